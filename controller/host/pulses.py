"""What small pulses of current do to a held stylus: by a library's model, and by the sensors.

A pulse of 0.1 A is felt as a tremble and harmless with any sign. What is compared is the current over the second
half of the pulse, when the amplifier has settled, and the mean acceleration over the first 5 ms, before the hand's
springs push back: that depends on the motor's force and on the masses, and little on the grip.
"""

from dataclasses import dataclass

import numpy as np

from controller.record.played import through_pole
from transopt.library.library import Library
from transopt.plant.discretise import discretise

MOST_NODES = 4  # of grip, in a configuration
FINER = 20  # steps of the rollout per servo period
FIRST_S = 5e-3  # of the pulse, over which the acceleration is averaged
LATE_TICKS = 2  # after which the amplifier's delay is over


@dataclass(frozen=True)
class PulseModel:
    """What a library's model says of a pulse of 1 A.

    Attributes
    ----------
    grips_N : (n,) rising, n <= 4.
    acceleration_m_s2 : (n,) mean over the first 5 ms, as the accelerometer sees it.
    path_m : (n,) of the encoder at the end of the pulse; 0 where the model has no position.
    """

    grips_N: tuple[float, ...]
    acceleration_m_s2: tuple[float, ...]
    path_m: tuple[float, ...]

    def at(self, grip_N: float) -> tuple[float, float]:
        """Acceleration and path at a grip, moved to the edge of the nodes."""
        return (
            float(np.interp(grip_N, self.grips_N, self.acceleration_m_s2)),
            float(np.interp(grip_N, self.grips_N, self.path_m)),
        )


def pulse_model(library: Library, duration_s: float, accelerometer_Hz: float) -> PulseModel:
    """By the exact motion of the library's own model, from rest, at up to four of its grips.

    Parameters
    ----------
    duration_s : of the pulse. accelerometer_Hz : its pole.
    """
    grips = library.grips_N
    nodes = grips if grips.size <= MOST_NODES else np.linspace(grips[0], grips[-1], MOST_NODES)
    found = [_one(library, float(grip_N), duration_s, accelerometer_Hz) for grip_N in nodes]
    return PulseModel(tuple(map(float, nodes)), tuple(a for a, _ in found), tuple(z for _, z in found))


def _one(library: Library, grip_N: float, duration_s: float, accelerometer_Hz: float) -> tuple[float, float]:
    dt_s, amplifier = float(library.meta["dt_s"]), library.amplifier()
    delay_s = 0.0 if amplifier is None else amplifier.delay_s
    fine_s = dt_s / FINER
    plant = library.scene().plant(grip_N)
    steps = round((duration_s + delay_s + dt_s) / fine_s)
    command = np.ones(steps)
    command[round(duration_s / fine_s) :] = 0.0
    motion = discretise(plant, amplifier, fine_s, position=True).motion(command)
    times = delay_s + fine_s * np.arange(steps)
    felt = through_pole(motion.acceleration_m_s2, fine_s, accelerometer_Hz)
    ticks = dt_s * np.arange(LATE_TICKS, round(FIRST_S / dt_s) + LATE_TICKS)
    acceleration = float(np.interp(ticks, times, felt, left=0.0).mean())
    return acceleration, float(np.interp(duration_s, times, motion.encoder_m, left=0.0))
