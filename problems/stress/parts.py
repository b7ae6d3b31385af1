"""The parts of a stress case: device, current, horizon, demand, coil, surface and spread."""

from dataclasses import dataclass

import numpy as np

from problems.stress.hands import HandMotion
from transopt.base.signals import FloatArray
from transopt.plant.chain import Link, chain
from transopt.plant.coil import CoilModel
from transopt.plant.drive import drive
from transopt.plant.hand import HandSection, LinearParameter
from transopt.plant.intention import INTENTION_S, Yielding
from transopt.plant.second_order import second_order
from transopt.plant.state_space import StateSpace
from transopt.plant.time_grid import TimeGrid
from transopt.problem.objective.error_term import ErrorTerm, rapid, rapid_filter
from transopt.problem.objective.target import Target

PEAK_PER_SPEED_1_S = 280.0  # of a tap on wood: 28 m/s^2 at 0.1 m/s
RING_HZ, RING_DECAY_S = 390.0, 4e-3
R_OHM = 2.18
HAND = HandSection(
    mass_kg=LinearParameter(constant=0.01, per_newton=0.0),
    skin_stiffness_N_m=LinearParameter(constant=3000.0, per_newton=2000.0),
    skin_damping_N_s_m=LinearParameter(constant=6.0, per_newton=3.0),
    arm_stiffness_N_m=LinearParameter(constant=160.0, per_newton=110.0),
    arm_damping_N_s_m=LinearParameter(constant=6.0, per_newton=3.0),
)


@dataclass(frozen=True)
class DrawnDevice:
    """The device of a case: motor mass, transmission and stylus in a hand.

    Attributes
    ----------
    kind : "drive", "second_order", or "defective": a stylus on a link so damped that both poles are one.
    grip_N : grip force; 0 for a free stylus.
    moving_kg : mass of the motor at the tip.
    stylus_kg : mass of the stylus.
    mode_Hz, damping_ratio : mode of motor and stylus on the transmission.
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
        """The model from current to stylus acceleration, with its states in the stated units.

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
    limit_A : limit on the current.
    command : range of the command over that limit.
    pole_Hz : pole of the amplifier; None is ideal.
    delay_samples : delay of the amplifier in servo periods.
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
    after : number of instants in the tail.
    lost : whether lost samples, before any command acts, count.
    """

    dt_s: float = 1e-4
    stages: int = 100
    lead_s: float = 3e-4
    hand_over: int = 10
    after: int = 0
    lost: bool = False


@dataclass(frozen=True)
class Demand:
    """The demand of a case: reference and weights.

    Attributes
    ----------
    kind : kind of reference: "tap", "constant", "denormal", "noise", "sample", "huge", "overflow", "nan" or "empty".
    speed_m_s : incoming speed; 0 gives a target of zero.
    weights : weights of the plain error: "one", "late", "sparse", "none" or "tiny"; "intention" for 0.09 during the
        hand's intention; "untrusted" for no plain term, as for a recording with an unreliable slow part.
    rho : weight of the command's movement.
    rapid : "none", or the filter of the second term of the error, "highpass" or "pacinian".
    rapid_from_Hz : corner of the high-pass.
    heat_price : price of the squared current, in units of the limit.
    seed : seed of the noise in the reference.
    price : price of intensity, lam over its largest value for these weights.
    asked_dB : required intensity, which is searched for; None for none.
    yields : law of yielding of the hand after its intention.
    intention_s : duration of the intention after contact.
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
        """The target in the window of a grid, in the tail and, if they count, in the lost samples, minus a_free."""
        before = grid.before_times_s if lost else np.zeros(0)
        times = (grid.switching_times_s, grid.after_times_s, before)
        recorded = [self._reference(each, self.seed + j) for j, each in enumerate(times)]
        if self.yields == "straight":
            return Target(*recorded)
        free = [hand.free_m_s2(each[: r.size]) for each, r in zip(times, recorded, strict=True)]
        return Target(*(r - a for r, a in zip(recorded, free, strict=True)), *free)

    def _reference(self, times_s: FloatArray, seed: int) -> FloatArray:
        """(K,) reference [m/s^2] at some instants; some kinds are wrong input that constructors have to refuse."""
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
        """The error terms; if the plain one is alone, it counts in the tail too."""
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
    """The coil of a case, stated by its distance from the temperature limit.

    Attributes
    ----------
    tau_w_s, tau_h_s : time constants of winding and housing.
    below_K : limit minus start temperature; negative for a start above the limit.
    warming : rise of the winding under the limit current over the horizon, divided by `below_K` (at least 1 mK).
    nodes : 1 (winding) or 2 (winding and housing).
    tap_share : duration of a tap over the time between repeated taps; None for a single tap.
    """

    tau_w_s: float = 12.0
    tau_h_s: float = 612.0
    below_K: float = 0.05
    warming: float = 2.0
    nodes: int = 2
    tap_share: float | None = None

    def model(self, limit_A: float, duration_s: float) -> CoilModel:
        """The coil's model for a limit on the current and the duration of the horizon.

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
    """Further devices that the command of a case serves: the case's device with two numbers varied.

    Attributes
    ----------
    count : number of devices.
    width : largest relative deviation of the mode, or of the resonance.
    held : largest relative deviation of the grip, or of the quality.
    worst : whether the worst device counts, not the mean.
    """

    count: int = 2
    width: float = 0.1
    held: float = 0.2
    worst: bool = False

    def factors(self) -> list[tuple[float, float]]:
        """Factors on the first and on the second number, for each device."""
        shares = np.linspace(-1, 1, self.count) if self.count > 1 else np.ones(1)
        return [(float(1 + self.width * x), float(1 - self.held * x)) for x in shares]
