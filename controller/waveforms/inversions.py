"""The two inversions that the optimum is compared with, rebuilt from a library file.

A library stores their errors, not their commands. The unlimited optimum is computed by a plain Riccati recursion
here, since the designer's solver needs CasADi, which the runtime does not depend on.
"""

import numpy as np

from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.problem.baselines import clipped_optimum, seed_inversion
from transopt.problem.limits import hand_over
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import linear_stage
from transopt.solvers.stage_data import tracking_values


def unlimited_optimum(problem: TransientProblem) -> FloatArray:
    """(N,) commands [A] that minimise J without limits, hand-over kept.

    V_k(x) = x' P x + 2 p' x backwards over x+ = A x + b u, e = C x + E u - r, u the command's movement, with the
    optimal u = K x + k before the hand-over and the prescribed one in it (Joseph's form, so P stays semidefinite).
    """
    N = problem.grid.stages
    if problem.reference_is_zero:
        return np.zeros(N)
    stage = linear_stage(problem)
    A, b, C, E = stage.A, stage.A[:, -1], stage.C, stage.E[:, 0]
    values = tracking_values(problem, stage)
    wanted, weights, movement = values["r"], values["w"], float(values["rho"][0])
    rows, constants = hand_over.rows(problem, stage)
    rows[:, -1] -= 1.0
    # Terminal cost: the motion of the device after the waveform.
    end, target = values["end_gain"], values["end_target"]
    P, p = end.T @ end, -end.T @ target
    laws = []
    for k in range(N - 1, -1, -1):
        w = weights[k]
        if k >= problem.free_stages:
            K, constant = rows[k - problem.free_stages], constants[k - problem.free_stages]
        else:
            H = movement + (w * E) @ E + b @ P @ b
            K = -((w * E) @ C + b @ P @ A) / H
            constant = -(b @ p - (w * E) @ wanted[k]) / H
        laws.append((K, constant))
        closed, tracked = A + np.outer(b, K), C + np.outer(E, K)
        error = E * constant - wanted[k]
        p = (w * error) @ tracked + movement * constant * K + (P @ b * constant + p) @ closed
        P = (tracked.T * w) @ tracked + movement * np.outer(K, K) + closed.T @ P @ closed
    x = np.zeros(b.size)
    command = np.empty(N)
    for k, (K, constant) in enumerate(reversed(laws)):
        x = A @ x + b * (K @ x + constant)
        command[k] = x[-1] * stage.input_scale
    if problem.wall is None:
        command[problem.free_stages :] = 0.0
    return command


def inversion(library: Library, iv: int, ig: int, *, optimal: bool) -> FloatArray:
    """(N,) transient command of one node by clipping the unlimited optimum, or by the seed's inversion.

    The total current is clipped at the library's limit; with a wall its predicted feedback is subtracted, as for the
    optimum.
    """
    problem = library.problem(iv, ig).without_intensity()
    limit = problem.limits.input_limit
    if optimal:
        command = clipped_optimum(problem.stage, problem.grid, unlimited_optimum(problem), limit)
    else:
        command = seed_inversion(
            problem.stage, problem.grid, problem.reference_m_s2, limit, problem.hand_over_samples
        )
    return problem.transient_command(command)
