"""The electronics of a device in one file: from datasheet values to resistors, scales and limits.

    converter -> shift -> amplifier -> motor -> monitor -> divider -> converter

A converter of 0 to 3.3 V becomes the input of +-10 V of a servo amplifier by one operational amplifier. Its inverting
input has a resistor to the reference, one to ground and the feedback. The amplifier's monitor comes back by a divider
to the reference, about its middle. A plain H-bridge has a shunt amplifier that speaks about that middle, and a PI
stage that closes the loop. Scales are those of the resistors of a series, not of the ideal ones.
"""

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from controller.servo.settings import DELAY_TICKS, LONGEST_DT_S, ROUNDED_TICKS, SHORTEST_DT_S
from transopt.base.errors import InputError
from transopt.base.section import Finite, Positive, Section, Words
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.plant.motor import Motor

# IEC 60063 computes E96; E24 is a list, since it departs from the formula.
E24 = (
    *(1.0, 1.1, 1.2, 1.3, 1.5, 1.6, 1.8, 2.0, 2.2, 2.4, 2.7, 3.0),
    *(3.3, 3.6, 3.9, 4.3, 4.7, 5.1, 5.6, 6.2, 6.8, 7.5, 8.2, 9.1),
)
E96 = tuple(round(10 ** (k / 96), 2) for k in range(96))
BASE_OHM = 10e3  # of the resistors: little noise, and a load that any operational amplifier drives
RAIL_COUNTS = 8  # so near to an end of the converter's range there is no number
HEADROOM = 0.97  # of a converter's range that the over-current may take
OUTPUT_ROOM_V = (
    0.2  # that a converter's output buffer keeps from either rail (STM32F405, DS8626: DAC_OUT with the buffer on)
)
OVER_CURRENT = 1.3  # on the largest current: above what a check and a tap overshoot by, below what harms
POLE_ROOM = 1.5  # by which the amplifier's pole may differ from the stated one, up and down
# Table -> unit of its sensor, and the reaches of such sensors: beyond them another unit was stated.
REACHES = {"accelerometer": ("g", 5.0, 1000.0), "grip": ("N", 2.0, 1000.0)}
LEAST_RANGE_G = 13.0  # the built-in taps reach 10.9 g, gravity adds 1 g, and the last 2 % of a range count as its end
NOISE_HZ = 10e3  # of the filter before a converter that is read every 100 us

Part = Annotated[float, Field(ge=0, le=0.2)]


class Converter(Section):
    """The microcontroller's side."""

    supply_V: Positive = Field(3.3, description="range of both converters, and reference of the circuit")
    bits: int = Field(12, ge=8, le=16, description="of both converters")
    output: Literal["dac", "pwm"] = Field("dac", description="what puts the command out")
    pwm_Hz: Positive = Field(36621.09, description="of a PWM output")

    @property
    def counts(self) -> int:
        return 1 << self.bits


class Power(Section):
    """What amplifier and motor are used for."""

    current_A: Positive = Field(description="most current, with the amplifier's own limit at or below it")
    command_A: Positive = Field(description="most command, which overshoots the current to make it rise")
    pole_Hz: Positive = Field(description="of the current loop, as set or guessed; `transopt identify` measures it")
    delay_s: float = Field(7e-5, ge=0, le=1e-2, description="of the amplifier, beyond the hold of the command")
    ambient_C: Finite = Field(35.0, description="warmest surroundings of the motor")


class Servo(Section):
    """A servo amplifier with an analogue input and monitor, such as an ESCON 50/5."""

    input_V: Positive = Field(10.0, description="its input goes from minus to plus this")
    input_V_A: Positive = Field(description="volt at its input for an ampere, as set in it")
    monitor_V_A: Positive = Field(description="volt of its monitor for an ampere, as set in it")


class Bridge(Section):
    """A plain H-bridge that is switched by a triangle, with a shunt amplifier and a PI stage."""

    motor_V: Positive = Field(description="supply of the bridge")
    shunt_ohm: Positive = Field(description="in the motor's line")
    sense_gain: Positive = Field(description="of the shunt amplifier; its reference is the middle of the supply")
    triangle_V: Positive = Field(description="from peak to peak, about the same middle")
    sense_tolerance: Part = Field(0.01, description="of shunt and shunt amplifier together")


class Shaft(Section):
    """The encoder on the motor's shaft."""

    lines: int = Field(ge=1, le=100_000, description="per turn; all four edges of each are counted")
    direction: Literal[-1, 1] = Field(1, description="-1 where counts fall while the stylus moves out of the object")


