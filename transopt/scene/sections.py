"""Tables of a scene file: keys, types, bounds.

The first paragraph of a table's docstring is shown to users beside its keys.
"""

import itertools
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from transopt.base.section import Finite, NonNegative, Positive, Section, Speed, Temperature, Words
from transopt.base.sizes import (
    LONGEST_AFTER_S,
    LONGEST_DELAY_S,
    LONGEST_DT_S,
    LONGEST_HORIZON_S,
    LONGEST_LEAD_S,
    MOST_NODES,
    MOST_STAGES,
    SHORTEST_DT_S,
)
from transopt.plant.bridge import FASTEST_SWITCHING_HZ, SLOWEST_SWITCHING_HZ
from transopt.plant.discretise import WHOLE
from transopt.plant.intention import INTENTION_S, Intention, Yielding
from transopt.plant.kinds import Model
from transopt.plant.motor import Tip
from transopt.scene.population import Population


def _increasing(values: list[float]) -> list[float]:
    if any(b <= a for a, b in itertools.pairwise(values)):
        raise ValueError("must be strictly increasing, without duplicates")
    return values


COVERED_S = 0.2e-3  # by the lead beyond the delay: without it no current acts while the pulse rises


def covering_lead_s(dt_s: float, delay_s: float) -> float:
    """The least whole number of servo periods that is at least the amplifier's delay and 0.2 ms."""
    periods = int(np.ceil((delay_s + COVERED_S) / dt_s - WHOLE))
    return float(f"{periods * dt_s:.12g}")  # 3e-4 and not 0.00030000000000000003, as a scene would state it


def _nobody() -> list[float]:
    """Grips of a device that nobody holds."""
    return [0.0]


class Grid(Section):
    """Nodes of the library: no speeds where there are named targets, grip 0 alone where nobody holds the device.

    With `cool_share` each node has a cool command, the best that makes no more than this share of the first one's
    heat. A device whose coil is warm blends towards it in place of playing a weaker first one.

    Attributes
    ----------
    speeds_m_s : incoming speeds of the taps, increasing.
    grips_N : grip forces, increasing; 0 alone is a device that nobody holds.
    grip_min_N : below this grip no transient is played.
    cool_share : share of the heat that a cool command for a warm coil may make.
    """

    speeds_m_s: Annotated[list[Speed], Field(max_length=MOST_NODES)] = Field(default_factory=list)
    grips_N: Annotated[list[NonNegative], Field(min_length=1, max_length=MOST_NODES)] = Field(default_factory=_nobody)
    grip_min_N: Positive = 0.5
    cool_share: Annotated[float, Field(gt=0, lt=1)] | None = None

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


WINDOW_S = 80e-3  # within which the hand is held up and let go again, unless taps come sooner


class Time(Section):
    """Servo period, horizon, and how long before contact the waveform starts.

    Without `stages` the window is 80 ms, or what `thermal.tap_rate_Hz` leaves of it where taps come sooner. A lead of
    none is the least whole number of servo periods that covers the amplifier's delay and 0.2 ms.

    Attributes
    ----------
    dt_s : servo period: a command is held for so long.
    stages : commands of a waveform; without it the window is 80 ms, or what `thermal.tap_rate_Hz` leaves of it.
    lead_s : how long before contact the waveform starts; without it the delay and 0.2 ms are covered.
    """

    dt_s: Annotated[float, Field(ge=SHORTEST_DT_S, le=LONGEST_DT_S)] = 1e-4
    stages: Annotated[int, Field(ge=2, le=MOST_STAGES)] | None = None
    lead_s: Annotated[float, Field(ge=0, le=LONGEST_LEAD_S)] | None = None

    @model_validator(mode="after")
    def _short(self) -> Self:
        horizon_s = (self.stages or 0) * self.dt_s
        if horizon_s > LONGEST_HORIZON_S:
            raise ValueError(
                f"{self.stages} stages of {self.dt_s:g} s are {horizon_s:g} s: must be at most "
                f"{LONGEST_HORIZON_S:g} s; a tap is over in a tenth of one"
            )
        return self


