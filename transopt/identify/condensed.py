"""All spectral lines of all trials condensed, without loss, to the few numbers per bin that a likelihood needs.

A record from rest to rest has an exact plain DFT: Y_k(f) = G(f) U_k(f) + V_k(f), without a window, and the noise V of
different lines is independent. Within a bin of neighbouring lines the response is taken for a polynomial of second
degree, given by its values at three nodes. The lines of a trial determine these values through a normal matrix and a
right side; a likelihood formed of these equals that of all lines. The transients at both ends of a record are removed
first (local polynomial method: Pintelon & Schoukens 2012, System Identification, Ch. 7). The residual of the
polynomial estimates the noise, without any model of the device.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft, special

from transopt.base.errors import InputError
from transopt.base.signals import BoolArray, ComplexArray, FloatArray, IndexArray

BINS_PER_OCTAVE = 24
MOST_ORDER = 2  # largest degree of the local polynomial: curvature across a bin is followed, not averaged
NODES = MOST_ORDER + 1
SPAN = 0.8  # place of the outer nodes in a bin of many lines, which reaches from -1 to 1
LEAST_LINES_OF_TRANSIENT, ORDER_OF_TRANSIENT = 16, 1  # lines per trial in a bin to fit a transient; its degree
LEAST_SURPLUS = 3  # lines in a bin beyond the polynomial's coefficients, to estimate the noise from
EXCITED = 0.03  # share of the largest energy per octave below which a bin counts as not excited
OCTAVES_OF_NOISE = 0.25  # to either side of a bin over which the noise is averaged
LEAST_NEIGHBOURS = 2  # bins to either side that are averaged at least, since the lowest bins are far apart
ODD_ONE_OUT = 1e-3  # significance level at which a bin's noise counts as higher than its neighbours'


@dataclass(frozen=True)
class Condensed:
    """Condensed data of K trials: responses from one input to o outputs in b bins, each line in one bin only.

    Attributes
    ----------
    middles_Hz : (b,) mean frequency of the lines of each bin, strictly increasing.
    frequencies_Hz : (b, q) nodes; an unused node lies in the middle of its bin and has weight zero.
    used : (b, q) whether a node is used.
    middle : (b, q) weights that interpolate the response at `middles_Hz` from those at the nodes.
    normal : (K, b, q, q) complex normal matrices of the responses at the nodes, common to all outputs.
    right : (K, o, b, q) complex right sides.
    residual : (b, o, o) complex covariance of the polynomial's residual per line, over the outputs.
    surplus : (b,) number of lines beyond the coefficients of the polynomial and of the transients.
    power : (o, b) mean square of a line of the output.
    noise : (o, b) noise variance of a line of the output, pooled with the neighbouring bins.
    degrees : (o, b) real degrees of freedom of `noise`.
    known : (o, b) whether an output is reliable in a bin; if not, the bin does not count for it.
    dt_s : sampling period of the records.
    """

    middles_Hz: FloatArray
    frequencies_Hz: FloatArray
    used: BoolArray
    middle: FloatArray
    normal: ComplexArray
    right: ComplexArray
    residual: ComplexArray
    surplus: FloatArray
    power: FloatArray
    noise: FloatArray
    degrees: FloatArray
    known: BoolArray
    dt_s: float

    @property
    def whole(self) -> ComplexArray:
        """(b, q, q) normal matrices summed over the trials; one on the diagonal for an unused node."""
        return np.asarray(self.normal.sum(axis=0) + np.where(self.used, 0.0, 1.0)[:, :, None] * np.eye(NODES))

    def values(self) -> ComplexArray:
        """(o, b, q) responses at the nodes by least squares; 0 at an unused node."""
        return np.asarray(np.linalg.solve(self.whole, self.right.sum(axis=0)[..., None])[..., 0])

    def roots(self) -> ComplexArray:
        """(o, b, q, q) W with W^H W = 2 normal / noise: both parts of W times a response's error have variance 1."""
        root = np.conj(np.swapaxes(np.linalg.cholesky(self.whole), 1, 2)) * self.used[:, :, None]
        return np.asarray(root * (self.known * np.sqrt(2 / self.noise))[:, :, None, None])

    def moved(self) -> "Condensed":
        """A copy without the outer bins in which removing the transients leaves next to no input."""
        left = self.normal.sum(axis=(0, 2, 3)).real / self.surplus
        return self.some(excited(self.middles_Hz * left))

    def some(self, bins: slice = slice(None), outputs: slice = slice(None)) -> "Condensed":
        """A copy with only these bins and outputs."""
        by_bin = ("middles_Hz", "frequencies_Hz", "used", "middle", "surplus")
        by_output = ("power", "noise", "degrees", "known")
        return replace(
            self,
            normal=self.normal[:, bins],
            right=self.right[:, outputs, bins],
            residual=self.residual[bins, outputs, outputs],
            **{name: getattr(self, name)[bins] for name in by_bin},
            **{name: getattr(self, name)[outputs, bins] for name in by_output},
        )


