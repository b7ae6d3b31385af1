"""The optimum of one entry: the smallest problem that has it, solved (DESIGN 4)."""

from dataclasses import dataclass, replace

import numpy as np

from transopt import transcribe
from transopt.certify import inside
from transopt.explain import infeasibility, unavoidable
from transopt.parts import leave_out, pressing, reference_course, silence
from transopt.problem import Certificate, Solution, Status, TransientProblem
from transopt.signals import FloatArray, nrmse
from transopt.solvers import SolverOptions, is_stationary, prove, solve, solve_certified, unlimited

MOST_MASKS = 5  # solves until the wall pushes exactly where it was assumed to


@dataclass(frozen=True)
class Designed:
    """One entry before its replay.

    Attributes
    ----------
    problem : with every limit of the scene, and the wall pushing where the answer makes it push.
    certificate : of the answer for that whole problem.
    unlimited_command_A : (N,) the optimum without limits. floor : its NRMSE. free_peak_A : its peak current.
    left_out : part -> why the problem that was solved does not have it.
    size : of the program that was solved; None where one linear solve was enough.
    remarks : why an entry has no answer.
    """

    problem: TransientProblem
    solution: Solution
    certificate: Certificate
    unlimited_command_A: FloatArray
    floor: float
    free_peak_A: float
    left_out: dict[str, str]
    size: transcribe.Size | None
    remarks: list[str]


def optimum(problem: TransientProblem, options: SolverOptions) -> Designed:
    """Solve one entry, leaving out what it does not need.

    With a wall the ticks at which it pushes are first taken from the reference's motion, then from the answer's,
    until both agree.
    """
    if problem.reference_is_zero:
        return _silent(problem, options)
    if problem.wall is None:
        return _solved(problem, options)
    problem = pressing(problem, reference_course(problem.grid, problem.reference_m_s2))
    spent = 0.0
    for _ in range(MOST_MASKS):
        designed = _solved(problem, options)
        spent += designed.solution.solve_time_s
        course = problem.encoder_at_ticks(problem.stage.motion(designed.solution.command_A))
        again = pressing(problem, course)
        if _same_mask(problem, again):
            break
        problem = again
    return replace(designed, solution=replace(designed.solution, solve_time_s=spent))


def _silent(problem: TransientProblem, options: SolverOptions) -> Designed:
    """A zero reference: no transient at all, over a wall nothing but its feedback, which has to keep the limits."""
    problem, command = silence(problem)
    answer = replace(solve(problem, options), command_A=command)
    proof = prove(problem, command, answer.multipliers, options)
    hopeless = unavoidable(problem)
    if hopeless:
        answer = replace(answer, status=Status.INFEASIBLE)
    elif problem.wall is not None and not proof.excess <= 1:
        wall, limit = problem.wall.wall, problem.limits.current_A
        answer = replace(answer, status=Status.HAND_OVER)
        hopeless = [
            f"hand-over: without any transient the wall alone asks for {np.abs(command).max():.3g} A, limit "
            f"{limit:g} A; lower feedback.stiffness_N_m ({wall.stiffness_N_m:g} N/m), feedback.damping_N_s_m "
            f"({wall.damping_N_s_m:g} N s/m) or the speed"
        ]
    left_out = {"limits": "zero reference: zero waveform"}
    rest = np.zeros(problem.grid.stages)
    floor = nrmse(rest, problem.reference_m_s2)
    return Designed(problem, answer, proof, rest, floor, 0.0, left_out, None, hopeless)


def _same_mask(problem: TransientProblem, other: TransientProblem) -> bool:
    """Over the hand-over and the tick before it, which the prefilter remembers."""
    assert problem.wall is not None
    assert other.wall is not None
    first = max(problem.free_stages - 1, 0)
    return bool(np.array_equal(problem.wall.pressing[first:], other.wall.pressing[first:]))


def _hand_over_excess(problem: TransientProblem) -> str:
    """Whether the wall alone asks for too much when the transient has to end, on the reference's course; or empty."""
    wall, limit = problem.wall, problem.limits.current_A
    if wall is None:
        return ""
    z = wall.encoder(reference_course(problem.grid, problem.reference_m_s2))[problem.free_stages :]
    deepest = float(-z.min())
    current = wall.wall.stiffness_N_m * deepest / wall.wall.force_per_current_N_A
    if current <= limit:
        return ""
    allowed = limit * wall.wall.force_per_current_N_A / deepest
    return (
        f"hand-over: K_p z / k_f = {current:.2f} A at {deepest * 1e3:.2f} mm below the surface, where the reference "
        f"goes, limit {limit:g} A; {np.floor(allowed):g} N/m would do"
    )


def _solved(problem: TransientProblem, options: SolverOptions) -> Designed:
    """The optimum with the wall's ticks fixed."""
    reduced = leave_out(problem)
    small, left_out = reduced.problem, dict(reduced.left_out)
    free = unlimited.solve(small)
    acceleration, current = problem.stage.rollout(free.command_A)
    floor = nrmse(acceleration, problem.reference_m_s2)
    peak = float(np.abs(current).max())

    def designed(answer: Solution, size: transcribe.Size | None, remarks: list[str]) -> Designed:
        proof = prove(problem, answer.command_A, answer.multipliers, options)
        return Designed(problem, answer, proof, free.command_A, floor, peak, left_out, size, remarks)

    if inside(problem, free.command_A):
        left_out["limits"] = (
            f"the unlimited optimum is inside all limits: current {peak:.3g} A of {problem.limits.current_A:g} A, "
            f"command {np.abs(free.command_A).max():.3g} A of {problem.limits.command_bound_A:g} A"
        )
        return designed(free, None, [])
    hopeless = unavoidable(small)
    if hopeless:
        return designed(replace(free, status=Status.INFEASIBLE), None, hopeless)
    spent = free.solve_time_s
    if small.thermal is not None:
        cold = solve_certified(replace(small, thermal=None), options)
        spent += cold.solve_time_s
        if cold.status is Status.OPTIMAL and inside(problem, cold.command_A, only="coil"):
            hottest = float(small.thermal.temperatures_C(*_currents(small, cold.command_A)).max())
            left_out["temperature"] = (
                f"the optimum without it stays inside: {hottest:.3f} C, limit {small.thermal.limit_C:g} C"
            )
            answer = replace(cold, solve_time_s=spent)
            return designed(answer, transcribe.size(replace(small, thermal=None)), [])
    answer = solve_certified(small, options)
    answer = replace(answer, solve_time_s=spent + answer.solve_time_s)
    remarks = []
    idle = small.wall is None and inside(small, np.zeros(small.grid.stages))
    too_deep = "" if is_stationary(small, answer) else _hand_over_excess(small)
    if too_deep:
        return designed(replace(answer, status=Status.HAND_OVER), transcribe.size(small), [too_deep])
    if not is_stationary(small, answer) and not idle:
        # Doing nothing is no way out either: perhaps there is none, whatever the solver called it.
        remarks = infeasibility(small, options)
        answer = replace(answer, status=Status.INFEASIBLE) if remarks else answer
    return designed(answer, transcribe.size(small), remarks)


def _currents(problem: TransientProblem, command_A: FloatArray) -> tuple[FloatArray, FloatArray]:
    return problem.stage.rollout(command_A)[1], command_A
