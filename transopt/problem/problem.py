"""The optimal-control problem of one library entry, and what an answer to it consists of (DESIGN 4)."""

from dataclasses import dataclass, fields
from enum import Enum

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.circuit import Supply
from transopt.plant.discretise import Motion, StageModel, TimeGrid
from transopt.plant.wall import HandOver, feedback_command
from transopt.problem.heat import ThermalLimit
from transopt.problem.objective.weighting import ErrorFilter

OBJECTIVE_SCALE = 1e-3  # objectives below this count as this in relative comparisons
AT_FLOOR = 1e-3  # an NRMSE within 0.1 % of the floor is at the floor
AMPLITUDE_THRESHOLD = 0.2  # just noticeable difference of vibration amplitude, about 1.8 dB
ZERO_REFERENCE_M_S2 = 1e-3  # a reference with a smaller rms is zero
LARGEST_M_S2 = 1e100  # whose square and all that is made of it double precision can hold
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

    minimise  sum_k w_k (F e)_k^2 / sum_k r_k^2 + rho / (N I^2) sum_k (dc_k 1e-4 s / dt)^2,  e_k = y''_k - r_k,
    over the commands c_0..c_(N-1), dc_k = c_k - c_(k-1), c_(-1) = 0, I = `limits.current_A`,
    subject to the stage model, the limits, and the hand-over: over the last `hand_over_samples` the command is
    what the wall's feedback asks for, zero without a wall.

    Attributes
    ----------
    stage : exact stage model of this grip's device.
    grid : time axis; `grid.stages` = N.
    reference_m_s2 : (N,) r at the switching instants.
    tracking_weights : (N,) w_k >= 0.
    rho : weight of the command's movement, >= 0.
    supply, wall, thermal, error_filter : None where the problem has no such part; F is 1 without a filter.
    spread : further devices that the one command shall serve; the first term is then the mean over all.
    """

    stage: StageModel
    grid: TimeGrid
    reference_m_s2: FloatArray
    tracking_weights: FloatArray
    rho: float
    limits: Limits
    hand_over_samples: int
    supply: Supply | None = None
    wall: HandOver | None = None
    thermal: ThermalLimit | None = None
    error_filter: ErrorFilter | None = None
    spread: tuple[StageModel, ...] = ()

    __repr__ = brief

    def __post_init__(self) -> None:
        N = self.grid.stages
        for name in ("reference_m_s2", "tracking_weights"):
            array = getattr(self, name)
            if array.shape != (N,):
                raise InputError(f"{name} has shape {array.shape}, expected ({N},)")
            if not np.isfinite(array).all():
                raise InputError(f"{name} holds a number that is not finite")
        largest = max(float(self.reference_m_s2.max()), -float(self.reference_m_s2.min()))
        if largest > LARGEST_M_S2:
            raise InputError(
                f"reference_m_s2 reaches {largest:g} m/s^2: must stay below {LARGEST_M_S2:g}, where squares "
                "overflow; check its unit"
            )
        if self.tracking_weights.min() < 0 or not 0 <= self.rho < np.inf:
            raise InputError("weights: tracking weights and rho must be >= 0 and finite")
        if not 1 <= self.hand_over_samples <= N:
            raise InputError(
                f"hand_over_samples = {self.hand_over_samples}: must be between 1 and the {N} stages, "
                "so that the transient ends"
            )
        if self.wall is not None and self.stage.Cp is None:
            raise InputError("a wall needs the encoder position: discretise the device with its position")

    @property
    def reference_is_zero(self) -> bool:
        r = self.reference_m_s2
        return float(r @ r) < ZERO_REFERENCE_M_S2**2 * r.size

    @property
    def free_stages(self) -> int:
        """Number of commands before the hand-over."""
        return self.grid.stages - self.hand_over_samples

    @property
    def current_scale_A(self) -> float:
        """Largest current that the limits leave: the unit in which it is of order one."""
        limits = self.limits
        reach = np.inf if limits.slew_A_per_s is None else limits.slew_A_per_s * self.grid.dt_s * self.grid.stages
        return min(limits.current_A, limits.command_bound_A, reach)

    @property
    def movement_weight(self) -> float:
        """rho (1e-4 s / dt)^2 / (N I^2): the weight of dc_k^2 [1/A^2]."""
        step = SMOOTHNESS_STEP_S / self.grid.dt_s
        return self.rho * step**2 / (self.grid.stages * self.limits.current_A**2)

    @property
    def devices(self) -> tuple[StageModel, ...]:
        """The device and those of the spread."""
        return (self.stage, *self.spread)

    def accelerations(self, command_A: FloatArray) -> FloatArray:
        """(S, N) y'' of every device, the entry's own first."""
        return np.stack([device.rollout(command_A)[0] for device in self.devices])

    def weighted_error(self, accelerations_m_s2: FloatArray) -> FloatArray:
        """(..., N) F e."""
        error = accelerations_m_s2 - self.reference_m_s2
        return error if self.error_filter is None else self.error_filter.apply(error)

    def objective(self, command_A: FloatArray, accelerations_m_s2: FloatArray) -> float:
        """J of a command (N,) and the accelerations (S, N) it was rolled out to; dimensionless."""
        r = self.reference_m_s2
        error = np.atleast_2d(self.weighted_error(accelerations_m_s2))
        movement = np.diff(command_A, prepend=0.0)
        tracking = float(np.mean(error**2 @ self.tracking_weights)) / float(r @ r)
        return tracking + self.movement_weight * float(movement @ movement)

    def weighted_nrmse(self, acceleration_m_s2: FloatArray) -> float:
        """|F e| / |F r|: the NRMSE as the filter hears it."""
        r = self.reference_m_s2
        filtered = r if self.error_filter is None else self.error_filter.apply(r)
        return float(np.linalg.norm(self.weighted_error(acceleration_m_s2)) / np.linalg.norm(filtered))

    def encoder_at_ticks(self, motion: Motion) -> FloatArray:
        """(N,) y of the motor mass at the ticks t_k."""
        late = self.stage.whole_delay + 1
        return np.append(np.zeros(late), motion.encoder_m)[: self.grid.stages]

    def hand_over_command(self, motion: Motion) -> FloatArray:
        """(N,) command that the predicted feedback asks for; zero without a wall."""
        if self.wall is None:
            return np.zeros(self.grid.stages)
        dt = self.grid.dt_s
        return feedback_command(
            self.wall.masked_feedback(self.encoder_at_ticks(motion), dt), self.stage.amplifier, dt
        )

    def transient_command(self, command_A: FloatArray) -> FloatArray:
        """(N,) what remains of a total command when the wall's predicted feedback is taken off (seed Eq. 9)."""
        if self.wall is None:
            return command_A.copy()
        dt = self.grid.dt_s
        course = self.encoder_at_ticks(self.stage.motion(command_A))
        transient = command_A - feedback_command(self.wall.feedback(course, dt), self.stage.amplifier, dt)
        # Zero to rounding by the hand-over's constraint; what is handed over is nothing at all.
        transient[self.free_stages :] = 0.0
        return transient


