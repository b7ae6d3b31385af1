"""Exponential, powers and balancing of small matrices: loading scipy.linalg takes longer than solving twelve taps."""

import math

import numpy as np

from transopt.base.signals import FloatArray

# Numerator of the diagonal Pade approximant of degree 13 and the 1-norm up to which it is exact to the last bit, from
# Higham, The scaling and squaring method for the matrix exponential revisited, SIAM J. Matrix Anal. Appl. 26 (2005).
PADE = (
    *(64764752532480000.0, 32382376266240000.0, 7771770303897600.0, 1187353796428800.0, 129060195264000.0),
    *(10559470521600.0, 670442572800.0, 33522128640.0, 1323241920.0, 40840800.0, 960960.0, 16380.0, 182.0, 1.0),
)
LARGEST_NORM = 5.371920351148152
BALANCED = 0.95  # a rescaling has to reduce the sum of row and column norm below this share, as in LAPACK
MOST_SWEEPS = 100  # sweeps over all states; even extreme matrices take only a few


def balanced(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """S^-1 A S and the diagonal (n,) of S: powers of two that make row and column norms of A (n, n) nearly equal.

    Parlett and Reinsch's method, as in LAPACK's dgebal without permutations; a matrix that is not finite is returned
    unchanged.
    """
    found, scale = np.array(matrix, dtype=float), np.ones(matrix.shape[0])
    for _ in range(MOST_SWEEPS if np.isfinite(found).all() else 0):
        settled = True
        for i in range(scale.size):
            column, row = math.hypot(*found[:, i].tolist()), math.hypot(*found[i].tolist())
            if not (0 < column < math.inf and 0 < row < math.inf):
                continue
            by = float(np.exp2(round(0.5 * (math.log2(row) - math.log2(column)))))
            if column * by + row / by < BALANCED * (column + row):
                found[:, i] *= by
                found[i] /= by
                scale[i] *= by
                settled = False
        if settled:
            break
    return found, scale


def expm(matrix: FloatArray) -> FloatArray:
    """exp(A) of A (n, n) by Pade's approximant of degree 13, scaled and squared; NaN where A is not finite."""
    norm = float(np.abs(matrix).sum(axis=0).max(initial=0.0))
    if not np.isfinite(norm):
        return np.full(matrix.shape, np.nan)
    squarings = max(int(np.ceil(np.log2(norm / LARGEST_NORM))), 0) if norm > 0 else 0
    A, one, b = matrix / 2.0**squarings, np.eye(matrix.shape[0]), PADE
    A2 = A @ A
    A4 = A2 @ A2
    A6 = A4 @ A2
    odd = A @ (A6 @ (b[13] * A6 + b[11] * A4 + b[9] * A2) + b[7] * A6 + b[5] * A4 + b[3] * A2 + b[1] * one)
    even = A6 @ (b[12] * A6 + b[10] * A4 + b[8] * A2) + b[6] * A6 + b[4] * A4 + b[2] * A2 + b[0] * one
    found = np.linalg.solve(even - odd, even + odd)
    for _ in range(squarings):
        found = found @ found
    return np.asarray(found)


def exponential(matrix: FloatArray) -> FloatArray:
    """Matrix exponential (n, n) after balancing the states by powers of two, which makes it independent of units.

    Elongations and velocities in SI differ by many orders of magnitude; without balancing, the rounding errors of the
    large entries would exceed the small entries.
    """
    even, scale = balanced(matrix)
    return np.asarray(expm(even) * scale[:, None] / scale)


def powers(A: FloatArray, last: int) -> FloatArray:
    """((last + 1) n, n) powers A^0 to A^last one below the other, by doubling."""
    n, known = A.shape[0], 2
    found = np.empty(((max(last, 1) + 1) * n, n), dtype=A.dtype)
    found[: 2 * n] = np.concatenate([np.eye(n), A])
    while known <= last:
        more = min(known - 1, last + 1 - known)
        highest, into = found[(known - 1) * n : known * n], found[known * n : (known + more) * n]
        np.matmul(found[n : (1 + more) * n], highest, out=into)
        known += more
    return found[: (last + 1) * n]
