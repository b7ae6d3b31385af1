"""Trials of a known device for the tests of identification: exact sampled motion of transopt's models, plus noise.

Independent of the fits: time domain, one step of the exact hold after the other.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import signal

from controller.record.excitation import sweep_command
from transopt.base.matrices import exponential
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray, Signal
from transopt.identify.device.chain import DriveChain
from transopt.identify.measurement import Measurement
from transopt.plant.amplifier import Amplifier
from transopt.plant.discretise import split_delay
from transopt.plant.state_space import StateSpace

DT_S = 1e-4
ACCELEROMETER_HZ = 2500.0
NOISE_M_S2 = 320e-6 * STANDARD_GRAVITY_M_S2 * np.sqrt(np.pi / 2 * ACCELEROMETER_HZ)  # rms behind the pole
CURRENT_NOISE_A = 5e-3
AMPLIFIER = Amplifier(1050.0, 68e-6, 6.0)
# The default device of the built-in scenes: a Maxon RE 25 behind a transmission, a stylus, a hand.
DEFAULT = DriveChain(
    1.25,
    np.array([0.014, 0.026, 6e4, 8.0]),
    np.array([[0.010, 0.0], [3000.0, 2000.0], [6.0, 3.0], [160.0, 110.0], [6.0, 3.0]]),
)


def mismatched(fraction: float, seed: int) -> DriveChain:
    """The default device with every parameter but the known force off by up to `fraction`."""
    random = np.random.default_rng([seed, 77])
    shared = DEFAULT.shared * (1 + fraction * random.uniform(-1, 1, 4))
    hand = DEFAULT.hand * (1 + fraction * random.uniform(-1, 1, (5, 1)))
    return DriveChain(DEFAULT.force_per_current_N_A, shared, hand)


def sampled_run(
    plant: StateSpace, command_A: FloatArray, amplifier: Amplifier | None = AMPLIFIER, crossover_A: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(N,) current [A], acceleration behind its sensor's pole [m/s^2], position [m]; each before its command acts."""
    felt = command_A - np.clip(command_A, -crossover_A, crossover_A)
    n = plant.order
    pole = 2 * np.pi * ACCELEROMETER_HZ
    M = np.zeros((n + 3, n + 3))  # plant, current, accelerometer, felt command
    rate = 0.0 if amplifier is None else amplifier.rate_rad_s
    source = n + 2 if amplifier is None else n
    M[:n, :n], M[:n, source] = plant.A, plant.B[:, 0]
    M[n, n], M[n, -1] = -rate, rate
    M[n + 1, :n], M[n + 1, source], M[n + 1, n + 1] = pole * plant.C[0], pole * plant.D[0, 0], -pole
    whole, late = split_delay(0.0 if amplifier is None else amplifier.delay_s, DT_S)
    early, rest = exponential(M * late), exponential(M * (DT_S - late))
    older = np.concatenate([np.zeros(whole + 1), felt])
    # c_(k - 1 - whole) acts until the delay is over, and the next one after that.
    whole_step = rest[:-1, :-1] @ early[:-1, :-1]
    driven = np.outer(older[:-1], rest[:-1, :-1] @ early[:-1, -1]) + np.outer(older[1:], rest[:-1, -1])
    states = np.zeros((command_A.size, n + 2))
    for k in range(command_A.size - 1):
        states[k + 1] = whole_step.dot(states[k]) + driven[k]
    current = states[:, n] if amplifier is not None else older[: command_A.size]
    return current, states[:, n + 1], states[:, :n] @ plant.Ce[0]


