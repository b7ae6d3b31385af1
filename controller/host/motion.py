"""Ratio of a hand's motion by the encoder to the same motion by the accelerometer.

Both signals pass the same band-pass and the encoder's path is differentiated twice, which removes gravity, offsets
and the accelerometer's low-frequency noise. A shake of a centimetre at 2 to 4 Hz has accelerations of some m/s^2, far
above both sensors' noise.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from transopt.base.signals import FloatArray

LOW_HZ, HIGH_HZ = 1.5, 15.0  # band of a shaking hand
SETTLING_S = 0.3  # settling time of the filter, left out at both ends
LEAST_M_S2 = 0.3  # least rms of a shake for a comparison
NOTHING = 0.05  # rms over the other sensor's below which a sensor shows only noise
COHERENT = 0.9  # least correlation of two records of the same motion


@dataclass(frozen=True)
class Shaken:
    """One shake seen by both sensors.

    Attributes
    ----------
    encoder_m_s2, accelerometer_m_s2 : rms of the acceleration within the band, by each sensor.
    correlation : correlation of the two signals, -1 to 1.
    """

    encoder_m_s2: float
    accelerometer_m_s2: float
    correlation: float

    @property
    def enough(self) -> bool:
        """Whether at least one sensor saw a shake large enough for a comparison."""
        return max(self.encoder_m_s2, self.accelerometer_m_s2) >= LEAST_M_S2

    @property
    def ratio(self) -> float:
        """Rms by the encoder over that by the accelerometer, signed; NaN if the two are not coherent.

        0 if only the accelerometer shows motion, infinite if only the encoder does.
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
    dt_s : sampling period. position_m, acceleration_m_s2 : (n,) readings of encoder and accelerometer.
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
