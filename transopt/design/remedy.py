"""Remedies for a refused entry: other numbers in its scene, each solved before it is proposed.

Bounds do not suffice as proposals. At the least width of a limit only a single command is feasible, which solvers
miss and whose replay exceeds the limit; and a softer wall, which needs less current at one depth, lets the stylus go
deeper. Every proposal is therefore rounded as printed, then solved, certified and replayed. A search begins at the
least width, and a limit that no width makes feasible is not tried. If none succeeds, the report says what was tried
and how far.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from transopt.base.errors import InputError
from transopt.base.units import unit_of
from transopt.design.context import Posed
from transopt.design.design import design
from transopt.design.entry import Entry
from transopt.design.explain import Change, Remedy
from transopt.problem.answer import Status
from transopt.problem.limits.limit import Limit
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import layout
from transopt.proof.continuous import AGREEMENT
from transopt.proof.replay import Replay
from transopt.solvers.feasibility import alone, can_widen, least_widening
from transopt.solvers.options import SolverOptions, TrialOptions

MOST_WORK = 100.0  # work of all trials for one entry; most searches of the stress suite end within 20 trials
STAGES_OF_WORK = 1000.0  # number of stages whose solution takes as long as the fixed part of a trial
STATES_OF_WORK = 12.0  # with more states the work of a stage is in proportion to their square
SLOW = 5.0  # work of a trial on a nonlinear plant, for the worst of several devices or for an energy, over any other
MOST_ITERATIONS = 60  # of the solver in a trial; a feasible problem takes a quarter of it
DIGITS = 3  # significant digits of a proposal
TENTHS = 10  # temperatures are rounded to 1 / TENTHS of a kelvin
OVER = 1.03  # first factor tried, relative to the least width, or to how far the refused answer exceeded its limit
NEAR = 1.1  # bisection ends when a successful strength is within this factor of a failed one
# Factors ("strengths") by which numbers are changed; bisection finds the least one that succeeds.
STRENGTHS = (1.02, 1.1, 1.4, 2.5, 10.0, 100.0, 1e4, 1e6, 1e9)
SHORTER = (2.0, 4.0, 8.0)  # divisors of the servo period in the same window, or of the window's length
STEADIER = (1e-9, 1e-6, 1e-3)  # weights of the command's movement
COLD_C = 0.0  # lowest temperature that is proposed for the coil's surroundings [C]

RHO = "weights.rho"
STIFFNESS, DAMPING, LATENCY = "feedback.stiffness_N_m", "feedback.damping_N_s_m", "feedback.latency_ticks"
FEEDBACK, TAP_RATE = "feedback", "thermal.tap_rate_Hz"
PERIOD, STAGES = "time.dt_s", "time.stages"
AMBIENT = "thermal.ambient_C"
COOLED = ("thermal.start_winding_C", "thermal.start_housing_C", AMBIENT)
MOTOR = ("motor.R_wh_K_W", "motor.R_ha_K_W")  # thermal resistances of a different motor, proposed last
COUNTED = (LATENCY, STAGES)

Values = Mapping[str, float | None]
Move = tuple[str, bool]  # a key of the scene, and whether its number is increased


class Adjustable(Protocol):
    """An entry that can be posed with other numbers."""

    def value(self, key: str) -> float | None:
        """The number at a dotted key of the scene; None if the key is absent."""

    def posed(self, changes: Values) -> Posed:
        """Pose the entry with other numbers; the value None removes a key.

        Raises
        ------
        InputError : numbers that are invalid in the scene.
        """


def does(entry: Adjustable, changes: Values, options: SolverOptions) -> bool:
    """Whether the entry with these numbers is solved by the given solver alone, certified and replayed cleanly."""
    trial = TrialOptions(options.solver, options.tolerance, min(options.max_iterations, MOST_ITERATIONS))
    with np.errstate(over="ignore", invalid="ignore"):  # extreme numbers overflow; the trial fails then
        try:
            posed = entry.posed(changes)
        except InputError:
            return False
        (found,) = design([posed], options=trial)
        return found.designed.is_proven and found.admitted


@dataclass(frozen=True)
class _Way:
    """A one-parameter family of changes: some numbers changed together, by one strength.

    Attributes
    ----------
    at : strength -> the numbers, rounded as printed, away from their present values.
    strengths : increasing, the first above 1.
    guided : whether the search starts at the factor by which the refused answer exceeded its limit.
    vanishes : whether the numbers are close to zero at the largest strength.
    least : factor by which the limits have to be wider at the least; 1 if it is not known.
    """

    at: Callable[[float], Values]
    strengths: tuple[float, ...] = STRENGTHS
    guided: bool = True
    vanishes: bool = False
    least: float = 1.0


@dataclass
class Work:
    """Budget of work for trials, counted and not timed, so that results are the same on every machine.

    Attributes
    ----------
    most : budget for all trials. spent : work of the trials made so far.
    short : whether changes that may help were not tried for lack of it.
    """

    most: float = MOST_WORK
    spent: float = 0.0
    short: bool = False

    @property
    def left(self) -> float:
        """Remaining work, at least 0."""
        return max(self.most - self.spent, 0.0)

    def spend(self, refused: Entry, values: Values) -> None:
        """Add the work of one trial of a refused entry with other numbers."""
        problem = refused.problem
        stages = (values.get(STAGES) or problem.grid.stages) + problem.grid.after_stages
        slow = problem.worst or refused.objective == "intensity" or refused.designed.nonlinear is not None
        each = max(layout(problem).states / STATES_OF_WORK, 1.0) ** 2
        self.spent += (SLOW if slow else 1.0) * (1 + each * stages / STAGES_OF_WORK)


@dataclass
class _Search:
    """The trials of one entry.

    Attributes
    ----------
    hint : the strength to begin with, if it is above 1.
    work : the budget of all trials.
    until : spent work at which the present list of ways has used up its share.
    known : numbers already tried -> whether they succeeded.
    """

    entry: Adjustable
    refused: Entry
    options: SolverOptions
    hint: float
    work: Work
    until: float = 0.0
    known: dict[tuple[tuple[str, float | None], ...], bool] = field(default_factory=dict)

    def begin(self, ways: Sequence[_Way]) -> None:
        """Start a list of ways; it may use half of the remaining work, so that the next list has some left.

        Ways of a single trial have one trial even if no work is left: to leave a part out is the surest change.
        """
        self.until = self.work.spent + self.work.left / 2
        if all(len(way.strengths) == 1 for way in ways):
            self.until = max(self.until, math.nextafter(self.work.spent, math.inf))

    @property
    def late(self) -> bool:
        return self.work.spent >= self.until

    def tried(self, ways: Sequence[_Way]) -> list[Remedy]:
        """The best remedy of each way; ways that succeed at their first strength go first. At least one is tried."""
        at_once = [way for way in ways if not self.late and self.does(way.at(self.first(way)))]
        found = [self.best(way) for way in at_once]
        for way in ways:
            if way not in at_once and not self.late:
                found.append(self.best(way))
            elif way not in at_once:
                self.work.short = True
        return found

    def begins(self, way: _Way) -> float:
        """The strength to begin with; not above 1 if none is known."""
        return OVER * way.least if way.least > 1 else self.hint if way.guided else 0.0

    def strengths(self, way: _Way) -> tuple[float, ...]:
        """Strengths of a way from its least on, with the one to begin with and one that shows it to be the least."""
        begins = self.begins(way)
        near = {begins, max(begins / NEAR, math.sqrt(begins))} if 1 < begins < math.inf else set()
        return tuple(sorted(each for each in {*way.strengths, *near} if way.least == 1 or each >= way.least))

    def first(self, way: _Way) -> float:
        """The strength with which the search begins: a known one, or the middle one."""
        strengths, begins = self.strengths(way), self.begins(way)
        return begins if begins in strengths else strengths[len(strengths) // 2]

    def __contains__(self, values: Values) -> bool:
        return tuple(values.items()) in self.known

    def does(self, values: Values) -> bool:
        key = tuple(values.items())
        if key not in self.known:
            self.work.spend(self.refused, values)
            self.known[key] = does(self.entry, values, self.options)
        return self.known[key]

    def best(self, way: _Way) -> Remedy:
        """The least change that succeeds, to within a factor `NEAR`; or the largest change that was tried in vain."""
        strengths, begins = self.strengths(way), self.begins(way)
        middle = strengths.index(self.first(way))
        low, high, farthest, up = -1, len(strengths), middle, 1
        while high - low > 1 and (low < 0 or way.at(strengths[middle]) in self or not self.late):
            farthest = max(farthest, middle)
            if self.does(way.at(strengths[middle])):
                high = middle
            else:
                low = middle
            # A number that does not help close to zero does not help in between, and a strength that is known to
            # begin with is nearly the least: the largest strength, or the ones beside the known one, are tried next.
            known = begins in strengths
            if high == len(strengths):
                middle = high - 1 if way.vanishes else min(low + up, high - 1) if known else (low + high) // 2
                up *= 2
            else:
                middle = high - 1 if low < 0 and known and strengths[high] == begins else (low + high) // 2
        if high == len(strengths):
            self.work.short |= high - low > 1
            return _remedy(way.at(strengths[farthest]), solved=False)
        weak, strong = strengths[low] if low >= 0 else way.least, strengths[high]
        while strong / weak > NEAR and not self.late:
            between = math.sqrt(weak * strong)
            if way.at(between) in (way.at(weak), way.at(strong)):
                break
            if self.does(way.at(between)):
                strong = between
            else:
                weak = between
        return _remedy(way.at(strong), solved=True)


def remedies(entry: Adjustable, refused: Entry, options: SolverOptions, work: Work | None = None) -> list[Remedy]:
    """Find remedies for a refused entry: one number changed or, if none helps, several together.

    Parameters
    ----------
    refused : the refused entry, with its problem, its replay and its status.
    work : budget of the trials; `MOST_WORK` by default. The trial that exceeds it is the last but for those that
        leave a part out.

    Returns
    -------
    The remedies that succeed, if there are any; otherwise those tried in vain, each at its largest strength.
    """
    problem, played, status = refused.problem, refused.played, refused.status
    search = _Search(entry, refused, options, _excess(problem, played, status), work or Work())
    tried: list[Remedy] = []
    for ways in _ways(entry, refused):
        search.begin(ways)
        found = search.tried([way for way in ways if search.strengths(way)])
        solved = [remedy for remedy in found if remedy.solved]
        if solved:
            return solved
        tried += found
    return tried


def _excess(problem: TransientProblem, played: Replay, status: Status) -> float:
    """Largest ratio of peak to limit in a refused answer's replay, times `OVER`; 0 if infeasible."""
    if status is Status.INFEASIBLE:
        return 0.0
    linear = [limit for limit in problem.limits if limit.linear]
    if status is Status.UNRESOLVED:
        linear = [limit for limit in linear if played.leaves(limit)]
    reached = [played.peak(limit) / limit.stated for limit in linear]
    return OVER * max((by for by in reached if by < STRENGTHS[-1]), default=0.0)


