"""A nonlinear device over one servo period: exponential Runge-Kutta integration.

Let z be the plant's states and, unless the amplifier is ideal, its input: dz/dt = L z + G c + n(z), with L and G the
linear model with the amplifier and n the nonlinear remainder. The linear part may be stiff, by a coil's L / R or the
amplifier's pole, and is integrated exactly by matrix exponentials; n by an exponential Runge-Kutta method of order
four (Cox and Matthews, "Exponential time differencing for stiff systems", J. Comput. Phys. 176, 2002, ETD4RK) in
`substeps` equal steps. For n = 0 the stage equals that of `transopt.plant.discretise` up to rounding.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from transopt.base.arithmetic import NUMBERS, NUMPY, Functions
from transopt.base.matrices import exponential
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.discretise import AFTER, Motion
from transopt.plant.nonlinear import COMPLEX_STEP, NonlinearCoil
from transopt.plant.state_space import VELOCITY

MOST_CORRECTIONS = 12  # by Newton's method until periods stepped side by side meet
MEET = 1e-11  # largest correction, relative to the state's largest value; the error it leaves is of its square
MOST_SUBSTEPS = 32
ORDER, KINKED_ORDER = 4, 2  # of the integration method, and where a formula is continuous but its slope is not
STEP_ERROR = 4e-7  # largest accepted integration error, relative to the largest acceleration

Sparse = tuple[tuple[tuple[int, float], ...], ...]  # a matrix as the nonzero entries (column, value) of each row


def _sparse(matrix: FloatArray) -> Sparse:
    return tuple(tuple((j, float(by)) for j, by in enumerate(row) if by != 0) for row in np.atleast_2d(matrix))


def _times(matrix: Sparse, vector: Sequence[Any]) -> list[Any]:
    return [sum((by * vector[j] for j, by in row), start=0.0) for row in matrix]


def _sum(*vectors: Sequence[Any]) -> list[Any]:
    return [sum(parts, start=0.0) for parts in zip(*vectors, strict=True)]


@dataclass(frozen=True)
class _Tableau:
    """Matrices of one substep h.

    Attributes
    ----------
    half, whole : exp(L h / 2) and exp(L h).
    half_by_command, whole_by_command : the held command's part after h / 2 and h.
    inner, first, middle, last : weights of n in the inner stages and in the three terms of the result.
    """

    half: Sparse
    half_by_command: Sparse
    whole: Sparse
    whole_by_command: Sparse
    inner: Sparse
    first: Sparse
    middle: Sparse
    last: Sparse


@dataclass(frozen=True)
class Linearised:
    """Derivatives of a stage along a command of K periods.

    Attributes
    ----------
    A, B : (K, n, n) and (K, n), derivatives of z_(k+1) by z_k and by c_k.
    C, D : (K, n) and (K,), derivatives of y''_k by z_k and by c_k.
    ends : (K, n) states z_(k+1) that follow z_k.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    ends: FloatArray


