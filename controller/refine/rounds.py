"""Rounds of taps on the device, each with the library that was learnt from the previous rounds."""

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
    """The result of a refinement.

    Attributes
    ----------
    before, library : the original library, and the refined one with the kept design of every node.
    history : rounds, courses, and the confirming round.
    ratios : index of a tapped grip -> T from all taps.
    window : window whose cosine coefficients the history holds. scatter : scatter of all taps.
    designed : the library solved for the model without any correction, the reference of the device.
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
    """Play, learn and solve again until no significant difference is left; then confirm what is kept with new taps.

    Parameters
    ----------
    play : function that plays a library in a round at some nodes; a node needs at least two taps to be learnt from.
    resolve : `transopt.design.resolve.resolve`.
    rounds : largest number of rounds with corrections.
    stated : entries of `meta["refinement"]` on device and measurement.
    tell : called with the learner and the results after each round.
    """
    learner = Learner(library, resolve, rounds, lambda learner: in_meta(learner, stated))
    while not learner.over:
        tell(learner, learner.learn(play(learner.library, learner.number, learner.asked)))
    return Refined.of(library, learner)
