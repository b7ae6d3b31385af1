"""The trade-off between waveform and intensity, as sections of report.md and rows of report.json."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from transopt.base.writing import percent, table
from transopt.design.entry import Entry
from transopt.design.trade_off import TradeOff, TradeOffPoint
from transopt.problem.objective.bands import EDGES_Hz, JUST_NOTICED_dB, Levels

if TYPE_CHECKING:
    from transopt.design.build import Build


def _dB(value: float) -> str:
    return "-" if np.isnan(value) else f"{round(value, 1) + 0.0:+.1f}"  # avoids -0.0


def trade_off_lines(build: "Build") -> list[str]:
    """The section of report.md on the trade-off; empty if no limit binds."""
    found = build.trade_offs
    if not found:
        return []
    weights = build.scene.weights
    asked_dB = weights.intensity_dB if weights.objective == "intensity" else 0.0
    bands = _bands(found)
    head = [
        *build.scene.axes.columns,
        "optimum of",
        "lam",
        "tap error %",
        "dB",
        "felt dB",
        f"below {EDGES_Hz[0]:.0f} Hz",
    ]
    rows = []
    for each in found:
        for name, point in (("waveform", each.waveform), ("intensity", each.intensity)):
            cells = [*each.cells, name, f"{point.price:.3g}", percent(point.tap_error)]
            thirds = [point.levels.thirds_dB.get(band, np.nan) for band in bands]
            cells += map(_dB, (point.levels.broadband_dB, point.levels.pacinian_dB, point.levels.below_dB, *thirds))
            rows.append(cells)
    missing = "; ".join(f"{each.place} ({each.missing_dB:.2f} dB short)" for each in found if each.missing_dB)
    beyond_reach = f"No lam reaches it at {missing}. That is no proof that no command within the limits has more."
    return [
        "",
        "## Waveform and intensity",
        "",
        *table([*head, *(f"{band:g} Hz" for band in bands)], rows),
        "Entries that a limit cuts, as predicted. waveform: the least squares of the error. intensity: the nearest "
        f"waveform among all commands with an energy of {asked_dB:+g} dB over the recorded one, at the price lam. "
        "dB: energy within the window over that of r; felt: through the band-pass at 275 Hz, of which "
        f"{JUST_NOTICED_dB:g} dB are just noticed; then third octaves (IEC 61260) that hold a part of the tap. "
        "`trade_off.png` shows what lies between, where figures are drawn.",
        *([beyond_reach] if missing else []),
    ]


def _bands(found: Sequence[TradeOff]) -> list[float]:
    """Third octaves that contain a part of any entry's tap."""
    return sorted({band for each in found for band in each.waveform.levels.thirds_dB})


def attained_lines(entries: Sequence[Entry]) -> list[str]:
    """The section on the energy that the scene asks for; empty if it asks for none."""
    asked = [(entry, entry.attained) for entry in entries if entry.attained is not None]
    if not asked:
        return []
    lines = [f"- {e.place}: {attained.sentence}" for e, attained in asked]
    return [
        "",
        "## Intensity",
        "",
        *lines,
        "",
        "Each is the nearest waveform among all commands within the limits with as much energy: gap and bound are "
        "those of J less lam times the energy. What the search for lam leaves stands in the dB.",
    ]


def levels_row(levels: Levels) -> dict[str, Any]:
    """Levels, with the bands under their names."""
    return {**asdict(levels), "thirds_dB": {f"{band:g}": value for band, value in levels.thirds_dB.items()}}


def _row(point: TradeOffPoint) -> dict[str, Any]:
    return {**asdict(point), "levels": levels_row(point.levels)}


def trade_off_row(build: "Build", entry: Entry) -> dict[str, Any] | None:
    """Trade-off in an entry's row of report.json; None if no limit binds."""
    for each in build.trade_offs:
        if each.place == entry.place:
            return {
                "waveform": _row(each.waveform),
                "intensity": _row(each.intensity),
                "missing_dB": each.missing_dB,
                "path": [_row(point) for point in each.path],
            }
    return None
