"""The usual way of writing the problem, for comparison: CasADi's Opti with IPOPT."""

import casadi as ca
import numpy as np

from transopt.plant.coil import PWM_RIPPLE_A
from transopt.problem.problem import TransientProblem


def commonly_written(problem: TransientProblem) -> tuple[ca.Opti, ca.MX]:
    """The program without a solver yet, and its commands (1, N) [A].

    As CasADi's own multiple-shooting examples do it: a stage Function called in a loop, every limit through
    subject_to, SI units. States are plant, current and previous command, input its movement, as in the project's own
    statement; what happens after the window is a cost of the last state, as the free motion that follows from it is
    linear; where the temperature is limited, the rises of winding and housing too, with the absolute value of the
    current as it stands in the seed's Eq. 7.
    """
    stage, limits, N = problem.stage, problem.limits, problem.grid.stages
    range_A = limits["command"].stated
    r, n, energy = problem.reference_m_s2, stage.A.shape[0], problem.target.energy_m2_s4
    state, movement = ca.MX.sym("z", n + 1), ca.MX.sym("dc")
    command = state[n] + movement
    advance = ca.Function("F", [state, movement], [ca.vertcat(stage.A @ state[:n] + stage.B * command, command)])

    opti = ca.Opti()
    z, dc, wanted = opti.variable(n + 1, N + 1), opti.variable(1, N), opti.parameter(1, N)
    cost = 0
    opti.subject_to(z[:, 0] == 0)
    for k in range(N):
        opti.subject_to(z[:, k + 1] == advance(z[:, k], dc[k]))
        opti.subject_to(opti.bounded(-limits.input_limit, z[n - 1, k], limits.input_limit))
        opti.subject_to(opti.bounded(-range_A, z[n, k + 1], range_A))
        cost += (stage.C @ z[:n, k] - wanted[k]) ** 2 / energy + problem.movement.weight * dc[k] ** 2
        if k >= problem.free_stages:
            opti.subject_to(z[n, k + 1] == 0)
    free = [stage.C]
    for _ in range(problem.grid.after_stages - 1):
        free.append(free[-1] @ stage.A)
    if problem.grid.after_stages:
        Q, R = np.linalg.qr(np.vstack(free))
        cost += ca.sumsqr(R @ z[:n, N] - Q.T @ problem.target.after_m_s2) / energy
    if problem.thermal is not None:
        model = problem.thermal.model
        rise = opti.variable(model.nodes, N + 1)
        opti.subject_to(rise[:, 0] == 0)
        for k in range(N):
            heating = model.heating
            first, last = z[n - 1, k], heating.decay * z[n - 1, k] + (1 - heating.decay) * z[n, k + 1]
            mean = heating.share * first + (1 - heating.share) * last
            square = heating.square[0] * first**2 + heating.square[1] * first * last + heating.square[2] * last**2
            heat = square + 2 * PWM_RIPPLE_A * ca.fabs(mean) + PWM_RIPPLE_A**2
            power = (model.gain[k] + model.copper * rise[0, k]) * heat
            opti.subject_to(rise[:, k + 1] == model.M @ rise[:, k] + model.b * power)
            opti.subject_to(rise[0, k + 1] <= model.headroom_K[k])
    opti.minimize(cost)
    opti.set_value(wanted, r)
    return opti, z[n, 1:]