@dataclass(frozen=True)
class Rig:
    """A device that is recorded.

    Attributes
    ----------
    device : the truth. crossover_A : half the amplifier's dead band. noise : factor on the sensors' noise.
    count_m : of the encoder, which is recorded too then.
    """

    device: DriveChain = DEFAULT
    amplifier: Amplifier | None = AMPLIFIER
    crossover_A: float = 0.0
    noise: float = 1.0
    count_m: float | None = None
    runs: dict[tuple[float, bytes], tuple[FloatArray, FloatArray, FloatArray]] = field(
        default_factory=dict, compare=False
    )

    def record(self, name: str, grip_N: float, command_A: FloatArray, seed: int) -> Measurement:
        sign = np.sign(command_A[np.argmax(np.abs(command_A))]) or 1.0  # nothing here depends on the polarity
        key = (grip_N, (sign * command_A).tobytes())
        if key not in self.runs:
            plant = self.device.plant(grip_N)
            self.runs[key] = sampled_run(plant, sign * command_A, self.amplifier, self.crossover_A)
        current, acceleration, position = (sign * each for each in self.runs[key])
        random = np.random.default_rng([seed, int(1000 * grip_N)])
        kept = np.exp(-2 * np.pi * ACCELEROMETER_HZ * DT_S)
        fresh = random.standard_normal(command_A.size + 100)
        noise = signal.lfilter([np.sqrt(1 - kept**2)], [1.0, -kept], fresh)[100:]
        times = (0.0, DT_S)
        # Nobody holds the stylus twice at the same part of a count.
        part = np.random.default_rng([seed, int(1000 * grip_N), 2]).uniform(-0.5, 0.5)
        counted = None if self.count_m is None else self.count_m * np.round(position / self.count_m + part)
        return Measurement(
            name=name,
            source=name,
            sha256="0" * 64,
            command=Signal(*times, command_A),
            current=Signal(*times, current + self.noise * CURRENT_NOISE_A * random.standard_normal(command_A.size)),
            acceleration=Signal(*times, acceleration + self.noise * NOISE_M_S2 * noise),
            position=None if counted is None else Signal(*times, counted),
            grip_N=grip_N,
            accelerometer_Hz=ACCELEROMETER_HZ,
        )

    def sweeps(
        self, grips_N: tuple[float, ...], trials: int = 4, seconds: float = 2.0, seed: int = 0
    ) -> list[Measurement]:
        """Sweeps 1 to 2000 Hz at 0.75 A, every other one of reversed polarity."""
        command = sweep_command(1.0, 2000.0, seconds, 0.75, DT_S)
        return [
            self.record(f"sweep_{grip:g}N_{j}.npz", grip, (-1) ** j * command, 1000 * seed + j)
            for grip in grips_N
            for j in range(trials)
        ]

    def transients(self, grips_N: tuple[float, ...], seed: int = 0) -> list[Measurement]:
        """A tap-like burst per grip: 4 ms at about 3 A, ringing, 60 ms of it."""
        times = DT_S * np.arange(1200)
        start = times - 0.02
        burst = np.where(start > 0, np.exp(-start / 4e-3) * np.sin(2 * np.pi * 120 * start), 0.0)
        command = 3.0 * burst / np.abs(burst).max()
        return [self.record(f"burst_{grip:g}N.npz", grip, command, 5000 + seed) for grip in grips_N]

    def loud(self, noise: float) -> "Rig":
        return replace(self, noise=noise)


def spoilt(run: Measurement, quantity: str, change: Callable[[FloatArray], FloatArray]) -> Measurement:
    """A run in which the values (n,) of one signal are changed."""
    x = run.require(quantity)
    made: dict[str, Any] = {quantity: replace(x, values=change(x.values))}
    return replace(run, **made)


def assert_near(model: StateSpace, truth: StateSpace, high_Hz: float = 800.0) -> None:
    """Within 1 dB and 5 degrees from 2 Hz on."""
    frequencies = np.geomspace(2, high_Hz, 300)
    ratio = model.response(frequencies) / truth.response(frequencies)
    assert np.max(np.abs(20 * np.log10(np.abs(ratio)))) < 1
    assert np.max(np.abs(np.degrees(np.angle(ratio)))) < 5
