"""The interface of a limit, whose rows (`row`) all solvers and proofs read, and the limits of one problem."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.coil import Circuit, CoilModel
from transopt.plant.discretise import StageModel
from transopt.plant.state_space import Input
from transopt.plant.time_grid import TimeGrid
from transopt.plant.wall import HandOver
from transopt.problem.heat import Budget
from transopt.problem.limits.row import HELD, Row

SIDES = ("lower", "upper")  # the two bounds of a row
VIOLATION_TOLERANCE = 1e-6  # in the limit's unit; relative to a limit below one unit


def tolerated(limit: float) -> float:
    """Largest accepted violation of a limit, in its unit: absolute, but relative to a limit below one unit."""
    return VIOLATION_TOLERANCE * min(limit, 1.0)


class Posed(Protocol):
    """The part of a problem that its limits may read."""

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
    """The data of a tap from which limits are built, besides the numbers that the scene states.

    Attributes
    ----------
    stage : device under the entry's grip.
    grid : time axis.
    circuit : terminals of the motor or coil; None where the scene states the drive at the tip.
    coil : thermal model with the temperatures at the start; None without motor data.
    budget : further requirements on the winding's temperature.
    wall : the virtual wall during this tap; None without one.
    reference_m_s2 : (N,) r at the switching instants.
    nominal_m, nominal_m_s : (N,) nominal motion z_nom and its derivative at the switching instants; zero for a mass
        that moves in a case, whose position does not include the hand's motion.
    spread : further devices that the same command drives.
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
        """The entry's device, then those of the spread."""
        return (self.stage, *self.spread)

    def input_limit(self, asked: Mapping[str, Any]) -> float:
        """The limit on the plant's input among the numbers of the scene's table `limits`."""
        driven_by = self.stage.plant.driven_by
        return float(asked[f"{driven_by.name}_{driven_by.unit}"])


