"""Learning from rounds of taps: the best design of each node, the next correction, and the end.

Round 0 plays the library as it is. Each further round plays a corrected design at the nodes with a significant
difference; it replaces the node's best design only if its gain is significant. A design that is significantly worse
is tried again with half the gain. When no node has a significant difference left, or the rounds are over, a
confirming round plays the designs that were kept with new taps, from which nothing is selected: a node whose gain
they do not confirm goes back to its original design.

The learner does not play. The caller asks it what to play, and passes it the taps.
"""

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from controller.refine.heard import Heard, Node, nodes_of, smooth
from controller.refine.learning import LEAST_GAIN, Condition, Ratio, corrected, ratio, widest
from controller.refine.significance import LEVEL, Scatter, Tapped, Window
from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.library.meta import entry_left_out

LEAST_TAPS = 2  # taps at a node in a round that are needed to estimate the scatter
FOLLOWED = 3  # number of times a correction is enlarged by the part that the model's optimum does not follow
LEAST_DEGREES = 2  # degrees of freedom of the pooled scatter that are needed to estimate its anisotropy
Resolve = Callable[[Library, Mapping[Node, FloatArray], dict[str, Any]], tuple[Library, dict[Node, str]]]

NOT_TAPPED = f"fewer than {LEAST_TAPS} taps counted"
NOTHING_LEFT = "nothing stands out of the taps' scatter"
NOT_SURE = "a correction would not surely converge"
NO_GAIN = "the last correction brought no further gain beyond the taps' scatter"
WORSE = "every correction made it worse"
ENDED = "the rounds ended before nothing was left"
NOT_CONFIRMED = "its gain was not confirmed by new taps: it is as it was"


@dataclass(frozen=True)
class NodeRound:
    """Result of one round at one node.

    Attributes
    ----------
    tapped : the taps, and the design that they played.
    better : whether its gain over the best earlier design is significant; true in the first round.
    limited : whether limits bind, so that the node cannot get better than the optimum under them.
    condition : convergence condition of the correction; None before the first correction, and in a confirming round.
    """

    tapped: Tapped
    better: bool
    limited: bool
    condition: Condition | None

    @property
    def playback_error(self) -> float:
        return self.tapped.playback_error


Round = Mapping[Node, NodeRound]


@dataclass
class Course:
    """Course of one node over the rounds.

    Attributes
    ----------
    best : number of the round that played its best design.
    base : number of the round that the next correction starts from. It differs from `best` if a design came out
        better, but not significantly: the next one may be significantly better than the best.
    gain : gain of the next correction.
    condition : convergence condition of the design that is tried.
    why : reason why the node has ended; empty while it goes on.
    """

    best: int = 0
    base: int = 0
    gain: float = 1.0
    condition: Condition | None = None
    why: str = ""


@dataclass(frozen=True)
class Step:
    """The next correction at a node.

    Attributes
    ----------
    base : the taps and the design that it starts from.
    part : (K,) share of each coefficient that is significant.
    change : (K,) change to subtract from the acceleration.
    condition : Q and the convergence condition.
    limited : whether limits bind in that design.
    """

    base: Tapped
    part: FloatArray
    change: FloatArray
    condition: Condition
    limited: bool


@dataclass
class History:
    """All results of a refinement so far, which `controller.refine.kept` writes into a library.

    Attributes
    ----------
    rounds : rounds used for learning, the first with the original library.
    courses : course of each node.
    confirming : whether the next taps are those of the confirming round.
    confirmed : results of the confirming round; None before it.
    """

    rounds: list[Round] = field(default_factory=list)
    courses: dict[Node, Course] = field(default_factory=dict)
    confirming: bool = False
    confirmed: Round | None = None

    @property
    def played(self) -> list[Round]:
        """All rounds, the confirming one last."""
        return [*self.rounds, *([] if self.confirmed is None else [self.confirmed])]


