"""Learning from taps, one round after another: which design each node has, what is tried next, when nothing is left.

A refinement goes through rounds of taps. Round 0 plays the library as it is. Each further round plays, at the nodes
where something stood out of the taps' scatter, a design that was corrected by it; it takes the place of the node's
best one only if its gain is beyond chance. What comes out worse beyond chance is tried again with half the gain. When
no node has anything significant left, or the rounds are over, a confirming round plays what was kept with new taps,
from which nothing is chosen any more: a node whose gain they do not confirm goes back to what it was.

The learner does not play. Whoever does asks it what to play, and gives it the taps.
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

LEAST_TAPS = 2  # at a node in a round, to tell its scatter from its mean
FOLLOWED = 3  # times a correction is enlarged by what the model's optimum does not follow
LEAST_DEGREES = 2  # of freedom of the scatter of all nodes together, to tell whether it is alike in all directions
Resolve = Callable[[Library, Mapping[Node, FloatArray], dict[str, Any]], tuple[Library, dict[Node, str]]]

NOT_TAPPED = f"not tapped {LEAST_TAPS} times"
NOTHING_LEFT = "nothing stands out of the taps' scatter"
NOT_SURE = "a correction would not surely converge"
NO_GAIN = "a correction brought no gain beyond the taps' scatter"
WORSE = "every correction made it worse"
ENDED = "the rounds ended before nothing was left"
NOT_CONFIRMED = "its gain was not confirmed by new taps: it is as it was"


@dataclass(frozen=True)
class NodeRound:
    """What one round said of one node.

    Attributes
    ----------
    tapped : the taps, and the design that they played.
    better : its gain over the best one before is beyond chance; of the first round true.
    limited : limits bind, so that it cannot get better than the optimum under them.
    condition : with which the design had been learnt; None before the first correction, and in a confirming round.
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
    base : of the round that the next correction starts from. It is another one where a design came out better, yet
        not beyond chance: the next one may be beyond chance better than the best.
    gain : of the next correction.
    condition : of the design that is tried.
    why : why nothing is tried any more; empty while it is.
    """

    best: int = 0
    base: int = 0
    gain: float = 1.0
    condition: Condition | None = None
    why: str = ""


@dataclass(frozen=True)
class Step:
    """What is tried at a node.

    Attributes
    ----------
    base : the taps and the design that it starts from.
    part : (K,) of each coefficient that stands out of the scatter.
    change : (K,) what shall be taken off the acceleration.
    condition : Q, and that it converges.
    limited : limits bind in that design.
    """

    base: Tapped
    part: FloatArray
    change: FloatArray
    condition: Condition
    limited: bool


@dataclass
class History:
    """All that a refinement has found so far; what `controller.refine.kept` writes into a library.

    Attributes
    ----------
    rounds : of taps that were learnt from, the first with the library as it was.
    courses : of the nodes.
    confirming : what is asked for, if anything, are the taps that confirm.
    confirmed : what those said; None before they were played.
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
    """Asks for taps of a library at nodes, and makes the next library of them.

    Parameters
    ----------
    library : to be refined; with a `history`, the one that its last round asked for.
    resolve : `transopt.design.resolve.resolve`.
    rounds : of corrections, at most.
    meta : what `meta["refinement"]` says of the history, at any time.

    Attributes
    ----------
    library : to be played next; once nothing is asked, the result.
    asked : the nodes at which it is to be tapped; empty when it is over.
    designed : the library without any correction, whose prediction the device shall make: no device can make all of a
        recorded tap, and what its design lacks is not the device's fault.
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
        """Number of the round that is asked for."""
        return len(self.history.played)

    @property
    def over(self) -> bool:
        return not self.asked

    def learn(self, taps: Mapping[Node, Sequence[Heard]]) -> Round:
        """What the taps of the round that was asked for say; `library` and `asked` are the next round's then."""
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
        """Scatter of all taps so far."""
        return self._scatter()

    def _scatter(self, more: Iterable[Tapped] = ()) -> Scatter:
        played = (one.tapped for results in self.history.played for one in results.values())
        return Scatter(self.window.bands, [*played, *more])

    @property
    def changed(self) -> list[Node]:
        """Nodes whose best design is not the one that they began with."""
        return [node for node, course in self.history.courses.items() if course.best > 0]

    @property
    def ratios(self) -> dict[int, Ratio]:
        """T of each grip that was tapped at, by index, from all taps: the device stays what it is."""
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
        """(N,) y'' that the device shall make, as far as it is measured."""
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
        """Whether a design takes the place of the best one; if not, how the course goes on."""
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
        """Corrections of the nodes where something stands out; without any, what has to be confirmed."""
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
        """What is tried next at each node; why nothing is, at the others."""
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
        """(N,) a correction after a change (K,) is taken off it."""
        out, window = self.window.values(change), self.window
        return corrected(correction_m_s2, out, window.dt_s, step.condition.cutoff_Hz, window.fade)

    def _missed(self, node: Node, step: Step) -> FloatArray:
        """(K,) how far the prediction is from changing by as much as it was wanted to, where something stood out.

        An optimum follows what is asked in the window only in part where it costs error in the time after it, as slow
        corrections do. So more is asked, until the model does in the window what the device shall.
        """
        window = self.window
        predicted = window.fade * smooth(self.library.acceleration_m_s2[node], window.dt_s) - self._reference(node)
        missed = window.coefficients(predicted) - (step.base.predicted - step.change)
        return np.where(step.part > 0, missed, 0.0)

    def _off(self, node: Node, found: NodeRound) -> FloatArray:
        """(K,) u, what the device is off by from what it should do.

        It should do what the model does at its own optimum for r, which is the prediction of round 0 less the
        correction that it was solved with. What that optimum leaves of r, for the sake of the hand-over and of the
        time after the window, is no error of the device. Where limits bind, the model's optimum is out of a weaker
        device's reach and below a stronger one's: then u = d + w, which is the same where p = r + d.
        """
        first, window = self.history.rounds[0][node].tapped, self.window
        tapped = found.tapped
        if found.limited:
            return window.coefficients(window.fade * tapped.correction_m_s2) + tapped.difference
        return tapped.error - first.predicted + window.coefficients(window.fade * first.correction_m_s2)

    def _taken_back(self, tried: Container[Node]) -> dict[Node, FloatArray]:
        """The best correction of every node that nothing new is tried at, where the library has another one."""
        best = {
            node: self._best(node).correction_m_s2
            for node in self.history.courses
            if node not in tried and node in self.history.rounds[0]
        }
        return {node: d for node, d in best.items() if not np.array_equal(d, self.library.correction_m_s2[node])}

    def _confirms(self, node: Node, tapped: Tapped, scatter: Scatter) -> bool:
        """Better beyond chance where the design was changed, and in all not worse beyond chance."""
        first = self.history.rounds[0][node].tapped
        better, whole = scatter.gain(first, tapped, where_changed=True), scatter.gain(first, tapped)
        return better.by_chance < LEVEL <= whole.worse_by_chance

    def _finish(self, results: Round) -> None:
        """What the new taps did not confirm goes back to what it was."""
        back = {}
        for node in self.asked:
            if node not in results or not results[node].better:
                self.history.courses[node].best, self.history.courses[node].why = 0, NOT_CONFIRMED
                back[node] = self._best(node).correction_m_s2
        self.history.confirmed, self.asked = results, []
        self._solve(back)

    def _solve(self, corrections: Mapping[Node, FloatArray]) -> dict[Node, str]:
        """Solve nodes again, and write down what is known; why a node was not solved."""
        self.library, refused = self._resolve(self.library, corrections, {})
        self.library = replace(self.library, meta={**self.library.meta, "refinement": self._meta(self)})
        return refused
