"""Exact discretisation of plant and amplifier on the switching instants.

The servo issues command c_k at its tick t_k = -lead + k dt and holds it. After the amplifier's delay the command acts
on the motor, from the switching instant tau_k = t_k + delay on. Predictions and the reference are sampled at the
switching instants, so a delay only shifts the time axis and needs no state. Between two switching instants the
current is monotonic: a bound on i(tau_k) bounds |i(t)| for all t, which a bound at the ticks would not.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from operator import is_
from typing import Any, TypeVar

import numpy as np

from transopt.base.matrices import exponential
from transopt.base.recursions import LinearSystem, Recursion
from transopt.base.shown import brief
from transopt.base.signals import BoolArray, FloatArray, read_only
from transopt.plant.amplifier import Amplifier
from transopt.plant.scaling import peaks, sizes
from transopt.plant.state_space import StateSpace

T = TypeVar("T")
PERIOD = " the period"  # suffix of the names of outputs that depend on the command c_k at stage k
AFTER = f" after{PERIOD}"  # suffix of an output's value at the next switching instant
COURSES = ("acceleration_m_s2", "plant_input", "velocity_m_s", "encoder_m")  # of a motion
MATRICES = ("A", "B", "C", "D", "Ci", "Di", "Cv", "Cp", "Dp")  # of a stage model


def within(name: str, share: Fraction) -> str:
    """Name of an output at an instant within the period, this share of it after the switching instant."""
    return name + AFTER if share == 1 else f"{name} at {share} of{PERIOD}"


@dataclass(frozen=True)
class Motion:
    """The motion under a command at the switching instants, or a gradient by it; all (..., N).

    With p directions the accelerations are (..., p, N); with m motors inputs and velocities are (..., m, N).

    Attributes
    ----------
    acceleration_m_s2 : y'' of the stylus.
    plant_input : current in the motor, or voltage at the coil.
    velocity_m_s : dy/dt of the motor mass, to which the back-EMF is proportional.
    encoder_m : y of the motor mass at tick t_(k + 1 + whole delay), at which the encoder is read while c_k acts; zero
        if the stage model has no position.
    outputs : further outputs of the stage model at the switching instants, by name.
    """

    acceleration_m_s2: FloatArray
    plant_input: FloatArray
    velocity_m_s: FloatArray
    encoder_m: FloatArray
    outputs: Mapping[str, FloatArray] = field(default_factory=dict)

    __repr__ = brief

    @classmethod
    def zero(cls, stages: int) -> "Motion":
        """A motion of zeros, (stages,) each."""
        nothing = np.zeros(stages)
        return cls(nothing, nothing, nothing, nothing)

    def padded(self, stages: int) -> "Motion":
        """The motion with so many zeros appended."""
        if stages == 0:
            return self

        def longer(values: FloatArray) -> FloatArray:
            return np.concatenate([values, np.zeros((*values.shape[:-1], stages), dtype=values.dtype)], axis=-1)

        return self._each(longer)

    def _each(self, change: Callable[[FloatArray], FloatArray]) -> "Motion":
        """The motion with each of its courses changed alike."""
        courses = {name: change(getattr(self, name)) for name in COURSES}
        return Motion(**courses, outputs={name: change(values) for name, values in self.outputs.items()})

    def of_motor(self, motor: int) -> "Motion":
        """The motion with the input and the velocity of one of several motors."""
        inputs, velocities = self.plant_input[..., motor, :], self.velocity_m_s[..., motor, :]
        return replace(self, plant_input=inputs, velocity_m_s=velocities)

    @classmethod
    def stacked(cls, motions: Sequence["Motion"]) -> "Motion":
        """Several motions, one along each course of a new first axis."""
        courses = {name: np.stack([getattr(motion, name) for motion in motions]) for name in COURSES}
        outputs = {name: np.stack([motion.outputs[name] for motion in motions]) for name in motions[0].outputs}
        return cls(**courses, outputs=outputs)

    def of_course(self, course: int) -> "Motion":
        """One of several motions."""
        return self._each(lambda values: values[course])

    def first(self, stages: int) -> "Motion":
        """The first so many instants of the motion."""
        return self._each(lambda values: values[..., :stages])


@dataclass(frozen=True)
class StageModel:
    """One grip's device over one servo period, exact for a held command.

    x_(k+1) = A x_k + B c_k,  outputs C x_k + D c_k  at the switching instants.
    x holds the plant's acting states and, unless the amplifier is ideal, the motors' currents (its last entries).
    Commands are (..., N), or (..., m, N) of m motors.

    Attributes
    ----------
    plant : the continuous-time model.
    amplifier : None is ideal, i = c.
    dt_s : servo period.
    A : (n, n).
    B : (n, m).
    C, D : (p, n), (p, m), output y''.
    Ci, Di : (m, n), (m, m), outputs of the plant's inputs, currents or voltages.
    Cv : (m, n), velocities of the motor masses.
    Cp, Dp : (1, n), (1, 1), encoder position at the tick within the period; None if it is left out.
    outputs : name -> (n,) row of a further output at the switching instants. It has no direct dependence on the
        command; the output of the same name with the suffix `AFTER`, one period later, has.
    instants : name of a further output -> shares of the period at which it is provided too, under the names of
        `within`.
    """

    plant: StateSpace
    amplifier: Amplifier | None
    dt_s: float
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    Ci: FloatArray
    Di: FloatArray
    Cv: FloatArray
    Cp: FloatArray | None = None
    Dp: FloatArray | None = None
    outputs: Mapping[str, FloatArray] = field(default_factory=dict)
    instants: Mapping[str, tuple[Fraction, ...]] = field(default_factory=dict)

    __repr__ = brief

    def __post_init__(self) -> None:
        for name in MATRICES:
            if (matrix := getattr(self, name)) is not None:
                vars(self)[name] = read_only(matrix)

    @property
    def motors(self) -> int:
        """Number of commands m."""
        return int(self.B.shape[1])

    @property
    def tracked(self) -> int:
        """Number of accelerations p."""
        return int(self.C.shape[0])

    @property
    def whole_delay(self) -> int:
        """Whole servo periods in the amplifier's delay."""
        return 0 if self.amplifier is None else split_delay(self.amplifier.delay_s, self.dt_s)[0]

    @cached_property
    def _forwards(self) -> Recursion:
        return Recursion(self.A)

    @cached_property
    def _system(self) -> LinearSystem:
        """The system from the command to all quantities of `Motion`, one below the other."""
        nothing = np.zeros((self.Cv.shape[0], self.motors), dtype=self.A.dtype)
        rows, direct = [self.C, self.Ci, self.Cv], [self.D, self.Di, nothing]
        if self.Cp is not None and self.Dp is not None:
            rows, direct = [*rows, self.Cp], [*direct, self.Dp]
        for name in self.output_names:
            row, by_command = self.output(name)
            rows.append(row[None])
            direct.append(np.full((1, 1), by_command, dtype=self.A.dtype))
        return LinearSystem(self.A, self.B, np.concatenate(rows), np.concatenate(direct))

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of all further outputs: at the switching instant, one period later, and within the period."""
        return (*(name for own in self.outputs for name in (own, own + AFTER)), *self._inside)

    def output(self, name: str) -> tuple[FloatArray, float]:
        """(n,) and scalar: a further output by the state and by the command that acts."""
        if name in self._inside:
            return self._inside[name]
        own = name.removesuffix(AFTER)
        row = self.outputs[own]
        return (row, 0.0) if own == name else (row @ self.A, float(row @ self.B[:, 0]))

    def within(self, instants: Mapping[str, tuple[Fraction, ...]]) -> "StageModel":
        """The stage model with outputs at these `instants`; cached, as all problems of one grip share it."""
        wanted = {name: shares for name, shares in sorted(instants.items()) if shares}
        if wanted == self.instants:
            return self
        key = ("within", *wanted.items())
        if key not in self.derived:
            self.derived[key] = replace(self, instants=wanted)
        model: StageModel = self.derived[key]
        return model

    @cached_property
    def _inside(self) -> dict[str, tuple[FloatArray, float]]:
        """Name of an output within the period -> row by the state and scalar by the command."""
        found: dict[str, tuple[FloatArray, float]] = {}
        for name, shares in self.instants.items():
            for share in shares:
                row = self.outputs[name] @ self.part(share)
                found[within(name, share)] = row[:-1], float(row[-1])
        return found

    @cached_property
    def idle_states(self) -> int:
        """Number of plant states on which neither acceleration nor velocity depends: a free device's position."""
        return int(np.sum(~acting_states(self.plant)))

    @cached_property
    def flow(self) -> FloatArray:
        """(n + 1, n + 1) generator of d/dt [x, held command] in continuous time."""
        rows = [self.plant.output(name).row for name in self.outputs]
        acting = acting_states(self.plant, position=self.Cp is not None, outputs=rows)
        return _flow(self.plant.A[np.ix_(acting, acting)], self.plant.B[acting], self.amplifier)

    def part(self, share: Fraction) -> FloatArray:
        """(n, n + 1) transition from state and command to the state after a share of the period."""
        return exponential(self.flow * (self.dt_s * share.numerator / share.denominator))[: -self.motors]

    def states(self, command: FloatArray) -> FloatArray:
        """(N, n) states at the switching instants for one held command (N,)."""
        dtype = np.result_type(self.A, command)
        forcing = np.zeros((command.size, self.A.shape[0]), dtype=dtype)
        forcing[1:] = command[:-1, None] * self.B[:, 0]
        if dtype == np.float64:
            return self._forwards.run(forcing)
        for k in range(1, command.size):  # the recursion of `transopt.base` has double precision only
            forcing[k] += self.A @ forcing[k - 1]
        return forcing

    def motion(self, command: FloatArray) -> Motion:
        """The motion under held commands.

        Parameters
        ----------
        command : (..., N), or (..., m, N) with m motors.
        """
        m, p = self.motors, self.tracked
        commands = command[..., None, :] if m == 1 else command
        values = np.moveaxis(self._system.outputs(commands), -2, 0)
        acceleration, current, velocity = map(_lone, (values[:p], values[p : p + m], values[p + m : p + 2 * m]))
        encoder = np.zeros(values.shape[1:]) if self.Cp is None else values[p + 2 * m]
        names = self.output_names
        further = values[values.shape[0] - len(names) :]
        return Motion(acceleration, current, velocity, encoder, dict(zip(names, further, strict=True)))

    def rollout(self, command: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Acceleration y'' and current at the switching instants for held commands (..., N), each (..., N)."""
        motion = self.motion(command)
        return motion.acceleration_m_s2, motion.plant_input

    def state_scale(self, input_limit: float, stages: int) -> FloatArray:
        """(n,) size of each state by `state_scale`; its simulation is cached for all problems of one grip."""
        if stages not in self._peaks:
            self._peaks[stages] = peaks(self.A, self.B, stages)
        return sizes(input_limit * self._peaks[stages])

    @cached_property
    def _peaks(self) -> dict[int, FloatArray]:
        return {}

    @cached_property
    def derived(self) -> dict[Any, Any]:
        """Cache of results that other packages derive from this model, each under its own key."""
        return {}

    def kept(self, kind: object, same: tuple[object, ...], equal: object, make: Callable[[], T]) -> T:
        """The value of a kind that `make` computes from this model; the latest one is cached in `derived`.

        Parameters
        ----------
        same, equal : what the value depends on besides the model: objects of which no copy serves, and others.
        """
        found = self.derived.get(kind)
        if not (found and len(found[0]) == len(same) and all(map(is_, found[0], same)) and found[1] == equal):
            found = self.derived[kind] = same, equal, make()
        value: T = found[2]
        return value

    def extended(self) -> "StageModel":
        """Stage model in extended precision (64 bits of mantissa where the machine has them, else unchanged)."""

        def wide(matrix: FloatArray) -> FloatArray:
            return matrix.astype(np.longdouble)

        given = {name: getattr(self, name) for name in MATRICES}
        matrices: dict[str, Any] = {name: wide(matrix) for name, matrix in given.items() if matrix is not None}
        return replace(self, outputs={name: wide(row) for name, row in self.outputs.items()}, **matrices)

    def adjoint(self, gradient: Motion) -> FloatArray:
        """(..., N) or (..., m, N) gradient by the commands for a gradient by the motion.

        The transpose of `motion`, by the adjoint recursion: lambda_k = A' lambda_(k+1) + sum of C' g_k.
        """
        one, motors = self.tracked == 1, self.motors == 1
        by_output = [
            gradient.acceleration_m_s2[..., None, :] if one else gradient.acceleration_m_s2,
            *(each[..., None, :] if motors else each for each in (gradient.plant_input, gradient.velocity_m_s)),
        ]
        if self.Cp is not None:
            by_output.append(gradient.encoder_m[..., None, :])
        nothing = np.zeros(gradient.plant_input.shape[-1:])
        by_output += [gradient.outputs.get(name, nothing)[..., None, :] for name in self.output_names]
        courses = np.broadcast_shapes(*(each.shape[:-2] for each in by_output))
        wide = [np.broadcast_to(each, (*courses, *each.shape[-2:])) for each in by_output]
        by_command = self._system.transposed(np.concatenate(wide, axis=-2))
        return np.asarray(by_command[..., 0, :] if motors else by_command)


def _lone(values: FloatArray) -> FloatArray:
    """(..., N) from (1, ..., N), and (..., p, N) from (p, ..., N): a leading axis of length 1 is dropped."""
    return values[0] if values.shape[0] == 1 else np.moveaxis(values, 0, -2)


def split_delay(delay_s: float, dt_s: float) -> tuple[int, float]:
    """A delay as whole servo periods and the remainder [s], less than a period."""
    whole = int(np.floor(delay_s / dt_s + 1e-9))
    return whole, max(delay_s - whole * dt_s, 0.0)


def acting_states(plant: StateSpace, *, position: bool = False, outputs: Sequence[FloatArray] = ()) -> BoolArray:
    """(n,) mask of the states on which acceleration and motor velocity depend, by the structure of the matrices.

    The position of a free device only integrates its velocity, so it is not among them unless `position` is set or an
    output needs it. A free mass under a force has no state that matters; the one that grows least is kept then, since
    a stage has at least one.
    """
    rows = [plant.C, plant.Cv, *([plant.Ce] if position else []), *outputs]
    acting: BoolArray = (np.concatenate(rows) != 0).any(axis=0)
    by = plant.A != 0
    while True:
        more = acting | by[acting].any(axis=0)
        if (more == acting).all():
            break
        acting = more
    if not acting.any():
        acting[plant.A.diagonal().argmin()] = True
    return acting


def discretise(
    plant: StateSpace,
    amplifier: Amplifier | None,
    dt_s: float,
    *,
    position: bool = False,
    outputs: Sequence[str] = (),
) -> StageModel:
    """Exact zero-order hold of plant and amplifier by one matrix exponential.

    The amplifier's delay only shifts the time axis, with one exception: the encoder is read at ticks, which lie
    between two switching instants. States on which no output depends are left out.

    Parameters
    ----------
    plant : continuous-time model.
    amplifier : None is ideal.
    dt_s : servo period.
    position : whether to provide the encoder position, for a wall.
    outputs : names of further outputs of the plant (`StateSpace.output`).

    Raises
    ------
    InputError : an output that the plant does not have.
    """
    further = {name: plant.output(name).row for name in outputs}
    acting = acting_states(plant, position=position, outputs=list(further.values()))
    n, m = int(acting.sum()), plant.motors
    A, B, C = plant.A[np.ix_(acting, acting)], plant.B[acting], plant.C[:, acting]
    velocity, encoder = plant.Cv[:, acting], plant.Ce[:, acting]
    flow = _flow(A, B, amplifier)
    if amplifier is None:
        D, Ci, Di = plant.D, np.zeros((m, n)), np.eye(m)
    else:
        C, D = np.hstack([C, plant.D]), np.zeros_like(plant.D)
        Ci, Di = np.eye(m, n + m, n), np.zeros((m, m))
        # Positions and velocities do not depend directly on the motor's force, so their rows have zeros for currents.
        velocity, encoder = (np.hstack([row, np.zeros((row.shape[0], m))]) for row in (velocity, encoder))
    hold = exponential(flow * dt_s)
    rows = {name: np.append(row[0, acting], np.zeros(C.shape[1] - n)) for name, row in further.items()}
    of_state, of_command = hold[:-m, :-m], hold[:-m, -m:]
    model = StageModel(plant, amplifier, dt_s, of_state, of_command, C, D, Ci, Di, velocity, outputs=rows)
    if not position:
        return model
    late = 0.0 if amplifier is None else split_delay(amplifier.delay_s, dt_s)[1]
    until_tick = exponential(flow * (dt_s - late))
    return replace(model, Cp=encoder @ until_tick[:-m, :-m], Dp=encoder @ until_tick[:-m, -m:])


def _flow(A: FloatArray, B: FloatArray, amplifier: Amplifier | None) -> FloatArray:
    """(n + m, n + m) generator of d/dt [plant, currents unless the amplifiers are ideal, held commands]."""
    n, m = B.shape
    if amplifier is None:
        return np.block([[A, B], [np.zeros((m, n + m))]])
    w, flow = amplifier.rate_rad_s, np.zeros((n + 2 * m, n + 2 * m))
    flow[:n, : n + m] = np.hstack([A, B])
    flow[n : n + m, n:] = np.hstack([-w * np.eye(m), w * np.eye(m)])
    return flow