class Sensor(Section):
    """An analogue sensor."""

    V_per_unit: Finite = Field(description="volt per newton of a grip sensor, per g of an accelerometer; may be < 0")
    zero_V: Positive = Field(description="what it gives at zero")

    @model_validator(mode="after")
    def _shows_something(self) -> Self:
        if self.V_per_unit == 0:
            raise ValueError("V_per_unit = 0: a sensor that shows nothing")
        return self


class Accelerometer(Sensor):
    """The accelerometer on the stylus."""

    bandwidth_Hz: Positive = Field(2500.0, description="its pole")
    range_g: Positive = Field(description="of the sensor to either side, gravity included, from its datasheet")


class Circuit(Section):
    """A circuit file. servo or bridge : the one that is there; `grip` may be left out."""

    name: Words
    motor: str
    transmission: str
    dt_s: float = Field(1e-4, ge=SHORTEST_DT_S, le=LONGEST_DT_S)
    resistors: Part = Field(0.01, description="tolerance of the resistors")
    converter: Converter = Converter()
    power: Power
    servo: Servo | None = None
    bridge: Bridge | None = None
    encoder: Shaft
    accelerometer: Accelerometer
    grip: Sensor | None = None

    @model_validator(mode="after")
    def _one_amplifier_in_time(self) -> Self:
        if (self.servo is None) == (self.bridge is None):
            raise ValueError("state one amplifier: a table [servo] or a table [bridge]")
        if self.power.delay_s > (DELAY_TICKS + ROUNDED_TICKS) * self.dt_s:
            raise ValueError(
                f"power.delay_s = {1e3 * self.power.delay_s:g} ms: must be {1e3 * DELAY_TICKS * self.dt_s:g} ms at "
                f"most, {DELAY_TICKS} servo periods of dt_s: take an amplifier with less delay"
            )
        return self


@dataclass(frozen=True)
class Stage:
    """V_out = gain (V_in - zero_V), or for a divider V_out = zero_V + gain V_in.

    Attributes
    ----------
    parts : values of its resistors [ohm] by their names in the drawing.
    gain_off, zero_off_V : by how much both may differ at the worst corner of the resistors' tolerance; the gain's as
        a part of it.
    """

    gain: float
    zero_V: float
    parts: Mapping[str, float]
    gain_off: float
    zero_off_V: float


@dataclass(frozen=True)
class Scale:
    """value = (counts - zero_counts) * per_count; below `least` and above `most` counts there is no number."""

    per_count: float
    zero_counts: float
    least: int
    most: int


def of_series(value: float, series: tuple[float, ...] = E96) -> float:
    """The value of a series of the decades that is nearest, as a ratio."""
    decade = 10.0 ** math.floor(math.log10(value))
    found = min((decade * m for m in (*series, 10.0)), key=lambda one: abs(math.log(one / value)))
    return float(f"{found:.4g}")


def _stage(formula: Callable[..., tuple[float, float]], parts: Mapping[str, float], tolerance: float) -> Stage:
    """Gain and zero of the parts, and how far the corners of their tolerance lie off."""
    gain, zero_V = formula(*parts.values())
    corners = [
        formula(*(value * (1 + sign * tolerance) for value, sign in zip(parts.values(), signs, strict=True)))
        for signs in itertools.product((-1, 1), repeat=len(parts))
    ]
    gain_off = max(abs(one / gain - 1) for one, _ in corners)
    return Stage(gain, zero_V, parts, gain_off, max(abs(one - zero_V) for _, one in corners))


def shift(supply_V: float, out_V: float, tolerance: float) -> Stage:
    """An operational amplifier from 0..supply to -out..+out: feedback R1, R2 to the supply, R3 to ground.

    V_out = (1 + R1/R2 + R1/R3) V_in - R1/R2 supply; it is zero in the middle where R1/R2 = gain / 2. Of all R1 of a
    decade of E96 the one is taken that leaves the least error.

    Raises
    ------
    InputError : an output below the supply, for which this circuit has no resistors.
    """
    wanted = 2 * out_V / supply_V
    if wanted < 2.1:
        raise InputError(f"servo.input_V = {out_V:g} V: must be {1.05 * supply_V:.3g} V or more: set its input wider")

    def formula(R1: float, R2: float, R3: float) -> tuple[float, float]:
        gain = 1 + R1 / R2 + R1 / R3
        return gain, supply_V * R1 / R2 / gain

    def found(R1: float) -> Stage:
        ratio = wanted / 2
        return _stage(
            formula, {"R1": R1, "R2": of_series(R1 / ratio), "R3": of_series(R1 / (wanted - 1 - ratio))}, tolerance
        )

    tried = (found(BASE_OHM * mantissa) for mantissa in E96)
    return min(tried, key=lambda one: abs(one.gain / wanted - 1) + abs(2 * one.zero_V / supply_V - 1))