class Status(Enum):
    """How an entry ended; the value is the message and the remedy."""

    OPTIMAL = "optimal"
    ITERATION_LIMIT = "the solver stopped at its iteration limit: loosen the tolerance or choose another --solver"
    INFEASIBLE = "no command meets all limits"
    NUMERICAL_FAILURE = "the solver broke down numerically: choose another --solver or rescale the scene"
    NOT_GLOBAL = (
        "a certified stationary point, but the convex bound leaves room for a better one: lower the temperature that "
        "the winding may reach or the rate of taps, so that the copper warms less"
    )
    NOT_CERTIFIED = "the answer is not proven optimal: tighten --solver-tolerance or choose another --solver"
    REPLAY_VIOLATION = (
        "the continuous-time replay leaves a limit or misses the prediction: report this scene as a defect"
    )
    HAND_OVER = (
        "the wall's feedback alone exceeds a limit when the transient has to end: lower feedback.stiffness_N_m or "
        "the speed, or shorten time.stages so that the stylus is less deep"
    )
    PRECISION = (
        "double precision has no digits left to prove the answer: state the problem with limits nearer to what the "
        "answer takes, or fewer stages"
    )
    UNSTABLE_WALL = (
        "the wall's feedback grows by itself on this device: lower feedback.stiffness_N_m, feedback.damping_N_s_m or "
        "feedback.latency_ticks"
    )
    UNRESOLVED = (
        "a limit is kept at every switching instant, as the problem states it, but left within a servo period: "
        "shorten time.dt_s"
    )


