"""The parts of an answer to the problem: status, multipliers, solution, certificate, verdict."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property, lru_cache

import numpy as np

from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.base.writing import percent
from transopt.problem.limits.limit import VIOLATION_TOLERANCE
from transopt.problem.objective.bands import JUST_NOTICED_dB, Levels
from transopt.problem.objective.figures import Figures
from transopt.problem.problem import TransientProblem

OBJECTIVE_SCALE = 1e-3  # gaps are relative to J or to this, whichever is larger
AT_FLOOR = 1e-3  # largest excess of the tap error over the floor, and of sqrt(J), that counts as no loss by limits
MIN_FLOOR_OF_PUSHING_HAND = 0.02  # a larger floor comes from the waveform's end while the hand still pushes
OTHER_WAVEFORM = 10 ** (JUST_NOTICED_dB / 20) - 1  # felt error of an amplitude off by the just noticeable difference
MAX_SPEED_OF_PULLING = -0.005  # `Figures.speed` below it prints as negative: the surface pulls the stylus
END_OF_LIMIT_NAME = re.compile(r" (?=[-+<>=±\d])")  # the space between a binding limit's name and its value


class Status(Enum):
    """How an entry ended; the value is the message. `transopt.design.remedy` finds by trial what would help."""

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
        "a limit holds at every switching instant, where the problem states it, but is exceeded between two of them"
    )

    @property
    def admitted(self) -> bool:
        """Whether a library may have the entry: its optimum is proven or, if that is not convex, its stationarity."""
        return self in (Status.OPTIMAL, Status.STATIONARY)


Pair = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class Multipliers:
    """Lagrange multipliers of the problem, all >= 0 except those of the hand-over; unit 1 / unit of the row.

    Sign: grad J + sum (upper - lower) grad(value) = 0, `lower` for a row's lower bound, `upper` for its upper one.

    Attributes
    ----------
    stages : N.
    pairs : name of a row -> its multipliers (lower (N,), upper (N,)); those of a missing row are zero.
    hand_over : (hand_over_samples,) of the equations c_k = feedback command; (m, hand_over_samples) with m motors.
    slope : (N,) subgradient of |mean i| over period k, in [-1, 1]; the heat of the ripple depends on it. It is not a
        multiplier but a ratio of two. Where the mean current is zero, the optimum determines it.
    """

    stages: int
    pairs: Mapping[str, Pair]
    hand_over: FloatArray
    slope: FloatArray

    __repr__ = brief

    @classmethod
    def zero(cls, problem: TransientProblem, hand_over: FloatArray | None = None) -> "Multipliers":
        """The multipliers where no limit binds: all zero but, where they are given, those of the hand-over."""
        if hand_over is None:
            hand_over = np.zeros((*problem.rest.shape[:-1], problem.hand_over_samples))
        return cls(problem.grid.stages, {}, hand_over, _nothing(problem.grid.stages))

    def lower(self, row: str) -> FloatArray:
        """(N,) multipliers of a row's lower bound."""
        return self.pairs[row][0] if row in self.pairs else _nothing(self.stages)

    def upper(self, row: str) -> FloatArray:
        """(N,) multipliers of a row's upper bound."""
        return self.pairs[row][1] if row in self.pairs else _nothing(self.stages)

    def with_pair(self, row: str, lower: FloatArray, upper: FloatArray) -> "Multipliers":
        """Return a copy in which this row has these multipliers."""
        return replace(self, pairs={**self.pairs, row: (lower, upper)})

    def arrays(self) -> Iterator[FloatArray]:
        """Iterate over all arrays, the slope included."""
        for pair in self.pairs.values():
            yield from pair
        yield self.hand_over
        yield self.slope

    @property
    def largest(self) -> float:
        """The largest multiplier of a limit, whatever its unit."""
        return max(self._most.values(), default=0.0)

    def most(self, row: str) -> float:
        """The largest multiplier of a row."""
        return self._most.get(row, 0.0)

    @cached_property
    def _most(self) -> dict[str, float]:
        return {row: max(float(lower.max()), float(upper.max())) for row, (lower, upper) in self.pairs.items()}

    def clipped(self) -> "Multipliers":
        """Return a copy with every negative multiplier of a limit set to zero and the slope clipped to [-1, 1]."""
        pairs = {row: (np.maximum(low, 0.0), np.maximum(high, 0.0)) for row, (low, high) in self.pairs.items()}
        return replace(self, pairs=pairs, slope=np.minimum(np.maximum(self.slope, -1.0), 1.0))


@lru_cache(maxsize=8)
def _nothing(stages: int) -> FloatArray:
    nothing = np.zeros(stages)
    nothing.flags.writeable = False  # all callers share this array
    return nothing


