"""All lines of all trials condensed to what a likelihood needs of them: a few numbers per bin, none of it lost.

A record from rest to rest has an exact plain DFT: Y_k(f) = G(f) U_k(f) + V_k(f), without a window, and the noise V of
different lines is independent. In a bin of neighbouring lines a response is a polynomial of second degree, that is,
its values at three nodes. What the lines of a trial say about these values is a normal matrix and a right side; a
likelihood formed of them is that of all lines. Transients of either end of a record are taken out first (local
polynomial method: Pintelon & Schoukens 2012, System Identification, Ch. 7), and what the polynomial leaves is the
noise, with no model of the device in it.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft, special

from transopt.base.errors import InputError
from transopt.base.signals import ComplexArray, FloatArray

BINS_PER_OCTAVE = 24
MOST_ORDER = 2  # of the local polynomial: curvature across a bin is followed, not averaged
NODES = MOST_ORDER + 1
SPAN = 0.8  # the outer nodes of a bin of many lines, which reaches from -1 to 1
LEAST_LINES_OF_TRANSIENT, ORDER_OF_TRANSIENT = 16, 1  # of each trial in a bin, from where its transient can be fitted
LEAST_SURPLUS = 3  # samples in a bin beyond the polynomial's coefficients, to estimate the noise from
EXCITED = 0.03  # of the strongest energy per octave: below, a bin counts as not excited
OCTAVES_OF_NOISE = 0.25  # to either side: over which the noise is averaged
LEAST_NEIGHBOURS = 2  # to either side: the lowest bins are further apart than that
ODD_ONE_OUT = 1e-3  # chance at which a bin's own noise is taken for higher than its neighbours'


@dataclass(frozen=True)
class Condensed:
    """Responses from one input to o outputs in b bins, by K trials. No line is in two bins.

    Attributes
    ----------
    middles_Hz : (b,) mean frequency of the lines of each bin, strictly increasing.
    frequencies_Hz : (b, q) nodes; those of a bin with fewer lie in its middle and weigh nothing.
    used : (b, q) which nodes there are.
    middle : (b, q) weights of the responses at the nodes in that at `middles_Hz`.
    normal : (K, b, q, q) complex, of the responses at the nodes; the same for every output.
    right : (K, o, b, q) complex.
    residual : (b, o, o) complex, covariance of what the polynomial leaves of a line of the outputs.
    surplus : (b,) lines beyond the coefficients of the polynomial and of the transients.
    power : (o, b) mean square of a line of the output.
    noise : (o, b) variance of a line of the output, the neighbours' residuals taken in.
    degrees : (o, b) real degrees of freedom in it.
    known : (o, b) where an output can be relied upon; the others do not count.
    dt_s : sampling period of the records.
    """

    middles_Hz: FloatArray
    frequencies_Hz: FloatArray
    used: NDArray[np.bool_]
    middle: FloatArray
    normal: ComplexArray
    right: ComplexArray
    residual: ComplexArray
    surplus: FloatArray
    power: FloatArray
    noise: FloatArray
    degrees: FloatArray
    known: NDArray[np.bool_]
    dt_s: float

    @property
    def whole(self) -> ComplexArray:
        """(b, q, q) normal matrices of all trials together; one on the diagonal where there is no node."""
        return np.asarray(self.normal.sum(axis=0) + np.where(self.used, 0.0, 1.0)[:, :, None] * np.eye(NODES))

    def values(self) -> ComplexArray:
        """(o, b, q) responses at the nodes by themselves; 0 where there is no node."""
        return np.asarray(np.linalg.solve(self.whole, self.right.sum(axis=0)[..., None])[..., 0])

    def roots(self) -> ComplexArray:
        """(o, b, q, q) W with W^H W = 2 normal / noise: both parts of W times a response's error have variance 1."""
        root = np.conj(np.swapaxes(np.linalg.cholesky(self.whole), 1, 2)) * self.used[:, :, None]
        return np.asarray(root * (self.known * np.sqrt(2 / self.noise))[:, :, None, None])

    def moved(self) -> "Condensed":
        """Without the bins at either end where the transients leave next to nothing of the input."""
        left = self.normal.sum(axis=(0, 2, 3)).real / self.surplus
        return self.some(excited(self.middles_Hz * left))

    def some(self, bins: slice = slice(None), outputs: slice = slice(None)) -> "Condensed":
        """Some of the bins and of the outputs."""
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

    The polarity of a trial drops out, since the spectra of input and output change sign together; what does not
    change sign with the input, distortion of even order, cancels between trials of either polarity. Harmonics of a
    sweep arrive at other times than the fundamental, so that their phase turns from line to line: they count as noise
    and average out.

    Parameters
    ----------
    inputs : (n,) of each trial, from rest to rest, without noise.
    outputs : (o, n) of each trial.

    Raises
    ------
    InputError : records too short.
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
) -> tuple[FloatArray, ComplexArray, ComplexArray, NDArray[np.int_]]:
    """All lines between 0 and half the rate, both exclusive, bin by bin and in each of them trial by trial.

    A bin is a 24th of an octave wide where the lines are dense; elsewhere it takes as many lines as a fit needs, one
    with at least six trials of one length.

    Returns
    -------
    (s,) frequencies, (s, 1) spectrum of the input, (s, o) of the outputs, and (bins, K + 1) where the lines of each
    trial begin and those of the last one end: of bins with lines enough of every trial, where the input excites.
    """
    lengths, K = np.array([one.size for one in inputs]), len(inputs)
    numbers = [np.arange(1, (length + 1) // 2) for length in lengths]
    frequency = np.concatenate([lines / (length * dt_s) for lines, length in zip(numbers, lengths, strict=True)])
    spacing, needed = 1 / (lengths.min() * dt_s), -(-(MOST_ORDER + 1 + LEAST_SURPLUS) // K)
    if lengths.max() != lengths.min():
        needed = max(needed, 2)  # lines of different trials at different frequencies: no mean without a slope
    edges = [0.5 * spacing]
    while edges[-1] <= 0.5 / dt_s:
        edges.append(max(edges[-1] * 2 ** (1 / BINS_PER_OCTAVE), edges[-1] + needed * spacing))
    # Bin 0 is below all others; what is left just below half the rate would be a bin too small.
    number, bins = np.searchsorted(edges[:-1], frequency, side="right"), max(len(edges) - 2, 0)
    trial = np.repeat(np.arange(K), [lines.size for lines in numbers])
    order = np.lexsort((trial, number))
    ends = np.cumsum(np.bincount(number * K + trial, minlength=(bins + 2) * K))
    starts = ends[K - 1 + np.arange(bins)[:, None] * K + np.arange(K + 1)]
    count = np.diff(starts, axis=1)
    starts = starts[(count.sum(axis=1) > LEAST_SURPLUS) & np.all(count > 0, axis=1)]

    def spectra(signals: Sequence[FloatArray]) -> ComplexArray:
        """Noise has one variance in the spectra at every length; scipy keeps its plan for a length, prime or not."""
        each = zip(signals, numbers, lengths, strict=True)
        return np.concatenate([fft.rfft(one)[:, lines].T / np.sqrt(length) for one, lines, length in each])[order]

    frequency, given = frequency[order], spectra([one[None] for one in inputs])
    inside = [slice(first[0], first[-1]) for first in starts]
    energy = np.array([frequency[one].mean() * np.mean(np.abs(given[one]) ** 2) for one in inside])
    return frequency, given, spectra(outputs), starts[excited(energy)]


def excited(energy: FloatArray) -> slice:
    """From the first to the last bin whose energy per octave is at least 3 % of its highest."""
    strong = np.flatnonzero(energy >= EXCITED * energy.max(initial=0.0))
    return slice(strong[0], strong[-1] + 1) if strong.size else slice(0)


def _nodes(places: FloatArray) -> FloatArray:
    """(q,) of a bin's polynomial, from -1 to 1, for lines at these places (s,)."""
    distinct = np.unique(np.round(places, 9))
    order = min(MOST_ORDER, distinct.size - 1, places.size - 1 - LEAST_SURPLUS)
    if distinct.size == order + 1:
        return distinct  # nothing between the lines is asked for
    return np.linspace(-SPAN, SPAN, order + 1) if order else np.zeros(1)


def _lagrange(nodes: FloatArray, places: FloatArray) -> FloatArray:
    """(s, q) at the places (s,) the polynomials that are 1 at one of the nodes (q,) and 0 at the others."""
    itself = np.eye(nodes.size)
    factors = (places[:, None, None] - nodes) / (nodes[:, None] - nodes + itself)
    return np.asarray(np.prod(np.where(itself, 1.0, factors), axis=2))


def around(frequencies_Hz: FloatArray, octaves: float, least: int = 0) -> Callable[[FloatArray], FloatArray]:
    """Sums over the bins within so many octaves of each, and over at least so many to either side."""
    place, number = np.log2(frequencies_Hz), np.arange(frequencies_Hz.size)
    first = np.minimum(np.searchsorted(place, place - octaves), np.maximum(number - least, 0))
    last = np.searchsorted(place, place + octaves, side="right")
    last = np.maximum(last, np.minimum(number + least + 1, number.size))

    def summed(values: FloatArray) -> FloatArray:
        total = np.concatenate([[0.0], np.cumsum(values)])
        return np.asarray(total[last] - total[first])

    return summed


def pooled(frequencies_Hz: FloatArray, noise: FloatArray, degrees: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(m,) variances of the noise and their degrees of freedom, the neighbours' residuals taken in.

    A bin of few lines knows its noise badly, and weights that follow such luck make fits overconfident. A bin that
    stands out of its neighbours (the mains' hum) keeps its own.
    """
    summed = around(frequencies_Hz, OCTAVES_OF_NOISE, LEAST_NEIGHBOURS)
    together = summed(degrees)
    pooled = summed(noise * degrees) / together
    apart = noise > pooled * special.fdtri(degrees, together, 1 - ODD_ONE_OUT)
    return np.where(apart, noise, pooled), np.where(apart, degrees, together)