def divider(supply_V: float, in_V: float, tolerance: float) -> Stage:
    """Two or three resistors from -in..+in to 0..supply: R4 from the monitor, R5 to the supply, R6 to ground.

    Up to -supply..+supply two equal resistors do: then a wire that is off reads the rail, which is no number. Beyond
    it R6 makes the range wider, and a wire that is off reads a current.
    """
    gain = min(supply_V / 2 / in_V, 0.5)

    def formula(R4: float, R5: float, R6: float = math.inf) -> tuple[float, float]:
        total = 1 / R4 + 1 / R5 + 1 / R6
        return 1 / R4 / total, supply_V / R5 / total

    parts = {"R4": of_series(BASE_OHM / 2 / gain), "R5": BASE_OHM}
    if gain < 0.49:
        parts["R6"] = of_series(BASE_OHM / (1 - 2 * gain))
    return _stage(formula, parts, tolerance)


@dataclass(frozen=True)
class Loop:
    """PI stage of a plain bridge: R7 from the command, R8 from the shunt amplifier, R9 and C1 in the feedback.

    The loop is the motor's winding behind a gain: with R9 C1 = L / R its pole is at
    2 motor_V / triangle_V * R9 / R8 * shunt * sense_gain / L.
    """

    R7_ohm: float
    R8_ohm: float
    R9_ohm: float
    C1_F: float
    pole_Hz: float


def loop(bridge: Bridge, motor: Motor, pole_Hz: float) -> Loop:
    """Resistors and capacitor for a pole of the current loop."""
    sense_V_A = bridge.shunt_ohm * bridge.sense_gain
    through = 2 * bridge.motor_V / bridge.triangle_V * sense_V_A / motor.L_H / (2 * math.pi)
    R9 = of_series(BASE_OHM * pole_Hz / through)
    C1 = of_series(motor.L_H / motor.R_ohm / R9, E24)
    return Loop(BASE_OHM, BASE_OHM, R9, C1, through * R9 / BASE_OHM)


@dataclass(frozen=True)
class Scales:
    """Everything that follows from a circuit file.

    Attributes
    ----------
    output_zero, output_per_A : counts of no command, and per ampere.
    current, acceleration, grip : of the inputs [A], [m/s^2], [N]; `grip` None without a sensor.
    range_g : largest acceleration that sensor and converter read to either side, gravity included.
    count_m : path of the tip per count of the encoder.
    command, monitor : the stages; of a bridge None.
    loop : of a bridge.
    command_off, command_off_A : by how much the command's scale and zero may differ, by the resistors.
    monitor_off, monitor_off_A : likewise of the monitor.
    open_A : current that a monitor's wire that is off reads; None where that is no number, and a fault.
    """

    output_zero: float
    output_per_A: float
    current: Scale
    acceleration: Scale
    grip: Scale | None
    range_g: float
    count_m: float
    command: Stage | None
    monitor: Stage | None
    loop: Loop | None
    command_off: float
    command_off_A: float
    monitor_off: float
    monitor_off_A: float
    open_A: float | None


