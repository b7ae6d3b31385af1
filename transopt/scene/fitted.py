"""Common part of all model parts that were fitted: covariance, intervals, source files.

`transopt.scene.model_parts` defines the parts. This file defines what they share, and how other values are drawn from
the covariance.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, ValidationError, field_validator, model_validator

from transopt.base.errors import InputError
from transopt.base.section import Finite, Section, Words
from transopt.base.signals import FloatArray
from transopt.base.sizes import MOST_STATES
from transopt.base.toml import in_words

KINDS = ("drive", "state_space", "second_order", "fourth_order")
SYMMETRY = 1e-6  # tolerance of symmetry and eigenvalues, relative to the standard deviations, for rounding

Interval = tuple[Finite, Finite]


class Source(Section):
    """A file that a part was fitted to.

    Attributes
    ----------
    file : name of the file.
    sha256 : hash of its bytes.
    """

    file: Words
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class ModelPart(Section):
    """Common fields of all parts.

    Attributes
    ----------
    verdict : which designs the part supports, in plain words.
    shortfalls : why it is not fit to design with, one sentence each; empty for a part that is fit.
    sources : files that it was fitted to.
    """

    verdict: Words
    shortfalls: list[Words] = Field(default_factory=list)
    sources: list[Source]


class FittedPart(ModelPart):
    """A part with fitted numbers.

    Attributes
    ----------
    intervals : name -> lower and upper end of the 95 % interval.
    parameters : dotted names of the p fitted values.
    covariance : (p, p) covariance of `parameters`, in their order, in SI units.
    """

    intervals: dict[str, Interval]
    parameters: Annotated[list[str], Field(max_length=MOST_STATES)]
    covariance: Annotated[list[list[Finite]], Field(max_length=MOST_STATES)]

    @field_validator("intervals")
    @classmethod
    def _ordered(cls, intervals: dict[str, Interval]) -> dict[str, Interval]:
        for name, (lower, upper) in intervals.items():
            if lower > upper:
                raise ValueError(f"{name}: its lower bound {lower:g} is above its upper bound {upper:g}")
        return intervals

    @model_validator(mode="after")
    def _covariance_of_the_parameters(self) -> Self:
        known = numbers(self.model_dump())
        for name in self.parameters:
            if name not in known:
                raise ValueError(f"parameters: {name} is no number of this part; known: {', '.join(known)}")
        if len(set(self.parameters)) < len(self.parameters):
            raise ValueError("parameters: a name occurs twice")
        p = len(self.parameters)
        if len(self.covariance) != p or any(len(row) != p for row in self.covariance):
            raise ValueError(f"covariance: must be {p} by {p}, one row per name in parameters")
        if p == 0:
            return self
        covariance = np.array(self.covariance)
        variance = np.diagonal(covariance)
        if np.any(variance < 0):
            raise ValueError(f"covariance: negative variance of {self.parameters[int(np.argmin(variance))]}")
        deviation = np.where(variance > 0, np.sqrt(variance), 1.0)
        scaled = covariance / np.outer(deviation, deviation)
        if np.abs(scaled - scaled.T).max() > SYMMETRY:
            raise ValueError("covariance: not symmetric")
        if np.linalg.eigvalsh((scaled + scaled.T) / 2)[0] < -SYMMETRY:
            raise ValueError("covariance: has a negative eigenvalue, so it is not a covariance")
        return self

    def values(self) -> FloatArray:
        """(p,) values of `parameters`."""
        known = numbers(self.model_dump())
        return np.array([known[name] for name in self.parameters])

    def with_values(self, values: Sequence[float] | FloatArray) -> Self:
        """The part with other values (p,) of `parameters`.

        Raises
        ------
        InputError : invalid values, for example of a device that is not passive.
        """
        content = self.model_dump()
        for name, value in zip(self.parameters, values, strict=True):
            *tables, last = name.split(".")
            table = content
            for key in tables:
                table = table[key]
            table[last] = float(value)
        try:
            return type(self).model_validate(content)
        except ValidationError as error:
            raise InputError(complaint(error)) from None

    def factor(self) -> FloatArray:
        """(p, p) L with L L' = covariance: L times p standard normal numbers is a random error of the values."""
        covariance = np.array(self.covariance).reshape(len(self.parameters), -1)
        variance = np.diagonal(covariance)
        deviation = np.where(variance > 0, np.sqrt(variance), 1.0)
        # Scaled to correlations first, as variances of stiffnesses and masses differ by many orders of magnitude.
        size, along = np.linalg.eigh((covariance + covariance.T) / 2 / np.outer(deviation, deviation))
        return np.asarray(deviation[:, None] * along * np.sqrt(np.maximum(size, 0.0)))


def numbers(content: Mapping[str, Any], prefix: str = "") -> dict[str, float]:
    """The numbers of a part by dotted name, without those that describe the fit (intervals, errors)."""
    by_name: dict[str, float] = {}
    for name, value in content.items():
        if isinstance(value, Mapping) and name not in ("intervals", "nrmse", "error", "predicted"):
            by_name |= numbers(value, f"{prefix}{name}.")
        elif isinstance(value, float):
            by_name[f"{prefix}{name}"] = value
    return by_name


def complaint(error: ValidationError) -> str:
    """One line with pydantic's first complaint about a part: field, value, what is wrong, number of further ones."""
    errors = error.errors()
    first = min(errors, key=lambda found: found["type"] != "extra_forbidden")
    # Pydantic also lists the kind of a device or a hand in the location.
    where = ".".join(str(part) for part in first["loc"] if part not in KINDS)
    message = in_words(first["msg"])
    if first["type"] == "extra_forbidden":
        message = "unknown field"
    elif first["type"] == "missing":
        message = "missing"
    elif isinstance(first["input"], str | int | float):
        where += f" = {first['input']!r}"
    more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
    return f"{where}: {message}{more}" if where else f"{message}{more}"
