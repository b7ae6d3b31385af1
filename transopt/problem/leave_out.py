"""What a problem does not need: limits that no admissible command can reach (DESIGN 4, leaving out)."""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import CoilModel, effective_square
from transopt.plant.discretise import StageModel, TimeGrid, discretise
from transopt.plant.wall import FeedbackLoop, HandOver
from transopt.problem.heat import Budget, ThermalLimit, thermal_limit
from transopt.problem.problem import TransientProblem


def reference_course(grid: TimeGrid, reference_m_s2: FloatArray) -> FloatArray:
    """(N,) deviation of the stylus from its nominal motion at the ticks, if it followed the reference (N,)."""
    velocity = scipy.integrate.cumulative_trapezoid(reference_m_s2, dx=grid.dt_s, initial=0)
    course = scipy.integrate.cumulative_trapezoid(velocity, dx=grid.dt_s, initial=0)
    return np.asarray(np.interp(grid.issue_times_s, grid.switching_times_s, course))


def thermal_of(
    coil: CoilModel | None,
    amplifier: Amplifier | None,
    grid: TimeGrid,
    budget: Budget,
    wall: HandOver | None,
    reference_m_s2: FloatArray,
) -> ThermalLimit | None:
    """The temperature limit of one entry; None without a coil.

    Between taps that repeat flows what the budget states or else what the wall asks for when the window ends: the
    hand leans on the wall until it comes in again, which heats more than lifting off.
    """
    if coil is None:
        return None
    if budget.idle_A is None and wall is not None:
        leaning = float(wall.feedback(reference_course(grid, reference_m_s2), grid.dt_s)[-1])
        budget = replace(budget, idle_A=leaning)
    return thermal_limit(coil, amplifier, grid, budget)


def silence(problem: TransientProblem) -> tuple[TransientProblem, FloatArray]:
    """The problem with its wall pressing where it does when no transient plays, and that command (N,); zero without.

    Tick by tick, with the wall's law closed over the stage model.
    """
    stage, wall, N = problem.stage, problem.wall, problem.grid.stages
    command = np.zeros(N)
    if wall is None:
        return problem, command
    assert stage.Cp is not None
    assert stage.Dp is not None
    loop = FeedbackLoop(
        wall.wall, stage.amplifier, problem.grid.dt_s, wall.nominal_m[:1], np.array([wall.approach_m_s])
    )
    course, late, x = np.zeros(N), stage.whole_delay + 1, np.zeros((stage.A.shape[0], 1))
    with np.errstate(over="ignore", invalid="ignore"):  # a wall that grows by itself
        for k in range(N):
            command[k] = loop.step(wall.nominal_m[k : k + 1] + course[k])[0]
            if k + late < N:
                course[k + late] = (stage.Cp @ x + stage.Dp * command[k])[0, 0]
            x = stage.A @ x + stage.B * command[k]
    return pressing(problem, course), command


@dataclass(frozen=True)
class Reduced:
    """A smaller problem with the same answer, and part -> why it may be missing."""

    problem: TransientProblem
    left_out: dict[str, str]


def temperature_bound_C(problem: TransientProblem) -> float:
    """What the winding cannot exceed, whatever the optimiser chooses: the limit current held throughout."""
    thermal = problem.thermal
    assert thermal is not None
    limit, grid = problem.limits.current_A, problem.grid
    # The delay belongs to it: the ripple of Eq. 7 heats before the first command arrives.
    duration = (grid.stages + 1) * grid.dt_s + grid.delay_s
    if thermal.period_s is None:
        return thermal.coil.adiabatic_bound_C(limit, duration)
    heat = np.full((1, grid.stages + 1), float(effective_square(np.asarray(limit))))
    pause = thermal.period_s - duration
    winding, _ = thermal.coil.steady_course(
        heat, np.full(grid.stages + 1, duration / (grid.stages + 1)), pause, np.array([thermal.budget.pause_A])
    )
    return float(winding.max())


def voltage_bound_V(problem: TransientProblem) -> float:
    """Largest terminal voltage of any command inside the current and command limits."""
    supply = problem.supply
    assert supply is not None
    current, command = problem.limits.current_A, problem.limits.command_bound_A
    impulse = np.zeros(problem.grid.stages)
    impulse[0] = 1.0
    response = np.abs(problem.stage.motion(impulse).velocity_m_s)
    velocity = np.append(0.0, np.cumsum(response)[1:]) * command + np.abs(supply.nominal_m_s)
    drop = abs(supply.by_current) * current + supply.by_command * command
    return float(drop + supply.circuit.emf_V_s_m * velocity.max())


def leave_out(problem: TransientProblem) -> Reduced:
    """The problem without the limits that cannot matter, each with its proof."""
    limits, reasons = problem.limits, {}
    if limits.slew_A_per_s is not None:
        step = limits.slew_A_per_s * problem.grid.dt_s
        if step >= 2 * limits.command_bound_A:
            reasons["slew"] = (
                f"no command inside +-{limits.command_bound_A:g} A moves by more than "
                f"{2 * limits.command_bound_A:g} A per tick, limit {step:g} A"
            )
            problem = replace(problem, limits=replace(limits, slew_A_per_s=None))
    if problem.supply is not None:
        bound = voltage_bound_V(problem)
        if bound <= problem.supply.limit_V:
            reasons["supply"] = (
                f"no current inside its limits takes more than {bound:.1f} V, limit {problem.supply.limit_V:g} V"
            )
            problem = replace(problem, supply=None)
    if problem.thermal is not None:
        bound = temperature_bound_C(problem)
        if bound <= problem.thermal.limit_C:
            reasons["temperature"] = _cold_proof(problem, bound)
            problem = replace(problem, thermal=None)
    if problem.wall is not None and not problem.wall.pressing[max(problem.free_stages - 1, 0) :].any():
        reasons["feedback"] = "the stylus is above the surface over the hand-over: the wall asks for nothing there"
        problem = replace(problem, wall=None, stage=without_position(problem.stage))
    return Reduced(problem, reasons)


def _cold_proof(problem: TransientProblem, bound_C: float) -> str:
    assert problem.thermal is not None
    throughout = f"cannot pass {bound_C:.2f} C even if {problem.limits.current_A:g} A flowed"
    if problem.thermal.period_s is None:
        return f"{throughout} for the whole horizon and no heat left the winding, limit {problem.thermal.limit_C:g} C"
    rate = problem.thermal.budget.tap_rate_Hz
    return f"{throughout} throughout every tap, {rate:g} taps/s for ever, limit {problem.thermal.limit_C:g} C"


def without_position(stage: StageModel) -> StageModel:
    """The same device without the encoder's position, and without the states that only it depends on."""
    return discretise(stage.plant, stage.amplifier, stage.dt_s)


def encoder_course(problem: TransientProblem, command_A: FloatArray) -> FloatArray:
    """(N,) deviation of the encoder at the ticks under a command."""
    return problem.encoder_at_ticks(problem.stage.motion(command_A))


def pressing(problem: TransientProblem, deviation_m: FloatArray) -> TransientProblem:
    """The same problem with the ticks at which its wall pushes taken from an encoder course (N,) of deviations."""
    wall = problem.wall
    assert wall is not None
    pushes = wall.feedback(deviation_m, problem.grid.dt_s) > 0
    return replace(problem, wall=replace(wall, pressing=pushes))
