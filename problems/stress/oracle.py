"""Decides feasibility by a linear program that shares no code with the solvers."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import optimize

from transopt.base import apart
from transopt.base.signals import FloatArray
from transopt.plant.discretise import AFTER
from transopt.problem.limits.output import OutputLimit
from transopt.problem.limits.supply import SupplyLimit
from transopt.problem.problem import TransientProblem
from transopt.proof.effect import inside

MOST_STAGES = 700  # largest number of stages for the linear program
LONGEST_S = 60.0  # time limit of the linear program
LATE_S = 20.0  # further time after which its process is ended
CLEARLY = 1e-4  # share of the limits beyond the rounding errors of both methods
DECIDED = (0, 2)  # status codes of scipy's linprog for an optimum and for infeasibility


@dataclass(frozen=True)
class Verdict:
    """The oracle's verdict on feasibility.

    Attributes
    ----------
    way_out : description of a feasible command; empty if none was found.
    decided : whether the search was complete, so that an empty `way_out` proves infeasibility.
    """

    way_out: str
    decided: bool


def admits_a_command(problem: TransientProblem, *, ignoring_heat: bool = False) -> Verdict:
    """Whether a feasible command exists, as far as an independent method can decide it.

    The zero command is tried first. Then a linear program maximises the least slack over all commands, with every
    stage's state as a sum of impulse responses. The temperature is not a linear limit, so a problem with it stays
    undecided, unless it is ignored or the heat of the ripple alone exceeds it.
    """
    if ignoring_heat:
        problem = problem.without("temperature")
    nothing = np.zeros(problem.grid.stages)
    if problem.wall is None and inside(problem, nothing):
        return Verdict("doing nothing keeps all limits", decided=True)
    if problem.thermal is not None:
        return Verdict("", decided=not inside(problem, nothing, only="temperature"))
    if problem.grid.stages > MOST_STAGES:
        return Verdict("", decided=False)
    try:
        # A separate process isolates crashes, output and hangs of the method's native code.
        room = apart.call(_room, problem, LONGEST_S, within_s=LONGEST_S + LATE_S)
    except apart.UnansweredError:
        room = None
    if room is None:
        return Verdict("", decided=False)
    way_out = f"a command keeps all limits with {room:.1e} of them to spare" if room > CLEARLY else ""
    return Verdict(way_out, decided=True)


def _room(problem: TransientProblem, longest_s: float) -> float | None:
    """Largest s such that every limit keeps a relative slack of s: max over commands of min of 1 - |value| / limit.

    Minus infinity if the hand-over is infeasible, None if the linear program ended undecided.
    """
    N, limits, stage = problem.grid.stages, problem.limits, problem.stage
    unit = problem.command_bound
    motion = stage.motion(np.eye(N) * unit)
    at_rest = stage.motion(np.zeros(N))
    # Each row of `responses` is one limited quantity per command; `offset` its value without any.
    # Of a supply that sags the bound moves along the horizon.
    (row,) = limits.input.rows(problem)
    quantities: list[tuple[FloatArray, FloatArray, float | FloatArray]]
    quantities = [(motion.plant_input.T, np.zeros(N), row.upper)]
    quantities.append((np.eye(N) * unit, np.zeros(N), problem.command_bound))
    slew, supply = limits.get("slew") or limits.get("voltage_slew"), limits.get("supply")
    for limit in limits:
        if isinstance(limit, OutputLimit):
            reached = motion.outputs[limit.output + AFTER].T
            quantities.append((reached, limit.nominal[1:], limit.limit - limit.margin()))
    if slew is not None:
        quantities.append(((np.eye(N) - np.eye(N, k=-1)) * unit, np.zeros(N), slew.stated))
    if supply is not None:
        assert isinstance(supply, SupplyLimit)
        w, rest = supply.pole_rad_s, supply.nominal_V
        # The command that acts just before and just after each switching instant, with the copper cold and hot.
        for circuit, felt in product((end.circuit for end in supply.ends), (np.eye(N, k=-1), np.eye(N))):
            rate = w * (felt * unit - motion.plant_input.T)
            volts = circuit.R_ohm * motion.plant_input.T + circuit.L_H * rate
            quantities.append((volts + circuit.emf_V_s_m * motion.velocity_m_s.T, rest, supply.limit_V))
    blocks, bounds = [], []
    for response, offset, bound in quantities:
        for sign in (1.0, -1.0):
            most = np.broadcast_to(bound, N)
            blocks.append(np.hstack([sign * response / most[:, None], np.ones((N, 1))]))
            bounds.append(1.0 - sign * offset / most)
    tail = np.arange(problem.free_stages, N)
    asked = problem.hand_over_command(at_rest)[tail]
    answered = np.stack(
        [command - problem.hand_over_command(stage.motion(command)) for command in np.eye(N) * unit], axis=1
    )
    # The feedback is affine in the commands: its constant part is on the right-hand side.
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
        options={"time_limit": longest_s},
    )
    if found.status not in DECIDED:
        return None
    return -np.inf if found.x is None else float(found.x[-1])
