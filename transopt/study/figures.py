"""Figures of a constraint study: curves for one key, heat maps for two, else small multiples."""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from transopt.base.plotting import DARK, LABEL_PT, SEED, SMALL_PT, colours, plain, style
from transopt.base.signals import FloatArray
from transopt.base.units import unit_of, words_of
from transopt.study.axes import Axis
from transopt.study.inverse import Answer
from transopt.study.plan import Plan
from transopt.study.rows import Row, entry_cells, entry_name, is_admitted, number

MOST_PANELS = 12  # most heat maps, one per entry; for more entries a single map of the worst
MOST_WRITTEN = 80  # most cells of a heat map that show their numbers
LEAST_PERCENT = 0.1
MANY_TICKS = 30.0  # ratio of largest to smallest value above which ticks at 1, 2, 5 of each decade overlap
NARROW = 6.0  # ratio of the ends of an axis up to which it has the ticks of `NARROW_SUBS`
WIDE_SUBS, NARROW_SUBS = (1.0, 2.0, 3.0, 5.0), (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
DASHES = ("-", "--", ":", "-.")


def axis_label(key: str, unit: str = "") -> str:
    """Table and words of a key with its unit, or another one: "limits: current [A]" for "limits.current_A"."""
    table, _, name = key.partition(".")
    words = f"{table}: {words_of(name)}" if name else words_of(table)
    unit = unit or unit_of(key)
    return f"{words} [{unit}]" if unit else words


class PercentLocator(LogLocator):
    """Ticks at 1, 2, 3 and 5 of each decade, and at more places on an axis that spans less than a decade."""

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        self.set_params(subs=WIDE_SUBS if vmax > NARROW * vmin else NARROW_SUBS)
        return super().tick_values(vmin, vmax)


def percent_axis(axes: Axes, *, x: bool = False) -> None:
    """A logarithmic axis of percentages with plain numbers."""
    (axes.set_xscale if x else axes.set_yscale)("log")
    axis = axes.xaxis if x else axes.yaxis
    axis.set_major_locator(PercentLocator())
    axis.set_major_formatter(FuncFormatter(plain))
    axis.set_minor_formatter(NullFormatter())
    axis.set_minor_locator(NullLocator())


def _logarithmic(axis: Axis) -> bool:
    values = [value for value in axis.values if isinstance(value, int | float)]
    return axis.log or (axis.numeric and len(values) > 2 and min(values) > 0 and max(values) / min(values) >= 50)


def _prepared(axes: Axes, axis: Axis) -> FloatArray:
    """(n,) positions of a key's values on the x axis; its ticks and label are set."""
    axes.set_xlabel(axis_label(axis.key), fontsize=LABEL_PT)
    if not axis.numeric:
        axes.set_xticks(range(len(axis.labels)), axis.labels, rotation=30, ha="right")
        return np.arange(len(axis.labels), dtype=float)
    values = np.array(axis.values, dtype=float)
    if _logarithmic(axis):
        percent_axis(axes, x=True)
        if values.max() > MANY_TICKS * values.min():
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    if unit_of(axis.key) == "s" and values.max() < 0.1:
        axes.set_xlabel(axis_label(axis.key, "ms"), fontsize=LABEL_PT)
        values = 1e3 * values
    return values


def entry_grid(plan: Plan, rows: Sequence[Row], column: str) -> FloatArray:
    """(*shape, speeds, grips) one column of a study of all combinations; NaN where the value is missing."""
    table = np.full(plan.entries, np.nan)
    for row in rows:
        table[int(row["index"])] = number(row, column) if is_admitted(row) else np.nan
    return table.reshape(*plan.shape, len(plan.speeds_m_s), len(plan.grips_N))


def panels_of(count: int, most_across: int, wide_in: float, margin_in: float, *, share_x: bool) -> tuple[Figure, Any]:
    """A figure with `count` panels, row by row, in an array (down, across) whose surplus panels are hidden."""
    across = min(count, most_across)
    down = math.ceil(count / across)
    figure = Figure(figsize=(1.0 + wide_in * across, margin_in + 2.5 * down), layout="constrained")
    panels = figure.subplots(down, across, sharex=share_x, sharey=True, squeeze=False)
    for axes in panels.flat[count:]:
        axes.set_visible(False)
    for row in panels:
        row[0].set_ylabel("tap error [%], log scale", fontsize=LABEL_PT)
    return figure, panels


def legend_above(figure: Figure, handles: Sequence[Any], most_columns: int = 6) -> None:
    """One legend above all panels."""
    columns = min(len(handles), most_columns)
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, fontsize=SMALL_PT, frameon=False)