def scales(circuit: Circuit, motor: Motor, ratio_1_m: float) -> Scales:
    """Resistors and scales of a circuit.

    Raises
    ------
    InputError : a command or an over-current that does not fit the converter's range, an input that is too narrow.
    """
    converter, off = circuit.converter, circuit.resistors
    supply_V, counts = converter.supply_V, converter.counts
    V_per_count, over_A = supply_V / counts, OVER_CURRENT * circuit.power.current_A
    if circuit.servo is not None:
        servo = circuit.servo
        there, back = (
            shift(supply_V, servo.input_V, off),
            divider(supply_V, over_A * servo.monitor_V_A / HEADROOM, off),
        )
        A_per_V, V_per_A = there.gain / servo.input_V_A, back.gain * servo.monitor_V_A
        offs = (there.gain_off, there.zero_off_V * A_per_V, back.gain_off, back.zero_off_V / V_per_A)
        zero_V, monitor_zero_V, closed = there.zero_V, back.zero_V, None
    else:
        assert circuit.bridge is not None
        bridge, there, back = circuit.bridge, None, None
        V_per_A = bridge.shunt_ohm * bridge.sense_gain
        A_per_V, zero_V, monitor_zero_V = 1 / V_per_A, supply_V / 2, supply_V / 2
        V_per_A = (
            -V_per_A
        )  # the shunt amplifier is turned round: its output falls with the current, so that it adds up
        closed = loop(bridge, motor, circuit.power.pole_Hz)
        resistors = (1 + off) / (1 - off) - 1
        gain_off = (1 + resistors) / (1 - bridge.sense_tolerance) - 1
        # The middle comes from two resistors, and moves the zeros of command and monitor alike.
        middle_A = off * supply_V / 2 * A_per_V
        offs = (gain_off, middle_A, bridge.sense_tolerance, middle_A)
    _need_room(circuit, A_per_V, zero_V)
    current = Scale(V_per_count / V_per_A, monitor_zero_V / V_per_count, RAIL_COUNTS, counts - 1 - RAIL_COUNTS)
    reach_A = min(current.zero_counts - current.least, current.most - current.zero_counts) * abs(current.per_count)
    if reach_A < over_A:
        raise InputError(
            f"monitor: shows up to {reach_A:.3g} A, must show {over_A:.3g} A, {OVER_CURRENT:g} times "
            "power.current_A: set fewer volts per ampere"
        )
    open_A = None
    if back is not None and "R6" in back.parts:
        open_V = supply_V * back.parts["R6"] / (back.parts["R5"] + back.parts["R6"])
        open_A = (open_V / V_per_count - current.zero_counts) * current.per_count
    acceleration = _sensor("accelerometer", circuit.accelerometer, V_per_count, counts, STANDARD_GRAVITY_M_S2)
    return Scales(
        output_zero=zero_V / V_per_count,
        output_per_A=1 / (A_per_V * V_per_count),
        current=current,
        acceleration=acceleration,
        grip=None if circuit.grip is None else _sensor("grip", circuit.grip, V_per_count, counts, 1.0),
        range_g=_range_g(circuit.accelerometer, acceleration),
        count_m=2 * math.pi / (4 * circuit.encoder.lines * ratio_1_m),
        command=there,
        monitor=back,
        loop=closed,
        command_off=offs[0],
        command_off_A=offs[1],
        monitor_off=offs[2],
        monitor_off_A=offs[3],
        open_A=open_A,
    )


def _need_room(circuit: Circuit, A_per_V: float, zero_V: float) -> None:
    """
    Raises
    ------
    InputError : a command beyond what the converter puts out, or so small a part of it that counts are coarse.
    """
    supply_V, command_A = circuit.converter.supply_V, circuit.power.command_A
    reach_A = (min(zero_V, supply_V - zero_V) - OUTPUT_ROOM_V) * A_per_V
    if command_A > reach_A:
        raise InputError(
            f"power.command_A = {command_A:g} A: the circuit puts out up to {reach_A:.3g} A: set fewer volts per "
            "ampere in the amplifier, a smaller shunt, or less command"
        )


def _range_g(sensor: Accelerometer, scale: Scale) -> float:
    """The range that the sensor's own and the converter's leave.

    Raises
    ------
    InputError : the built-in taps go beyond it.
    """
    counts = min(scale.zero_counts - scale.least, scale.most - scale.zero_counts)
    read_g = counts * abs(scale.per_count) / STANDARD_GRAVITY_M_S2
    if min(sensor.range_g, read_g) < LEAST_RANGE_G:
        raise InputError(
            f"accelerometer.range_g = {sensor.range_g:g} g, of which the converter reads {read_g:.3g} g: must be "
            f"{LEAST_RANGE_G:g} g or more, which the built-in taps take: use a sensor of a wider range, or fewer "
            "volts per g"
        )
    return min(sensor.range_g, read_g)


def _sensor(table: str, sensor: Sensor, V_per_count: float, counts: int, unit: float) -> Scale:
    """A sensor whose zero is near an end reads to that end: an open grip sensor reads far below zero, a fault.

    Raises
    ------
    InputError : a reach that no such sensor has, as where millivolts were stated.
    """
    zero = sensor.zero_V / V_per_count
    least = 0 if zero < counts / 8 else RAIL_COUNTS
    reach = max(zero - least, counts - 1 - RAIL_COUNTS - zero) * V_per_count / abs(sensor.V_per_unit)
    of, least_reach, most_reach = REACHES[table]
    if not least_reach <= reach <= most_reach:
        instead = sensor.V_per_unit * (1e-3 if reach < least_reach else 1e3)
        raise InputError(
            f"{table}.V_per_unit = {sensor.V_per_unit:g} V per {of}: the converter reads up to {reach:.3g} {of}, "
            f"such sensors {least_reach:g} to {most_reach:g} {of}: is it {instead:.3g} V per {of}?"
        )
    return Scale(unit * V_per_count / sensor.V_per_unit, zero, least, counts - 1 - RAIL_COUNTS)
