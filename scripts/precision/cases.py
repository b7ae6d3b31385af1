"""The entries on which methods are compared, their reference solutions, and how a command is judged."""

from dataclasses import dataclass

import numpy as np

import problems
from precision.qp import QP, quadratic_program, solved
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.design.context import Context
from transopt.problem.answer import OBJECTIVE_SCALE, Certificate, Multipliers, Solution
from transopt.problem.leave_out import leave_out
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import binding_limits, certify
from transopt.proof.effect import boxes
from transopt.proof.replay import replayed_figures
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings
from transopt.solvers.choose import solve
from transopt.solvers.options import SolverOptions

SCENES = ("wood_on_foam", "firm_fast", "hot_coil", "stiff_drive")
AGREEMENT = 1e-7  # of two methods, relative; a tenth of what counts as solved
SOLVED = 1e-6
# Two methods that share nothing but the statement. For the NLP the second is the compiled extension, without which
# `solve` refuses the comparison in one line.
QP_REFERENCES = (SolverOptions("casadi-piqp", 1e-12), SolverOptions("casadi-ipopt", 1e-12))
NLP_REFERENCES = (SolverOptions("casadi-ipopt", 1e-12), SolverOptions("riccati", 1e-12))


class DisagreementError(Exception):
    """Two methods that ought to find the same optimum do not: nothing can be compared with it."""


def reference_label(method: str, tolerance: float) -> str:
    return f"{method} at {tolerance:g}"


@dataclass(frozen=True)
class Optimum:
    """The reference solution of one case.

    Attributes
    ----------
    command_A : (N,). objective : J of its rollout. tap_error : beside the recorded tap, after replay.
    found_by, confirmed_by : method and tolerance. agreement : difference of their J, relative. apart_A : largest
        difference of their commands. certificate : of the first, by its multipliers.
    """

    command_A: FloatArray
    multipliers: Multipliers
    objective: float
    tap_error: float
    found_by: str
    confirmed_by: str
    agreement: float
    apart_A: float
    certificate: Certificate

    def is_reference(self, method: str, tolerance: float) -> bool:
        """Whether this method at this tolerance is one of the two, so that its error is no measurement."""
        return reference_label(method, tolerance) in (self.found_by, self.confirmed_by)


@dataclass(frozen=True)
class Case:
    """One entry.

    Attributes
    ----------
    problem : with every limit of the scene. small : what has to be solved, without what cannot matter.
    scene, speed_m_s, grip_N : where it comes from. binding : which limits bind, in words.
    qp : None for an NLP.
    """

    name: str
    scene: Scene
    speed_m_s: float
    grip_N: float
    problem: TransientProblem
    small: TransientProblem
    optimum: Optimum
    binding: str
    qp: QP | None

    @property
    def entry(self) -> str:
        return f"{self.speed_m_s:g} m/s, {self.grip_N:g} N"


@dataclass(frozen=True)
class Verdict:
    """What a command is worth, from its rollout through the exact model.

    Attributes
    ----------
    gap : (J - J of the reference) / max(J of the reference, 1e-3); a command outside the limits can be below it.
    violation : largest excess over a limit, relative to that limit (temperature: to the headroom); 0 if none.
    """

    gap: float
    violation: float

    @property
    def error(self) -> float:
        """The larger of |gap| and violation; infinite where a number is not finite."""
        largest = max(abs(self.gap), self.violation)
        return largest if np.isfinite(self.gap) and np.isfinite(self.violation) else float("inf")


FAILED = Verdict(float("inf"), float("inf"))


def objective(problem: TransientProblem, command_A: FloatArray) -> float:
    return problem.objective(command_A, problem.accelerations(command_A))


