"""Building blocks of settings files: numbers with bounds, and a table that refuses unknown keys."""

import inspect
import re
from itertools import pairwise
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from transopt.base.shown import brief
from transopt.base.units import beyond

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Speed = Annotated[float, Field(ge=1e-4, le=100)]
Temperature = Annotated[float, Field(ge=-100, le=500)]
Finite = Annotated[float, Field(allow_inf_nan=False)]

LONGEST_NAME = 100
OF_THE_KEY = ("constant", "per_newton")  # keys of a parameter that is linear in grip; both have the parameter's unit


def _named(text: str) -> str:
    """Check that a name is valid as the name of a folder: results are written to out/NAME."""
    if not text.strip() or text != text.strip() or len(text) > LONGEST_NAME or not text.isprintable():
        raise ValueError(f"must be 1 to {LONGEST_NAME} printable characters, without spaces at its ends")
    if any(mark in text for mark in '/\\:*?"<>|') or text.strip(".") == "":
        raise ValueError('names the folder of the results: must be without / \\ : * ? " < > | and not only dots')
    return text


def _worded(text: str) -> str:
    """Check that a text has no control characters but line breaks and tabs."""
    odd = next((c for c in text if not c.isprintable() and c not in "\n\t"), None)
    if odd is not None:
        raise ValueError(f"holds the control character {odd!a}, which a terminal may obey: take it out")
    return text


def increasing(values: list[float]) -> list[float]:
    """Check that nodes are strictly increasing; a field validator of any table that has some."""
    if any(b <= a for a, b in pairwise(values)):
        raise ValueError("must be strictly increasing, without duplicates")
    return values


Name = Annotated[str, AfterValidator(_named)]
Words = Annotated[str, AfterValidator(_worded)]


class Section(BaseModel):
    """A table of a settings file: unknown keys are refused, values never change after loading.

    No number may be larger than its unit allows (`transopt.base.units`), whatever other bounds its key has. The
    validator of a table is built when the first table of its kind is made: a scene has few of all the kinds.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)

    __repr__ = brief

    @field_validator("*")
    @classmethod
    def _possible(cls, value: Any, info: ValidationInfo) -> Any:
        # The numbers of {constant, per_newton} have the unit of this key; other tables check their own numbers.
        numbers = [getattr(value, name, None) for name in OF_THE_KEY] if isinstance(value, Section) else value
        if said := beyond(info.field_name or "", numbers):
            raise ValueError(said)
        return value


def meanings(table: type) -> dict[str, str]:
    """Field -> its description below Attributes in the docstring of the table's class or of a base class."""
    said: dict[str, str] = {}
    for owner in reversed(table.__mro__):
        _, _, listed = inspect.cleandoc(owner.__doc__ or "").partition("Attributes\n----------\n")
        for found in re.finditer(r"^(\w+) : (.+?)(?=^\w|\Z)", listed, re.DOTALL | re.MULTILINE):
            said[found[1]] = " ".join(found[2].split())
    return said
