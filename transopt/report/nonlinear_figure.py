"""What both designs do on the plant that is not linear, beside what is wanted."""

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from transopt.base.plotting import CLIPPED, DARK, LABEL_PT, OPTIMUM, SMALL_PT, Drawing, leave_room, style
from transopt.base.writing import percent
from transopt.design.entry import Entry
from transopt.report.transients import legend_above

MOST_TARGETS = 6  # that one figure shows legibly
WANTED: dict[str, Any] = {"color": DARK, "linewidth": 2.2, "alpha": 0.35}
LINEAR: dict[str, Any] = {"color": CLIPPED, "linewidth": 1.0, "linestyle": "--"}
OWN: dict[str, Any] = {"color": OPTIMUM, "linewidth": 1.0}
BOUND: dict[str, Any] = {"color": DARK, "linewidth": 1.0, "linestyle": ":"}


def nonlinear_figure(entries: Sequence[Entry]) -> Figure:
    """Acceleration of both designs played on the nonlinear plant, above their commands; a column for each target.

    Parameters
    ----------
    entries : the first `MOST_TARGETS` of them are drawn.
    """
    shown = entries[:MOST_TARGETS]
    figure = Drawing(figsize=(max(1.0 + 2.6 * len(shown), 4.4), 5.0))
    rows = figure.subplots(2, len(shown), sharex="col", squeeze=False, gridspec_kw={"wspace": 0.28, "hspace": 0.08})
    for column, entry in enumerate(shown):
        above, below = rows[:, column]
        problem = entry.problem
        felt_ms, issued_ms = problem.grid.switching_times_s * 1e3, problem.grid.issue_times_s * 1e3
        above.plot(felt_ms, problem.reference_m_s2, **WANTED)
        if entry.linear_played is not None and entry.linear_command is not None:
            above.plot(felt_ms, entry.linear_played.acceleration_m_s2, **LINEAR)
            below.step(issued_ms, entry.linear_command, where="post", **LINEAR)
        above.plot(felt_ms, entry.played.acceleration_m_s2, **OWN)
        below.step(issued_ms, entry.solution.command, where="post", **OWN)
        for side in (-1, 1):
            below.axhline(side * problem.limits.input_limit, **BOUND)
        errors = f"linear {percent(entry.linear_tap_error)} %, nonlinear {percent(entry.figures.tap_error)} %"
        above.set_title(f"{entry.target}\n{errors}", fontsize=SMALL_PT)
        below.set_xlabel("time [ms]", fontsize=LABEL_PT)
        for axes in (above, below):
            style(axes)
    driven_by = shown[0].problem.driven_by
    rows[0, 0].set_ylabel("acceleration [m/s²]", fontsize=LABEL_PT)
    rows[1, 0].set_ylabel(f"{driven_by.name} [{driven_by.unit}]", fontsize=LABEL_PT)
    handles = [
        Line2D([], [], label="wanted", **WANTED),
        Line2D([], [], label="linear design", **LINEAR),
        Line2D([], [], label="nonlinear design", **OWN),
        Line2D([], [], label="limit", **BOUND),
    ]
    above_in = legend_above(figure, handles, entry_in=1.15) + 0.42
    leave_room(figure, left_in=0.72, right_in=0.12, below_in=0.5, above_in=above_in)
    return figure
