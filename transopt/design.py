"""The design of library entries: optimum, floor, baselines, certificate, replay, admission (DESIGN 4)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from transopt.baselines import clipped_optimum, seed_inversion
from transopt.certify import binding_limits, certify
from transopt.discretise import StageModel, acting_states, discretise
from transopt.problem import Certificate, Solution, Status, TransientProblem, verdict
from transopt.reference import Reference
from transopt.replay import Replay, replay
from transopt.scene import Scene
from transopt.signals import FloatArray, nrmse
from transopt.solvers import SOLVERS, SolverOptions, solve, unlimited
from transopt.thermal import CoilModel
from transopt.verify import admit, temperature_bound_C


@dataclass(frozen=True)
class Baselines:
    """NRMSE of the two other methods after replay, at the transient limit and at the steady limit."""

    seed: float
    clipped: float
    seed_steady: float
    clipped_steady: float


@dataclass(frozen=True)
class Entry:
    """One (speed, grip) of a library, with everything that is said about it.

    Attributes
    ----------
    predicted_m_s2, current_A : (N,) y'' and i of the command at the switching instants.
    floor : NRMSE of the unlimited optimum. free_peak_A : its peak current.
    status, shortfalls : admission; shortfalls is empty for an OPTIMAL entry.
    left_out : part of the problem -> why it is not in it.
    """

    speed_m_s: float
    grip_N: float
    problem: TransientProblem
    solution: Solution
    certificate: Certificate
    played: Replay
    predicted_m_s2: FloatArray
    current_A: FloatArray
    floor: float
    free_peak_A: float
    baselines: Baselines
    repeatability: float
    status: Status
    shortfalls: list[str]
    binding: str
    left_out: dict[str, str]

    @property
    def nrmse(self) -> float:
        return self.played.nrmse

    @property
    def verdict(self) -> str:
        if self.status is not Status.OPTIMAL:
            return "refused"
        if self.problem.reference_is_zero:
            return "zero reference"
        return verdict(self.nrmse, self.floor, self.repeatability)


def _inside_limits(problem: TransientProblem, command_A: FloatArray, current_A: FloatArray) -> bool:
    limits = problem.limits
    step = limits.slew_A_per_s
    return bool(
        np.abs(current_A).max() <= limits.current_A
        and np.abs(command_A).max() <= limits.command_bound_A
        and (step is None or np.abs(np.diff(command_A, prepend=0.0)).max() <= step * problem.grid.dt_s)
    )


def _left_out(scene: Scene, problem: TransientProblem, coil: CoilModel | None, free: str | None) -> dict[str, str]:
    """Every part that the problem does not have, and why it may be missing."""
    idle = int(np.sum(~acting_states(problem.stage.plant)))
    parts = {
        "feedback": "the scene has no wall",
        "position": "nothing in the scene depends on it" + (f": {idle} state fewer" if idle else ""),
        "supply": "the scene states no supply limit",
    }
    if problem.limits.slew_A_per_s is None:
        parts["slew"] = "the scene states no slew limit"
    if problem.stage.amplifier is None:
        parts["amplifier"] = "ideal in the scene"
    if scene.grid.grips_N[0] == 0:
        parts["hand"] = "free device, grip 0"
    if coil is None:
        parts["temperature"] = "the scene has no motor data"
    elif temperature_bound_C(problem, coil) <= coil.limit_C:
        parts["temperature"] = (
            f"cannot pass {temperature_bound_C(problem, coil):.2f} C even if {problem.limits.current_A:g} A flowed "
            f"for the whole horizon and no heat left the winding, limit {coil.limit_C:g} C"
        )
    if free is not None:
        parts["limits"] = free
    return parts


@dataclass(frozen=True)
class Designed:
    """One entry before its replay.

    Attributes
    ----------
    floor, free_peak_A : NRMSE and peak current of the unlimited optimum `unlimited_command_A` (N,).
    free : why the unlimited optimum is the answer, None if it is not.
    """

    problem: TransientProblem
    solution: Solution
    unlimited_command_A: FloatArray
    floor: float
    free_peak_A: float
    free: str | None


def optimum(problem: TransientProblem, options: SolverOptions) -> Designed:
    """The optimum of one entry: the unlimited one if it is inside all limits, else the solver's."""
    if problem.reference_is_zero:
        answer = solve(problem, options)
        floor = nrmse(answer.command_A, problem.reference_m_s2)
        return Designed(problem, answer, answer.command_A, floor, 0.0, "zero reference: zero waveform")
    free = unlimited.solve(problem)
    acceleration, current = problem.stage.rollout(free.command_A)
    r = problem.reference_m_s2
    floor = nrmse(acceleration, r)
    peak = float(np.abs(current).max())
    if _inside_limits(problem, free.command_A, current):
        reason = (
            f"the unlimited optimum is inside all limits: current {peak:.3g} A of {problem.limits.current_A:g} A, "
            f"command {np.abs(free.command_A).max():.3g} A of {problem.limits.command_bound_A:g} A"
        )
        return Designed(problem, free, free.command_A, floor, peak, reason)
    answer = _proven(problem, options)
    answer = replace(answer, solve_time_s=free.solve_time_s + answer.solve_time_s)
    return Designed(problem, answer, free.command_A, floor, peak, None)


