"""What would do where an entry is refused: other numbers in the scene, each tried before it is named.

That a number would do is said only of one with which the entry has been solved, certified and replayed, rounded as it
is printed. No bound is enough for that: at the least value that a linear program finds, what is feasible is a single
command, which no method finds and no replay keeps; and a wall that asks for less at one depth pushes the stylus to
another. Where nothing did, it is said what was tried and how far it went.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from transopt.base.errors import InputError
from transopt.design.entry import replayed
from transopt.design.optimum import Designed, optimum
from transopt.design.verify import admit
from transopt.problem.answer import Status
from transopt.problem.limits.current import CurrentLimit
from transopt.problem.problem import TransientProblem
from transopt.proof.replay import Replay
from transopt.scene.keys import unit_of
from transopt.solvers.options import SolverOptions, TrialOptions

MOST_S = 5.0  # of a processor's time for the trials of one entry; the one that runs then is the last
LONGEST = 4.0  # times that by the clock, on a machine that is busy with other things
DIGITS = 3  # of what is proposed
OVER = 1.03  # times what was reached over a limit: what is tried first
NEAR = 1.1  # a strength that does, over one that does not: close enough
# By how much a number is changed, one after the other: which is the least that does is found by bisection.
STRENGTHS = (1.02, 1.1, 1.4, 2.5, 10.0, 100.0, 1e4, 1e6, 1e9)
SHORTER = (2.0, 4.0, 8.0)  # times the servo periods in the same window
COLD_C = 0.0  # no coil is asked to be colder

STIFFNESS, DAMPING, LATENCY = "feedback.stiffness_N_m", "feedback.damping_N_s_m", "feedback.latency_ticks"
CURRENT = f"limits.{CurrentLimit.key}"
PERIOD, STAGES = "time.dt_s", "time.stages"
TAP_RATE, FEEDBACK = "thermal.tap_rate_Hz", "feedback"
MOTOR = ("motor.R_wh_K_W", "motor.R_ha_K_W")  # of another one, where nothing else does
COUNTED = (LATENCY, STAGES)

CAUSES_KNOWN = (Status.INFEASIBLE, Status.HAND_OVER, Status.UNSTABLE_WALL)  # no shorter servo period helps

Values = Mapping[str, float | None]


class Adjustable(Protocol):
    """An entry that can be posed with other numbers."""

    def value(self, key: str) -> float | None:
        """What stands at a dotted key of the scene; None where nothing does."""

    def problem(self, changes: Values) -> TransientProblem:
        """The entry's problem with other numbers, None for a key that is left out.

        Raises
        ------
        InputError : numbers that the scene cannot have.
        """


@dataclass(frozen=True)
class Change:
    """One number of a scene: its dotted key, its new value, None for none, and its unit."""

    key: str
    value: float | None
    unit: str

    def __str__(self) -> str:
        return f"no {self.key}" if self.value is None else f"{self.key} = {self.value:.10g} {self.unit}".rstrip()


@dataclass(frozen=True)
class Remedy:
    """Numbers that together make an entry possible, or were meant to.

    Attributes
    ----------
    changes : at least one.
    solved : whether the entry with exactly these was solved, certified and replayed; if not, they are the farthest
        that was tried.
    """

    changes: tuple[Change, ...]
    solved: bool

    def __str__(self) -> str:
        return " and ".join(map(str, self.changes))

    @property
    def values(self) -> Values:
        """Key -> value."""
        return {change.key: change.value for change in self.changes}


def said(remedies: Sequence[Remedy]) -> str:
    """What would do, or what was tried in vain, in one sentence."""
    solved = [str(remedy) for remedy in remedies if remedy.solved]
    if solved:
        return f"{' or '.join(solved)} would do"
    tried = ", ".join(str(remedy) for remedy in remedies)
    return f"tried in vain, as far as {tried}" if tried else "nothing was found to try"


def does(entry: Adjustable, changes: Values, options: SolverOptions) -> bool:
    """Whether the entry with these numbers is solved, certified and replayed clean, by the wanted solver alone."""
    with np.errstate(over="ignore", invalid="ignore"):  # far from what is usual
        try:
            problem = entry.problem(changes)
        except InputError:
            return False
        designed = optimum(problem, TrialOptions(options.solver, options.tolerance, options.max_iterations))
        if not designed.is_proven:
            return False
        coil = None if problem.thermal is None else problem.thermal.coil
        (played,) = replayed(coil, [designed])
        command = designed.solution.command_A
        predicted, _ = problem.stage.rollout(command)
        status, _ = admit(
            designed.solution.status, designed.certificate, played, designed.problem, command, predicted
        )
    return status is Status.OPTIMAL


@dataclass(frozen=True)
class _Way:
    """How some numbers change together, by one strength.

    Attributes
    ----------
    at : strength > 1 -> the numbers, rounded as they are printed, in the direction of the change.
    strengths : increasing.
    begins_at_hint : whether the excess of the refused answer tells where to begin.
    vanishes : whether next to nothing is left of the numbers at the largest strength.
    """

    at: Callable[[float], Values]
    strengths: tuple[float, ...] = STRENGTHS
    begins_at_hint: bool = True
    vanishes: bool = False


@dataclass
class _Search:
    """The trials of one entry.

    Attributes
    ----------
    hint : the strength to begin with, if it is above 1.
    known : what did and what did not.
    """

    entry: Adjustable
    options: SolverOptions
    most_s: float
    hint: float
    known: dict[tuple[tuple[str, float | None], ...], bool] = field(default_factory=dict)
    started_s: tuple[float, float] = field(default_factory=lambda: (time.process_time(), time.monotonic()))

    @property
    def late(self) -> bool:
        busy_s, by_clock_s = self.started_s
        return (
            time.process_time() - busy_s > self.most_s or time.monotonic() - by_clock_s > LONGEST * self.most_s
        )

    def does(self, values: Values) -> bool:
        key = tuple(values.items())
        if key not in self.known:
            self.known[key] = not self.late and does(self.entry, values, self.options)
        return self.known[key]

    def best(self, way: _Way) -> Remedy:
        """The least change that does, nearly; or the farthest that was tried."""
        strengths = way.strengths
        if way.begins_at_hint and self.hint > 1:
            strengths = tuple(sorted({*strengths, self.hint}))
        low, high, farthest = -1, len(strengths), 0
        middle = strengths.index(self.hint) if self.hint in strengths else high // 2
        while high - low > 1 and not self.late:
            farthest = max(farthest, middle)
            if self.does(way.at(strengths[middle])):
                high = middle
            else:
                low = middle
            # What is of no use when it is next to nothing is of none in between.
            middle = high - 1 if way.vanishes and high == len(strengths) else (low + high) // 2
        if high == len(strengths):
            return _remedy(way.at(strengths[farthest]), solved=False)
        weak, strong = strengths[low] if low >= 0 else 1.0, strengths[high]
        while strong / weak > NEAR and not self.late:
            between = math.sqrt(weak * strong)
            if way.at(between) in (way.at(weak), way.at(strong)):
                break
            if self.does(way.at(between)):
                strong = between
            else:
                weak = between
        return _remedy(way.at(strong), solved=True)


def remedies(
    entry: Adjustable,
    designed: Designed,
    played: Replay,
    status: Status,
    options: SolverOptions,
    most_s: float = MOST_S,
) -> list[Remedy]:
    """What would do for an entry that is refused: one number changed or, if none helps, several together.

    Parameters
    ----------
    designed, played : the entry's refused answer and its replay. status : how it ended. most_s : for all trials.

    Returns
    -------
    Those that do, if there are any; else those that were tried, each as far as it went.
    """
    search = _Search(entry, options, most_s, _excess(designed.problem, played, status))
    tried: list[Remedy] = []
    for ways in _ways(entry, designed.problem, status):
        found = [search.best(way) for way in ways if not search.late]
        solved = [remedy for remedy in found if remedy.solved]
        if solved:
            return solved
        tried += found
    return tried


def _excess(problem: TransientProblem, played: Replay, status: Status) -> float:
    """How many times a limit, and a little more, a refused answer's replay reached; 1 where that means nothing."""
    if status is Status.INFEASIBLE:
        return 1.0
    reached = [played.peak(limit) / limit.stated for limit in problem.limits if limit.linear]
    return OVER * max((by for by in reached if by < STRENGTHS[-1]), default=0.0)