def entry_lines(axes: Axes, plan: Plan, x: FloatArray, values: FloatArray) -> None:
    """Draw a line per entry of values (points, speeds, grips): one colour per grip, dashes and marker per speed."""
    for iv, (marker, dash) in zip(range(len(plan.speeds_m_s)), itertools.product("os^Dv<>", DASHES), strict=False):
        for ig, colour in enumerate(colours(len(plan.grips_N))):
            name = plan.entry_axes.place(iv, ig)
            drawn: dict[str, Any] = {"color": colour, "linestyle": dash, "linewidth": 1.2, "marker": marker}
            axes.plot(x, values[:, iv, ig], markersize=3, label=name, **drawn)


def curves(plan: Plan, rows: Sequence[Row]) -> Figure:
    """Tap error and floor over one key: one panel per grip, one line per speed."""
    axis, grips, speeds = plan.axes[0], plan.grips_N, plan.speeds_m_s
    error, floor = (100 * entry_grid(plan, rows, column) for column in ("tap_error", "floor"))
    shade = colours(len(speeds))
    figure, panels = panels_of(len(grips), 4, 2.3, 0.9, share_x=True)
    for ig, (axes, grip) in enumerate(zip(panels.flat, grips, strict=False)):
        style(axes)
        x = _prepared(axes, axis)
        for iv in range(len(speeds)):
            axes.plot(x, floor[:, iv, ig], color=shade[iv], linewidth=0.8, linestyle=":")
            axes.plot(x, error[:, iv, ig], color=shade[iv], linewidth=1.3, marker="o", markersize=3)
        if not plan.entry_axes.targets:
            axes.set_title(f"grip {grip:g} N", fontsize=LABEL_PT)
        percent_axis(axes)
    names = plan.entry_axes.targets or [f"{v:g} m/s" for v in speeds]
    handles = [
        Line2D([], [], color=c, marker="o", markersize=3, label=name) for c, name in zip(shade, names, strict=True)
    ]
    handles.append(Line2D([], [], color="0.4", linewidth=0.8, linestyle=":", label="floor"))
    legend_above(figure, handles)
    return figure


def heat_map(
    axes: Axes, down: Axis, across: Axis, percent: FloatArray, norm: LogNorm, *, written: bool = True
) -> Any:
    """One map of percentages (down, across); NaN is grey."""
    axes.set_facecolor("0.85")
    mesh = axes.pcolormesh(percent, norm=norm, cmap="viridis_r", edgecolors="white", linewidth=0.4)
    for axis, set_ticks in ((across, axes.set_xticks), (down, axes.set_yticks)):
        step = max(1, math.ceil(len(axis.labels) / 8))
        shown = range(0, len(axis.labels), step)
        texts = [f"{float(f'{axis.values[j]:.3g}'):g}" if axis.numeric else axis.labels[j] for j in shown]
        turned: dict[str, Any] = {"rotation": 30, "ha": "right"} if axis is across and not axis.numeric else {}
        set_ticks([j + 0.5 for j in shown], texts, fontsize=SMALL_PT, **turned)
    if written and percent.size <= MOST_WRITTEN:
        dark = np.sqrt(float(norm.vmin or 1) * float(norm.vmax or 1))
        for (j, k), value in np.ndenumerate(percent):
            if np.isfinite(value):
                text = f"{value:.0f}" if value >= 9.95 else f"{value:.1f}"
                axes.text(
                    k + 0.5, j + 0.5, text, ha="center", va="center", fontsize=6.5, color="w" if value > dark else "k"
                )
            else:
                axes.text(k + 0.5, j + 0.5, "x", ha="center", va="center", fontsize=6.5, color="0.5")
    return mesh


def percent_norm(percent: FloatArray) -> LogNorm:
    """Logarithmic colour scale over the finite percentages."""
    there = percent[np.isfinite(percent)]
    if not there.size:
        return LogNorm(LEAST_PERCENT, 100.0)
    low, high = max(float(there.min()), LEAST_PERCENT), float(there.max())
    return LogNorm(low, max(high, 1.05 * low))


def maps(plan: Plan, rows: Sequence[Row]) -> Figure:
    """Tap error over two keys: one heat map per entry, or one of the worst entry if there are many."""
    down, across = plan.axes
    error = 100 * entry_grid(plan, rows, "tap_error")
    speeds, grips = plan.speeds_m_s, plan.grips_N
    if plan.entries_per_point > MOST_PANELS:
        # NaN propagates, so a point with a refused entry counts as refused.
        error = error.max(axis=(2, 3), keepdims=True)
        titles = [["worst entry"]]
    else:
        titles = [[plan.entry_axes.place(iv, ig) for ig in range(len(grips))] for iv in range(len(speeds))]
    nv, ng = error.shape[2:]
    figure = Figure(
        figsize=(1.8 + max(2.6, 0.3 * len(across.values)) * ng, 0.9 + max(2.0, 0.2 * len(down.values)) * nv),
        layout="constrained",
    )
    panels = figure.subplots(nv, ng, sharex=True, sharey=True, squeeze=False)
    norm = percent_norm(error)
    for iv in range(nv):
        for ig in range(ng):
            mesh = heat_map(panels[iv, ig], down, across, error[:, :, iv, ig], norm)
            panels[iv, ig].set_title(titles[iv][ig], fontsize=LABEL_PT)
    figure.supxlabel(axis_label(across.key), fontsize=LABEL_PT)
    figure.supylabel(axis_label(down.key), fontsize=LABEL_PT)
    bar = figure.colorbar(mesh, ax=panels, shrink=0.9)
    bar.set_label("tap error [%], grey: not certified", fontsize=LABEL_PT)
    percent_axis(bar.ax)
    bar.ax.tick_params(labelsize=SMALL_PT)
    return figure


