"""Work-precision diagrams: error, and tap error over the reference's, against run time; a column per case."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import Bbox, BboxBase
from PIL import Image

from precision.cases import SOLVED, Case
from precision.methods import TIME_LIMIT_S, Kind, Level
from precision.run import Row
from transopt.base.files import whole_file
from transopt.base.plotting import DARK, LABEL_PT, SMALL_PT

ERROR_FLOOR, TAP_ERROR_FLOOR = 1e-14, 1e-12  # what is drawn for less, zero included
GREY = "0.45"
TINY_PT = 6.5
SMALL_DPI = 120
EXACT = "exact hold"  # what every solver's curve has anyway
NAME_HEIGHT = 6.0  # what a name takes up on the logarithmic axis, as a factor
# Offsets of a point's name from the point, in points; the first one that covers no other name, no point and
# not the axis is taken.
NAME_PLACES_PT = (
    *((6, 0), (6, 3), (6, -4), (-6, 0), (-6, 3), (-6, -4), (6, 8), (6, -8), (-6, 8), (-6, -8)),
    *((6, 13), (6, -13), (-6, 13), (-6, -13), (6, 18), (6, -18), (-6, 18), (-6, -18)),
)
MARKER_PT = 2.5  # half the width of a point's marker
# Okabe and Ito's colours; a method keeps its look in every panel.
LOOKS: dict[str, dict[str, Any]] = {
    "casadi-piqp": {"color": "#0072B2", "marker": "o"},
    "casadi-ipopt": {"color": "#0072B2", "marker": "^", "linestyle": ":"},
    "riccati": {"color": "#D55E00", "marker": "o"},
    "hpipm (CasADi)": {"color": "#CC79A7", "marker": "v"},
    "piqp": {"color": "#56B4E9", "marker": "o"},
    "clarabel": {"color": "#009E73", "marker": "s"},
    "osqp": {"color": "#E69F00", "marker": "D"},
    "daqp": {"color": "#8B6D00", "marker": "P"},
    "opti-ipopt": {"color": "#000000", "marker": "^"},
}
LABELS = {
    "riccati": "riccati (this project's own)",
    "casadi-piqp": "casadi-piqp (this project)",
    "casadi-ipopt": "casadi-ipopt (this project)",
    "opti-ipopt": "Opti + IPOPT, as commonly written",
    "daqp": "daqp, condensed",
}
SPARE = ("#882255", "#7F3C8D", "#666666")  # for methods that the table above does not know
POINTS = {Kind.BASELINE.value: "X", Kind.DISCRETISATION.value: "_", Kind.PERIOD.value: "p"}
POINT_WORDS = {
    Kind.BASELINE.value: "baseline",
    Kind.DISCRETISATION.value: "right edge: stage discretised otherwise",
    Kind.PERIOD.value: "other servo rate, over a 40 kHz servo's",
}


def look(method: str, methods: Sequence[str]) -> dict[str, Any]:
    """Colour, marker and line of a method."""
    if method in LOOKS:
        return {"linestyle": "-", **LOOKS[method]}
    unknown = [name for name in methods if name not in LOOKS]
    return {"color": SPARE[unknown.index(method) % len(SPARE)], "marker": "*", "linestyle": "-"}


def _curves(axes: Axes, rows: Sequence[Row], value: str, floor: float) -> None:
    """One line per solver from loose to tight, its default ringed."""
    solvers = [row for row in rows if row.kind == Kind.SOLVER.value]
    names = list(dict.fromkeys(row.method for row in solvers))
    for name in names:
        found = [row for row in solvers if row.method == name and np.isfinite(getattr(row, value))]
        swept = sorted((row for row in found if np.isfinite(row.tolerance)), key=lambda row: -row.tolerance)
        style = look(name, names)
        places = [(row.solve_ms, max(abs(getattr(row, value)), floor)) for row in swept]
        axes.plot(*zip(*places, strict=True), linewidth=1.1, markersize=3.6, **style) if places else None
        for row in found:
            if row.level == Level.DEFAULT.value:
                place = (row.solve_ms, max(abs(getattr(row, value)), floor))
                axes.plot(*place, color=style["color"], marker=style["marker"], markersize=3.6, linestyle="")
                axes.plot(*place, marker="o", markersize=8.0, markerfacecolor="none", markeredgecolor=style["color"])


def _points(axes: Axes, rows: Sequence[Row], value: str, floor: float) -> list[Annotation]:
    """Baselines and servo rates with their names, which are returned; discretisations, whose time is that of one
    solver, by their level at the right edge.
    """
    named: dict[str, Any] = {"fontsize": TINY_PT, "color": GREY, "textcoords": "offset points", "va": "center"}
    shown = [row for row in rows if row.kind in POINTS and row.method != EXACT and np.isfinite(getattr(row, value))]
    edge, free, names = axes.get_xlim()[1], np.inf, list[Annotation]()
    for row in sorted(shown, key=lambda row: -abs(getattr(row, value))):
        height = max(abs(getattr(row, value)), floor)
        mark: dict[str, Any] = {"marker": POINTS[row.kind], "color": GREY, "linestyle": ""}
        if row.kind == Kind.DISCRETISATION.value:
            axes.plot(edge, height, markersize=6, clip_on=False, **mark)
            # Names of levels that nearly coincide stand below each other.
            free = min(height, free / NAME_HEIGHT)
            axes.annotate(row.method, (edge, free), (-7, 0), ha="right", **named)
        else:
            axes.plot(row.solve_ms, height, markersize=4.5, zorder=1, **mark)
            names.append(axes.annotate(row.method, (row.solve_ms, height), NAME_PLACES_PT[0], **named))
    return names


def _move_apart(names: Sequence[Annotation]) -> None:
    """Place the names of one panel, in a figure that is laid out, so that none covers another, a named point or the
    axis on the left.
    """
    taken = list[BboxBase]()
    for name in names:
        x, y = name.axes.transData.transform(name.xy)
        half = MARKER_PT * name.get_figure().dpi / 72
        taken.append(Bbox.from_extents(x - half, y - half, x + half, y + half))
    for name in names:
        for place in NAME_PLACES_PT:
            name.xyann = place
            name.set_horizontalalignment("left" if place[0] > 0 else "right")
            box = name.get_window_extent()
            if box.x0 > name.axes.bbox.x0 and not any(box.overlaps(other) for other in taken):
                break
        taken.append(box)


def _style(axes: Axes, floor: float, top: float, fastest_ms: float) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(floor / 3, top)
    axes.set_xlim(0.2 * fastest_ms, 2e3 * TIME_LIMIT_S)  # room for a name on the left of the fastest point
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_major_locator(LogLocator(base=100, numticks=20))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(labelsize=SMALL_PT)
    axes.grid(color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)


def work_precision(cases: Sequence[Case], rows: Sequence[Row]) -> Figure:
    """The diagrams: upper row the error, lower row the tap error, both logarithmic."""
    figure = Figure(figsize=(3.3 * len(cases) + 0.6, 7.4), layout="constrained")
    panels = figure.subplots(2, len(cases), sharex=True, sharey="row", squeeze=False)
    names, fastest_ms = list[list[Annotation]](), min(1.0, *(row.solve_ms for row in rows if row.solve_ms > 0))
    for column, case in enumerate(cases):
        own = [row for row in rows if row.case == case.name]
        upper, lower = panels[0, column], panels[1, column]
        _style(upper, ERROR_FLOOR, 300.0, fastest_ms)
        _style(lower, TAP_ERROR_FLOOR, 30.0, fastest_ms)
        upper.axhspan(ERROR_FLOOR / 10, max(case.optimum.agreement, ERROR_FLOOR), color="0.93", zorder=0)
        upper.axhline(SOLVED, color=DARK, linewidth=0.8, linestyle="--", zorder=0)
        _curves(upper, own, "error", ERROR_FLOOR)
        names.append(_points(upper, own, "error", ERROR_FLOOR))
        _curves(lower, own, "tap_error_excess", TAP_ERROR_FLOOR)
        names.append(_points(lower, own, "tap_error_excess", TAP_ERROR_FLOOR))
        failed = [row for row in own if not np.isfinite(row.error) and row.kind != Kind.PERIOD.value]
        if failed:
            words = ", ".join(dict.fromkeys(f"{row.method} ({row.status.split(':')[0]})" for row in failed))
            upper.set_xlabel(f"failed: {words}", fontsize=TINY_PT, color=GREY, wrap=True)
        kind = "QP" if case.qp is not None else "NLP"
        upper.set_title(f"{case.name}, {case.entry} ({kind})", fontsize=LABEL_PT)
        lower.set_xlabel("run time [ms]", fontsize=LABEL_PT)
    panels[0, 0].set_ylabel("relative error: the larger of\n|objective gap| and limit violation", fontsize=LABEL_PT)
    panels[1, 0].set_ylabel("tap error after replay,\ndistance to the reference's", fontsize=LABEL_PT)
    columns = min(len(cases), 4)
    figure.legend(handles=_handles(rows), loc="outside lower center", ncols=columns, fontsize=SMALL_PT, frameon=False)
    figure.draw_without_rendering()  # the names' extents are known only then
    for of_a_panel in names:
        _move_apart(of_a_panel)
    return figure


def save_small(figure: Figure, path: Path) -> None:
    """Write a PNG of a few dozen kilobytes, for a README: fewer points to the inch, 128 colours.

    Raises
    ------
    InputError : the file cannot be written.
    """
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=SMALL_DPI)
    small = Image.open(drawn).convert("RGB").quantize(128)
    with whole_file(path) as file:
        small.save(file, format="PNG", optimize=True)


def _handles(rows: Sequence[Row]) -> list[Line2D]:
    names = list(dict.fromkeys(row.method for row in rows if row.kind == Kind.SOLVER.value))
    handles = [
        Line2D([], [], linewidth=1.1, markersize=4, label=LABELS.get(name, name), **look(name, names))
        for name in names
    ]
    ring = {"marker": "o", "markersize": 8, "markerfacecolor": "none", "markeredgecolor": DARK, "linestyle": ""}
    handles.append(Line2D([], [], label="ringed: default settings", **ring))
    for kind, marker in POINTS.items():
        if any(row.kind == kind for row in rows):
            handles.append(Line2D([], [], color=GREY, marker=marker, linestyle="", label=POINT_WORDS[kind]))
    handles.append(Line2D([], [], color=DARK, linewidth=0.8, linestyle="--", label=f"counts as solved, {SOLVED:g}"))
    handles.append(Line2D([], [], color="0.9", linewidth=6, label="the two reference solutions differ by this"))
    return handles
