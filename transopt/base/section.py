"""The building blocks of settings files: numbers with bounds, and a table that refuses unknown keys."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from transopt.base.shown import brief

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Speed = Annotated[float, Field(ge=1e-4, le=100)]
Temperature = Annotated[float, Field(ge=-100, le=500)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Section(BaseModel):
    """A table of a settings file: unknown keys are refused, values never change after loading."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    __repr__ = brief
