"""Tables of a scene file: keys, types, bounds.

The first paragraph of a table's docstring is shown to users beside its keys.
"""

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from transopt.base import sizes
from transopt.base.section import Finite, NonNegative, Positive, Section, Speed, Temperature, Words, increasing
from transopt.plant.bridge import FASTEST_SWITCHING_HZ, SLOWEST_SWITCHING_HZ
from transopt.plant.intention import INTENTION_S, Intention, Yielding
from transopt.plant.kinds import Model
from transopt.plant.motor import Tip
from transopt.plant.time_grid import DELAY_ROUNDING
from transopt.scene.population import Population

COVERED_S = 0.2e-3  # lead beyond the amplifier's delay, so that current already acts while the pulse rises


def covering_lead_s(dt_s: float, delay_s: float) -> float:
    """The least whole number of servo periods that is at least the amplifier's delay and 0.2 ms."""
    periods = int(np.ceil((delay_s + COVERED_S) / dt_s - DELAY_ROUNDING))
    return float(f"{periods * dt_s:.12g}")  # 3e-4 and not 0.00030000000000000003


def _free() -> list[float]:
    """Grips of a free device: 0 alone."""
    return [0.0]


class Grid(Section):
    """Nodes of the library: no speeds with named targets, and grip 0 alone for a device that no hand holds.

    With `cool_share` each node has a second, cool command: the optimum with at most this share of the first one's
    heat. A device whose coil is warm blends towards it instead of scaling the first command down.

    Attributes
    ----------
    speeds_m_s : incoming speeds of the taps, increasing.
    grips_N : grip forces, increasing; 0 alone is a free device.
    grip_min_N : grip below which no transient is played.
    cool_share : heat of the cool command for a warm coil within the window, at most this share of the first
        command's unless the hand-over to a wall takes more.
    """

    speeds_m_s: Annotated[list[Speed], Field(max_length=sizes.MOST_NODES)] = Field(default_factory=list)
    grips_N: Annotated[list[NonNegative], Field(min_length=1, max_length=sizes.MOST_NODES)] = Field(
        default_factory=_free
    )
    grip_min_N: Positive = 0.5
    cool_share: Annotated[float, Field(gt=0, lt=1)] | None = None

    _speeds_ordered = field_validator("speeds_m_s")(increasing)
    _grips_ordered = field_validator("grips_N")(increasing)

    @model_validator(mode="after")
    def _held_or_free(self) -> Self:
        if self.grips_N[0] == 0 and len(self.grips_N) > 1:
            raise ValueError("grips_N: the free device (grip 0) needs a scene of its own, without held grips")
        if 0 < self.grips_N[0] < self.grip_min_N:
            raise ValueError(
                f"grips_N: {self.grips_N[0]:g} N is below grip_min_N = {self.grip_min_N:g} N, "
                "where no transient is played: lower grip_min_N, or leave this grip out"
            )
        return self


WINDOW_S = 80e-3  # default window, in which the hand is stopped and let go again


class Time(Section):
    """Servo period, horizon, and the time by which the waveform precedes contact.

    Without `stages` the window is 80 ms, or shorter if `thermal.tap_rate_Hz` brings the next tap sooner. The default
    lead is the least whole number of servo periods that covers the amplifier's delay and 0.2 ms.

    Attributes
    ----------
    dt_s : servo period, for which a command is held.
    stages : number of commands of a waveform; by default 80 ms of them, fewer if `thermal.tap_rate_Hz` is high.
    lead_s : time by which the waveform precedes contact; by default the amplifier's delay and 0.2 ms.
    """

    dt_s: Annotated[float, Field(ge=sizes.SHORTEST_DT_S, le=sizes.LONGEST_DT_S)] = 1e-4
    stages: Annotated[int, Field(ge=2, le=sizes.MOST_STAGES)] | None = None
    lead_s: Annotated[float, Field(ge=0, le=sizes.LONGEST_LEAD_S)] | None = None

    @model_validator(mode="after")
    def _short(self) -> Self:
        horizon_s = (self.stages or 0) * self.dt_s
        if horizon_s > sizes.LONGEST_HORIZON_S:
            raise ValueError(
                f"{self.stages} stages of {self.dt_s:g} s are {horizon_s:g} s: must be at most "
                f"{sizes.LONGEST_HORIZON_S:g} s; a tap is over in a tenth of one"
            )
        return self