def _proven(problem: TransientProblem, options: SolverOptions) -> Solution:
    """The wanted solver's answer or, where that is not certified, the first other solver's that is.

    On stiff and extreme problems the methods fail on different cases; the certificate tells.
    """

    def is_proven(answer: Solution) -> bool:
        proof = certify(problem, answer.command_A, answer.multipliers)
        return answer.status is Status.OPTIMAL and proof.accepted

    wanted = solve(problem, options)
    if is_proven(wanted):
        return wanted
    others = (solve(problem, replace(options, solver=name)) for name in SOLVERS if name != options.solver)
    return next((answer for answer in others if is_proven(answer)), wanted)


def entry_problem(scene: Scene, stage: StageModel, reference: Reference) -> TransientProblem:
    """What one entry has to meet: the stage model of its grip, the reference of its speed."""
    grid = scene.time_grid()
    return TransientProblem(
        stage=stage,
        grid=grid,
        reference_m_s2=reference.motor_m_s2,
        tracking_weights=np.ones(grid.stages),
        rho=scene.weights.rho,
        limits=scene.current_limits(),
        hand_over_samples=scene.hand_over_samples,
    )


def design_grip(scene: Scene, grip_N: float, references: Sequence[Reference], options: SolverOptions) -> list[Entry]:
    """All entries of one grip, in the order of the references.

    Solved one by one with one solver object; the optimum and the baselines of all speeds are replayed together.
    """
    grid, limits, coil = scene.time_grid(), scene.current_limits(), scene.coil()
    stage = discretise(scene.plant(grip_N), scene.amplifier_model(), grid.dt_s)
    designed = [optimum(entry_problem(scene, stage, reference), options) for reference in references]
    rivals = [
        _rivals(stage, d, limit) for d in designed for limit in (limits.current_A, scene.limits.steady_current_A)
    ]
    commands = [d.solution.command_A for d in designed] + [c for pair in rivals for c in pair]
    each = np.stack([reference.motor_m_s2 for reference in references])
    wanted = np.concatenate([each, np.repeat(each, 4, axis=0)])
    # A solver that broke down returns NaN, which no integrator needs to see.
    playable = np.nan_to_num(np.stack(commands), nan=0.0, posinf=0.0, neginf=0.0)
    replays = replay(stage, grid, playable, wanted, coil)
    return [
        _entry(scene, grip_N, reference, d, replays[j], replays[len(designed) + 4 * j : len(designed) + 4 * (j + 1)])
        for j, (reference, d) in enumerate(zip(references, designed, strict=True))
    ]


def _rivals(stage: StageModel, designed: Designed, limit_A: float) -> tuple[FloatArray, FloatArray]:
    grid, reference = designed.problem.grid, designed.problem.reference_m_s2
    return (
        seed_inversion(stage, grid, reference, limit_A, designed.problem.hand_over_samples),
        clipped_optimum(stage, grid, designed.unlimited_command_A, limit_A),
    )


def _entry(
    scene: Scene, grip_N: float, reference: Reference, designed: Designed, played: Replay, rivals: Sequence[Replay]
) -> Entry:
    problem, solution, coil = designed.problem, designed.solution, scene.coil()
    certificate = certify(problem, solution.command_A, solution.multipliers)
    predicted, current = problem.stage.rollout(solution.command_A)
    status, shortfalls = admit(solution.status, certificate, played, problem, coil, predicted)
    seed, clipped, seed_steady, clipped_steady = (rival.nrmse for rival in rivals)
    return Entry(
        speed_m_s=reference.speed_m_s,
        grip_N=grip_N,
        problem=problem,
        solution=solution,
        certificate=certificate,
        played=played,
        predicted_m_s2=predicted,
        current_A=current,
        floor=designed.floor,
        free_peak_A=designed.free_peak_A,
        baselines=Baselines(seed, clipped, seed_steady, clipped_steady),
        repeatability=reference.repeatability,
        status=status,
        shortfalls=shortfalls,
        binding=binding_limits(problem, solution.command_A, solution.multipliers),
        left_out=_left_out(scene, problem, coil, designed.free),
    )
