"""Tables and text of `seed_figures.py`: seed.md and the CSV files."""

from collections.abc import Sequence
from dataclasses import dataclass

from controller.waveforms.bank import Method
from seed.comparison import MISMATCH, Summary, exceptions
from seed.device import RealTap, Shape
from transopt.base.writing import percent, table

WORDS = {
    Method.BILINEAR: "optimum, blended (bilinear)",
    Method.NEAREST: "optimum, nearest node",
    Method.BLIND: "optimum for the middle grip (blind)",
    Method.PROPORTIONAL: "proportional only, wall of 200 N/m",
    Method.DECAYING_SINUSOID: "decaying sinusoid",
    Method.FIXED_WIDTH_PULSE: "fixed-width pulse",
    Method.MOMENTUM_CANCELLATION: "momentum cancellation",
    Method.SEED_INVERSION: "the seed's inversion, clipped",
    Method.CLIPPED_OPTIMUM: "unlimited optimum, clipped",
}
FIGURE_WORDS = {
    "nominal": "mean, nominal device",
    "nominal_worst": "worst, nominal device",
    "mean": "mean over devices",
    "worst_device": "worst device",
    "worst_tap": "worst tap",
    "nominal_unshifted": "nominal mean without the shift",
    "mean_unshifted": "mean over devices without the shift",
    "felt_nominal": "mean felt error, nominal device",
    "felt_mean": "mean felt error over devices",
}
WHY = {
    Method.NEAREST.value: " It plays the same optimum; all these taps are at the nodes, where rounding to a node "
    "takes away the errors of measured speed and grip. Between the nodes only the blend is right: last columns."
}


@dataclass(frozen=True)
class Compared:
    """One condition on the nominal device.

    Attributes
    ----------
    needed_A : peak of the unlimited optimum. over_ms : time it spends above the steady limit.
    optimum, optimum_steady, seed, seed_steady, blind : tap error after the shift: at the transient limit, at the
        steady one, the seed's inversion at both, and the optimum for the middle grip at the transient limit.
    optimum_felt, optimum_speed, seed_felt, seed_speed : felt error and speed of the same taps, and so of the others.
    peak_g, peak_steady_g : played. reference_g : recorded. playback_error : of the optimum against the library's
        prediction after the shift. latency_s : of the optimum against it.
    """

    speed_m_s: float
    grip_N: float
    needed_A: float
    over_ms: float
    optimum: float
    optimum_steady: float
    seed: float
    seed_steady: float
    blind: float
    optimum_felt: float
    optimum_steady_felt: float
    seed_felt: float
    seed_steady_felt: float
    blind_felt: float
    optimum_speed: float
    optimum_steady_speed: float
    seed_speed: float
    seed_steady_speed: float
    blind_speed: float
    reference_g: float
    peak_g: float
    peak_steady_g: float
    playback_error: float
    latency_s: float


def method_table(summaries: Sequence[Summary], off_nodes: Sequence[Summary]) -> list[str]:
    """Tap error by method; `off_nodes` of the same methods at the cells' middles, nominal device."""
    off = {summary.method: summary for summary in off_nodes}
    head = ["method", "nominal: mean", "worst", "devices: mean", "worst device", "worst tap", "nearer than optimum"]
    head += ["as it came: nominal", "devices", "off the nodes: mean", "worst"]
    rows = []
    for s in summaries:
        values = (s.nominal, s.nominal_worst, s.mean, s.worst_device, s.worst_tap)
        ahead = f"{s.ahead} / {s.ahead_unshifted} of {s.taps}"
        last = [percent(s.nominal_unshifted), percent(s.mean_unshifted)]
        if s.method in off:
            last += [percent(off[s.method].nominal), percent(off[s.method].nominal_worst)]
        else:
            last += ["-", "-"]
        rows.append([WORDS[Method(s.method)], *map(percent, values), ahead, *last])
    return table(head, rows)


