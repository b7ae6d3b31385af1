"""Last digits of a nearly solved QP: an active-set method on the Riccati recursion, from a solver's multipliers.

An active limit fixes the movement of its stage as an affine function of the state, so the problem with a given active
set is linear-quadratic, and its solution one backward and one forward sweep with iterative refinement. Limits whose
multiplier has the wrong sign are dropped, violated ones are added, until the certificate accepts or the sets repeat.
One stage can hold one limit: a slew that binds on the way into the hand-over, whose own stages are ruled already, is
left as the solver found it.
"""

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from transopt.base.signals import FloatArray
from transopt.problem.problem import OBJECTIVE_SCALE, Certificate, Multipliers, Solution, Status, TransientProblem
from transopt.problem.stage import hand_over_rows, linear_stage
from transopt.proof.certify import certify

MOST_SETS = 25  # active sets tried,
MOST_STAGES = 40000  # and stages swept for them, in all
REFINEMENTS = 2
FLAT = 1e-14  # of the stage's own terms: curvature that is rounding


@dataclass(frozen=True)
class _Kind:
    """One limit along the horizon: |a_k z_k + b u_k + offset_k| <= bound at stage k, whose movement is u_k.

    `at` : by how many stages later its value is stated than the movement that meets it. `pair` names its multipliers,
    `per` converts one of half the scaled objective to SI.
    """

    pair: str
    a: FloatArray
    b: float
    offset: FloatArray
    bound: float
    at: int
    per: float


class _Sweep:
    """The linear-quadratic problem in scaled states, for any choice of stages whose movement follows a rule."""

    def __init__(self, problem: TransientProblem) -> None:
        self.problem = problem
        self.stage = linear_stage(problem)
        r = problem.reference_m_s2
        wanted = r if problem.error_filter is None else problem.error_filter.apply(r)
        devices = len(problem.devices)
        self.A, self.B = self.stage.A, self.stage.A[:, -1].copy()
        self.C, self.E = self.stage.C, self.stage.E
        self.wanted = np.tile((wanted / np.linalg.norm(r))[:, None], devices)
        self.weights = problem.tracking_weights / devices
        self.s = problem.movement_weight * self.stage.current_A**2
        self.tail, self.constants = hand_over_rows(problem, self.stage)
        self.kinds = self._kinds()

    def _kinds(self) -> list[_Kind]:
        problem, stage, A, B = self.problem, self.stage, self.A, self.B
        limits, unit, N, n = problem.limits, self.stage.current_A, problem.grid.stages, self.B.size
        none, held = np.zeros(N), np.eye(1, n, n - 1)[0]
        kinds = []
        if limits.command_A is None:
            kinds.append(_Kind("current", held, 1.0, none, limits.current_A / unit, 0, 2 / unit))
        else:
            i = n_current(problem)
            kinds.append(_Kind("command", held, 1.0, none, limits.command_A / unit, 0, 2 / unit))
            kinds.append(_Kind("current", A[i], B[i], none, limits.current_A / unit, 1, 2 / unit))
        if limits.slew_A_per_s is not None:
            step = limits.slew_A_per_s * problem.grid.dt_s / unit
            kinds.append(_Kind("slew", np.zeros(n), 1.0, none, step, 0, 2 / unit))
        if problem.supply is not None:
            volts, S = problem.supply, stage.supply
            kinds.append(_Kind("supply_after", S, volts.by_command * unit, volts.nominal_V, volts.limit_V, 0, 2.0))
            later = np.append(volts.nominal_V[1:], 0.0)
            kinds.append(_Kind("supply_before", S @ A, float(S @ B), later, volts.limit_V, 1, 2.0))
        return kinds

    def values(self, kind: _Kind, z: FloatArray, u: FloatArray) -> FloatArray:
        """(N,) value of one limit, where it is stated within the horizon; NaN where it is not."""
        found = z @ kind.a + kind.b * u + kind.offset
        if kind.at:
            found[-kind.at :] = np.nan
        return found

    def solve(self, a: FloatArray, b: FloatArray, v: FloatArray, ruled: NDArray[np.bool_]) -> tuple[FloatArray, ...]:
        """z (N, n), u (N,), and the multiplier (N,) of each stage's rule a_k z + b_k u = v_k; zero where free."""
        N, n, A, B, C, E, w, s = v.size, self.B.size, self.A, self.B, self.C, self.E, self.weights, self.s
        K, S, R = np.zeros((N, n)), np.zeros((N, n)), np.zeros(N)
        P = np.zeros((n, n))
        EE, EC, CC = float(E @ E), E @ C, C.T @ C
        for k in range(N - 1, -1, -1):
            PA, PB = P @ A, P @ B
            Q, S[k], R[k] = w[k] * CC + A.T @ PA, w[k] * EC + B @ PA, w[k] * EE + B @ PB + s
            if ruled[k]:
                K[k] = -a[k] / b[k]
            elif R[k] > FLAT * (w[k] + s):
                K[k] = -S[k] / R[k]
            P = Q + np.outer(K[k], S[k]) + np.outer(S[k], K[k]) + R[k] * np.outer(K[k], K[k])
            P = (P + P.T) / 2
        z, u, error = np.zeros((N, n)), np.zeros(N), -self.wanted
        for _ in range(1 + REFINEMENTS):
            offset, p = np.zeros(N), np.zeros(n)
            for k in range(N - 1, -1, -1):
                q, rho = A.T @ p + w[k] * (error[k] @ C), B @ p + w[k] * (error[k] @ E) + s * u[k]
                if ruled[k]:
                    offset[k] = (v[k] - a[k] @ z[k]) / b[k] - u[k]
                elif R[k] > FLAT * (w[k] + s):
                    offset[k] = -rho / R[k]
                p = q + S[k] * offset[k] + K[k] * (rho + R[k] * offset[k])
            moved = np.zeros(n)
            for k in range(N):
                by = K[k] @ moved + offset[k]
                z[k] += moved
                u[k] += by
                moved = A @ moved + B * by
            error = z @ C.T + u[:, None] * E - self.wanted
        mu, costate = np.zeros(N), np.zeros(n)
        for k in range(N - 1, -1, -1):
            by_u = B @ costate + w[k] * (error[k] @ E) + s * u[k]
            costate = A.T @ costate + w[k] * (error[k] @ C)
            if ruled[k]:
                mu[k] = -by_u / b[k]
                costate += a[k] * mu[k]
        return z, u, mu


