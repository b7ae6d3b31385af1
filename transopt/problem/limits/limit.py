"""What a limit is: one interface, behind which each limit stands in a file of its own.

A limit says what it bounds as rows, `lower_k <= sum of outputs + offset <= upper_k` at the switching instants tau_k.
The outputs are named outputs of the stage, so that a row knows nothing of states, scaling or solvers. The solvers'
stage data, the CasADi program, the program that asks for feasibility, the certificate and the replay all read the
same rows.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache, reduce
from operator import add
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.circuit import Circuit
from transopt.plant.coil import CoilModel
from transopt.plant.discretise import PERIOD, Motion, StageModel, TimeGrid
from transopt.plant.state_space import Input
from transopt.plant.wall import HandOver
from transopt.problem.heat import Budget

# Outputs that every stage has, all at the switching instant tau_k; a stage may name more (`StageModel.outputs`).
INPUT = "plant input"  # u(tau_k), a current [A] or a voltage [V]
COMMAND = "command"  # c_k, felt from tau_k on, in the unit of the input
HELD = "held command"  # c_(k-1), felt until tau_k
VELOCITY = "velocity"  # dy/dt of the motor mass [m/s]

SIDES = ("lower", "upper")  # of a row
VIOLATION_TOLERANCE = 1e-6  # of a limit where that is below one of its units, and of one unit above


def tolerated(limit: float) -> float:
    """Violation that a limit tolerates: a microampere is nothing at 1 A and everything at 1e-6 A."""
    return VIOLATION_TOLERANCE * min(limit, 1.0)


@dataclass(frozen=True)
class Row:
    """One value along the horizon with a bound on either side.

    Attributes
    ----------
    name : of its multipliers, which a library stores as mu_<name>_lower and mu_<name>_upper.
    outputs : output -> its coefficient in the value.
    lower, upper : (N,) or one number for all instants; infinite where nothing is asked.
    offset : (N,) or one number: the part of the value that no command changes.
    condition : under which the value is this one, as it is said where the row binds; empty for none.
    device : which of the problem's devices has the value; 0 is the entry's own.
    motor : whose input, command and velocity are meant, from 0; None for a plant with one motor.
    share : what part of the limit this motor has; the bounds are that much of what the limit states.
    """

    name: str
    outputs: Mapping[str, float]
    lower: FloatArray | float
    upper: FloatArray | float
    offset: FloatArray | float = 0.0
    condition: str = ""
    device: int = 0
    motor: int | None = None
    share: float = 1.0

    def of_motor(self, motor: int, share: float = 1.0) -> "Row":
        """Return the row of one of several motors, with its own multipliers and its share of the bounds."""
        of_it = "" if share == 1 else f", which has {share:g} of it"
        said = f"{self.condition} of motor {motor + 1}{of_it}".lstrip()
        name, lower, upper = motor_row(self.name, motor), share * self.lower, share * self.upper
        return replace(self, name=name, lower=lower, upper=upper, condition=said, motor=motor, share=share)

    def of_device(self, device: int) -> "Row":
        """Return the row for a device of the spread, with its own multipliers; device 0 is the entry's, unchanged."""
        if device == 0:
            return self
        said = f"{self.condition} of device {device} of the spread".lstrip()
        return replace(self, name=device_row(self.name, device), condition=said, device=device)

    def value(self, motion: Motion, command: FloatArray) -> FloatArray:
        """(..., N) what a command (..., N), or (..., m, N) of m motors, with this motion makes of it."""
        if self.motor is not None:
            motion, command = motion.of_motor(self.motor), command[..., self.motor, :]
        parts: list[Any] = [by * output_values(output, motion, command) for output, by in self.outputs.items()]
        if isinstance(self.offset, np.ndarray) or self.offset or not parts:
            parts.append(self.offset)
        return np.asarray(reduce(add, parts))

    def bounds(self, stages: int) -> tuple[FloatArray, FloatArray]:
        """(stages,) lower and upper."""
        return _along(self.lower, stages), _along(self.upper, stages)

    def by_outputs(self, motion: Motion, command: FloatArray, gradient: FloatArray) -> dict[str, FloatArray]:
        """Output -> gradient (N,) by it, for a gradient (N,) by the value."""
        return {output: coefficient * gradient for output, coefficient in self.outputs.items()}

    @property
    def linear(self) -> bool:
        """Whether the value is a sum of outputs."""
        return True

    @property
    def waits(self) -> bool:
        """Whether the command c_k has no say in the value of stage k: in that of the first nobody has."""
        return not any(name == COMMAND or name.endswith(PERIOD) for name in self.outputs)