class Learner:
    """Requests taps of a library at nodes, and computes the next library from them.

    Parameters
    ----------
    library : library to refine; with a `history`, the library that its last round requested.
    resolve : `transopt.design.resolve.resolve`.
    rounds : largest number of rounds with corrections.
    meta : function that gives `meta["refinement"]` for the present history.

    Attributes
    ----------
    library : library to play next; the result once nothing is requested.
    asked : nodes at which to tap; empty when the refinement is over.
    designed : the library without any correction; its prediction is the reference of the device. The recorded tap is
        not, since no device can render all of it.
    """

    def __init__(
        self,
        library: Library,
        resolve: Resolve,
        rounds: int,
        meta: Callable[["Learner"], dict[str, Any]],
        history: History | None = None,
        asked: Sequence[Node] | None = None,
    ) -> None:
        self.library, self._resolve, self._rounds, self._meta = library, resolve, rounds, meta
        self.history = history or History(courses={node: Course() for node in nodes_of(library)})
        self.asked = list(nodes_of(library) if asked is None else asked)
        self.window = Window.over(library.time_grid().switching_times_s)
        self.designed = library
        if library.correction_m_s2.any():
            nothing = {node: np.zeros(library.command.shape[2]) for node in nodes_of(library)}
            self.designed, _ = resolve(library, nothing, {})

    @property
    def number(self) -> int:
        """Number of the requested round."""
        return len(self.history.played)

    @property
    def over(self) -> bool:
        return not self.asked

    def learn(self, taps: Mapping[Node, Sequence[Heard]]) -> Round:
        """Evaluate the taps of the requested round; `library` and `asked` are then those of the next round."""
        found = {node: self._tapped(node, taps[node]) for node in self.asked if len(taps.get(node, ())) >= LEAST_TAPS}
        scatter = self._scatter(found.values())
        limited = {node: "limits" not in entry_left_out(self.library.meta, *node) for node in found}
        confirming = self.history.confirming
        results = {}
        for node, tapped in found.items():
            better = (self._confirms if confirming else self._judge)(node, tapped, scatter)
            condition = None if confirming else self.history.courses[node].condition
            results[node] = NodeRound(tapped, better, limited[node], condition)
        for node in self.asked:
            if node not in found:
                self.history.courses[node].why = NOT_TAPPED
        if confirming:
            self._finish(results)
        else:
            self.history.rounds.append(results)
            self._correct(scatter)
        return results

    @property
    def scatter(self) -> Scatter:
        """Scatter of all taps so far, pooled."""
        return self._scatter()

    def _scatter(self, more: Iterable[Tapped] = ()) -> Scatter:
        played = (one.tapped for results in self.history.played for one in results.values())
        return Scatter(self.window.bands, [*played, *more])

    @property
    def changed(self) -> list[Node]:
        """Nodes whose best design is not the original one."""
        return [node for node, course in self.history.courses.items() if course.best > 0]

    @property
    def ratios(self) -> dict[int, Ratio]:
        """Index of a tapped grip -> T from all taps of all rounds, since the device does not change."""
        pairs: dict[int, list[tuple[FloatArray, FloatArray]]] = {}
        for results in self.history.played:
            for node, one in results.items():
                p = self.window.values(one.tapped.predicted) + self._reference(node)
                pairs.setdefault(node[1], []).extend((p, p + w) for w in self.window.values(one.tapped.differences))
        return {
            ig: ratio([p for p, _ in each], [a for _, a in each], self.window.dt_s)
            for ig, each in sorted(pairs.items())
        }

    def _reference(self, node: Node) -> FloatArray:
        """(N,) reference y'' of the device within the measured window."""
        return self.window.fade * smooth(self.designed.acceleration_m_s2[node], self.window.dt_s)

    def _tapped(self, node: Node, heard: Sequence[Heard]) -> Tapped:
        window = self.window
        wanted = window.coefficients(self._reference(node))
        predicted = window.fade * smooth(self.library.acceleration_m_s2[node], window.dt_s)
        return Tapped(
            correction_m_s2=self.library.correction_m_s2[node],
            predicted=window.coefficients(predicted) - wanted,
            differences=window.coefficients(np.stack([tap.difference_m_s2 for tap in heard])),
            reference=float(wanted @ wanted),
            peak_current_A=max(tap.peak_current_A for tap in heard),
        )

    def _best(self, node: Node) -> Tapped:
        return self.history.rounds[self.history.courses[node].best][node].tapped

    def _judge(self, node: Node, tapped: Tapped, scatter: Scatter) -> bool:
        """Whether a design replaces the best one; updates the node's course."""
        if self.number == 0:
            return True
        course, found = self.history.courses[node], scatter.gain(self._best(node), tapped, where_changed=True)
        if found.by_chance < LEVEL:
            course.best = course.base = self.number
            return True
        if found.worse_by_chance < LEVEL:
            course.gain, course.base = course.gain / 2, course.best
            course.why = "" if course.gain >= LEAST_GAIN else WORSE
        elif found.value > 0 and course.base == course.best:
            course.base = self.number
        else:
            course.why = NO_GAIN
        return False

    def _correct(self, scatter: Scatter) -> None:
        """Solve corrections at the nodes with a significant difference; without any, start the confirming round."""
        steps = self._steps(scatter)
        corrections = {
            node: self._corrected(one.base.correction_m_s2, one.change, one) for node, one in steps.items()
        }
        refused = self._solve(self._taken_back(corrections) | corrections)
        for _ in range(FOLLOWED):
            missed = {node: one for node, one in steps.items() if not one.limited and node not in refused}
            again = {
                node: self._corrected(self.library.correction_m_s2[node], self._missed(node, one), one)
                for node, one in missed.items()
            }
            refused |= self._solve(again)
        for node, why in refused.items():
            self.history.courses[node].why = why
        self.asked = [node for node in steps if node not in refused]
        if refused:
            self._solve(self._taken_back(self.asked))
        if not self.asked and self.changed:
            self.history.confirming, self.asked = True, self.changed
            self._solve({})

    def _steps(self, scatter: Scatter) -> dict[Node, Step]:
        """The next correction of each node that goes on; the reason of the others is stored in their course."""
        steps: dict[Node, Step] = {}
        ratios, open_ = self.ratios, [node for node, course in self.history.courses.items() if not course.why]
        for node in open_:
            course = self.history.courses[node]
            found = self.history.rounds[course.base][node]
            off = self._off(node, found)
            part = scatter.standing_out(off, found.tapped, len(open_))
            if not part.any():
                course.why = NOTHING_LEFT
                continue
            course.condition = widest(ratios[node[1]], course.gain, limited=found.limited)
            if not course.condition.met:
                course.why = NOT_SURE
            elif self.number > self._rounds:
                course.why = ENDED
            else:
                steps[node] = Step(found.tapped, part, course.gain * part * off, course.condition, found.limited)
        return steps

    def _corrected(self, correction_m_s2: FloatArray, change: FloatArray, step: Step) -> FloatArray:
        """(N,) the correction less a change (K,), through Q."""
        out, window = self.window.values(change), self.window
        return corrected(correction_m_s2, out, window.dt_s, step.condition.cutoff_Hz, window.fade)

    def _missed(self, node: Node, step: Step) -> FloatArray:
        """(K,) residual of the prediction's change against the requested one, in the significant coefficients.

        The optimum follows a request within the window only partly if that causes error after the window, as slow
        corrections do. So the request is enlarged until the model's change within the window is the wanted one.
        """
        window = self.window
        predicted = window.fade * smooth(self.library.acceleration_m_s2[node], window.dt_s) - self._reference(node)
        missed = window.coefficients(predicted) - (step.base.predicted - step.change)
        return np.where(step.part > 0, missed, 0.0)

    def _off(self, node: Node, found: NodeRound) -> FloatArray:
        """(K,) u, the error of the device.

        The device's target is the model at its own optimum for r: the prediction of round 0 less the correction that
        it was solved with. The residual of that optimum from r, due to the hand-over and the time after the window,
        is no error of the device. Where limits bind, a weaker device cannot reach the model's optimum and a stronger
        one exceeds it: then u = d + w, which is the same if p = r + d.
        """
        first, window = self.history.rounds[0][node].tapped, self.window
        tapped = found.tapped
        if found.limited:
            return window.coefficients(window.fade * tapped.correction_m_s2) + tapped.difference
        return tapped.error - first.predicted + window.coefficients(window.fade * first.correction_m_s2)

    def _taken_back(self, tried: Container[Node]) -> dict[Node, FloatArray]:
        """Node -> its best correction, for nodes not tried whose correction in the library is a different one."""
        best = {
            node: self._best(node).correction_m_s2
            for node in self.history.courses
            if node not in tried and node in self.history.rounds[0]
        }
        return {node: d for node, d in best.items() if not np.array_equal(d, self.library.correction_m_s2[node])}

    def _confirms(self, node: Node, tapped: Tapped, scatter: Scatter) -> bool:
        """Whether the design is significantly better in the changed bands, and not significantly worse over all."""
        first = self.history.rounds[0][node].tapped
        better, whole = scatter.gain(first, tapped, where_changed=True), scatter.gain(first, tapped)
        return better.by_chance < LEVEL <= whole.worse_by_chance

    def _finish(self, results: Round) -> None:
        """End the refinement; nodes whose gain the new taps did not confirm go back to their original design."""
        back = {}
        for node in self.asked:
            if node not in results or not results[node].better:
                self.history.courses[node].best, self.history.courses[node].why = 0, NOT_CONFIRMED
                back[node] = self._best(node).correction_m_s2
        self.history.confirmed, self.asked = results, []
        self._solve(back)

    def _solve(self, corrections: Mapping[Node, FloatArray]) -> dict[Node, str]:
        """Solve nodes again and update the record in the library; return the reasons of nodes that failed."""
        self.library, refused = self._resolve(self.library, corrections, {})
        self.library = replace(self.library, meta={**self.library.meta, "refinement": self._meta(self)})
        return refused
