"""What a refinement did, in words and numbers."""

from pathlib import Path

import numpy as np
from rich.table import Table

from controller.refine.rounds import Node, NodeRound, Refined, Round, nodes_of
from transopt.library.library import Library

LEGEND = (
    "Measured by the device's own sensors, mean of a round's taps, low-passed at 1 kHz, until the hand can react at "
    "30 ms; * kept.\nL gain, Q its low-pass; factor: what a round leaves of the error at most, in brackets with two "
    "standard deviations of T; below 1 it converges.\n! limits bind there: it gets no better than the optimum under "
    "them."
)


def best_round(rounds: list[Round], node: Node) -> int | None:
    """Number of the round whose design a node keeps."""
    tapped = [number for number, results in enumerate(rounds) if node in results and results[node].better]
    return tapped[-1] if tapped else None


def mean_nrmse(results: Round) -> float:
    """Over the nodes that were tapped at."""
    each = [node.nrmse for node in results.values()]
    return float(np.mean(each)) if each else float("nan")


def round_line(number: int, results: Round) -> str:
    if not results:
        return f"round {number}: no node was tapped at twice"
    worst = max(node.nrmse for node in results.values())
    peak = max(node.peak_current_A for node in results.values())
    better = "" if number == 0 else f", better at {sum(node.better for node in results.values())}"
    return (
        f"round {number}: NRMSE {100 * mean_nrmse(results):.2f} % on average over {len(results)} nodes, worst "
        f"{100 * worst:.2f} %{better}; at most {peak:.3f} A"
    )


def _condition_cells(node: NodeRound | None) -> tuple[str, str, str]:
    known = None if node is None else node.condition
    if known is None:
        return "-", "-", "-"
    return f"{known.gain:g}", f"{known.cutoff_Hz:.0f}", f"{known.factor:.2f} ({known.sure_factor:.2f})"


def refine_table(before: Library, refined: Refined, title: str) -> Table:
    """Every node, round by round."""
    rounds = refined.rounds
    table = Table(title=title)
    for name in ("speed m/s", "grip N", "model's optimum", *(f"round {number}" for number in range(len(rounds)))):
        table.add_column(name, justify="right", no_wrap=True)
    for name in ("L", "Q Hz", "factor"):
        table.add_column(name, justify="right", no_wrap=True)
    for node in nodes_of(before):
        kept = best_round(rounds, node)
        cells = []
        for number, results in enumerate(rounds):
            mark = "*" if number == kept else " "
            cells.append(f"{100 * results[node].nrmse:.2f}{mark}" if node in results else "- ")
        last = next((results[node] for results in reversed(rounds) if node in results), None)
        bound = "!" if last is not None and last.limited else " "
        iv, ig = node
        table.add_row(
            f"{before.speeds_m_s[iv]:g}",
            f"{before.grips_N[ig]:g}",
            f"{100 * before.nrmse[node]:.2f}{bound}",
            *cells,
            *_condition_cells(last),
        )
    table.add_section()
    table.add_row("mean", "", "", *(f"{100 * mean_nrmse(results):.2f} " for results in rounds))
    return table


def summary(before: Library, refined: Refined, written: Path) -> tuple[str, bool]:
    """One line, and whether it is good news; `written` is the refined library's file."""
    limit = float(before.meta["limits"]["current_A"])
    peaks = [node.peak_current_A for results in refined.rounds for node in results.values()]
    if not refined.better:
        return "no node became better: the library stays as it is, and nothing was written", False
    first = [results.nrmse for results in refined.rounds[0].values()]
    kept = [best_round(refined.rounds, node) for node in refined.rounds[0]]
    last = [
        refined.rounds[number][node].nrmse
        for node, number in zip(refined.rounds[0], kept, strict=True)
        if number is not None
    ]
    held = f"at most {max(peaks):.3f} A of {limit:g} A"
    return (
        f"{len(refined.better)} of {len(nodes_of(before))} nodes refined: NRMSE {100 * np.mean(first):.2f} % to "
        f"{100 * np.mean(last):.2f} % on average; {held}; check it: transopt verify {written}",
        True,
    )
