"""What recording, identifying, solving and refining come to: stages, their table and figure, what falls short."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from controller.refine.heard import nodes_of
from transopt.base.plotting import CLIPPED, DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT
from transopt.base.writing import table as markdown_table
from transopt.library.library import Library

OVER_A = 1e-6
NEAR, SLOW_M_S = 5e-4, 0.3  # by how much identified commands may be worse than the known truth's; up to which speed
IDENTIFIED, TRUTH = "identified, without the servo", "known truth, without the servo"
ROUND = "refined, round"


@dataclass(frozen=True)
class Stage:
    """One library on the true device; lists in the order of the nodes.

    Attributes
    ----------
    tap_error : against the recorded tap, mean over the taps at each node; NaN where only sensors have measured.
    playback_error : likewise, over the intention, against the tap as it was designed for the model.
    peak_current_A : over all t and taps.
    """

    name: str
    tap_error: list[float]
    playback_error: list[float]
    peak_current_A: float

    @property
    def mean(self) -> float:
        return float(np.mean(self.tap_error))

    @property
    def worst(self) -> float:
        return max(self.tap_error)

    @property
    def playback(self) -> float:
        """Mean of the playback errors."""
        return float(np.mean(self.playback_error))


def table(mismatch: float, stages: Sequence[Stage], library: Library) -> tuple[list[str], list[list[str]]]:
    """Head and rows: mean and worst tap error, mean playback error, and the tap error of every node, in %."""
    speeds = [f"{v:g} m/s" for v in library.speeds_m_s]
    head = [f"mismatch {mismatch:g}, %", "mean", f"to {SLOW_M_S:g} m/s", "worst", "playback", "peak A", *speeds]
    slow, found = library.speeds_m_s <= SLOW_M_S + 1e-9, []
    for stage in stages:
        errors = 100 * np.array(stage.tap_error).reshape(-1, library.grips_N.size)
        nodes = (" ".join(f"{value:.1f}" for value in row) for row in errors)
        numbers = f"{errors.mean():.2f}", f"{errors[slow].mean():.3f}", f"{errors.max():.2f}"
        numbers = *numbers, f"{100 * stage.playback:.2f}"
        found.append([stage.name, *numbers, f"{stage.peak_current_A:.3f}", *nodes])
    return head, found


def in_markdown(results: dict[float, list[Stage]]) -> list[str]:
    """Mean and worst tap error and mean playback error of every library in %, and its largest current in A.

    A column for each mismatch.
    """
    head = ["library", *(f"mismatch {mismatch:g}: mean (worst), playback, at most" for mismatch in results)]
    rows = [
        [
            stages[0].name,
            *(f"{_mean_and_worst(s)}, {100 * s.playback:.2f}, {s.peak_current_A:.3f} A" for s in stages),
        ]
        for stages in zip(*results.values(), strict=True)
    ]
    return markdown_table(head, rows)


def _mean_and_worst(stage: Stage) -> str:
    """Tap error in %; a dash where only sensors have measured, which know no recorded tap."""
    return "-" if np.isnan(stage.mean) else f"{100 * stage.mean:.2f} ({100 * stage.worst:.1f})"


def figure(results: dict[float, list[Stage]]) -> Figure:
    """Mean and worst tap error by stage, one line per mismatch, the known truth as a level."""
    drawn = Figure(figsize=(8.0, 3.6), layout="constrained")
    panels = drawn.subplots(1, 2)
    for axes, which in zip(panels, ("mean", "worst"), strict=True):
        for (mismatch, stages), colour in zip(results.items(), (OPTIMUM, SEED, CLIPPED, DARK) * 9, strict=False):
            truth = 100 * getattr(stages[-1], which)
            shown = [stage for stage in stages if stage.name not in (IDENTIFIED, TRUTH) and np.isfinite(stage.mean)]
            steps = [100 * getattr(stage, which) for stage in shown]
            axes.plot(
                range(len(steps)), steps, color=colour, marker="o", linewidth=1.6, label=f"mismatch {mismatch:g}"
            )
            axes.axhline(truth, color=colour, linestyle=":", linewidth=1.0)
        names = [stage.name.replace(" model", "").replace("refined, ", "refined\n") for stage in shown]
        axes.set_xticks(range(len(names)), names, fontsize=SMALL_PT)
        axes.set_ylim(0, 1.08 * axes.get_ylim()[1])
        axes.set_ylabel(f"{which} tap error over all nodes, %", fontsize=LABEL_PT)
        axes.tick_params(labelsize=SMALL_PT)
        axes.grid(color="0.9", linewidth=0.6)
        axes.set_axisbelow(True)
    panels[0].legend(fontsize=SMALL_PT, title="dotted: known truth", title_fontsize=SMALL_PT)
    return drawn


def shortfalls(mismatch: float, stages: Sequence[Stage], library: Library, unstated_pole: bool) -> list[str]:
    """What is not as asked."""
    limit_A = library.input_limit
    found, truth = [], stages[-1]
    slow = [bool(library.speeds_m_s[iv] <= SLOW_M_S + 1e-9) for iv, _ in nodes_of(library)]
    named = {stage.name: stage for stage in stages}
    nominal, model = named["nominal model"], named.get("identified model")
    at = f"mismatch {mismatch:g}"
    found += [
        f"{at}: {stage.name}: {stage.peak_current_A:.4f} A, limit {limit_A:g} A"
        for stage in stages
        # What a sensor measures has its noise on it; a limit is kept by the servo.
        if not stage.name.startswith(ROUND) and stage.name != IDENTIFIED and stage.peak_current_A > limit_A + OVER_A
    ]
    if model is not None and model.mean > nominal.mean:
        found.append(f"{at}: identified {model.mean:.2%}, worse than nominal {nominal.mean:.2%}")
    if model is not None and not unstated_pole:
        own, known = (float(np.mean(np.array(stage.tap_error)[slow])) for stage in (named[IDENTIFIED], truth))
        if own - known > NEAR:
            found.append(f"{at}: up to {SLOW_M_S:g} m/s identified {own:.3%}, known truth {known:.3%}")
    before = nominal if model is None else model
    last = named["refined, kept"]
    # A refinement leads towards the design, whatever the design leaves of the tap.
    if last is not before and last.playback > before.playback:
        found.append(f"{at}: {last.name} {last.playback:.2%} of playback, {before.name} {before.playback:.2%}")
    return found
