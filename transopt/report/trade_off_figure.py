"""Tap error against energy, from the nearest waveform to the optimum of intensity and on, where a limit binds."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from transopt.base.plotting import LABEL_PT, SMALL_PT, colours, leave_room, style
from transopt.design.trade_off import TradeOff
from transopt.problem.objective.bands import JUST_NOTICED_dB
from transopt.report.transients import legend_above

if TYPE_CHECKING:
    from transopt.design.build import Build

LOWEST_dB, HIGHEST_dB = -12.0, 8.0  # what of the path is drawn; beyond it all entries go on alike


def trade_off_figure(build: "Build") -> Figure:
    """Tap error [%] over energy [dB], a line per entry from the nearest waveform on; circles, squares: the optima.

    Parameters
    ----------
    build : with at least one entry that a limit cuts.
    """
    found = build.trade_offs
    figure = Figure(figsize=(6.4, 4.6))
    axes = figure.subplots()
    style(axes)
    axes.axvspan(-JUST_NOTICED_dB, JUST_NOTICED_dB, color="0.93", linewidth=0)
    axes.axvline(0.0, color="0.6", linewidth=0.8)
    speeds = sorted({(each.speed_m_s, each.cells[0]) for each in found})
    grips = sorted({each.grip_N for each in found})
    shades = colours(len(speeds))
    dashes = ("-", "--", "-.", ":")
    lines = []
    for each in found:
        i, j = speeds.index((each.speed_m_s, each.cells[0])), grips.index(each.grip_N)
        dB, error = ([getattr(p, name) for p in each.path] for name in ("energy_dB", "tap_error"))
        drawn: dict[str, Any] = {"color": shades[i], "linewidth": 1.2}
        label = each.place
        (line,) = axes.plot(dB, 100 * np.array(error), linestyle=dashes[j % len(dashes)], label=label, **drawn)
        lines.append(line)
        for point, marker in ((each.waveform, "o"), (each.intensity, "s")):
            axes.plot([point.energy_dB], [100 * point.tap_error], marker=marker, markersize=5, linestyle="", **drawn)
    axes.set_xlim(*_shown(found))
    within = [100 * p.tap_error for each in found for p in each.path if p.energy_dB <= axes.get_xlim()[1]]
    axes.set_ylim(0.0, 1.08 * max(within))
    axes.set_xlabel("energy within the window over that of the recorded tap [dB]", fontsize=LABEL_PT)
    axes.set_ylabel("tap error as predicted [%]", fontsize=LABEL_PT)
    axes.tick_params(labelsize=SMALL_PT)
    axes.text(
        0.01,
        0.98,
        f"circle: nearest waveform; square: intensity\nshaded: {JUST_NOTICED_dB:g} dB, just noticed",
        transform=axes.transAxes,
        fontsize=SMALL_PT,
        va="top",
    )
    leave_room(figure, left_in=0.62, right_in=0.1, below_in=0.48, above_in=legend_above(figure, lines, entry_in=1.6))
    return figure


def _shown(found: Sequence[TradeOff]) -> tuple[float, float]:
    """Ends of the axis: all optima, and of the rest of the paths so much that the optima stay apart."""
    optima = [point.energy_dB for each in found for point in (each.waveform, each.intensity)]
    low, high = max(min(optima), LOWEST_dB), min(max(*optima, 0.0) + 4.0, max(HIGHEST_dB, *optima) + 1)
    return low - 0.3, high