@dataclass(frozen=True, eq=False)
class Limit(ABC):
    """One limit of one entry's problem.

    Attributes
    ----------
    name : identifies the limit in code and in `left_out` of a library.
    label : its name in reports of what binds; by default `name`.
    unit : unit of the bounded quantity. step_unit : unit of differences of it; by default `unit`.
    key : scene key below `limits` that states its number; empty where the number is stated elsewhere.
    driven_by : input of the plants it applies to; None for any.
    implied : whether a problem may have it without a number below `limits`.
    row_names : names of all rows that it can have for one device; by default `name`.
    sides : the bounds that its rows have.
    needs : outputs that its rows use beyond those of every stage model.
    in_every_file : whether a library stores its multipliers even if the problem does not have the limit.
    after_the_waveform : whether the replay checks it after the waveform too, where a wall may still push.
    scales_movement : whether it is the unit I of the movement's weight in J.
    indispensable : whether the problem needs it to bound the command, so that it can never be left out.
    price_step : step by which its price is computed, in `unit`; infinite for a share of the limit.
    of_each_device : whether it depends on the motion, so that a spread has rows for each device (`device_row`).
    signed : whether its bounds have their own numbers; otherwise it bounds a magnitude, by one number.
    of_each_motor : whether plants with several motors can have it, with rows for each motor (`motor_row`).
    asks_for : what a scene has to state besides its number, in words; empty for nothing.
    said_without : why a problem does not have it, in words.
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
    signed: ClassVar[bool] = False
    of_each_motor: ClassVar[bool] = False
    asks_for: ClassVar[str] = ""
    said_without: ClassVar[str] = ""

    __repr__ = brief

    def __init_subclass__(cls) -> None:
        """Name and unit also serve as label, row and unit of differences of a kind that does not state these."""
        stated = vars(cls)
        if "name" in stated:
            cls.label, cls.row_names = stated.get("label", cls.name), stated.get("row_names", (cls.name,))
        if "unit" in stated:
            cls.step_unit = stated.get("step_unit", cls.unit)

    @property
    @abstractmethod
    def stated(self) -> float:
        """The limit's number in the unit that the user states it in."""

    @classmethod
    @abstractmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        """Build the limit for a tap from the scene's numbers; None if it does not apply.

        Called only where the scene states its number, or where it is `implied`.

        Parameters
        ----------
        asked : key of the scene's table `limits` -> number or None.
        """

    @abstractmethod
    def wider(self, factor: float) -> Self:
        """The limit multiplied by `factor`."""

    def raised(self, by: float) -> Self:
        """The limit increased by so much, in its own unit, on both sides."""
        return self.wider(1 + by / self.stated)

    @cached_property
    def is_hashable(self) -> bool:
        """Whether equal ones can be found; one that holds a course of the tap's nominal motion cannot be hashed."""
        try:
            hash(self)
        except TypeError:
            return False
        return True

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        """The rows of the limit; none for a limit that has its own states, the temperature."""
        return ()

    @property
    def linear(self) -> bool:
        """Whether all its rows are linear, so that a quadratic program can contain it."""
        return True

    def written(self, by: float = 0.0, *, lower: bool = False) -> float:
        """The number that the user writes for a bound, once the limit is raised by so much, in `key_unit`."""
        return self.key_scale * (self.stated + by)

    def missed(self, by: float, *, lower: bool = False) -> str:
        """A violation of a bound by so much, in words."""
        side = "below" if lower and self.signed else "over"
        return (
            f"{self.label} {self.key_scale * by:.3g} {self.key_unit(step=True)} {side} its limit "
            f"{self.written(lower=lower):.8g} {self.key_unit()}"
        )

    def bound_in_words(self, side: str, *, two_sided: bool) -> str:
        """The bound of one side as reports state it where it binds."""
        sign = {"lower": "-", "upper": "+" if two_sided else ""}[side]
        return f"{sign}{self.key_scale * self.stated:.8g}"

    @property
    def key_scale(self) -> float:
        """Factor from a number in `unit` to one in `key_unit`, the unit of the scene key."""
        return 1.0

    @classmethod
    def key_unit(cls, *, step: bool = False) -> str:
        """Unit in which sentences state the limit or, with `step`, differences of it: that of the scene key."""
        return (cls.step_unit if step else cls.unit).replace("/tick", "/s")

    @classmethod
    def concerns(cls, driven_by: Input) -> bool:
        """Whether it applies to plants with this input."""
        return cls.driven_by in (None, driven_by)

    @classmethod
    def suits(cls, circuit: Circuit | None) -> bool:
        """Whether this kind applies to a device with this circuit; of several kinds with one key exactly one does."""
        return True

    @classmethod
    def stored_with(cls, row: str) -> str:
        """Key among a library's limits that implies the multipliers of a row; empty if it always has them."""
        return "" if cls.in_every_file else cls.key

    @classmethod
    def base_unit(cls) -> str:
        """Unit of its violations and of the inverse of its multipliers: `step_unit` without "/tick"."""
        return cls.step_unit.removesuffix("/tick")

    @classmethod
    def relieved_by(cls) -> Mapping[str, bool]:
        """Dotted scene key that relaxes the limit -> True if by raising it, False if by lowering it."""
        return {f"limits.{cls.key}": True}

    @classmethod
    def dispensed_by(cls) -> str:
        """Dotted scene key whose removal removes the limit; empty if none does."""
        return "" if cls.implied or cls.scales_movement else f"limits.{cls.key}"

    @property
    def room(self) -> float:
        """The usable part of the limit, the reference for relative steps of it."""
        return self.stated

    def watched(self, problem: Posed) -> tuple[Row, ...]:
        """Rows that the replay checks at all times; an offset of shape (N + 1,) reaches to tau_N.

        For c_k the replay takes the command that acts. Rows with c_(k-1) have no meaning between two instants.
        """
        return tuple(row for row in self.rows(problem) if HELD not in row.outputs)

    @property
    def kept_back(self) -> float:
        """Margin by which the problem tightens the limit for what happens between the switching instants."""
        return 0.0

    @property
    def tolerance(self) -> float:
        """Largest accepted violation at the instants at which it is stated."""
        return tolerated(self.stated)

    @property
    def replay_tolerance(self) -> float:
        """Largest accepted violation in the replay, at any time."""
        return self.tolerance

    def command_bound(self, *, ideal: bool) -> float:
        """Bound on |c_k| that it implies, with an `ideal` amplifier or with one that has a pole."""
        return np.inf

    def reach(self, grid: TimeGrid) -> float:
        """Largest plant input that it permits, from which the problem's scale is derived."""
        return np.inf

    def cannot_bind(self, problem: Posed) -> str:
        """Proof in words that no admissible command reaches the limit; empty if one might."""
        return ""

    def needed(self, problem: Posed) -> tuple[Self, Mapping[str, str]]:
        """The limit without the rows that no admissible command reaches; removed part -> proof in words.

        Called only for a limit that might bind.
        """
        return self, {}

    def unavoidable(self, problem: Posed) -> str:
        """Why every command violates the limit, in words; empty if that is not known."""
        return ""

    def replayed(self, peak: float) -> str:
        """Message for a replay whose peak violates the limit."""
        return f"replayed {self.label} {peak:.6f} {self.unit}, limit {self.stated:g} {self.unit}"

    def unresolved(self, problem: Posed, command: FloatArray, peak: float) -> str:
        """Why the replay violates the limit although its rows hold at the switching instants; empty if unknown."""
        return ""


