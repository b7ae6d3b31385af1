"""Rounds of taps on the device, each of them with the library that was learnt from those before."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from controller.refine.heard import Heard, Node
from controller.refine.kept import in_meta
from controller.refine.learner import History, Learner, Resolve, Round
from controller.refine.learning import Ratio
from controller.refine.significance import Scatter, Window
from transopt.library.library import Library

Play = Callable[[Library, int, Sequence[Node]], Mapping[Node, Sequence[Heard]]]


@dataclass(frozen=True)
class Refined:
    """What came of it.

    Attributes
    ----------
    before, library : as it was, and with the design of every node that is kept.
    history : rounds, courses, and what was confirmed.
    ratios : T of each grip that was tapped at, by index, from all taps.
    window : in whose cosines the history stands. scatter : of all taps.
    designed : as solved for the model, without any correction: what the device shall do.
    """

    before: Library
    library: Library
    history: History
    ratios: dict[int, Ratio]
    window: Window
    scatter: Scatter
    designed: Library

    @classmethod
    def of(cls, before: Library, learner: Learner) -> "Refined":
        history, ratios, window = learner.history, learner.ratios, learner.window
        return cls(before, learner.library, history, ratios, window, learner.scatter, learner.designed)

    @property
    def better(self) -> list[Node]:
        """Nodes whose gain was confirmed by new taps."""
        return sorted(node for node, course in self.history.courses.items() if course.best > 0)


def refine(
    library: Library,
    play: Play,
    resolve: Resolve,
    rounds: int,
    stated: dict[str, Any],
    *,
    tell: Callable[[Learner, Round], None] = lambda learner, results: None,
) -> Refined:
    """Play, learn, solve again, until nothing significant is left; and confirm with new taps what is kept.

    Parameters
    ----------
    play : taps with a library in a round at some nodes, at least two at a node that is to be learnt from.
    resolve : `transopt.design.resolve.resolve`.
    rounds : of corrections, at most.
    stated : what `meta["refinement"]` says of device and measurement, beside the history.
    tell : called with the learner and each round as soon as it was learnt from.
    """
    learner = Learner(library, resolve, rounds, lambda learner: in_meta(learner, stated))
    while not learner.over:
        tell(learner, learner.learn(play(learner.library, learner.number, learner.asked)))
    return Refined.of(library, learner)
