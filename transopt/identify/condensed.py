"""All lines of all trials condensed to what a likelihood needs of them: a few numbers per bin, none of it lost.

In a bin of neighbouring lines a response is a polynomial of second degree, that is, its values at three nodes. What
the lines of a trial say about these values is a normal matrix and a right side; a likelihood formed of them is that
of all lines. Transients of either end of a record are taken out first (local polynomial method: Pintelon & Schoukens
2012, System Identification, Ch. 7), and what the polynomial leaves is the noise, with no model of the device in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.identify.spectrum import (
    LEAST_LINES_OF_TRANSIENT,
    LEAST_SURPLUS,
    MOST_ORDER,
    ORDER_OF_TRANSIENT,
    Bin,
    ComplexArray,
    bins_of,
    pooled,
)

NODES = MOST_ORDER + 1
SPAN = 0.8  # the outer nodes of a bin of many lines, which reaches from -1 to 1


@dataclass(frozen=True)
class Condensed:
    """Responses from one input to o outputs in b bins, by K trials.

    Attributes
    ----------
    frequencies_Hz : (b, q) nodes; those of a bin with fewer lie in its middle and weigh nothing.
    used : (b, q) which nodes there are.
    normal : (K, b, q, q) complex, of the responses at the nodes; the same for every output.
    right : (K, o, b, q) complex.
    noise : (o, b) variance of a line of the output.
    degrees : (o, b) real degrees of freedom in it.
    known : (o, b) where an output can be relied upon; the others do not count.
    """

    frequencies_Hz: FloatArray
    used: NDArray[np.bool_]
    normal: ComplexArray
    right: ComplexArray
    noise: FloatArray
    degrees: FloatArray
    known: NDArray[np.bool_]

    def values(self) -> ComplexArray:
        """(o, b, q) responses at the nodes by themselves; 0 where there is no node."""
        whole = self.normal.sum(axis=0) + np.where(self.used, 0.0, 1.0)[:, :, None] * np.eye(NODES)
        return np.asarray(np.linalg.solve(whole, self.right.sum(axis=0)[..., None])[..., 0])

    def roots(self) -> ComplexArray:
        """(o, b, q, q) W with W^H W = 2 normal / noise: both parts of W times a response's error have variance 1."""
        whole = self.normal.sum(axis=0) + np.where(self.used, 0.0, 1.0)[:, :, None] * np.eye(NODES)
        root = np.conj(np.swapaxes(np.linalg.cholesky(whole), 1, 2)) * self.used[:, :, None]
        return np.asarray(root * (self.known * np.sqrt(2 / self.noise))[:, :, None, None])

    def every(self, step: int) -> "Condensed":
        """Each `step`-th bin."""
        some = slice(step // 2, None, step)
        return Condensed(
            self.frequencies_Hz[some],
            self.used[some],
            self.normal[:, some],
            self.right[:, :, some],
            self.noise[:, some],
            self.degrees[:, some],
            self.known[:, some],
        )


def condense(inputs: Sequence[FloatArray], outputs: Sequence[FloatArray], dt_s: float) -> Condensed:
    """Condense trials.

    Parameters
    ----------
    inputs : (n,) of each trial, from rest to rest, without noise.
    outputs : (o, n) of each trial.

    Raises
    ------
    InputError : records too short.
    """
    bins = bins_of(inputs, outputs, dt_s)
    if not bins:
        shortest = min(given.size for given in inputs) * dt_s
        raise InputError(f"records of {shortest:g} s are too short for a spectrum; sweep longer")
    K, o = len(inputs), outputs[0].shape[0]
    frequencies, used = np.empty((len(bins), NODES)), np.zeros((len(bins), NODES), dtype=bool)
    normal = np.zeros((K, len(bins), NODES, NODES), dtype=complex)
    right = np.zeros((K, o, len(bins), NODES), dtype=complex)
    noise, degrees = np.empty((o, len(bins))), np.empty(len(bins))
    for b, one in enumerate(bins):
        nodes, shapes = _basis(one)
        middle, reach = one.frequency_Hz.mean(), np.abs(one.frequency_Hz - one.frequency_Hz.mean()).max()
        q = nodes.size
        frequencies[b], used[b, :q] = middle, True
        frequencies[b, :q] += reach * nodes
        outs, surplus = one.outputs.copy(), one.input.size - q
        basis: ComplexArray = shapes * one.input[:, None]
        if one.input.size >= LEAST_LINES_OF_TRANSIENT * K:
            ends = one.places[:, None] ** np.arange(ORDER_OF_TRANSIENT + 1)
            for k in range(K):
                of = one.trial == k
                Q, _ = np.linalg.qr(ends[of])
                basis[of] -= Q @ (Q.T @ basis[of])
                outs[of] -= Q @ (Q.T @ outs[of])
            surplus -= K * ends.shape[1]
        for k in range(K):
            of = one.trial == k
            adjoint = basis[of].conj().T
            normal[k, b, :q, :q], right[k, :, b, :q] = adjoint @ basis[of], (adjoint @ outs[of]).T
        Q, _ = np.linalg.qr(basis)
        noise[:, b] = np.sum(np.abs(outs - Q @ (Q.conj().T @ outs)) ** 2, axis=0) / surplus
        degrees[b] = 2.0 * surplus
    middles = frequencies.mean(axis=1)
    spread = [pooled(middles, one, degrees) for one in noise]
    least = np.finfo(float).eps ** 2 * np.array([np.mean(np.abs(right[:, j]) ** 2) for j in range(o)])
    return Condensed(
        frequencies_Hz=frequencies,
        used=used,
        normal=normal,
        right=right,
        noise=np.maximum([one for one, _ in spread], least[:, None] + np.finfo(float).tiny),
        degrees=np.array([of for _, of in spread]),
        known=np.ones((o, len(bins)), dtype=bool),
    )


def _basis(one: Bin) -> tuple[FloatArray, FloatArray]:
    """(q,) nodes from -1 to 1 and (s, q) the polynomials that are 1 at one of them and 0 at the others."""
    x = one.places
    distinct = np.unique(np.round(x, 9))
    order = min(MOST_ORDER, distinct.size - 1, x.size - 1 - LEAST_SURPLUS)
    if distinct.size == order + 1:
        nodes = distinct  # nothing between the lines is asked for
    else:
        nodes = SPAN * np.array({0: [0.0], 1: [-1.0, 1.0], 2: [-1.0, 0.0, 1.0]}[order])
    columns = [
        np.prod([(x - other) / (node - other) for other in nodes if other != node] or [np.ones(x.size)], axis=0)
        for node in nodes
    ]
    return nodes, np.stack(columns, axis=1)
