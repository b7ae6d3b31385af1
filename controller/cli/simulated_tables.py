"""The table of one tap."""

import numpy as np
from rich.table import Table

from controller.servo.interface import Notice
from controller.sim.experiment import Played
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.library.library import Library


def _number(value: float, form: str, unit: str) -> str:
    return "-" if np.isnan(value) else f"{value:{form}} {unit}"


def tap_table(played: Played, library: Library, title: str) -> Table:
    """What was measured, and beside it what it is to be compared with."""
    m, g = played.metrics, STANDARD_GRAVITY_M_S2
    limits, coil = library.meta["limits"], library.coil()
    table = Table(title=title)
    table.add_column("figure")
    table.add_column("played", justify="right", no_wrap=True)
    table.add_column("compare with", overflow="fold")
    table.add_row(
        "latency", _number(m.latency_s * 1e6, ".1f", "µs"), "the one shift that aligns played and predicted"
    )
    table.add_row("NRMSE after the shift", _number(100 * m.nrmse, ".2f", "%"), "against the library's prediction")
    floor = f"against the recorded tap; floor {_number(100 * played.prediction.floor, '.2f', '%')}"
    table.add_row("", _number(100 * m.nrmse_reference, ".2f", "%"), floor)
    table.add_row(
        "peak",
        _number(m.peak_m_s2 / g, ".2f", "g"),
        f"predicted {m.predicted_peak_m_s2 / g:.2f} g, recorded {m.reference_peak_m_s2 / g:.2f} g",
    )
    table.add_row(
        "spectral error", _number(m.spectral_error_dB, ".2f", "dB"), "rms over third octaves 10 Hz to 1 kHz"
    )
    real = _number(m.real_rate_hardness_N_m, ".0f", "N/m")
    table.add_row(
        "rate-hardness",
        _number(m.rate_hardness_N_m, ".0f", "N/m"),
        f"motor force at the tip; the real object, struck: {real}",
    )
    table.add_row("peak current", _number(m.peak_current_A, ".3f", "A"), f"limit {limits['current_A']:g} A")
    table.add_row(
        "winding",
        _number(m.peak_winding_C, ".2f", "°C"),
        "no motor data"
        if coil is None
        else f"start {m.start_winding_C:.2f} °C, servo's estimate {m.estimated_winding_C:.2f} °C, "
        f"limit {coil.limit_C:g} °C",
    )
    clamps = m.notices.get(Notice.COMMAND_SATURATED, 0)
    table.add_row("clamps", str(clamps), "times that transient and feedback together were cut")
    for notice, count in m.notices.items():
        if notice not in (Notice.COMMAND_SATURATED, Notice.CONTACT, Notice.FINISHED):
            table.add_row("notice", str(count), notice.value)
    table.add_row("verdict", "", m.verdict, style="red" if m.faults or not m.played else None)
    return table
