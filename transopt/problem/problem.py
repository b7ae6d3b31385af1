"""The optimal-control problem of one library entry: terms of the objective, limits, hand-over."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.discretise import Motion, StageModel, TimeGrid
from transopt.plant.intention import INTENTION_S
from transopt.plant.state_space import Input
from transopt.plant.wall import HandOver, feedback_command
from transopt.problem.after import Feedback
from transopt.problem.limits.limit import Limit, Limits, Row
from transopt.problem.limits.output import OutputLimit
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.figures import Figures, Yardstick
from transopt.problem.objective.heat_price import HeatPrice
from transopt.problem.objective.movement import Movement
from transopt.problem.objective.target import Target
from transopt.problem.objective.tracking import Tracking


@dataclass(frozen=True)
class TransientProblem:
    """Make the device accelerate like the target, within the limits, from rest.

    minimise  sum over terms sum_k weight_k (F e)_k^2 / E + rho / (N I^2) sum_k (dc_k 1e-4 s / dt)^2
              + heat_price sum_(k<N) i_k^2,  e = y'' - (r - a_free),
    over the commands c_0..c_(N-1), dc_k = c_k - c_(k-1), c_(-1) = 0, I = `limits.current_A`, i what drives the plant,
    subject to the stage model, the limits, and the hand-over: over the last `hand_over_samples` the command is
    what the wall's feedback asks for, zero without a wall; so it stays after the window. Every part of the objective
    is a room of `objective`: `error_term` with `plain` and `rapid`, `tracking`, `movement`, `heat_price`; so is each
    limit, in `limits`.

    A plant with m motors has commands (m, N) and limits for each motor, all squares being summed over the motors.
    Of a plant with p directions each has a target and a weight of its own (`shares`), the normal of the surface
    first. Such a plant can have no wall, no spread, no price on intensity, and no limit that is not `of_each_motor`.

    Attributes
    ----------
    stage : exact stage model of this grip's device.
    grid : time axis; `grid.stages` = N, `grid.after_stages` = M.
    target : r - a_free, with what is lost before tau_0 and what comes after tau_N.
    terms : of the error e; the last one is that whose energy intensity is about.
    rho : weight of the command's movement, >= 0.
    limits : what bounds the command and all that follows from it.
    wall : the virtual wall over the hand-over; None without one.
    spread : further devices that the one command shall serve; the error is then the mean over all.
    shares : (S,) of all devices in that mean, of sum one; None for equal ones. Of a plant with several directions
        their weights (p,), >= 0, the first above 0.
    worst : the error is that of the worst device; `shares` are its multipliers then (`objective.tracking`).
    heat_price : of the squared input, >= 0 [1/A^2 or 1/V^2].
    intention_s : for so long after contact a played tap is told against the recorded one; all of a named target.
    named : whether the target is named, and no tap.
    intensity : lam, price of the energy that y'' lacks; what is minimised is then L = J - lam [sum (F y'')^2
        - 10^(intensity_dB / 10) sum (F (r - a_free))^2] / E, both sums over the window. 0 minimises J.
    intensity_dB : energy of the tap that is asked for, over the target's [dB].
    """

    stage: StageModel
    grid: TimeGrid
    target: Target
    terms: tuple[ErrorTerm, ...]
    rho: float
    limits: Limits
    hand_over_samples: int
    wall: HandOver | None = None
    spread: tuple[StageModel, ...] = ()
    shares: FloatArray | None = None
    worst: bool = False
    heat_price: float = 0.0
    intention_s: float = INTENTION_S
    named: bool = False
    intensity: float = 0.0
    intensity_dB: float = 0.0

    __repr__ = brief

    def __post_init__(self) -> None:
        N, M = self.grid.stages, self.grid.after_stages
        for name, array, size in (
            ("reference_m_s2", self.target.window_m_s2, N),
            ("reference_after_m_s2", self.target.after_m_s2, M),
            ("reference_before_m_s2", self.target.before_m_s2, self.target.lost),
            *((f"weights of the {term.name} term", term.weights, N) for term in self.terms),
        ):
            of_direction = self.directions if name.startswith("reference") else ()
            if array.shape != (*of_direction, size):
                raise InputError(f"{name} has shape {array.shape}, expected {(*of_direction, size)}")
        if self.target.flaw:
            raise InputError(self.target.flaw)
        if not self.terms:
            raise InputError("weights: no term of the error: give weights.plain or weights.rapid")
        for term in self.terms:
            if not term.is_sound:
                raise InputError(f"weights of the {term.name} term: must be >= 0 and finite")
        for name, value in (("rho", self.rho), ("heat_price", self.heat_price)):
            if not 0 <= value < np.inf:
                raise InputError(f"weights.{name} = {value:g}: must be >= 0 and finite")
        if not (self.intensity == 0 or 0 < self.intensity < min(1.0, self.terms[-1].weights.min())):
            raise InputError(
                f"intensity {self.intensity:g}: must be >= 0, below 1 and below every weight of the "
                f"{self.terms[-1].name} term"
            )
        self._check_several()
        if (
            self.shares is not None
            and not self.directions
            and not (
                self.shares.shape == (len(self.devices),)
                and self.shares.min() >= 0
                and abs(self.shares.sum() - 1) < 1e-9
            )
        ):
            raise InputError(f"shares: must be one >= 0 for each of the {len(self.devices)} devices, of sum one")
        if not 1 <= self.hand_over_samples <= N:
            raise InputError(
                f"hand_over_samples = {self.hand_over_samples}: must be between 1 and the {N} stages, "
                "so that the transient ends"
            )
        if self.wall is not None and self.stage.Cp is None:
            raise InputError("a wall needs the encoder position: discretise the device with its position")

    def _check_several(self) -> None:
        """
        Raises
        ------
        InputError : what a plant with several motors or directions cannot have.
        """
        if not self.directions and self.stage.motors == 1:
            return
        said = f"a plant with {self.stage.motors} motors and {self.stage.tracked} directions"
        p, shares = self.stage.tracked, self.shares
        if self.directions and (
            shares is None
            or shares.shape != (p,)
            or not np.isfinite(shares).all()
            or not shares.min() >= 0 < shares[0]
        ):
            raise InputError(f"shares: {said} needs {p} weights >= 0, the first above 0")
        unfit = {
            "feedback": self.wall is not None,
            "robust": bool(self.spread),
            "weights.objective": self.intensity > 0,
            **{f"limits.{limit.key or limit.name}": not limit.of_each_motor for limit in self.limits},
        }
        for key, there in unfit.items():
            if there:
                raise InputError(f"{key}: {said} cannot have it yet; leave it out")

    @property
    def directions(self) -> tuple[int, ...]:
        """(p,) of a plant with several directions; empty for one."""
        return () if self.stage.tracked == 1 else (self.stage.tracked,)

    @cached_property
    def rest(self) -> FloatArray:
        """(N,) or (m, N) no command at all."""
        motors = () if self.stage.motors == 1 else (self.stage.motors,)
        return np.zeros((*motors, self.grid.stages))

    def rows(self) -> tuple[tuple[Limit, Row], ...]:
        """Every row of every limit."""
        return self._rows

    @cached_property
    def _rows(self) -> tuple[tuple[Limit, Row], ...]:
        return tuple((limit, row) for limit in self.limits for row in limit.rows(self))

    def without(self, *names: str) -> "TransientProblem":
        """Leave out the limits of these names."""
        if not any(name in self.limits for name in names):
            return self
        return self._under(self.limits.without(*names))

    def alone(self) -> "TransientProblem":
        """Pose the problem for its own device alone, with no price on intensity."""
        return replace(self.without_intensity(), spread=(), shares=None, worst=False)

    def replaced(self, limit: Limit) -> "TransientProblem":
        """Put this limit in the place of the one of its name."""
        return self._under(self.limits.replaced(limit))

    def _under(self, limits: Limits) -> "TransientProblem":
        """Pose the problem under other limits; what they have no say in is not computed again."""
        found = replace(self, limits=limits)
        for name in ("tracking", "shared", "feedback", "reference_is_zero"):
            if name in vars(self):
                vars(found)[name] = vars(self)[name]
        return found

    def within(self, parts: Mapping[str, int]) -> "TransientProblem":
        """State limits on outputs at the ends of so many parts of every servo period, by their names.

        Those that are not named stay as they are.
        """
        limits, instants = self.limits, dict(self.stage.instants)
        for limit in limits:
            if isinstance(limit, OutputLimit) and limit.name in parts:
                limits = limits.replaced(limit.within(self, parts[limit.name]))
                instants[limit.output] = limit.shares(parts[limit.name])
        stage, *spread = (device.within(instants) for device in self.devices)
        return replace(self._under(limits), stage=stage, spread=tuple(spread))

    @property
    def parts(self) -> dict[str, int]:
        """Name of a limit on an output -> parts of a servo period at whose ends it is stated."""
        return {limit.name: limit.parts for limit in self.limits if isinstance(limit, OutputLimit)}

    def without_intensity(self) -> "TransientProblem":
        """Take the price on intensity away: J is minimised."""
        return self if self.intensity == 0 else replace(self, intensity=0.0)

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

    @cached_property
    def command_bound(self) -> float:
        """The bound on |c| that every admissible command obeys."""
        return self.limits.command_bound(ideal=self.stage.amplifier is None)

    @cached_property
    def yardstick(self) -> Yardstick:
        """Rule by which a movement is told beside the recorded tap."""
        return Yardstick(self.grid, self.intention_s, self.named)

    @property
    def reference_m_s2(self) -> FloatArray:
        """(N,) r - a_free within the window."""
        return self.target.window_m_s2

    def towards(self, reference_m_s2: FloatArray) -> "TransientProblem":
        """Pose the problem with another target (N,) within the window."""
        return replace(self, target=replace(self.target, window_m_s2=reference_m_s2))

    @cached_property
    def reference_is_zero(self) -> bool:
        """Whether the window asks for nothing, or no weight counts it: the answer is the zero waveform."""
        return self.target.asks_for_nothing or self.tracking.counts_nothing

    @property
    def free_stages(self) -> int:
        """Number of commands before the hand-over."""
        return self.grid.stages - self.hand_over_samples

    @cached_property
    def input_scale(self) -> float:
        """Largest current that the limits leave: the unit in which it is of order one."""
        return min(self.command_bound, *(limit.reach(self.grid) for limit in self.limits))

    @cached_property
    def tracking(self) -> Tracking:
        """What the error costs."""
        level = float(10 ** (self.intensity_dB / 10))
        return Tracking(
            target=self.target,
            terms=self.terms,
            intensity=self.intensity,
            level=level,
            shares=self.shares,
            worst=self.worst,
        )

    @cached_property
    def movement(self) -> Movement:
        """What the command's movement costs."""
        return Movement(self.rho, self.grid.stages, self.grid.dt_s, self.limits.input_limit)

    @property
    def heat(self) -> HeatPrice:
        """What the input's heat costs."""
        return HeatPrice(self.heat_price)

    @property
    def driven_by(self) -> Input:
        """What commands and the plant's input are."""
        return self.stage.plant.driven_by

    @property
    def devices(self) -> tuple[StageModel, ...]:
        """The device and those of the spread."""
        return (self.stage, *self.spread)

    @cached_property
    def shared(self) -> FloatArray:
        """(S,) share of every device, or (p,) weight of every direction, in what the error costs."""
        count = len(self.devices)
        return np.full(count, 1 / count) if self.shares is None else self.shares

    def accelerations(self, command: FloatArray) -> FloatArray:
        """(S, N + M) y'' of every device, the entry's own first, through the window and after it.

        Of a plant with several directions it is (p, N + M).
        """
        lasting = self.continued(command)
        if self.directions:
            return self.stage.rollout(lasting)[0]
        return np.stack([device.rollout(lasting)[0] for device in self.devices])

    def figures(self, accelerations_m_s2: FloatArray) -> Figures:
        """Figures of y'' (N + M,), or of (p, N + M) in the first direction, beside the problem's target."""
        if self.directions:
            accelerations_m_s2 = accelerations_m_s2[0]
        with np.errstate(over="ignore", invalid="ignore"):  # a wall that grows by itself
            return self.yardstick.figures(self.target.normal, accelerations_m_s2)

    def tap_error(self, accelerations_m_s2: FloatArray) -> float:
        """`Figures.tap_error` alone, of y'' (K,) or (p, K) from tau_0 on, K at least the samples of the window."""
        normal = accelerations_m_s2[0] if self.directions else accelerations_m_s2
        return self.yardstick.tap_error(self.target.normal, normal)

    def objective(
        self, command: FloatArray, accelerations_m_s2: FloatArray, plant_input: FloatArray | None = None
    ) -> float:
        """J of a command (N,) and what it was rolled out to; dimensionless.

        Parameters
        ----------
        accelerations_m_s2 : (S, N + M) of every device.
        plant_input : (N,) what drives the plant; rolled out where it is not given and heat has a price.
        """
        found = self.tracking.value(accelerations_m_s2) + self.movement.value(command)
        if self.heat_price == 0:
            return found
        return found + self.heat.value(self.stage.rollout(command)[1] if plant_input is None else plant_input)

    @cached_property
    def feedback(self) -> Feedback:
        """What the wall makes of a command; nothing without one."""
        return Feedback(self.stage, self.wall, self.grid)

    def continued(self, command: FloatArray) -> FloatArray:
        """(N + M,) a command (N,) and what follows it after the window: zero, or the wall's feedback."""
        return self.feedback.continued(command)

    def hand_over_command(self, motion: Motion) -> FloatArray:
        """(N,) command that the predicted feedback asks for; zero without a wall."""
        return self.feedback.command(motion)

    def transient_command(self, command: FloatArray) -> FloatArray:
        """(N,) what remains of a total command when the wall's predicted feedback is taken off (seed Eq. 9)."""
        if self.wall is None:
            return command.copy()
        dt = self.grid.dt_s
        course = self.feedback.course(self.stage.motion(command))
        transient = command - feedback_command(self.wall.feedback(course, dt), self.stage.amplifier, dt)
        # Zero to rounding by the hand-over's constraint; what is handed over is nothing at all.
        transient[self.free_stages :] = 0.0
        return transient