@dataclass(frozen=True)
class NonlinearStage:
    """z_(k+1) = step(z_k, c_k), y''_k = acceleration(z_k, c_k) at the switching instants.

    Attributes
    ----------
    plant : the nonlinear plant.
    amplifier : None is ideal, u = c.
    dt_s : servo period.
    substeps : number of integration steps per period.
    outputs : names of further outputs; a motion has them at the instant and, with the suffix `AFTER`, one period
        later.
    """

    plant: NonlinearCoil
    amplifier: Amplifier | None
    dt_s: float
    substeps: int
    outputs: tuple[str, ...] = ()
    rows: dict[str, FloatArray] = field(init=False)

    __repr__ = brief

    def __post_init__(self) -> None:
        idle = np.zeros(int(self.amplifier is not None))
        rows = {name: np.append(self.plant.linear.output(name).row[0], idle) for name in (*self.outputs, VELOCITY)}
        object.__setattr__(self, "rows", rows)

    @property
    def order(self) -> int:
        """n, number of states, the amplifier's included."""
        return self.plant.linear.order + int(self.amplifier is not None)

    @cached_property
    def _flow(self) -> tuple[FloatArray, FloatArray]:
        """L (n, n) and G (n, 1)."""
        linear, n = self.plant.linear, self.order
        if self.amplifier is None:
            return linear.A, linear.B
        w = self.amplifier.rate_rad_s
        L, G = np.zeros((n, n)), np.zeros((n, 1))
        L[:-1, :-1], L[:-1, -1:] = linear.A, linear.B
        L[-1, -1], G[-1, 0] = -w, w
        return L, G

    @cached_property
    def _tableau(self) -> _Tableau:
        L, G = self._flow
        h, n = self.dt_s / self.substeps, self.order
        whole, half = (_phi(L * step) for step in (h, h / 2))
        (E, p1, p2, p3), (E2, q1) = whole, half[:2]
        assert E.shape == (n, n)
        return _Tableau(
            half=_sparse(E2),
            half_by_command=_sparse(h / 2 * q1 @ G),
            whole=_sparse(E),
            whole_by_command=_sparse(h * p1 @ G),
            inner=_sparse(h / 2 * q1),
            first=_sparse(h * (p1 - 3 * p2 + 4 * p3)),
            middle=_sparse(h * (2 * p2 - 4 * p3)),
            last=_sparse(h * (4 * p3 - p2)),
        )

    def split(self, states: Sequence[Any], command: Any) -> tuple[Sequence[Any], Any]:
        """The plant's own states and its input."""
        return (states, command) if self.amplifier is None else (states[:-1], states[-1])

    def _rest(self, states: Sequence[Any], command: Any, functions: Functions) -> list[Any]:
        own, u = self.split(states, command)
        rest = self.plant.remainder(own, u, functions)
        return rest if self.amplifier is None else [*rest, 0.0]

    def step(self, states: Sequence[Any], command: Any, functions: Functions) -> list[Any]:
        """The states one period later, component by component, with the command held."""
        t, z, c = self._tableau, list(states), [command]
        half_c, whole_c = _times(t.half_by_command, c), _times(t.whole_by_command, c)
        for _ in range(self.substeps):
            n0 = self._rest(z, command, functions)
            half = _sum(_times(t.half, z), half_c)
            a = _sum(half, _times(t.inner, n0))
            n1 = self._rest(a, command, functions)
            b = _sum(half, _times(t.inner, n1))
            n2 = self._rest(b, command, functions)
            turned = [2.0 * second - first for second, first in zip(n2, n0, strict=True)]
            d = _sum(_times(t.half, a), half_c, _times(t.inner, turned))
            n3 = self._rest(d, command, functions)
            z = _sum(
                _times(t.whole, z),
                whole_c,
                _times(t.first, n0),
                _times(t.middle, _sum(n1, n2)),
                _times(t.last, n3),
            )
        return z

    def acceleration(self, states: Sequence[Any], command: Any, functions: Functions) -> Any:
        """y'' [m/s^2] at the instant from which the command acts."""
        own, u = self.split(states, command)
        return self.plant.acceleration(own, u, functions)

    def states(self, command: FloatArray, guess: FloatArray | None = None) -> FloatArray:
        """(K + 1, n) states from rest at tau_0 to tau_K for a held command (K,); NaN after a divergence.

        All periods are stepped side by side from guessed states, which Newton's method moves until the periods meet
        in the recursion's one solution. Where it does not get there, one period is stepped after the other.

        Parameters
        ----------
        guess : (K + 1, n) states nearby, such as those with other substeps; by default all are at rest.
        """
        z = np.zeros((command.size + 1, self.order)) if guess is None else guess
        with np.errstate(all="ignore"):
            for _ in range(MOST_CORRECTIONS):
                along = self.linearised(command, z)
                moved = corrections(along.A, along.ends - z[1:])
                z = z + moved
                if not np.isfinite(z).all():
                    break
                if np.all(np.abs(moved) <= MEET * np.abs(z).max(axis=0)):
                    return z
        return self._one_by_one(command)

    def _one_by_one(self, command: FloatArray) -> FloatArray:
        found = np.full((command.size + 1, self.order), np.nan)
        found[0], z = 0.0, [0.0] * self.order
        for k, c in enumerate(command.tolist()):
            try:
                z = self.step(z, c, NUMBERS)
            except (ArithmeticError, ValueError):
                break
            found[k + 1] = np.real(z)
        return found

    @np.errstate(all="ignore")  # a formula may have no value somewhere
    def motion(self, command: FloatArray, states: FloatArray | None = None) -> Motion:
        """The motion (K,) under a held command (K,).

        Parameters
        ----------
        states : (K + 1, n) states under this command, if they are known already.
        """
        z = self.states(command) if states is None else states
        now, after = z[:-1], z[1:]
        _, u = self.split(list(now.T), command)
        outputs = {}
        for name in self.outputs:
            outputs[name], outputs[name + AFTER] = now @ self.rows[name], after @ self.rows[name]
        return Motion(
            np.asarray(self.acceleration(list(now.T), command, NUMPY)),
            np.array(u),
            now @ self.rows[VELOCITY],
            np.zeros(command.size),
            outputs,
        )

    @np.errstate(all="ignore")
    def linearised(self, command: FloatArray, states: FloatArray) -> Linearised:
        """Derivatives along a command (K,) and its states (K + 1, n), by complex steps: exact to rounding.

        f(x + i h) = f(x) + i h f'(x) + O(h^2): the imaginary part loses no digits to a difference (Squire and Trapp,
        "Using complex variables to estimate derivatives of real functions", SIAM Review 40, 1998).
        """
        n, K = self.order, command.size
        # Row j of each state and of the command is moved if that is state j, the last row if it is the command.
        moved = np.repeat(np.vstack([states[:-1].T, command])[:, None].astype(complex), n + 1, axis=1)
        moved[np.arange(n + 1), np.arange(n + 1)] += 1j * COMPLEX_STEP
        ends = np.stack(self.step(list(moved[:n]), moved[n], NUMPY))
        by = np.moveaxis(ends.imag, (0, 1), (1, 2)) / COMPLEX_STEP
        made = np.broadcast_to(self.acceleration(list(moved[:n]), moved[n], NUMPY), (n + 1, K)).imag.T / COMPLEX_STEP
        return Linearised(by[:, :, :n], by[:, :, n], made[:, :n], made[:, n], ends[:, 0].real.T)

    def adjoint(self, along: Linearised, gradient: Motion) -> FloatArray:
        """(K,) gradient by the commands for a gradient by the motion, (K,) each.

        lambda_k = A_k' lambda_(k+1) + gradient by z_k; gradients by outputs `AFTER` the period belong to z_(k+1).
        """
        K, n = along.D.size, self.order
        by_state = np.zeros((K + 1, n))
        by_state[:-1] = along.C * gradient.acceleration_m_s2[:, None]
        by_state[:-1] += gradient.velocity_m_s[:, None] * self.rows[VELOCITY]
        by_command = along.D * gradient.acceleration_m_s2
        if self.amplifier is None:
            by_command = by_command + gradient.plant_input
        else:
            by_state[:-1, -1] += gradient.plant_input
        for name, by in gradient.outputs.items():
            where = slice(1, None) if name.endswith(AFTER) else slice(-1)
            by_state[where] += by[:, None] * self.rows[name.removesuffix(AFTER)]
        costate = by_state[-1]
        for k in range(K - 1, -1, -1):
            by_command[k] += along.B[k] @ costate
            costate = by_state[k] + costate @ along.A[k]
        return np.asarray(by_command)


