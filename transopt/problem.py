"""The optimal-control problem of one library entry, and what an answer to it consists of (DESIGN 4)."""

from dataclasses import dataclass, fields, replace
from enum import Enum

import numpy as np

from transopt.discretise import StageModel, TimeGrid
from transopt.errors import InputError
from transopt.signals import FloatArray

OBJECTIVE_SCALE = 1e-3  # objectives below this count as this in relative comparisons
AT_FLOOR = 1e-3  # an NRMSE within 0.1 % of the floor is at the floor
AMPLITUDE_THRESHOLD = 0.2  # just noticeable difference of vibration amplitude, about 1.8 dB
ZERO_REFERENCE_M_S2 = 1e-3  # a reference with a smaller rms is zero
SMOOTHNESS_STEP_S = 1e-4  # the servo period at which rho is stated


@dataclass(frozen=True)
class Limits:
    """Hard limits on the total current, enforced at the switching instants.

    Attributes
    ----------
    current_A : |i(t)| for all t (seed Eq. 8), > 0.
    command_A : |c_k|; None for an ideal amplifier, where c = i.
    slew_A_per_s : |c_k - c_(k-1)| / dt; None for no such limit.
    """

    current_A: float
    command_A: float | None
    slew_A_per_s: float | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None and not 0 < value < np.inf:
                raise InputError(f"limits.{field.name} = {value:g}: must be > 0 and finite")

    @property
    def command_bound_A(self) -> float:
        """The bound on |c| that every admissible command obeys."""
        return self.current_A if self.command_A is None else self.command_A


@dataclass(frozen=True)
class TransientProblem:
    """Make the device accelerate like the reference, within the limits, from rest.

    minimise  sum_k w_k (y''_k - r_k)^2 / sum_k r_k^2 + rho / (N I^2) sum_k (dc_k 1e-4 s / dt)^2
    over the commands c_0..c_(N-1), dc_k = c_k - c_(k-1), c_(-1) = 0, I = `limits.current_A`,
    subject to the stage model, the limits, and c_k = 0 over the last `hand_over_samples`.

    Attributes
    ----------
    stage : exact stage model of this grip's device.
    grid : time axis; `grid.stages` = N.
    reference_m_s2 : (N,) r at the switching instants.
    tracking_weights : (N,) w_k >= 0.
    rho : weight of the command's movement, >= 0.
    """

    stage: StageModel
    grid: TimeGrid
    reference_m_s2: FloatArray
    tracking_weights: FloatArray
    rho: float
    limits: Limits
    hand_over_samples: int

    def __post_init__(self) -> None:
        N = self.grid.stages
        for name in ("reference_m_s2", "tracking_weights"):
            array = getattr(self, name)
            if array.shape != (N,):
                raise InputError(f"{name} has shape {array.shape}, expected ({N},)")
            if not np.all(np.isfinite(array)):
                raise InputError(f"{name} holds a number that is not finite")
        if np.any(self.tracking_weights < 0) or not 0 <= self.rho < np.inf:
            raise InputError("weights: tracking weights and rho must be >= 0 and finite")
        if not 1 <= self.hand_over_samples <= N:
            raise InputError(
                f"hand_over_samples = {self.hand_over_samples}: must be between 1 and the {N} stages, "
                "so that the transient ends"
            )

    @property
    def reference_is_zero(self) -> bool:
        r = self.reference_m_s2
        return float(r @ r) < ZERO_REFERENCE_M_S2**2 * r.size

    @property
    def free_stages(self) -> int:
        """Number of commands before the hand-over."""
        return self.grid.stages - self.hand_over_samples

    @property
    def movement_weight(self) -> float:
        """rho (1e-4 s / dt)^2 / (N I^2): the weight of dc_k^2 [1/A^2]."""
        step = SMOOTHNESS_STEP_S / self.grid.dt_s
        return self.rho * step**2 / (self.grid.stages * self.limits.current_A**2)

    def objective(self, command_A: FloatArray, acceleration_m_s2: FloatArray) -> float:
        """J of a command (N,) and the acceleration (N,) it was rolled out to; dimensionless."""
        r = self.reference_m_s2
        error = acceleration_m_s2 - r
        movement = np.diff(command_A, prepend=0.0)
        tracking = float(self.tracking_weights @ error**2) / float(r @ r)
        return tracking + self.movement_weight * float(movement @ movement)