@dataclass(frozen=True)
class Multipliers:
    """Lagrange multipliers of J's problem, all >= 0 except `hand_over`; units 1/A, 1/V and 1/K.

    Sign: grad J + sum (upper - lower) grad(constraint) = 0, `lower` for the limit -I, `upper` for +I.
    A pair that the problem does not have is zero.

    Attributes
    ----------
    current_lower, current_upper : (N,) of the box on i at the switching instants.
    command_lower, command_upper : (N,) of the box on c.
    slew_lower, slew_upper : (N,) of the box on dc.
    supply_before_lower, ..., supply_after_upper : (N,) of the voltage just before and after the switching instants.
    temperature_upper : (N,) of the winding's limit at tau_(k+1).
    current_sign : (N,) slope of |mean i| over period k, -1 to 1, by which the ripple heats; no multiplier itself,
        but a ratio of two: where the mean current is zero, the optimum decides which it is.
    hand_over : (hand_over_samples,) of c_k = feedback command.
    """

    current_lower: FloatArray
    current_upper: FloatArray
    command_lower: FloatArray
    command_upper: FloatArray
    slew_lower: FloatArray
    slew_upper: FloatArray
    supply_before_lower: FloatArray
    supply_before_upper: FloatArray
    supply_after_lower: FloatArray
    supply_after_upper: FloatArray
    temperature_upper: FloatArray
    current_sign: FloatArray
    hand_over: FloatArray

    __repr__ = brief

    @classmethod
    def zero(cls, problem: TransientProblem) -> "Multipliers":
        """No limit binds."""
        nothing = np.zeros(problem.grid.stages)
        nothing.flags.writeable = False  # it stands for all of them
        return cls(**dict.fromkeys(STAGEWISE, nothing), hand_over=np.zeros(problem.hand_over_samples))

    @property
    def largest(self) -> float:
        """The largest multiplier of a limit, whatever its unit."""
        return max(float(getattr(self, name).max()) for name in OF_LIMITS)

    def clipped(self) -> "Multipliers":
        """The same with every negative multiplier of a limit set to zero."""
        limits = {name: np.maximum(getattr(self, name), 0.0) for name in OF_LIMITS}
        sign = np.minimum(np.maximum(self.current_sign, -1.0), 1.0)
        return Multipliers(**limits, current_sign=sign, hand_over=self.hand_over)


# Multipliers that are (N,); of these, those of limits: the others are of an equation, and a slope.
STAGEWISE = tuple(field.name for field in fields(Multipliers) if field.name != "hand_over")
OF_LIMITS = tuple(name for name in STAGEWISE if name != "current_sign")


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

    __repr__ = brief


@dataclass(frozen=True)
class Certificate:
    """Proof of optimality from the command's rollout and the multipliers, never from the solver.

    Attributes
    ----------
    objective : J of the rolled-out command.
    primal_violation_A : largest excess over a current, command or slew limit, and at the hand-over [A], 0 if none.
    primal_violation_V, primal_violation_K : the same of the supply and of the temperature.
    excess : the largest of the violations in units of its tolerance (`tolerated`); at most 1 is accepted.
    dual_residual : largest |reduced gradient of the Lagrangian| over the free commands [1/A].
    duality_gap : bound on J - optimum; rigorous unless the temperature binds, then that of the linearised problem.
    lower_bound : rigorous bound on the optimum from below.
    finite : every number that went in was finite.
    """

    objective: float
    primal_violation_A: float
    primal_violation_V: float
    primal_violation_K: float
    excess: float
    dual_residual: float
    duality_gap: float
    lower_bound: float
    finite: bool

    VIOLATION_TOLERANCE = 1e-6  # A, V or K; of the limit where that is below 1 A or 1 V
    GAP_TOLERANCE = 1e-6
    BOUND_TOLERANCE = 1e-2  # copper that warms makes the problem nonconvex; trials 0.06 to 0.2 %

    __repr__ = brief

    @classmethod
    def nothing(cls) -> "Certificate":
        """Of numbers that are not finite."""
        inf = float("inf")
        return cls(float("nan"), inf, inf, inf, inf, inf, inf, -inf, finite=False)

    @classmethod
    def tolerated(cls, limit: float) -> float:
        """By how much a limit in A or V may be left: a microampere is nothing at 1 A and everything at 1e-6 A."""
        return cls.VIOLATION_TOLERANCE * min(limit, 1.0)

    @property
    def relative_gap(self) -> float:
        return self.duality_gap / max(self.objective, OBJECTIVE_SCALE)

    @property
    def relative_bound(self) -> float:
        """How far J lies above the rigorous lower bound, relative."""
        return (self.objective - self.lower_bound) / max(self.objective, OBJECTIVE_SCALE)

    @property
    def primal_violation(self) -> float:
        """The largest of the violations, each in its unit."""
        return max(self.primal_violation_A, self.primal_violation_V, self.primal_violation_K)

    @property
    def is_stationary(self) -> bool:
        """Feasible, and no better nearby: all but the rigorous bound where the temperature binds."""
        # Written so that a NaN anywhere rejects.
        tolerance = self.VIOLATION_TOLERANCE
        return (
            self.finite
            and self.primal_violation_A <= tolerance
            and self.primal_violation_V <= tolerance
            and self.primal_violation_K <= tolerance
            and self.excess <= 1
            and self.relative_gap <= self.GAP_TOLERANCE
        )

    @property
    def accepted(self) -> bool:
        return self.is_stationary and -self.GAP_TOLERANCE <= self.relative_bound <= self.BOUND_TOLERANCE


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
