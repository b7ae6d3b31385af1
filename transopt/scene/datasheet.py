"""Writes the text of a scene from the values of a datasheet, for `transopt plant new`.

The scene is meant to be read and changed: it contains every number of the datasheet with a comment that explains it,
and every derived number with its formula. It can be solved without changes: its target is a burst within the
actuator's reach.
"""

import math
import tomllib
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from transopt.base.section import NonNegative, Positive, Section
from transopt.base.sizes import MOST_STAGES
from transopt.base.writing import rounded_down
from transopt.plant.state_space import POSITION, StateSpace
from transopt.scene.file import validated
from transopt.scene.scene import Scene

KINDS = ("inertial", "voice_coil", "shaker")
RATES_HZ = {"inertial": 48e3, "voice_coil": 10e3, "shaker": 10e3}  # rates of audio drivers and servo amplifiers
FREQUENCY_HZ = 100.0  # frequency of the target where no sharp resonance suggests one
# The target is a burst of CYCLES periods; the waveform, which also brakes it, lasts WINDOW_CYCLES of them. CYCLES is
# a whole number, since the mean of a burst of 1.5 cycles is not zero, and a mass on a spring cannot make a mean
# acceleration: the least error of an LRA was 17 % with 1.5 cycles and 3 % with 2.
CYCLES, WINDOW_CYCLES = 2.0, 5.0
PEAK_SHARE = 0.25  # target's peak over the steady amplitude at peak input; a burst ends before resonance builds up
LONGEST_STROKE_M = 0.1  # twice that of the longest shakers, 50 mm from rest to the stop
LEAST_RATE = 20  # least number of samples per period of the target and of the resonance


class Datasheet(Section):
    """The values that a datasheet states of a moving-coil actuator; each key has a description.

    A shaker is a voice coil whose table carries a payload; its resonance is that of the bare table.
    """

    kind: Literal["inertial", "voice_coil", "shaker"] = "inertial"
    input: Literal["voltage", "current"] = Field("voltage", description="quantity that the driver sets")
    resonance_Hz: Positive | None = Field(None, description="resonance f0, terminals open")
    quality: Positive | None = Field(None, description="quality Q of that resonance, terminals open")
    damping_N_s_m: NonNegative | None = Field(None, description="damper of a moving part without a spring")
    moving_mass_kg: Positive = Field(description="moving mass; for a shaker the bare table with its coil")
    payload_kg: NonNegative = Field(0.0, description="mass on a shaker's table")
    case_mass_kg: Positive | None = Field(None, description="case with all that shakes with it, such as a phone")
    force_factor_N_A: Positive = Field(
        description="force factor BL: newton per ampere, tesla metre, volt second per m"
    )
    R_ohm: Positive | None = Field(None, description="resistance of the coil")
    L_H: NonNegative = Field(0.0, description="inductance of the coil; 0 leaves it out")
    rated: Positive | None = Field(None, description="largest continuous input, as the peak of a sine [V or A]")
    peak: Positive = Field(description="largest input at any instant [V or A]")
    stroke_m: Positive | None = Field(None, description="displacement from rest to the stop, in either direction")
    frequency_Hz: Positive | None = Field(None, description="frequency of the target; for an LRA its resonance")
    rate_Hz: Annotated[float, Field(ge=100, le=1e5)] | None = Field(None, description="sample rate of the driver")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.kind == "inertial" and self.case_mass_kg is None:
            raise ValueError("case_mass_kg: missing; an inertial actuator shakes its case")
        if self.kind == "inertial" and self.resonance_Hz is None:
            raise ValueError("resonance_Hz: missing; an inertial actuator is stated by resonance and quality")
        if (self.resonance_Hz is None) != (self.quality is None):
            raise ValueError("resonance_Hz and quality belong together: state both, or neither and damping_N_s_m")
        if self.resonance_Hz is not None and self.damping_N_s_m is not None:
            raise ValueError("damping_N_s_m: follows from resonance_Hz and quality: leave one or the other out")
        if self.resonance_Hz is None and self.damping_N_s_m is None:
            raise ValueError(
                "resonance_Hz and quality are missing; a part without a spring states damping_N_s_m: "
                "0 is taken where no sheet has it, and leaves the friction of its guide out"
            )
        if self.kind == "shaker" and self.case_mass_kg is not None:
            raise ValueError("case_mass_kg: a shaker's body is held; take kind = voice_coil for one that floats")
        if self.kind != "shaker" and self.payload_kg > 0:
            raise ValueError(f"payload_kg: belongs to a shaker; of kind = {self.kind} it is part of the masses")
        if self.input == "voltage" and self.R_ohm is None:
            raise ValueError("R_ohm: missing; a voltage drives the coil")
        if self.rated is not None and self.rated > self.peak:
            raise ValueError(
                f"rated = {self.rated:g} {self.unit}: above peak = {self.peak:g} {self.unit}; the continuous input "
                "is at most the largest one: exchange or correct them"
            )
        if self.kind == "inertial" and self.case_mass_kg is not None and self.moving_mass_kg >= self.case_mass_kg:
            raise ValueError(
                f"moving_mass_kg = {self.moving_mass_kg:g}: not below case_mass_kg = {self.case_mass_kg:g}, which it "
                "shakes; both are in kilograms: correct or exchange them"
            )
        if self.stroke_m is not None and self.stroke_m > LONGEST_STROKE_M:
            raise ValueError(
                f"stroke_m = {self.stroke_m:g}: above {LONGEST_STROKE_M:g} m, longer than any such actuator's; it is "
                "in metres: correct it"
            )
        for name, value in (("resonance_Hz", self.resonance_Hz or 0.0), ("frequency_Hz", self.target_Hz)):
            if self.samples_Hz < LEAST_RATE * value:
                raise ValueError(
                    f"rate_Hz = {self.samples_Hz:g}: must be at least {LEAST_RATE} times {name} = {value:g} Hz, "
                    f"{LEAST_RATE * value:g} Hz"
                )
        if self.stages > MOST_STAGES:
            raise ValueError(
                f"rate_Hz = {self.samples_Hz:g}: {self.stages} samples in {WINDOW_CYCLES:g} periods of "
                f"{self.target_Hz:g} Hz, at most {MOST_STAGES}: lower rate_Hz or raise frequency_Hz"
            )
        return self

    @property
    def unit(self) -> str:
        """Unit of the input."""
        return "V" if self.input == "voltage" else "A"

    @property
    def samples_Hz(self) -> float:
        """Sample rate of the driver."""
        return RATES_HZ[self.kind] if self.rate_Hz is None else self.rate_Hz

    @property
    def target_Hz(self) -> float:
        """Frequency of the target."""
        if self.frequency_Hz is not None:
            return self.frequency_Hz
        return self.resonance_Hz if self.kind == "inertial" and self.resonance_Hz else FREQUENCY_HZ

    @property
    def stages(self) -> int:
        """Stages of the waveform."""
        return math.ceil(WINDOW_CYCLES / self.target_Hz * self.samples_Hz)


