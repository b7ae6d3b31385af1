"""One self-contained C99/C++ header with a library's waveforms and the blend between its nodes, for any motors."""

import re
import textwrap
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.library.library import Library

FULL_SCALE = 32767  # counts; -32768 stays unused so that the scale is symmetric
COUNTS_PER_LINE = 16

INTERVAL = """\
/* The two nodes of a strictly increasing axis between which x lies; *share is its place between them, clamped to
 * 0..1. */
static inline void transopt_interval(const float *axis, int32_t nodes, float x, int32_t *at, float *share)
{
    int32_t j = 0;
    float place = 0.0f;
    while (j + 2 < nodes && x >= axis[j + 1]) {
        ++j;
    }
    if (nodes > 1) {
        place = (x - axis[j]) / (axis[j + 1] - axis[j]);
    }
    *share = place < 0.0f ? 0.0f : (place > 1.0f ? 1.0f : place);
    at[0] = j;
    at[1] = j + 1 < nodes ? j + 1 : j;
}
"""
# In these texts "@" stands for the unit of the input.
FUNCTION = """\
/* {what} [@] {motor}of tick k,
 * {found} to +-TRANSOPT_COMMAND_LIMIT_@.
 * 0 outside 0 <= k < TRANSOPT_SAMPLES{silent}. */
static inline float transopt_command({arguments}, int32_t k)
{{
    float command_@ = 0.0f;
    if ({outside}) {{
        return 0.0f;
    }}
{sum}
    command_@ *= TRANSOPT_SCALE_@;
    if (command_@ > TRANSOPT_COMMAND_LIMIT_@) {{
        return TRANSOPT_COMMAND_LIMIT_@;
    }}
    if (command_@ < -TRANSOPT_COMMAND_LIMIT_@) {{
        return -TRANSOPT_COMMAND_LIMIT_@;
    }}
    return command_@;
}}
"""
BLEND = """\
    float share[{axes}], value[{corners}];
    int32_t at[{axes}][2];
    /* A stylus that does not come in taps nothing. Every comparison with NaN is false, so NaN ends here too. */
    if ({none}) {{
        return 0.0f;
    }}
{intervals}
{corner_values}
{folds}
    command_@ = value[0];"""


class _Axis(NamedTuple):
    """An axis along which commands are blended.

    Attributes
    ----------
    name, argument : of its nodes and of the function's argument. meaning : of the argument, with its unit.
    none : test for an argument for which nothing is played. nodes : (k,) in double precision.
    """

    name: str
    argument: str
    meaning: str
    none: str
    nodes: FloatArray

    @property
    def size(self) -> str:
        """Name of the macro with the number of nodes."""
        return self.name.split("_")[0].upper()


def _axes(library: Library) -> list[_Axis]:
    """The axes of a library; none for named targets, which are not blended."""
    if library.axes.targets:
        return []
    found = [_Axis("speeds_m_s", "speed_m_s", "speed [m/s]", "!(speed_m_s > 0.0f)", library.speeds_m_s)]
    if library.axes.places or not library.scene().shares:  # nobody holds a plant of several motors that is no arm
        grips = np.array([*library.axes.by_grip])
        found.append(_Axis("grips_N", "grip_N", "grip [N]", "!(grip_N >= TRANSOPT_GRIP_MIN_N)", grips))
    for name, size in zip(("normal", "posture"), library.axes.sizes[1:] if library.axes.places else (), strict=False):
        meaning = f"the place along the list of {name}s, 1 for the first"
        found.append(_Axis(f"{name}s", name, meaning, f"!({name} == {name})", np.arange(1.0, size + 1)))
    return found


