"""Tables of what was seen on a device: the bring-up check, taps, sweeps."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controller.host.bringup import Result
from controller.host.sweeps import Trial
from controller.protocol.codes import LinkNotice
from controller.record.played import PlayedTap
from controller.servo.interface import Fault, Notice
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.base.tables import Table
from transopt.library.library import Library

VERDICTS = {True: "passed", False: "FAILED", None: "-"}
EVERY_TAP = (Notice.CONTACT, Notice.FINISHED)


def check_table(results: Sequence[Result], title: str) -> Table:
    """Every step: expected, seen, verdict."""
    heads = ("step", "expected", "seen", "verdict")
    table = Table.of(title, heads, words=heads)
    for result in results:
        style = "red" if result.passed is False else None
        table.add_row(result.name, result.expected, result.seen, VERDICTS[result.passed], style=style)
    return table


def taps_table(taps: Sequence[PlayedTap], events: Mapping[object, int], title: str) -> Table:
    """Every tap with its figures, if any tap could be compared, then the events that are not part of every tap."""
    judged = any(not tap.why for tap in taps)
    figures = ("latency µs", "tap %", "playback %", "peak g", "predicted g") if judged else ()
    table = Table.of(title, ("tap", "speed m/s", "grip N", *figures, "note"), words=("note",))
    for tap in taps:
        contact, found, g = tap.contact, tap.compared, STANDARD_GRAVITY_M_S2
        numbers = (
            _number(1e6 * found.latency_s, ".1f"),
            _number(100 * found.tap_error, ".1f"),
            _number(100 * found.playback_error, ".2f"),
            _number(found.peak_m_s2 / g, ".2f"),
            _number(found.predicted_peak_m_s2 / g, ".2f"),
        )
        place = (str(contact.number), f"{contact.speed_m_s:.3f}", f"{contact.grip_N:.2f}")
        table.add_row(*place, *numbers[: len(figures)], tap.remark)
    for what, count in events.items():
        if what not in EVERY_TAP and isinstance(what, Notice | Fault | LinkNotice):
            table.add_row(*[""] * (3 + len(figures)), f"{count} x {what.value}")
    return table


@dataclass(frozen=True)
class Yardstick:
    """What a library's scene knows that no telemetry tells; NaN where it does not.

    Attributes
    ----------
    force_per_current_N_A : of the motor, at the tip.
    real_rate_hardness_N_m : of the object that the scene's recordings come from.
    why_unknown : reason why the rate-hardness of the object is not known; empty if it is.
    """

    force_per_current_N_A: float
    real_rate_hardness_N_m: float
    why_unknown: str = ""


def figures_table(
    taps: Sequence[PlayedTap], library: Library, events: Mapping[object, int], yardstick: Yardstick
) -> Table:
    """What the taps came to, on average or at most, and beside it what that is to be compared with."""
    compared = [tap for tap in taps if not tap.why]
    g, limits, coil = STANDARD_GRAVITY_M_S2, library.posing().asked, library.coil()

    def mean(values: Iterable[float], size: float, form: str, unit: str) -> str:
        return _number(size * float(np.mean(list(values))) if compared else np.nan, form, unit)

    def figure(name: str, size: float, form: str, unit: str) -> str:
        return mean((getattr(tap.compared, name) for tap in compared), size, form, unit)

    floor = mean((tap.prediction.floor for tap in compared), 100, ".2f", "%")
    predicted, reference = (figure(f"{name}_peak_m_s2", 1 / g, ".2f", "g") for name in ("predicted", "reference"))
    hardness = (tap.rate_hardness_N_m(yardstick.force_per_current_N_A) for tap in compared)
    real = yardstick.why_unknown or _number(yardstick.real_rate_hardness_N_m, ".0f", "N/m")
    peak_A = max((tap.peak_current_A for tap in taps), default=np.nan)
    hottest_C = max((float(tap.contact.winding_C.max(initial=-np.inf)) for tap in taps), default=np.nan)
    winding, of_winding = "-", "no motor data"
    if coil is not None:
        winding = _number(hottest_C, ".2f", "°C")
        of_winding = f"estimated; start {coil.start_winding_C:.2f} °C, limit {coil.limit_C:g} °C"
    clamps = str(events.get(Notice.COMMAND_SATURATED, 0))
    by_hand = "against the library's prediction, until the hand can react"
    played = "played" if len(taps) <= 1 else f"{len(compared)} taps"
    table = Table.of(None, ("figure", played, "compare with"), words=("figure", "compare with"))
    rows = (
        ("latency", figure("latency_s", 1e6, ".1f", "µs"), "the one shift that aligns played and predicted"),
        (
            "tap error",
            figure("tap_error", 100, ".1f", "%"),
            f"against the recorded tap, until the hand can react; floor {floor}",
        ),
        ("speed", figure("speed", 1, ".2f", ""), "change of speed over the recorded one; 1 is as hard"),
        ("playback error", figure("playback_error", 100, ".2f", "%"), by_hand),
        ("peak", figure("peak_m_s2", 1 / g, ".2f", "g"), f"predicted {predicted}, recorded {reference}"),
        ("spectral error", figure("spectral_error_dB", 1, ".2f", "dB"), "rms over third octaves 10 Hz to 1 kHz"),
        (
            "rate-hardness",
            mean(hardness, 1, ".0f", "N/m"),
            f"motor force at the tip; the real object, struck: {real}",
        ),
        ("peak current", _number(peak_A, ".3f", "A"), f"limit {limits['current_A']:g} A"),
        ("winding", winding, of_winding),
        ("clamps", clamps, "times that transient and feedback together were cut"),
    )
    for row in rows if compared else rows[-3:]:  # no tap tells the others
        table.add_row(*row)
    faults = [what.value for what in events if isinstance(what, Fault)]
    words = [f"fault: {faults[0]}"] if faults else list(dict.fromkeys(tap.verdict for tap in taps))
    table.add_row("verdict", "", "; ".join(words) or "no transient played", style=None if compared else "red")
    return table


def sweep_table(trials: Sequence[tuple[Path, Trial]], title: str) -> Table:
    """Every trial with what it reached."""
    heads = ("file", "sign", "grip N", "peak A", "peak g", "travel mm", "note")
    table = Table.of(title, heads, words=("file", "note"))
    for path, trial in trials:
        swing = trial.acceleration_m_s2 - trial.acceleration_m_s2.mean()
        travel_m = float(np.ptp(trial.position_m))
        notes = [f"a limit cut {trial.cut_ticks} commands"] if trial.cut_ticks else []
        notes += [] if travel_m > 0 else ["not one encoder count: is the rotor blocked on purpose?"]
        table.add_row(
            path.name,
            "-" if trial.negative else "+",
            f"{trial.grip_N:.2f}",
            f"{np.abs(trial.current_A).max():.3f}",
            f"{np.abs(swing).max() / STANDARD_GRAVITY_M_S2:.2f}",
            f"{1e3 * travel_m:.2f}",
            "; ".join(notes),
        )
    return table


def _number(value: float, form: str, unit: str = "") -> str:
    return "-" if np.isnan(value) else f"{value:{form}} {unit}".rstrip()
