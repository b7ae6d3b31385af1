"""The modes of a device, in which its stages are solved: only the held command couples them to each other."""

from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import LinearStage, layout

# Condition of the modes up to which the method works in them. The built-in scenes have at most 33, a wall's delay
# line has no modes. The compiled certificate works in them as well, so it does not see what rounding does to them.
# That grows with the square of the condition: at 8e3 a gap stated as 1e-8 of J was 6e-4, at 4e2 all agree to 1e-6.
MOST_CONDITION = 4e2


@dataclass(frozen=True)
class Modes:
    """States as sums of modes, x = T z, for all problems of one linear stage.

    Attributes
    ----------
    of : A of the linear stage, by which it is known again.
    T : (n, n); the identity where modes are ill conditioned.
    A : (n, n) of z: complex modes in pairs, then the real ones, each driven by the held command, the last state.
    current : which of them is the current; -1 without an amplifier.
    """

    of: FloatArray
    T: FloatArray
    A: FloatArray
    current: int


def modes_of(problem: TransientProblem, stage: LinearStage) -> Modes:
    """The modes of a linear stage, kept with the device for the next problem."""
    derived = problem.stage.derived
    found = derived.get(Modes)
    if not (isinstance(found, Modes) and found.of is stage.A):
        where = layout(problem)
        found = derived[Modes] = _of_dynamics(stage.A, where.current if where.amplifier else -1)
    return found


def _of_dynamics(A: FloatArray, current: int) -> Modes:
    n, dense = A.shape[0], Modes(A, np.eye(A.shape[0]), A, current)
    if not np.isfinite(A).all():
        return dense  # a device of a forged file, which the certificate refuses
    values, vectors = np.linalg.eig(A[:-1, :-1])
    columns, pattern = list[FloatArray](), np.eye(n, dtype=bool)
    pattern[:, -1] = True
    for vector in vectors.T[values.imag > 0]:
        # Real and imaginary part stand at right angles in one of the phases that a complex vector may have.
        turned = vector * np.exp(-0.5j * np.angle(np.sum(vector**2)))
        at = len(columns)
        pattern[at : at + 2, at : at + 2] = True
        columns += [turned.real, turned.imag]
    columns += list(vectors.T[values.imag == 0].real)
    T = np.eye(n)
    T[:-1, :-1] = np.array(columns).T
    T /= np.maximum(np.linalg.norm(T, axis=0), np.finfo(float).tiny)
    if current >= 0:
        # Nothing but the command acts on the current, which is one of the modes, and keeps its unit.
        own = int(np.abs(T[current]).argmax())
        T[:, own] /= T[current, own] or 1.0
        T[current] = np.arange(n) == own
    if not np.linalg.cond(T) <= MOST_CONDITION:
        return dense
    return Modes(A, T, np.where(pattern, np.linalg.solve(T, A @ T), 0.0), own if current >= 0 else -1)