def small_multiples(plan: Plan, rows: Sequence[Row]) -> Figure:
    """Tap error of every entry over each key, whatever the other keys are; one colour per speed."""
    targets = plan.entry_axes.targets
    names = targets or tuple(f"{v:g}" for v in plan.speeds_m_s)
    shade = dict(zip(names, colours(len(names)), strict=True))
    there = [row for row in rows if is_admitted(row)]
    figure, panels = panels_of(len(plan.axes), 3, 2.7, 0.8, share_x=False)
    size = 4.0 if len(there) < 300 else 2.0
    for axes, axis in zip(panels.flat, plan.axes, strict=False):
        style(axes)
        places = dict(zip(axis.labels, _prepared(axes, axis), strict=True))
        for name in names:
            own = [row for row in there if entry_cells(row)[0] == name]
            x = [places[row[axis.key]] if row[axis.key] in places else float(row[axis.key]) for row in own]
            y = [100 * number(row, "tap_error") for row in own]
            axes.plot(
                x, y, linestyle="", marker="o", markersize=size, color=shade[name], alpha=0.6, markeredgewidth=0
            )
        percent_axis(axes)
    handles = [
        Line2D([], [], linestyle="", marker="o", markersize=4, color=c, label=v if targets else f"{v} m/s")
        for v, c in shade.items()
    ]
    legend_above(figure, handles)
    return figure


def study_figure(plan: Plan, rows: Sequence[Row]) -> Figure:
    """The kind of figure that suits the number of keys."""
    if plan.sample is None and len(plan.axes) == 1:
        return curves(plan, rows)
    if plan.sample is None and len(plan.axes) == 2:
        return maps(plan, rows)
    return small_multiples(plan, rows)


def question_figure(found: Answer, label_of_key: str) -> Figure:
    """The first requirement's measure of every entry over the values tried, with bound and answer."""
    requirement = found.question.requirements[0]
    figure = Figure(figsize=(5.6, 3.8), layout="constrained")
    axes = figure.subplots()
    style(axes)
    entries = list(dict.fromkeys((row["target"] or row["speed_m_s"], row["grip_N"]) for row in found.tried[0].rows))
    x = [tried.value for tried in found.tried]
    shade, dashes = ({text: j for j, text in enumerate(dict.fromkeys(each))} for each in zip(*entries, strict=True))
    by_speed = colours(len(shade))
    for entry in entries:
        own = [
            next(row for row in tried.rows if (row["target"] or row["speed_m_s"], row["grip_N"]) == entry)
            for tried in found.tried
        ]
        y = [requirement.scale * number(row, requirement.measure) if is_admitted(row) else np.nan for row in own]
        name = entry_name(own[0])
        colour, dash = by_speed[shade[entry[0]]], DASHES[dashes[entry[1]] % len(DASHES)]
        axes.plot(x, y, color=colour, linestyle=dash, linewidth=1.0, marker="o", markersize=2.5, label=name)
    # Drawn from first to last value, so that the axes have ends where no answer is certified.
    axes.plot([min(x), max(x)], 2 * [requirement.scale * requirement.bound], color=DARK, linewidth=0.9, linestyle=":")
    if found.met is not None:
        axes.axvline(found.met.value, color=SEED, linewidth=1.0, linestyle="--")
    if found.question.log:
        percent_axis(axes, x=True)
    if requirement.unit == "%":
        percent_axis(axes)
    axes.set_xlabel(label_of_key, fontsize=LABEL_PT)
    scale = ", log scale" if requirement.unit == "%" else ""
    axes.set_ylabel(f"{axis_label(requirement.measure, requirement.unit)}{scale}", fontsize=LABEL_PT)
    answered = "" if found.met is None else ", answer (dashed)"
    axes.set_title(f"{requirement.in_words} (dotted){answered}", fontsize=LABEL_PT)
    if len(entries) <= MOST_PANELS:
        axes.legend(fontsize=6.5, frameon=False, ncols=2)
    return figure
