"""Modal coordinates of a device, in which its stages are solved: only the held command couples the modes."""

from dataclasses import dataclass

import numpy as np

from transopt.base.signals import ComplexArray, FloatArray
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import Layout, LinearStage, layout

# Largest condition number of T for which modal coordinates are used. The built-in scenes have at most 50; a wall's
# delay line is not diagonalisable. The compiled certificate uses the same coordinates, so it does not see the
# rounding of the transformation, which grows with the square of the condition: at 8e3 a gap reported as 1e-8 of J was
# in truth 6e-4, at 4e2 all agree to 1e-6.
MOST_CONDITION = 4e2


@dataclass(frozen=True)
class Modes:
    """Modal coordinates z of the states, x = T z, for all problems of one linear stage.

    Attributes
    ----------
    T : (n, n); the identity where the modes are ill conditioned.
    A : (n, n) dynamics of z: complex modes in pairs, then the real ones, all driven by the held commands, the last
        states.
    current : index of the mode that is the first motor's current; -1 without an amplifier.
    """

    T: FloatArray
    A: FloatArray
    current: int


def modes_of(problem: TransientProblem, stage: LinearStage) -> Modes:
    """The modes of a linear stage, cached with the device."""
    where = layout(problem)
    return problem.stage.kept(Modes, (stage.A,), (where,), lambda: _modes_of(stage, where))


def _modes_of(stage: LinearStage, where: Layout) -> Modes:
    """The modes of a stage, whose amplifiers have equal poles, and whose error filters have too.

    The order is complex modes in pairs, error filters, real modes, currents, commands. The eigenvectors of the
    plants' modes include the response of the error filters, each of which keeps its two states as a pair: filters of
    several devices have the same eigenvalues, to which no eigenvectors belong that could be told apart.
    """
    n, m, A = stage.units.size, stage.motors, stage.A
    dense = Modes(np.eye(n), A, where.current if where.amplifier else -1)
    if where.feedback_delay is not None or not np.isfinite(A).all():  # numbers of a damaged file are refused later
        return dense
    size, before = sum(where.plants), n - m
    pole = float(A[where.current, where.current]) if where.amplifier else 0.0
    plant, filters = slice(size), slice(size + m * int(where.amplifier), before)
    values, vectors = np.linalg.eig(A[plant, plant])
    try:
        whole = np.zeros((n, size), dtype=complex)
        whole[plant] = vectors
        for j, value in enumerate(values):
            whole[filters, j] = _driven(A, filters, value, A[filters, plant] @ vectors[:, j])
        currents = np.zeros((n, m if where.amplifier else 0))
        for c in range(currents.shape[1]):
            at = where.currents[c]
            currents[at, c] = 1.0
            currents[plant, c] = _driven(A, plant, pole, A[plant, at]).real
            by = A[filters, plant] @ currents[plant, c] + A[filters, at]
            currents[filters, c] = _driven(A, filters, pole, by).real
    except np.linalg.LinAlgError:
        return dense
    pairs, real = _columns(values, whole)
    own = np.eye(n)
    columns = [*pairs, *own[filters], *real]
    T = np.array([*(column / max(np.linalg.norm(column), 1e-300) for column in columns), *currents.T, *own[-m:]]).T
    if not np.linalg.cond(T) <= MOST_CONDITION:
        return dense
    found = np.where(_pattern(n, m, len(pairs) + before - filters.start), np.linalg.solve(T, A @ T), 0.0)
    return Modes(T, found, before - m if where.amplifier else -1)


def _columns(values: ComplexArray, vectors: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Real columns of eigenvectors, as rows: those of complex modes in pairs, and those of real modes."""
    upper = vectors.T[values.imag > 0]
    # Choose the phase of the eigenvector for which its real and imaginary parts are orthogonal.
    turned = upper * np.exp(-0.5j * np.angle((upper**2).sum(axis=1)))[:, None]
    pairs = np.stack([turned.real, turned.imag], axis=1).reshape(-1, vectors.shape[0])
    return pairs, vectors.T[values.imag == 0].real


def _driven(A: FloatArray, states: slice, pole: complex, by: FloatArray | ComplexArray) -> ComplexArray:
    """Part of an eigenvector in driven states, y with (A - pole) y = -by."""
    own = A[states, states]
    return np.asarray(np.linalg.solve(own - pole * np.eye(own.shape[0]), -by))


def _pattern(n: int, m: int, paired: int) -> FloatArray:
    """(n, n) sparsity of A in modal coordinates: the first `paired` states in pairs, and the commands' columns."""
    found = np.eye(n, dtype=bool)
    found[:, n - m :] = True
    for first in range(0, paired, 2):
        found[first : first + 2, first : first + 2] = True
    found[n - m :, n - m :] = np.eye(m, dtype=bool)
    return found
