"""Figure of a refinement: error by round, what the device makes of the model, one tap before and after."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from controller.record.played import CUTOFF_HZ
from controller.refine.learning import SIGMAS
from controller.refine.rounds import Refined, smooth
from controller.refine.tables import best_round, mean_nrmse
from controller.waveforms.prediction import REACTION_S
from transopt.base.plotting import CLIPPED, DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.library.library import Library

COLOURS = (OPTIMUM, CLIPPED, SEED)


def _axes(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(x, fontsize=LABEL_PT)
    axes.set_ylabel(y, fontsize=LABEL_PT)
    axes.tick_params(labelsize=SMALL_PT)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def refine_figure(before: Library, refined: Refined) -> Figure:
    """Three panels, left to right."""
    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    errors, ratios, tap = figure.subplots(1, 3, width_ratios=[1, 1.1, 1.3])
    _errors(errors, refined)
    _ratios(ratios, before, refined)
    _tap(tap, before, refined)
    return figure


def _errors(axes: Axes, refined: Refined) -> None:
    numbers = range(len(refined.rounds))
    nodes = sorted({node for results in refined.rounds for node in results})
    free = bound = True
    for node in nodes:
        course = [100 * r[node].nrmse if node in r else np.nan for r in refined.rounds]
        limited = refined.rounds[-1][node].limited if node in refined.rounds[-1] else False
        label = ("a node, limits bind" if bound else None) if limited else ("a node" if free else None)
        free, bound = free and limited, bound and not limited
        style = "--" if limited else "-"
        axes.plot(numbers, course, color="0.65", linestyle=style, linewidth=0.9, marker=".", label=label)
    mean = [100 * mean_nrmse(results) for results in refined.rounds]
    axes.plot(numbers, mean, color=OPTIMUM, linewidth=2.0, marker="o", label="mean")
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(low, 2.5 * high)  # room for the legend
    axes.set_xticks(list(numbers))
    ticks = [value for value in (0.5, 1, 2, 5, 10, 20, 50, 100) if axes.get_ylim()[0] <= value <= axes.get_ylim()[1]]
    axes.set_yticks(ticks, [f"{value:g}" for value in ticks])
    axes.minorticks_off()
    _axes(axes, "round", "measured NRMSE %")
    axes.legend(fontsize=SMALL_PT, framealpha=0.9)


def _ratios(axes: Axes, before: Library, refined: Refined) -> None:
    for ig, colour in zip(sorted(refined.ratios), COLOURS * len(refined.ratios), strict=False):
        found = refined.ratios[ig]
        off = np.abs(1 - found.value)
        more = SIGMAS * found.deviation
        f = found.frequencies_Hz
        axes.fill_between(f, np.maximum(off - more, 0), off + more, color=colour, alpha=0.2, linewidth=0)
        axes.plot(f, off, color=colour, linewidth=1.3, label=f"{before.grips_N[ig]:g} N")
    cutoffs = [n.condition.cutoff_Hz for r in refined.rounds for n in r.values() if n.condition is not None]
    if cutoffs:
        axes.axvspan(min(cutoffs), CUTOFF_HZ, color="0.93", zorder=0)
        axes.text(0.98 * CUTOFF_HZ, 0.97, "Q ends", fontsize=SMALL_PT, color="0.4", va="top", ha="right")
    axes.axhline(1.0, color=DARK, linewidth=0.8, linestyle=":")
    axes.set_xscale("log")
    axes.set_xlim(float(next(iter(refined.ratios.values())).frequencies_Hz[0]), CUTOFF_HZ)
    axes.set_xticks([20, 50, 100, 200, 500, 1000], ["20", "50", "100", "200", "500", "1000"])
    axes.set_ylim(0, 1.1)
    axes.minorticks_off()
    _axes(axes, "frequency Hz", "|1 - T|, below 1 the rounds converge")
    axes.legend(fontsize=SMALL_PT, framealpha=0.9, loc="upper left")


def _tap(axes: Axes, before: Library, refined: Refined) -> None:
    """The node that gained most."""
    rounds = refined.rounds

    def gained(node: tuple[int, int]) -> float:
        kept = best_round(rounds, node)
        return 0.0 if kept is None else rounds[0][node].nrmse - rounds[kept][node].nrmse

    node = max(rounds[0], key=gained)
    kept = best_round(rounds, node) or 0
    grid, g = before.time_grid(), STANDARD_GRAVITY_M_S2
    times = grid.switching_times_s
    shown = times <= REACTION_S
    ms = 1e3 * times[shown]
    wanted = smooth(before.reference_m_s2[node[0]], grid.dt_s)[shown]
    axes.plot(ms, wanted / g, color="0.6", linewidth=3.0, label="reference")
    first, last = rounds[0][node], rounds[kept][node]
    for results, number, colour, style in ((first, 0, SEED, "-"), (last, kept, OPTIMUM, "--")):
        label = f"round {number}, {100 * results.nrmse:.1f} %"
        axes.plot(ms, results.measured_m_s2[shown] / g, color=colour, linestyle=style, linewidth=1.2, label=label)
    speed, grip = before.speeds_m_s[node[0]], before.grips_N[node[1]]
    axes.set_title(f"{speed:g} m/s, {grip:g} N", fontsize=LABEL_PT)
    _axes(axes, "time from contact ms", "acceleration g")
    axes.legend(fontsize=SMALL_PT, framealpha=0.9)
