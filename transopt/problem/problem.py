"""The optimal-control problem of one library entry: terms of the objective, limits, hand-over."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.discretise import Motion, StageModel, TimeGrid
from transopt.plant.wall import HandOver, feedback_command
from transopt.problem.limits.limit import Limit, Limits, Row
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.objective.movement import Movement
from transopt.problem.objective.tracking import Tracking
from transopt.problem.objective.weighting import ErrorFilter

ZERO_REFERENCE_M_S2 = 1e-3  # a reference with a smaller rms is zero
LARGEST_M_S2 = 1e100  # whose square and all that is made of it double precision can hold


@dataclass(frozen=True)
class TransientProblem:
    """Make the device accelerate like the reference, within the limits, from rest.

    minimise  sum_k w_k (F e)_k^2 / sum_k r_k^2 + rho / (N I^2) sum_k (dc_k 1e-4 s / dt)^2,  e_k = y''_k - r_k,
    over the commands c_0..c_(N-1), dc_k = c_k - c_(k-1), c_(-1) = 0, I = `limits.current_A`,
    subject to the stage model, the limits, and the hand-over: over the last `hand_over_samples` the command is
    what the wall's feedback asks for, zero without a wall. Each term is a room: `objective.tracking`,
    `objective.movement`; so is each limit, in `limits`.

    Attributes
    ----------
    stage : exact stage model of this grip's device.
    grid : time axis; `grid.stages` = N.
    reference_m_s2 : (N,) r at the switching instants.
    tracking_weights : (N,) w_k >= 0.
    rho : weight of the command's movement, >= 0.
    limits : what bounds the command and all that follows from it.
    wall : the virtual wall over the hand-over; None without one.
    error_filter : F; None for 1.
    spread : further devices that the one command shall serve; the first term is then the mean over all.
    """

    stage: StageModel
    grid: TimeGrid
    reference_m_s2: FloatArray
    tracking_weights: FloatArray
    rho: float
    limits: Limits
    hand_over_samples: int
    wall: HandOver | None = None
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

    def rows(self) -> tuple[tuple[Limit, Row], ...]:
        """Every row of every limit."""
        return self._rows

    @cached_property
    def _rows(self) -> tuple[tuple[Limit, Row], ...]:
        return tuple((limit, row) for limit in self.limits for row in limit.rows(self))

    def without(self, *names: str) -> "TransientProblem":
        """The same problem without the limits of these names."""
        if not any(name in self.limits for name in names):
            return self
        return replace(self, limits=self.limits.without(*names))

    def replaced(self, limit: Limit) -> "TransientProblem":
        """The same problem with this limit in the place of the one of its name."""
        return replace(self, limits=self.limits.replaced(limit))

    @property
    def nonlinear(self) -> tuple[str, ...]:
        """Names of the limits that a quadratic program cannot have."""
        return tuple(limit.name for limit in self.limits if not limit.linear)

    @cached_property
    def thermal(self) -> TemperatureLimit | None:
        """The limit that has states of its own; None in a quadratic problem."""
        found = self.limits.get(TemperatureLimit.name)
        assert found is None or isinstance(found, TemperatureLimit)
        return found

    @property
    def command_bound_A(self) -> float:
        """The bound on |c| that every admissible command obeys."""
        return self.limits.command_bound_A(ideal=self.stage.amplifier is None)

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
        return min(self.command_bound_A, *(limit.reach_A(self.grid) for limit in self.limits))

    @property
    def tracking(self) -> Tracking:
        """The first term."""
        return Tracking(self.reference_m_s2, self.tracking_weights, self.error_filter)

    @property
    def movement(self) -> Movement:
        """The second term."""
        return Movement(self.rho, self.grid.stages, self.grid.dt_s, self.limits.current_A)

    @property
    def devices(self) -> tuple[StageModel, ...]:
        """The device and those of the spread."""
        return (self.stage, *self.spread)

    def accelerations(self, command_A: FloatArray) -> FloatArray:
        """(S, N) y'' of every device, the entry's own first."""
        return np.stack([device.rollout(command_A)[0] for device in self.devices])

    def objective(self, command_A: FloatArray, accelerations_m_s2: FloatArray) -> float:
        """J of a command (N,) and the accelerations (S, N) it was rolled out to; dimensionless."""
        return self.tracking.value(accelerations_m_s2) + self.movement.value(command_A)

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