def judge(problem: TransientProblem, command_A: FloatArray, reference_objective: float) -> Verdict:
    """Judge a command (N,) by the problem's own rollout, whatever it was found with."""
    if command_A.shape != problem.reference_m_s2.shape or not np.all(np.isfinite(command_A)):
        return FAILED
    motion = problem.stage.motion(command_A)
    excess = []
    for box in boxes(problem, command_A, motion, Multipliers.zero(problem)):
        # The room that a limit leaves is the bound itself, but for the temperature what it may rise.
        size = box.upper if problem.thermal is not box.limit else problem.thermal.model.headroom_K
        stated = np.isfinite(size)
        excess.append(float((box.excess[stated] / size[stated]).max(initial=0.0)))
    tail = np.abs(command_A - problem.hand_over_command(motion))[problem.free_stages :]
    excess.append(float(tail.max()) / problem.command_bound)
    gap = (objective(problem, command_A) - reference_objective) / max(reference_objective, OBJECTIVE_SCALE)
    return Verdict(gap, max(excess))


def replayed_tap_errors(problem: TransientProblem, commands_A: FloatArray) -> FloatArray:
    """(M,) tap errors of commands (M, N) in continuous time."""
    targets = [problem.target] * len(commands_A)
    return np.array([f.tap_error for f in replayed_figures(problem.stage, problem.yardstick, commands_A, targets)])


def _confirmed(name: str, problem: TransientProblem, small: TransientProblem) -> Optimum:
    """
    Raises
    ------
    DisagreementError : the two methods do not agree, or the first is not certified.
    """
    first, second = QP_REFERENCES if small.thermal is None else NLP_REFERENCES
    answers: list[Solution] = [solve(small, options) for options in (first, second)]
    values = [objective(problem, answer.command) for answer in answers]
    agreement = abs(values[0] - values[1]) / max(values[0], OBJECTIVE_SCALE)
    outside = max(
        judge(problem, answer.command, value).violation for answer, value in zip(answers, values, strict=True)
    )
    labels = [reference_label(options.solver, options.tolerance) for options in (first, second)]
    # Written so that a NaN is no agreement.
    if not max(agreement, outside) <= AGREEMENT:
        raise DisagreementError(
            f"{name}: {labels[0]} finds J = {values[0]:.12g}, {labels[1]} {values[1]:.12g}: they differ by "
            f"{agreement:.1e} and leave a limit by {outside:.1e}, allowed {AGREEMENT:g}: nothing to compare with"
        )
    proof = certify(problem, answers[0].command, answers[0].multipliers)
    if not proof.is_stationary:
        raise DisagreementError(f"{name}: {labels[0]} is not certified (gap {proof.relative_gap:.1e})")
    command = answers[0].command
    return Optimum(
        command_A=command,
        multipliers=answers[0].multipliers,
        objective=values[0],
        tap_error=float(replayed_tap_errors(problem, command[None])[0]),
        found_by=labels[0],
        confirmed_by=labels[1],
        agreement=agreement,
        apart_A=float(np.abs(command - answers[1].command).max()),
        certificate=proof,
    )


def make_case(name: str, scene: Scene, problem: TransientProblem, speed_m_s: float, grip_N: float) -> Case:
    """The case of one entry, its reference solution found and confirmed."""
    small = leave_out(problem).problem
    optimum = _confirmed(name, problem, small)
    qp = None
    if small.thermal is None:
        qp = solved(quadratic_program(name, small), small, optimum.objective, QP_REFERENCES[0].tolerance)
    binding = binding_limits(problem, optimum.command_A, optimum.multipliers)
    return Case(name, scene, speed_m_s, grip_N, problem, small, optimum, binding, qp)


def check_name(name: str) -> None:
    """
    Raises
    ------
    InputError : no such scene.
    """
    if name not in SCENES:
        raise InputError(f"--case {name}: unknown; choose one of {', '.join(SCENES)}")


def case_of_scene(name: str) -> Case:
    """The entry of a scene that its limits cost most: in all four that of the fastest tap and the firmest grip.

    Raises
    ------
    InputError : no such scene. DisagreementError : no reference solution.
    """
    check_name(name)
    scene = problems.load(name)
    speed, grip = scene.grid.speeds_m_s[-1], scene.grid.grips_N[-1]
    return make_case(name, scene, Context.recorded(scene, recordings(scene)).posed(speed, grip).problem, speed, grip)
