"""What an answer to the problem consists of: status, multipliers, solution, certificate, verdict."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from functools import lru_cache

import numpy as np

from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.base.writing import percent
from transopt.problem.limits.limit import VIOLATION_TOLERANCE
from transopt.problem.objective.bands import JUST_NOTICED_dB, Levels
from transopt.problem.objective.figures import Figures
from transopt.problem.problem import TransientProblem

OBJECTIVE_SCALE = 1e-3  # objectives below this count as this in relative comparisons
AT_FLOOR = 1e-3  # a tap error within 0.1 % of the floor is at the floor
ENDS = 0.02  # a floor above it is that of a waveform which ends while a hand pushes
OTHER_WAVEFORM = 10 ** (JUST_NOTICED_dB / 20) - 1  # felt error of an amplitude that is off by what is just noticed
PULLS = -0.005  # a change of speed below it, as printed below 0, is that of a surface that pulls
NAMED = re.compile(r" (?=[-+<>=±\d])")  # behind the name of a limit that binds


class Status(Enum):
    """How an entry ended; the value is the message. What would do is found by trial (`transopt.design.remedy`)."""

    OPTIMAL = "optimal"
    ITERATION_LIMIT = "the solver stopped at its iteration limit"
    INFEASIBLE = "no command meets all limits"
    NUMERICAL_FAILURE = "the solver broke down numerically"
    NOT_GLOBAL = "a certified stationary point, but the convex bound leaves room for a better one"
    STATIONARY = "a certified stationary point, replayed; nothing is claimed about others"
    NOT_CERTIFIED = "the answer is not proven optimal"
    REPLAY_VIOLATION = "the continuous-time replay leaves a limit or misses the prediction"
    HAND_OVER = "the wall's feedback alone exceeds a limit when the transient has to end"
    PRECISION = "double precision has no digits left to prove the answer"
    UNSTABLE_WALL = "the wall's feedback grows by itself on this device"
    UNRESOLVED = (
        "a limit is kept at every switching instant, as the problem states it, but left within a servo period"
    )


Pair = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class Multipliers:
    """Lagrange multipliers of J's problem, all >= 0 except those of the hand-over; units 1 / unit of the row.

    Sign: grad J + sum (upper - lower) grad(value) = 0, `lower` for a row's lower bound, `upper` for its upper one.

    Attributes
    ----------
    stages : N.
    pairs : name of a row -> its multipliers (lower (N,), upper (N,)); a row that is not there has none.
    hand_over : (hand_over_samples,) of c_k = feedback command; (m, hand_over_samples) of several motors.
    slope : (N,) slope of |mean i| over period k, -1 to 1, by which the ripple heats; no multiplier itself, but a
        ratio of two: where the mean current is zero, the optimum decides which it is.
    """

    stages: int
    pairs: Mapping[str, Pair]
    hand_over: FloatArray
    slope: FloatArray

    __repr__ = brief

    @classmethod
    def zero(cls, problem: TransientProblem) -> "Multipliers":
        """No limit binds."""
        tail = np.zeros((*problem.rest.shape[:-1], problem.hand_over_samples))
        return cls(problem.grid.stages, {}, tail, _nothing(problem.grid.stages))

    def lower(self, row: str) -> FloatArray:
        """(N,) of a row's lower bound."""
        return self.pairs[row][0] if row in self.pairs else _nothing(self.stages)

    def upper(self, row: str) -> FloatArray:
        """(N,) of a row's upper bound."""
        return self.pairs[row][1] if row in self.pairs else _nothing(self.stages)

    def with_pair(self, row: str, lower: FloatArray, upper: FloatArray) -> "Multipliers":
        """Replace the multipliers of one row by these."""
        return replace(self, pairs={**self.pairs, row: (lower, upper)})

    def arrays(self) -> Iterator[FloatArray]:
        """Every array of them, the slope too."""
        for pair in self.pairs.values():
            yield from pair
        yield self.hand_over
        yield self.slope

    @property
    def largest(self) -> float:
        """The largest multiplier of a limit, whatever its unit."""
        return max((float(side.max()) for pair in self.pairs.values() for side in pair), default=0.0)

    def clipped(self) -> "Multipliers":
        """Set every negative multiplier of a limit to zero."""
        pairs = {row: (np.maximum(low, 0.0), np.maximum(high, 0.0)) for row, (low, high) in self.pairs.items()}
        return replace(self, pairs=pairs, slope=np.minimum(np.maximum(self.slope, -1.0), 1.0))


