"""Significance tests on repeated taps: of their mean difference from the prediction, and of a design's gain.

Taps at a node differ by sensor noise and by the hand. So the mean difference from the prediction is partly noise. A
correction by noise makes the device worse, while the same taps indicate an improvement. Therefore a node is corrected
only by significant differences, and a correction is kept only if later taps show a significant gain.

All tests use the orthonormal cosine coefficients (DCT-II) of the measured window up to 1 kHz. A sum of squares over
time equals the sum of squares of the coefficients, stationary noise is nearly independent between them, and a band of
frequencies is a range of coefficients.

In a band of m coefficients, with the scatter S (variance of one coefficient from tap to tap) and the mean u of n
taps,

    f = n |u|^2 / (m S)

is F-distributed under noise alone, with m and m nu degrees of freedom, where nu is that of the scatter (Hotelling's
test for a covariance that is isotropic within the band). If the coefficients of a band are correlated, as those of a
hand are, m is replaced by (tr C)^2 / tr(C^2) of their covariance C (Satterthwaite 1946; Box 1954), which makes the
test stricter. S is the larger of two estimates, from the node's own taps and from all taps. A band with significant f
is corrected by the share 1 - 1/f of u, which is signal in the mean square (Wiener 1949); no other band is corrected.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy

from controller.refine.heard import fade_of
from transopt.base.signals import FloatArray

BANDS_HZ = (0.0, 50.0, 100.0, 200.0, 300.0, 400.0, 550.0, 700.0, 1000.0)
CHANGED = 0.01  # share of a prediction's squared change below which a band counts as unchanged
LEVEL = 0.01  # significance level: of a difference over all tests of a round, of a gain at one node


@dataclass(frozen=True)
class Window:
    """The measured part of a library's time grid, and its cosine transform.

    Attributes
    ----------
    fade : (N,) 1 within the measured window, falling to 0.
    dt_s : period of the grid.
    """

    fade: FloatArray
    dt_s: float

    @classmethod
    def over(cls, times_s: FloatArray) -> "Window":
        """Window over the times (N,) from contact."""
        return cls(fade_of(times_s), float(times_s[1] - times_s[0]))

    @property
    def samples(self) -> int:
        """Number of samples with `fade` > 0."""
        return int(np.count_nonzero(self.fade > 0))

    @cached_property
    def bands(self) -> list[slice]:
        """The coefficients of each band."""
        each_Hz = 1 / (2 * self.samples * self.dt_s)
        edges = np.minimum(np.ceil(np.array(BANDS_HZ) / each_Hz).astype(int), self.samples)
        return [slice(int(low), int(high)) for low, high in pairwise(edges) if high > low]

    @property
    def size(self) -> int:
        """K, the number of coefficients."""
        return int(self.bands[-1].stop)

    def coefficients(self, values: FloatArray) -> FloatArray:
        """(..., K) coefficients of values (..., N) that are 0 after the window."""
        found = scipy.fft.dct(values[..., : self.samples], type=2, norm="ortho")
        return np.asarray(found[..., : self.size])

    def values(self, coefficients: FloatArray) -> FloatArray:
        """(..., N) values from coefficients (..., K)."""
        whole = np.zeros((*coefficients.shape[:-1], self.samples))
        whole[..., : self.size] = coefficients
        found = np.zeros((*coefficients.shape[:-1], self.fade.size))
        found[..., : self.samples] = scipy.fft.idct(whole, type=2, norm="ortho")
        return found


@dataclass(frozen=True)
class Tapped:
    """The taps of one round at a node and the design that they played; coefficients in m/s^2.

    Attributes
    ----------
    correction_m_s2 : (N,) correction that the design was solved with.
    predicted : (K,) prediction less reference, p - r, with r the prediction of the uncorrected design.
    differences : (n, K) measured less predicted, w of each tap; n >= 2.
    reference : sum of the squares of r over the window.
    peak_current_A : largest measured current; NaN if none was measured.
    """

    correction_m_s2: FloatArray
    predicted: FloatArray
    differences: FloatArray
    reference: float
    peak_current_A: float

    @property
    def taps(self) -> int:
        return len(self.differences)

    @property
    def difference(self) -> FloatArray:
        """(K,) mean difference of all taps."""
        return np.asarray(self.differences.mean(axis=0))

    @property
    def error(self) -> FloatArray:
        """(K,) mean tap less reference."""
        return self.predicted + self.difference

    @cached_property
    def residuals(self) -> FloatArray:
        """(n, K) each tap less their mean."""
        return self.differences - self.difference

    def squared_in(self, bands: Iterable[slice]) -> float:
        """Squared error in some bands over the squares of r, less the bias due to the scatter of the taps."""
        noise = (self.residuals**2).sum(axis=0) / (self.taps - 1) / self.taps
        return sum(float((self.error**2 - noise)[band].sum()) for band in bands) / self.reference

    @property
    def playback_error(self) -> float:
        """Playback error: |a - r| / |r| in all bands."""
        return float(np.sqrt(max(self.squared_in([slice(None)]), 0.0)))

    @property
    def predicted_error(self) -> float:
        """|p - r| / |r| of the prediction p, over the window of the playback error."""
        return float(np.sqrt(self.predicted @ self.predicted / self.reference))


@dataclass(frozen=True)
class Gain:
    """The difference of two squared errors over the squares of r, and its chances.

    Attributes
    ----------
    value : reduction by the later design. deviation : its standard deviation.
    by_chance : p value of the gain; worse_by_chance : p value of a loss.
    """

    value: float
    deviation: float
    by_chance: float
    worse_by_chance: float


class Scatter:
    """Scatter between taps by band, pooled over all taps of a refinement.

    Parameters
    ----------
    all_taps : the taps of each node and round.
    """

    def __init__(self, bands: Sequence[slice], all_taps: Iterable[Tapped]) -> None:
        self._bands = bands
        residuals = [tapped.residuals for tapped in all_taps]
        self.degrees = sum(len(each) - 1 for each in residuals)
        stacked = np.concatenate(residuals) if residuals else np.zeros((0, bands[-1].stop))
        covariances = [stacked[:, band].T @ stacked[:, band] / max(self.degrees, 1) for band in bands]
        self._variance = np.array([np.trace(C) / len(C) for C in covariances])
        self._free = np.array([self._free_of(C) for C in covariances])

    def _free_of(self, covariance: FloatArray) -> float:
        """Unbiased (tr C)^2 / tr(C^2) of the true covariance from this estimate; between 1 and m.

        The trace of the square of an estimate with nu degrees of freedom is biased by (tr C)^2 / nu (Bai and
        Saranadasa 1996).
        """
        m, nu, trace = len(covariance), self.degrees, float(np.trace(covariance))
        if nu < 2 or trace == 0:
            return 1.0
        square = nu**2 / ((nu - 1) * (nu + 2)) * (float((covariance**2).sum()) - trace**2 / nu)
        return float(np.clip(trace**2 / max(square, trace**2 / m), 1.0, m))

    def _variance_of(self, tapped: Tapped) -> FloatArray:
        """(bands,) variance of one coefficient between taps."""
        own = [float((tapped.residuals[:, band] ** 2).mean()) for band in self._bands]
        return np.asarray(np.maximum(np.array(own) * tapped.taps / (tapped.taps - 1), self._variance))

    def standing_out(self, wanted: FloatArray, tapped: Tapped, among: int) -> FloatArray:
        """(K,) share of each coefficient of a mean (K,) that is signal; 0 in bands that are not significant.

        Parameters
        ----------
        wanted : mean to test; its scatter is that of the mean of these taps.
        among : number of nodes tested together; the chance of any false positive in any of their bands is at most
            `LEVEL` (Bonferroni).
        """
        part = np.zeros(wanted.size)
        tiny = np.finfo(float).tiny
        for band, variance, free in zip(self._bands, self._variance_of(tapped), self._free, strict=True):
            f = tapped.taps * float((wanted[band] ** 2).mean()) / max(variance, tiny)
            chance = scipy.stats.f.sf(f, free, free * max(self.degrees, 1))
            if chance < LEVEL / (among * len(self._bands)):
                part[band] = 1 - 1 / f
        return part

    def gain(self, before: Tapped, after: Tapped, *, where_changed: bool = False) -> Gain:
        """Gain of one design over another, from the taps of both.

        Parameters
        ----------
        where_changed : whether to use only the bands in which the prediction changed. Errors in other bands, equal in
            both designs, add scatter that hides a gain.

        The squared error of the mean of n taps has the variance 4 e'C e / n + 2 tr(C^2) / (n (n - 1)); e'C e is taken
        between that of an isotropic C and that of a C entirely along e.
        """
        changed = np.array([float(((before.predicted - after.predicted)[band] ** 2).sum()) for band in self._bands])
        used = changed >= (CHANGED * changed.sum() if where_changed else 0.0)
        bands = [band for band, is_used in zip(self._bands, used, strict=True) if is_used]
        variance = sum(float(self._variances_of_squared(tapped)[used].sum()) for tapped in (before, after))
        value = before.squared_in(bands) - after.squared_in(bands)
        deviation = float(np.sqrt(variance))
        t = value / max(deviation, float(np.finfo(float).tiny))
        degrees = max(self.degrees, 1)
        return Gain(value, deviation, float(scipy.stats.t.sf(t, degrees)), float(scipy.stats.t.cdf(t, degrees)))

    def deviation(self, tapped: Tapped) -> float:
        """Standard deviation of `Tapped.playback_error`."""
        more = float(np.sqrt(self._variances_of_squared(tapped).sum()))
        return float(np.sqrt(tapped.playback_error**2 + more)) - tapped.playback_error

    def _variances_of_squared(self, tapped: Tapped) -> FloatArray:
        """(bands,) variance of the squared error in each band."""
        n, found = tapped.taps, []
        for band, variance, free in zip(self._bands, self._variance_of(tapped), self._free, strict=True):
            m = band.stop - band.start
            along = m / free * variance * float((tapped.error[band] ** 2).sum())
            found.append(4 / n * along + 2 / (n * (n - 1)) * (m * variance) ** 2 / free)
        return np.array(found) / tapped.reference**2