def n_current(problem: TransientProblem) -> int:
    """Index of the current among the states."""
    return sum(device.A.shape[0] - 1 for device in problem.devices)


def polished(problem: TransientProblem, answer: Solution) -> Solution:
    """The answer of the best active set found from a solver's answer; the answer itself if none is better."""
    start = time.perf_counter()
    sweep, N, free = _Sweep(problem), problem.grid.stages, problem.free_stages
    m = answer.multipliers
    best, proof = answer, certify(problem, answer.command_A, m)
    # Which limit, and which side of it, holds each stage; -1 none.
    held, side = np.full(N, -1), np.zeros(N)
    strongest = np.zeros(N)
    for j, kind in enumerate(sweep.kinds):
        for sign, name in ((1.0, "upper"), (-1.0, "lower")):
            mu = np.append(getattr(m, f"{kind.pair}_{name}")[kind.at :], np.zeros(kind.at)) / kind.per * kind.bound
            take = (mu > OBJECTIVE_SCALE * Certificate.GAP_TOLERANCE) & (mu > strongest)
            held[take], side[take], strongest[take] = j, sign, mu[take]
    held[free:] = -1
    seen: set[bytes] = set()
    for _ in range(min(MOST_SETS, max(MOST_STAGES // N, 1))):
        key = held.tobytes() + side.tobytes()
        if key in seen:
            break
        seen.add(key)
        z, u, mu = _under(sweep, held, side)
        found = _solution(sweep, answer, u, held, mu, start)
        judged = certify(problem, found.command_A, found.multipliers)
        if judged.finite and (judged.excess <= 1, -judged.relative_gap) > (proof.excess <= 1, -proof.relative_gap):
            best, proof = found, judged
        if proof.is_stationary or not np.all(np.isfinite(u)):
            break
        held, side = _next(sweep, z, u, mu, held, side)
    return best


def _under(sweep: _Sweep, held: FloatArray, side: FloatArray) -> tuple[FloatArray, ...]:
    N, n, free = held.size, sweep.B.size, sweep.problem.free_stages
    a, b, v, ruled = np.zeros((N, n)), np.ones(N), np.zeros(N), held >= 0
    for j, kind in enumerate(sweep.kinds):
        on = held == j
        a[on], b[on], v[on] = kind.a, kind.b, (side * kind.bound - kind.offset)[on]
    # c_k = rows x_k + constant: the command held before plus the movement.
    a[free:] = np.eye(1, n, n - 1)[0] - sweep.tail
    v[free:], ruled[free:] = sweep.constants, True
    return sweep.solve(a, b, v, ruled)


def _next(
    sweep: _Sweep, z: FloatArray, u: FloatArray, mu: FloatArray, held: FloatArray, side: FloatArray
) -> tuple[FloatArray, FloatArray]:
    held, side = held.copy(), side.copy()
    free = sweep.problem.free_stages
    wrong = (held >= 0) & (mu * side < 0)
    held[wrong] = -1
    worst = np.full(held.size, 1e-12)
    for j, kind in enumerate(sweep.kinds):
        values = sweep.values(kind, z, u)
        over = np.nan_to_num(np.abs(values) / kind.bound - 1, nan=-1.0)
        take = (over > worst) & (np.arange(held.size) < free)
        held[take], side[take], worst[take] = j, np.sign(values[take]), over[take]
    return held, side


def _solution(
    sweep: _Sweep, answer: Solution, u: FloatArray, held: FloatArray, mu: FloatArray, start: float
) -> Solution:
    problem, unit, free = sweep.problem, sweep.stage.current_A, sweep.problem.free_stages
    bound = problem.limits.command_bound_A
    command = np.clip(np.cumsum(u) * unit, -bound, bound)
    if problem.wall is None:
        command[free:] = 0.0
    found = Multipliers.zero(problem)
    for j, kind in enumerate(sweep.kinds):
        values = np.where(held == j, mu, 0.0) * kind.per
        if kind.at:
            values = np.append(np.zeros(kind.at), values[: -kind.at])
        pair = {f"{kind.pair}_upper": np.maximum(values, 0.0), f"{kind.pair}_lower": np.maximum(-values, 0.0)}
        found = replace(found, **pair)
    return replace(
        answer,
        status=Status.OPTIMAL,
        command_A=command,
        multipliers=replace(found, hand_over=mu[free:] * 2 / unit),
        message=f"{answer.message}, polished",
        solve_time_s=answer.solve_time_s + time.perf_counter() - start,
    )
