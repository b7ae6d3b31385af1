"""The scene: everything that defines one library, and the models built from it.

`transopt.scene.sections` checks each table, `transopt.scene.consistent` the tables against each other. The methods of
`Scene` build the objects of the lower layers from the tables: plant, amplifier, coil, wall, time grid, limits.
"""

import math
from dataclasses import replace
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from transopt.base.axes import Axes
from transopt.base.errors import InputError
from transopt.base.section import Name, Section, Words
from transopt.base.shown import cut, wrapped
from transopt.base.sizes import MOST_NODES, MOST_STAGES
from transopt.plant.amplifier import Amplifier
from transopt.plant.arm import Arm
from transopt.plant.bridge import Bridge
from transopt.plant.coil import PWM_RIPPLE_A, Circuit, CoilModel
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
from transopt.plant.time_grid import TimeGrid, samples_after
from transopt.plant.wall import Wall
from transopt.problem.heat import Budget
from transopt.problem.limits.input import SHARES as MOTOR_SHARES
from transopt.problem.objective.error_term import rapid_filter
from transopt.problem.posing import Posing
from transopt.recordings.settings import Recordings
from transopt.references.targets import TargetTable
from transopt.scene import sections
from transopt.scene.consistent import BELOW, POPULATION_SEED, check
from transopt.scene.identified import IdentifiedModel
from transopt.scene.model_parts import ChainHand, DriveDevice


