"""|z| <= stroke: the displacement of the motor mass from contact, which a mechanical stop bounds on either side."""

from dataclasses import dataclass
from typing import ClassVar

from transopt.base.signals import FloatArray
from transopt.problem.limits.limit import Setting
from transopt.problem.limits.output import OutputLimit


@dataclass(frozen=True, repr=False)
class StrokeLimit(OutputLimit):
    """The limit on the displacement z of the motor mass from contact, as the encoder reads it [m]."""

    name: ClassVar[str] = "stroke"
    label: ClassVar[str] = "stroke"
    unit: ClassVar[str] = "m"
    step_unit: ClassVar[str] = "m"
    key: ClassVar[str] = "stroke_m"
    row_names: ClassVar[tuple[str, ...]] = ("stroke",)
    needs: ClassVar[tuple[str, ...]] = ("position",)
    of_each_device: ClassVar[bool] = True
    said_without: ClassVar[str] = "the scene states no stroke limit"
    output: ClassVar[str] = "position"
    grading: ClassVar[int] = 1

    @staticmethod
    def nominal_part(setting: Setting) -> FloatArray:
        return setting.nominal_m