class AmplifierSection(Section):
    """Amplifier: pole, delay beyond the hold, range of the command.

    Pole and delay stand here unless the scene's model file has them. With `switching_Hz`, the PWM frequency of an
    H-bridge on the rail `limits.supply_V`, a pole that is not stated follows from the motor, the delay with it, and
    so does the ripple's heat. `gain_V_A` is the proportional gain of its PI current loop, by default that of a
    crossover at a tenth of `switching_Hz`. A voltage amplifier's range is `command_limit_V`, a class-D stage's rail,
    by default `limits.voltage_V`.

    Attributes
    ----------
    pole_Hz : frequency at which the current has lost 3 dB against the command.
    delay_s : time from a command to the first current, beyond the hold.
    command_limit_A : range of the command, either sign.
    command_limit_V : range of the command of a voltage amplifier; by default `limits.voltage_V`.
    switching_Hz : PWM frequency of an H-bridge, from which pole, delay and ripple follow.
    gain_V_A : proportional gain of the current loop; by default its crossover is a tenth of `switching_Hz`.
    """

    pole_Hz: Positive | None = None
    delay_s: Annotated[float, Field(ge=0, le=LONGEST_DELAY_S)] | None = None
    command_limit_A: Positive = 6.0
    command_limit_V: Positive | None = None
    switching_Hz: Annotated[float, Field(ge=SLOWEST_SWITCHING_HZ, le=FASTEST_SWITCHING_HZ)] | None = None
    gain_V_A: Positive | None = None


class Striker(Section):
    """The device that strikes the object of simulated recordings, where the design is for that of a model file.

    It is what the scene states beside its model file, so that the taps to be reproduced stay when the model changes.
    """

    model: Annotated[Model, Field(discriminator="kind")]
    tip: Tip | None = None
    amplifier: AmplifierSection | Literal["ideal"]


class OwnLimitTable(Section):
    """A limit of a user's own, as its file was read (`limits.own` names files, which are read with the scene)."""

    name: Words
    unit: Words
    outputs: list[Words]
    lower: Finite | None
    upper: Finite | None
    coefficients: list[Finite] | None
    offsets: list[Finite] | None
    function: str | None
    convex: list[bool]


Instant = Annotated[list[Finite], Field(min_length=2, max_length=2)]  # a time [s] and a value there
OF_A_VOLTAGE = ("steady_voltage_V", "slew_V_per_s", "sag")  # limits beside `voltage_V`
OF_A_CURRENT = ("steady_current_A", "slew_A_per_s", "supply_V")  # limits where a current is the input


class LimitsSection(Section):
    """The transient limit is beta * steady_current_A (seed Eq. 8), or `current_A` in its place.

    Where a voltage is the input it is `voltage_V`, of which `sag` states the share that the supply has along the
    waveform, and `current_A` bounds the coil's current.

    Attributes
    ----------
    steady_current_A : current that the motor stands for ever.
    beta : the transient limit as a multiple of the steady current.
    current_A : current at all times, in the place of `beta`; the current of a coil that a voltage drives.
    slew_A_per_s : change of the command over time.
    supply_V : rail: the voltage that resistance, inductance and back-EMF together may take.
    voltage_V : voltage at all times, where a voltage drives the plant.
    steady_voltage_V : rated voltage, by which the baselines are made.
    slew_V_per_s : change of a voltage command over time.
    sag : share of `voltage_V` that the supply has along the waveform: pairs of time and share.
    stroke_m : way of the motor mass, or of a moving coil, from the surface or from rest.
    velocity_m_s : velocity of that mass, the motion of the hand included.
    own : files of Python with limits of your own.
    """

    steady_current_A: Positive | None = None
    beta: Annotated[float, Field(ge=1, le=1e4, allow_inf_nan=False)] | None = None
    current_A: Positive | None = None
    slew_A_per_s: Positive | None = None
    supply_V: Positive | None = None
    voltage_V: Positive | None = None
    steady_voltage_V: Positive | None = None
    slew_V_per_s: Positive | None = None
    sag: Annotated[list[Instant], Field(max_length=MOST_NODES)] | None = None
    stroke_m: Positive | None = None
    velocity_m_s: Positive | None = None
    own: list[OwnLimitTable] = Field(default_factory=list)

    @model_validator(mode="after")
    def _one_statement(self) -> Self:
        if self.beta is not None and self.current_A is not None:
            raise ValueError("give beta or current_A, not both")
        if self.voltage_V is None:
            for key in OF_A_VOLTAGE:
                if getattr(self, key) is not None:
                    raise ValueError(f"{key}: belongs to voltage_V, which is not stated")
        elif self.steady_voltage_V is not None and self.steady_voltage_V > self.voltage_V:
            raise ValueError(
                f"steady_voltage_V = {self.steady_voltage_V:g} V: above voltage_V = {self.voltage_V:g} V"
            )
        return self

    def asked(self) -> dict[str, Any]:
        """Key -> number of every limit, the input's as the number that it comes to; `own` where there are any."""
        exclude = {"beta"} if self.own else {"beta", "own"}
        if self.voltage_V is not None:
            stated = self.model_dump(exclude={*exclude, *OF_A_CURRENT})
            return {**stated, "steady_voltage_V": self.steady_input}
        return {**self.model_dump(exclude={*exclude, "voltage_V", *OF_A_VOLTAGE}), "current_A": self.transient_input}

    @property
    def transient_input(self) -> float:
        """The limit on the input over a transient: as stated, or beta (3.2 by default) times the steady current."""
        if self.voltage_V is not None:
            return self.voltage_V
        if self.current_A is not None:
            return self.current_A
        return (3.2 if self.beta is None else self.beta) * self.steady_input

    @property
    def steady_input(self) -> float:
        """What the actuator stands for ever: the steady current or voltage, by default of a voltage the limit."""
        steady = self.steady_current_A if self.voltage_V is None else self.steady_voltage_V or self.voltage_V
        assert steady is not None
        return steady


