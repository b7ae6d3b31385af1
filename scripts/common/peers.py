"""The problem as it is commonly written in CasADi's Opti with IPOPT, for comparison."""

import casadi as ca
import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.problem import TransientProblem


def filtered_stage(problem: TransientProblem) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A (n, n), B (n, 1) of stage and filters behind it, C (T, n) what the terms of the error track, in SI."""
    stage, filters = problem.stage, [term.error_filter for term in problem.terms]
    own = stage.A.shape[0]
    n = own + 2 * sum(by is not None for by in filters)
    A, B, C = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((len(filters), n))
    A[:own, :own], B[:own] = stage.A, stage.B
    first = own
    for row, by in zip(C, filters, strict=True):
        if by is None:
            row[:own] = stage.C[0]
            continue
        Af, Bf, Cf, Df = by.state_space()
        states, first = slice(first, first + 2), first + 2
        A[states, :own], A[states, states] = Bf @ stage.C, Af
        row[:own], row[states] = (Df @ stage.C)[0], Cf[0]
    return A, B, C


def commonly_written(problem: TransientProblem) -> tuple[ca.Opti, ca.MX]:
    """The program without a solver yet, and its commands (1, N) [A].

    It follows CasADi's multiple-shooting examples: a stage Function called in a loop, every limit by subject_to, SI
    units. As in the project's statement, the states are plant, current, error filters and previous command, and the
    input is the command's movement; the tail is a cost of the last state. With a temperature limit the rises of
    winding and housing are states too, with the absolute value of the current as in the seed's Eq. 7.
    """
    stage, limits, N = problem.stage, problem.limits, problem.grid.stages
    range_A = limits["command"].stated
    current = stage.A.shape[0] - 1
    A, B, C = filtered_stage(problem)
    n, energy, lost = len(A), problem.tracking.energy_m2_s4, problem.target.before_m_s2.size
    weights, r = (each[:, lost:] for each in (problem.tracking.weights, problem.tracking.wanted))
    state, movement = ca.MX.sym("z", n + 1), ca.MX.sym("dc")
    command = state[n] + movement
    advance = ca.Function("F", [state, movement], [ca.vertcat(A @ state[:n] + B * command, command)])

    opti = ca.Opti()
    z, dc, wanted = opti.variable(n + 1, N + 1), opti.variable(1, N), opti.parameter(len(C), N)
    cost = 0
    opti.subject_to(z[:, 0] == 0)
    for k in range(N):
        opti.subject_to(z[:, k + 1] == advance(z[:, k], dc[k]))
        opti.subject_to(opti.bounded(-limits.input_limit, z[current, k], limits.input_limit))
        opti.subject_to(opti.bounded(-range_A, z[n, k + 1], range_A))
        cost += weights[None, :, k] @ (C @ z[:n, k] - wanted[:, k]) ** 2 / energy
        cost += problem.movement.weight * dc[k] ** 2 + problem.heat_price * z[current, k] ** 2
        if k >= problem.free_stages:
            opti.subject_to(z[n, k + 1] == 0)
    free = [C]
    for _ in range(problem.grid.after_stages - 1):
        free.append(free[-1] @ A)
    if problem.grid.after_stages:
        roots = np.sqrt(weights[:, N:].T.ravel())
        Q, R = np.linalg.qr(roots[:, None] * np.vstack(free))
        cost += ca.sumsqr(R @ z[:n, N] - Q.T @ (roots * r[:, N:].T.ravel())) / energy
    if problem.thermal is not None:
        model = problem.thermal.model
        rise = opti.variable(model.nodes, N + 1)
        opti.subject_to(rise[:, 0] == 0)
        for k in range(N):
            heating = model.heating
            first, last = z[current, k], heating.decay * z[current, k] + (1 - heating.decay) * z[n, k + 1]
            mean = heating.share * first + (1 - heating.share) * last
            square = heating.square[0] * first**2 + heating.square[1] * first * last + heating.square[2] * last**2
            heat = square + 2 * heating.ripple_A * ca.fabs(mean) + heating.ripple_A**2
            power = (model.gain[k] + model.copper * rise[0, k]) * heat
            opti.subject_to(rise[:, k + 1] == model.M @ rise[:, k] + model.b * power)
            opti.subject_to(rise[0, k + 1] <= model.headroom_K[k])
    opti.minimize(cost)
    opti.set_value(wanted, r[:, :N])
    return opti, z[n, 1:]