def _ways(entry: Adjustable, problem: TransientProblem, status: Status) -> Iterator[list[_Way]]:
    """What may help, the simplest first; each list is tried as a whole."""
    hopeless = [limit for limit in problem.limits if limit.unavoidable(problem)]
    helped = [pair for limit in hopeless or problem.limits for pair in limit.relieved_by().items()]
    wider = [(key, up) for key, up in helped if _movable(entry, key)]
    softer = [(key, False) for key in (STIFFNESS, DAMPING, LATENCY) if _movable(entry, key)]
    if status is Status.PRECISION:
        yield [_way(entry, [(CURRENT, False)])]
        return
    if status is Status.UNSTABLE_WALL:
        wider = []
    if hopeless:
        softer = []
    yield [_way(entry, [pair]) for pair in ([*softer, *wider] if status is Status.HAND_OVER else [*wider, *softer])]
    rising = [pair for pair in wider if pair[1]]
    firm = [pair for pair in softer if pair[0] != LATENCY]
    yield [_way(entry, pairs) for pairs in (rising, firm) if len(pairs) > 1]
    if status not in CAUSES_KNOWN:
        yield [_finer(entry)]
    optional = {key for key, up in rising if key.startswith("limits.") and key != CURRENT}
    gone = [key for key in (*sorted(optional), TAP_RATE) if entry.value(key) is not None]
    gone += [FEEDBACK] if entry.value(STIFFNESS) is not None else []
    yield [_way(entry, [], [key]) for key in gone]
    if len(gone) > 1:
        yield [_way(entry, [], gone)]
    everything = [pair for limit in problem.limits for pair in limit.relieved_by().items()]
    kept = [(key, up) for key, up in everything if key not in gone and _movable(entry, key)]
    colder = [pair for pair in kept if not pair[1]]
    if colder:
        yield [_way(entry, colder, gone)]
    yield [_way(entry, kept, gone)]
    if problem.thermal is not None:
        yield [_way(entry, [(key, False) for key in MOTOR], gone)]


