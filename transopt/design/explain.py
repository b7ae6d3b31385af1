"""Why no command meets all limits: which limit, by how much, when, and what would do (DESIGN 4)."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.problem import Certificate, Multipliers, Status, TransientProblem
from transopt.problem.stage import wall_growth
from transopt.proof.certify import Box, boxes, certify
from transopt.solvers.choose import capable, solve
from transopt.solvers.feasibility import least_widening
from transopt.solvers.options import SolverOptions

WIDEST = 64.0  # times the limit: beyond, widening it alone is no remedy
MOST_ITERATIONS = 100
GROWS = 1e-6  # per tick: more than rounding
MOST_SOLVERS = 2  # asked whether a limit can be met
PRECISION = 0.005  # relative, of the least limit that would do


def rounded_up(value: float) -> float:
    """To four digits, so that what is printed is enough; temperatures keep their millikelvins."""
    grain = 10.0 ** (np.floor(np.log10(abs(value))) - 3) if value else 1.0
    return float(np.ceil(value / min(grain, 1e-3)) * min(grain, 1e-3))


def widened(problem: TransientProblem) -> dict[str, Callable[[float], TransientProblem]]:
    """For each limit the problem with that limit `factor` times as wide; a coil gets kelvins in that proportion."""
    limits = problem.limits
    found: dict[str, Callable[[float], TransientProblem]] = {}
    if problem.thermal is not None:
        thermal = problem.thermal

        def warmer(factor: float) -> TransientProblem:
            rise = (factor - 1) * max(float(thermal.model.headroom_K.max()), 1.0)
            model = replace(thermal.model, headroom_K=thermal.model.headroom_K + rise)
            return replace(problem, thermal=replace(thermal, model=model))

        found["coil"] = warmer
    if problem.supply is not None:
        supply = problem.supply
        found["supply"] = lambda factor: replace(problem, supply=replace(supply, limit_V=factor * supply.limit_V))
    if limits.slew_A_per_s is not None:
        slew = limits.slew_A_per_s
        found["slew"] = lambda factor: replace(problem, limits=replace(limits, slew_A_per_s=factor * slew))
    if limits.command_A is not None:
        command = limits.command_A
        found["command"] = lambda factor: replace(problem, limits=replace(limits, command_A=factor * command))
    found["current"] = lambda factor: replace(problem, limits=replace(limits, current_A=factor * limits.current_A))
    return found


def _cooler(problem: TransientProblem) -> str:
    """What makes an idle coil cooler, in keys of the scene."""
    assert problem.thermal is not None
    coil, budget = problem.thermal.coil, problem.thermal.budget
    if budget.tap_rate_Hz is not None:
        return f"lower thermal.idle_A ({budget.pause_A:.3g} A) or thermal.ambient_C ({coil.ambient_C:g} C)"
    if budget.headroom_K is not None:
        return f"raise thermal.headroom_K ({budget.headroom_K:g} K) or cool the housing ({coil.start_housing_C:g} C)"
    return (
        f"lower thermal.start_winding_C ({coil.start_winding_C:g} C), start_housing_C ({coil.start_housing_C:g} C), "
        f"or ambient_C ({coil.ambient_C:g} C)"
    )


def unstable_wall(problem: TransientProblem) -> str:
    """Whether the pressing wall grows by itself on this device; empty if it does not."""
    if problem.wall is None:
        return ""
    wall, growth = problem.wall.wall, wall_growth(problem)
    if growth <= 1 + GROWS:
        return ""
    keys = (
        ("feedback.stiffness_N_m", wall.stiffness_N_m, " N/m"),
        ("feedback.damping_N_s_m", wall.damping_N_s_m, " N s/m"),
        ("feedback.latency_ticks", wall.latency_ticks, ""),
    )
    lower = " or ".join(f"{key} ({value:g}{unit})" for key, value, unit in keys if value > 0)
    return f"feedback: on this device the pressing wall grows {growth:.4g} times per tick; lower {lower}"


def unavoidable(problem: TransientProblem) -> list[str]:
    """Limits that are missed whatever is commanded: known without a solve.

    No current heats less than the ripple alone; and before the first command is felt the motor already moves.
    """
    found, tau_ms = [], problem.grid.switching_times_s * 1e3
    if problem.thermal is not None:
        model, limit = problem.thermal.model, problem.thermal.limit_C
        ripple = model.heating.mean_square(np.zeros(problem.grid.stages), np.zeros(problem.grid.stages))
        excess = model.rise(ripple)[1:, 0] - model.headroom_K
        k = int(np.argmax(excess))
        if not np.isfinite(excess[k]):
            found.append(f"coil: no steady state even without a transient, thermal runaway; {_cooler(problem)}")
        elif excess[k] > Certificate.VIOLATION_TOLERANCE:
            found.append(
                f"coil {excess[k]:.2g} K over its {limit:.8g} C at {tau_ms[k]:.1f} ms even without a transient; "
                f"{_cooler(problem)}"
            )
    if problem.supply is not None:
        start = abs(float(problem.supply.nominal_V[0]))
        if start > problem.supply.limit_V + Certificate.tolerated(problem.supply.limit_V):
            found.append(
                f"supply {start - problem.supply.limit_V:.3g} V over its {problem.supply.limit_V:g} V at "
                f"{tau_ms[0]:.1f} ms: the back-EMF of the incoming stylus alone; {rounded_up(start):.6g} V at least"
            )
    return found


def _feasible(problem: TransientProblem, options: SolverOptions) -> FloatArray | None:
    """A command inside all limits, optimal or not, from the first solver that finds one or says there is none."""
    briefly = replace(options, max_iterations=min(options.max_iterations, MOST_ITERATIONS))
    for name in capable(problem)[:MOST_SOLVERS]:
        answer = solve(problem, replace(briefly, solver=name))
        if certify(problem, answer.command_A, answer.multipliers).excess <= 1:
            return answer.command_A
        if answer.status is Status.INFEASIBLE:
            return None
    return None


def infeasibility(problem: TransientProblem, options: SolverOptions) -> list[str]:
    """One sentence for each limit whose widening alone would help or, if none would, for all of them together.

    Empty if even that is not enough. What the linear limits lack is found by linear programs; only where they can be
    met it is the temperature, whose least limit is found by bisection. The command that just meets the wider limit
    tells by how much and when the stated one is missed.
    """
    by_name = widened(problem)
    linear = [name for name in by_name if name != "coil"]
    together = least_widening(problem, linear)
    if together is None:
        return []
    if together[0] > 1:
        found = []
        for name in linear:
            least = least_widening(problem, [name])
            if least is not None:
                found.append(_sentence(problem, by_name[name](least[0]), name, least[1]))
        if found:
            return found
        factor, command = together
        wide = problem
        for name in linear:
            wide = widened(wide)[name](factor)
        missed = [name for name in linear if _worst(problem, name, command)[1] > 0]
        return [f"{_sentence(problem, wide, name, command)}, all limits wider at once" for name in missed]
    if problem.thermal is None:
        return []
    warmer = _least(by_name["coil"], options)
    return [] if warmer is None else [_sentence(problem, by_name["coil"](warmer[0]), "coil", warmer[1])]


def _least(widen: Callable[[float], TransientProblem], options: SolverOptions) -> tuple[float, FloatArray] | None:
    """The least factor, to `PRECISION`, at which a command meets all limits, and that command; None if none does."""
    command = _feasible(widen(WIDEST), options)
    if command is None:
        return None
    low, high = 1.0, WIDEST
    while high / low > 1 + PRECISION:
        middle = float(np.sqrt(low * high))
        tried = _feasible(widen(middle), options)
        if tried is None:
            low = middle
        else:
            high, command = middle, tried
    return high, command


def _worst(problem: TransientProblem, name: str, command_A: FloatArray) -> tuple[Box, float]:
    """The side of a limit that a command leaves farthest, and how far; negative inside."""
    motion = problem.stage.motion(command_A)
    of = [box for box in boxes(problem, command_A, motion, Multipliers.zero(problem)) if box.name == name]
    worst = max(of, key=lambda box: float(box.excess.max()))
    return worst, float(worst.excess.max())


def _sentence(problem: TransientProblem, wide: TransientProblem, name: str, command_A: FloatArray) -> str:
    worst, _ = _worst(problem, name, command_A)
    wider = [
        box
        for box in boxes(wide, command_A, problem.stage.motion(command_A), Multipliers.zero(problem))
        if box.name == name
    ]
    k = int(np.argmax(worst.excess))
    time_ms = problem.grid.switching_times_s[k] * 1e3
    unit = "K" if worst.unit == "C" else worst.unit
    enough = float(wider[0].bound[np.isfinite(wider[0].bound)].max())
    return (
        f"{name} {worst.excess[k]:.3g} {unit} over its {worst.stated:.8g} {worst.unit} at {time_ms:.1f} ms at the "
        f"least; {rounded_up(enough):.8g} {worst.unit} would do"
    )
