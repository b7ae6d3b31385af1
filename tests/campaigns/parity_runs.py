"""Random runs of the Python servo for `device_parity.py`: settings, banks, motions, faults, wishes of the host."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from controller.protocol.image import bank_of, image_of
from controller.servo.interface import Readings, State
from controller.servo.settings import DELAY_TICKS, Settings
from controller.sim.simulated_tap import approach_ticks
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import device_of
from controller.sim.user import TapUser, Tremor
from controller.waveforms.bank import Bank, Method, bank
from tests.benches.core_replay import ARM, DISARM, EXCITE, GAIN, NEGATIVE, RESET, Recorder
from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import CoilModel
from transopt.plant.intention import YIELDINGS, Intention
from transopt.plant.wall import Wall
from transopt.problem.warm_coil import currents, norms

DT_S, COUNT_M = 1e-4, 24.5e-6
TAIL = 10  # zero commands at the end of every waveform
ABSURD = (math.nan, math.inf, -math.inf, 1e300, -1e300, 1e9, -1e9)
EXCITED_EVERY = 8  # of so many random runs one is of excitations that the host starts
Random = np.random.Generator


def draw_bank(random: Random, amplifier: Amplifier | None, *, free: bool) -> Bank:
    """A table of noise, with one to five speeds and one to four grips, as a rule with cool commands."""
    nv, ng, N = int(random.integers(1, 6)), int(random.integers(1, 5)), int(random.integers(TAIL + 1, 400))
    speeds = np.cumsum(random.uniform(0.05, 0.2, nv))
    grips = np.zeros(1) if free else np.cumsum(random.uniform(0.5, 2.0, ng))
    width = int(random.integers(1, 30))
    command = random.uniform(0.5, 5.0) * random.standard_normal((nv, grips.size, N))
    command = np.apply_along_axis(np.convolve, -1, command, np.ones(width) / width, mode="same")
    command[..., -TAIL:] = 0.0
    transient = norms(currents(command, amplifier, DT_S), amplifier, DT_S)
    cool, cool_transient = draw_cool(random.spawn(1)[0], command, amplifier)
    return Bank(
        method=Method.BILINEAR,
        speeds_m_s=speeds.tolist(),
        grips_N=grips.tolist(),
        command_A=command,
        transient_A=transient.tolist(),
        feedback_A=(random.uniform(0, 0.3) * transient).tolist(),
        grip_min_N=0.0 if free else 0.5,
        by_grip=bool(random.uniform() < 0.8),
        nearest=bool(random.uniform() < 0.2),
        cool_command_A=cool,
        cool_transient_A=cool_transient,
    )


def draw_cool(
    random: Random, command: FloatArray, amplifier: Amplifier | None
) -> tuple[FloatArray | None, list[list[float]]]:
    """Cool commands of less heat at most nodes, and their norms; at times none, or some of no current at all."""
    if random.uniform() < 0.3:
        return None, []
    share = random.uniform(0.1, 1.1, (*command.shape[:2], 1)) * (random.uniform(size=(*command.shape[:2], 1)) < 0.9)
    cool = share * command + 0.1 * share * np.roll(command, -3, axis=-1)
    cool[..., -TAIL:] = 0.0
    return cool, norms(currents(cool, amplifier, DT_S), amplifier, DT_S).tolist()


def draw_coil(random: Random) -> CoilModel | None:
    """The RE 25, at times with one node, at times so hot that transients are scaled, withheld or cut by a fault."""
    if random.uniform() < 0.15:
        return None
    coil = CoilModel(2.18, 3.1, 14.0, 12.0, 612.0, 100.0, nodes=int(random.integers(1, 3)))
    if random.uniform() < 0.5:
        return coil
    winding = float(random.choice([94.9, 94.99, 94.999, 97.0, 99.9, 99.99]))
    housing = float(random.choice([25.0, winding - 5, winding]))
    return replace(coil, start_winding_C=winding, start_housing_C=housing)


def draw_settings(random: Random, amplifier: Amplifier | None, *, free: bool) -> Settings:
    """Settings with parts there or not, contacts and rearming quick enough that much happens."""
    wall = None
    if random.uniform() < 0.6:
        stiffness, damping = float(random.uniform(50, 4000)), float(random.uniform(0, 20))
        wall = Wall(stiffness, damping, 1.25, int(random.integers(0, 6)), float(random.uniform(50, 2000)))
    others: dict[str, Any] = {}
    if free:
        others = {"grip_min_N": 0.0, "assumed_grip_N": 0.0}
    elif random.uniform() < 0.15:
        others = {"assumed_grip_N": 3.0}
    return Settings(
        dt_s=DT_S,
        lead_s=float(random.choice([0.0, 1e-4, 3e-4])),
        current_limit_A=float(random.uniform(1.0, 5.0)),
        amplifier=amplifier,
        amplifier_tolerance=float(random.choice([0.0, 0.1, 0.3])),
        wall=wall,
        coil=draw_coil(random),
        slew_limit_A_per_s=float(random.uniform(1000, 20000)) if random.uniform() < 0.3 else None,
        surface_counts=float(random.choice([0.0, -0.5, 137.25])),
        window_ticks=int(random.integers(4, 256)) if random.uniform() < 0.5 else 100,
        rearm_s=float(random.choice([0.0, 1e-3, 5e-3])),
        rearm_height_m=float(random.choice([1e-4, 5e-4])),
        grip_filter_s=float(random.choice([0.0, 5e-3])),
        **others,
    )


def draw_amplifier(random: Random) -> Amplifier | None:
    if random.uniform() < 0.2:
        return None
    pole_Hz = float(random.uniform(300, 3000))
    return Amplifier(pole_Hz, 68e-6 + int(pole_Hz) % DELAY_TICKS * DT_S, 6.0)


def stored(settings: Settings, table: Bank, tail: int) -> bytes:
    """The image of a table for a device with these settings; cool commands of odd length in 8 bit."""
    bits = 8 if table.command_A.shape[-1] % 2 else 16
    return image_of(table, settings.dt_s, settings.lead_s, tail, cool_bits=bits, amplifier=settings.amplifier)


def recorder_of(settings: Settings, table: Bank, tail: int) -> Recorder:
    """A servo that plays what a device would store of this table."""
    image = stored(settings, table, tail)
    return Recorder(settings, bank_of(image)[0], image)


def draw_wishes(random: Random, state: State) -> tuple[int, float]:
    """What the host asks before a tick: seldom anything, but always for a way out of IDLE and FAULT."""
    chance, gain = random.uniform(), float(random.choice([1.0, 0.1, 0.5, -1.0, 2.0, math.nan]))
    wishes = (GAIN if chance < 0.002 else 0) | (DISARM if 0.002 <= chance < 0.003 else 0)
    if state is State.FAULT and chance > 0.97:
        wishes |= RESET
    if (state is State.IDLE and chance > 0.95) or chance > 0.9995:
        wishes |= ARM
    if state is State.ARMED and 0.1 <= chance < 0.105:
        wishes |= EXCITE | (NEGATIVE if chance < 0.1025 else 0)
    return wishes, gain


def falsified(random: Random, readings: Readings) -> Readings:
    """Make one of the readings wrong, in one of the ways that make faults."""
    counts = readings.encoder_counts
    kinds: tuple[Callable[[], dict[str, Any]], ...] = (
        lambda: {"emergency_stop": True},
        lambda: {"encoder_counts": random.choice(ABSURD)},
        lambda: {"encoder_counts": counts + int(random.integers(-2000, 2000))},
        lambda: {"current_A": float(random.choice([*ABSURD, 49.0, 5.3, -5.3]))},
        lambda: {"grip_N": float(random.choice([*ABSURD, 0.0, 0.3, 59.0, 61.0, -2.0]))},
    )
    return readings._replace(**kinds[int(random.integers(len(kinds)))]())


def random_run(seed: int, ticks: int) -> Recorder:
    """A hand that swings across the surface at random, a noisy device, faults and wishes at random instants.

    What is played is started by contacts, or by the host's wish.
    """
    random = np.random.default_rng([seed, 11])
    amplifier, free = draw_amplifier(random), bool(random.uniform() < 0.1)
    settings = draw_settings(random, amplifier, free=free)
    if seed % EXCITED_EVERY == 1:
        settings = replace(settings, host_starts=True, wall=None)
    recorder = recorder_of(settings, draw_bank(random, amplifier, free=free), TAIL)
    servo, faulty = recorder.servo, float(random.choice([0.0, 2e-4, 2e-3]))
    swings = [(random.uniform(2e-4, 6e-3), random.uniform(1.0, 15.0), random.uniform(0, 7)) for _ in range(3)]
    far = int(random.choice([0, 0, 400_000]))  # the encoder's zero may be anywhere
    if far:
        recorder = recorder_of(replace(settings, surface_counts=settings.surface_counts + far), servo.bank, TAIL)
        servo = recorder.servo
    held, stuck = float(random.uniform(0.6, 8.0)), -1
    # The accelerometer's scale and offset, at times it is dead; and the part of the expected current that is measured
    # in three of twenty stretches of 50 ms.
    sensed = np.random.default_rng([seed, 14])
    felt, tilt = (0.0, 0.0) if sensed.uniform() < 0.15 else (sensed.uniform(0.7, 1.3), sensed.uniform(-2.0, 2.0))
    wrong = dict.fromkeys((2, 5, 8), float(sensed.choice([1.0, 0.5, 1.2, 2.0])))
    for tick in range(ticks):
        angles = [2 * math.pi * rate * tick * DT_S + at for _, rate, at in swings]
        z = sum(size * math.sin(angle) for (size, _, _), angle in zip(swings, angles, strict=True))
        bend = sum(
            -size * (2 * math.pi * rate) ** 2 * math.sin(angle)
            for (size, rate, _), angle in zip(swings, angles, strict=True)
        )
        counts = math.floor(z / COUNT_M + 0.5) + far
        if random.uniform() < 1e-4:
            stuck = tick + int(random.integers(100, 3000))
        if tick < stuck:
            counts = servo.watch.counts
        readings = Readings(
            tick,
            counts,
            max(held + 0.02 * random.standard_normal(), 0.0),
            servo.awaited_A[0] * (wrong.get(tick // 500 % 20, 1.0) if tick % 9000 < 8900 else 0.1)
            + 0.005 * random.standard_normal(),
            felt * bend + tilt + (0.2 * sensed.standard_normal() if felt else 0.0),
        )
        if sensed.uniform() < faulty / 5:
            readings = readings._replace(acceleration_m_s2=float(sensed.choice([*ABSURD, 5000.0])))
        if random.uniform() < faulty:
            readings = falsified(random, readings)
        recorder.step(readings, *draw_wishes(random, servo.state))
    return recorder


def tap_run(library: Library, seed: int) -> Recorder:
    """A scenario in closed loop with the simulator: one tap of the library, with whatever else may be there."""
    random = np.random.default_rng([seed, 12])
    free = library.grips_N[0] == 0
    varied = draw_settings(random, library.amplifier(), free=free)
    ideal = random.uniform() < 0.15
    settings = replace(
        Settings.of(library),
        amplifier=None if ideal else library.amplifier(),
        amplifier_tolerance=varied.amplifier_tolerance,
        wall=varied.wall,
        coil=varied.coil,
        slew_limit_A_per_s=varied.slew_limit_A_per_s,
        assumed_grip_N=varied.assumed_grip_N,
    )
    method = (Method.BILINEAR, Method.NEAREST, Method.BLIND, Method.CLIPPED_OPTIMUM)[
        int(random.choice(4, p=[0.7, 0.1, 0.1, 0.1]))
    ]
    recorder = recorder_of(settings, bank(library, method), TAIL if method is not Method.CLIPPED_OPTIMUM else 1)
    speed, grip = float(random.uniform(0.05, 0.7)), 0.0 if free else float(random.uniform(0.3, 7.0))
    contact = approach_ticks(speed, settings.dt_s)
    intention = Intention(yields=YIELDINGS[int(random.integers(3))])
    user = TapUser(speed, grip, (contact + random.uniform()) * settings.dt_s, intention, Tremor())
    imperfections = Imperfections(mismatch=float(random.uniform(0, 0.1)))
    device = replace(device_of(library.scene()), amplifier=settings.amplifier)
    simulator = Simulator(device, user, settings.dt_s, imperfections=imperfections, seed=seed)
    recorder.servo.set_gain(1.0)
    broken = contact + int(random.integers(-contact, 700)) if random.uniform() < 0.4 else -1
    lasting, open_at = int(random.choice([1, 3, 40])), contact if random.uniform() < 0.1 else math.inf
    for tick in range(contact + 900):
        readings = simulator.readings()
        if broken <= tick < broken + lasting:
            readings = falsified(np.random.default_rng([seed, 13]), readings)
        wishes, gain = draw_wishes(random, recorder.servo.state)
        output = recorder.step(readings, ARM if tick == 0 else wishes, gain)
        simulator.advance(0.0 if tick > open_at else output.command_A)
    return recorder