def _ways(entry: Adjustable, refused: Entry) -> Iterator[list[_Way]]:
    """Lists of ways that may help, the simplest first; each list is tried as a whole.

    Empty for a replay whose integration does not converge: its device is too fast, whatever the command. A trial on a
    nonlinear plant takes seconds, so that only limits that are missed are left out there.
    """
    problem, played, status = refused.problem, refused.played, refused.status
    if refused.designed.nonlinear is not None:
        missed = [key for row in refused.designed.missed if (key := row.limit.dispensed_by())]
        yield [_without(key) for key in missed]
        yield [_without(*missed)] if len(missed) > 1 else []
        return

    def movable(moves: Sequence[Move]) -> list[Move]:
        return [(key, up) for key, up in moves if _is_movable(entry, key)]

    if status is Status.REPLAY_VIOLATION and not played.step_error <= AGREEMENT:
        return
    weaker = _way(entry, [(f"limits.{problem.limits.input.key}", False)])
    if status is Status.PRECISION:
        yield [weaker, _steadier(entry)]
        yield [_shortened(entry)]
        if entry.value(STIFFNESS) is not None:
            yield [_steadier(entry, [FEEDBACK])]
        return
    hopeless = [limit for limit in problem.limits if limit.unavoidable(problem)]
    blamed = list(hopeless or problem.limits)
    if status is Status.HAND_OVER:
        blamed = [limit for limit in blamed if limit.linear]
    if status is Status.NOT_GLOBAL:  # J may lie above the convex bound only where a limit is not convex
        blamed = [limit for limit in blamed if not limit.linear] or blamed
    if status is Status.UNSTABLE_WALL:
        blamed = []
    if status is Status.UNRESOLVED:
        # Only the limits violated between two instants. If it is the temperature of a coil as fast as a servo period,
        # less current keeps the limit from any start, and that problem is quickly solved.
        blamed = [limit for limit in blamed if played.leaves(limit)]
    least = _least_factors(problem, blamed) if status in (Status.INFEASIBLE, Status.HAND_OVER) else {}
    wider = [(move, limit) for limit in blamed for move in movable([*limit.relieved_by().items()])]
    softer = movable([(key, False) for key in (STIFFNESS, DAMPING, LATENCY)])
    if hopeless:
        softer = []
    softened = [_way(entry, [move]) for move in softer]
    widened = [_way(entry, [move], least=least.get((limit.name,), 1.0)) for move, limit in wider]
    singly = [*softened, *widened] if status is Status.HAND_OVER else [*widened, *softened]
    yield [replace(weaker, guided=False), *singly] if status is Status.UNRESOLVED else singly
    rising = [move for move, _ in wider if move[1]]
    both = [move for move in softer if move[0] != LATENCY]
    together = least.get(tuple(limit.name for limit in blamed), 1.0)
    yield [_way(entry, moves, least=by) for moves, by in ((rising, together), (both, 1.0)) if len(moves) > 1]
    if status is Status.HAND_OVER:
        yield [_shortened(entry)]
    elif status not in (Status.INFEASIBLE, Status.UNSTABLE_WALL):
        yield [_finer(entry)]
    needless = [key for limit in problem.limits if (key := limit.dispensed_by())]
    needless += [TAP_RATE] if entry.value(TAP_RATE) is not None else []
    gone = [*needless, *([FEEDBACK] if entry.value(STIFFNESS) is not None else [])]
    yield [_without(key) for key in gone]
    if len(gone) > 1:
        yield [_without(*gone)]
    everything = [move for limit in problem.limits for move in limit.relieved_by().items() if move[0] not in gone]
    kept = movable(everything)
    falling = [move for move in kept if not move[1]]
    last = [_way(entry, moves, gone) for moves in (falling, kept) if moves]
    yield last
    if problem.thermal is not None:
        motor = _way(entry, movable([(key, False) for key in MOTOR]), gone)
        last.append(motor)
        yield [motor]
    if (entry.value(RHO) or 0.0) < STEADIER[-1]:
        # A problem made feasible in this way may still have a J too flat for double precision.
        yield [_steadied(way) for way in last]


