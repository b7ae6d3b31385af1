"""Stage models by common one-step methods, to compare with the exact one (Hairer & Wanner, ODEs II, IV.3 and IV.5).

A Runge-Kutta method turns dx/dt = F x + G c, c held, into x+ = A x + B c with [A B; 0 1] = R(h [F G; 0 0]), R its
stability function: a rational approximation of the exponential.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import linalg

from transopt.base.signals import FloatArray
from transopt.plant.discretise import StageModel, acting_states

Rule = Callable[[FloatArray], FloatArray]
ROUNDING = 1e-9


def _euler(M: FloatArray) -> FloatArray:
    return np.eye(len(M)) + M


def _rk4(M: FloatArray) -> FloatArray:
    one = np.eye(len(M))
    return one + M @ (one + M @ (one + M @ (one + M / 4) / 3) / 2)


def _tustin(M: FloatArray) -> FloatArray:
    one = np.eye(len(M))
    return np.asarray(np.linalg.solve(one - M / 2, one + M / 2))


def _radau(M: FloatArray) -> FloatArray:
    one, square = np.eye(len(M)), M @ M
    numerator = one + 2 / 5 * M + square / 20
    denominator = one - 3 / 5 * M + 3 / 20 * square - square @ M / 60
    return np.asarray(np.linalg.solve(denominator, numerator))


RULES: dict[str, Rule] = {
    "exact hold": lambda M: np.asarray(linalg.expm(M)),
    "Radau IIA-5": _radau,
    "RK4": _rk4,
    "Tustin": _tustin,
    "Euler": _euler,
}


def flow(stage: StageModel) -> FloatArray:
    """(n + 1, n + 1) [F G; 0 0] of the stage's states: plant, and unless the amplifier is ideal the current."""
    plant, amplifier = stage.plant, stage.amplifier
    acting = acting_states(plant, position=stage.Cp is not None)
    A, B = plant.A[np.ix_(acting, acting)], plant.B[acting]
    n = len(A)
    if amplifier is None:
        return np.block([[A, B], [np.zeros((1, n + 1))]])
    found = np.zeros((n + 2, n + 2))
    found[:n, : n + 1] = np.hstack([A, B])
    found[n, n:] = -amplifier.rate_rad_s, amplifier.rate_rad_s
    return found


def discretised(rule: Rule, stage: StageModel) -> StageModel:
    """The stage with one step of the rule per servo period in place of the exact hold."""
    hold = rule(flow(stage) * stage.dt_s)
    return replace(stage, A=hold[:-1, :-1], B=hold[:-1, -1:])


def growth(stage: StageModel) -> float:
    """Factor by which the stage's fastest growing motion grows per servo period; 1 where none does."""
    radius = float(np.abs(np.linalg.eigvals(stage.A)).max())
    return radius if radius > 1 + ROUNDING else 1.0