class Status(Enum):
    """How a solve ended; the value is the message and the remedy."""

    OPTIMAL = "optimal"
    ITERATION_LIMIT = "the solver stopped at its iteration limit: loosen the tolerance or choose another --solver"
    INFEASIBLE = "no command meets all limits: raise the limit named beside this or shorten the hand-over"
    NUMERICAL_FAILURE = "the solver broke down numerically: choose another --solver or rescale the scene"
    NOT_CERTIFIED = "the answer is not proven optimal: tighten --solver-tolerance or choose another --solver"
    REPLAY_VIOLATION = (
        "the continuous-time replay leaves a limit or misses the prediction: report this scene as a defect"
    )
    TEMPERATURE_MAY_BIND = (
        "the coil could pass its temperature limit and temperature is not yet part of the problem: "
        "lower limits.current_A or thermal.start_winding_C, or shorten time.stages"
    )


@dataclass(frozen=True)
class Multipliers:
    """Lagrange multipliers of J's problem, all >= 0 except `hand_over`; units 1/A.

    Sign: grad J + sum (upper - lower) grad(constraint) = 0, `lower` for the limit -I, `upper` for +I.
    A pair that the problem does not have is zero.

    Attributes
    ----------
    current_lower, current_upper : (N,) of the box on i at the switching instants.
    command_lower, command_upper : (N,) of the box on c.
    slew_lower, slew_upper : (N,) of the box on dc.
    hand_over : (hand_over_samples,) of c_k = 0.
    """

    current_lower: FloatArray
    current_upper: FloatArray
    command_lower: FloatArray
    command_upper: FloatArray
    slew_lower: FloatArray
    slew_upper: FloatArray
    hand_over: FloatArray

    @classmethod
    def zero(cls, problem: TransientProblem) -> "Multipliers":
        """No limit binds."""
        zero = np.zeros(problem.grid.stages)
        return cls(zero, zero, zero, zero, zero, zero, np.zeros(problem.hand_over_samples))

    def clipped(self) -> "Multipliers":
        """The same with every negative multiplier of a limit set to zero."""
        limits = {f.name: np.maximum(getattr(self, f.name), 0.0) for f in fields(self) if f.name != "hand_over"}
        return replace(self, **limits)


@dataclass(frozen=True)
class Solution:
    """What a solver returned, in its own words: nothing here is proof (see `certify`).

    Attributes
    ----------
    status : typed from the solver's raw status string.
    command_A : (N,) commands, exactly inside the command box and exactly zero over the hand-over.
    multipliers : clipped to their sign.
    solver : name, version-free.
    message : the solver's raw status.
    iterations : -1 where the solver does not tell.
    solve_time_s : wall time of this solve, stage data included, set-up excluded; a designed entry's includes
        the unlimited solve before it.
    """

    status: Status
    command_A: FloatArray
    multipliers: Multipliers
    solver: str
    message: str
    iterations: int
    solve_time_s: float


@dataclass(frozen=True)
class Certificate:
    """Proof of optimality from the command's rollout and the multipliers, never from the solver.

    Attributes
    ----------
    objective : J of the rolled-out command.
    primal_violation_A : largest excess over a current or command limit [A], 0 if none.
    dual_residual : largest |reduced gradient of the Lagrangian| over the free commands [1/A].
    duality_gap : rigorous bound on J - optimum.
    finite : every number that went in was finite.
    """

    objective: float
    primal_violation_A: float
    dual_residual: float
    duality_gap: float
    finite: bool

    VIOLATION_TOLERANCE_A = 1e-6
    GAP_TOLERANCE = 1e-6

    @property
    def relative_gap(self) -> float:
        return self.duality_gap / max(self.objective, OBJECTIVE_SCALE)

    @property
    def accepted(self) -> bool:
        # Written so that a NaN anywhere rejects.
        return (
            self.finite
            and self.primal_violation_A <= self.VIOLATION_TOLERANCE_A
            and self.relative_gap <= self.GAP_TOLERANCE
        )


def verdict(nrmse: float, floor: float, repeatability: float) -> str:
    """How good an entry is, in terms of what limits it or of what a hand can feel.

    Parameters
    ----------
    repeatability : trial-to-mean NRMSE of the recordings, NaN if unknown.
    """
    if nrmse > AMPLITUDE_THRESHOLD:
        # Nothing to be proud of, even where the floor is no lower.
        return "above 20 % threshold"
    if nrmse <= floor + AT_FLOOR:
        return "at its floor"
    return "below repeatability" if nrmse <= repeatability else "below 20 % threshold"