def needed(kind: str, driven_by: str) -> tuple[str, ...]:
    """Keys that a scene of this kind and input requires."""
    own = ("resonance_Hz", "quality", "case_mass_kg") if kind == "inertial" else ()
    coil = ("R_ohm",) if driven_by == "voltage" else ()
    return (*own, "moving_mass_kg", "force_factor_N_A", *coil, "peak")


def scene_text(sheet: Datasheet, name: str) -> str:
    """The text of a datasheet's scene file, checked.

    Raises
    ------
    InputError : values that no scene can have.
    """
    plant = _scene(name, _text(sheet, 1.0)).plant(0.0)
    text = _text(sheet, _peak_m_s2(sheet, plant))
    _scene(name, text)
    return text


def _scene(name: str, text: str) -> Scene:
    return validated(f"the datasheet of {name}", {**tomllib.loads(text), "name": name})


def _peak_m_s2(sheet: Datasheet, plant: StateSpace) -> float:
    """Peak of a burst well within the actuator's input and stroke."""
    f = np.array([sheet.target_Hz])
    per_input = float(abs(plant.response(f)[0]))
    reach = per_input * sheet.peak
    if sheet.stroke_m is not None:
        moved = StateSpace(plant.A, plant.B, plant.outputs[POSITION].row, np.zeros((1, 1)))
        reach = min(reach, per_input / float(abs(moved.response(f)[0])) * sheet.stroke_m)
    return rounded_down(PEAK_SHARE * reach, 2)


def _n(value: float | None) -> str:
    """A number as a scene states it, with all its digits; earlier checks ensure that it is stated."""
    assert value is not None
    return f"{value:.12g}"


