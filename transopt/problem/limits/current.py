"""|i(t)| <= I for all t: of a motor that a current drives its transient limit (seed Eq. 8), else that of a coil."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.state_space import CURRENT_INPUT, VOLTAGE_INPUT
from transopt.problem.limits.input import InputLimit
from transopt.problem.limits.limit import Setting
from transopt.problem.limits.output import OutputLimit


@dataclass(frozen=True, repr=False)
class CurrentLimit(InputLimit):
    """The limit on the total current [A], > 0, where a current is the input."""

    name: ClassVar[str] = "current"
    label: ClassVar[str] = "current"
    unit: ClassVar[str] = "A"
    step_unit: ClassVar[str] = "A"
    key: ClassVar[str] = "current_A"
    driven_by = CURRENT_INPUT
    row_names: ClassVar[tuple[str, ...]] = ("current",)


@dataclass(frozen=True, repr=False)
class CoilCurrentLimit(OutputLimit):
    """The limit on the current of a coil that a voltage drives [A], > 0: an output of the plant like any other."""

    name: ClassVar[str] = "current"
    label: ClassVar[str] = "coil current"
    unit: ClassVar[str] = "A"
    step_unit: ClassVar[str] = "A"
    key: ClassVar[str] = "current_A"
    driven_by = VOLTAGE_INPUT
    row_names: ClassVar[tuple[str, ...]] = ("current",)
    needs: ClassVar[tuple[str, ...]] = ("current",)
    of_each_device: ClassVar[bool] = True
    said_without: ClassVar[str] = "the scene states no limit on the coil's current"
    output: ClassVar[str] = "current"

    @staticmethod
    def nominal_part(setting: Setting) -> FloatArray:
        return np.zeros(setting.grid.stages)