def condense(inputs: Sequence[FloatArray], outputs: Sequence[FloatArray], dt_s: float) -> Condensed:
    """Condense trials.

    The polarity of a trial has no effect, since the spectra of input and output change sign together. Distortion of
    even order does not change sign with the input, so it cancels between trials of opposite polarity. Harmonics of a
    sweep occur at other times than the fundamental, so their phase varies from line to line: they count as noise and
    average out.

    Parameters
    ----------
    inputs : (n,) samples of each trial, from rest to rest, without noise.
    outputs : (o, n) samples of each trial.

    Raises
    ------
    InputError : the records are too short.
    """
    lines_Hz, given, answers, bins = _lines(inputs, outputs, dt_s)
    if not bins.size:
        shortest = min(one.size for one in inputs) * dt_s
        raise InputError(f"records of {shortest:g} s are too short for a spectrum; sweep longer")
    K, B, o = len(inputs), len(bins), outputs[0].shape[0]
    frequencies, used = np.empty((B, NODES)), np.zeros((B, NODES), dtype=bool)
    normal, right = np.zeros((K, B, NODES, NODES), dtype=complex), np.zeros((K, o, B, NODES), dtype=complex)
    middles, middle, surplus, power = np.empty(B), np.zeros((B, NODES)), np.empty(B), np.empty((o, B))
    residual = np.empty((B, o, o), dtype=complex)
    for b, starts in enumerate(bins):
        inside, trials = slice(starts[0], starts[-1]), list(itertools.pairwise(starts - starts[0]))
        frequency, outs = lines_Hz[inside], answers[inside]
        middles[b], power[:, b] = frequency.mean(), np.mean(np.abs(outs) ** 2, axis=0)
        reach = max(float(np.abs(frequency - middles[b]).max()), np.finfo(float).tiny)
        places = (frequency - middles[b]) / reach
        nodes = _nodes(places)
        q = nodes.size
        used[b, :q], middle[b, :q], frequencies[b] = True, _lagrange(nodes, np.zeros(1))[0], middles[b]
        frequencies[b, :q] += reach * nodes
        surplus[b] = places.size - q
        both: ComplexArray = np.hstack([_lagrange(nodes, places) * given[inside], outs])
        if places.size >= LEAST_LINES_OF_TRANSIENT * K:
            for first, end in trials:
                ends, _ = np.linalg.qr(places[first:end, None] ** np.arange(ORDER_OF_TRANSIENT + 1))
                both[first:end] -= ends @ (ends.T @ both[first:end])
            surplus[b] -= K * (ORDER_OF_TRANSIENT + 1)
        basis, outs = both[:, :q], both[:, q:]
        for k, (first, end) in enumerate(trials):
            products = basis[first:end].conj().T @ both[first:end]
            normal[k, b, :q, :q], right[k, :, b, :q] = products[:, :q], products[:, q:].T
        Q, _ = np.linalg.qr(basis)
        left = outs - Q @ (Q.conj().T @ outs)
        residual[b] = left.T @ left.conj() / surplus[b]
    spread = [pooled(middles, own, 2 * surplus) for own in np.einsum("boo->ob", residual).real]
    least = np.finfo(float).eps ** 2 * np.mean(np.abs(right) ** 2, axis=(0, 2, 3)) + np.finfo(float).tiny
    return Condensed(
        middles_Hz=middles,
        frequencies_Hz=frequencies,
        used=used,
        middle=middle,
        normal=normal,
        right=right,
        residual=residual,
        surplus=surplus,
        power=power,
        noise=np.maximum([noise for noise, _ in spread], least[:, None]),
        degrees=np.array([degrees for _, degrees in spread]),
        known=np.ones((o, B), dtype=bool),
        dt_s=dt_s,
    )


