"""Cases of the stress suite: an entry's problem, described by a few numbers far from everyday ones.

A case is data and knows how to build itself with the library's own constructors, so that what a constructor refuses
is refused here as it is for a user. Directed families are in `problems.stress.families`, random draws in
`problems.stress.draw`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from problems.stress.actuators import Actuator
from problems.stress.hands import HandMotion
from transopt.base.signals import FloatArray
from transopt.design.context import Posed
from transopt.design.intensity import most_price
from transopt.plant.amplifier import Amplifier
from transopt.plant.chain import Link, chain
from transopt.plant.circuit import Circuit
from transopt.plant.coil import CoilModel
from transopt.plant.discretise import TimeGrid, discretise
from transopt.plant.drive import drive
from transopt.plant.hand import Hand, LinearInGrip
from transopt.plant.intention import INTENTION_S, Intention, Yielding
from transopt.plant.second_order import second_order
from transopt.plant.state_space import CURRENT_INPUT, Input, StateSpace
from transopt.plant.wall import HandOver, Wall
from transopt.problem.heat import Budget
from transopt.problem.limits import needed_outputs, posed
from transopt.problem.limits.limit import Setting
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.rapid import rapid, rapid_filter
from transopt.problem.objective.target import Target
from transopt.problem.problem import TransientProblem

PEAK_PER_SPEED_1_S = 280.0  # of a tap on wood: 28 m/s^2 at 0.1 m/s
RING_HZ, RING_DECAY_S = 390.0, 4e-3
R_OHM = 2.18
HAND = Hand(
    mass_kg=LinearInGrip(0.01, 0.0),
    skin_stiffness_N_m=LinearInGrip(3000.0, 2000.0),
    skin_damping_N_s_m=LinearInGrip(6.0, 3.0),
    arm_stiffness_N_m=LinearInGrip(160.0, 110.0),
    arm_damping_N_s_m=LinearInGrip(6.0, 3.0),
)


@dataclass(frozen=True)
class DrawnDevice:
    """The device of a case: motor mass, transmission and stylus in a hand.

    Attributes
    ----------
    kind : "drive", "second_order", or "defective": a stylus on a link so damped that both poles are one.
    grip_N : 0 is free.
    moving_kg : mass of the motor at the tip.
    stylus_kg : mass of the stylus.
    mode_Hz, damping_ratio : of motor and stylus on the transmission.
    force_N_A : force per ampere.
    units : the states are stated in units of 1, u, u^2, 1, u, ... of SI.
    """

    kind: str = "drive"
    grip_N: float = 3.0
    moving_kg: float = 14e-3
    stylus_kg: float = 26e-3
    mode_Hz: float = 400.0
    damping_ratio: float = 0.17
    force_N_A: float = 1.25
    units: float = 1.0

    def plant(self) -> StateSpace:
        """From current to stylus acceleration, its states in the stated units.

        Raises
        ------
        InputError : parameters that are not passive.
        """
        made = self._in_si()
        scale = self.units ** (np.arange(made.order) % 3)
        return StateSpace.from_matrices(
            A=made.A * scale / scale[:, None],
            B=made.B / scale[:, None],
            C=made.C * scale,
            D=made.D,
            Ce=made.Ce * scale,
        )

    def _in_si(self) -> StateSpace:
        rate = 2 * np.pi * self.mode_Hz
        if self.kind == "second_order":
            return second_order(self.grip_N, force_per_current_N_A=self.force_N_A)
        if self.kind == "defective":
            link = Link(self.stylus_kg * rate**2, 2 * self.stylus_kg * rate)
            return chain([self.stylus_kg], [link], force_per_current_N_A=self.force_N_A, stylus=0)
        reduced = self.moving_kg * self.stylus_kg / (self.moving_kg + self.stylus_kg)
        return drive(
            self.grip_N,
            hand=HAND,
            stylus_mass_kg=self.stylus_kg,
            moving_mass_kg=self.moving_kg,
            transmission=Link(reduced * rate**2, 2 * self.damping_ratio * reduced * rate),
            force_per_current_N_A=self.force_N_A,
        )


@dataclass(frozen=True)
class Current:
    """The amplifier of a case, and the limits on current, command, slew and supply.

    Attributes
    ----------
    limit_A : of the current.
    command : range of the command over that limit.
    pole_Hz : of the amplifier; None is ideal.
    delay_samples : of the amplifier, in servo periods.
    slew : limit on the change of the command per tick, over the limit on the current; None for none.
    supply : limit on the voltage over R times the limit on the current; None for none.
    """

    limit_A: float = 4.0
    command: float = 1.5
    pole_Hz: float | None = 1050.0
    delay_samples: float = 0.68
    slew: float | None = None
    supply: float | None = None


@dataclass(frozen=True)
class Horizon:
    """The time grid of a case: servo period, number of commands, lead before contact, hand-over samples, tail.

    Attributes
    ----------
    after : instants after the window that count.
    lost : whether what comes before the first instant that a command can reach counts.
    """

    dt_s: float = 1e-4
    stages: int = 100
    lead_s: float = 3e-4
    hand_over: int = 10
    after: int = 0
    lost: bool = False


@dataclass(frozen=True)
class Demand:
    """What a case asks of its device: reference, weights, movement.

    Attributes
    ----------
    kind : of the reference: "tap", "constant", "denormal", "noise", "sample", "huge", "overflow", "nan" or "empty".
    speed_m_s : incoming; 0 asks for nothing.
    weights : of the plain error: "one", "late", "sparse", "none" or "tiny"; of a hand, "intention": 0.09 over that.
        Of a recording that is not trusted in its slow part, "untrusted": there is no plain term.
    rho : weight of the command's movement.
    rapid : "none", or the filter of the second term of the error, "highpass" or "pacinian".
    rapid_from_Hz : corner of the high-pass.
    heat_price : of the squared current, for a current of one limit.
    seed : of the noise in the reference.
    price : of intensity, lam over the largest that the weights leave.
    asked_dB : intensity that is searched for; None for none.
    yields : what the hand does when its intention is over. intention_s : how long that is after contact.
    """

    kind: str = "tap"
    speed_m_s: float = 0.4
    weights: str = "one"
    rho: float = 1e-3
    rapid: str = "none"
    rapid_from_Hz: float = 20.0
    heat_price: float = 0.0
    seed: int = 0
    price: float = 0.0
    asked_dB: float | None = None
    yields: Yielding = "straight"
    intention_s: float = INTENTION_S

    def target(self, grid: TimeGrid, hand: HandMotion, *, lost: bool) -> Target:
        """Within the window of a grid, after it and, if that counts, before it: less what the hand does by itself."""
        before = grid.before_times_s if lost else np.zeros(0)
        times = (grid.switching_times_s, grid.after_times_s, before)
        recorded = [self._reference(each, self.seed + j) for j, each in enumerate(times)]
        if self.yields == "straight":
            return Target(*recorded)
        free = [hand.free_m_s2(each[: r.size]) for each, r in zip(times, recorded, strict=True)]
        return Target(*(r - a for r, a in zip(recorded, free, strict=True)), *free)

    def _reference(self, times_s: FloatArray, seed: int) -> FloatArray:
        """(K,) [m/s^2] at some instants, with the kinds of wrong input that the constructors have to refuse."""
        N, t = times_s.size, np.maximum(times_s, 0.0)
        peak = PEAK_PER_SPEED_1_S * self.speed_m_s
        ringing = 0.3 * np.exp(-t / RING_DECAY_S) * np.sin(2 * np.pi * RING_HZ * t)
        tap = peak * (np.where(t < 4e-3, np.sin(np.pi * t / 4e-3), 0.0) + ringing)
        white = np.random.default_rng(seed).standard_normal(N)
        made: dict[str, FloatArray] = {
            "tap": tap,
            "constant": np.full(N, peak),
            "denormal": np.full(N, 5e-324),
            "noise": peak * white,
            "sample": np.where(np.arange(N) == N // 2, peak, 0.0),
            "huge": 1e6 * peak * white,
            "overflow": 1e200 * white,
            "nan": np.where(np.arange(N) == N // 2, np.nan, tap),
            "empty": np.zeros(0),
        }
        return made[self.kind]

    def terms(self, grid: TimeGrid) -> tuple[ErrorTerm, ...]:
        """The terms of the error; the plain one counts after the window where it is alone."""
        k, filtered = np.arange(grid.stages), rapid_filter(self.rapid, self.rapid_from_Hz, grid.dt_s)
        made: dict[str, FloatArray] = {
            "one": np.ones(grid.stages),
            "intention": np.where(grid.switching_times_s < self.intention_s, 0.09, 0.0),
            "late": np.where(k < grid.stages // 2, 0.0, 1.0),
            "sparse": np.where(k % 7 == 3, 1.0, 0.0),
            "none": np.zeros(grid.stages),
            "tiny": np.where(k % 2 == 0, 1e-10, 1.0),
        }
        if filtered is None:
            return (ErrorTerm("plain", made[self.weights]),)
        if self.weights == "untrusted":
            return (rapid(filtered, grid),)
        return ErrorTerm("plain", made[self.weights], after=0.0), rapid(filtered, grid)


@dataclass(frozen=True)
class Coil:
    """The coil of a case, by how near its temperature limit is.

    Attributes
    ----------
    tau_w_s, tau_h_s : time constants of winding and housing.
    below_K : how far the start lies below the limit, negative above it.
    warming : what the limit current held for the horizon would add to the winding, over `below_K` (at least 1 mK).
    nodes : 1 (winding) or 2 (winding and housing).
    tap_share : of the time that taps take when they repeat for ever; None for a single tap.
    """

    tau_w_s: float = 12.0
    tau_h_s: float = 612.0
    below_K: float = 0.05
    warming: float = 2.0
    nodes: int = 2
    tap_share: float | None = None

    def model(self, limit_A: float, duration_s: float) -> CoilModel:
        """For a limit on the current and the length of the horizon.

        Raises
        ------
        InputError : values that no coil can have.
        """
        # The resistance that gives the wanted warming: rise = R i^2 R_wh (1 - exp(-t / tau)).
        share = -np.expm1(-duration_s / self.tau_w_s)
        R_wh = self.warming * max(abs(self.below_K), 1e-3) / (R_OHM * (limit_A + 0.02) ** 2 * share)
        limit_C = 100.0
        start = limit_C - self.below_K
        return CoilModel(
            R_ohm=R_OHM,
            R_wh_K_W=R_wh,
            R_ha_K_W=4.5 * R_wh,
            tau_w_s=self.tau_w_s,
            tau_h_s=self.tau_h_s,
            limit_C=limit_C,
            ambient_C=25.0,
            start_winding_C=start,
            start_housing_C=min(60.0, start),
            nodes=self.nodes,
        )


@dataclass(frozen=True)
class Surface:
    """A virtual wall under the stylus."""

    stiffness_N_m: float = 200.0
    damping_N_s_m: float = 5.0
    latency_ticks: int = 1
    filter_Hz: float = 500.0


@dataclass(frozen=True)
class Spread:
    """Further devices that the one command of a case shall serve: the case's own with two of its numbers varied.

    Attributes
    ----------
    count : how many.
    width : the mode, or the resonance, lies up to this share beside the own.
    held : so does the grip, or the quality.
    worst : whether the worst of them counts and not their mean.
    """

    count: int = 2
    width: float = 0.1
    held: float = 0.2
    worst: bool = False

    def factors(self) -> list[tuple[float, float]]:
        """On the first and on the second number, for each device."""
        shares = np.linspace(-1, 1, self.count) if self.count > 1 else np.ones(1)
        return [(float(1 + self.width * x), float(1 - self.held * x)) for x in shares]


@dataclass(frozen=True)
class StressCase:
    """One problem of the stress suite.

    Attributes
    ----------
    family : what it is a case of.
    device : that is driven.
    current : amplifier and limits.
    horizon : time grid.
    demand : what is asked of the device.
    coil : whose temperature is limited; None for no such limit.
    surface : virtual wall; None for none.
    actuator : in the place of the device, with limits of its own; None for a stylus on a motor. What the case says of
        currents is then said of its input, a current or a voltage.
    spread : further devices to serve; None for the one.
    """

    family: str
    device: DrawnDevice = field(default_factory=DrawnDevice)
    current: Current = field(default_factory=Current)
    horizon: Horizon = field(default_factory=Horizon)
    demand: Demand = field(default_factory=Demand)
    coil: Coil | None = None
    surface: Surface | None = None
    actuator: Actuator | None = None
    spread: Spread | None = None

    def __str__(self) -> str:
        """In one line what differs from the plain case."""
        plain = StressCase(self.family)
        words = []
        for name in ("device", "current", "horizon", "demand", "coil", "surface", "actuator", "spread"):
            own = getattr(self, name)
            if own is None:
                continue
            usual = getattr(plain, name) or type(own)()
            changed = [f.name for f in fields(own) if getattr(own, f.name) != getattr(usual, f.name)]
            said = " ".join(f"{key}={_short(getattr(own, key))}" for key in changed)
            if said or getattr(plain, name) is None:
                words.append(f"{name}({said})")
        return f"{self.family}: {' '.join(words) or 'plain'}"

    @property
    def objective(self) -> str:
        """Objective as a scene would state it."""
        return "waveform" if self.demand.asked_dB is None else "intensity"

    def grid(self) -> TimeGrid:
        """Time grid of the case; an InputError as `problem` raises it."""
        horizon = self.horizon
        delay = 0.0 if self.current.pole_Hz is None else self.current.delay_samples * horizon.dt_s
        return TimeGrid(horizon.dt_s, horizon.stages, horizon.lead_s, delay, horizon.after)

    @property
    def driven_by(self) -> Input:
        """What commands are."""
        return CURRENT_INPUT if self.actuator is None else self.actuator.driven_by

    def _numbers(self) -> dict[str, Any]:
        """Dotted key, as a scene would have it, -> number that the case states."""
        current, horizon, driven = self.current, self.horizon, self.driven_by
        largest, supply = current.limit_A, current.supply
        numbers: dict[str, Any] = {
            "time.dt_s": horizon.dt_s,
            "time.stages": horizon.stages,
            "weights.rho": self.demand.rho,
            f"limits.{driven.name}_{driven.unit}": largest,
            f"limits.slew_{driven.unit}_per_s": None
            if current.slew is None
            else current.slew * largest / horizon.dt_s,
        }
        if self.actuator is None:
            numbers["limits.supply_V"] = None if supply is None else supply * R_OHM * largest
        else:
            own = self.actuator.limits(largest, horizon.dt_s * horizon.stages)
            numbers |= {f"limits.{key}": number for key, number in own.items()}
        if current.pole_Hz is not None:
            numbers[f"amplifier.command_limit_{driven.unit}"] = current.command * largest
        if self.surface is not None:
            numbers |= {
                "feedback.stiffness_N_m": self.surface.stiffness_N_m,
                "feedback.damping_N_s_m": self.surface.damping_N_s_m,
                "feedback.latency_ticks": self.surface.latency_ticks,
            }
        if self.coil is not None:
            coil, share = self.coil.model(current.limit_A, horizon.dt_s * horizon.stages), self.coil.tap_share
            numbers |= {
                "thermal.start_winding_C": coil.start_winding_C,
                "thermal.start_housing_C": coil.start_housing_C,
                "thermal.ambient_C": coil.ambient_C,
                "motor.R_wh_K_W": coil.R_wh_K_W,
                "motor.R_ha_K_W": coil.R_ha_K_W,
                "thermal.tap_rate_Hz": None if share is None else share / (horizon.stages * horizon.dt_s),
            }
        return numbers

    def value(self, key: str) -> float | None:
        """What the case states for a dotted key of a scene; None where it states nothing."""
        number: float | None = self._numbers().get(key)
        return number

    def posed(self, changes: Mapping[str, float | None] | None = None) -> Posed:
        """The problem as `transopt.design.design` takes it; parameters and errors as of `problem`."""
        problem = self.problem(changes)
        thermal = problem.thermal
        return Posed(problem, objective=self.objective, coil=None if thermal is None else thermal.coil)

    def problem(self, changes: Mapping[str, float | None] | None = None) -> TransientProblem:
        """The optimal-control problem of the case.

        Parameters
        ----------
        changes : dotted key, as a scene would have it, -> another number; None takes out what stands there. The
            rest stays as it is, in SI and not in units of what is changed; "feedback" stands for the whole wall.

        Raises
        ------
        InputError : a constructor refuses it.
        """
        grid = self.grid()
        numbers = self._numbers() | dict(changes or {})
        grid = replace(grid, dt_s=numbers["time.dt_s"], stages=int(numbers["time.stages"]))
        driven, of = self.driven_by, self.actuator
        speed, force_N_A = (self.demand.speed_m_s if of is None else 0.0), self.device.force_N_A
        amplifier = None
        if self.current.pole_Hz is not None:
            largest = numbers[f"amplifier.command_limit_{driven.unit}"]
            amplifier = Amplifier(self.current.pole_Hz, grid.delay_s, largest)
        plant = self.device.plant() if of is None else of.plant()
        asked = {key.removeprefix("limits."): number for key, number in numbers.items() if key.startswith("limits.")}
        hand = HandMotion(Intention(self.demand.intention_s, self.demand.yields), speed, grid)
        target = self.demand.target(grid, hand, lost=self.horizon.lost)
        wall = None
        if self.surface is not None and numbers.get("feedback", True) is not None:
            law = Wall(
                numbers["feedback.stiffness_N_m"],
                numbers["feedback.damping_N_s_m"],
                force_N_A,
                int(numbers["feedback.latency_ticks"]),
                self.surface.filter_Hz,
            )
            nominal = hand.position_m(grid.all_issue_times_s)
            wall = HandOver(law, nominal, speed, nominal < 0)
        coil = None
        if self.coil is not None:
            made = self.coil.model(self.current.limit_A, self.horizon.dt_s * self.horizon.stages)
            stated = {key.rsplit(".", 1)[-1]: number for key, number in numbers.items()}
            coil = replace(made, **{f.name: stated[f.name] for f in fields(made) if f.name in stated})
        circuit = Circuit(R_OHM, L_H=0.238e-3, emf_V_s_m=force_N_A)
        outputs = needed_outputs(asked, driven)
        stage = discretise(plant, amplifier, grid.dt_s, position=wall is not None, outputs=outputs)
        others = () if self.spread is None else tuple(self._others(self.spread))
        spread = tuple(discretise(each, amplifier, grid.dt_s, outputs=outputs) for each in others)
        setting = Setting(
            stage=stage,
            grid=grid,
            circuit=circuit,
            coil=coil,
            budget=Budget(tap_rate_Hz=numbers.get("thermal.tap_rate_Hz")),
            wall=wall,
            reference_m_s2=target.window_m_s2,
            nominal_m=hand.position_m(grid.switching_times_s),
            nominal_m_s=hand.velocity_m_s(grid.switching_times_s),
            spread=spread,
        )
        key = f"{driven.name}_{driven.unit}"
        plain = TransientProblem(
            stage=stage,
            grid=grid,
            target=target,
            terms=self.demand.terms(grid),
            rho=numbers["weights.rho"],
            limits=posed({key: asked[key]}, replace(setting, coil=None)),
            hand_over_samples=self.horizon.hand_over,
            wall=wall,
            heat_price=self.demand.heat_price / asked[key] ** 2,
        )
        # A reference that is refused is named before the limits that it cannot be held to.
        whole = replace(plain, limits=posed(asked, setting))
        if self.spread is not None:
            whole = replace(whole, spread=spread, worst=self.spread.worst)
        return replace(
            whole, intensity=self.demand.price * most_price(whole), intensity_dB=self.demand.asked_dB or 0.0
        )

    def _others(self, spread: Spread) -> list[StateSpace]:
        """The plants of the spread."""
        own, device = self.actuator, self.device
        if own is not None:
            return [
                replace(own, resonance_Hz=f * own.resonance_Hz, quality=g * own.quality).plant()
                for f, g in spread.factors()
            ]
        return [
            replace(device, mode_Hz=f * device.mode_Hz, grip_N=g * device.grip_N).plant() for f, g in spread.factors()
        ]


def _short(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