@lru_cache(maxsize=8)
def _nothing(stages: int) -> FloatArray:
    nothing = np.zeros(stages)
    nothing.flags.writeable = False  # it stands for all of them
    return nothing


@dataclass(frozen=True)
class Solution:
    """What a solver returned, in its own words: nothing here is proof (see `certify`).

    Attributes
    ----------
    status : typed from the solver's raw status string.
    command : (N,) commands, exactly inside the command box and exactly zero over the hand-over; (m, N) of several
        motors.
    multipliers : clipped to their sign.
    solver : name, version-free.
    message : the solver's raw status.
    iterations : -1 where the solver does not tell.
    solve_time_s : wall time of this solve, stage data included, set-up excluded; a designed entry's includes
        the unlimited solve before it.
    """

    status: Status
    command: FloatArray
    multipliers: Multipliers
    solver: str
    message: str
    iterations: int
    solve_time_s: float

    __repr__ = brief


@dataclass(frozen=True)
class Certificate:
    """Proof of optimality from the command's rollout and the multipliers, never from the solver.

    Attributes
    ----------
    objective : J of the rolled-out command.
    merit : L of it, which is what is minimised; J itself where intensity has no price.
    violations : unit -> largest excess over a limit in that unit, and in A at the hand-over; 0 if none.
    excess : the largest of the violations in units of its tolerance (`tolerated`); at most 1 is accepted.
    dual_residual : largest |reduced gradient of the Lagrangian| over the free commands [1/A].
    duality_gap : bound on L - optimum; rigorous unless the temperature binds, then that of the linearised problem.
    lower_bound : rigorous bound on the optimum of L from below.
    finite : every number that went in was finite.
    """

    objective: float
    merit: float
    violations: Mapping[str, float]
    excess: float
    dual_residual: float
    duality_gap: float
    lower_bound: float
    finite: bool

    __repr__ = brief

    VIOLATION_TOLERANCE = VIOLATION_TOLERANCE
    GAP_TOLERANCE = 1e-6
    BOUND_TOLERANCE = 1e-2  # copper that warms makes the problem nonconvex; built-in scenes have 0.007 to 0.06 %

    @classmethod
    def nothing(cls) -> "Certificate":
        """The certificate of numbers that are not finite."""
        inf = float("inf")
        nan = float("nan")
        return cls(nan, nan, {"A": inf}, inf, inf, inf, -inf, finite=False)

    @property
    def stated_violations(self) -> dict[str, float]:
        """Violations by unit, those of every device first."""
        return {unit: self.violation(unit) for unit in dict.fromkeys(("A", "V", "K", *self.violations))}

    def violation(self, unit: str) -> float:
        """Largest excess over a limit in this unit; infinite where the numbers are not finite."""
        return self.violations.get(unit, 0.0 if self.finite else float("inf"))

    @property
    def relative_gap(self) -> float:
        return self.duality_gap / max(self.objective, OBJECTIVE_SCALE)

    @property
    def relative_bound(self) -> float:
        """How far L lies above the rigorous lower bound, relative."""
        return (self.merit - self.lower_bound) / max(self.objective, OBJECTIVE_SCALE)

    @property
    def primal_violation(self) -> float:
        """The largest of the violations, each in its unit."""
        return max(self.violations.values(), default=0.0)

    @property
    def is_stationary(self) -> bool:
        """Feasible, and no better nearby: all but the rigorous bound where the temperature binds."""
        return self.finite and self._inside and self.relative_gap <= self.GAP_TOLERANCE

    @property
    def _inside(self) -> bool:
        # Written so that a NaN anywhere rejects.
        return self.excess <= 1 and all(by <= self.VIOLATION_TOLERANCE for by in self.violations.values())

    @property
    def accepted(self) -> bool:
        return self.is_stationary and -self.GAP_TOLERANCE <= self.relative_bound <= self.BOUND_TOLERANCE

    @property
    def shortfall(self) -> str:
        """What it lacks of an optimum's, in a phrase; empty where it is accepted."""
        if self.accepted:
            return ""
        if not self.finite:
            return "not certified: its numbers do not stay finite"
        if not self._inside:
            over = ", ".join(f"{by:.3g} {unit}" for unit, by in self.stated_violations.items() if not by <= 0)
            return f"not certified: a limit is exceeded by {over}"
        if not self.is_stationary:
            said, most = f"{self.relative_gap:.1e} above the optimum", f"{self.GAP_TOLERANCE:.0e}"
            return f"not certified: no stationary point, may lie {said}, limit {most}"
        if self.relative_bound > self.BOUND_TOLERANCE:
            return f"J lies {self.relative_bound:.1%} above the convex lower bound, limit {self.BOUND_TOLERANCE:.0%}"
        return f"not certified: its lower bound {self.lower_bound:.8g} lies above it, at {self.merit:.8g}"