def _text(sheet: Datasheet, peak_m_s2: float) -> str:
    made = {"inertial": "mass in a case", "voice_coil": "voice coil", "shaker": "shaker with its payload"}[sheet.kind]
    head = [
        f'description = "a {made}, by its datasheet"',
        'amplifier = "ideal"  # or a table [amplifier] with pole_Hz and delay_s of the driver',
        "hand_over_samples = 1  # the waveform ends in a sample of zero",
        "",
        "[time]",
        f"dt_s = {1 / sheet.samples_Hz:.17g}  # the driver plays {_n(sheet.samples_Hz)} samples per second",
        f"stages = {sheet.stages}  # samples, {_n(WINDOW_CYCLES)} periods of the target: it also brakes",
        "lead_s = 0.0  # the waveform begins at t = 0",
        "",
        "# Wanted accelerations, one table [[targets]] each: a burst, a decay, a half sine, or file = a recording.",
        "[[targets]]",
        f'name = "click {_n(sheet.target_Hz)} Hz"',
        'shape = "burst"',
        f"frequency_Hz = {_n(sheet.target_Hz)}",
        f"cycles = {_n(CYCLES)}",
        f"peak_m_s2 = {_n(peak_m_s2)}  # a quarter of a long sine's at the limits",
        "",
    ]
    weights = [
        "# [weights]",
        "# calm = 30.0  # weight of the error after the end of a target, relative to that within it",
    ]
    return "\n".join([*head, *_model(sheet), "", *_limits(sheet), "", *weights, ""])


def _model(sheet: Datasheet) -> list[str]:
    coil = [
        f'input = "{sheet.input}"  # quantity that the driver sets',
        f"force_factor_N_A = {_n(sheet.force_factor_N_A)}  # BL: force per ampere, and back-EMF per m/s",
        *([f"R_ohm = {_n(sheet.R_ohm)}"] if sheet.R_ohm is not None else []),
        f"L_H = {_n(sheet.L_H)}",
    ]
    if sheet.kind == "inertial":
        return [
            "[model]",
            'kind = "inertial"  # the acceleration is that of the case',
            f"resonance_Hz = {_n(sheet.resonance_Hz)}  # f0 in its case, terminals open",
            f"quality = {_n(sheet.quality)}",
            f"moving_mass_kg = {_n(sheet.moving_mass_kg)}",
            f"case_mass_kg = {_n(sheet.case_mass_kg)}  # with all that shakes with it",
            *coil,
        ]
    m = sheet.moving_mass_kg
    carried = f"  # {_n(m)} of the table and {_n(sheet.payload_kg)} of the payload" if sheet.kind == "shaker" else ""
    if sheet.resonance_Hz is None:
        spring = ["stiffness_N_m = 0  # no spring holds it", f"damping_N_s_m = {_n(sheet.damping_N_s_m)}"]
    else:
        assert sheet.quality is not None
        # In a case both masses vibrate against each other at the datasheet's resonance.
        M = sheet.case_mass_kg
        mass, symbol = (m, "m") if M is None else (m * M / (m + M), "mu")
        masses = ", mu = m M / (m + M)" if M is not None else ", m the bare table's" if sheet.kind == "shaker" else ""
        w = 2 * math.pi * sheet.resonance_Hz
        spring = [
            f"# f0 = {_n(sheet.resonance_Hz)} Hz and Q = {_n(sheet.quality)}: k = {symbol} (2 pi f0)^2, c = {symbol} "
            f"2 pi f0 / Q{masses}",
            f"stiffness_N_m = {_n(mass * w**2)}",
            f"damping_N_s_m = {_n(mass * w / sheet.quality)}",
        ]
    return [
        "[model]",
        'kind = "voice_coil"  # the acceleration is that of '
        + ("the moving part" if sheet.case_mass_kg is None else "the case"),
        f"moving_mass_kg = {_n(m + sheet.payload_kg)}{carried}",
        *([f"case_mass_kg = {_n(sheet.case_mass_kg)}"] if sheet.case_mass_kg is not None else []),
        *spring,
        *coil,
    ]


def _limits(sheet: Datasheet) -> list[str]:
    steady = sheet.peak if sheet.rated is None else sheet.rated
    key = f"{sheet.input}_{sheet.unit}"
    return [
        "[limits]",
        f"{key} = {_n(sheet.peak)}  # at every instant",
        f"steady_{key} = {_n(steady)}  # continuous, the peak of a sine; for a baseline of the report, no limit",
        "# stroke_m = 0.0005  # from rest to the stop, in either direction"
        if sheet.stroke_m is None
        else f"stroke_m = {_n(sheet.stroke_m)}  # from rest to the stop, in either direction",
    ]