def corrections(A: FloatArray, gaps: FloatArray) -> FloatArray:
    """(..., K + 1, n) corrections e_(k+1) = A_k e_k + d_k, e_0 = 0, of states with gaps d_k behind the periods.

    Parameters
    ----------
    A : (..., K, n, n). gaps : (..., K, n).
    """
    moved = np.zeros((*gaps.shape[:-2], gaps.shape[-2] + 1, gaps.shape[-1]))
    for k in range(gaps.shape[-2]):
        moved[..., k + 1, :] = (A[..., k, :, :] @ moved[..., k, :, None])[..., 0] + gaps[..., k, :]
    return moved


def _phi(matrix: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """exp(M) and phi_1 to phi_3 of M (n, n), phi_j(M) = sum_k M^k / (k + j)!, from one exponential.

    They are the first row of blocks of exp([[M, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, 0]]) (Sidje,
    "Expokit", ACM Trans. Math. Softw. 24, 1998).
    """
    n = matrix.shape[0]
    block = np.zeros((4 * n, 4 * n))
    block[:n, :n] = matrix
    block += np.eye(4 * n, k=n)
    found = exponential(block)[:n]
    return found[:, :n], found[:, n : 2 * n], found[:, 2 * n : 3 * n], found[:, 3 * n :]


def resolved(stage: NonlinearStage, command: FloatArray, most: float = STEP_ERROR) -> tuple[NonlinearStage, float]:
    """The stage with as many substeps as a command (K,) needs, and the remaining error of y''.

    The error relative to the peak is estimated from the change of y'' with twice the substeps. From l to m substeps
    it falls by (m / l)^4 where the formulas are smooth, but by as little as (m / l)^2 where they have a kink, as |x|:
    so the error is at most 4/3 of that change. The number of substeps is raised until the error is at most `most`,
    or to 32.
    """
    found = replace(stage, substeps=2)
    while True:
        states, finer = found.states(command), replace(stage, substeps=2 * found.substeps)
        fine = finer.motion(command, finer.states(command, states)).acceleration_m_s2
        scale = max(float(np.abs(fine).max()), np.finfo(float).tiny)
        change = float(np.abs(fine - found.motion(command, states).acceleration_m_s2).max()) / scale
        error = change / (1 - 2.0**-KINKED_ORDER)
        if error <= most or found.substeps >= MOST_SUBSTEPS:
            return found, error
        wanted = found.substeps * (error / most) ** (1 / ORDER) if np.isfinite(error) else np.inf
        more = int(min(max(np.ceil(wanted), found.substeps + 1), 4 * found.substeps, MOST_SUBSTEPS))
        found = replace(stage, substeps=more)
