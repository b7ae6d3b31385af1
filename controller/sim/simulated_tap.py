"""One tap of a simulated hand: its specification, and the simulator that executes it.

The world behind the port `sim:` consists of these taps (`controller.sim.tapping`); `controller.sim.played_tap` plays
one without the protocol in between and compares it with the truth.
"""

from dataclasses import dataclass, replace

import numpy as np

from controller.record.metrics import rate_hardness_N_m
from controller.sim.simulator import NONE, Imperfections, Simulator
from controller.sim.true_device import TrueDevice
from controller.sim.user import TapUser, Tremor, User
from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.plant.intention import Yielding
from transopt.recordings.settings import SimulatedTaps

APPROACH_S, APPROACH_M = 60e-3, 5e-3  # least duration and length of the straight approach
AFTER_S = 20e-3  # time simulated after the window
STEPS_AT_CONTACT = 8  # integration steps per segment while a real object is struck


@dataclass(frozen=True)
class SimulatedTap:
    """Specification of one tap by a user.

    Attributes
    ----------
    gain : gain of the servo, for the prediction.
    yields : the hand's behaviour after its intention; None for that of the recordings.
    incoming_m_s2 : acceleration of the hand during the approach.
    phase : phase of the contact within a servo period, 0 to 1; None draws it from the seed.
    """

    speed_m_s: float
    grip_N: float
    gain: float = 1.0
    yields: Yielding | None = None
    incoming_m_s2: float = 0.0
    seed: int = 0
    imperfections: Imperfections = NONE
    tremor: Tremor | None = None
    grip_rate_N_s: float = 0.0
    phase: float | None = None


@dataclass(frozen=True)
class Struck:
    """A real object struck by the undriven device; times from contact, (K,) each."""

    times_s: FloatArray
    acceleration_m_s2: FloatArray
    motor_m: FloatArray
    contact_N: FloatArray
    rate_hardness_N_m: float


def approach_ticks(speed_m_s: float, dt_s: float) -> int:
    """Whole servo periods of straight approach before a contact."""
    return int(np.ceil(max(APPROACH_S, APPROACH_M / speed_m_s) / dt_s))


def strike_real(
    device: TrueDevice,
    target: SimulatedTaps,
    speed_m_s: float,
    grip_N: float,
    duration_s: float,
    dt_s: float,
) -> Struck:
    """Let the undriven stylus strike a real object at z = 0 (seed Fig. 1)."""
    approach = 100
    simulator = Simulator(
        device,
        TapUser(speed_m_s, grip_N, approach * dt_s),
        dt_s,
        target=target,
        steps=STEPS_AT_CONTACT,
        trace=True,
    )
    for _ in range(approach + int(np.ceil(duration_s / dt_s))):
        simulator.advance(0.0)
    trace = simulator.trace()
    times = trace.times_s - approach * dt_s
    hardness = rate_hardness_N_m(times, trace.contact_N, speed_m_s)
    return Struck(times, trace.acceleration_m_s2, trace.motor_m, trace.contact_N, hardness)


def _user(library: Library, tap: SimulatedTap, contact_s: float) -> User:
    intention = library.scene().hand.intention()
    if tap.yields is not None:
        intention = replace(intention, yields=tap.yields)
    return TapUser(tap.speed_m_s, tap.grip_N, contact_s, intention, tap.tremor, tap.grip_rate_N_s, tap.incoming_m_s2)


def _contact_s(tap: SimulatedTap, dt_s: float) -> float:
    """Instant at which the hand's intention reaches the surface [s]."""
    phase = float(np.random.default_rng([tap.seed, 5]).uniform()) if tap.phase is None else tap.phase
    return (approach_ticks(tap.speed_m_s, dt_s) + phase) * dt_s


def tap_simulator(
    library: Library, tap: SimulatedTap, device: TrueDevice, *, trace: bool = False
) -> tuple[Simulator, float]:
    """A simulator of a user approaching the surface, and the instant at which the intention reaches it [s].

    Parameters
    ----------
    device : the true device without the tap's imperfections.
    trace : whether to keep the truth at every step.
    """
    dt = library.time_grid().dt_s
    expected = _contact_s(tap, dt)
    user = _user(library, tap, expected)
    simulator = Simulator(device, user, dt, imperfections=tap.imperfections, seed=tap.seed, trace=trace)
    return simulator, expected


def object_simulator(target: SimulatedTaps, device: TrueDevice, tap: SimulatedTap, dt_s: float) -> Simulator:
    """A simulator of a hand approaching a real object at the surface; the hand goes straight on."""
    user = TapUser(tap.speed_m_s, tap.grip_N, _contact_s(tap, dt_s))
    wrong, steps = tap.imperfections, STEPS_AT_CONTACT
    return Simulator(device, user, dt_s, imperfections=wrong, seed=tap.seed, target=target, steps=steps)