def c_header(library: Library) -> str:
    """The header's text, ASCII.

    Waveforms are `transient_command` rounded to 16 bit with one scale for the whole library, so a blended command is
    off by at most half a count, max|c| / 65534 (plus single-precision rounding). Those of several motors are scaled
    down first by as much as that can add to the weakest motor's limit, since the function clamps all motors alike.

    Raises
    ------
    InputError : two nodes of an axis are the same number in single precision.
    """
    axes, unit, digest = _axes(library), library.driven_by.unit, library.content_sha256
    shares = library.scene().shares
    shape = [axis.nodes.size for axis in axes] or [len(library.axes.targets)]
    names = [*([axis.size for axis in axes] or ["TARGETS"]), *(["MOTORS"] if shares else []), "SAMPLES"]
    counts, scale = _quantised(library, library.transient_command)
    counts = counts.reshape(*shape, *counts.shape[2:])
    sizes = dict(zip(names, counts.shape, strict=True))
    declared = "".join(f"[TRANSOPT_{name}]" for name in names)
    # The guard names the content: two different libraries in one program must collide, not hide each other.
    guard = f"TRANSOPT_{digest[:16].upper()}_H"
    parts = [
        _comment(library, axes, digest, counts.nbytes),
        f"#ifndef {guard}\n#define {guard}\n\n#include <stdint.h>\n",
        _macros(library, sizes, scale),
        *(_nodes(axis) for axis in axes),
        f"static const int16_t transopt_counts{declared} = {_nested(counts)};\n",
        *([INTERVAL] if axes else []),
        _function(axes, several=bool(shares), what="Transient command").replace("@", unit),
    ]
    if library.cool is not None:
        counts, scale = _quantised(library, library.cool.transient_command)
        function = _function(axes, several=False, what="Cool command, with less heat,").replace("@", unit)
        for name in ("transopt_command", "transopt_counts", f"TRANSOPT_SCALE_{unit}"):
            function = function.replace(name, name.replace("opt_", "opt_cool_").replace("OPT_", "OPT_COOL_"))
        parts += [
            f"#define TRANSOPT_COOL_SCALE_{unit} {literal(scale)} /* {unit} per count of the cool commands */\n",
            f"static const int16_t transopt_cool_counts{declared} = {_nested(counts)};\n",
            function,
        ]
    return "\n".join([*parts, f"#endif /* {guard} */\n"])


def _nodes(axis: _Axis) -> str:
    """The definition of an axis in C.

    Raises
    ------
    InputError : two nodes are the same number in single precision.
    """
    rounded = axis.nodes.astype(np.float32)
    same = np.flatnonzero(np.diff(rounded) <= 0)
    if same.size:
        lower, upper = axis.nodes[same[0] : same[0] + 2]
        raise InputError(
            f"{axis.name}: {lower:.17g} and {upper:.17g} are the same number in single precision, which the header "
            "uses; solve the scene again with nodes further apart"
        )
    listed = ", ".join(literal(node) for node in rounded)
    return f"static const float transopt_{axis.name}[TRANSOPT_{axis.size}] = {{{listed}}};"


def _quantised(library: Library, command: FloatArray) -> tuple[NDArray[np.int16], np.float32]:
    """Counts of commands (nv, ng, ..., N), and the size of a count."""
    largest = float(np.abs(command).max())
    shares = library.scene().shares
    shrunk = 1 - largest / (2 * FULL_SCALE) / (library.input_limit * min(shares)) if shares else 1.0
    scale = np.float32(shrunk * largest / FULL_SCALE)
    if scale < np.finfo(np.float32).tiny:  # a zero library; a subnormal scale could overflow the counts
        return np.zeros(command.shape, dtype=np.int16), np.float32(0.0)
    # Divide by the rounded scale, because the device multiplies by the rounded scale.
    return np.rint(shrunk * command / float(scale)).astype(np.int16), scale


def literal(value: float | np.float32) -> str:
    """The shortest C float literal that reads back as the same single-precision number."""
    return f"{np.float32(value)!s}f"


def plain(text: object) -> str:
    """Text in which no character can end a C comment or continue its line."""
    return re.sub(r"[^A-Za-z0-9_ .,:()+-]", "_", str(text))


