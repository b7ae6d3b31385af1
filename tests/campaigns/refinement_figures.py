"""What a refinement truly came to at every node, in tables, and what was asked of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

RIGHT = ("right", "right_held", "varying")
WORSE = 2e-4  # of playback error: by which no node may truly become worse where the model is right
WITH_FRICTION = 1.4e-2  # playback error of the worst node that no limit binds


@dataclass(frozen=True)
class NodeErrors:
    """True playback error of one node, without noise.

    Attributes
    ----------
    limited : limits bind with the model's own optimum.
    before, after : until a hand can react. whole_before, whole_after : of the rapid part over the library's window.
    known : of the command nearest to the design for who knows the true device, until a hand can react; NaN where
        there is none.
    refined : what is kept is another design than before.
    why : the learning ended there.
    """

    speed_m_s: float
    grip_N: float
    limited: bool
    before: float
    after: float
    whole_before: float
    whole_after: float
    known: float
    refined: bool
    why: str

    @property
    def worse(self) -> float:
        """Give by how much the error rose at most, by either measure."""
        return max(self.after - self.before, self.whole_after - self.whole_before)


@dataclass(frozen=True)
class Outcome:
    """One refinement. rounds : of taps, the confirming one included."""

    case: str
    seed: int
    rounds: int
    nodes: list[NodeErrors]


HEAD = ["case", "seed", "rounds", "refined", "mean %", "worst free %", "worst limited %", "worse by at most, points"]


def rows(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """One line for each refinement; errors before and after, until a hand can react."""

    def pair(nodes: Sequence[NodeErrors], worst: bool) -> str:
        if not nodes:
            return "-"
        pick = max if worst else np.mean
        return " → ".join(f"{100 * float(pick([getattr(n, a) for n in nodes])):.2f}" for a in ("before", "after"))

    found = []
    for one in outcomes:
        free = [node for node in one.nodes if not node.limited]
        found.append(
            [
                one.case,
                str(one.seed),
                str(one.rounds),
                f"{sum(node.refined for node in one.nodes)} of {len(one.nodes)}",
                pair(one.nodes, worst=False),
                pair(free, worst=True),
                pair([node for node in one.nodes if node.limited], worst=True),
                f"{100 * max(0.0, *(node.worse for node in one.nodes)):.3f}",
            ]
        )
    return found


def node_rows(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """One line for each node, over all seeds of a case; before and after, until a hand can react and of the whole.

    A case of which nothing was refined has none.
    """
    found = []
    for case in dict.fromkeys(one.case for one in outcomes if any(node.refined for node in one.nodes)):
        for nodes in zip(*(one.nodes for one in outcomes if one.case == case), strict=True):
            early, whole = (
                " → ".join(
                    f"{100 * float(np.mean([getattr(n, a) for n in nodes])):.2f}" for a in (f"{w}before", f"{w}after")
                )
                for w in ("", "whole_")
            )
            place = f"{nodes[0].speed_m_s:g} m/s, {nodes[0].grip_N:g} N{', limited' if nodes[0].limited else ''}"
            known = float(np.mean([n.known for n in nodes]))
            knows = "-" if np.isnan(known) else f"{100 * known:.2f}"
            worse = f"{100 * max(0.0, *(n.worse for n in nodes)):.3f}" if any(n.refined for n in nodes) else "-"
            found.append(
                [case, place, f"{sum(n.refined for n in nodes)} of {len(nodes)}", early, whole, knows, worse]
            )
    return found


NODE_HEAD = [
    "case",
    "node",
    "refined",
    "mean until 30 ms %",
    "rapid part of the whole %",
    "who knows the device %",
    "worse by at most, points",
]


def figures(outcomes: Sequence[Outcome]) -> list[tuple[str, str, str, bool]]:
    """What was asked, what was reached, and whether it is as asked."""
    found = []
    right = [node for one in outcomes if one.case in RIGHT for node in one.nodes]
    if right:
        worse = max(0.0, *(node.worse for node in right))
        what = f"model right, {len(right)} nodes: truly worse by at most"
        found.append((what, f"{100 * WORSE:g} points", f"{100 * worse:.3f} points", worse <= WORSE))
    free = [node.after for one in outcomes if one.case == "friction" for node in one.nodes if not node.limited]
    if free:
        what = "friction 0.05 N: worst node that no limit binds"
        found.append((what, f"{100 * WITH_FRICTION:g} %", f"{100 * max(free):.2f} %", max(free) <= WITH_FRICTION))
    return found
