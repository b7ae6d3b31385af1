"""Linear recursions over the stages as banded triangular systems, solved by forward substitution.

The recursion x_(k+1) = P_k x_k + f_k with m states, written for all k at once, is a unit lower triangular system with
2 m - 1 diagonals below the main one. BLAS solves it with the recursion's own products and sums, in a fiftieth of the
time that a loop in Python takes.
"""

import numpy as np
from scipy.linalg import blas

from transopt.base.signals import FloatArray

CHUNK = 128  # stages that one constant band spans


def band(P: FloatArray) -> FloatArray:
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


def constant_band(A: FloatArray) -> FloatArray:
    """(2 m, CHUNK m) the band of `CHUNK` stages that share the matrix A (m, m)."""
    block = band(A[None]).T
    columns = np.empty((CHUNK, *block.shape))
    columns[:] = block
    return columns.reshape(-1, block.shape[1]).T


def substitute(lower: FloatArray, forcing: FloatArray, *, transposed: bool = False) -> FloatArray:
    """Solve the recursion whose band is given.

    Forwards x_k = P_(k-1) x_(k-1) + forcing_k from x_0 = forcing_0; transposed, and so backwards,
    x_k = P_k' x_(k+1) + forcing_k from x_(K-1) = forcing_(K-1).

    Parameters
    ----------
    lower : (2 m, at least K m) of `band` or `constant_band`.
    forcing : (K, m).

    Returns
    -------
    (K, m) states.
    """
    K, m = forcing.shape
    solved = blas.dtbsv(2 * m - 1, lower[:, : K * m], forcing.ravel(), lower=1, trans=int(transposed), diag=1)
    return np.asarray(solved).reshape(K, m)


def run(A: FloatArray, lower: FloatArray, forcing: FloatArray) -> FloatArray:
    """(N, m) states of x_k = A x_(k-1) + forcing_k, x_(-1) = 0, `CHUNK` stages at a time.

    Parameters
    ----------
    A : (m, m).
    lower : its `constant_band`.
    forcing : (N, m).
    """
    found = np.empty(forcing.shape)
    for start in range(0, forcing.shape[0], CHUNK):
        part = forcing[start : start + CHUNK].copy()
        if start:
            part[0] += A @ found[start - 1]
        found[start : start + CHUNK] = substitute(lower, part)
    return found


def filtered(b: FloatArray, a: FloatArray, values: FloatArray) -> FloatArray:
    """(K,) output of the digital filter b / a from rest, with a_0 = 1: what `scipy.signal.lfilter` gives.

    `lfilter` itself is not used because a tap may have to be solved between approach and contact, and loading
    scipy.signal takes longer than solving a hundred taps.
    """
    moved = np.convolve(values, b)[: values.size]
    lower = np.repeat(a[:, None], values.size, axis=1)
    return np.asarray(blas.dtbsv(a.size - 1, lower, moved, lower=1, diag=1))