def felt_table(summaries: Sequence[Summary], off_nodes: Sequence[Summary]) -> list[str]:
    """Felt error and speed by method, of the same taps as `method_table`."""
    off = {summary.method: summary for summary in off_nodes}
    head = ["method", "felt error: nominal", "devices", "off the nodes", "speed: nominal", "devices", "off the nodes"]
    rows = []
    for s in summaries:
        between = off.get(s.method)
        felt = [s.felt_nominal, s.felt_mean, *([between.felt_nominal] if between else [])]
        speed = [s.speed_nominal, s.speed_mean, *([between.speed_nominal] if between else [])]
        missing = [] if between else ["-"]
        shown = [*map(percent, felt), *missing, *(f"{each:.2f}" for each in speed), *missing]
        rows.append([WORDS[Method(s.method)], *shown])
    return table(head, rows)


def ahead_of_all(summaries: Sequence[Summary]) -> list[str]:
    """Whether the optimum leads in mean and worst case, and where not."""
    found = exceptions(summaries)
    claim = "The optimum has less tap and felt error than every other method in every mean and worst case"
    if not found:
        return [f"{claim}.", ""]
    lines = [f"{claim}, except:", ""]
    for method in dict.fromkeys(name for name, *_ in found):
        figures = [(figure, optimum - value) for name, figure, value, optimum in found if name == method]
        most = 100 * max(gain for _, gain in figures)
        where = "; ".join(FIGURE_WORDS[figure] for figure, _ in figures)
        lines.append(
            f"- {WORDS[Method(method)]}, by at most {most:.3f} percentage points: {where}.{WHY.get(method, '')}"
        )
    return [*lines, ""]


def limit_table(compared: Sequence[Compared], limits_A: tuple[float, float]) -> list[str]:
    high, low = (f"{limit:g} A" for limit in limits_A)
    head = ["speed m/s", "grip N", "needed A", f"ms above {low}", f"optimum {high}", f"optimum {low}"]
    head += [f"seed {high}", f"seed {low}", f"blind {high}"]
    rows = [
        [
            f"{c.speed_m_s:g}",
            f"{c.grip_N:g}",
            f"{c.needed_A:.2f}",
            f"{c.over_ms:.1f}",
            *map(percent, (c.optimum, c.optimum_steady, c.seed, c.seed_steady, c.blind)),
        ]
        for c in compared
    ]
    return table(head, rows)


def limit_felt_table(compared: Sequence[Compared], limits_A: tuple[float, float]) -> list[str]:
    """Felt error, speed and peak of the same taps."""
    high, low = (f"{limit:g} A" for limit in limits_A)
    ways = [f"optimum {high}", f"optimum {low}", f"seed {high}", f"seed {low}"]
    head = ["speed m/s", "grip N", f"felt error: {ways[0]}", *ways[1:], f"speed: {ways[0]}", *ways[1:]]
    head += ["peak g: recorded", *ways[:2]]
    rows = [
        [
            f"{c.speed_m_s:g}",
            f"{c.grip_N:g}",
            *map(percent, (c.optimum_felt, c.optimum_steady_felt, c.seed_felt, c.seed_steady_felt)),
            *(
                f"{speed:.2f}"
                for speed in (c.optimum_speed, c.optimum_steady_speed, c.seed_speed, c.seed_steady_speed)
            ),
            *(f"{peak:.1f}" for peak in (c.reference_g, c.peak_g, c.peak_steady_g)),
        ]
        for c in compared
    ]
    return table(head, rows)


def mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def limit_words(compared: Sequence[Compared], limits_A: tuple[float, float]) -> list[str]:
    """The seed's statements about limit and grip beside what was measured."""
    high, low = limits_A
    n = len(compared)
    over = sum(c.needed_A > low for c in compared)
    above = sum(c.needed_A > high for c in compared)
    off_grip = [c for c in compared if abs(c.optimum - c.blind) > 0.01]
    lines = [
        f"- The seed: at the steady limit of {low:g} A almost every signal would be clipped. Here {over} of {n} "
        f"optima need more than {low:g} A, {above} more than {high:g} A. Held to {low:g} A the best possible current "
        f"has a mean tap error of {percent(mean([c.optimum_steady for c in compared]))} % in place of "
        f"{percent(mean([c.optimum for c in compared]))} % at {high:g} A; the seed's inversion, clipped, "
        f"{percent(mean([c.seed_steady for c in compared]))} % in place of "
        f"{percent(mean([c.seed for c in compared]))} %.",
        f"- At {high:g} A the optimum has a mean felt error of {percent(mean([c.optimum_felt for c in compared]))} % "
        f"and a speed of {mean([c.optimum_speed for c in compared]):.2f}, the seed's inversion "
        f"{percent(mean([c.seed_felt for c in compared]))} % and {mean([c.seed_speed for c in compared]):.2f}.",
    ]
    if off_grip:
        lines.append(
            f"- The seed: the current has to be compensated for the grip. Where the grip is not the one that "
            f"the blind waveform is for ({len(off_grip)} of {n} conditions), its mean tap error is "
            f"{percent(mean([c.blind for c in off_grip]))} %, that of the compensated one "
            f"{percent(mean([c.optimum for c in off_grip]))} %."
        )
    errors = [c.playback_error for c in compared]
    late_us = [1e6 * c.latency_s for c in compared]
    lines.append(
        f"- Played against predicted on the nominal device: playback error "
        f"{percent(min(errors))} to {percent(max(errors))} %, latency {min(late_us):.1f} to {max(late_us):.1f} µs."
    )
    return [*lines, ""]


def real_tap_table(taps: Sequence[RealTap]) -> list[str]:
    head = ["speed m/s", "grip N", "peak g", "peak N", "first push ms"]
    rows = [
        [f"{t.speed_m_s:g}", f"{t.grip_N:g}", f"{t.peak_g:.1f}", f"{t.peak_N:.1f}", f"{1e3 * t.pulse_s:.1f}"]
        for t in taps
    ]
    return table(head, rows)


def shape_table(shapes: Sequence[Shape]) -> list[str]:
    head = ["grip N", "dB/decade 1-4 Hz", "dB/decade 5-80 Hz", "g/A at 80 Hz", "resonance Hz", "g/A there"]
    rows = [
        [
            f"{s.grip_N:g}",
            f"{s.slow_dB_decade:.1f}",
            f"{s.fast_dB_decade:.1f}",
            f"{s.at_80_Hz_g_A:.2f}",
            f"{s.resonance_Hz:.0f}",
            f"{s.resonance_g_A:.1f}",
        ]
        for s in shapes
    ]
    return table(head, rows)


def how_measured(devices: int) -> list[str]:
    return [
        "Tap error is |a - r| / |r| in % of the played acceleration a (the simulator's stylus) against the recorded "
        "tap r, unfiltered, until the hand's intention is over; felt error is the same ratio within 120 to 620 Hz, "
        "over window and tail; speed is the change of speed, played over recorded, 1 on a surface as hard as the "
        "real one. All after the one shift within 1 ms that suits the tap best; *as it came* is without that shift. "
        "The seed's inversion asks the motor for the whole recorded deceleration. At 0 Hz its model passes nothing, "
        "so that the mean current is open: no current before contact is its expedient. What it still pushes with "
        "when the waveform ends it lets go of within the taper, and that kick is in the felt error. The hand of the "
        "recordings, servo in the loop: speed from the encoder, grip from its sensor. Nominal: the device as the "
        "model has it, with sensor noise. "
        f"Devices: {devices} with every mass, stiffness, damping, force per ampere and the amplifier's pole and "
        f"delay off by up to {100 * MISMATCH:g} % and a dead band of 10 mA, the same ones for every method. "
        "*Nearer than optimum* counts their taps in which a method beat the optimum by more than 0.1 percentage "
        "points, after the shift / as they came: the optimum is one for the nominal device, and on another one the "
        "error of a worse waveform can happen to oppose that of the device. *Off the nodes*: nominal device, middles "
        "of the grid's cells. The scene renders no wall; proportional only has the one of the scene `walled`.",
        "",
    ]