COOLED = ("thermal.start_winding_C", "thermal.start_housing_C", "thermal.ambient_C")


def _coldest_C(entry: Adjustable, key: str) -> float:
    """A coil cools to what is around it, and that to nothing unusual."""
    ambient = entry.value(COOLED[-1])
    return COLD_C if key == COOLED[-1] or ambient is None else ambient


def _movable(entry: Adjustable, key: str) -> bool:
    """Whether a number stands there, and not at its end."""
    stated = entry.value(key)
    return stated is not None and stated > (_coldest_C(entry, key) if key in COOLED else 0.0)


def _way(entry: Adjustable, pairs: Sequence[tuple[str, bool]], gone: Sequence[str] = ()) -> _Way:
    """All of these keys, each with whether it goes up, by the same factor; a temperature by its distance.

    Parameters
    ----------
    gone : what is left out besides.
    """
    stated = {key: entry.value(key) or 0.0 for key, _ in pairs}

    def at(strength: float) -> Values:
        values: dict[str, float | None] = dict.fromkeys(gone)
        for key, up in pairs:
            if key in COOLED:
                cold = _coldest_C(entry, key)
                values[key] = math.floor(10 * (cold + (stated[key] - cold) / strength)) / 10
            elif key in COUNTED:
                values[key] = float(math.floor(stated[key] / strength))
            else:
                values[key] = _rounded(stated[key] * strength if up else stated[key] / strength, up)
        return values

    if not pairs:
        return _Way(at, (1.0,), begins_at_hint=False)
    return _Way(at, vanishes=not any(up for _, up in pairs))


def _finer(entry: Adjustable) -> _Way:
    """More and shorter servo periods in the same window."""
    period_s, stages = entry.value(PERIOD) or 0.0, entry.value(STAGES) or 0.0

    def at(strength: float) -> Values:
        return {PERIOD: float(f"{period_s / strength:.6g}"), STAGES: float(round(stages * strength))}

    return _Way(at, SHORTER, begins_at_hint=False)


def _rounded(value: float, up: bool) -> float:
    """To the digits that are printed, away from where it comes from."""
    if value == 0:
        return 0.0
    digits = DIGITS - 1 - math.floor(math.log10(abs(value)))
    scaled = value * 10.0**digits
    # A product that rounding has left beside a whole number is that number.
    whole = math.ceil(scaled - 1e-9) if up else math.floor(scaled + 1e-9)
    return float(f"{whole / 10.0**digits:.{DIGITS}g}")


def _remedy(values: Values, *, solved: bool) -> Remedy:
    return Remedy(tuple(Change(key, value, unit_of(key)) for key, value in values.items()), solved)
