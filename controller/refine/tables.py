"""Lines and tables that report a refinement."""

from collections import Counter
from pathlib import Path
from shlex import quote

import numpy as np

from controller.refine.heard import Node, nodes_of
from controller.refine.learner import ENDED, NO_GAIN, NOTHING_LEFT, Learner, NodeRound, Round
from controller.refine.rounds import Refined
from transopt.base.tables import Table
from transopt.library.library import Library

LEGEND = (
    "Playback error: the mean tap beside the designed one, by the device's own sensors, low-passed at 1 kHz, until "
    "the hand can react at 30 ms, less what the taps' scatter adds.\n"
    "Before: the library as it was. Confirmed: what was kept, by new taps that nothing was chosen from.\n"
    "L gain, Q its low-pass; T: device over model, as a response over frequency; factor: what a round leaves of the "
    "error at most, in brackets with T off by two standard deviations; below 1 it converges.\n"
    "! limits bind there: it gets no better than the optimum under them."
)
LEFT = "nothing significant is left to be learnt"


def place(library: Library, node: Node) -> str:
    """A node in words, like `0.1 m/s at 3 N`."""
    return f"{library.speeds_m_s[node[0]]:g} m/s at {library.grips_N[node[1]]:g} N"


def mean_error(results: Round) -> float:
    """Mean playback error over the tapped nodes; NaN if there is none."""
    each = [node.playback_error for node in results.values()]
    return float(np.mean(each)) if each else float("nan")


def _nodes(count: int) -> str:
    return f"{count} node{'' if count == 1 else 's'}"


def round_line(number: int, learner: Learner, results: Round) -> str:
    """One line with the results of a round."""
    confirming = learner.history.confirmed is not None
    name = "confirming round" if confirming else f"round {number}"
    if not results:
        return f"{name}: no node was tapped at twice"
    worst = max(node.playback_error for node in results.values())
    better = sum(node.better for node in results.values())
    said = (
        f", gain confirmed at {better}"
        if confirming
        else ""
        if number == 0
        else f", better beyond chance at {better}"
    )
    peaks = [node.tapped.peak_current_A for node in results.values()]
    at_most = "" if np.isnan(peaks).all() else f"; at most {np.nanmax(peaks):.3f} A"
    return (
        f"{name}: playback error {100 * mean_error(results):.2f} % on average over {_nodes(len(results))}, worst "
        f"{100 * worst:.2f} %{said}{at_most}"
    )


def following_line(learner: Learner) -> str:
    """One line that tells what is played next, or why nothing is."""
    if learner.history.confirmed is not None:
        return ""
    if learner.history.confirming:
        waiting = f"new taps shall confirm {_nodes(len(learner.asked))} with a correction"
        ended = any(course.why == ENDED for course in learner.history.courses.values())
        return f"the rounds are over (--rounds): {waiting}" if ended else f"{LEFT}: {waiting}"
    if learner.over:
        return f"{LEFT}, and no node was changed"
    return f"something stands out of the taps' scatter at {_nodes(len(learner.asked))}: played next with a correction"


def refine_table(refined: Refined, title: str) -> Table:
    """Table of every node: errors of the original library, and errors of the kept design in the confirming round."""
    before, history = refined.before, refined.history
    confirmed = history.confirmed or {}
    numbers = ("speed m/s", "grip N", "model's optimum", "before", "confirmed", "L", "Q Hz", "factor")
    table = Table.of(title, (*numbers, "why it ended"), words=("why it ended",), keys=2)
    for node in nodes_of(before):
        course = history.courses[node]
        first, kept = history.rounds[0].get(node), course.best > 0
        bound = "!" if first is not None and (confirmed.get(node) or first).limited else " "
        table.add_row(
            f"{before.speeds_m_s[node[0]]:g}",
            f"{before.grips_N[node[1]]:g}",
            "-" if first is None else f"{100 * first.tapped.predicted_error:.2f}{bound}",
            *(_percent(refined, one) for one in (first, confirmed.get(node) if kept else None)),
            *_condition_cells(history.rounds[course.best].get(node) if kept else None),
            course.why,
        )
    return table


def _percent(refined: Refined, one: NodeRound | None) -> str:
    return (
        "-" if one is None else f"{100 * one.playback_error:.2f} ± {100 * refined.scatter.deviation(one.tapped):.2f}"
    )


def _condition_cells(node: NodeRound | None) -> tuple[str, str, str]:
    known = None if node is None else node.condition
    if known is None:
        return "-", "-", "-"
    return f"{known.gain:g}", f"{known.cutoff_Hz:.0f}", f"{known.factor:.2f} ({known.sure_factor:.2f})"


def reasons(refined: Refined) -> str:
    """Reasons why the nodes ended, the most frequent first."""
    counted = Counter(course.why for course in refined.history.courses.values())
    return "; ".join(f"{_nodes(count)}: {why}" for why, count in counted.most_common())


def summary(refined: Refined, written: Path) -> tuple[str, bool]:
    """One line on the result, and whether it is a success; `written` is the refined library's file."""
    better, history = refined.better, refined.history
    if not better:
        if all(course.why in (NOTHING_LEFT, NO_GAIN) for course in history.courses.values()):
            said = "nothing significant is to be gained at any node: the library is as good as these taps can tell"
            return f"{said}; unchanged in {written}", True
        return f"no node became better beyond chance: the library is unchanged in {written}", False
    assert history.confirmed is not None
    first, last = (
        np.mean([found[node].playback_error for node in better]) for found in (history.rounds[0], history.confirmed)
    )
    limit = refined.before.input_limit
    peaks = [one.tapped.peak_current_A for results in history.played for one in results.values()]
    held = "" if np.isnan(peaks).all() else f"; at most {np.nanmax(peaks):.3f} A of {limit:g} A"
    checked = quote(str(written))
    return (
        f"{len(better)} of {_nodes(len(nodes_of(refined.before)))} refined, confirmed by new taps: playback error "
        f"{100 * first:.2f} % to {100 * last:.2f} % on average{held}; check it: transopt verify {checked}",
        True,
    )