class Thermal(Section):
    """Temperatures at the start, and what the winding may do: keep its limit, a headroom per tap, taps for ever.

    Attributes
    ----------
    ambient_C : temperature of the air.
    start_winding_C : temperature of the winding when a tap begins.
    start_housing_C : temperature of the housing when a tap begins.
    nodes : 2: winding and housing warm; 1: the housing stays as it is.
    headroom_K : how far one tap may warm the winding.
    tap_rate_Hz : taps a second, for ever: their steady state keeps the limit.
    idle_A : current in the pauses between such taps; by default what a wall asks for.
    """

    ambient_C: Temperature = 25.0
    start_winding_C: Temperature = 25.0
    start_housing_C: Temperature = 25.0
    nodes: Literal[1, 2] = 2
    headroom_K: Positive | None = None
    tap_rate_Hz: Positive | None = None
    idle_A: NonNegative | None = None

    @model_validator(mode="after")
    def _one_budget(self) -> Self:
        if self.tap_rate_Hz is not None and (self.headroom_K is not None or self.nodes == 1):
            raise ValueError(
                "tap_rate_Hz is about the steady state of winding and housing: it needs nodes = 2 and no headroom_K"
            )
        if self.idle_A is not None and self.tap_rate_Hz is None:
            raise ValueError("idle_A flows in the pauses between taps: state tap_rate_Hz too, or leave it out")
        return self


class Feedback(Section):
    """Virtual wall under the transient (seed Eq. 9): spring and damper below the surface, from the encoder.

    Attributes
    ----------
    stiffness_N_m : spring of the virtual wall.
    damping_N_s_m : damper of the wall.
    latency_ticks : age of the encoder reading that the wall answers to, in servo periods.
    derivative_filter_Hz : low-pass of the measured velocity.
    """

    stiffness_N_m: Positive
    damping_N_s_m: NonNegative = 0.0
    latency_ticks: Annotated[int, Field(ge=0, le=100)] = 1
    derivative_filter_Hz: Positive = 500.0


class Hand(Section):
    """How the hand behind the recordings moves: on at the incoming speed for `intention_s`, and then as it yields.

    `brakes` comes to rest evenly in 60 ms, `straight` goes on, `stops` stops dead, `decays` loses its speed with a
    time constant of 30 ms, `pulls` turns back within 60 ms. What the hand does by itself is not asked of the motor.

    Attributes
    ----------
    intention_s : how long the hand goes on as it came, since nobody answers sooner.
    yields : law by which the hand gives way after that.
    """

    intention_s: Annotated[float, Field(ge=1e-3, le=LONGEST_HORIZON_S)] = INTENTION_S
    yields: Yielding = "brakes"

    def intention(self) -> Intention:
        """What the hand means to do from contact on."""
        return Intention(self.intention_s, self.yields)