def held_back(tap_error: float, floor: float, binding: str) -> list[str]:
    """The limits that hold an entry back, as `binding` words them; none for one at its floor.

    Parameters
    ----------
    floor : tap error of the optimum without limits; NaN where it is not known, and whatever binds holds back.
    """
    return [] if tap_error <= floor + AT_FLOOR or binding in ("", "none") else binding.split("; ")


def verdict(
    figures: Figures,
    floor: float,
    repeatability: float,
    levels: Levels,
    binding: str,
    *,
    named: bool,
    least_input: tuple[float, str] | None = None,
) -> str:
    """How near an entry comes to the tap, what holds it back, and what a hand notices of it.

    Hands know a surface by the intensity of the tap more than by its waveform, so that this comes first: within what
    is just noticed, or too weak, and in which band most. A waveform that is far off at the right intensity is told as
    well. A motor cannot hold the hand for ever: the waveform ends while the hand still pushes, so even the optimum
    without limits has an error, the floor.

    Parameters
    ----------
    floor : tap error of the optimum without limits.
    repeatability : trial-to-mean error of the recordings, NaN if unknown.
    binding : the limits that bind, as `proof.certify.binding_limits` says.
    named : whether it is for a named target, behind which there is no hand.
    least_input : the least of what drives the plant, and its unit; None where it is not known.
    """
    off_dB = levels.felt_dB if np.isnan(figures.felt_dB) else figures.felt_dB
    if np.isnan(off_dB) or abs(off_dB) <= JUST_NOTICED_dB:
        said = [f"felt within {JUST_NOTICED_dB:g} dB"]
        if figures.felt_error > OTHER_WAVEFORM:
            said[0] += f", its waveform {percent(figures.felt_error)} % off"
    else:
        said = [f"too {'weak' if off_dB < 0 else 'strong'} by {abs(off_dB):.1f} dB, most {levels.where}"]
    if figures.tap_error <= repeatability:
        said.append("nearer than the recordings to each other")
    elif figures.tap_error <= floor + AT_FLOOR:
        ends = not named and floor > ENDS
        said.append("at its floor" + (": the waveform ends while the hand pushes" if ends else ""))
    elif held := held_back(figures.tap_error, floor, binding):
        limits = dict.fromkeys(NAMED.split(part)[0].strip() for part in held)
        said.append(f"held back by {' and '.join(limits)}")
    if figures.speed < PULLS:
        said.append("the surface pulls")
        if least_input is not None and least_input[0] < 0:
            said[-1] += f", by up to {-least_input[0]:.2f} {least_input[1]}"
    return "; ".join(said)