def _function(axes: list[_Axis], *, several: bool, what: str) -> str:
    """The function that returns a command, with "@" for its unit."""
    outside = ["k < 0 || k >= TRANSOPT_SAMPLES"]
    arguments = [f"float {axis.argument}" for axis in axes] or ["int32_t target"]
    silent = ["" if axes else ", for no such target"]
    if not axes:
        outside.append("target < 0 || target >= TRANSOPT_TARGETS")
    if several:
        outside.append("motor < 0 || motor >= TRANSOPT_MOTORS")
        arguments.append("int32_t motor")
        silent.append(", for no such motor")
    if axes:
        under = ", below TRANSOPT_GRIP_MIN_N" if any(axis.argument == "grip_N" for axis in axes) else ""
        silent.append(f", for speed <= 0{under} and for NaN")
    of_motor, meanings = "[motor]" if several else "", ",\n * ".join(axis.meaning for axis in axes)
    return FUNCTION.format(
        what=what,
        motor="of a motor, 0 to TRANSOPT_MOTORS - 1, " if several else "",
        found=f"linear in {meanings}, clamped to the grid and" if axes else "by the number of its target, clamped",
        silent="".join(silent),
        arguments=", ".join(arguments),
        outside=" || ".join(outside),
        sum=_blend(axes, of_motor) if axes else f"    command_@ = (float)transopt_counts[target]{of_motor}[k];",
    )


def _blend(axes: list[_Axis], of_motor: str) -> str:
    """The statements that blend the commands of the nodes around a point, the last axis first."""
    many = len(axes)
    intervals = [
        f"    transopt_interval(transopt_{one.name}, TRANSOPT_{one.size}, {one.argument}, at[{a}], &share[{a}]);"
        for a, one in enumerate(axes)
    ]
    corners = [
        "".join(f"[at[{a}][{side}]]" for a, side in enumerate(sides)) for sides in product((0, 1), repeat=many)
    ]
    values = [f"    value[{j}] = (float)transopt_counts{corner}{of_motor}[k];" for j, corner in enumerate(corners)]
    folds = [
        f"    value[{j}] += share[{a}] * (value[{j + step}] - value[{j}]);"
        for a, step in reversed([(a, 2 ** (many - 1 - a)) for a in range(many)])
        for j in range(0, 2**many, 2 * step)
    ]
    return BLEND.format(
        axes=many,
        none=" || ".join(one.none for one in axes),
        intervals="\n".join(intervals),
        corners=2**many,
        corner_values="\n".join(values),
        folds="\n".join(folds),
    )


def _comment(library: Library, axes: list[_Axis], digest: str, size: int) -> str:
    """What the header holds, and how a tap or a target is played from it."""
    scene, unit = library.scene(), library.driven_by.unit
    versions = ", ".join(f"{plain(name)} {plain(version)}" for name, version in library.meta["versions"].items())
    motors = f"{len(scene.shares)} motors" if scene.shares else "the motor"
    made = "make the stylus accelerate as in the recorded taps" if axes else "make the targets named below"
    paragraphs = [
        f"Tap transients for scene {plain(scene.name)}, generated by transopt. Do not edit.",
        f"library content sha256: {digest}\nversions: {versions}",
        f"Commands of {motors} that {made}. Units: {unit}, m/s, N, s.\n{_added(library)}",
        "\n".join(_playing(library, axes)),
        *(["\n".join(listed)] if (listed := _numbered(library)) else []),
    ]
    if library.cool is not None:
        paragraphs.append(
            "Where the coil is warm, send (1 - m) transopt_command(...) + m transopt_cool_command(...) of the same "
            "tick instead, with one m in 0..1 for the whole tap. The blend keeps every limit, and the root of its "
            "heat is at most the same blend of the roots of both heats."
        )
    paragraphs.append(
        f"The tables take {size * (1 if library.cool is None else 2)} bytes. Do not compile with -ffast-math: it may "
        "drop the checks for NaN."
    )
    lines = "\n\n".join(paragraphs).splitlines()
    wrapped = [part for line in lines for part in textwrap.wrap(line, 110, subsequent_indent="   ") or [""]]
    return "/* " + "\n".join(f" * {line}".rstrip() for line in wrapped)[3:] + "\n */"


