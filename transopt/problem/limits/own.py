"""A limit that the user states as an expression with a lower and an upper bound.

`solvers.own` reads the expression. If it is linear in its outputs, with coefficients that are constant along the
horizon, it becomes an ordinary row. Otherwise it is a `Law`, a function of the outputs whose values and derivatives
are computed outside this package, which does not load CasADi; the problem is then not a quadratic program.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.plant.discretise import AFTER, Motion
from transopt.plant.state_space import Input
from transopt.problem.limits.limit import Limit, Posed, Setting
from transopt.problem.limits.row import COMMAND, HELD, INPUT, Row, output_values

OF_EVERY_STAGE = (COMMAND, HELD)


class Law(Protocol):
    """A function of m outputs (m, N), evaluated stage by stage.

    Attributes
    ----------
    text : the function as CasADi serialises it; two laws with the same text are equal.
    """

    @property
    def text(self) -> str: ...

    @property
    def convex(self) -> tuple[bool, bool]:
        """Whether a lower and whether an upper bound on it is proven to leave a convex set."""

    def value(self, outputs: FloatArray) -> FloatArray:
        """(N,) values."""

    def slopes(self, outputs: FloatArray) -> FloatArray:
        """(m, N) derivatives by the outputs."""


LawOf = Callable[[str], Law]


@dataclass(frozen=True)
class LawRow(Row):
    """A row whose value is a nonlinear function of its outputs.

    Attributes
    ----------
    nominal : output -> (N,) or 0, the nominal motion's part of it.
    law : function of the outputs in their order, the nominal motion included.
    convex : whether the feasible set is proven convex: the law is convex if it has an upper bound, and concave if it
        has a lower one.
    """

    nominal: Mapping[str, FloatArray | float] = None  # type: ignore[assignment]
    law: Law = None  # type: ignore[assignment]
    convex: bool = False

    @property
    def linear(self) -> bool:
        return False

    def arguments(self, motion: Motion, command: FloatArray) -> FloatArray:
        """(m, ..., N) outputs, the nominal motion included."""
        return np.stack([output_values(name, motion, command) + self.nominal[name] for name in self.outputs])

    def value(self, motion: Motion, command: FloatArray) -> FloatArray:
        return _along_courses(self.law.value, self.arguments(motion, command))

    def by_outputs(self, motion: Motion, command: FloatArray, gradient: FloatArray) -> dict[str, FloatArray]:
        slopes = _along_courses(self.law.slopes, self.arguments(motion, command))
        return {name: slope * gradient for name, slope in zip(self.outputs, slopes, strict=True)}


def _along_courses(law: Callable[[FloatArray], FloatArray], outputs: FloatArray) -> FloatArray:
    """A function of outputs (m, N), evaluated at (m, ..., N) along each course."""
    if outputs.ndim == 2:
        return law(outputs)
    return np.stack([_along_courses(law, outputs[:, course]) for course in range(outputs.shape[1])], axis=-2)


@dataclass(frozen=True, repr=False)
class OwnLimit(Limit):
    """lower <= expression <= upper at the switching instants.

    Attributes
    ----------
    lower, upper : infinite where there is no bound.
    row : the bounded value.
    """

    key: ClassVar[str] = "own"
    signed: ClassVar[bool] = True

    lower: float
    upper: float
    row: Row

    @classmethod
    def relieved_by(cls) -> Mapping[str, bool]:
        return {}

    @classmethod
    def dispensed_by(cls) -> str:
        return f"limits.{cls.key}.{cls.name}"

    @property
    def stated(self) -> float:
        return max(abs(bound) for bound in (self.lower, self.upper) if np.isfinite(bound)) or 1.0

    @property
    def room(self) -> float:
        """Half the distance of two bounds, which may both lie far from zero; of a single one the bound."""
        width = self.upper - self.lower
        return width / 2 if 0 < width < np.inf else self.stated

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        raise NotImplementedError("made by own_limits")

    def __reduce__(self) -> tuple[Any, ...]:
        # The class is generated for this name, so pickle cannot import it: another process generates it again.
        return _made, (self.name, self.unit, self.lower, self.upper, self.row)

    @property
    def linear(self) -> bool:
        return self.row.linear

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        own = replace(self.row, lower=self.lower, upper=self.upper)
        count = len(problem.devices) if follows_motion(own.outputs, problem.stage.plant.driven_by) else 1
        return tuple(own.of_device(device) for device in range(count))

    def watched(self, problem: Posed) -> tuple[Row, ...]:
        # It is defined at the switching instants only.
        return ()

    def wider(self, factor: float) -> Self:
        by = (factor - 1) * self.stated
        return type(self)(self.lower - by, self.upper + by, self.row)

    def written(self, by: float = 0.0, *, lower: bool = False) -> float:
        return self.lower - by if lower else self.upper + by

    def bound_in_words(self, side: str, *, two_sided: bool) -> str:
        return f"{self.written(lower=side == 'lower'):.8g}"


def follows_motion(outputs: Iterable[str], driven_by: Input) -> bool:
    """Whether outputs depend on the motion, which differs between the devices of a spread.

    The current of a voltage-driven coil does, through the back-EMF.
    """
    return not {*outputs} <= {*OF_EVERY_STAGE, INPUT, driven_by.name}


def outputs_needed(tables: Sequence[Mapping[str, Any]], driven_by: Input) -> list[str]:
    """Names of the outputs that a stage model must provide for these limits, beyond its input and commands."""
    named = [name.removesuffix(AFTER) for table in tables for name in table["outputs"]]
    return [name for name in dict.fromkeys(named) if name not in (*OF_EVERY_STAGE, driven_by.name)]


def own_limits(tables: Sequence[Mapping[str, Any]], setting: Setting, law_of: LawOf | None) -> tuple[OwnLimit, ...]:
    """The limits of these tables, which `solvers.own` writes.

    Raises
    ------
    InputError : offsets for another number of stages, or a nonlinear expression without a `law_of` to evaluate it.
    """
    found = []
    driven_by = setting.stage.plant.driven_by.name
    for table in tables:
        names = [INPUT if name == driven_by else name for name in table["outputs"]]
        lower = -np.inf if table["lower"] is None else float(table["lower"])
        upper = np.inf if table["upper"] is None else float(table["upper"])
        part = {name: _nominal(name, setting) for name in names}
        row: Row
        if table["coefficients"] is not None:
            offset = np.asarray(table["offsets"], dtype=float)
            if offset.size not in (1, setting.grid.stages):
                raise InputError(
                    f"limits.own: {table['name']} was read for {offset.size} stages, the problem has "
                    f"{setting.grid.stages}: load the scene again"
                )
            outputs = dict(zip(names, table["coefficients"], strict=True))
            moved = sum((coefficient * part[name] for name, coefficient in outputs.items()), start=offset)
            row = Row(table["name"], outputs, lower, upper, np.broadcast_to(moved, setting.grid.stages))
        else:
            if law_of is None:
                raise InputError(
                    f"limits.own: {table['name']} is not linear: give `law_of`, which evaluates its expression"
                )
            outputs, law = dict.fromkeys(names, 1.0), law_of(table["function"])
            row = LawRow(
                table["name"],
                outputs,
                lower,
                upper,
                nominal=part,
                law=law,
                convex=(upper == np.inf or law.convex[1]) and (lower == -np.inf or law.convex[0]),
            )
        found.append(_made(table["name"], table["unit"], lower, upper, row))
    return tuple(found)


def _made(name: str, unit: str, lower: float, upper: float, row: Row) -> OwnLimit:
    return _kind(name, unit)(lower, upper, row)


def _nominal(name: str, setting: Setting) -> FloatArray | float:
    """(N,) or 0: the nominal motion's part of an output; 0 for an output after the period, a deviation."""
    if name in (INPUT, *OF_EVERY_STAGE) or name.endswith(AFTER):
        return 0.0
    follows = setting.stage.plant.output(name).follows
    if follows == "position":
        return setting.nominal_m
    return setting.nominal_m_s if follows == "velocity" else 0.0


def _kind(name: str, unit: str) -> type[OwnLimit]:
    """The subclass of `OwnLimit` for a limit of this name and unit."""
    words = {"name": name, "label": name, "unit": unit, "step_unit": unit, "row_names": (name,)}
    return type(f"OwnLimit_{name}", (OwnLimit,), words)
