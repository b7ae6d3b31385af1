"""Simulated tapping trials: hands of known mechanics tap a real surface with a stylus (seed Section 3).

`python -m problems.generators.tapping_trials FOLDER` writes the 81 trials of one session as the files that
`transopt identify hand` reads; with `--hand fourth_order` the true hand is that of the seed's Fig. 4b, otherwise that
of its Eqs. 3-5. The files contain surface force, stylus acceleration, position and grip, as their sensors measure
them.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy  # its modules load where they are used: most import this one for its constants

import problems
from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray
from transopt.plant.chain import Link, chain
from transopt.plant.hand import HandSection, LinearInGrip, LinearParameter
from transopt.plant.second_order import SEED_HAND_DAMPING_N_S_M, SEED_HAND_MASS_KG, SEED_HAND_STIFFNESS_N_M
from transopt.plant.state_space import StateSpace
from transopt.recordings.settings import SimulatedTaps
from transopt.scene.strikes import APPROACH_S, ENCODER_COUNT_M, contact_force

STEP_S = 2e-5
AFTER_S = 45e-3  # recorded time after contact
RATE_HZ = 10e3
GRIPS_N = np.linspace(1.0, 10.0, 9)
SPEEDS_M_S = np.linspace(0.1, 0.4, 9)
JITTER = 0.05  # relative deviation of actual speeds and grips from the requested ones
HANDS = ("second_order", "fourth_order")

# A stylus of 40 g, the hand's mass behind the skin: the seed's Fig. 4b, as a whole about as heavy as Eqs. 3-5.
FOURTH_ORDER_STYLUS_KG = 0.040
FOURTH_ORDER_HAND = HandSection(
    mass_kg=LinearParameter(constant=0.175, per_newton=-0.00328),
    skin_stiffness_N_m=LinearParameter(constant=3000.0, per_newton=2000.0),
    skin_damping_N_s_m=LinearParameter(constant=6.0, per_newton=3.0),
    arm_stiffness_N_m=LinearParameter(**vars(SEED_HAND_STIFFNESS_N_M)),
    arm_damping_N_s_m=LinearParameter(**vars(SEED_HAND_DAMPING_N_S_M)),
)


@dataclass(frozen=True)
class Spread:
    """Relative standard deviations of a hand's parameters from trial to trial, drawn independently."""

    mass: float = 0.05
    damping: float = 0.10
    stiffness: float = 0.10


@dataclass(frozen=True)
class Sensors:
    """The sensors that record a trial.

    Attributes
    ----------
    accelerometer_Hz : pole of the accelerometer.
    noise_g_rtHz : one-sided noise density of the accelerometer (ADXL321).
    range_g : range at which it clips.
    offset_g : static offset.
    force_N : rms noise of the force plate, white up to half the rate.
    grip_relative, grip_N : rms error of the stated grip, drawn once per trial: a share of it, and a constant.
    """

    accelerometer_Hz: float = 2500.0
    noise_g_rtHz: float = 320e-6
    range_g: float = 18.0
    offset_g: float = 1.0
    force_N: float = 0.05
    grip_relative: float = 0.02
    grip_N: float = 0.05


@dataclass(frozen=True)
class Trials:
    """T recorded taps on one time grid, contact shortly after t = 0.

    Attributes
    ----------
    times_s : (n,).
    force_N, acceleration_m_s2, position_m : (T, n).
    grip_N, speed_m_s : (T,) as stated by the session, which differ from the true ones.
    accelerometer_Hz : pole of the accelerometer, the same for all trials.
    """

    times_s: FloatArray
    force_N: FloatArray
    acceleration_m_s2: FloatArray
    position_m: FloatArray
    grip_N: FloatArray
    speed_m_s: FloatArray
    accelerometer_Hz: float


def rk4_step(rate: Callable[[FloatArray], FloatArray], state: FloatArray, h_s: float) -> FloatArray:
    """The state after one step of the classical Runge-Kutta method of fourth order."""
    k1 = rate(state)
    k2 = rate(state + h_s / 2 * k1)
    k3 = rate(state + h_s / 2 * k2)
    k4 = rate(state + h_s * k3)
    return state + h_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def surface() -> SimulatedTaps:
    """The object that is tapped: wood on foam, that of the default scene."""
    target = problems.load("wood_on_foam").recordings.simulated
    assert target is not None
    return target


