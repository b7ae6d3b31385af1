"""Recursions over the stages, compiled where there is a compiler, else as banded triangular systems.

The recursion x_(k+1) = P_k x_k + f_k with m states, written for all k at once, is a unit lower triangular system with
2 m - 1 diagonals below the main one. BLAS solves it with the recursion's own products and sums, in a fiftieth of the
time that a loop in Python takes; `native/recursions.c`, which does little else, in a fifth of that. The extension is
optional, and both round differently in the last bits.
"""

import ctypes as ct
import os
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.linalg import blas

from transopt.base.signals import FloatArray

CHUNK = 128  # stages that one constant band spans
EXTENSION = "_recursions.pyd" if os.name == "nt" else "_recursions.so"
MOST_STATES = 64  # of recursions.c


def _library() -> ct.CDLL | None:
    file = Path(__file__).with_name("native") / EXTENSION
    if not file.exists():
        return None
    library = ct.CDLL(str(file))
    if not hasattr(library, "tr_strike") or library.tr_most_states() != MOST_STATES:
        return None  # left behind by another version: as good as none
    library.tr_strike.restype = None
    library.tr_strike.argtypes = (ct.c_size_t, ct.c_int, ct.c_size_t, *(ct.c_void_p,) * 7)
    for call in (library.tr_run, library.tr_forwards, library.tr_backwards):
        call.restype, call.argtypes = None, (ct.c_size_t, ct.c_int, ct.c_void_p, ct.c_void_p)
    return library


COMPILED = _library()


class Recursion:
    """x_k = A x_(k-1) + forcing_k, the matrix A (m, m) being the same at every stage."""

    def __init__(self, A: FloatArray) -> None:
        self._A = np.ascontiguousarray(A, dtype=float)

    def run(self, forcing: FloatArray) -> FloatArray:
        """(N, m) states for a forcing (N, m), from x_0 = forcing_0 on."""
        N, m = forcing.shape
        if COMPILED is not None and m <= MOST_STATES:
            found = np.array(forcing, dtype=float, order="C")
            COMPILED.tr_run(N, m, self._A.ctypes.data, found.ctypes.data)
            return found
        found = np.empty(forcing.shape)
        for start in range(0, N, CHUNK):
            part = forcing[start : start + CHUNK].copy()
            if start:
                part[0] += self._A @ found[start - 1]
            found[start : start + CHUNK] = _substituted(self._band, part, transposed=False)
        return found

    @cached_property
    def _band(self) -> FloatArray:
        """(2 m, CHUNK m) the band of `CHUNK` stages."""
        block = _band(self._A[None]).T
        columns = np.empty((CHUNK, *block.shape))
        columns[:] = block
        return columns.reshape(-1, block.shape[1]).T


def forwards(P: FloatArray, forcing: FloatArray) -> FloatArray:
    """(K, m) states x_k = P_(k-1) x_(k-1) + forcing_k from x_0 = forcing_0, with P (K - 1, m, m)."""
    return _changing(P, forcing, transposed=False)


def backwards(P: FloatArray, forcing: FloatArray) -> FloatArray:
    """(K, m) states x_k = P_k' x_(k+1) + forcing_k from x_(K-1) = forcing_(K-1); the transpose of `forwards`."""
    return _changing(P, forcing, transposed=True)


def _changing(P: FloatArray, forcing: FloatArray, *, transposed: bool) -> FloatArray:
    if COMPILED is None:
        last = np.zeros((1, *P.shape[1:]))  # which starts no step, but has its place in the band
        return _substituted(_band(np.concatenate([P, last])), forcing, transposed=transposed)
    P, found = np.ascontiguousarray(P), np.array(forcing, order="C")
    call = COMPILED.tr_backwards if transposed else COMPILED.tr_forwards
    call(*found.shape, P.ctypes.data, found.ctypes.data)
    return found


def _band(P: FloatArray) -> FloatArray:
    """The matrix of x_(k+1) - P_k x_k for k = 0..K-1, as BLAS stores lower bands.

    Parameters
    ----------
    P : (K, m, m).

    Returns
    -------
    (2 m, K m) : column j m + i holds the diagonal and the subdiagonals of state i of stage j.
    """
    K, m, _ = P.shape
    columns = np.zeros((K, m, 2 * m))
    for j in range(m):
        columns[:, j, m - j : 2 * m - j] = -P[:, :, j]
    return columns.reshape(K * m, 2 * m).T


def _substituted(lower: FloatArray, forcing: FloatArray, *, transposed: bool) -> FloatArray:
    """(K, m) solution of the system whose band (2 m, at least K m) is given."""
    K, m = forcing.shape
    solved = blas.dtbsv(2 * m - 1, lower[:, : K * m], forcing.ravel(), lower=1, trans=int(transposed), diag=1)
    return np.asarray(solved).reshape(K, m)


def filtered(b: FloatArray, a: FloatArray, values: FloatArray) -> FloatArray:
    """(..., K) output of the digital filter b / a from rest, with a_0 = 1: what `scipy.signal.lfilter` gives.

    `lfilter` itself is not used because a tap may have to be solved between approach and contact, and loading
    scipy.signal takes longer than solving a hundred taps.
    """
    K = values.shape[-1]
    lower = np.repeat(a[:, None], K, axis=1)
    found = np.empty(values.shape)
    for course, its in zip(values.reshape(-1, K), found.reshape(-1, K), strict=True):
        its[:] = blas.dtbsv(a.size - 1, lower, np.convolve(course, b)[:K], lower=1, diag=1)
    return found


def strike(
    by_state: FloatArray,
    by_force: FloatArray,
    seen: FloatArray,
    earlier: FloatArray,
    contact: tuple[float, float, float],
    start: FloatArray,
    steps: int,
) -> tuple[FloatArray, FloatArray] | None:
    """States (steps + 1, n, V) and forces (steps + 1, V) of V courses that strike something; None if not compiled.

    A step of Runge-Kutta's method is x_(k+1) = by_state x_k + by_force F with the forces F of its four stages j, each
    k delta^e (1 + c d delta/dt) >= 0 at (delta, d delta/dt) = seen_j x_k + sum_(i < j) earlier_ji F_i.

    Parameters
    ----------
    by_state : (n, n). by_force : (n, 4). seen : (4, 2, n). earlier : (4, 2, 4).
    contact : k, e and c.
    start : (n, V) states at first.
    """
    n, courses = start.shape
    if COMPILED is None or n > MOST_STATES:
        return None
    states, forces = np.empty((steps + 1, n, courses)), np.empty((steps + 1, courses))
    states[0] = start
    given = [np.ascontiguousarray(each, dtype=float) for each in (by_state, by_force, seen, earlier, contact)]
    COMPILED.tr_strike(steps, n, courses, *(each.ctypes.data for each in (*given, states, forces)))
    return states, forces
