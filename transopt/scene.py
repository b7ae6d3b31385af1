"""What a scene holds: everything that defines one library (DESIGN 3, 5, 8)."""

import itertools
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from transopt import models
from transopt.amplifier import Amplifier
from transopt.discretise import TimeGrid
from transopt.errors import InputError
from transopt.problem import Limits
from transopt.thermal import CoilModel

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Speed = Annotated[float, Field(ge=1e-4, le=100)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Section(BaseModel):
    """A table of a scene file: unknown keys are refused, values never change after loading."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _increasing(values: list[float]) -> list[float]:
    if any(b <= a for a, b in itertools.pairwise(values)):
        raise ValueError("must be strictly increasing, without duplicates")
    return values


class Grid(Section):
    """Nodes of the library."""

    speeds_m_s: Annotated[list[Speed], Field(min_length=1)]
    grips_N: Annotated[list[NonNegative], Field(min_length=1)]
    grip_min_N: Positive = 0.5

    _speeds_ordered = field_validator("speeds_m_s")(_increasing)
    _grips_ordered = field_validator("grips_N")(_increasing)

    @model_validator(mode="after")
    def _held_or_free(self) -> Self:
        if self.grips_N[0] == 0 and len(self.grips_N) > 1:
            raise ValueError("grips_N: the free device (grip 0) is its own scene, never blended with held ones")
        if 0 < self.grips_N[0] < self.grip_min_N:
            raise ValueError(
                f"grips_N: {self.grips_N[0]:g} N is below grip_min_N = {self.grip_min_N:g} N, "
                "where no transient is played"
            )
        return self


class Time(Section):
    """Servo period, horizon, and how long before contact the waveform starts."""

    dt_s: Positive = 1e-4
    stages: Annotated[int, Field(ge=2)] = 600
    lead_s: Annotated[float, Field(ge=0, le=0.02)] = 3e-4


class SimulatedTaps(Section):
    """A real object that the undriven device strikes (DESIGN 5): the built-in recordings.

    Contact force on the stylus: k delta^n (1 + c d delta/dt) >= 0, delta the indentation.
    """

    grip_N: Positive
    object_mass_kg: Positive
    object_stiffness_N_m: NonNegative
    object_damping_N_s_m: NonNegative
    contact_stiffness_N_m: Positive
    contact_exponent: Positive
    contact_damping_s_m: NonNegative
    repeats: Annotated[int, Field(ge=1)] = 3
    speed_spread: Annotated[float, Field(ge=0, lt=0.15)] = 0.05
    noise_g_rtHz: NonNegative = 320e-6
    range_g: Positive = 18.0
    rate_Hz: Annotated[float, Field(ge=1e3, le=1e6)] = 10e3
    seed: Annotated[int, Field(ge=0)] = 1


class Recordings(Section):
    """Where the taps come from and how they become references."""

    files: list[str] = []
    folder: str = "."
    columns: list[str] = []
    full_scale_m_s2: Positive | None = None
    speed_m_s: Speed | None = None
    speed_by_file_m_s: dict[str, Speed] = {}
    grip_N: NonNegative | None = None
    source: str = ""
    polarity: Literal["auto", "positive", "negative"] = "auto"
    offset_m_s2: Finite | Literal["baseline"] = "baseline"
    onset_s: Finite | Literal["auto"] = "auto"
    lowpass_Hz: Annotated[float, Field(ge=50, le=1e6)] = 1000.0
    highpass_Hz: Annotated[float, Field(ge=0.1, le=1e5)] = 8.0
    speed_tolerance: Annotated[float, Field(ge=0, lt=1)] = 0.15
    time_scale: Annotated[float, Field(ge=1e-3, le=1e3)] = 1.0
    amplitude_scale: Annotated[float, Field(ge=1e-6, le=1e6)] | Literal["to_grid_speed"] = 1.0
    simulated: SimulatedTaps | None = None

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if bool(self.files) == (self.simulated is not None):
            raise ValueError("give either files or a simulated table, not both and not neither")
        if self.highpass_Hz >= self.lowpass_Hz:
            raise ValueError(f"highpass_Hz = {self.highpass_Hz:g}: must be below lowpass_Hz = {self.lowpass_Hz:g}")
        return self


class LinearParameter(Section):
    constant: Finite
    per_newton: Finite = 0.0


Parameter = LinearParameter | Finite


def _linear(value: LinearParameter | float) -> models.LinearInGrip:
    if isinstance(value, LinearParameter):
        return models.LinearInGrip(value.constant, value.per_newton)
    return models.LinearInGrip(value, 0.0)


class HandSection(Section):
    """Skin and arm as functions of grip: a number, or {constant, per_newton}."""

    mass_kg: Parameter
    skin_stiffness_N_m: Parameter
    skin_damping_N_s_m: Parameter
    arm_stiffness_N_m: Parameter
    arm_damping_N_s_m: Parameter

    def hand(self) -> models.Hand:
        return models.Hand(**{name: _linear(getattr(self, name)) for name in type(self).model_fields})


class SecondOrder(Section):
    kind: Literal["second_order"]


class FourthOrder(Section):
    kind: Literal["fourth_order"]
    stylus_mass_kg: Positive
    hand: HandSection


class Drive(Section):
    kind: Literal["drive"]
    stylus_mass_kg: Positive
    hand: HandSection


class Motor(Section):
    """One row of a datasheet; its values belong together."""

    name: str
    datasheet: str
    R_ohm: Positive
    L_H: NonNegative
    kt_Nm_A: Positive
    rotor_kg_m2: NonNegative
    i_continuous_A: Positive
    i_peak_A: Positive
    R_wh_K_W: Positive
    R_ha_K_W: Positive
    tau_w_s: Positive
    tau_h_s: Positive
    winding_max_C: Finite


class Transmission(Section):
    """From motor shaft to stylus tip: `ratio_1_m` is shaft radian per metre of tip travel."""

    ratio_1_m: Positive
    link_mass_kg: NonNegative
    stiffness_N_m: Positive
    damping_N_s_m: NonNegative


class Tip(Section):
    """The drive stated at the tip, for voice coils: no motor data, so no coil temperature."""

    force_per_current_N_A: Positive
    moving_mass_kg: Positive
    stiffness_N_m: Positive | None = None
    damping_N_s_m: NonNegative | None = None


class AmplifierSection(Section):
    pole_Hz: Positive
    delay_s: NonNegative
    command_limit_A: Positive = 6.0


class LimitsSection(Section):
    """The transient limit is beta * steady_current_A (seed Eq. 8), or `current_A` in its place."""

    steady_current_A: Positive
    beta: Annotated[float, Field(ge=1, allow_inf_nan=False)] | None = None
    current_A: Positive | None = None
    slew_A_per_s: Positive | None = None

    @model_validator(mode="after")
    def _one_statement(self) -> Self:
        if self.beta is not None and self.current_A is not None:
            raise ValueError("give beta or current_A, not both")
        return self

    @property
    def transient_current_A(self) -> float:
        if self.current_A is not None:
            return self.current_A
        return (3.2 if self.beta is None else self.beta) * self.steady_current_A


class Thermal(Section):
    ambient_C: Finite = 25.0
    start_winding_C: Finite = 25.0
    start_housing_C: Finite = 25.0


class Weights(Section):
    rho: NonNegative = 1e-3


class Scene(Section):
    """One scene file; `name` defaults to the file's stem."""

    name: str
    description: str
    grid: Grid
    time: Time = Time()
    recordings: Recordings
    model: Annotated[SecondOrder | FourthOrder | Drive, Field(discriminator="kind")]
    motor: Motor | None = None
    transmission: Transmission | None = None
    tip: Tip | None = None
    amplifier: AmplifierSection | Literal["ideal"]
    limits: LimitsSection
    thermal: Thermal = Thermal()
    weights: Weights = Weights()
    hand_over_samples: Annotated[int, Field(ge=1)] = 10

    @model_validator(mode="after")
    def _one_drive(self) -> Self:
        if (self.motor is None) != (self.transmission is None):
            raise ValueError("motor and transmission belong together: give both, or a tip table in their place")
        if (self.motor is None) == (self.tip is None):
            raise ValueError("the drive is stated either by motor and transmission or by tip: give exactly one")
        if (
            isinstance(self.model, Drive)
            and self.tip is not None
            and None
            in (
                self.tip.stiffness_N_m,
                self.tip.damping_N_s_m,
            )
        ):
            raise ValueError("model.kind = drive needs tip.stiffness_N_m and tip.damping_N_s_m")
        if self.motor is not None and self.limits.transient_current_A > self.motor.i_peak_A:
            raise ValueError(
                f"limits: transient limit {self.limits.transient_current_A:g} A is above the motor's i_peak_A = "
                f"{self.motor.i_peak_A:g} A: lower beta or current_A"
            )
        if self.recordings.highpass_Hz > 0.1 / self.time.dt_s:
            raise ValueError(
                f"recordings.highpass_Hz = {self.recordings.highpass_Hz:g}: must not exceed a tenth of the servo "
                f"rate, {0.1 / self.time.dt_s:g} Hz"
            )
        if self.hand_over_samples > self.time.stages:
            raise ValueError(
                f"hand_over_samples = {self.hand_over_samples}: must not exceed time.stages = {self.time.stages}"
            )
        return self

    def drive_at_tip(self) -> Tip:
        """What the stylus feels of the drive: force per ampere, rotor and link as one mass, transmission.

        k_f = k_t ratio, m = J ratio^2 + m_link, with the ratio in shaft radian per metre of tip travel.
        """
        if self.motor is None or self.transmission is None:
            assert self.tip is not None
            return self.tip
        ratio = self.transmission.ratio_1_m
        return Tip(
            force_per_current_N_A=self.motor.kt_Nm_A * ratio,
            moving_mass_kg=self.motor.rotor_kg_m2 * ratio**2 + self.transmission.link_mass_kg,
            stiffness_N_m=self.transmission.stiffness_N_m,
            damping_N_s_m=self.transmission.damping_N_s_m,
        )

    def plant(self, grip_N: float, *, struck: bool = False) -> models.StateSpace:
        """Model from motor current to stylus acceleration at one grip.

        With `struck` the input is a force on the stylus [N] instead: the same device tapping a real object.

        Raises
        ------
        InputError : parameters that are not passive at this grip.
        """
        try:
            return self._chain(grip_N, struck)
        except InputError as error:
            raise InputError(f"{self.name}, grip {grip_N:g} N: {error}") from None

    def _chain(self, grip_N: float, struck: bool) -> models.StateSpace:
        tip = self.drive_at_tip()
        gain = 1.0 if struck else tip.force_per_current_N_A
        match self.model:
            case SecondOrder():
                return models.second_order(grip_N, force_per_current_N_A=gain)
            case FourthOrder(stylus_mass_kg=stylus, hand=hand):
                return models.fourth_order(
                    grip_N,
                    hand=hand.hand(),
                    stylus_mass_kg=stylus,
                    moving_mass_kg=tip.moving_mass_kg,
                    force_per_current_N_A=gain,
                )
            case Drive(stylus_mass_kg=stylus, hand=hand):
                assert tip.stiffness_N_m is not None
                assert tip.damping_N_s_m is not None
                return models.drive(
                    grip_N,
                    hand=hand.hand(),
                    stylus_mass_kg=stylus,
                    moving_mass_kg=tip.moving_mass_kg,
                    transmission=models.Link(tip.stiffness_N_m, tip.damping_N_s_m),
                    force_per_current_N_A=gain,
                    driven=1 if struck else 0,
                )

    def amplifier_model(self) -> Amplifier | None:
        """None for an ideal amplifier."""
        if self.amplifier == "ideal":
            return None
        assert isinstance(self.amplifier, AmplifierSection)
        return Amplifier(**self.amplifier.model_dump())

    def time_grid(self) -> TimeGrid:
        amplifier = self.amplifier_model()
        delay = 0.0 if amplifier is None else amplifier.delay_s
        return TimeGrid(self.time.dt_s, self.time.stages, self.time.lead_s, delay)

    def current_limits(self) -> Limits:
        amplifier = self.amplifier_model()
        return Limits(
            current_A=self.limits.transient_current_A,
            command_A=None if amplifier is None else amplifier.command_limit_A,
            slew_A_per_s=self.limits.slew_A_per_s,
        )

    def coil(self) -> CoilModel | None:
        """None where the drive is stated at the tip: no motor, no temperature."""
        if self.motor is None:
            return None
        motor = self.motor
        return CoilModel(
            R_ohm=motor.R_ohm,
            R_wh_K_W=motor.R_wh_K_W,
            R_ha_K_W=motor.R_ha_K_W,
            tau_w_s=motor.tau_w_s,
            tau_h_s=motor.tau_h_s,
            limit_C=motor.winding_max_C,
            **self.thermal.model_dump(),
        )
