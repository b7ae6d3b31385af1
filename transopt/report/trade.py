"""Tables of what is exported to a driver, and of the figures in use in the haptics trade."""

import math
from collections.abc import Sequence

from transopt.base.tables import Table
from transopt.base.writing import percent
from transopt.library.drive import is_multiple
from transopt.library.drive_replay import PlayedDrive
from transopt.library.library import Library
from transopt.library.trade import PRESENT, RISEN, TradeFigures, trade_figures

TRADE_COLUMNS = ("peak m/s^2", "pulse / ring", "rise ms", "duration ms", "brake ms", "ring energy %")
TRADE_LEGEND = (
    "The pulse is the acceleration until the target ends (a recorded tap: until its last instant at "
    f"{100 * PRESENT:g} % of its peak), the ring what comes after. pulse / ring: peak to peak of the one over that "
    f"of the other. rise: first instant at {100 * PRESENT:g} % of the peak to the first at {100 * RISEN:g} %. "
    f"duration: first to last instant at {100 * PRESENT:g} %. brake: from the target's end to the last instant at "
    f"{100 * PRESENT:g} %. ring energy: share of the ring in all of the acceleration squared."
)


def trade_cells(figures: TradeFigures) -> list[str]:
    """Cells under `TRADE_COLUMNS`; a dash if a figure is unknown or the ring was not seen to end."""
    return [
        f"{figures.peak_m_s2:.3g}",
        _known(figures.pulse_to_ring, 1, "{:.1f}"),
        _known(figures.rise_s, 1e3, "{:.2f}"),
        _known(figures.duration_s, 1e3, "{:.2f}"),
        _known(figures.brake_s, 1e3, "{:.2f}"),
        percent(figures.ring_share),
    ]


def _known(value: float, factor: float, form: str) -> str:
    return form.format(factor * value) if math.isfinite(value) else "-"


def trade_table(library: Library, name: str) -> Table:
    """The trade's figures of every entry as designed."""
    table = Table.of(name, [*library.axes.columns, "tap error %", *TRADE_COLUMNS], words=("target",))
    for iv in range(library.speeds_m_s.size):
        for ig in range(library.grips_N.size):
            found = trade_figures(library, iv, ig)
            table.add_row(*library.axes.cells(iv, ig), percent(library.tap_error[iv, ig]), *trade_cells(found))
    return table


def drive_table(library: Library, left: Sequence[PlayedDrive]) -> Table:
    """The table of `transopt export --drive`: errors as designed and as exported, and the trade's figures."""
    driver = left[0].drive.driver
    title = (
        f"as it leaves: {driver.rate_Hz:g} Hz, {driver.depth.word}, full scale {driver.full_scale:g} {driver.unit}"
    )
    columns = ["designed %", "leaves %", "after %", "saturated", f"peak {driver.unit}", *TRADE_COLUMNS]
    table = Table.of(title, [*library.axes.columns, *columns], words=("target",))
    for each in left:
        drive = each.drive
        table.add_row(
            *library.axes.cells(drive.iv, drive.ig),
            f"{100 * each.tap_error_designed:.3f}",
            f"{100 * each.tap_error:.3f}",
            percent(each.error_after),
            str(drive.saturated),
            f"{drive.peak:.3f}",
            *trade_cells(each.figures),
            style="red" if drive.saturated or each.limits_left else None,
        )
    return table


def drive_remarks(library: Library, left: Sequence[PlayedDrive]) -> list[str]:
    """Points of an exported drive that deserve a second look, one line each."""
    driver = left[0].drive.driver
    sentences = [
        f"{each.drive.name}: {limit} as it leaves; more --bits, a multiple of the design's rate or a lower limit in "
        "the scene would keep it"
        for each in left
        for limit in each.limits_left
    ]
    saturated = sum(each.drive.saturated for each in left)
    if saturated:
        sentences.append(
            f"{saturated} samples are beyond full scale and leave clipped: leave --full-scale out, or solve the "
            f"scene with a limit of {driver.full_scale:g} {driver.unit}"
        )
    if not is_multiple(library, driver.rate_Hz):
        sentences.append(
            f"{driver.rate_Hz:g} Hz is no multiple of the design's {1 / library.dt_s:g} Hz: each sample is "
            "the mean of the command over its period; a scene with time.dt_s = "
            f"{1 / driver.rate_Hz:.17g} leaves as it was designed"
        )
    return sentences
