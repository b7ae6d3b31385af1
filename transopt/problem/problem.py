"""The optimal-control problem of one library entry: terms of the objective, limits, hand-over."""

import operator
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.discretise import Motion, StageModel
from transopt.plant.intention import INTENTION_S
from transopt.plant.state_space import Input
from transopt.plant.time_grid import TimeGrid
from transopt.plant.wall import HandOver, feedback_command
from transopt.problem.after import Feedback
from transopt.problem.limits.limit import Limit, Limits
from transopt.problem.limits.output import OutputLimit
from transopt.problem.limits.row import Row
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.figures import Figures, Yardstick
from transopt.problem.objective.movement import HeatPrice, Movement
from transopt.problem.objective.target import Target
from transopt.problem.objective.tracking import Tracking, values


@dataclass(frozen=True)
class TransientProblem:
    """Track the target acceleration within the limits, starting from rest.

    minimise  J = sum over terms sum_k weight_k (F e)_k^2 / E + rho / (N I^2) sum_k (dc_k 1e-4 s / dt)^2
                  + heat_price sum_(k<N) i_k^2,    e = y'' - (r - a_free),

    over the commands c_0..c_(N-1), with dc_k = c_k - c_(k-1), c_(-1) = 0, I = `limits.current_A` and i the plant's
    input, subject to the stage model, the limits, and the hand-over: the last `hand_over_samples` commands equal the
    wall's feedback command, zero without a wall, as do the commands after the window. Each part of the objective has
    its own file in `objective` (`error_term` with `plain` and `rapid`, `tracking`, `movement`, `heat_price`), and
    each limit one in `limits`.

    A plant with m motors has commands (m, N) and limits for each motor; squares are summed over the motors. A plant
    with p directions has a target and a weight (`shares`) for each, the normal of the surface first. Such a plant can
    have no wall, no spread, no price on intensity, and only limits that are `of_each_motor`.

    Attributes
    ----------
    stage : exact stage model of this grip's device.
    grid : time axis; `grid.stages` = N, `grid.after_stages` = M.
    target : r - a_free in the window, with the lost samples before tau_0 and the tail after tau_N.
    terms : terms of the error e; the price on intensity refers to the energy of the last one.
    rho : weight of the command's movement, >= 0.
    limits : inequality constraints on the command and all that depends on it.
    hand_over_samples : number of commands in the hand-over.
    wall : the virtual wall; None without one.
    spread : further devices that the same command drives; the error is then the mean over all.
    shares : (S,) weights of all devices in that mean, of sum one; None for equal ones. For a plant with several
        directions their weights (p,), >= 0, the first above 0.
    worst : whether the error is that of the worst device; `shares` are then its multipliers (`objective.tracking`).
    heat_price : price of the squared input, >= 0 [1/A^2 or 1/V^2].
    intention_s : duration after contact over which a played tap is compared with the recorded one; for a named target
        the whole window.
    named : whether the target is a named one, such as a click, and not a tap.
    intensity : lam, price of the energy that y'' lacks. The solver then minimises L = J - lam [sum (F y'')^2
        - 10^(intensity_dB / 10) sum (F (r - a_free))^2] / E, both sums over the window; for lam = 0, J.
    intensity_dB : required energy of the tap over the target's [dB].
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
        N = self.grid.stages
        self._check_target()
        if not self.terms:
            raise InputError("weights: no error term: give weights.plain or weights.rapid")
        for term in self.terms:
            if term.weights.shape != (N,):
                raise InputError(f"weights of the {term.name} term has shape {term.weights.shape}, expected {(N,)}")
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

    def _check_target(self) -> None:
        """Check the target's shapes and numbers."""
        target = self.target
        for name, array, size in (
            ("reference_m_s2", target.window_m_s2, self.grid.stages),
            ("reference_after_m_s2", target.after_m_s2, self.grid.after_stages),
            ("reference_before_m_s2", target.before_m_s2, target.lost),
        ):
            if array.shape != (*self.directions, size):
                raise InputError(f"{name} has shape {array.shape}, expected {(*self.directions, size)}")
        if target.flaw:
            raise InputError(target.flaw)

    def _check_several(self) -> None:
        """Check a plant with several motors or directions."""
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
        """(p,) for a plant with p > 1 directions, the leading shape of its arrays; empty for one direction."""
        return () if self.stage.tracked == 1 else (self.stage.tracked,)

    @cached_property
    def rest(self) -> FloatArray:
        """(N,) or (m, N) zero command."""
        motors = () if self.stage.motors == 1 else (self.stage.motors,)
        return np.zeros((*motors, self.grid.stages))

    def rows(self) -> tuple[tuple[Limit, Row], ...]:
        """All rows of all limits, each with its limit."""
        return self._rows

    @cached_property
    def _rows(self) -> tuple[tuple[Limit, Row], ...]:
        return tuple((limit, row) for limit in self.limits for row in limit.rows(self))

    def without(self, *names: str) -> "TransientProblem":
        """The problem without the limits of these names."""
        if not any(name in self.limits for name in names):
            return self
        return self._under(self.limits.without(*names))

    def relaxed(self) -> "TransientProblem":
        """A convex problem that admits every command which this one admits, so that its optimum is no larger.

        The temperature limit is replaced by a convex one (`TemperatureLimit.relaxed`); other limits that are not
        linear are dropped.
        """
        found = self if self.thermal is None else self.replaced(self.thermal.relaxed())
        return found.without(*self.own_nonlinear)

    def alone(self) -> "TransientProblem":
        """The problem for its own device alone, without the spread and without a price on intensity."""
        return replace(self.without_intensity(), spread=(), shares=None, worst=False)

    def replaced(self, limit: Limit) -> "TransientProblem":
        """The problem with the limit of the same name replaced by this one."""
        return self._under(self.limits.replaced(limit))

    def _under(self, limits: Limits) -> "TransientProblem":
        """The problem under other limits; what does not depend on limits is neither checked nor computed again."""
        found = object.__new__(type(self))
        vars(found).update(self._under_any_limits)
        vars(found)["limits"] = limits
        return found

    @property
    def _under_any_limits(self) -> dict[str, object]:
        """All fields, and what is known by now that does not depend on the limits."""
        known = {name: value for name, value in vars(self).items() if name in UNDER_ANY_LIMITS}
        return known | {"unlimited": self.unlimited}

    def learn(self, other: "TransientProblem") -> None:
        """Take over what another problem knows that does not depend on limits, if it differs in nothing else."""
        if _but_limits(self) == _but_limits(other):
            vars(self).update(other._under_any_limits | {name: getattr(self, name) for name in FIELDS})

    @cached_property
    def unlimited(self) -> dict[object, Any]:
        """Cache of the optimum without limits, which the problems that differ only in limits share (`design`)."""
        return {}

    def without_optimum(self) -> "TransientProblem":
        """A copy that does not know `unlimited`, for what that holds: a cycle would keep both until a collection."""
        found = object.__new__(type(self))
        vars(found).update({name: value for name, value in vars(self).items() if name != "unlimited"})
        return found

    def aiming_at(self, target: Target) -> "TransientProblem":
        """The problem with another target; what does not depend on it is neither checked nor computed again."""
        found = self._with({"target": target})
        found._check_target()
        return found

    def aiming_as(self, other: "TransientProblem") -> "TransientProblem":
        """The problem with the target of another one, and with all that is known of that target."""
        return self._with({name: value for name, value in vars(other).items() if name in OF_THE_TARGET})

    def _with(self, of_the_target: Mapping[str, object]) -> "TransientProblem":
        found = object.__new__(type(self))
        vars(found).update(self._for_any_target)
        vars(found).update(of_the_target)
        return found

    @cached_property
    def _for_any_target(self) -> dict[str, object]:
        """All fields and cached properties that do not depend on the target."""
        names = {*FIELDS, *CACHED} - OF_THE_TARGET - {"_for_any_target"}
        return {name: getattr(self, name) for name in names}

    def within(self, parts: Mapping[str, int]) -> "TransientProblem":
        """The problem with limits on outputs stated at the ends of parts of every servo period.

        Parameters
        ----------
        parts : name of a limit -> number of parts; limits that are not named stay unchanged.
        """
        limits, instants = self.limits, dict(self.stage.instants)
        for limit in limits:
            if isinstance(limit, OutputLimit) and limit.name in parts:
                limits = limits.replaced(limit.within(self, parts[limit.name]))
                instants[limit.output] = limit.shares(parts[limit.name])
        if limits is self.limits:
            return self
        stage, *spread = (device.within(instants) for device in self.devices)
        return replace(self._under(limits), stage=stage, spread=tuple(spread))

    @cached_property
    def parts(self) -> Mapping[str, int]:
        """Name of a limit on an output -> number of parts of a servo period at whose ends it is stated."""
        return {limit.name: limit.parts for limit in self.limits if isinstance(limit, OutputLimit)}

    def without_intensity(self) -> "TransientProblem":
        """The problem without the price on intensity, which minimises J."""
        return self if self.intensity == 0 else replace(self, intensity=0.0)

    @property
    def nonlinear(self) -> tuple[str, ...]:
        """Names of the limits that are not linear, which a quadratic program cannot contain."""
        return self.limits.nonlinear

    @property
    def own_nonlinear(self) -> tuple[str, ...]:
        """Names of a user's own limits that are not linear: under them a proof is of a stationary point only."""
        return tuple(name for name in self.nonlinear if name != TemperatureLimit.name)

    @cached_property
    def thermal(self) -> TemperatureLimit | None:
        """The temperature limit, which has its own states; None if the problem has none."""
        found = self.limits.get(TemperatureLimit.name)
        assert found is None or isinstance(found, TemperatureLimit)
        return found

    @cached_property
    def stays_cool(self) -> bool:
        """Whether every command that keeps the limit on the input keeps that on the winding's temperature."""
        return self.thermal is None or self.thermal.surely_kept(self)

    @cached_property
    def command_bound(self) -> float:
        """Bound on |c_k| of every admissible command."""
        return self.limits.command_bound(ideal=self.stage.amplifier is None)

    @cached_property
    def yardstick(self) -> Yardstick:
        """Rule by which a movement is compared with the recorded tap."""
        return Yardstick(self.grid, self.intention_s, self.named)

    @property
    def reference_m_s2(self) -> FloatArray:
        """(N,) r - a_free within the window."""
        return self.target.window_m_s2

    @cached_property
    def reference_is_zero(self) -> bool:
        """Whether the target is zero in the window or under all weights, so that the optimum is the zero waveform."""
        return self.target.asks_for_nothing or self.tracking.counts_nothing

    @property
    def free_stages(self) -> int:
        """Number of commands before the hand-over."""
        return self.grid.stages - self.hand_over_samples

    @cached_property
    def input_scale(self) -> float:
        """Largest plant input that the limits permit: the unit in which commands are scaled to order one."""
        return min(self.command_bound, *(limit.reach(self.grid) for limit in self.limits))

    @cached_property
    def tracking(self) -> Tracking:
        """The tracking term of J."""
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
        """The movement term of J."""
        return Movement(self.rho, self.grid.stages, self.grid.dt_s, self.limits.input_limit)

    @property
    def heat(self) -> HeatPrice:
        """The heat term of J."""
        return HeatPrice(self.heat_price)

    @property
    def driven_by(self) -> Input:
        """The plant's input, a current or a voltage; commands have the same unit."""
        return self.stage.plant.driven_by

    @property
    def devices(self) -> tuple[StageModel, ...]:
        """The entry's device, then those of the spread."""
        return (self.stage, *self.spread)

    @cached_property
    def shared(self) -> FloatArray:
        """(S,) share of every device, or (p,) weight of every direction, in the tracking term."""
        count = len(self.devices)
        return np.full(count, 1 / count) if self.shares is None else self.shares

    def accelerations(self, command: FloatArray) -> FloatArray:
        """(S, N + M) y'' of every device, the entry's own first, in window and tail; (p, N + M) of directions."""
        lasting = self.continued(command)
        if self.directions:
            return self.stage.rollout(lasting)[0]
        return np.stack([device.rollout(lasting)[0] for device in self.devices])

    def figures(self, accelerations_m_s2: FloatArray) -> Figures:
        """Figures of y'' (N + M,), or of the first direction of (p, N + M), relative to the problem's target."""
        with np.errstate(over="ignore", invalid="ignore"):  # the loop of an unstable wall overflows
            return self.yardstick.figures(self.target, accelerations_m_s2)

    def objective(
        self, command: FloatArray, accelerations_m_s2: FloatArray, plant_input: FloatArray | None = None
    ) -> float:
        """J of a command (N,) and its rollout; dimensionless.

        Parameters
        ----------
        accelerations_m_s2 : (S, N + M) y'' of every device.
        plant_input : (N,) the plant's input; computed if it is not given and heat has a price.
        """
        if plant_input is None:
            plant_input = self.rest if self.heat_price == 0 else self.stage.rollout(command)[1]
        return float(objectives([self], [command], accelerations_m_s2[None], [plant_input])[0])

    @cached_property
    def feedback(self) -> Feedback:
        """The wall's feedback as a function of the command; zero without a wall."""
        return Feedback(self.stage, self.wall, self.grid)

    def continued(self, command: FloatArray) -> FloatArray:
        """(N + M,) a command (N,) continued after the window: by zero, or by the wall's feedback."""
        return self.feedback.continued(command)

    def hand_over_command(self, motion: Motion) -> FloatArray:
        """(N,) command of the wall's predicted feedback; zero without a wall."""
        return self.feedback.command(motion)

    def transient_command(self, command: FloatArray) -> FloatArray:
        """(N,) total command minus the wall's predicted feedback: the transient that is played (seed Eq. 9).

        Without a wall it is the command itself.
        """
        if self.wall is None:
            return command
        dt = self.grid.dt_s
        course = self.feedback.course(self.stage.motion(command))
        transient = command - feedback_command(self.wall.feedback(course, dt), self.stage.amplifier, dt)
        # The hand-over makes it zero up to rounding; it is set to exactly zero.
        transient[self.free_stages :] = 0.0
        return transient


