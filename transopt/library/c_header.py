"""One self-contained C99/C++ header with a library's waveforms and the blend between its nodes."""

import re

import numpy as np
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.library.library import Library

FULL_SCALE = 32767  # counts; -32768 stays unused so that the scale is symmetric
COUNTS_PER_LINE = 16

INTERVAL = """\
/* The interval of a strictly increasing axis that x lies in; *weight is x's place in it, clamped to 0..1. */
static inline int32_t transopt_interval(const float *axis, int32_t nodes, float x, float *weight)
{
    int32_t j = 0;
    float place = 0.0f;
    while (j + 2 < nodes && x >= axis[j + 1]) {
        ++j;
    }
    if (nodes > 1) {
        place = (x - axis[j]) / (axis[j + 1] - axis[j]);
    }
    *weight = place < 0.0f ? 0.0f : (place > 1.0f ? 1.0f : place);
    return j;
}
"""

FUNCTION = """\
/* Transient command [A] of tick k, bilinear in speed [m/s] and grip [N], clamped to the grid and to
 * +-TRANSOPT_COMMAND_LIMIT_A. 0 outside 0 <= k < TRANSOPT_SAMPLES, for speed <= 0, below TRANSOPT_GRIP_MIN_N and
 * for NaN. */
static inline float transopt_command(float speed_m_s, float grip_N, int32_t k)
{
    float by_speed, by_grip, slower, faster, other, command_A;
    int32_t iv, ig, next_v, next_g;
    if (k < 0 || k >= TRANSOPT_SAMPLES) {
        return 0.0f;
    }
    /* A stylus that does not come in taps nothing. Every comparison with NaN is false, so NaN ends here too. */
    if (!(speed_m_s > 0.0f) || !(grip_N >= TRANSOPT_GRIP_MIN_N)) {
        return 0.0f;
    }
    iv = transopt_interval(transopt_speeds_m_s, TRANSOPT_SPEEDS, speed_m_s, &by_speed);
    ig = transopt_interval(transopt_grips_N, TRANSOPT_GRIPS, grip_N, &by_grip);
    next_v = iv + 1 < TRANSOPT_SPEEDS ? iv + 1 : iv;
    next_g = ig + 1 < TRANSOPT_GRIPS ? ig + 1 : ig;
    slower = transopt_counts[iv][ig][k];
    other = transopt_counts[iv][next_g][k];
    slower += by_grip * (other - slower);
    faster = transopt_counts[next_v][ig][k];
    other = transopt_counts[next_v][next_g][k];
    faster += by_grip * (other - faster);
    command_A = TRANSOPT_SCALE_A * (slower + by_speed * (faster - slower));
    if (command_A > TRANSOPT_COMMAND_LIMIT_A) {
        return TRANSOPT_COMMAND_LIMIT_A;
    }
    if (command_A < -TRANSOPT_COMMAND_LIMIT_A) {
        return -TRANSOPT_COMMAND_LIMIT_A;
    }
    return command_A;
}
"""


def c_header(library: Library) -> str:
    """The header's text, ASCII.

    Waveforms are `transient_command_A` rounded to 16 bit with one scale for the whole library, so a blended
    command is off by at most half a count, max|c| / 65534 (plus single-precision rounding).

    Raises
    ------
    InputError : two nodes of an axis are the same number in single precision.
    """
    speeds = single_precision("speeds_m_s", library.speeds_m_s)
    grips = single_precision("grips_N", library.grips_N)
    counts, scale_A = _quantise(library.transient_command)
    digest = library.content_sha256
    # The guard names the content: two different libraries in one program must collide, not hide each other.
    guard = f"TRANSOPT_{digest[:16].upper()}_H"
    parts = [
        _comment(library, digest, counts),
        f"#ifndef {guard}\n#define {guard}\n\n#include <stdint.h>\n",
        _macros(library, counts, scale_A),
        axis("transopt_speeds_m_s[TRANSOPT_SPEEDS]", speeds),
        axis("transopt_grips_N[TRANSOPT_GRIPS]", grips),
        _waveforms(counts, ""),
        INTERVAL,
        FUNCTION,
        *_second(library),
        f"#endif /* {guard} */\n",
    ]
    return "\n".join(parts)


def _second(library: Library) -> list[str]:
    """Scale, table and function of the cool commands; an empty list if the library has no cool commands."""
    if library.cool is None:
        return []
    counts, scale_A = _quantise(library.cool.transient_command)
    function = FUNCTION
    for name in ("transopt_command", "transopt_counts", "TRANSOPT_SCALE_A"):
        function = function.replace(name, name.replace("transopt_", "transopt_cool_").replace("OPT_S", "OPT_COOL_S"))
    function = function.replace("Transient command", "Cool command, with less heat,")
    scale = f"#define TRANSOPT_COOL_SCALE_A {literal(scale_A)} /* amperes per count of the cool commands */\n"
    return [scale, _waveforms(counts, "cool_"), function]


def single_precision(name: str, nodes: FloatArray) -> NDArray[np.float32]:
    """Nodes of an axis in the single precision of the header.

    Raises
    ------
    InputError : two nodes are the same number in single precision.
    """
    rounded = nodes.astype(np.float32)
    same = np.flatnonzero(np.diff(rounded) <= 0)
    if same.size:
        lower, upper = nodes[same[0] : same[0] + 2]
        raise InputError(
            f"{name}: {lower:.17g} and {upper:.17g} are the same number in single precision, which the header uses; "
            "solve the scene again with nodes further apart"
        )
    return rounded