def _lines(
    inputs: Sequence[FloatArray], outputs: Sequence[FloatArray], dt_s: float
) -> tuple[FloatArray, ComplexArray, ComplexArray, IndexArray]:
    """All lines between 0 and half the sampling rate, both exclusive, sorted by bin and within a bin by trial.

    A bin is a 24th of an octave wide where the lines are dense. Elsewhere it takes as many lines as a fit needs: one
    of each trial if there are at least six trials of equal length.

    Returns
    -------
    (s,) frequencies, (s, 1) spectrum of the input, (s, o) of the outputs, and (bins, K + 1) indices at which each
    trial's lines begin and those of the last one end. Bins that lack lines or excitation are left out.
    """
    lengths, K = np.array([one.size for one in inputs]), len(inputs)
    numbers = [np.arange(1, (length + 1) // 2) for length in lengths]
    frequency = np.concatenate([lines / (length * dt_s) for lines, length in zip(numbers, lengths, strict=True)])
    spacing, needed = 1 / (lengths.min() * dt_s), -(-(MOST_ORDER + 1 + LEAST_SURPLUS) // K)
    if lengths.max() != lengths.min():
        needed = max(needed, 2)  # the trials' lines then differ in frequency, so that a mean needs a slope too
    edges = [0.5 * spacing]
    while edges[-1] <= 0.5 / dt_s:
        edges.append(max(edges[-1] * 2 ** (1 / BINS_PER_OCTAVE), edges[-1] + needed * spacing))
    # Bin 0 lies below all others; the remainder just below half the rate is too narrow for a bin.
    number, bins = np.searchsorted(edges[:-1], frequency, side="right"), max(len(edges) - 2, 0)
    trial = np.repeat(np.arange(K), [lines.size for lines in numbers])
    order = np.lexsort((trial, number))
    ends = np.cumsum(np.bincount(number * K + trial, minlength=(bins + 2) * K))
    starts = ends[K - 1 + np.arange(bins)[:, None] * K + np.arange(K + 1)]
    count = np.diff(starts, axis=1)
    starts = starts[(count.sum(axis=1) > LEAST_SURPLUS) & np.all(count > 0, axis=1)]

    def spectra(signals: Sequence[FloatArray]) -> ComplexArray:
        """Spectra scaled so that the noise has the same variance at every length of record."""
        each = zip(signals, numbers, lengths, strict=True)
        return np.concatenate([fft.rfft(one)[:, lines].T / np.sqrt(length) for one, lines, length in each])[order]

    frequency, given = frequency[order], spectra([one[None] for one in inputs])
    inside = [slice(first[0], first[-1]) for first in starts]
    energy = np.array([frequency[one].mean() * np.mean(np.abs(given[one]) ** 2) for one in inside])
    return frequency, given, spectra(outputs), starts[excited(energy)]


def excited(energy: FloatArray) -> slice:
    """The bins from the first to the last whose energy per octave is at least `EXCITED` of the largest."""
    strong = np.flatnonzero(energy >= EXCITED * energy.max(initial=0.0))
    return slice(strong[0], strong[-1] + 1) if strong.size else slice(0)


def _nodes(places: FloatArray) -> FloatArray:
    """(q,) nodes of a bin's polynomial, from -1 to 1, for lines at these places (s,)."""
    distinct = np.unique(np.round(places, 9))
    order = min(MOST_ORDER, distinct.size - 1, places.size - 1 - LEAST_SURPLUS)
    if distinct.size == order + 1:
        return distinct  # the polynomial is evaluated at the lines only
    return np.linspace(-SPAN, SPAN, order + 1) if order else np.zeros(1)


def _lagrange(nodes: FloatArray, places: FloatArray) -> FloatArray:
    """(s, q) Lagrange polynomials of the nodes (q,), evaluated at the places (s,)."""
    itself = np.eye(nodes.size)
    factors = (places[:, None, None] - nodes) / (nodes[:, None] - nodes + itself)
    return np.asarray(np.prod(np.where(itself, 1.0, factors), axis=2))


def summed_around(frequencies_Hz: FloatArray, octaves: float, least: int = 0) -> Callable[[FloatArray], FloatArray]:
    """A function that sums values over the bins within `octaves` of each bin, at least `least` to either side."""
    place, number = np.log2(frequencies_Hz), np.arange(frequencies_Hz.size)
    first = np.minimum(np.searchsorted(place, place - octaves), np.maximum(number - least, 0))
    last = np.searchsorted(place, place + octaves, side="right")
    last = np.maximum(last, np.minimum(number + least + 1, number.size))

    def summed(values: FloatArray) -> FloatArray:
        total = np.concatenate([[0.0], np.cumsum(values)])
        return np.asarray(total[last] - total[first])

    return summed


def pooled(frequencies_Hz: FloatArray, noise: FloatArray, degrees: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(m,) variances of the noise, pooled with the neighbouring bins, and their degrees of freedom.

    A bin of few lines estimates its noise poorly, and weights from such estimates make fits overconfident. A bin with
    significantly more noise than its neighbours (mains hum) keeps its own estimate.
    """
    summed = summed_around(frequencies_Hz, OCTAVES_OF_NOISE, LEAST_NEIGHBOURS)
    together = summed(degrees)
    pooled = summed(noise * degrees) / together
    apart = noise > pooled * special.fdtri(degrees, together, 1 - ODD_ONE_OUT)
    return np.where(apart, noise, pooled), np.where(apart, degrees, together)