def _least_factors(problem: TransientProblem, limits: Sequence[Limit]) -> dict[tuple[str, ...], float]:
    """Least factors of each limit alone and of all together, by their names; infinite where none is enough."""
    if not can_widen(problem):
        return {}
    names = tuple(limit.name for limit in limits)
    together = least_widening(problem, names)
    found = {names: together} | {(name,): alone(problem, name, together) for name in names}
    return {each: np.inf if widening is None else widening.factor for each, widening in found.items()}


def _coldest_C(entry: Adjustable, key: str) -> float:
    """Lowest temperature at a key [C]: `COLD_C` for the surroundings, their temperature for the coil."""
    ambient = entry.value(AMBIENT)
    return COLD_C if key == AMBIENT or ambient is None else ambient


def _is_movable(entry: Adjustable, key: str) -> bool:
    """Whether the scene has a number at the key that can still be reduced."""
    stated = entry.value(key)
    return stated is not None and stated > (_coldest_C(entry, key) if key in COOLED else 0.0)


def _way(entry: Adjustable, moves: Sequence[Move], gone: Sequence[str] = (), least: float = 1.0) -> _Way:
    """Change all of these numbers by the same factor; a temperature by its distance from the coldest allowed one.

    Parameters
    ----------
    gone : further keys, which are removed.
    """
    stated = {key: entry.value(key) or 0.0 for key, _ in moves}

    def at(strength: float) -> Values:
        values: dict[str, float | None] = dict.fromkeys(gone)
        for key, up in moves:
            if key in COOLED:
                cold = _coldest_C(entry, key)
                values[key] = math.floor(TENTHS * (cold + (stated[key] - cold) / strength)) / TENTHS
            elif key in COUNTED:
                values[key] = float(math.floor(stated[key] / strength))
            else:
                values[key] = _rounded(stated[key] * strength if up else stated[key] / strength, up)
        return values

    return _Way(at, vanishes=not any(up for _, up in moves), least=least)


