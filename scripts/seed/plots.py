"""What the seed's figures share, its Fig. 10, and the figure of all methods."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from controller.sim.played_tap import Played
from seed.comparison import NOMINAL, Condition, Result, Summary
from transopt.base.plotting import CLIPPED, DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT, plain, style
from transopt.base.signals import STANDARD_GRAVITY_M_S2

REFERENCE = "0.65"
BEFORE_MS, AFTER_MS = 2.0, 90.0  # shown of a tap: the waveform and some of what comes after it
JITTER = 0.28  # of the dots around their method's line
MEAN: dict[str, Any] = {"linestyle": "", "marker": "|", "markersize": 22, "markeredgewidth": 2, "color": OPTIMUM}


def logarithmic(axes: Axes, *, y: bool) -> None:
    """Frequencies, and with `y` magnitudes too, on logarithmic axes with plain numbers."""
    axes.set_xscale("log")
    if y:
        axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis) if y else (axes.xaxis,):
        axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        axis.set_minor_formatter(NullFormatter())
        axis.set_major_formatter(FuncFormatter(plain))


# ------------------------------------------------------------------------------------------------ Fig. 10


@dataclass(frozen=True)
class Series:
    """One way of playing all conditions: what was played, and how it is drawn."""

    label: str
    taps: dict[Condition, Played]
    line: dict[str, Any]


def optimum_line() -> dict[str, Any]:
    return {"color": OPTIMUM, "linewidth": 1.2}


def steady_line() -> dict[str, Any]:
    return {"color": SEED, "linewidth": 1.0, "linestyle": "--"}


def blind_line() -> dict[str, Any]:
    return {"color": CLIPPED, "linewidth": 1.0, "linestyle": "-."}


def tap_grid(series: Sequence[Series], limits_A: Sequence[float], *, predicted: bool) -> Figure:
    """Layout of the seed's Fig. 10: a column per grip, per speed a row of accelerations and one of currents.

    All accelerations have one scale, and all currents, so that what grows with the speed is seen to grow.

    Parameters
    ----------
    series : all with the same conditions. limits_A : drawn as dotted lines.
    predicted : whether the library's prediction of the first series is drawn, and its tap error written.
    """
    conditions = list(series[0].taps)
    speeds, grips = (list(dict.fromkeys(c[j] for c in conditions)) for j in (0, 1))
    figure = Figure(figsize=(1.4 + 2.5 * len(grips), 0.9 + 2.55 * len(speeds)), layout="constrained")
    rows = figure.subplots(
        2 * len(speeds), len(grips), sharex=True, sharey="row", squeeze=False, height_ratios=[1.6, 1.0] * len(speeds)
    )
    g = STANDARD_GRAVITY_M_S2
    for condition in conditions:
        iv, ig = speeds.index(condition[0]), grips.index(condition[1])
        above, below = rows[2 * iv, ig], rows[2 * iv + 1, ig]
        first = series[0].taps[condition]
        predicted_ms = first.prediction.times_s * 1e3
        above.plot(predicted_ms, first.prediction.recorded_m_s2 / g, color=REFERENCE, linewidth=3.0)
        if predicted:
            above.plot(predicted_ms, first.prediction.whole_m_s2 / g, color=SEED, linewidth=1.2)
        for one in series:
            played = one.taps[condition]
            line = {**one.line, "linestyle": "--"} if predicted else one.line
            above.plot(played.times_s * 1e3, played.acceleration_m_s2 / g, **line)
            below.plot(played.times_s * 1e3, played.current_A, **one.line)
        if predicted:
            text = f"tap error {100 * first.tap_error:.1f} %"
            above.text(0.97, 0.93, text, transform=above.transAxes, ha="right", va="top", fontsize=SMALL_PT)
        for limit in limits_A:
            for sign in (1, -1):
                below.axhline(sign * limit, color=DARK, linewidth=0.8, linestyle=":")
        for axes in (above, below):
            style(axes)
            axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 4, 5, 10]))
    for ig, grip in enumerate(grips):
        rows[0, ig].set_title(f"grip {grip:g} N", fontsize=LABEL_PT)
        rows[-1, ig].set_xlabel("time after contact [ms]", fontsize=LABEL_PT)
    for iv, speed in enumerate(speeds):
        rows[2 * iv, 0].set_ylabel(f"{speed:g} m/s\nacceleration [g]", fontsize=LABEL_PT)
        rows[2 * iv + 1, 0].set_ylabel("current [A]", fontsize=LABEL_PT)
    rows[0, 0].set_xlim(-BEFORE_MS, AFTER_MS)
    handles = [Line2D([], [], color=REFERENCE, linewidth=3.0, label="recorded tap")]
    if predicted:
        handles.append(Line2D([], [], color=SEED, linewidth=1.2, label="predicted"))
    for one in series:
        line = {**one.line, "linestyle": "--"} if predicted else one.line
        handles.append(Line2D([], [], label=one.label, **line))
    text = " and ".join(f"{limit:g} A" for limit in limits_A)
    handles.append(Line2D([], [], color=DARK, linewidth=0.8, linestyle=":", label=f"limit of {text}"))
    least = min(float(played.current_A.min()) for one in series for played in one.taps.values())
    ends = np.array([axes.get_ylim() for axes in rows[::2, 0]])
    for axes in rows[::2, 0]:
        axes.set_ylim(ends[:, 0].min(), ends[:, 1].max())
    for axes in rows[1::2, 0]:
        axes.set_ylim(least - 0.08 * max(limits_A), 1.15 * max(limits_A))
    columns = 1 if len(grips) == 1 else len(handles)
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, fontsize=SMALL_PT, frameon=False)
    return figure


# ------------------------------------------------------------------------------------------------ methods


PANELS = (("tap_error", "tap error [%]", 100.0), ("felt_error", "felt error [%]", 100.0), ("speed", "speed", 1.0))
MEANS = {"tap_error": "mean", "felt_error": "felt_mean", "speed": "speed_mean"}  # field of a summary


def method_figure(results: Sequence[Result], summaries: Sequence[Summary]) -> Figure:
    """Every tap of every method: tap error, felt error and speed, the nominal device's apart, with the means."""
    figure = Figure(figsize=(11.0, 0.9 + 0.45 * len(summaries)), layout="constrained")
    panels = figure.subplots(1, len(PANELS), sharey=True)
    for axes, (field, words, unit) in zip(panels, PANELS, strict=True):
        style(axes)
        axes.grid(visible=False, axis="y")
        random = np.random.default_rng(0)
        for row, summary in enumerate(summaries):
            taps = [r for r in results if r.method == summary.method]
            for nominal, colour, size in ((False, "0.65", 2.2), (True, SEED, 3.6)):
                values = np.array([unit * getattr(r, field) for r in taps if (r.device == NOMINAL) == nominal])
                places = row + random.uniform(-JITTER, JITTER, values.size)
                axes.plot(values, places, linestyle="", marker="o", markersize=size, color=colour, markeredgewidth=0)
            mean = getattr(summary, MEANS[field])
            if np.isfinite(mean):
                axes.plot(unit * mean, row, **MEAN)
        axes.set_xlabel(words, fontsize=LABEL_PT)
        if unit == 1:
            axes.axvline(1.0, color=DARK, linewidth=0.8, linestyle=":")
            axes.xaxis.set_major_locator(MaxNLocator(5))
        else:
            logarithmic(axes, y=False)
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    panels[0].set_yticks(range(len(summaries)), [summary.method for summary in summaries], fontsize=SMALL_PT)
    panels[0].set_ylim(len(summaries) - 0.5, -0.5)
    dot: dict[str, Any] = {"linestyle": "", "marker": "o"}
    handles = [
        Line2D([], [], color=SEED, markersize=4, label="nominal device", **dot),
        Line2D([], [], color="0.65", markersize=4, label="mismatched devices", **dot),
        Line2D([], [], label="their mean", **{**MEAN, "markersize": 11}),
        Line2D([], [], color=DARK, linewidth=0.8, linestyle=":", label="as hard as the recorded surface"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, fontsize=SMALL_PT, frameon=False)
    return figure
