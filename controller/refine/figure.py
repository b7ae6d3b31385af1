"""Figure of a refinement: error by round, ratio of device to model, and one tap before and after."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from controller.record.played import CUTOFF_HZ
from controller.refine.heard import Node, smooth
from controller.refine.learning import SIGMAS
from controller.refine.rounds import Refined
from controller.refine.tables import place
from transopt.base.plotting import CLIPPED, DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT, style
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.plant.intention import INTENTION_S

COLOURS = (OPTIMUM, CLIPPED, SEED)


def _axes(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(x, fontsize=LABEL_PT)
    axes.set_ylabel(y, fontsize=LABEL_PT)
    style(axes)


def refine_figure(refined: Refined) -> Figure:
    """Three panels, left to right."""
    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    errors, ratios, tap = figure.subplots(1, 3, width_ratios=[1, 1.1, 1.3])
    _errors(errors, refined)
    _ratios(ratios, refined)
    _tap(tap, refined)
    return figure


def _errors(axes: Axes, refined: Refined) -> None:
    """Draw the errors of every node by round, and those of the confirming round for the designs that are kept."""
    played, kept = refined.history.played, refined.better
    limited = {node: one.limited for results in played for node, one in results.items()}
    styles = {True: "--", False: "-"}
    labels = {True: "a node, limits bind", False: "a node"}
    for node, is_limited in limited.items():
        course = [
            (number, 100 * r[node].playback_error) for number, r in enumerate(refined.history.rounds) if node in r
        ]
        label = labels.pop(is_limited, None)
        axes.plot(*zip(*course, strict=True), color="0.65", linestyle=styles[is_limited], marker=".", label=label)
    if refined.history.confirmed:
        last = [100 * refined.history.confirmed[node].playback_error for node in kept]
        axes.plot([len(played) - 1] * len(kept), last, "o", color=OPTIMUM, label="confirmed")
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(low, 2.5 * high)  # room for the legend
    rounds = [f"{number}" for number in range(len(refined.history.rounds))]
    axes.set_xticks(range(len(played)), [*rounds, *["new taps"] * (len(played) - len(rounds))])
    ticks = [value for value in (0.5, 1, 2, 5, 10, 20, 50, 100) if axes.get_ylim()[0] <= value <= axes.get_ylim()[1]]
    axes.set_yticks(ticks, [f"{value:g}" for value in ticks])
    axes.minorticks_off()
    _axes(axes, "round", "playback error [%], log scale")
    axes.legend(fontsize=SMALL_PT, framealpha=0.9)


def _ratios(axes: Axes, refined: Refined) -> None:
    for ig, colour in zip(sorted(refined.ratios), COLOURS * len(refined.ratios), strict=False):
        found = refined.ratios[ig]
        off = np.abs(1 - found.value)
        more = SIGMAS * found.deviation
        f = found.frequencies_Hz
        axes.fill_between(f, np.maximum(off - more, 0), off + more, color=colour, alpha=0.2, linewidth=0)
        axes.plot(f, off, color=colour, linewidth=1.3, label=f"{refined.before.grips_N[ig]:g} N")
    cutoffs = [n.condition.cutoff_Hz for r in refined.history.rounds for n in r.values() if n.condition is not None]
    if cutoffs:
        axes.axvspan(min(cutoffs), CUTOFF_HZ, color="0.93", zorder=0)
        axes.text(
            0.98 * CUTOFF_HZ,
            0.97,
            "no correction: low-pass Q ends",
            fontsize=SMALL_PT,
            color="0.4",
            va="top",
            ha="right",
        )
    axes.axhline(1.0, color=DARK, linewidth=0.8, linestyle=":")
    axes.set_xscale("log")
    axes.set_xlim(float(next(iter(refined.ratios.values())).frequencies_Hz[0]), CUTOFF_HZ)
    axes.set_xticks([20, 50, 100, 200, 500, 1000], ["20", "50", "100", "200", "500", "1000"])
    axes.set_ylim(0, 1.1)
    axes.minorticks_off()
    _axes(axes, "frequency [Hz]", "device off the model, |1 - T|; below 1: converges")
    axes.legend(fontsize=SMALL_PT, framealpha=0.9, loc="upper left")


def _tap(axes: Axes, refined: Refined) -> None:
    """Draw the tap of the node with the largest gain, before and after."""
    before, window, history = refined.before, refined.window, refined.history
    first, last = history.rounds[0], history.confirmed or {}

    def gained(node: Node) -> float:
        return first[node].playback_error - last[node].playback_error if node in refined.better else 0.0

    node, g = max(first, key=gained), STANDARD_GRAVITY_M_S2
    times = before.time_grid().switching_times_s
    shown = times <= INTENTION_S
    ms = 1e3 * times[shown]
    wanted = smooth(refined.designed.acceleration_m_s2[node], window.dt_s)
    axes.plot(ms, wanted[shown] / g, color="0.6", linewidth=3.0, label="designed")
    taps = [(first[node], "before", SEED, "-")]
    taps += [(last[node], "confirmed", OPTIMUM, "--")] if node in refined.better else []
    for one, name, colour, dash in taps:
        measured = wanted + window.values(one.tapped.error)
        label = f"{name}, {100 * one.playback_error:.1f} %"
        axes.plot(ms, measured[shown] / g, color=colour, linestyle=dash, linewidth=1.2, label=label)
    axes.set_title(place(before, node), fontsize=LABEL_PT)
    _axes(axes, "time from contact [ms]", "acceleration [g]")
    axes.legend(fontsize=SMALL_PT, framealpha=0.9)