def of_motors(row: Row, problem: Posed, shares: tuple[float, ...] = ()) -> tuple[Row, ...]:
    """The row once for each motor of the problem's plant; unchanged if there is only one.

    Parameters
    ----------
    shares : (m,) share of the bounds for each motor; empty for 1 each.
    """
    motors = problem.stage.motors
    if motors == 1:
        return (row,)
    return tuple(row.of_motor(j, share) for j, share in enumerate(shares or (1.0,) * motors))


@dataclass(frozen=True)
class Limits:
    """The limits of one problem, in the order of `transopt.problem.limits.KINDS`, by name: `limits["supply"]`."""

    members: tuple[Limit, ...] = field(default=())

    def __iter__(self) -> Iterator[Limit]:
        return iter(self.members)

    @cached_property
    def are_hashable(self) -> bool:
        """Whether each of them is, so that equal ones can be found."""
        return all(limit.is_hashable for limit in self.members)

    @cached_property
    def nonlinear(self) -> tuple[str, ...]:
        """Names of those that are not linear."""
        return tuple(limit.name for limit in self.members if not limit.linear)

    def get(self, name: str) -> Limit | None:
        return next((limit for limit in self.members if limit.name == name), None)

    def __getitem__(self, name: str) -> Limit:
        found = self.get(name)
        if found is None:
            raise KeyError(name)
        return found

    def __contains__(self, name: object) -> bool:
        return any(limit.name == name for limit in self.members)

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash(self.members)

    def without(self, *names: str) -> "Limits":
        """The limits that have none of these names; equal questions have the same object as their answer."""
        if names not in self._without:
            self._without[names] = Limits(tuple(limit for limit in self.members if limit.name not in names))
        return self._without[names]

    @cached_property
    def _without(self) -> dict[tuple[str, ...], "Limits"]:
        return {}

    def replaced(self, limit: Limit) -> "Limits":
        """Replace the limit of the same name by this one."""
        return Limits(tuple(limit if each.name == limit.name else each for each in self.members))

    @cached_property
    def input(self) -> Limit:
        """The limit on the plant's input, which every problem has."""
        return next(limit for limit in self.members if limit.scales_movement)

    @property
    def input_limit(self) -> float:
        """U, the limit on |u(t)|, which is the unit of the movement's weight."""
        return self.input.stated

    def command_bound(self, *, ideal: bool) -> float:
        """Bound on |c_k| of every admissible command; the input's limit where no other limit bounds the command."""
        bound = min(limit.command_bound(ideal=ideal) for limit in self.members)
        return bound if np.isfinite(bound) else self.input_limit


def positive(key: str, value: float) -> None:
    """Check that a limit is > 0 and finite."""
    if not 0 < value < np.inf:
        raise InputError(f"limits.{key} = {value:g}: must be > 0 and finite")