class Scene(Section):
    """One scene file; `name` defaults to the file's stem.

    Attributes
    ----------
    name : name of the scene and of the folder of its results; by default that of the file.
    description : description for reports.
    motor : file or table of a motor: one row of a datasheet.
    amplifier : `ideal`, where the current follows the command without lag, or the table of an amplifier.
    hand_over_samples : number of last commands of a waveform at which the transient is zero.
    implausible : whether implausible numbers are refused or accepted.
    """

    name: Name
    description: Words = ""
    grid: sections.Grid = sections.Grid()
    time: sections.Time = sections.Time()
    recordings: Recordings = Recordings()
    hand: sections.Hand = sections.Hand()
    targets: Annotated[list[TargetTable], Field(max_length=MOST_NODES)] = Field(default_factory=list)
    model: Annotated[Model | IdentifiedModel, Field(discriminator="kind")]
    motor: Motor | None = None
    transmission: Transmission | None = None
    tip: Tip | None = None
    amplifier: sections.AmplifierSection | Literal["ideal"]
    limits: sections.LimitsSection
    thermal: sections.Thermal = sections.Thermal()
    feedback: sections.Feedback | None = None
    weights: sections.Weights = sections.Weights()
    robust: sections.Robust | None = None
    hand_over_samples: Annotated[int, Field(ge=1)] = 10
    striker: sections.Striker | None = None
    implausible: Literal["refuse", "accept"] = "refuse"  # see `transopt.scene.plausible`

    def __repr__(self) -> str:
        time = self.time
        named = ": ".join(filter(None, (cut(self.name), cut(self.description))))
        return wrapped(
            f"Scene({named}; {self.axes.in_words}, {self.stages} commands of {1e3 * time.dt_s:g} ms, limit "
            f"{self.limits.transient_input:g} {self.driven_by.unit})"
        )

    @property
    def axes(self) -> Axes:
        """The axes of its library: speeds and grips, or named targets."""
        names = tuple(target.name for target in self.targets)
        speeds, grips = tuple(self.grid.speeds_m_s) or (0.0,) * len(names), tuple(self.grid.grips_N)
        if not isinstance(self.model, Arm):
            return Axes(speeds, grips, names)
        places = self.model.places
        return Axes(speeds, tuple(grip for grip in grips for _ in places), names, places * len(grips))

    @property
    def driven_by(self) -> Input:
        """The plant's input, a current or a voltage."""
        return self.model.driven_by

    @property
    def shares(self) -> list[float]:
        """Share of the transient limit that each of several motors has; empty for a single motor."""
        return self.model.shares if isinstance(self.model, PlantKind) else []

    @property
    def directions(self) -> int:
        """Number of tracked accelerations."""
        return self.model.directions if isinstance(self.model, PlantKind) else 1

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        check(self)
        return self

    def striking(self) -> Self:
        """The scene whose device strikes the object in simulated recordings: this one, unless it states a striker."""
        if self.striker is None:
            return self
        stated = {"model": self.striker.model, "tip": self.striker.tip, "amplifier": self.striker.amplifier}
        return self.model_copy(update={**stated, "striker": None})

    def free_motion(self, grip_N: float) -> FreeMotion:
        """The motion of the stylus without current in the hand of the recordings, at one grip."""
        struck = self.striking() if self.recordings.simulated is not None else self
        is_held = grip_N > 0 and (isinstance(struck.model, IdentifiedModel) or struck.model.held_by_hand)
        chain = struck.plant(grip_N) if is_held and struck.model.is_chain else None
        return FreeMotion(self.hand.intention(), chain, is_held=is_held)

    def drive_at_tip(self) -> Tip:
        """The drive at the tip: identified, computed from motor and transmission, or stated."""
        identified = self.model.tip() if isinstance(self.model, IdentifiedModel) else None
        if identified is not None:
            return identified
        if self.motor is None or self.transmission is None:
            assert self.tip is not None
            return self.tip
        return at_the_tip(self.motor, self.transmission)

    def plant(self, grip_N: float, place: tuple[float, float] | None = None, *, struck: bool = False) -> StateSpace:
        """The model from the plant's input to the tracked acceleration at one grip.

        With `struck` the input is a force on the stylus [N]: the same device, not driven, tapping a real object.
        `place` is the normal and the posture of an arm, by number from 1; by default the first ones.

        Raises
        ------
        InputError : parameters that are not passive at this grip.
        """
        try:
            if isinstance(self.model, Arm) and place is not None:
                return self.model.plant_at(grip_N, self.model.place(*place))
            return self._chain(grip_N, struck)
        except InputError as error:
            raise InputError(f"{self.name}, grip {grip_N:g} N: {error}") from None

    def _chain(self, grip_N: float, struck: bool) -> StateSpace:
        if isinstance(self.model, IdentifiedModel):
            force = None if self.model.device is not None else self.drive_at_tip().force_per_current_N_A
            return self.model.plant(grip_N, force, struck=struck)
        tip = self.drive_at_tip() if self.model.driven_at_tip else None
        return self.model.plant(grip_N, tip, struck=struck)

    def amplifier_model(self) -> Amplifier | None:
        """The amplifier's model; None for an ideal one."""
        if self.amplifier == "ideal":
            return None
        assert isinstance(self.amplifier, sections.AmplifierSection)
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
        """Whether the scene or its model file states the amplifier's pole, in place of a bridge that implies it."""
        identified = self.model.amplifier if isinstance(self.model, IdentifiedModel) else None
        return identified is not None or (self.amplifier != "ideal" and self.amplifier.pole_Hz is not None)

    def bridge(self) -> Bridge | None:
        """The amplifier's H-bridge; None if its switching frequency is not stated.

        Raises
        ------
        InputError : a motor, rail, frequency or gain outside the range of its model.
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
        """Time by which the waveform precedes contact: as stated, or the least that covers the amplifier's delay."""
        return (
            sections.covering_lead_s(self.time.dt_s, self.delay_s) if self.time.lead_s is None else self.time.lead_s
        )

    @property
    def stages(self) -> int:
        """Number of commands of an entry: as stated, or 80 ms of them, fewer if the next tap comes sooner."""
        dt_s, rate_Hz = self.time.dt_s, self.thermal.tap_rate_Hz
        if self.time.stages is not None:
            return self.time.stages
        stages = min(round(sections.WINDOW_S / dt_s), MOST_STAGES)
        if rate_Hz is not None:
            # A tap takes a servo period and the amplifier's delay longer than its window, and ends before the next.
            stages = min(stages, math.ceil((1 / rate_Hz - self.delay_s) / dt_s * BELOW) - 2)
        return max(stages, self.hand_over_samples + 1, 2)

    def time_grid(self) -> TimeGrid:
        """Servo ticks and switching instants of every entry, and the number of samples in the tail."""
        after = samples_after(self.weights.after_s, self.time.dt_s)
        return TimeGrid(self.time.dt_s, self.stages, self.lead_s, self.delay_s, after)

    @property
    def nonlinear(self) -> bool:
        """Whether the plant has formulas in place of constants."""
        return isinstance(self.model, MovingCoil) and self.model.nonlinear is not None

    @property
    def formulas(self) -> dict[str, str | None] | None:
        """Key -> formula in place of the plant's constant; None for a linear plant."""
        stated = self.model.nonlinear if isinstance(self.model, MovingCoil) else None
        return None if stated is None else stated.model_dump()

    def nonlinear_plant(self) -> NonlinearCoil:
        """The plant with its formulas.

        Raises
        ------
        InputError : a scene without `model.nonlinear`, or a friction that pushes within `limits.stroke_m`.
        """
        plant = self.model.nonlinear_plant() if isinstance(self.model, MovingCoil) else None
        if plant is None:
            raise InputError(f"{self.name}: model.nonlinear: missing; add it to the scene, or use transopt.build")
        plant.check_friction(self.limits.stroke_m or 0.0)
        return plant

    def at_rest(self) -> Self:
        """The scene with the linear plant at rest."""
        if not self.nonlinear:
            return self
        return self.model_copy(update={"model": self.model.model_copy(update={"nonlinear": None})})

    def posing(self) -> Posing:
        """The data that the problems of all its taps share.

        Raises
        ------
        InputError : a nonlinear plant, which no linear problem has.
        """
        if self.nonlinear:
            raise InputError(
                f"{self.name}: model.nonlinear: this needs a linear plant; `transopt solve` and transopt.build "
                "design for a nonlinear one, for all else leave the table out"
            )
        posing = self._posing()
        if not self.shares:
            return posing
        return replace(posing, asked={**posing.asked, MOTOR_SHARES: self.shares}, tangential=self.weights.tangential)

    def check_one_motor(self, what: str) -> None:
        """Refuse what only a device with one motor can have."""
        if self.shares:
            also = ", as does `transopt study --study direction`" if isinstance(self.model, Arm) else ""
            raise InputError(
                f"{what}: model.kind = {self.model.kind} has several motors, and this needs one; `transopt solve`, "
                f"show, verify, compare and export accept it{also}"
            )

    def arm(self) -> Arm:
        """The scene's arm with several motors.

        Raises
        ------
        InputError : a scene of another plant.
        """
        if not isinstance(self.model, Arm):
            raise InputError(
                f"{self.name}: model.kind = {self.model.kind} is no arm: take a scene of an arm, as stylus_3d"
            )
        return self.model

    def _posing(self) -> Posing:
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
        """Requirements on the winding's temperature beyond its limit."""
        thermal = self.thermal
        return Budget(thermal.headroom_K, thermal.tap_rate_Hz, thermal.idle_A)

    def wall(self) -> Wall | None:
        """The virtual wall; None without feedback."""
        if self.feedback is None:
            return None
        return Wall(force_per_current_N_A=self.drive_at_tip().force_per_current_N_A, **self.feedback.model_dump())

    def circuit(self) -> Circuit | None:
        """The circuit of motor or coil; None if the drive is stated at the tip.

        In SI the back-EMF per m/s equals the force per ampere.
        """
        if self.motor is None:
            return self.model.circuit() if isinstance(self.model, PlantKind) else None
        return Circuit(self.motor.R_ohm, self.motor.L_H, self.drive_at_tip().force_per_current_N_A)

    def unfit_model(self) -> str:
        """The parts of the model file that are not fit to design with, and why, in one line; empty if all are fit."""
        if not isinstance(self.model, IdentifiedModel):
            return ""
        parts = self.model.unfit(coil=self.motor is not None)
        shortfalls = "; ".join(f"{name}: {'; '.join(reasons)}" for name, reasons in parts.items())
        return f"{self.model.file} is not fit to design with: {shortfalls}" if shortfalls else ""

    def spread_grips_N(self, grip_N: float) -> list[float]:
        """Further grips around a node that its command shall serve, without the node's own."""
        if self.robust is None or self.robust.grip_spread is None:
            return []
        width = self.robust.grip_spread
        factors = [1 - width + 2 * width * j / (self.robust.samples - 1) for j in range(self.robust.samples)]
        return [grip_N * factor for factor in factors if abs(factor - 1) > 1e-9]

    def spread(self, grip_N: float) -> list[tuple[Self, float]]:
        """Further devices that the command of a node shall serve, each as a scene and a grip.

        They are the scene at other grips; at the node's grip, devices drawn from the uncertainty of its model, the
        device in other hands, and specimens from production.
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
        """The scene with its device held by another hand.

        Raises
        ------
        InputError : a model without a separate hand.
        """
        model = self.model
        if isinstance(model, Drive | FourthOrder):
            return self.model_copy(update={"model": model.model_copy(update={"hand": hand})})
        if isinstance(model, IdentifiedModel) and isinstance(model.device, DriveDevice):
            device = model.device.model_copy(update={"hand": ChainHand.model_validate(hand.model_dump())})
            return self.model_copy(update={"model": model.model_copy(update={"device": device})})
        raise InputError(
            f"{self.name}: model.kind = {model.kind} has no separate hand to replace: take a scene of kind drive, or "
            "identify its device as a drive chain"
        )

    @property
    def winding(self) -> Motor | Winding | None:
        """Thermal data of the winding, from the motor's or the actuator's datasheet; None if neither states them."""
        if self.motor is not None:
            return self.motor
        return self.model.known_winding if isinstance(self.model, PlantKind) else None

    def coil(self) -> CoilModel | None:
        """The coil's thermal model; None without thermal data of a winding, or for a voltage-driven plant."""
        circuit, winding = self.circuit(), self.winding
        if circuit is None or winding is None or self.driven_by.unit == "V":
            return None
        identified = self.model.coil if isinstance(self.model, IdentifiedModel) else None
        heat = winding if identified is None else identified
        # A thermal resistance means something with the resistance that it was found for.
        R_ohm = (None if identified is None else identified.R_ohm) or circuit.R_ohm
        bridge = self.bridge()
        return CoilModel(
            ripple_A=PWM_RIPPLE_A if bridge is None else bridge.ripple_A,
            R_ohm=R_ohm * (1.0 if bridge is None else bridge.heat_factor),
            R_wh_K_W=heat.R_wh_K_W,
            R_ha_K_W=heat.R_ha_K_W,
            tau_w_s=heat.tau_w_s,
            tau_h_s=heat.tau_h_s,
            limit_C=winding.winding_max_C,
            **self.thermal.model_dump(exclude={"headroom_K", "tap_rate_Hz", "idle_A"}),
        )