def session(random: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """True grips [N] and speeds [m/s] of 81 taps, (81,) each: every grip with every speed, with random deviations."""
    grips, speeds = (axis.ravel() for axis in np.meshgrid(GRIPS_N, SPEEDS_M_S, indexing="ij"))
    return (
        grips * (1 + JITTER * random.uniform(-1, 1, grips.size)),
        speeds * (1 + JITTER * random.uniform(-1, 1, speeds.size)),
    )


def second_order_hands(grips_N: FloatArray, random: np.random.Generator, spread: Spread) -> list[StateSpace]:
    """One hand per tap, from force on the stylus to its acceleration: seed Eqs. 3-5, scattered."""
    m = _scattered(SEED_HAND_MASS_KG, grips_N, random, spread.mass)
    b = _scattered(SEED_HAND_DAMPING_N_S_M, grips_N, random, spread.damping)
    k = _scattered(SEED_HAND_STIFFNESS_N_M, grips_N, random, spread.stiffness)
    return [
        chain([mass], [Link(stiffness, damping)], force_per_current_N_A=1.0, stylus=0)
        for mass, damping, stiffness in zip(m, b, k, strict=True)
    ]


def fourth_order_hands(grips_N: FloatArray, random: np.random.Generator, spread: Spread) -> list[StateSpace]:
    """One hand per tap by the seed's Fig. 4b: skin, hand mass and arm vary, the stylus' mass does not."""
    hand = FOURTH_ORDER_HAND
    mass = _scattered(hand.line("mass_kg"), grips_N, random, spread.mass)
    skin_k = _scattered(hand.line("skin_stiffness_N_m"), grips_N, random, spread.stiffness)
    skin_b = _scattered(hand.line("skin_damping_N_s_m"), grips_N, random, spread.damping)
    arm_k = _scattered(hand.line("arm_stiffness_N_m"), grips_N, random, spread.stiffness)
    arm_b = _scattered(hand.line("arm_damping_N_s_m"), grips_N, random, spread.damping)
    return [
        chain(
            [FOURTH_ORDER_STYLUS_KG, mass[j]],
            [Link(skin_k[j], skin_b[j]), Link(arm_k[j], arm_b[j])],
            force_per_current_N_A=1.0,
            stylus=0,
        )
        for j in range(grips_N.size)
    ]


def _scattered(line: LinearInGrip, grips_N: FloatArray, random: np.random.Generator, relative: float) -> FloatArray:
    mean = line.constant + line.per_newton * grips_N
    return np.asarray(mean * (1 + relative * random.standard_normal(grips_N.size)))


def taps(
    hands: Sequence[StateSpace], target: SimulatedTaps, speeds_m_s: FloatArray, step_s: float = STEP_S
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """True motions of taps from contact on, one per hand, before the sensors.

    The hand's intended motion continues at the incoming speed. The stylus' deviation from that motion obeys the
    model, which starts from rest.

    Parameters
    ----------
    hands : T models of one order from force on the stylus, the first mass of its chain, to its acceleration.
    speeds_m_s : (T,).

    Returns
    -------
    times_s (K,), force_N, acceleration_m_s2, position_m of the stylus (T, K).
    """
    A, B, C, D, Ce = (np.stack([getattr(hand, name) for hand in hands]) for name in ("A", "B", "C", "D", "Ce"))
    n = A.shape[1]

    def output(row: FloatArray, state: FloatArray) -> FloatArray:
        return np.asarray((row @ state[:, :n, None])[:, 0, 0])

    def force(state: FloatArray) -> FloatArray:
        z = output(Ce, state) - speeds_m_s * state[:, -1]
        velocity = state[:, n // 2] - speeds_m_s
        return contact_force(target, state[:, n] - z, state[:, n + 1] - velocity)

    def rate(state: FloatArray) -> FloatArray:
        F = force(state)
        change = np.empty_like(state)
        change[:, :n] = (A @ state[:, :n, None] + B * F[:, None, None])[..., 0]
        change[:, n] = state[:, n + 1]
        rest = target.object_stiffness_N_m * state[:, n] + target.object_damping_N_s_m * state[:, n + 1]
        change[:, n + 1] = -(F + rest) / target.object_mass_kg
        change[:, -1] = 1.0
        return change

    steps = int(np.ceil((AFTER_S + 1 / RATE_HZ) / step_s))
    state = np.zeros((len(hands), n + 3))  # hand, object, and time itself
    forces, accelerations, positions = (np.empty((len(hands), steps + 1)) for _ in range(3))
    for k in range(steps + 1):
        forces[:, k] = force(state)
        accelerations[:, k] = output(C, state) + D[:, 0, 0] * forces[:, k]
        positions[:, k] = output(Ce, state) - speeds_m_s * state[:, -1]
        state = rk4_step(rate, state, step_s)
    return np.asarray(step_s * np.arange(steps + 1), dtype=float), forces, accelerations, positions


def recorded(
    hands: Sequence[StateSpace],
    grips_N: FloatArray,
    speeds_m_s: FloatArray,
    random: np.random.Generator,
    *,
    target: SimulatedTaps | None = None,
    sensors: Sensors | None = None,
) -> Trials:
    """Taps of these hands as measured by the sensors; without `target` on wood on foam."""
    sensors = sensors or Sensors()
    t, force, acceleration, position = taps(hands, target or surface(), speeds_m_s)
    # The pole as the exact response to an acceleration that is linear between the fine steps.
    x = 2 * np.pi * sensors.accelerometer_Hz * STEP_S
    q = np.exp(-x)
    after = 1 - (1 - q) / x
    acceleration = scipy.signal.lfilter([after, 1 - q - after], [1, -q], acceleration, axis=1)

    dt, before = 1 / RATE_HZ, round(APPROACH_S * RATE_HZ)
    count = before + int(AFTER_S * RATE_HZ)
    T = len(hands)
    phases = random.uniform(0, 1, T)  # sampling is not synchronised with the contact
    sampled = np.empty((3, T, count))
    for j in range(T):
        at = (np.arange(count) - before + phases[j]) * dt
        sampled[0, j] = np.interp(at, t, force[j], left=0.0)
        sampled[1, j] = np.interp(at, t, acceleration[j], left=0.0)
        sampled[2, j] = np.where(at < 0, -speeds_m_s[j] * at, np.interp(at, t, position[j]))
    noise_g = sensors.noise_g_rtHz * np.sqrt(RATE_HZ / 2) * random.standard_normal((T, count))
    seen_g = np.clip(
        sampled[1] / STANDARD_GRAVITY_M_S2 + sensors.offset_g + noise_g, -sensors.range_g, sensors.range_g
    )
    stated_N = grips_N * (1 + sensors.grip_relative * random.standard_normal(T))
    stated_N = np.abs(stated_N + sensors.grip_N * random.standard_normal(T))
    return Trials(
        times_s=np.asarray(dt * np.arange(count), dtype=float),
        force_N=sampled[0] + sensors.force_N * random.standard_normal((T, count)),
        acceleration_m_s2=seen_g * STANDARD_GRAVITY_M_S2,
        position_m=np.round(sampled[2] / ENCODER_COUNT_M) * ENCODER_COUNT_M,
        grip_N=stated_N,
        speed_m_s=speeds_m_s,
        accelerometer_Hz=sensors.accelerometer_Hz,
    )


def tapping_trials(seed: int = 1, *, hand: str = "second_order", spread: Spread | None = None) -> Trials:
    """The 81 trials of one session; the same seed gives the same trials.

    Parameters
    ----------
    hand : one of `HANDS`, the truth.
    """
    random = np.random.default_rng([seed, 81])
    grips_N, speeds_m_s = session(random)
    make = second_order_hands if hand == "second_order" else fourth_order_hands
    hands = make(grips_N, random, spread or Spread())
    return recorded(hands, grips_N, speeds_m_s, random)


def write_trials(trials: Trials, folder: Path) -> list[Path]:
    """Write one NPZ file per trial, trial_01.npz, ...; returns the paths.

    Raises
    ------
    InputError : the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}); choose another folder") from None
    paths = []
    for j, grip_N in enumerate(trials.grip_N):
        paths.append(folder / f"trial_{j + 1:02d}.npz")
        with whole_file(paths[-1]) as file:
            np.savez_compressed(
                file,
                time_s=trials.times_s,
                acceleration_m_s2=trials.acceleration_m_s2[j],
                force_N=trials.force_N[j],
                position_m=trials.position_m[j],
                grip_N=grip_N,
                speed_m_s=trials.speed_m_s[j],
                accelerometer_Hz=trials.accelerometer_Hz,
            )
    return paths


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Write the 81 simulated tapping trials of one session.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--hand", choices=HANDS, default=HANDS[0])
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    write_trials(tapping_trials(options.seed, hand=options.hand), options.folder)