@dataclass(frozen=True)
class Solution:
    """What a solver returned. Nothing in it is proof; `transopt.proof.certify` checks it independently.

    Attributes
    ----------
    status : from the solver's raw status string.
    command : (N,) commands, exactly inside the command box and exactly zero over the hand-over; (m, N) with m motors.
    multipliers : clipped to their sign.
    solver : name without version.
    message : the solver's raw status.
    iterations : -1 if the solver does not report them.
    solve_time_s : wall time of this solve: stage data included, set-up excluded. That of a designed entry includes
        the solve without limits that precedes it.
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
    merit : L of the rolled-out command, the quantity minimised; equal to J where intensity has no price.
    violations : unit -> largest excess over a limit in that unit; in A that of the hand-over too; 0 if none.
    excess : largest violation divided by its tolerance (`tolerated`); accepted up to 1.
    dual_residual : largest |reduced gradient of the Lagrangian| over the free commands [1/A].
    duality_gap : bound on L - optimum; rigorous unless the temperature binds, then that of the linearised problem.
    lower_bound : rigorous lower bound on the optimum of L.
    finite : whether all numbers that the certificate was computed from are finite.
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
    # Copper that warms makes the problem nonconvex, so L may lie above the convex bound: 0.007 to 0.06 % in the
    # built-in scenes.
    BOUND_TOLERANCE = 1e-2

    @classmethod
    def nothing(cls) -> "Certificate":
        """The certificate where a number is NaN or infinite: never accepted."""
        inf = float("inf")
        nan = float("nan")
        return cls(nan, nan, {"A": inf}, inf, inf, inf, -inf, finite=False)

    @property
    def stated_violations(self) -> dict[str, float]:
        """Unit -> violation, the units A, V and K always among them and first."""
        return {unit: self.violation(unit) for unit in dict.fromkeys(("A", "V", "K", *self.violations))}

    def violation(self, unit: str) -> float:
        """Largest excess over a limit in this unit; infinite if the certificate is not `finite`."""
        return self.violations.get(unit, 0.0 if self.finite else float("inf"))

    @property
    def relative_gap(self) -> float:
        """Duality gap over J."""
        return self.duality_gap / max(self.objective, OBJECTIVE_SCALE)

    @property
    def relative_bound(self) -> float:
        """Distance of L from its rigorous lower bound, over J."""
        return (self.merit - self.lower_bound) / max(self.objective, OBJECTIVE_SCALE)

    @property
    def primal_violation(self) -> float:
        """The largest number among the violations, whatever their units."""
        return max(self.violations.values(), default=0.0)

    @cached_property
    def is_stationary(self) -> bool:
        """Whether it is feasible with a closed duality gap: a local optimum where the temperature binds."""
        return self.finite and self._inside and self.relative_gap <= self.GAP_TOLERANCE

    @property
    def _inside(self) -> bool:
        # A comparison with NaN is false, so a NaN anywhere rejects.
        return self.excess <= 1 and all(by <= self.VIOLATION_TOLERANCE for by in self.violations.values())

    @property
    def accepted(self) -> bool:
        """Whether it proves the command optimal."""
        return self.is_stationary and -self.GAP_TOLERANCE <= self.relative_bound <= self.BOUND_TOLERANCE

    @property
    def shortfall(self) -> str:
        """Why it is not accepted, in a phrase; empty where it is."""
        if self.accepted:
            return ""
        if not self.finite:
            return "not certified: its numbers do not stay finite"
        if not self._inside:
            over = ", ".join(f"{by:.3g} {unit}" for unit, by in self.stated_violations.items() if not by <= 0)
            return f"not certified: a limit is violated by {over}"
        if not self.is_stationary:
            gap, limit = f"{self.relative_gap:.1e} above the optimum", f"{self.GAP_TOLERANCE:.0e}"
            return f"not certified: no stationary point, may lie {gap}, limit {limit}"
        if self.relative_bound > self.BOUND_TOLERANCE:
            return f"J lies {self.relative_bound:.1%} above the convex lower bound, limit {self.BOUND_TOLERANCE:.0%}"
        return f"not certified: its lower bound {self.lower_bound:.8g} lies above it, at {self.merit:.8g}"


def held_back(
    tap_error: float, floor: float, objective: float, unlimited_objective: float, binding: str
) -> list[str]:
    """The limits that hold an entry back, in the words of `binding`; empty for an entry that they cost nothing.

    The tap error alone does not tell: J weighs the motion after the waveform as well, so that a limited optimum with
    a far larger J may have a smaller tap error than the optimum without limits.

    Parameters
    ----------
    floor : tap error of the optimum without limits; if it is NaN, every binding limit counts as holding back.
    objective, unlimited_objective : J of the entry, and of the optimum without limits; NaN if unknown.
    """
    costs_J = objective > (math.sqrt(max(unlimited_objective, 0.0)) + AT_FLOOR) ** 2
    costs = costs_J or not tap_error <= floor + AT_FLOOR
    return binding.split("; ") if costs and binding not in ("", "none") else []


def verdict(
    figures: Figures,
    floor: float,
    repeatability: float,
    levels: Levels,
    held: Sequence[str],
    *,
    named: bool,
    least_input: tuple[float, str] | None = None,
) -> str:
    """How near an entry comes to the recorded tap, what holds it back, and what the hand notices of it.

    A hand recognises a surface by the intensity of the tap more than by its waveform, so the intensity comes first:
    within the just noticeable difference, or too weak or strong, and in which band most. A waveform that is far off
    at the right intensity is stated as well. The waveform ends while the hand still pushes, so even the optimum
    without limits has an error, the floor.

    Parameters
    ----------
    floor : tap error of the optimum without limits.
    repeatability : trial-to-mean error of the recordings, NaN if unknown.
    held : the limits that hold the entry back, of `held_back`.
    named : whether the entry is for a named target, which involves no hand.
    least_input : smallest value of the plant's input, and its unit; None if it is not known.
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
    elif held:
        limits = dict.fromkeys(END_OF_LIMIT_NAME.split(part)[0].strip() for part in held)
        said.append(f"held back by {' and '.join(limits)}")
    elif figures.tap_error <= floor + AT_FLOOR:
        ends = not named and floor > MIN_FLOOR_OF_PUSHING_HAND
        said.append("at its floor" + (": the waveform ends while the hand pushes" if ends else ""))
    if figures.speed < MAX_SPEED_OF_PULLING:
        said.append("the surface pulls")
        if least_input is not None and least_input[0] < 0:
            said[-1] += f", by up to {-least_input[0]:.2f} {least_input[1]}"
    return "; ".join(said)