def _added(library: Library) -> str:
    """What may be added to the commands of a tap of one motor; that of others is whole."""
    if library.scene().shares or library.axes.targets:
        return f"Every {'command' if library.axes.targets else 'blend'} keeps all limits; nothing is added to it."
    total = (
        "This scene has no wall: they are the total command."
        if library.wall() is None
        else "This scene has a wall: its feedback is not in them."
    )
    return (
        f"Signs: {library.driven_by.name} > 0 pushes the stylus out of the surface; incoming speed > 0; grip >= 0.\n"
        f"The waveforms are the transient part of the command. {total}\nFeedback of your own is added to them, "
        f"through its prefilter; then clamp the sum to TRANSOPT_COMMAND_LIMIT_{library.driven_by.unit}."
    )


def _playing(library: Library, axes: list[_Axis]) -> list[str]:
    """The steps that play a tap or a target."""
    several = bool(library.scene().shares)
    names = [axis.argument for axis in axes] or ["target"]
    called = ", ".join([*names, *(["motor"] if several else []), "k"])
    read = ", ".join(axis.argument.split("_")[0] for axis in axes)
    begun = f"extrapolate the approach; TRANSOPT_LEAD_S before contact read {read} once and set k = 0;"
    stopped = ", or at once when the grip falls below TRANSOPT_GRIP_MIN_N" if "grip_N" in names else ""
    to_all = " to every motor" if several else ""
    return [
        "How to play, at one tick every TRANSOPT_DT_S:",
        f"1. {begun if axes else 'TRANSOPT_LEAD_S before the beginning of the target set k = 0;'}",
        f"2. at this tick and every later one: send transopt_command({called}){to_all}, hold it, then k = k + 1;",
        f"3. stop after TRANSOPT_SAMPLES ticks{stopped}.",
    ]


def _numbered(library: Library) -> list[str]:
    """The targets, normals and postures by the numbers that the function takes."""
    if not library.axes.places:
        return [f"target {j}: {plain(name)}" for j, name in enumerate(library.axes.targets)]
    arm = library.scene().arm()
    normals = [f"normal {j}: {plain(each)}" for j, each in enumerate(arm.normals, start=1)]
    return normals + [f"posture {j}: {plain(each)} degrees" for j, each in enumerate(arm.postures_deg, start=1)]


def _macros(library: Library, sizes: dict[str, int], scale: np.float32) -> str:
    amplifier, most, unit = library.amplifier(), library.input_limit, library.driven_by.unit
    # A library of the free device has no minimum grip: it plays at every reading but NaN.
    free = library.grips_N.size == 1 and library.grips_N[0] == 0
    counted = {"TARGETS": "by number from 0", "MOTORS": "by number from 0", "SAMPLES": "ticks"}
    values = {name: (str(size), counted.get(name, "nodes")) for name, size in sizes.items()}
    values |= {
        "DT_S": (literal(library.dt_s), "servo period [s]"),
        "LEAD_S": (literal(library.lead_s), "tick 0 is this long before contact or a target's beginning [s]"),
    }
    if "GRIPS" in sizes:
        least_grip = -np.finfo(np.float32).max if free else library.grip_min_N
        values["GRIP_MIN_N"] = (literal(least_grip), "no transient below this grip [N]")
    if "MOTORS" not in sizes:
        whole = f"limit of the total {library.driven_by.name}, feedback included [{unit}]"
        values[f"{library.driven_by.name.upper()}_LIMIT_{unit}"] = (literal(most), whole)
    limit = most if amplifier is None else amplifier.command_limit
    values[f"COMMAND_LIMIT_{unit}"] = (literal(limit), f"limit of the command [{unit}]")
    values[f"SCALE_{unit}"] = (literal(scale), f"{unit} per count")
    return "".join(f"#define TRANSOPT_{name} {value} /* {what} */\n" for name, (value, what) in values.items())


def _nested(counts: NDArray[np.int16]) -> str:
    """Counts (..., N) as a C initialiser, `COUNTS_PER_LINE` counts per line."""
    if counts.ndim > 1:
        return "{\n" + ",\n".join(map(_nested, counts)) + "\n}"
    texts = [str(count) for count in counts.tolist()]
    lines = [", ".join(texts[j : j + COUNTS_PER_LINE]) for j in range(0, len(texts), COUNTS_PER_LINE)]
    return "{" + ",\n ".join(lines) + "}"
