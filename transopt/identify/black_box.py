"""The black box: a stable real state space near a frequency response, for devices that are no drive chain.

Poles come from vector fitting (Gustavsen and Semlyen 1999, "Rational approximation of frequency domain responses by
vector fitting", IEEE Transactions on Power Delivery 14 (3)), the output from linear least squares.

A sum of partial fractions with given poles is linear in its coefficients; in the real basis used here a pair of poles
p, p* has the two functions 1/(s - p) + 1/(s - p*) and j/(s - p) - j/(s - p*), which are the states of

    A = [[Re p, Im p], [-Im p, Re p]],  b = (2, 0),

so that the coefficients of the sum are the row C of a real state space.

What a spring holds stays where it is under a constant input, so that its acceleration has two zeros at s = 0. No
resonance is narrower than the points resolve: between two of them a pole of next to no damping and a zero beside it
cost nothing and explain a little noise, and a design would play into them.
"""

from collections.abc import Callable

import numpy as np

from transopt.base.signals import ComplexArray, FloatArray

RELOCATIONS = 20
RESOLVED = 0.5  # of the distance between points: no resonance may be narrower, since nothing was measured within


def fractions(s: ComplexArray, poles: ComplexArray) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """The basis (m, n) at the points s, and A (n, n) and b (n,) of the states that it is made of.

    Parameters
    ----------
    poles : (n,) conjugate pairs adjacent.
    """
    order = poles.size
    basis = np.empty((s.size, order), dtype=complex)
    A, b = np.zeros((order, order)), np.empty(order)
    j = 0
    while j < order:
        p = poles[j]
        if p.imag != 0:
            one, other = 1 / (s - p), 1 / (s - p.conjugate())
            basis[:, j], basis[:, j + 1] = one + other, 1j * (one - other)
            A[j : j + 2, j : j + 2] = [[p.real, p.imag], [-p.imag, p.real]]
            b[j : j + 2] = 2.0, 0.0
            j += 2
        else:
            basis[:, j], A[j, j], b[j] = 1 / (s - p), p.real, 1.0
            j += 1
    return basis, A, b


def vector_fit(s: ComplexArray, target: ComplexArray, weight: FloatArray, order: int, direct: bool) -> ComplexArray:
    """(order,) stable poles of a rational function near `target` at the points s, conjugate pairs adjacent.

    Iterates: least squares for numerator and denominator with a common set of poles, whose new set are the zeros of
    the denominator; those to the right are reflected. An odd order begins with a real pole in the middle.

    Parameters
    ----------
    s : (m,) points, scaled to at most about 1. target : (m,) values there. weight : (m,) of their errors.
    direct : whether a constant is added to the fractions.
    """
    size = np.abs(s)
    imaginary = np.geomspace(size.min(), size.max(), order // 2)
    poles = np.stack([-0.1 * imaginary + 1j * imaginary, -0.1 * imaginary - 1j * imaginary], axis=1).ravel()
    if order % 2:
        poles = np.append(poles, -np.sqrt(size.min() * size.max()))
    for _ in range(RELOCATIONS):
        basis, A, b = fractions(s, poles)
        columns = [basis] + ([np.ones((s.size, 1))] if direct else []) + [-target[:, None] * basis]
        system = np.hstack(columns) * weight[:, None]
        right = target * weight
        stacked, wanted = np.vstack([system.real, system.imag]), np.concatenate([right.real, right.imag])
        norm = np.linalg.norm(stacked, axis=0)
        solution = np.linalg.lstsq(stacked / norm, wanted, rcond=None)[0] / norm
        moved = np.linalg.eigvals(A - np.outer(b, solution[-order:]))
        moved = -np.abs(moved.real) + 1j * moved.imag
        upper = moved[moved.imag > 0]
        real = np.sort(moved[moved.imag == 0].real)
        poles = np.concatenate([np.stack([upper, upper.conj()], axis=1).ravel(), real.astype(complex)])
    return poles


def at_rest(A: FloatArray, b: FloatArray) -> FloatArray:
    """(n + 1, n + 1) projector of rows of coefficients (C, D) onto those whose response has two zeros at s = 0.

    Value and slope there are linear in the coefficients: (s I - A)^-1 b = -A^-1 b - s A^-2 b - ...
    """
    inverse = np.linalg.inv(A)
    value = -inverse @ b
    kept = np.eye(b.size + 1)
    for row in (np.append(value, 1.0), np.append(inverse @ value, 0.0)):
        asked = kept @ row
        kept = kept - np.outer(asked, asked) / (asked @ asked)
    return kept


def least_width(frequencies_Hz: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """The least damping a of s^2 + a s + w^2 that the distance between points resolves, from log w to log a."""
    log_w, log_a = np.log(2 * np.pi * frequencies_Hz), np.log(2 * np.pi * RESOLVED * np.gradient(frequencies_Hz))
    return lambda at: np.asarray(np.interp(at, log_w, log_a))