def device_row(name: str, device: int) -> str:
    """What the row of a further device of a spread is called, beside the row of the entry's own device."""
    return f"{name}_device_{device}" if device else name


def motor_row(name: str, motor: int) -> str:
    """What the row of one of several motors is called."""
    return f"{name}_motor_{motor + 1}"


def _along(value: FloatArray | float, stages: int) -> FloatArray:
    """(stages,) of a number or of as many."""
    return value if isinstance(value, np.ndarray) else _everywhere(value, stages)


@lru_cache(maxsize=16)
def _everywhere(value: float, stages: int) -> FloatArray:
    found = np.full(stages, value)
    found.flags.writeable = False  # it stands for all of them
    return found


def output_values(name: str, motion: Motion, command: FloatArray) -> FloatArray:
    """(..., N) one output along a command (..., N)."""
    if name == INPUT:
        return motion.plant_input
    if name == COMMAND:
        return command
    if name == HELD:
        held = np.zeros_like(command)
        held[..., 1:] = command[..., :-1]
        return held
    return motion.velocity_m_s if name == VELOCITY else motion.outputs[name]


def transposed(
    by_value: Iterable[tuple[Row, FloatArray]], motion: Motion, command: FloatArray
) -> tuple[Motion, FloatArray]:
    """Gradients by the motion and, directly, by the commands (N,) for gradients (N,) by the values of rows.

    Parameters
    ----------
    motion, command : where the gradients are taken; only a row that is not linear looks at them. Of several motors
        the commands are (m, N), and so is what is returned.
    """
    if command.ndim > 1:
        return _transposed_by_motor(list(by_value), motion, command)
    by: dict[str, FloatArray] = {}
    nothing = np.zeros(command.size)
    for row, gradient in by_value:
        for output, part in row.by_outputs(motion, command, gradient).items():
            by[output] = by.get(output, nothing) + part
    by_command = by.pop(COMMAND, nothing)
    if (by_held := by.pop(HELD, None)) is not None:
        by_command = by_command + np.append(by_held[1:], 0.0)
    return Motion(nothing, by.pop(INPUT, nothing), by.pop(VELOCITY, nothing), nothing, by), by_command


def _transposed_by_motor(
    by_value: list[tuple[Row, FloatArray]], motion: Motion, command: FloatArray
) -> tuple[Motion, FloatArray]:
    parts = [
        transposed([each for each in by_value if each[0].motor == j], motion.of_motor(j), command[j])
        for j in range(command.shape[0])
    ]
    inputs, velocities = (
        np.stack([getattr(of, name) for of, _ in parts]) for name in ("plant_input", "velocity_m_s")
    )
    still = np.zeros_like(motion.acceleration_m_s2)
    return Motion(still, inputs, velocities, np.zeros(command.shape[-1])), np.stack([by for _, by in parts])


class Posed(Protocol):
    """What of a problem its limits may look at."""

    @property
    def stage(self) -> StageModel: ...

    @property
    def devices(self) -> tuple[StageModel, ...]: ...

    @property
    def grid(self) -> TimeGrid: ...

    @property
    def limits(self) -> "Limits": ...


@dataclass(frozen=True)
class Setting:
    """What beside its own number a limit may be made of: the device, and the nominal motion of the tap.

    Attributes
    ----------
    stage : device of the entry's grip.
    grid : time axis.
    circuit : terminals of the motor or of the coil; None where the drive is stated at the tip.
    coil : with its temperatures at the start; None without motor data.
    budget : what the winding may do beside keeping below its limit.
    wall : the virtual wall over this tap; None without one.
    reference_m_s2 : (N,) r at the switching instants.
    nominal_m, nominal_m_s : (N,) z_nom and its derivative at the switching instants, as far as they are part of the
        device's position: zero where that is of a mass in a case.
    spread : further devices that the one command shall serve.
    """

    stage: StageModel
    grid: TimeGrid
    circuit: Circuit | None
    coil: CoilModel | None
    budget: Budget
    wall: HandOver | None
    reference_m_s2: FloatArray
    nominal_m: FloatArray
    nominal_m_s: FloatArray
    spread: tuple[StageModel, ...] = ()

    @property
    def devices(self) -> tuple[StageModel, ...]:
        """The device and those of the spread."""
        return (self.stage, *self.spread)

    def input_limit(self, asked: Mapping[str, Any]) -> float:
        """The number among those asked for that bounds the plant's input."""
        driven_by = self.stage.plant.driven_by
        return float(asked[f"{driven_by.name}_{driven_by.unit}"])