class AmplifierSection(Section):
    """Amplifier: pole, delay beyond the hold, range of the command.

    Pole and delay are stated here unless the scene's model file has them. With `switching_Hz`, the PWM frequency of
    an H-bridge on the rail `limits.supply_V`, pole and delay that are not stated follow from the motor, as does the
    ripple's heat. `gain_V_A` is the proportional gain of its PI current loop, by default for a crossover at a tenth
    of `switching_Hz`. The range of a voltage amplifier, a class-D stage's rail, is `command_limit_V`, by default
    `limits.voltage_V`.

    Attributes
    ----------
    pole_Hz : frequency of -3 dB from command to current.
    delay_s : time from a command to the first current, in addition to the hold.
    command_limit_A : largest command, of either sign.
    command_limit_V : largest command of a voltage amplifier; by default `limits.voltage_V`.
    switching_Hz : PWM frequency of an H-bridge, from which pole, delay and ripple follow.
    gain_V_A : proportional gain of the current loop; by default its crossover is a tenth of `switching_Hz`.
    """

    pole_Hz: Positive | None = None
    delay_s: Annotated[float, Field(ge=0, le=sizes.LONGEST_DELAY_S)] | None = None
    command_limit_A: Positive = 6.0
    command_limit_V: Positive | None = None
    switching_Hz: Annotated[float, Field(ge=SLOWEST_SWITCHING_HZ, le=FASTEST_SWITCHING_HZ)] | None = None
    gain_V_A: Positive | None = None


class Striker(Section):
    """The device that strikes the object in simulated recordings, where the design is for that of a model file.

    The scene states it in addition to its model file, so that the taps to reproduce do not change with the model.
    """

    model: Annotated[Model, Field(discriminator="kind")]
    tip: Tip | None = None
    amplifier: AmplifierSection | Literal["ideal"]


class OwnLimitTable(Section):
    """A user's own limit, as read from its file (`limits.own` names files, which are read with the scene)."""

    name: Words
    unit: Words
    outputs: list[Words]
    lower: Finite | None
    upper: Finite | None
    coefficients: list[Finite] | None
    offsets: list[Finite] | None
    function: str | None


Instant = Annotated[list[Finite], Field(min_length=2, max_length=2)]  # a time [s] and a value there
OF_A_VOLTAGE = ("steady_voltage_V", "slew_V_per_s", "sag")  # keys that need `voltage_V`
OF_A_CURRENT = ("steady_current_A", "slew_A_per_s", "supply_V")  # keys of plants that a current drives


class LimitsSection(Section):
    """The transient limit is beta * steady_current_A (seed Eq. 8), or `current_A` in its place.

    For a voltage input it is `voltage_V`; `sag` states the share of it that the supply provides along the waveform,
    and `current_A` bounds the coil's current.

    Attributes
    ----------
    steady_current_A : largest continuous current of the motor.
    beta : the transient limit as a multiple of the steady current.
    current_A : largest current at any time, in place of `beta`; with a voltage input, that of the coil.
    slew_A_per_s : largest rate of change of the command.
    supply_V : supply rail: largest sum of the voltages of resistance, inductance and back-EMF.
    voltage_V : largest voltage at any time, where a voltage drives the plant.
    steady_voltage_V : rated voltage, for the baselines.
    slew_V_per_s : largest rate of change of a voltage command.
    sag : share of `voltage_V` that the supply provides along the waveform: pairs of time and share.
    stroke_m : largest displacement of the motor mass, or of a moving coil, from the surface or from rest.
    velocity_m_s : largest velocity of that mass, the motion of the hand included.
    own : Python files with limits of your own.
    """

    steady_current_A: Positive | None = None
    beta: Annotated[float, Field(ge=1, le=1e4, allow_inf_nan=False)] | None = None
    current_A: Positive | None = None
    slew_A_per_s: Positive | None = None
    supply_V: Positive | None = None
    voltage_V: Positive | None = None
    steady_voltage_V: Positive | None = None
    slew_V_per_s: Positive | None = None
    sag: Annotated[list[Instant], Field(max_length=sizes.MOST_NODES)] | None = None
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
        """Key -> number of every limit, with the transient limit as a number; `own` if there are any."""
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
        """Largest continuous current or voltage of the actuator; a voltage defaults to its transient limit."""
        steady = self.steady_current_A if self.voltage_V is None else self.steady_voltage_V or self.voltage_V
        assert steady is not None
        return steady


