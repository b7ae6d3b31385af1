"""Sensor models: readings from true values by quantisation, noise and hysteresis."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from transopt.base.signals import STANDARD_GRAVITY_M_S2

NOISE_BLOCK = 4096  # random numbers drawn at once


@dataclass(frozen=True)
class Sensors:
    """Imperfections of the sensors.

    Attributes
    ----------
    count_m : encoder resolution at the tip (seed: 24.5 um).
    accelerometer_noise_g_rtHz, accelerometer_range_g, accelerometer_bandwidth_Hz : ADXL321 with the smallest
        filter capacitor; one pole at the bandwidth. At an end of the range a port reads no number (NaN).
    grip_hysteresis : relative hysteresis of the force-sensing resistor, to either side. grip_noise_N : rms noise.
    current_noise_A : rms noise of the amplifier's monitor.
    """

    count_m: float = 24.5e-6
    accelerometer_noise_g_rtHz: float = 320e-6
    accelerometer_range_g: float = 18.0
    accelerometer_bandwidth_Hz: float = 2500.0
    grip_hysteresis: float = 0.05
    grip_noise_N: float = 0.02
    current_noise_A: float = 0.005

    @property
    def accelerometer_noise_m_s2(self) -> float:
        """Rms noise behind the pole: white noise of density n through one pole at f has rms n sqrt(pi f / 2)."""
        density = self.accelerometer_noise_g_rtHz * STANDARD_GRAVITY_M_S2
        return density * math.sqrt(math.pi / 2 * self.accelerometer_bandwidth_Hz)


SEED_SENSORS = Sensors()


def noise_seed(seed: int, *place: int) -> int:
    """Seed of the noise of one trial, different for each `place`."""
    return int(np.random.SeedSequence([seed, 7, *place]).generate_state(1, np.uint64)[0] >> 1)


def _normal(random: np.random.Generator) -> Iterator[float]:
    while True:
        yield from random.standard_normal(NOISE_BLOCK).tolist()


class SensorBench:
    """The sensors of one run, with the states of their noise and hysteresis.

    Parameters
    ----------
    held_N : initial grip, at which the grip sensor has settled.

    Attributes
    ----------
    keep, new_m_s2 : coefficient and innovation of the accelerometer's noise, a first-order autoregression per tick.
    """

    def __init__(self, sensors: Sensors, dt_s: float, seed: int, held_N: float) -> None:
        self.sensors = sensors
        noises = [_normal(np.random.default_rng([seed, stream])) for stream in range(3)]
        self._acceleration, self._grip, self._current = noises
        self.keep = math.exp(-2 * math.pi * sensors.accelerometer_bandwidth_Hz * dt_s)
        self.new_m_s2 = sensors.accelerometer_noise_m_s2 * math.sqrt(1 - self.keep**2)
        self._wander_m_s2 = sensors.accelerometer_noise_m_s2 * next(self._acceleration)
        self._felt_N = held_N

    def counts(self, position_m: float) -> int:
        return math.floor(position_m / self.sensors.count_m + 0.5)

    def acceleration_m_s2(self, filtered_m_s2: float) -> float:
        """Reading of the acceleration behind the accelerometer's pole, NaN beyond its range.

        Its noise runs through the same pole.
        """
        self._wander_m_s2 = self.keep * self._wander_m_s2 + self.new_m_s2 * next(self._acceleration)
        limit = self.sensors.accelerometer_range_g * STANDARD_GRAVITY_M_S2
        read = filtered_m_s2 + self._wander_m_s2
        return read if abs(read) <= limit else math.nan

    def grip_N(self, held_N: float) -> float:
        slack = self.sensors.grip_hysteresis * held_N
        self._felt_N = min(max(self._felt_N, held_N - slack), held_N + slack)
        return max(self._felt_N + self.sensors.grip_noise_N * next(self._grip), 0.0)

    def current_A(self, current_A: float) -> float:
        return current_A + self.sensors.current_noise_A * next(self._current)