@dataclass(frozen=True)
class Limit(ABC):
    """One limit of one entry's problem.

    Attributes
    ----------
    name : of the limit in code and in `left_out` of a library.
    label : how it is called where it binds.
    unit : of what it bounds. step_unit : of differences.
    key : its number in a scene, below `limits`; empty where the number stands elsewhere.
    driven_by : the input of the plants that may have it; None for any.
    implied : whether a problem may have it although the scene states no number for it below `limits`.
    row_names : of all rows that it can have of one device. sides : on which they are bounded.
    needs : outputs of the stage that its rows use beyond those that every stage has.
    in_every_file : whether a library has its multipliers even where the limit is not in force.
    after_the_waveform : whether it is watched in the replay after the waveform too, where a wall goes on pushing.
    scales_movement : whether it is the unit I of the movement's weight in J.
    indispensable : whether it bounds the command of every problem that has it, so that none can be without it.
    price_step : by how much it is raised where its price is asked for; infinite for a share of it.
    of_each_device : whether it depends on the motion, which each device of a spread has for itself: it then holds for
        all of them, with rows for each (`device_row`).
    of_each_motor : whether a plant with several motors can have it, with rows for each (`motor_row`).
    asks_for : what a scene has to state beside its number; empty for nothing.
    said_without : why a problem does not have it.
    """

    name: ClassVar[str]
    label: ClassVar[str]
    unit: ClassVar[str]
    step_unit: ClassVar[str]
    key: ClassVar[str] = ""
    driven_by: ClassVar[Input | None] = None
    implied: ClassVar[bool] = False
    row_names: ClassVar[tuple[str, ...]]
    sides: ClassVar[tuple[str, ...]] = SIDES
    needs: ClassVar[tuple[str, ...]] = ()
    in_every_file: ClassVar[bool] = False
    after_the_waveform: ClassVar[bool] = False
    scales_movement: ClassVar[bool] = False
    indispensable: ClassVar[bool] = False
    price_step: ClassVar[float] = np.inf
    of_each_device: ClassVar[bool] = False
    of_each_motor: ClassVar[bool] = False
    asks_for: ClassVar[str] = ""
    said_without: ClassVar[str] = ""

    __repr__ = brief

    @property
    @abstractmethod
    def stated(self) -> float:
        """The limit in the user's words."""

    @classmethod
    @abstractmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        """The limit that a scene's numbers `asked` (key of `limits` -> number or None) put on a tap, if any.

        Asked only where the scene states its number, or where it is `implied`.
        """

    @abstractmethod
    def wider(self, factor: float) -> Self:
        """Widen the limit `factor` times."""

    def raised(self, by: float) -> Self:
        """Widen the limit on every side by so much of its own unit."""
        return self.wider(1 + by / self.stated)

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        """What it bounds; nothing for a limit that has a state of its own."""
        return ()

    @property
    def linear(self) -> bool:
        """Whether all that it bounds are sums of outputs, so that a quadratic program can have it."""
        return True

    def said(self, side: str, *, two_sided: bool) -> str:
        """The bound of a side where it binds."""
        sign = {"lower": "-", "upper": "+" if two_sided else ""}[side]
        return f"{sign}{self.stated:.8g}"

    @classmethod
    def concerns(cls, driven_by: Input) -> bool:
        """Whether a plant with this input may have it."""
        return cls.driven_by in (None, driven_by)

    @classmethod
    def suits(cls, circuit: Circuit | None) -> bool:
        """Whether a device with these terminals has it in this form; of two with one key one does."""
        return True

    @classmethod
    def stored_with(cls, row: str) -> str:
        """What a library states among its limits where it has the multipliers of a row; empty: it always has them."""
        return "" if cls.in_every_file else cls.key

    @classmethod
    def base_unit(cls) -> str:
        """Unit of its violations and of its multipliers' inverse, which a step per tick has without the tick."""
        return cls.step_unit.removesuffix("/tick")

    @classmethod
    def relieved_by(cls) -> Mapping[str, bool]:
        """Dotted keys of a scene whose change gives more room -> whether upwards."""
        return {f"limits.{cls.key}": True}

    @classmethod
    def dispensed_by(cls) -> str:
        """Dotted key of a scene without which there is no such limit; empty where there is one in any case."""
        return "" if cls.implied or cls.scales_movement else f"limits.{cls.key}"

    @property
    def room(self) -> float:
        """How much of it there is to use, of which steps are shares."""
        return self.stated

    def watched(self, problem: Posed) -> tuple[Row, ...]:
        """Rows that the replay follows at all times; an offset of (N + 1,) goes on to tau_N.

        The command that is felt stands there for c_k. The command held before has no meaning between the ticks.
        """
        return tuple(row for row in self.rows(problem) if HELD not in row.outputs)

    @property
    def kept_back(self) -> float:
        """How much of it the problem keeps for itself, for what it does not state."""
        return 0.0

    @property
    def tolerance(self) -> float:
        """How far an answer may leave the limit and still be accepted."""
        return tolerated(self.stated)

    @property
    def replay_tolerance(self) -> float:
        """How far the replay may leave the limit at any time, also between the instants at which it is stated."""
        return self.tolerance

    def command_bound(self, *, ideal: bool) -> float:
        """Bound on |c_k| that it implies, with an `ideal` amplifier or with one that has a pole."""
        return np.inf

    def reach(self, grid: TimeGrid) -> float:
        """Largest current that it leaves, for the scale of the problem."""
        return np.inf

    def cannot_bind(self, problem: Posed) -> str:
        """Why no admissible command can reach it, with the bound; empty where one might."""
        return ""

    def needed(self, problem: Posed) -> tuple[Self, Mapping[str, str]]:
        """Drop the rows that no admissible command can reach; the mapping says of each part why it is left out.

        Asked only of a limit that might bind.
        """
        return self, {}

    def unavoidable(self, problem: Posed) -> str:
        """Why it is missed whatever is commanded; empty where it need not be."""
        return ""

    def replayed(self, peak: float) -> str:
        """What is said of a replay that leaves it."""
        return f"replayed {self.label} {peak:.6f} {self.unit}, limit {self.stated:g} {self.unit}"

    def unresolved(self, problem: Posed, command: FloatArray, peak: float) -> str:
        """Why the replay left it although it is kept at every instant at which it is stated; empty if unknown."""
        return ""


