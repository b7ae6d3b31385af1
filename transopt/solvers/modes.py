"""Modal coordinates of a device, in which its stages are solved: only the held command couples the modes."""

from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import LinearStage, layout

# Largest condition number of T for which modal coordinates are used. The built-in scenes have at most 33; a wall's
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
    A : (n, n) dynamics of z: complex modes in pairs, then the real ones, all driven by the held command (last state).
    current : index of the mode that is the current; -1 without an amplifier.
    """

    T: FloatArray
    A: FloatArray
    current: int


def modes_of(problem: TransientProblem, stage: LinearStage) -> Modes:
    """The modes of a linear stage, cached with the device."""
    where = layout(problem)
    current = where.current if where.amplifier else -1
    return problem.stage.kept(Modes, (stage.A,), current, lambda: _of_dynamics(stage.A, current))


def _of_dynamics(A: FloatArray, current: int) -> Modes:
    n, dense = A.shape[0], Modes(np.eye(A.shape[0]), A, current)
    if not np.isfinite(A).all():
        return dense  # from a damaged file; the certificate refuses the answer
    values, vectors = np.linalg.eig(A[:-1, :-1])
    columns, pattern = list[FloatArray](), np.eye(n, dtype=bool)
    pattern[:, -1] = True
    for vector in vectors.T[values.imag > 0]:
        # Choose the phase of the eigenvector for which its real and imaginary parts are orthogonal.
        turned = vector * np.exp(-0.5j * np.angle(np.sum(vector**2)))
        at = len(columns)
        pattern[at : at + 2, at : at + 2] = True
        columns += [turned.real, turned.imag]
    columns += list(vectors.T[values.imag == 0].real)
    T = np.eye(n)
    T[:-1, :-1] = np.array(columns).T
    T /= np.maximum(np.linalg.norm(T, axis=0), np.finfo(float).tiny)
    if current >= 0:
        # Only the command acts on the current, so that the current is itself a mode; it keeps its unit.
        own = int(np.abs(T[current]).argmax())
        T[:, own] /= T[current, own] or 1.0
        T[current] = np.arange(n) == own
    if not np.linalg.cond(T) <= MOST_CONDITION:
        return dense
    return Modes(T, np.where(pattern, np.linalg.solve(T, A @ T), 0.0), own if current >= 0 else -1)
