"""All lines of all trials condensed to what a likelihood needs of them: a few numbers per bin, none of it lost.

A record from rest to rest has an exact plain DFT: Y_k(f) = G(f) U_k(f) + V_k(f), without a window, and the noise V of
different lines is independent. In a bin of neighbouring lines a response is a polynomial of second degree, that is,
its values at three nodes. What the lines of a trial say about these values is a normal matrix and a right side; a
likelihood formed of them is that of all lines. Transients of either end of a record are taken out first (local
polynomial method: Pintelon & Schoukens 2012, System Identification, Ch. 7), and what the polynomial leaves is the
noise, with no model of the device in it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

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

    def some(self, bins: slice = slice(None), outputs: slice = slice(None)) -> "Condensed":
        """Some of the bins and of the outputs."""
        return Condensed(
            middles_Hz=self.middles_Hz[bins],
            frequencies_Hz=self.frequencies_Hz[bins],
            used=self.used[bins],
            normal=self.normal[:, bins],
            right=self.right[:, outputs, bins],
            residual=self.residual[bins, outputs, outputs],
            surplus=self.surplus[bins],
            power=self.power[outputs, bins],
            noise=self.noise[outputs, bins],
            degrees=self.degrees[outputs, bins],
            known=self.known[outputs, bins],
            dt_s=self.dt_s,
        )


@dataclass(frozen=True)
class _Bin:
    """Lines of all trials in one bin.

    Attributes
    ----------
    frequency_Hz : (s,).
    input : (s,) spectrum.
    outputs : (s, o) spectra.
    trial : (s,) number of the trial.
    """

    frequency_Hz: FloatArray
    input: ComplexArray
    outputs: ComplexArray
    trial: NDArray[np.int_]

    @property
    def places(self) -> FloatArray:
        """(s,) where the lines lie in the bin, from -1 to 1."""
        off = self.frequency_Hz - self.frequency_Hz.mean()
        return np.asarray(off / max(float(np.abs(off).max()), np.finfo(float).tiny))


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
    bins = _bins(inputs, outputs, dt_s)
    if not bins:
        shortest = min(given.size for given in inputs) * dt_s
        raise InputError(f"records of {shortest:g} s are too short for a spectrum; sweep longer")
    K, o = len(inputs), outputs[0].shape[0]
    middles, surplus = np.array([one.frequency_Hz.mean() for one in bins]), np.empty(len(bins))
    frequencies, used = np.repeat(middles[:, None], NODES, axis=1), np.zeros((len(bins), NODES), dtype=bool)
    normal = np.zeros((K, len(bins), NODES, NODES), dtype=complex)
    right = np.zeros((K, o, len(bins), NODES), dtype=complex)
    residual, power = np.empty((len(bins), o, o), dtype=complex), np.empty((o, len(bins)))
    for b, one in enumerate(bins):
        nodes, shapes = _basis(one)
        q = nodes.size
        used[b, :q] = True
        frequencies[b, :q] += np.abs(one.frequency_Hz - middles[b]).max() * nodes
        outs, surplus[b] = one.outputs.copy(), one.input.size - q
        power[:, b] = np.mean(np.abs(outs) ** 2, axis=0)
        basis: ComplexArray = shapes * one.input[:, None]
        if one.input.size >= LEAST_LINES_OF_TRANSIENT * K:
            ends = one.places[:, None] ** np.arange(ORDER_OF_TRANSIENT + 1)
            for k in range(K):
                of = one.trial == k
                Q, _ = np.linalg.qr(ends[of])
                basis[of] -= Q @ (Q.T @ basis[of])
                outs[of] -= Q @ (Q.T @ outs[of])
            surplus[b] -= K * ends.shape[1]
        for k in range(K):
            of = one.trial == k
            adjoint = basis[of].conj().T
            normal[k, b, :q, :q], right[k, :, b, :q] = adjoint @ basis[of], (adjoint @ outs[of]).T
        Q, _ = np.linalg.qr(basis)
        left = outs - Q @ (Q.conj().T @ outs)
        residual[b] = left.T @ left.conj() / surplus[b]
    own = np.einsum("boo->ob", residual).real
    spread = [pooled(middles, one, 2 * surplus) for one in own]
    least = np.finfo(float).eps ** 2 * np.array([np.mean(np.abs(right[:, j]) ** 2) for j in range(o)])
    return Condensed(
        middles_Hz=middles,
        frequencies_Hz=frequencies,
        used=used,
        normal=normal,
        right=right,
        residual=residual,
        surplus=surplus,
        power=power,
        noise=np.maximum([one for one, _ in spread], least[:, None] + np.finfo(float).tiny),
        degrees=np.array([of for _, of in spread]),
        known=np.ones((o, len(bins)), dtype=bool),
        dt_s=dt_s,
    )


def _bins(inputs: Sequence[FloatArray], outputs: Sequence[FloatArray], dt_s: float) -> list[_Bin]:
    """All lines between 0 and half the rate, both exclusive, in bins of at least as many as a fit needs.

    A bin is a 24th of an octave wide where the lines are dense; elsewhere it takes as many lines as it needs, one
    with at least six trials of one length. Bins count where the input's energy per octave is at least 3 % of its
    highest, and between two such.
    """
    lengths = [given.size for given in inputs]
    spacing = 1 / (min(lengths) * dt_s)
    needed = -(-(MOST_ORDER + 1 + LEAST_SURPLUS) // len(inputs))
    if max(lengths) != min(lengths):
        needed = max(needed, 2)  # lines of different trials at different frequencies: no mean without a slope
    spectra: list[tuple[FloatArray, ComplexArray, ComplexArray, NDArray[np.int_]]] = []
    for j, (given, answers) in enumerate(zip(inputs, outputs, strict=True)):
        lines = np.arange(1, (lengths[j] + 1) // 2)
        size = np.sqrt(lengths[j])  # noise of one variance whatever the length
        spectrum: ComplexArray = np.fft.rfft(given)[lines] / size
        read: ComplexArray = np.fft.rfft(answers)[:, lines].T / size
        spectra.append((lines / (lengths[j] * dt_s), spectrum, read, np.full(lines.size, j)))
    frequency = np.concatenate([one[0] for one in spectra])
    order = np.argsort(frequency, kind="stable")
    frequency = frequency[order]
    excitation, answer, trial_of = (np.concatenate([one[j] for one in spectra])[order] for j in (1, 2, 3))
    bins: list[_Bin] = []
    low = 0.5 * spacing
    while True:
        high = max(low * 2 ** (1 / BINS_PER_OCTAVE), low + needed * spacing)
        if high > 0.5 / dt_s:  # a rest of the lines just below half the rate would be a bin too small
            break
        inside = slice(*np.searchsorted(frequency, [low, high]).tolist())
        if trial_of[inside].size >= LEAST_SURPLUS + 1 and np.unique(trial_of[inside]).size == len(inputs):
            bins.append(_Bin(frequency[inside], excitation[inside], answer[inside], trial_of[inside]))
        low = high
    middle = np.array([one.frequency_Hz.mean() for one in bins])
    energy = middle * np.array([np.mean(np.abs(one.input) ** 2) for one in bins])
    strong = np.flatnonzero(energy >= EXCITED * energy.max(initial=0.0))
    return bins[strong[0] : strong[-1] + 1] if strong.size else []


def _basis(one: _Bin) -> tuple[FloatArray, FloatArray]:
    """(q,) nodes from -1 to 1 and (s, q) the polynomials that are 1 at one of them and 0 at the others."""
    x = one.places
    distinct = np.unique(np.round(x, 9))
    order = min(MOST_ORDER, distinct.size - 1, x.size - 1 - LEAST_SURPLUS)
    if distinct.size == order + 1:
        nodes = distinct  # nothing between the lines is asked for
    else:
        nodes = SPAN * np.array({0: [0.0], 1: [-1.0, 1.0], 2: [-1.0, 0.0, 1.0]}[order])
    return nodes, lagrange(nodes, x)


def lagrange(nodes: FloatArray, places: FloatArray) -> FloatArray:
    """(s, q) at the places (s,) the polynomials that are 1 at one of the nodes (q,) and 0 at the others."""
    columns = [
        np.prod([(places - other) / (node - other) for other in nodes if other != node] or [np.ones(places.size)], 0)
        for node in nodes
    ]
    return np.stack(columns, axis=1)


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
