"""A hand's motion by the encoder beside the same motion by the accelerometer: what one reads over the other.

Both are band-passed alike and the encoder's path is derived twice, so that neither gravity, nor an offset, nor the
accelerometer's noise at low frequencies is in it: over a shake of a centimetre at 2 to 4 Hz the accelerations of some
m/s^2 stand far above both sensors' noise.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from transopt.base.signals import FloatArray

LOW_HZ, HIGH_HZ = 1.5, 15.0  # of a shaking hand
SETTLING_S = 0.3  # of the filter, left out at both ends
LEAST_M_S2 = 0.3  # rms of a shake from which anything can be told
NOTHING = 0.05  # of the other sensor's: noise
COHERENT = 0.9  # least correlation of two records of the same motion


@dataclass(frozen=True)
class Shaken:
    """One shake.

    Attributes
    ----------
    encoder_m_s2, accelerometer_m_s2 : rms of the acceleration by either sensor, within the band.
    correlation : of the two, -1 to 1.
    """

    encoder_m_s2: float
    accelerometer_m_s2: float
    correlation: float

    @property
    def enough(self) -> bool:
        """Whether one sensor saw a shake from which something can be told."""
        return max(self.encoder_m_s2, self.accelerometer_m_s2) >= LEAST_M_S2

    @property
    def ratio(self) -> float:
        """What the encoder says over what the accelerometer says, signed; NaN if the two have nothing in common.

        0 where only the accelerometer moves, infinite where only the encoder does.
        """
        if self.encoder_m_s2 < NOTHING * self.accelerometer_m_s2:
            return 0.0
        if self.accelerometer_m_s2 < NOTHING * self.encoder_m_s2:
            return float("inf")
        if abs(self.correlation) < COHERENT:
            return float("nan")
        return float(np.sign(self.correlation)) * self.encoder_m_s2 / self.accelerometer_m_s2


def shaken(dt_s: float, position_m: FloatArray, acceleration_m_s2: FloatArray) -> Shaken:
    """
    Parameters
    ----------
    dt_s : between two readings. position_m, acceleration_m_s2 : (n,) by encoder and by accelerometer.
    """
    edge = round(SETTLING_S / dt_s)
    if position_m.size < 3 * edge:
        return Shaken(0.0, 0.0, 0.0)
    band = scipy.signal.butter(2, [LOW_HZ, HIGH_HZ], "bandpass", fs=1 / dt_s, output="sos")

    def within(values: FloatArray) -> FloatArray:
        return np.asarray(scipy.signal.sosfiltfilt(band, values - values.mean()))

    path, felt = within(position_m), within(acceleration_m_s2)
    by_encoder = (np.gradient(np.gradient(path, dt_s), dt_s))[edge:-edge]
    by_accelerometer = felt[edge:-edge]
    sizes = [float(np.sqrt(np.mean(each**2))) for each in (by_encoder, by_accelerometer)]
    together = float(np.mean(by_encoder * by_accelerometer))
    product = sizes[0] * sizes[1]
    return Shaken(sizes[0], sizes[1], together / product if product > 0 else 0.0)
