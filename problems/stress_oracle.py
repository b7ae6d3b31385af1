"""Whether any command meets all limits, decided by a linear program that shares no code with the solvers."""

import numpy as np
from scipy import optimize

from transopt.certify import inside
from transopt.problem import TransientProblem

MOST_STAGES = 700  # of the linear program
CLEARLY = 1e-4  # of the limits' width: room that no rounding of either method makes


def admits_a_command(problem: TransientProblem) -> str:
    """What kind of command lies inside all limits; empty if none was found.

    Doing nothing is tried first. Without the temperature, whose limit is no linear one, all commands are then
    searched for the one that is farthest inside, with every stage's state as the sum of impulse responses.
    """
    if problem.wall is None and inside(problem, np.zeros(problem.grid.stages)):
        return "doing nothing keeps all limits"
    if problem.thermal is not None or problem.grid.stages > MOST_STAGES:
        return ""
    room = _room(problem)
    return f"a command keeps all limits with {room:.1e} of them to spare" if room > CLEARLY else ""


def _room(problem: TransientProblem) -> float:
    """Largest share s of every limit that can be left unused: min over limits of 1 - |value| / limit."""
    N, limits, stage = problem.grid.stages, problem.limits, problem.stage
    unit = limits.command_bound_A
    motion = stage.motion(np.eye(N) * unit)
    at_rest = stage.motion(np.zeros(N))
    # Each row of `responses` is what one limited quantity does per command; `offset` what it does without any.
    quantities = [(motion.current_A.T, np.zeros(N), limits.current_A)]
    quantities.append((np.eye(N) * unit, np.zeros(N), limits.command_bound_A))
    if limits.slew_A_per_s is not None:
        difference = np.eye(N) - np.eye(N, k=-1)
        quantities.append((difference * unit, np.zeros(N), limits.slew_A_per_s * problem.grid.dt_s))
    if problem.supply is not None:
        for side in (0, 1):
            rest = problem.supply.voltages_V(at_rest, np.zeros(N))[side]
            columns = [
                problem.supply.voltages_V(stage.motion(command), command)[side] - rest for command in np.eye(N) * unit
            ]
            quantities.append((np.stack(columns, axis=1), rest, problem.supply.limit_V))
    blocks, bounds = [], []
    for response, offset, limit in quantities:
        for sign in (1.0, -1.0):
            blocks.append(np.hstack([sign * response / limit, np.ones((N, 1))]))
            bounds.append(1.0 - sign * offset / limit)
    tail = np.arange(problem.free_stages, N)
    asked = problem.hand_over_command(at_rest)[tail]
    answered = np.stack(
        [command - problem.hand_over_command(stage.motion(command)) for command in np.eye(N) * unit], axis=1
    )
    # The feedback is affine: its share without a command is on the right-hand side.
    at_zero = problem.hand_over_command(at_rest)[:, None]
    rows = (answered + at_zero)[tail] / unit
    found = optimize.linprog(
        c=np.append(np.zeros(N), -1.0),
        A_ub=np.vstack(blocks),
        b_ub=np.concatenate(bounds),
        A_eq=np.hstack([rows, np.zeros((tail.size, 1))]),
        b_eq=asked / unit,
        bounds=[*[(-1.0, 1.0)] * N, (None, 1.0)],
        method="highs",
    )
    return float(found.x[-1]) if found.status == 0 and found.x is not None else -np.inf
