"""One self-contained C99/C++ header with the commands of several motors and the blend between their nodes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from transopt.base.signals import FloatArray
from transopt.library.c_header import FULL_SCALE, INTERVAL, axis, literal, plain, samples, single_precision
from transopt.library.library import Library

# In these texts "@" stands for the unit of the input.
FUNCTION = """\
/* Command [@] of a motor, 0 to TRANSOPT_MOTORS - 1, at tick k: {said};
 * then clamped to +-TRANSOPT_COMMAND_LIMIT_@. 0 outside 0 <= k < TRANSOPT_SAMPLES, for no such motor,
 * {silent}. */
static inline float transopt_command({arguments}, int32_t motor, int32_t k)
{{
    float command_@ = 0.0f;
    if (k < 0 || k >= TRANSOPT_SAMPLES || motor < 0 || motor >= TRANSOPT_MOTORS) {{
        return 0.0f;
    }}
{found}
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
OF_A_TARGET = """\
    if (target < 0 || target >= TRANSOPT_TARGETS) {
        return 0.0f;
    }
    command_@ = (float)transopt_counts[target][motor][k];"""
BLENDED = """\
    float share[{axes}];
    int32_t first[{axes}], corner;
    /* Every comparison with NaN is false, so NaN ends here. */
    if ({none}) {{
        return 0.0f;
    }}
{intervals}
    for (corner = 0; corner < {corners}; ++corner) {{
        float weight = 1.0f;
        int32_t at[{axes}], a;
        for (a = 0; a < {axes}; ++a) {{
            const int32_t next = (corner >> a) & 1;
            at[a] = first[a] + next;
            weight *= next ? share[a] : 1.0f - share[a];
        }}
        if (weight > 0.0f) {{
            command_@ += weight * (float)transopt_counts{at}[motor][k];
        }}
    }}"""


class _Axis(NamedTuple):
    """An axis along which commands are blended.

    Attributes
    ----------
    name, argument : of its nodes and of the function's argument. said : what the argument is.
    none : test for an argument for which nothing is played. nodes : (k,) in single precision.
    """

    name: str
    argument: str
    said: str
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
    if not library.axes.places:
        return found
    _, *sizes = library.axes.sizes
    grips = np.array([*library.axes.by_grip])
    found.append(_Axis("grips_N", "grip_N", "grip [N]", "!(grip_N >= TRANSOPT_GRIP_MIN_N)", grips))
    for name, size in zip(("normal", "posture"), sizes, strict=True):
        said = f"the place along the list of {name}s, 1 for the first"
        found.append(_Axis(f"{name}s", name, said, f"!({name} == {name})", np.arange(1.0, size + 1)))
    return found


def motors_header(library: Library) -> str:
    """The header's text, ASCII.

    Commands are rounded to 16 bit with one scale. They are scaled down first by as much as rounding can add, half a
    count of the weakest motor's limit, so that every blend of the rounded commands keeps the limits too.

    Raises
    ------
    InputError : two nodes of an axis are the same number in single precision.
    """
    axes = _axes(library)
    counts, scale = _quantised(library, axes)
    digest, unit = library.content_sha256, library.driven_by.unit
    guard = f"TRANSOPT_MOTORS_{digest[:16].upper()}_H"
    sizes = dict(zip([*([a.size for a in axes] or ["TARGETS"]), "MOTORS", "SAMPLES"], counts.shape, strict=True))
    shape = "".join(f"[TRANSOPT_{name}]" for name in sizes)
    parts = [
        _comment(library, digest, axes, counts.nbytes),
        f"#ifndef {guard}\n#define {guard}\n\n#include <stdint.h>\n",
        _macros(library, sizes, scale).replace("@", unit),
        *(axis(f"transopt_{a.name}[TRANSOPT_{a.size}]", single_precision(a.name, a.nodes)) for a in axes),
        f"static const int16_t transopt_counts{shape} = {_nested(counts)};\n",
        *([INTERVAL] if axes else []),
        _function(axes).replace("@", unit),
        f"#endif /* {guard} */\n",
    ]
    return "\n".join(parts)


def _quantised(library: Library, axes: list[_Axis]) -> tuple[NDArray[np.int16], np.float32]:
    """Counts over axes or targets, motors and ticks, and the size of a count."""
    least = library.input_limit * min(library.scene().shares)
    largest = float(np.abs(library.command).max())
    shrunk = 1 - largest / (2 * FULL_SCALE) / least
    scale = np.float32(shrunk * largest / FULL_SCALE)
    if scale < np.finfo(np.float32).tiny:  # a zero library; a subnormal scale could overflow the counts
        scale, counts = np.float32(0.0), np.zeros(library.command.shape, dtype=np.int16)
    else:
        counts = np.rint(shrunk * library.command / float(scale)).astype(np.int16)
    nodes = [a.nodes.size for a in axes] or [len(library.axes.targets)]
    return counts.reshape(*nodes, *counts.shape[2:]), scale


def _function(axes: list[_Axis]) -> str:
    if not axes:
        said = {"said": "that of a target, by its number from 0", "silent": "for no such target"}
        return FUNCTION.format(**said, arguments="int32_t target", found=OF_A_TARGET)
    intervals = [
        f"    first[{j}] = transopt_interval(transopt_{a.name}, TRANSOPT_{a.size}, {a.argument}, &share[{j}]);"
        for j, a in enumerate(axes)
    ]
    blended = BLENDED.format(
        axes=len(axes),
        none=" || ".join(a.none for a in axes),
        intervals="\n".join(intervals),
        corners=2 ** len(axes),
        at="".join(f"[at[{j}]]" for j in range(len(axes))),
    )
    under = ", below TRANSOPT_GRIP_MIN_N" if any(a.argument == "grip_N" for a in axes) else ""
    return FUNCTION.format(
        said="linear in\n * " + ",\n * ".join(a.said for a in axes) + ", each clamped to the grid",
        silent=f"for speed <= 0{under} and for NaN",
        arguments=", ".join(f"float {a.argument}" for a in axes),
        found=blended,
    )


def _comment(library: Library, digest: str, axes: list[_Axis], size: int) -> str:
    scene = library.scene()
    lists = []
    if scene.axes.places:
        lists += [f"normal {j}: {plain(each)}" for j, each in enumerate(scene.arm().normals, start=1)]
        lists += [f"posture {j}: {plain(each)} degrees" for j, each in enumerate(scene.arm().postures_deg, start=1)]
    lists += [f"target {j}: {plain(name)}" for j, name in enumerate(library.axes.targets)]
    listed = "".join(f" *   {each}\n" for each in lists)
    made = (
        "make the named targets"
        if not axes
        else "make the stylus accelerate as in the recorded taps, along\n * the normal of the surface"
        if scene.axes.places
        else "make the first acceleration that of the recorded taps"
    )
    kept = "blend" if axes else "command"
    begins = "the target's beginning" if not axes else "contact"
    arguments = ", ".join(a.argument.split("_")[0] for a in axes) or "target"
    return f"""\
/* Tap transients for scene {plain(library.meta["scene"]["name"])}, generated by transopt. Do not edit.
 *
 * library content sha256: {digest}
 *
 * Commands of {len(scene.shares)} motors that {made}. Units: {library.driven_by.unit}, m/s, N, s.
 * From TRANSOPT_LEAD_S before {begins} on, at one tick every TRANSOPT_DT_S, send
 * transopt_command({arguments}, motor, k) to every motor and hold it.
{listed} *
 * Every {kept} keeps the limits of all motors. The tables take {size} bytes. Do not compile with
 * -ffast-math: it may drop the checks for NaN.
 */"""


def _macros(library: Library, sizes: dict[str, int], scale: np.float32) -> str:
    amplifier = library.amplifier()
    limit = library.input_limit if amplifier is None else amplifier.command_limit
    values = {
        **{name: str(size) for name, size in sizes.items()},
        "DT_S": literal(library.dt_s),
        "LEAD_S": literal(library.lead_s),
        **({"GRIP_MIN_N": literal(library.grip_min_N)} if "GRIPS" in sizes else {}),
        "COMMAND_LIMIT_@": literal(limit),
        "SCALE_@": literal(scale),
    }
    return "".join(f"#define TRANSOPT_{name} {value}\n" for name, value in values.items())


def _nested(counts: NDArray[np.int16]) -> str:
    if counts.ndim == 1:
        return samples(counts)
    return "{\n" + ",\n".join(map(_nested, counts)) + "\n}"