def _without(*keys: str) -> _Way:
    return _Way(lambda _: dict.fromkeys(keys), (1.0,), guided=False)


def _finer(entry: Adjustable) -> _Way:
    """Divide the same window into more and shorter servo periods."""
    period_s, stages = entry.value(PERIOD) or 0.0, entry.value(STAGES) or 0.0

    def at(strength: float) -> Values:
        return {PERIOD: float(f"{period_s / strength:.6g}"), STAGES: float(round(stages * strength))}

    return _Way(at, SHORTER, guided=False)


def _shortened(entry: Adjustable) -> _Way:
    """Shorten the window."""
    stages = entry.value(STAGES) or 0.0
    return _Way(lambda strength: {STAGES: float(max(math.floor(stages / strength), 2))}, SHORTER, guided=False)


def _steadier(entry: Adjustable, gone: Sequence[str] = ()) -> _Way:
    """Increase the weight of the command's movement, with these keys removed."""
    stated, without = entry.value(RHO) or 0.0, dict.fromkeys(gone)
    return _Way(lambda rho: without | {RHO: rho}, tuple(rho for rho in STEADIER if rho > stated), guided=False)


def _steadied(way: _Way) -> _Way:
    """Change the same numbers under the largest weight of the command's movement that is tried."""
    return replace(way, at=lambda strength: {**way.at(strength), RHO: STEADIER[-1]})


def _rounded(value: float, up: bool) -> float:
    """Round to the printed digits, up or down: always away from the present value."""
    if value == 0:
        return 0.0
    digits = DIGITS - 1 - math.floor(math.log10(abs(value)))
    scaled = value * 10.0**digits
    # The offset of 1e-9 absorbs rounding errors of a product that should be a whole number.
    whole = math.ceil(scaled - 1e-9) if up else math.floor(scaled + 1e-9)
    return float(f"{whole / 10.0**digits:.{DIGITS}g}")


def _remedy(values: Values, *, solved: bool) -> Remedy:
    return Remedy(tuple(Change(key, value, unit_of(key)) for key, value in values.items()), solved)
