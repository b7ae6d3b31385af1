"""Levels of a movement relative to the wanted one: broadband, as vibration is felt, and by third octave.

Energies are those of the window tau_0 to tau_(N-1) without a taper, since a tap starts and ends at rest within it.
The energy in a band is the integral of the signal's energy density |X(f)|^2 between the band's edges. With R_m the
autocorrelation of the samples, |X(f)|^2 = sum_m R_m cos(2 pi f m dt). The integral is thus a finite sum that needs no
frequency grid, and the bands from 0 to half the sampling rate add up to the energy of the samples. A DFT would be too
coarse: over 80 ms its lines lie 12.5 Hz apart, wider than the third octave at 50 Hz.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from transopt.base.signals import FloatArray, fast_length
from transopt.problem.objective.target import Target, normal
from transopt.problem.objective.weighting import PACINIAN_Hz, pacinian

# IEC 61260-1: base-ten third octaves, midband 1000 Hz 10^(x/10), edges a factor 10^(1/20) below and above.
BANDS = range(-13, 1)  # x of the bands from 50 Hz to 1 kHz, the upper end of the recordings
MIDBAND_TO_EDGE = 10 ** (1 / 20)
NOMINAL_Hz = (50.0, 63.0, 80.0, 100.0, 125.0, 160.0, 200.0, 250.0, 315.0, 400.0, 500.0, 630.0, 800.0, 1000.0)
MIN_BAND_SHARE = 1e-4  # a band with a smaller share of the wanted energy, unweighted and as felt, gets no level
JUST_NOTICED_dB = 1.6  # difference threshold of the intensity of vibration, which lies between 1.6 and 1.9 dB


@dataclass(frozen=True)
class Levels:
    """Energy of a movement over that of the wanted one [dB]: 0 is equally strong, NaN if the wanted energy is zero.

    Attributes
    ----------
    broadband_dB : unweighted.
    pacinian_dB : weighted by the band-pass at 275 Hz of the sense of vibration (`weighting.pacinian`); NaN where the
        servo rate is too low for it.
    below_dB : of all frequencies below the lowest third octave.
    thirds_dB : nominal midband frequency [Hz] -> dB, for the third octaves that contain a part of the tap.
    lacking_Hz : third octave with the largest error in the energy as felt; 0 for the band below the lowest one.
    """

    broadband_dB: float
    pacinian_dB: float
    below_dB: float
    thirds_dB: dict[float, float]
    lacking_Hz: float

    @property
    def felt_dB(self) -> float:
        """The level that the verdict uses: `pacinian_dB`, or `broadband_dB` where that is NaN."""
        return self.broadband_dB if np.isnan(self.pacinian_dB) else self.pacinian_dB

    @property
    def where(self) -> str:
        """The band `lacking_Hz` in words."""
        return f"at {self.lacking_Hz:g} Hz" if self.lacking_Hz else f"below {EDGES_Hz[0]:.0f} Hz"


EDGES_Hz: FloatArray = 1000 * 10 ** (np.array([*BANDS, BANDS[-1] + 1]) / 10) / MIDBAND_TO_EDGE


def band_energies(samples: FloatArray, dt_s: float) -> FloatArray:
    """(..., 15) energy of samples (..., N) below the lowest third octave and in each of the 14 [unit^2].

    A band above half the sampling rate has zero energy; of a band across it the part below it counts.
    """
    N = samples.shape[-1]
    length = fast_length(2 * N)
    spectrum = np.fft.rfft(samples, length, axis=-1)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2, length, axis=-1)[..., :N]
    # Rounding can make the energy of an empty band slightly negative.
    return np.asarray(np.maximum(correlation @ _integrals(N, dt_s), 0.0))


@lru_cache(maxsize=8)
def _integrals(N: int, dt_s: float) -> FloatArray:
    """(N, 15) matrix that turns autocorrelations at lags 0 to N - 1 into energies of the bands."""
    edges = np.minimum(np.append(0.0, EDGES_Hz) * dt_s, 0.5)
    # 2 int cos(2 pi f m) df from 0 to an edge; every lag but m = 0 occurs twice, as m and -m.
    up_to = 2 * edges * np.sinc(2 * edges * np.arange(N)[:, None])
    up_to[1:] *= 2
    return np.diff(up_to, axis=1)


def pacinian_dB(made_m_s2: FloatArray, wanted_m_s2: FloatArray, dt_s: float) -> float:
    """`Levels.pacinian_dB` alone."""
    felt = _felt(np.atleast_2d(made_m_s2), wanted_m_s2, dt_s)
    return _energy_dB(*felt) if felt else float("nan")


def _felt(made: FloatArray, wanted: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray] | None:
    """Accelerations (S, N) and (N,) through the Pacinian band-pass; None where the servo rate is too low for it."""
    if not 2 * PACINIAN_Hz * dt_s < 1:
        return None
    by = pacinian(dt_s)
    return by.apply(made), by.apply(wanted)


def _energy_dB(made: FloatArray, wanted: FloatArray) -> float:
    """Mean energy of accelerations (S, N) over that of (N,) [dB]."""
    return _dB(float(np.mean(np.sum(made**2, axis=-1))), float(wanted @ wanted))


def levels(made_m_s2: FloatArray, wanted_m_s2: FloatArray, dt_s: float) -> Levels:
    """Levels of accelerations (N,), or of the mean energy of S devices' (S, N), relative to the wanted (N,)."""
    made = np.atleast_2d(made_m_s2)
    felt = _felt(made, wanted_m_s2, dt_s)
    felt_made, felt_wanted = felt or (made, wanted_m_s2)
    plain = band_energies(np.vstack([made, wanted_m_s2, felt_made, felt_wanted]), dt_s)
    S = made.shape[0]
    own, asked = plain[:S].mean(axis=0), plain[S]
    felt_own, felt_asked = plain[S + 1 : -1].mean(axis=0), plain[-1]
    present = (asked > MIN_BAND_SHARE * float(wanted_m_s2 @ wanted_m_s2)) | (
        felt_asked > MIN_BAND_SHARE * float(felt_wanted @ felt_wanted)
    )
    thirds = {f: _dB(own[j + 1], asked[j + 1]) for j, f in enumerate(NOMINAL_Hz) if present[j + 1]}
    off = int(np.argmax(np.abs(felt_own - felt_asked)))
    return Levels(
        broadband_dB=_energy_dB(made, wanted_m_s2),
        pacinian_dB=_energy_dB(*felt) if felt else float("nan"),
        below_dB=_dB(own[0], asked[0]) if present[0] else float("nan"),
        thirds_dB=thirds,
        lacking_Hz=(0.0, *NOMINAL_Hz)[off],
    )


def normal_levels(target: Target, acceleration_m_s2: FloatArray, dt_s: float) -> Levels:
    """Levels of y'' (N,), or of (p, N) along the normal, with a_free, beside what was recorded."""
    target = target.normal
    free, recorded = (target.of_window(each) for each in (target.free_m_s2, target.recorded_m_s2))
    return levels(normal(acceleration_m_s2) + free, recorded, dt_s)


def _dB(made: float, wanted: float) -> float:
    if wanted <= 0:
        return float("nan")
    return float(10 * np.log10(max(made / wanted, np.finfo(float).tiny)))
