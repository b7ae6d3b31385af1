"""|dz/dt| <= velocity: the limit on the speed of the motor mass that an encoder or a bearing sets."""

from dataclasses import dataclass
from typing import ClassVar

from transopt.base.signals import FloatArray
from transopt.problem.limits.limit import Setting
from transopt.problem.limits.output import OutputLimit


@dataclass(frozen=True, repr=False)
class VelocityLimit(OutputLimit):
    """The limit on the velocity dz/dt of the motor mass [m/s]; it begins at the incoming speed."""

    name: ClassVar[str] = "velocity"
    label: ClassVar[str] = "velocity"
    unit: ClassVar[str] = "m/s"
    step_unit: ClassVar[str] = "m/s"
    key: ClassVar[str] = "velocity_m_s"
    row_names: ClassVar[tuple[str, ...]] = ("velocity",)
    needs: ClassVar[tuple[str, ...]] = ("velocity",)
    of_each_device: ClassVar[bool] = True
    said_without: ClassVar[str] = "the scene states no velocity limit"
    output: ClassVar[str] = "velocity"

    @staticmethod
    def nominal_part(setting: Setting) -> FloatArray:
        return setting.nominal_m_s