def of_motors(row: Row, problem: Posed, shares: tuple[float, ...] = ()) -> tuple[Row, ...]:
    """Return a row for each motor of the problem's plant, and the row as it is where there is one motor.

    Parameters
    ----------
    shares : (m,) of the bounds that each motor has; empty for all of them.
    """
    motors = problem.stage.motors
    if motors == 1:
        return (row,)
    return tuple(row.of_motor(j, share) for j, share in enumerate(shares or (1.0,) * motors))


@dataclass(frozen=True)
class Limits:
    """The limits of one problem, in the order of `transopt.problem.limits.KINDS`.

    `limits["supply"]` is the one of that name; a limit that is not there binds nothing.
    """

    members: tuple[Limit, ...] = field(default=())

    def __iter__(self) -> Iterator[Limit]:
        return iter(self.members)

    def get(self, name: str) -> Limit | None:
        return next((limit for limit in self.members if limit.name == name), None)

    def __getitem__(self, name: str) -> Limit:
        found = self.get(name)
        if found is None:
            raise KeyError(name)
        return found

    def __contains__(self, name: object) -> bool:
        return any(limit.name == name for limit in self.members)

    def without(self, *names: str) -> "Limits":
        return Limits(tuple(limit for limit in self.members if limit.name not in names))

    def replaced(self, limit: Limit) -> "Limits":
        """Put this limit in the place of the one of its name."""
        return Limits(tuple(limit if each.name == limit.name else each for each in self.members))

    @property
    def input(self) -> Limit:
        """The limit on the plant's input, which every problem has."""
        return next(limit for limit in self.members if limit.scales_movement)

    @property
    def input_limit(self) -> float:
        """U, the unit of the movement's weight: the limit on |u(t)|."""
        return self.input.stated

    def command_bound(self, *, ideal: bool) -> float:
        """The bound on |c| that every admissible command obeys; that on the current where nothing else states one."""
        bound = min(limit.command_bound(ideal=ideal) for limit in self.members)
        return bound if np.isfinite(bound) else self.input_limit


def positive(key: str, value: float) -> None:
    """
    Raises
    ------
    InputError : a limit that is not > 0 and finite.
    """
    if not 0 < value < np.inf:
        raise InputError(f"limits.{key} = {value:g}: must be > 0 and finite")
