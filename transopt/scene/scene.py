"""What a scene holds: everything that defines one library, and the models that follow from it.

`Scene` checks what its tables say about each other; what a single table may say is checked in
`transopt.scene.sections`. Its methods turn the tables into the objects of the rooms below: plant, amplifier, coil,
wall, time grid, limits.
"""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from transopt.base.axes import Axes
from transopt.base.errors import InputError
from transopt.base.section import Name, Section, Words
from transopt.base.shown import cut, wrapped
from transopt.base.sizes import LONGEST_LEAD_S, MOST_AFTER, MOST_COMMANDS, MOST_NODES, MOST_STAGES
from transopt.base.writing import rounded_down
from transopt.plant.amplifier import Amplifier
from transopt.plant.bridge import Bridge
from transopt.plant.circuit import Circuit
from transopt.plant.coil import PWM_RIPPLE_A, CoilModel
from transopt.plant.discretise import TimeGrid, samples_after
from transopt.plant.drive import Drive
from transopt.plant.fourth_order import FourthOrder
from transopt.plant.hand import HandSection
from transopt.plant.intention import FreeMotion
from transopt.plant.kind import PlantKind
from transopt.plant.kinds import Model
from transopt.plant.motor import Motor, Tip, Transmission, Winding, at_the_tip
from transopt.plant.moving_coil import MovingCoil
from transopt.plant.nonlinear import NonlinearCoil
from transopt.plant.state_space import Input, StateSpace
from transopt.plant.wall import Wall
from transopt.problem.heat import Budget
from transopt.problem.limits import kinds_of
from transopt.problem.objective.rapid import rapid_filter
from transopt.problem.posing import Posing
from transopt.recordings.settings import Recordings
from transopt.recordings.targets import TargetTable
from transopt.scene.identified import IdentifiedModel
from transopt.scene.model_parts import ChainHand, DriveDevice, StateSpaceDevice
from transopt.scene.sections import (
    OF_A_CURRENT,
    WINDOW_S,
    AmplifierSection,
    Feedback,
    Grid,
    Hand,
    LimitsSection,
    Robust,
    Striker,
    Thermal,
    Time,
    Weights,
    covering_lead_s,
)

BELOW = 1 - 1e-6  # of a bound that has to be stayed below
POPULATION_SEED = 2  # of the hands that a robust design serves
FORCE_TOLERANCE = 0.01  # between the motor's force per ampere and that of a model file


