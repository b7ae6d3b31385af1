"""Tables of what was seen on a device: the bring-up check, taps played."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from controller.host.bringup import Result
from controller.host.sweeps import Trial
from controller.protocol.codes import LinkNotice
from controller.record.judge import Judged
from controller.servo.interface import Fault, Notice
from transopt.base.signals import STANDARD_GRAVITY_M_S2

VERDICTS = {True: "passed", False: "FAILED", None: "-"}
EVERY_TAP = (Notice.CONTACT, Notice.FINISHED)


def check_table(results: Sequence[Result], title: str) -> Table:
    """Every step: expected, seen, verdict."""
    table = Table(title=title)
    for name in ("step", "expected", "seen", "verdict"):
        table.add_column(name, overflow="fold")
    for result in results:
        style = "red" if result.passed is False else None
        table.add_row(result.name, result.expected, result.seen, VERDICTS[result.passed], style=style)
    return table


def played_table(judged: Sequence[Judged], events: Mapping[object, int], title: str) -> Table:
    """Every tap with its figures, then the events that are not part of every tap."""
    table = Table(title=title)
    table.add_column("tap", justify="right")
    for name in ("speed m/s", "grip N", "latency µs", "NRMSE %", "peak g", "predicted g"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("note", overflow="fold")
    for one in judged:
        contact, g = one.contact, STANDARD_GRAVITY_M_S2
        table.add_row(
            str(contact.number),
            f"{contact.speed_m_s:.3f}",
            f"{contact.grip_N:.2f}",
            _number(1e6 * one.latency_s, ".1f"),
            _number(100 * one.nrmse, ".2f"),
            _number(one.peak_m_s2 / g, ".2f"),
            _number(one.predicted_peak_m_s2 / g, ".2f"),
            one.why,
        )
    for what, count in events.items():
        if what not in EVERY_TAP and isinstance(what, Notice | Fault | LinkNotice):
            table.add_row("", "", "", "", "", "", "", f"{count} x {what.value}")
    return table


def sweep_table(trials: Sequence[tuple[Path, Trial]], title: str) -> Table:
    """Every trial with what it reached."""
    table = Table(title=title)
    table.add_column("file", no_wrap=True)
    for name in ("sign", "grip N", "peak A", "peak g", "travel mm"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("note", overflow="fold")
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


def _number(value: float, form: str) -> str:
    return "-" if np.isnan(value) else format(value, form)