def objectives(
    problems: Sequence[TransientProblem],
    commands: Iterable[FloatArray],
    accelerations_m_s2: FloatArray,
    plant_inputs: Iterable[FloatArray],
) -> FloatArray:
    """(G,) J of commands, each in its problem; the problems differ in their targets alone.

    Parameters
    ----------
    accelerations_m_s2 : (G, S, N + M). commands, plant_inputs : all as for `TransientProblem.objective`.
    """
    first, tracked = problems[0], values([problem.tracking for problem in problems], accelerations_m_s2)
    found = np.asarray(tracked + [first.movement.value(command) for command in commands])
    return found + [first.heat.value(each) for each in plant_inputs] if first.heat_price > 0 else found


FIELDS = {field.name for field in fields(TransientProblem)}
CACHED = {name for name, part in vars(TransientProblem).items() if isinstance(part, cached_property)}
# The field and the cached properties that depend on the target; fields and cached properties for any limits.
OF_THE_TARGET = {"target", "tracking", "reference_is_zero", "unlimited"}
UNDER_ANY_LIMITS = FIELDS | {*("tracking", "shared", "feedback", "reference_is_zero", "yardstick", "rest")}
SAME = ("stage", "target", "terms", "wall", "shares")  # fields of which no copy serves
_SAME, _EQUAL = (operator.attrgetter(*names) for names in (SAME, sorted(FIELDS - {*SAME, "spread", "limits"})))


def _but_limits(problem: TransientProblem) -> tuple[object, ...]:
    """The key of problems that differ only in limits."""
    return *map(id, (*_SAME(problem), *problem.spread)), *_EQUAL(problem)


BESIDES_THE_TARGET = operator.attrgetter(*sorted(FIELDS - {"target"}))