class Weights(Section):
    """What is minimised: two terms of the error, the command's movement and heat, and how long after the waveform.

    The plain error counts over the hand's intention, the rapid one, above `rapid_from_Hz` or as vibration is felt,
    through window and tail. With `objective = "intensity"` the tap is asked to have at least the recorded energy,
    `intensity_dB` above it.
    What is left after the end of a named target counts `calm` times: a little error of a click for much less ringing.

    Attributes
    ----------
    rho : weight of the movement of the command; above 0 the optimum is unique.
    plain : weight of the error as it is, over the intention.
    rapid : filter of the rapid term: a high-pass, the band of felt vibration, or no filter.
    rapid_from_Hz : corner of that high-pass.
    heat_price : price of the heat of the coil [1/A^2]; 0 asks for none.
    after_s : how long after the waveform the error still counts.
    calm : how many times more counts what is left after a named target ends.
    objective : `waveform`: the nearest one; `intensity`: the nearest one with the energy of the tap.
    intensity_dB : energy that `intensity` asks for, over that of the recorded tap.
    tangential : weight of the acceleration across the normal, which an arm shall not have; 0 leaves it free.
    """

    rho: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)] = 1e-3
    plain: Annotated[float, Field(ge=0, le=1e6)] = 0.09
    rapid: Literal["highpass", "pacinian", "none"] = "highpass"
    rapid_from_Hz: Positive = 20.0
    heat_price: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    after_s: Annotated[float, Field(ge=0, le=LONGEST_AFTER_S)] = 30e-3
    calm: Annotated[float, Field(ge=1, le=1e6)] = 1.0
    objective: Literal["waveform", "intensity"] = "waveform"
    intensity_dB: Annotated[float, Field(ge=-40, le=20)] = 0.0
    tangential: Annotated[float, Field(ge=0, le=1e6)] = 1.0


SAME_DEVICE = 1e-9  # a factor this near to 1 makes no other device


class Robust(Section):
    """One command for a spread of devices around each node: least in the mean of their squared errors, or the worst.

    The spread is of grips, of devices that the uncertainty of the identified model allows, of hands of a population,
    or of these side by side;
    of a moving coil it is that of resonance and quality as production has it, `samples` resonances evenly across and
    three qualities for each.

    Attributes
    ----------
    grip_spread : grips around each node that one command serves, as a share of the grip.
    model_uncertainty : whether devices within the uncertainty of the identified model are served.
    population : file of a population of hands that one command serves.
    resonance_spread : share by which production spreads the resonance of a moving coil.
    quality_spread : share by which production spreads its quality.
    samples : devices that stand for the spread.
    minimise : whether the mean or the largest of the errors is least.
    """

    grip_spread: Annotated[float, Field(gt=0, lt=1)] | None = None
    model_uncertainty: bool = False
    population: Population | None = None
    resonance_spread: Annotated[float, Field(gt=0, lt=1)] | None = None
    quality_spread: Annotated[float, Field(gt=0, lt=1)] | None = None
    samples: Annotated[int, Field(ge=2, le=15)] = 5
    minimise: Literal["mean", "worst"] = "mean"

    def produced(self) -> list[tuple[float, float]]:
        """Factors on resonance and quality of the devices beside the nominal one."""
        wide, steps = self.resonance_spread or 0.0, self.samples if self.resonance_spread else 1
        resonances = [1 + wide * x for x in np.linspace(-1, 1, steps)] if steps > 1 else [1.0]
        qualities = [1.0] if self.quality_spread is None else [1 - self.quality_spread, 1.0, 1 + self.quality_spread]
        pairs = [(float(f), float(q)) for f in resonances for q in qualities]
        return [pair for pair in pairs if max(abs(pair[0] - 1), abs(pair[1] - 1)) > SAME_DEVICE]

    @model_validator(mode="after")
    def _of_something(self) -> Self:
        stated = (self.grip_spread, self.population, self.resonance_spread, self.quality_spread)
        if not self.model_uncertainty and stated == (None,) * len(stated):
            raise ValueError(
                "give grip_spread, model_uncertainty = true, population, resonance_spread or quality_spread"
            )
        return self
