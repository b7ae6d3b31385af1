"""Linear recursions over the stages as banded triangular systems: forward substitution, column after column.

x_(k+1) = P_k x_k + f_k for all k at once is a unit lower triangular system with 2 m - 1 diagonals below the main one.
Its solution performs the recursion's own products and sums, at a fiftieth of the time of a loop in Python.
"""

import numpy as np
from scipy.linalg import blas

from transopt.base.signals import FloatArray

CHUNK = 128  # stages that one constant band spans


def band(P: FloatArray) -> FloatArray:
    """(2 m, K m) the matrix of x_(k+1) - P_k x_k, k = 0..K-1, as BLAS stores lower bands, from P (K, m, m)."""
    K, m, _ = P.shape
    columns = np.zeros((K, m, 2 * m))
    for j in range(m):
        columns[:, j, m - j : 2 * m - j] = -P[:, :, j]
    return columns.reshape(K * m, 2 * m).T


def constant_band(A: FloatArray) -> FloatArray:
    """The band of `CHUNK` stages with one matrix A (m, m)."""
    block = band(A[None]).T
    columns = np.empty((CHUNK, *block.shape))
    columns[:] = block
    return columns.reshape(-1, block.shape[1]).T


def substitute(lower: FloatArray, forcing: FloatArray, *, transposed: bool = False) -> FloatArray:
    """x (K, m) of x_k = P_(k-1) x_(k-1) + forcing_k, x_0 = forcing_0; transposed x_k = P_k' x_(k+1) + forcing_k."""
    K, m = forcing.shape
    solved = blas.dtbsv(2 * m - 1, lower[:, : K * m], forcing.ravel(), lower=1, trans=int(transposed), diag=1)
    return np.asarray(solved).reshape(K, m)


def run(A: FloatArray, lower: FloatArray, forcing: FloatArray) -> FloatArray:
    """x (N, m) of x_k = A x_(k-1) + forcing_k, x_(-1) = 0, in chunks of the constant band of A."""
    found = np.empty(forcing.shape)
    for start in range(0, forcing.shape[0], CHUNK):
        part = forcing[start : start + CHUNK].copy()
        if start:
            part[0] += A @ found[start - 1]
        found[start : start + CHUNK] = substitute(lower, part)
    return found


def filtered(b: FloatArray, a: FloatArray, values: FloatArray) -> FloatArray:
    """(K,) of the digital filter b / a from rest, a_0 = 1: what `scipy.signal.lfilter` gives.

    Not by it: a tap that is solved anew must not wait for scipy.signal to be loaded, which takes longer than a
    hundred taps.
    """
    moved = np.convolve(values, b)[: values.size]
    lower = np.repeat(a[:, None], values.size, axis=1)
    return np.asarray(blas.dtbsv(a.size - 1, lower, moved, lower=1, diag=1))