class Scene(Section):
    """One scene file; `name` defaults to the file's stem."""

    name: Name
    description: Words = ""
    grid: Grid = Grid()
    time: Time = Time()
    recordings: Recordings = Recordings()
    hand: Hand = Hand()
    targets: Annotated[list[TargetTable], Field(max_length=MOST_NODES)] = Field(default_factory=list)
    model: Annotated[Model | IdentifiedModel, Field(discriminator="kind")]
    motor: Motor | None = None
    transmission: Transmission | None = None
    tip: Tip | None = None
    amplifier: AmplifierSection | Literal["ideal"]
    limits: LimitsSection
    thermal: Thermal = Thermal()
    feedback: Feedback | None = None
    weights: Weights = Weights()
    robust: Robust | None = None
    hand_over_samples: Annotated[int, Field(ge=1)] = 10
    striker: Striker | None = None
    implausible: Literal["refuse", "accept"] = "refuse"  # see `transopt.scene.plausible`

    def __repr__(self) -> str:
        time = self.time
        named = ": ".join(filter(None, (cut(self.name), cut(self.description))))
        return wrapped(
            f"Scene({named}; {self.axes.said}, {self.stages} commands of {1e3 * time.dt_s:g} ms, limit "
            f"{self.limits.transient_input:g} {self.driven_by.unit})"
        )

    @property
    def axes(self) -> Axes:
        """What the entries of its library are for: speeds and grips, or named targets."""
        names = tuple(target.name for target in self.targets)
        return Axes(tuple(self.grid.speeds_m_s) or (0.0,) * len(names), tuple(self.grid.grips_N), names)

    @property
    def driven_by(self) -> Input:
        """What drives the plant: a current, or a voltage."""
        return self.model.driven_by

    @model_validator(mode="after")
    def _one_drive(self) -> Self:
        self._check_what_is_wanted()
        self._check_input()
        if (self.motor is None) != (self.transmission is None):
            raise ValueError("motor and transmission belong together: give both, or a tip table in their place")
        if isinstance(self.model, IdentifiedModel):
            self._check_identified(self.model)
        if self.nonlinear and not self.targets:
            raise ValueError("model.nonlinear: x is the displacement from rest, so it needs [[targets]], not speeds")
        if self.nonlinear and self.weights.objective != "waveform":
            raise ValueError('model.nonlinear: only with weights.objective = "waveform"')
        if self.grid.cool_share is not None and (self.nonlinear or self.weights.objective != "waveform"):
            raise ValueError(
                "grid.cool_share: the second command is the optimum of a linear plant's waveform: leave it out, or "
                'model.nonlinear and weights.objective = "intensity"'
            )
        if self.nonlinear and self.robust is not None:
            raise ValueError("robust: serves a spread of linear devices, not model.nonlinear: leave one of them out")
        whole = isinstance(self.model, PlantKind) and not self.model.driven_at_tip
        if whole and (self.motor, self.transmission, self.tip) != (None, None, None):
            raise ValueError(f"model.kind = {self.model.kind} is a whole actuator: take motor, transmission, tip out")
        if whole and self.feedback is not None:
            raise ValueError(f"feedback: a wall is for a stylus on a motor, not for model.kind = {self.model.kind}")
        held = not isinstance(self.model, PlantKind) or self.model.held_by_hand
        if not held and self.grid.grips_N != [0.0]:
            raise ValueError(f"grid.grips_N: model.kind = {self.model.kind} depends on no grip: leave it out")
        if not whole and not self._drive_in_file and (self.motor is None) == (self.tip is None):
            raise ValueError("the drive is stated either by motor and transmission or by tip: give exactly one")
        through = isinstance(self.model, PlantKind) and self.model.through_transmission
        if through and self.tip is not None and None in (self.tip.stiffness_N_m, self.tip.damping_N_s_m):
            raise ValueError(f"model.kind = {self.model.kind} needs tip.stiffness_N_m and tip.damping_N_s_m")
        if self.motor is not None and self.limits.transient_input > self.motor.i_peak_A:
            raise ValueError(
                f"limits: transient limit {self.limits.transient_input:g} A is above the motor's i_peak_A = "
                f"{self.motor.i_peak_A:g} A: lower beta or current_A"
            )
        self._check_amplifier()
        commands = self.axes.entries * self.stages
        if commands > MOST_COMMANDS:
            raise ValueError(
                f"grid and time.stages: {commands} commands, at most {MOST_COMMANDS}: fewer nodes or stages"
            )
        self._check_time()
        self._check_what_needs_what()
        if self.hand_over_samples > self.stages:
            raise ValueError(
                f"hand_over_samples = {self.hand_over_samples}: must not exceed time.stages = {self.stages}"
            )
        return self

    def _check_what_is_wanted(self) -> None:
        """Speeds with recordings of taps, or named targets: one of the two."""
        names = [target.name for target in self.targets]
        if not names:
            if self.weights.calm != 1:
                raise ValueError("weights.calm: a tap goes on as it was recorded, only a named target has an end")
            if not self.grid.speeds_m_s:
                raise ValueError("grid.speeds_m_s: missing; add it to the scene, or [[targets]] without speeds")
            if not self.recordings.files and self.recordings.simulated is None:
                raise ValueError("recordings: give either files or a simulated table, not both and not neither")
            return
        if len(set(names)) < len(names):
            raise ValueError("targets: two of one name: give each its own")
        if self.grid.speeds_m_s:
            raise ValueError("grid.speeds_m_s: named targets have no speed: give either speeds or targets")
        if self.grid.grips_N != [0.0]:
            raise ValueError("grid.grips_N: named targets are for a device that nobody holds: leave it out")
        if self.recordings.files or self.recordings.simulated is not None:
            raise ValueError("recordings: named targets take the place of files and simulated taps: leave these out")
        if self.feedback is not None:
            raise ValueError("feedback: a virtual wall needs a stylus that comes in: leave it out with named targets")

    def _check_input(self) -> None:
        """The limits, and all that knows currents alone, must be of the plant's input."""
        limits, unit = self.limits, self.driven_by.unit
        if unit == "A":
            if limits.voltage_V is not None:
                raise ValueError(
                    f"limits.voltage_V: a current drives model.kind = {self.model.kind}: state its limits in A, or a "
                    "model that a voltage drives"
                )
            if limits.steady_current_A is None:
                raise ValueError("limits.steady_current_A: missing; add it to the scene")
            return
        if limits.voltage_V is None:
            raise ValueError(f"limits.voltage_V: missing; a voltage drives model.kind = {self.model.kind}")
        if limits.current_A is not None and isinstance(self.model, MovingCoil) and self.model.L_H == 0:
            raise ValueError(
                "limits.current_A: the current of a coil without inductance follows the voltage at once and is no "
                "state to be limited: state model.L_H, or bound the voltage by limits.voltage_V"
            )
        for key, stated in (
            ("limits.beta", limits.beta is not None),
            *((f"limits.{key}", getattr(limits, key) is not None) for key in OF_A_CURRENT),
            ("feedback", self.feedback is not None),
            ("thermal", self.thermal != Thermal()),
            ("grid.cool_share", self.grid.cool_share is not None),
        ):
            if stated:
                raise ValueError(
                    f"{key}: belongs to a motor that a current drives, and here a voltage does: leave it out"
                )

    def _check_what_needs_what(self) -> None:
        """Keys that need or exclude keys of other tables."""
        if self.limits.supply_V is not None and (self.circuit() is None or self.amplifier == "ideal"):
            raise ValueError(
                "limits.supply_V needs [motor] (resistance, inductance, back-EMF) and an amplifier with a pole: an "
                "ideal one changes the current at once, which no voltage can"
            )
        budgets = (self.thermal.headroom_K, self.thermal.tap_rate_Hz)
        if budgets != (None, None) and self._winding is None:
            raise ValueError("thermal.headroom_K and thermal.tap_rate_Hz need [motor]: a tip states no coil")
        winding = self._winding
        if winding is not None and self.thermal.start_winding_C > winding.winding_max_C:
            raise ValueError(
                f"thermal.start_winding_C = {self.thermal.start_winding_C:g} C: above the motor's winding_max_C = "
                f"{winding.winding_max_C:g} C: let it cool"
            )
        grid = self.time_grid()
        takes_s = (grid.stages + 1) * grid.dt_s + grid.delay_s
        shorter = "" if self.time.stages is None else ", or shorten time.stages"
        if self.thermal.tap_rate_Hz is not None and not 1 / self.thermal.tap_rate_Hz > takes_s:
            raise ValueError(
                f"thermal.tap_rate_Hz = {self.thermal.tap_rate_Hz:g}: a tap takes {takes_s * 1e3:g} ms with the "
                f"amplifier's delay: must be at most {rounded_down(BELOW / takes_s):g}{shorter}"
            )
        if self.robust is not None and self.feedback is not None:
            raise ValueError(
                "robust: feedback answers one device's motion, and a spread of them has many: leave one of them out"
            )
        if self.robust is not None and self.robust.minimise == "worst" and self.weights.objective == "intensity":
            raise ValueError(
                'robust.minimise = "worst": is of the waveform: leave out weights.objective = "intensity", or take '
                '"mean"'
            )
        if self.robust is not None and self.robust.grip_spread is not None and self.grid.grips_N[0] == 0:
            raise ValueError("robust.grip_spread: the free device has no grip to spread")
        if self.robust is not None and self.robust.population is not None:
            self._check_population(self.robust)
        produced = self.robust is not None and (self.robust.resonance_spread or self.robust.quality_spread)
        if produced and not isinstance(self.model, MovingCoil):
            raise ValueError(
                "robust.resonance_spread and quality_spread: are of a mass on a spring, model.kind = inertial or "
                f"voice_coil, not of {self.model.kind}: leave them out"
            )
        if self.robust is not None and self.robust.model_uncertainty and not isinstance(self.model, IdentifiedModel):
            raise ValueError('robust.model_uncertainty: needs a model file (model = "MODEL.json"), which has it')

    def _check_population(self, robust: Robust) -> None:
        """Hands of a population take the place of a hand that is stated by itself and holds the device."""
        if not isinstance(self.model, Drive | FourthOrder) or self.grid.grips_N[0] == 0:
            raise ValueError(
                "robust.population: spreads the hand that a scene states by [model.hand], at grips above 0: leave it "
                "out; an identified model has robust.model_uncertainty"
            )
        assert robust.population is not None
        try:
            robust.population.drawn(robust.samples, POPULATION_SEED, self.grid.grips_N)
        except InputError as error:
            raise ValueError(f"robust.{error}") from None

    @property
    def _drive_in_file(self) -> bool:
        """Whether a model file tells what the motor moves, so that motor and transmission are not needed for it."""
        return isinstance(self.model, IdentifiedModel) and self.model.device is not None

    def _on_the_motion(self) -> list[str]:
        """Keys of the limits asked for that look at the device's motion."""
        asked, kinds = self.limits.asked(), kinds_of(self.driven_by)
        return [kind.key for kind in kinds if kind.of_each_device and asked.get(kind.key) is not None]

    def _check_identified(self, model: IdentifiedModel) -> None:
        """What the scene states beside a model file must not contradict it."""
        for grip in self.grid.grips_N:
            for served in (grip, *self.spread_grips_N(grip)):
                try:
                    model.check_grip(served)
                except InputError as error:
                    raise ValueError(f"grid.grips_N: {served:g} N: {error}") from None
        tip = model.tip()
        if self._drive_in_file and self.tip is not None:
            raise ValueError(f"tip: the device in {model.file} has it all: take the tip table out")
        if tip is not None and self.motor is not None and self.transmission is not None:
            stated, known = self.motor.kt_Nm_A * self.transmission.ratio_1_m, tip.force_per_current_N_A
            if not abs(stated / known - 1) <= FORCE_TOLERANCE:
                raise ValueError(
                    f"motor: kt_Nm_A * transmission.ratio_1_m = {stated:.4g} N/A, but {model.file} was identified "
                    f"with force_per_current_N_A = {known:.4g} N/A: they must agree within {FORCE_TOLERANCE:.0%}; "
                    "correct one of them, or identify again with this motor"
                )
        if isinstance(model.device, StateSpaceDevice):
            for key, stated_in_scene in (
                ("feedback", self.feedback is not None),
                *((f"limits.{key}", True) for key in self._on_the_motion()),
            ):
                if stated_in_scene:
                    raise ValueError(
                        f"{key}: needs the motor's motion, and the device in {model.file} is a state space, which "
                        "knows none: identify a drive chain, or leave it out"
                    )
            if self.recordings.simulated is not None and self.striker is None:
                raise ValueError(
                    f"recordings.simulated: the device in {model.file} is a state space, which has no stylus to "
                    "strike with: give recorded files, or a [model] that strikes and the file as model_file"
                )
        if self.robust is not None and self.robust.model_uncertainty:
            try:
                model.drawn(self.robust.samples, self.grid.grips_N)
            except InputError as error:
                raise ValueError(f"robust.model_uncertainty: {error}") from None

    def _check_amplifier(self) -> None:
        """Pole and delay stand in the scene or in its model file, in one of them, or follow from bridge and motor."""
        identified = self.model.amplifier if isinstance(self.model, IdentifiedModel) else None
        stated = None if self.amplifier == "ideal" else self.amplifier
        if stated is not None and stated.switching_Hz is not None:
            if self.circuit() is None or self.limits.supply_V is None:
                raise ValueError(
                    "amplifier.switching_Hz: needs [motor] and the rail that the bridge switches, limits.supply_V: "
                    "add them, or take it out"
                )
            self.bridge()
        if stated is not None and stated.gain_V_A is not None:
            if stated.switching_Hz is None:
                raise ValueError("amplifier.gain_V_A: is of a bridge's current loop: add amplifier.switching_Hz too")
            if stated.pole_Hz is not None or identified is not None:
                raise ValueError(
                    "amplifier.gain_V_A: the pole follows from it, and is stated too: take one of them out"
                )
        if identified is None:
            follows = self.bridge() is not None and not self.pole_is_stated
            for name in ("pole_Hz", "delay_s"):
                if stated is not None and getattr(stated, name) is None and not follows:
                    raise ValueError(f"amplifier.{name}: missing; add it to the scene")
            return
        assert isinstance(self.model, IdentifiedModel)
        if self.amplifier == "ideal":
            raise ValueError(f"amplifier = 'ideal': {self.model.file} has an amplifier part: state [amplifier]")
        assert isinstance(self.amplifier, AmplifierSection)
        for name in ("pole_Hz", "delay_s"):
            value = getattr(self.amplifier, name)
            if value is not None:
                raise ValueError(
                    f"amplifier.{name} = {value:g}: {self.model.file} has it too ({getattr(identified, name):g}): "
                    "take it out of the scene"
                )

    def _check_time(self) -> None:
        """A lead that is not stated must be possible, and the samples after the window must not be too many."""
        lead_s, after = self.lead_s, samples_after(self.weights.after_s, self.time.dt_s)
        if self.time.lead_s is None and lead_s > LONGEST_LEAD_S:
            raise ValueError(
                f"time.lead_s: the amplifier's delay of {self.delay_s * 1e3:g} ms and 0.2 ms, in whole periods of "
                f"{self.time.dt_s * 1e3:g} ms, take a lead of {lead_s * 1e3:g} ms, at most {LONGEST_LEAD_S * 1e3:g} "
                "ms: state a shorter time.lead_s; what no command can reach then counts as error"
            )
        if after > MOST_AFTER:
            raise ValueError(
                f"weights.after_s = {self.weights.after_s:g} s: {after} samples of {self.time.dt_s:g} s, at most "
                f"{MOST_AFTER}: lower weights.after_s"
            )

    def striking(self) -> Self:
        """The scene whose device strikes the object of simulated recordings: this one, unless it states a striker."""
        if self.striker is None:
            return self
        stated = {"model": self.striker.model, "tip": self.striker.tip, "amplifier": self.striker.amplifier}
        return self.model_copy(update={**stated, "striker": None})

    def free_motion(self, grip_N: float) -> FreeMotion:
        """How the stylus moves without current in the hand of the recordings, at one grip."""
        struck = self.striking() if self.recordings.simulated is not None else self
        is_held = grip_N > 0 and (isinstance(struck.model, IdentifiedModel) or struck.model.held_by_hand)
        chain = struck.plant(grip_N) if is_held and struck.model.is_chain else None
        return FreeMotion(self.hand.intention(), chain, is_held=is_held)

    def drive_at_tip(self) -> Tip:
        """What the stylus feels of the drive: as identified, as motor and transmission make it, or as stated."""
        identified = self.model.tip() if isinstance(self.model, IdentifiedModel) else None
        if identified is not None:
            return identified
        if self.motor is None or self.transmission is None:
            assert self.tip is not None
            return self.tip
        return at_the_tip(self.motor, self.transmission)

    def plant(self, grip_N: float, *, struck: bool = False) -> StateSpace:
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

    def _chain(self, grip_N: float, struck: bool) -> StateSpace:
        if isinstance(self.model, IdentifiedModel):
            force = None if self._drive_in_file else self.drive_at_tip().force_per_current_N_A
            return self.model.plant(grip_N, force, struck=struck)
        tip = self.drive_at_tip() if self.model.driven_at_tip else None
        return self.model.plant(grip_N, tip, struck=struck)

    def amplifier_model(self) -> Amplifier | None:
        """Model of the amplifier; None for an ideal one."""
        if self.amplifier == "ideal":
            return None
        assert isinstance(self.amplifier, AmplifierSection)
        identified = self.model.amplifier if isinstance(self.model, IdentifiedModel) else None
        stated = self.amplifier if identified is None else identified
        pole_Hz, delay_s, bridge = stated.pole_Hz, stated.delay_s, self.bridge()
        if bridge is not None:
            pole_Hz = bridge.pole_Hz if pole_Hz is None else pole_Hz
            delay_s = bridge.delay_s if delay_s is None else delay_s
        assert pole_Hz is not None
        assert delay_s is not None
        if self.driven_by.unit == "V":
            limit = self.amplifier.command_limit_V or self.limits.transient_input
        else:
            limit = self.amplifier.command_limit_A
        return Amplifier(pole_Hz, delay_s, limit)

    @property
    def pole_is_stated(self) -> bool:
        """Whether the amplifier's pole stands in the scene or its model file, and does not follow from a bridge."""
        identified = self.model.amplifier if isinstance(self.model, IdentifiedModel) else None
        return identified is not None or (self.amplifier != "ideal" and self.amplifier.pole_Hz is not None)

    def bridge(self) -> Bridge | None:
        """Give the bridge that the amplifier is made of; None where its switching frequency is not stated.

        Raises
        ------
        InputError : a motor, rail, frequency or gain for which its model was not tried.
        """
        circuit, rail_V = self.circuit(), self.limits.supply_V
        if self.amplifier == "ideal" or self.amplifier.switching_Hz is None or circuit is None or rail_V is None:
            return None
        eddy_ohm = None if self.motor is None else self.motor.R_eddy_ohm
        return Bridge(circuit, rail_V, self.amplifier.switching_Hz, self.amplifier.gain_V_A, eddy_ohm)

    @property
    def delay_s(self) -> float:
        """Delay of the amplifier; zero for an ideal one."""
        amplifier = self.amplifier_model()
        return 0.0 if amplifier is None else amplifier.delay_s

    @property
    def lead_s(self) -> float:
        """How long before contact the waveform starts: as stated, or the least that covers the amplifier's delay."""
        return covering_lead_s(self.time.dt_s, self.delay_s) if self.time.lead_s is None else self.time.lead_s

    @property
    def stages(self) -> int:
        """Commands of an entry: as stated, or those of 80 ms, fewer where the next tap comes sooner."""
        dt_s, rate_Hz = self.time.dt_s, self.thermal.tap_rate_Hz
        if self.time.stages is not None:
            return self.time.stages
        stages = min(round(WINDOW_S / dt_s), MOST_STAGES)
        if rate_Hz is not None:
            # A tap takes a servo period and the amplifier's delay more than its window, and ends before the next one.
            stages = min(stages, math.ceil((1 / rate_Hz - self.delay_s) / dt_s * BELOW) - 2)
        return max(stages, self.hand_over_samples + 1, 2)

    def time_grid(self) -> TimeGrid:
        """Servo ticks and switching instants of every entry, and how many samples after them count."""
        after = samples_after(self.weights.after_s, self.time.dt_s)
        return TimeGrid(self.time.dt_s, self.stages, self.lead_s, self.delay_s, after)

    @property
    def nonlinear(self) -> bool:
        """Whether its plant has formulas in place of constants."""
        return isinstance(self.model, MovingCoil) and self.model.nonlinear is not None

    @property
    def formulas(self) -> dict[str, str | None] | None:
        """What its plant has in place of constants, key -> formula; None for a linear plant."""
        stated = self.model.nonlinear if isinstance(self.model, MovingCoil) else None
        return None if stated is None else stated.model_dump()

    def nonlinear_plant(self) -> NonlinearCoil:
        """The plant with its formulas.

        Raises
        ------
        InputError : a scene without `model.nonlinear`.
        """
        plant = self.model.nonlinear_plant() if isinstance(self.model, MovingCoil) else None
        if plant is None:
            raise InputError(f"{self.name}: model.nonlinear: missing; add it to the scene, or use transopt.build")
        return plant

    def at_rest(self) -> Self:
        """The scene with the plant as it is at rest, a linear one."""
        if not self.nonlinear:
            return self
        return self.model_copy(update={"model": self.model.model_copy(update={"nonlinear": None})})

    def posing(self) -> Posing:
        """What the problems of all its taps share.

        Raises
        ------
        InputError : a nonlinear plant, which no linear problem has.
        """
        if self.nonlinear:
            raise InputError(
                f"{self.name}: model.nonlinear: this is done with linear plants alone; `transopt solve` and "
                "transopt.build design for a nonlinear one, for all else leave the table out"
            )
        grid = self.time_grid()
        return Posing(
            grid=grid,
            amplifier=self.amplifier_model(),
            plain=self.weights.plain,
            rapid=rapid_filter(self.weights.rapid, self.weights.rapid_from_Hz, self.time.dt_s),
            rho=self.weights.rho,
            heat_price=self.weights.heat_price,
            intention_s=self.hand.intention_s,
            asked=self.limits.asked(),
            hand_over_samples=self.hand_over_samples,
            circuit=self.circuit(),
            coil=self.coil(),
            wall=self.wall(),
            budget=self.budget(),
            objective=self.weights.objective,
            intensity_dB=self.weights.intensity_dB,
            driven_by=self.driven_by,
            calm=self.weights.calm,
            worst=self.robust is not None and self.robust.minimise == "worst",
        )

    def budget(self) -> Budget:
        """What the winding's temperature may do."""
        thermal = self.thermal
        return Budget(thermal.headroom_K, thermal.tap_rate_Hz, thermal.idle_A)

    def wall(self) -> Wall | None:
        """Rendered wall; None without feedback."""
        if self.feedback is None:
            return None
        return Wall(force_per_current_N_A=self.drive_at_tip().force_per_current_N_A, **self.feedback.model_dump())

    def circuit(self) -> Circuit | None:
        """Give the circuit; None if the drive is stated at the tip. In SI, back-EMF per m/s is force per ampere."""
        if self.motor is None:
            return self.model.circuit() if isinstance(self.model, PlantKind) and self.driven_by.unit == "A" else None
        return Circuit(self.motor.R_ohm, self.motor.L_H, self.drive_at_tip().force_per_current_N_A)

    def unfit_model(self) -> str:
        """Which parts of the model file are not fit to design with, and why, in one line; empty if there is none."""
        if not isinstance(self.model, IdentifiedModel):
            return ""
        parts = self.model.unfit(coil=self.motor is not None)
        said = "; ".join(f"{name}: {'; '.join(reasons)}" for name, reasons in parts.items())
        return f"{self.model.file} is not fit to design with: {said}" if said else ""

    def spread_grips_N(self, grip_N: float) -> list[float]:
        """Grips around a node that its command shall serve besides, the node itself not among them."""
        if self.robust is None or self.robust.grip_spread is None:
            return []
        width = self.robust.grip_spread
        factors = [1 - width + 2 * width * j / (self.robust.samples - 1) for j in range(self.robust.samples)]
        return [grip_N * factor for factor in factors if abs(factor - 1) > 1e-9]

    def spread(self, grip_N: float) -> list[tuple[Self, float]]:
        """Further devices that the command of a node shall serve, each as its scene and its grip.

        The scene itself at other grips, what the uncertainty of its model makes of it at the node's own, and the
        device in other hands.
        """
        devices: list[tuple[Self, float]] = [(self, grip) for grip in self.spread_grips_N(grip_N)]
        if self.robust is not None and self.robust.model_uncertainty:
            assert isinstance(self.model, IdentifiedModel)
            drawn = self.model.drawn(self.robust.samples, self.grid.grips_N)
            devices += [(self.model_copy(update={"model": model}), grip_N) for model in drawn]
        if self.robust is not None and self.robust.population is not None:
            hands = self.robust.population.drawn(self.robust.samples, POPULATION_SEED, self.grid.grips_N)
            devices += [(self.in_hand(hand), grip_N) for hand in hands]
        if self.robust is not None and isinstance(self.model, MovingCoil):
            others = [self.model.produced(*factors) for factors in self.robust.produced()]
            devices += [(self.model_copy(update={"model": model}), grip_N) for model in others]
        return devices

    def in_hand(self, hand: HandSection) -> Self:
        """The scene whose device is held by another hand.

        Raises
        ------
        InputError : a model that has no hand of its own.
        """
        model = self.model
        if isinstance(model, Drive | FourthOrder):
            return self.model_copy(update={"model": model.model_copy(update={"hand": hand})})
        if isinstance(model, IdentifiedModel) and isinstance(model.device, DriveDevice):
            device = model.device.model_copy(update={"hand": ChainHand.model_validate(hand.model_dump())})
            return self.model_copy(update={"model": model.model_copy(update={"device": device})})
        raise InputError(
            f"{self.name}: model.kind = {model.kind} has no skin and arm that could be another hand's: take a scene "
            "of kind drive, or identify its device as a drive chain"
        )

    @property
    def _winding(self) -> Motor | Winding | None:
        """How the winding heats, by the motor's datasheet or by that of a whole actuator; None where nobody says."""
        if self.motor is not None:
            return self.motor
        return self.model.known_winding if isinstance(self.model, PlantKind) else None

    def coil(self) -> CoilModel | None:
        """Give the coil; None if the drive is stated at the tip (no motor, no temperature) or takes a voltage."""
        circuit, winding = self.circuit(), self._winding
        if circuit is None or winding is None:
            return None
        identified = self.model.coil if isinstance(self.model, IdentifiedModel) else None
        heat = winding if identified is None else identified
        bridge = self.bridge()
        return CoilModel(
            ripple_A=PWM_RIPPLE_A if bridge is None else bridge.ripple_A,
            R_ohm=circuit.R_ohm * (1.0 if bridge is None else bridge.heat_factor),
            R_wh_K_W=heat.R_wh_K_W,
            R_ha_K_W=heat.R_ha_K_W,
            tau_w_s=heat.tau_w_s,
            tau_h_s=heat.tau_h_s,
            limit_C=winding.winding_max_C,
            **self.thermal.model_dump(exclude={"headroom_K", "tap_rate_Hz", "idle_A"}),
        )