def _quantise(command_A: FloatArray) -> tuple[NDArray[np.int16], np.float32]:
    """(nv, ng, N) counts, and the amperes per count."""
    scale_A = np.float32(np.abs(command_A).max() / FULL_SCALE)
    if scale_A < np.finfo(np.float32).tiny:  # a zero library; a subnormal scale could overflow the counts
        return np.zeros(command_A.shape, dtype=np.int16), np.float32(0.0)
    # Divide by the rounded scale, because the device multiplies by the rounded scale.
    return np.rint(command_A / float(scale_A)).astype(np.int16), scale_A


def literal(value: float | np.float32) -> str:
    """The shortest C float literal that reads back as the same single-precision number."""
    return f"{np.float32(value)!s}f"


def plain(text: object) -> str:
    """Text in which no character can end a C comment or continue its line."""
    return re.sub(r"[^A-Za-z0-9_ .,:()+-]", "_", str(text))


def _comment(library: Library, digest: str, counts: NDArray[np.int16]) -> str:
    meta = library.meta
    versions = ", ".join(f"{plain(name)} {plain(version)}" for name, version in meta["versions"].items())
    feedback = (
        "This scene has no wall: they are the total command."
        if library.wall() is None
        else "This scene has a wall: its feedback is not in them."
    )
    second = (
        ""
        if library.cool is None
        else """\
 *
 * Where the coil is warm, send (1 - m) transopt_command(...) + m transopt_cool_command(...) of the same tick instead,
 * with one m in 0..1 for the whole tap. The blend keeps every limit, and the root of its heat is at most the same
 * blend of the roots of both heats.
"""
    )
    size = counts.nbytes * (1 if library.cool is None else 2)
    return f"""\
/* Tap transients for scene {plain(meta["scene"]["name"])}, generated by transopt. Do not edit.
 *
 * library content sha256: {digest}
 * versions: {versions}
 *
 * Motor-current commands that make the stylus accelerate as in the recorded taps, over incoming speed and grip.
 * Units: A, m/s, N, s. Signs: current i > 0 pushes the stylus out of the surface; incoming speed > 0; grip >= 0.
 * The waveforms are the transient part of the command. {feedback}
 * Feedback of your own is added to them, through its prefilter; then clamp the sum to TRANSOPT_COMMAND_LIMIT_A.
 *
 * How to play a tap, at one tick every TRANSOPT_DT_S:
 *   1. extrapolate the approach; TRANSOPT_LEAD_S before contact read speed and grip once and set k = 0;
 *   2. at this tick and every later one: send transopt_command(speed_m_s, grip_N, k), hold it, then k = k + 1;
 *   3. stop after TRANSOPT_SAMPLES ticks, or at once when the grip falls below TRANSOPT_GRIP_MIN_N.
{second} *
 * The tables take {size} bytes. Do not compile with -ffast-math: it may drop the checks for NaN.
 */"""


def _macros(library: Library, counts: NDArray[np.int16], scale_A: np.float32) -> str:
    amplifier, current_A = library.amplifier(), library.input_limit
    # A library of the free device has no minimum grip: it plays at every reading but NaN.
    free = library.grips_N.size == 1 and library.grips_N[0] == 0
    least_grip = -np.finfo(np.float32).max if free else library.grip_min_N
    nv, ng, samples = counts.shape
    values = {
        "SPEEDS": (str(nv), "nodes"),
        "GRIPS": (str(ng), "nodes"),
        "SAMPLES": (str(samples), "ticks"),
        "DT_S": (literal(library.dt_s), "servo period [s]"),
        "LEAD_S": (literal(library.lead_s), "tick 0 is this long before contact [s]"),
        "GRIP_MIN_N": (literal(least_grip), "no transient below this grip [N]"),
        "CURRENT_LIMIT_A": (literal(current_A), "limit of the total current, feedback included [A]"),
        "COMMAND_LIMIT_A": (
            literal(current_A if amplifier is None else amplifier.command_limit),
            "limit of the command [A]",
        ),
        "SCALE_A": (literal(scale_A), "amperes per count"),
    }
    return "".join(f"#define TRANSOPT_{name} {value} /* {what} */\n" for name, (value, what) in values.items())


def axis(declarator: str, nodes: NDArray[np.float32]) -> str:
    """The definition of an axis in C."""
    return f"static const float {declarator} = {{{', '.join(literal(node) for node in nodes)}}};"


def _waveforms(counts: NDArray[np.int16], prefix: str) -> str:
    rows = ",\n".join("{\n" + ",\n".join(samples(row) for row in by_grip) + "\n}" for by_grip in counts)
    size = "[TRANSOPT_SPEEDS][TRANSOPT_GRIPS][TRANSOPT_SAMPLES]"
    return f"static const int16_t transopt_{prefix}counts{size} = {{\n{rows}\n}};\n"


def samples(row: NDArray[np.int16]) -> str:
    """A waveform as a C initialiser, `COUNTS_PER_LINE` counts per line."""
    texts = [str(count) for count in row.tolist()]
    lines = [", ".join(texts[j : j + COUNTS_PER_LINE]) for j in range(0, len(texts), COUNTS_PER_LINE)]
    return "{" + ",\n ".join(lines) + "}"