class Thermal(Section):
    """Temperatures at the start, and requirements on the winding: its limit, a rise per tap, repeated taps.

    Attributes
    ----------
    ambient_C : temperature of the air.
    start_winding_C : temperature of the winding when a tap begins.
    start_housing_C : temperature of the housing when a tap begins.
    nodes : 2: winding and housing warm; 1: the housing keeps its temperature.
    headroom_K : largest rise of the winding during one tap.
    tap_rate_Hz : taps per second, repeated for ever: their steady state keeps the limit.
    idle_A : current in the pauses between repeated taps; by default that of a wall.
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
                "tap_rate_Hz states a steady state of winding and housing: it needs nodes = 2 and no headroom_K"
            )
        if self.idle_A is not None and self.tap_rate_Hz is None:
            raise ValueError("idle_A flows in the pauses between taps: state tap_rate_Hz too, or leave it out")
        return self


class Feedback(Section):
    """Virtual wall rendered together with the transient (seed Eq. 9): spring and damper below the surface.

    Attributes
    ----------
    stiffness_N_m : spring of the virtual wall.
    damping_N_s_m : damper of the wall.
    latency_ticks : age of the encoder reading that the wall responds to, in servo periods.
    derivative_filter_Hz : corner of the low-pass of the measured velocity.
    """

    stiffness_N_m: Positive
    damping_N_s_m: NonNegative = 0.0
    latency_ticks: Annotated[int, Field(ge=0, le=100)] = 1
    derivative_filter_Hz: Positive = 500.0


class Hand(Section):
    """Motion of the hand in the recordings: at the incoming speed for `intention_s`, then by the law of yielding.

    `brakes` comes to rest in 60 ms at constant deceleration, `straight` continues, `stops` is at rest at once,
    `decays` loses its speed with a time constant of 30 ms, `pulls` reverses within 60 ms. The motor is not asked to
    make the hand's own motion.

    Attributes
    ----------
    intention_s : time for which the hand continues at its speed, as nobody reacts sooner.
    yields : law by which the hand yields after that.
    """

    intention_s: Annotated[float, Field(ge=1e-3, le=sizes.LONGEST_HORIZON_S)] = INTENTION_S
    yields: Yielding = "brakes"

    def intention(self) -> Intention:
        """The intended motion of the hand from contact on."""
        return Intention(self.intention_s, self.yields)


class Weights(Section):
    """Weights of the objective: two error terms, the command's movement, its heat, and the tail after the waveform.

    The plain error counts during the hand's intention; the rapid error, above `rapid_from_Hz` or in the band of felt
    vibration, counts through window and tail. With `objective = "intensity"` the tap must also have at least the
    recorded energy, changed by `intensity_dB`.
    The error after the end of a named target counts `calm` times: slightly more error of a click, much less ringing.

    Attributes
    ----------
    rho : weight of the command's movement; above 0 the optimum is unique.
    plain : weight of the unfiltered error during the intention.
    rapid : filter of the rapid term: a high-pass, the band of felt vibration, or no such term.
    rapid_from_Hz : corner of that high-pass.
    heat_price : price of the squared current of a motor that a current drives [1/A^2]; 0 for none.
    after_s : duration of the tail after the waveform in which the error still counts.
    calm : factor on the weight of the error after a named target ends.
    objective : `waveform`: least error; `intensity`: least error with the required energy of the tap.
    intensity_dB : energy required by `intensity`, over that of the recorded tap.
    tangential : weight of an arm's acceleration across the normal; 0 leaves it free.
    """

    rho: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)] = 1e-3
    plain: Annotated[float, Field(ge=0, le=1e6)] = 0.09
    rapid: Literal["highpass", "pacinian", "none"] = "highpass"
    rapid_from_Hz: Positive = 20.0
    heat_price: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    after_s: Annotated[float, Field(ge=0, le=sizes.LONGEST_AFTER_S)] = 30e-3
    calm: Annotated[float, Field(ge=1, le=1e6)] = 1.0
    objective: Literal["waveform", "intensity"] = "waveform"
    intensity_dB: Annotated[float, Field(ge=-40, le=20)] = 0.0
    tangential: Annotated[float, Field(ge=0, le=1e6)] = 1.0


SAME_DEVICE = 1e-9  # largest difference of a factor from 1 at which it stands for the nominal device


class Robust(Section):
    """One command for a spread of devices around each node, by the mean or the worst of their squared errors.

    The spread is over grips, over devices drawn from the uncertainty of the identified model, over hands of a
    population, or over several of these. For a moving coil it is over resonance and quality in production, with
    `samples` evenly spaced resonances and three qualities for each.

    Attributes
    ----------
    grip_spread : half width of the range of grips around each node, as a share of the grip.
    model_uncertainty : whether devices within the uncertainty of the identified model are served.
    population : file of a population of hands that one command serves.
    resonance_spread : relative spread of a moving coil's resonance in production.
    quality_spread : relative spread of its quality in production.
    samples : number of devices that represent the spread.
    minimise : whether the mean or the largest of the errors is minimised.
    """

    grip_spread: Annotated[float, Field(gt=0, lt=1)] | None = None
    model_uncertainty: bool = False
    population: Population | None = None
    resonance_spread: Annotated[float, Field(gt=0, lt=1)] | None = None
    quality_spread: Annotated[float, Field(gt=0, lt=1)] | None = None
    samples: Annotated[int, Field(ge=2, le=15)] = 5
    minimise: Literal["mean", "worst"] = "mean"

    def produced(self) -> list[tuple[float, float]]:
        """Factors on resonance and quality of the devices other than the nominal one."""
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
