"""The tables of a device file: what the owner of a device states of its encoder, sensors, amplifier and servo.

Everything has a default, that of the built-in device, so a file states only what differs. A calibration is stated as
it is measured at the desk; the device itself puts readings right by it, before anything else looks at them:

    counts         direction * counts as read
    grip           scale * grip as read - zero_N
    acceleration   scale * acceleration as read - rest_m_s2
    current        monitor_scale * current as read
    command out    command / scale of the amplifier
"""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from controller.servo.settings import LONGEST_DT_S, SCALE_LEAST, SCALE_MOST, SHORTEST_DT_S, Settings
from transopt.base.section import Positive, Section, Words

FINEST_COUNT_M, COARSEST_COUNT_M = 1e-6, 1e-4
MOST_COUNTS = 1e6
GRIP_N = 50.0  # what a hand does
LEAST_RANGE_G, MOST_RANGE_G = 1.0, 1000.0  # of an accelerometer; the least one shows gravity, and taps of little more


def _of_a_size(scale: float) -> float:
    """Refuse a sensor that is off by more: it is another sensor, to be stated in the firmware."""
    if abs(scale) < SCALE_LEAST:
        raise ValueError(f"its size must be {SCALE_LEAST:g} or more")
    return scale


Scale = Annotated[float, Field(ge=-SCALE_MOST, le=SCALE_MOST), AfterValidator(_of_a_size)]


class Encoder(Section):
    """On the motor, in metres at the tip of the stylus."""

    count_m: float = Field(
        Settings.count_m,
        ge=FINEST_COUNT_M,
        le=COARSEST_COUNT_M,
        description="path of the tip per count; all four edges of a quadrature encoder counted",
    )
    direction: Literal[-1, 1] = Field(
        1, description="1: counts grow when the stylus moves out of the object; -1: into it"
    )
    surface_counts: float = Field(
        Settings.surface_counts,
        ge=-MOST_COUNTS,
        le=MOST_COUNTS,
        description="counts, after the direction, where the surface is; `transopt-play zero` measures it",
    )


class Grip(Section):
    """The force with which the stylus is held."""

    sensor: bool = Field(True, description="whether there is a grip sensor")
    scale: Scale = Field(1.0, description="true grip over what is read; found with a known weight")
    zero_N: float = Field(0.0, ge=-GRIP_N, le=GRIP_N, description="scale times what is read when nobody holds it")
    assumed_grip_N: float = Field(
        3.0, ge=0.0, le=GRIP_N, description="taken for the grip of every tap where there is no grip sensor"
    )


class Accelerometer(Section):
    """On the stylus, positive out of the object."""

    sensor: bool = Field(True, description="whether there is an accelerometer")
    scale: Scale = Field(
        1.0, description="true acceleration over what is read; negative if it is mounted upside down"
    )
    rest_m_s2: float = Field(
        0.0,
        ge=-20.0,
        le=20.0,
        description="scale times what is read at rest: 9.81 above a level surface, 0 before an upright one",
    )
    bandwidth_Hz: float = Field(2500.0, ge=10.0, le=1e6, description="its pole, from the datasheet or its capacitor")
    range_g: float | None = Field(
        None,
        ge=LEAST_RANGE_G,
        le=MOST_RANGE_G,
        description="largest reading to either side, gravity included, before its scale; taps beyond do not count",
    )


class Power(Section):
    """The current amplifier and its monitor."""

    scale: Scale = Field(1.0, description="current that flows over current that is asked for")
    monitor_scale: Scale = Field(1.0, description="current that flows over current that the monitor reads")

    @property
    def part(self) -> float:
        """Part of the hardware's limits that a current may have, so that the command over `scale` keeps them too."""
        return min(abs(self.scale), 1.0)


class Period(Section):
    """The servo on the microcontroller."""

    dt_s: float | None = Field(
        None, ge=SHORTEST_DT_S, le=LONGEST_DT_S, description="its period; not stated: that of the library"
    )


class Limits(Section):
    """What the hardware is good for, as the device itself says it; a library that asks for more is refused."""

    current_A: Positive | None = Field(None, description="most current; not stated: what the device says")
    command_A: Positive | None = Field(None, description="most command; not stated: what the device says")
    pulse_A: Positive | None = Field(None, description="most test pulse of the check; not stated: 0.1")


class DeviceFile(Section):
    """One device.

    Attributes
    ----------
    name : in words.
    encoder, grip, accelerometer, amplifier, servo, hardware : its tables.
    """

    name: Words = "the built-in device"
    encoder: Encoder = Encoder()
    grip: Grip = Grip()
    accelerometer: Accelerometer = Accelerometer()
    amplifier: Power = Power()
    servo: Period = Period()
    hardware: Limits = Limits()


BUILT_IN = DeviceFile()
TABLES: dict[str, type[Section]] = {
    "encoder": Encoder,
    "grip": Grip,
    "accelerometer": Accelerometer,
    "amplifier": Power,
    "servo": Period,
    "hardware": Limits,
}
