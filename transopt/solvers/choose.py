"""Solvers behind one function: `solve_all(problems, options) -> list[Solution]`. One file per solver."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from transopt.base import apart
from transopt.base.errors import InputError
from transopt.base.nearest import did_you_mean
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.problem.answer import Certificate, Multipliers, Solution, Status
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import Effect, effects
from transopt.solvers import riccati, several
from transopt.solvers.options import SolverOptions, default_solver, most_time_s
from transopt.solvers.prove import certificates, certified

__all__ = [
    "SOLVERS",
    "Solver",
    "SolverOptions",
    "check_name",
    "default_solver",
    "global_bound",
    "one_by_one",
    "prove",
    "prove_all",
    "solve",
    "solve_all",
    "solve_certified",
]

NEARLY_INSIDE = 100.0  # times what is tolerated of the temperature: rounding of a steady state that builds up slowly
NEARLY_PROVEN = 100.0  # times the gap that is tolerated
ROOM = 1.5  # times what was missed, by which the limit is taken narrower then
MOST_ASKED_STAGES = 2000  # beyond, a linear program takes longer than another method
LATE_S = 20.0  # after the time that a method gives itself: it does not come back
Method = Callable[[Sequence[TransientProblem], SolverOptions], list[Solution]]


def one_by_one(method: Callable[[TransientProblem, SolverOptions], Solution]) -> Method:
    """A method for any number of problems of one that solves a single one."""
    return lambda problems, options: [method(problem, options) for problem in problems]


def _apart(name: str, method: Callable[[TransientProblem, SolverOptions], Solution]) -> Method:
    """Run a method in a process of its own: a library's native code answers no signal and may not return."""

    def alone(problem: TransientProblem, options: SolverOptions) -> Solution:
        within_s = most_time_s(problem.grid.stages) + LATE_S
        try:
            return apart.call(method, problem, options, within_s=within_s)
        except apart.UnansweredError as why:
            return Solution(
                Status.NUMERICAL_FAILURE, problem.rest, Multipliers.zero(problem), name, str(why), 0, within_s
            )

    return one_by_one(alone)


def _casadi_piqp(problem: TransientProblem, options: SolverOptions) -> Solution:
    # CasADi is loaded where it solves: in the process of its own.
    from transopt.solvers import casadi_piqp

    return casadi_piqp.solve(problem, options)


def _casadi_ipopt(problem: TransientProblem, options: SolverOptions) -> Solution:
    from transopt.solvers import casadi_ipopt

    return casadi_ipopt.solve(problem, options)


def _own(problems: Sequence[TransientProblem], options: SolverOptions) -> list[Solution]:
    """The project's own method: problems of one motor side by side, those of several motors one by one."""
    of_one_motor = iter(riccati.solve([each for each in problems if each.stage.motors == 1], options))
    return [next(of_one_motor) if each.stage.motors == 1 else several.solve(each, options) for each in problems]


@dataclass(frozen=True)
class Solver:
    """A method for any number of problems, and which of them it takes."""

    method: Method
    takes: Callable[[TransientProblem], bool]


# The first that takes a problem is the first choice for it: the project's own method where it is built, then PIQP
# where the problem is a QP, then IPOPT, which takes all.
SOLVERS: dict[str, Solver] = {
    "riccati": Solver(_own, lambda problem: riccati.can_solve(problem) or several.can_solve(problem)),
    "casadi-piqp": Solver(_apart("casadi-piqp", _casadi_piqp), lambda problem: not problem.nonlinear),
    "casadi-ipopt": Solver(_apart("casadi-ipopt", _casadi_ipopt), lambda problem: True),
}


def check_name(solver: str) -> None:
    """Refuse an unknown solver before any work is done.

    Raises
    ------
    InputError : unknown solver name.
    """
    if solver not in SOLVERS:
        raise InputError(
            f"--solver {solver}: unknown{did_you_mean(solver, SOLVERS)}; choose one of {', '.join(SOLVERS)}"
        )
    if solver == "riccati" and not riccati.available:
        raise InputError(
            "--solver riccati: its extension is not built or out of date; install again where there is a compiler"
        )


def capable(problem: TransientProblem, wanted: str = "riccati") -> Iterator[str]:
    """Names of the solvers that can take this problem, one by one: the wanted one, then the first choices."""
    return (name for name in dict.fromkeys((wanted, *SOLVERS)) if SOLVERS[name].takes(problem))


@one_blas_thread()
def solve(problem: TransientProblem, options: SolverOptions | None = None) -> Solution:
    """`solve_all` of one problem."""
    return solve_all([problem], SolverOptions() if options is None else options)[0]


@one_blas_thread()
def solve_all(problems: Sequence[TransientProblem], options: SolverOptions) -> list[Solution]:
    """Solve problems; what the answers are worth is judged by `certify` and `replay`, not here.

    A zero reference has the zero waveform as its answer and is not handed to a solver. A solver that cannot take
    a problem (PIQP with the temperature in it) gives way to the first choice among those that can. The own method
    solves problems of equal sizes side by side.

    Raises
    ------
    InputError : unknown solver name.
    """
    check_name(options.solver)
    found = dict[int, Solution]()
    by_solver: dict[str, list[int]] = {}
    for i, problem in enumerate(problems):
        if problem.reference_is_zero:
            none = Multipliers.zero(problem)
            found[i] = Solution(Status.OPTIMAL, problem.rest, none, "none", "zero reference: zero waveform", 0, 0.0)
        else:
            by_solver.setdefault(next(capable(problem, options.solver)), []).append(i)
    for name, group in by_solver.items():
        answers = SOLVERS[name].method([problems[i] for i in group], replace(options, solver=name))
        found.update(zip(group, answers, strict=True))
    return [found[i] for i in range(len(problems))]


def prove(
    problem: TransientProblem,
    command: FloatArray,
    multipliers: Multipliers,
    options: SolverOptions,
    *,
    effect: Effect | None = None,
) -> Certificate:
    """Certificate of an answer; where the temperature binds, with the convex problem's lower bound.

    Parameters
    ----------
    effect : of this command in this problem, where it is known already.
    """
    return prove_all([(effect or Effect(problem, command), multipliers)], options)[0]


def prove_all(answers: Sequence[tuple[Effect, Multipliers]], options: SolverOptions) -> list[Certificate]:
    """`prove` of answers, each by what its command does in its problem."""
    found = []
    for (effect, _), certificate in zip(answers, certificates(answers), strict=True):
        bounded = np.isfinite(certificate.lower_bound) or not certificate.finite or not effect.problem.nonlinear
        bound = certificate.lower_bound if bounded else global_bound(effect.problem, options)
        found.append(replace(certificate, lower_bound=bound))
    return found


def global_bound(problem: TransientProblem, options: SolverOptions) -> float:
    """Rigorous lower bound on J where the warming copper, or a limit of a user's own, makes the problem nonconvex.

    The convex relaxation is solved and its own certificate subtracted; minus infinity if that fails. The copper is
    replaced by a convex limit that every admissible command meets, a limit that is not linear by none.
    """
    thermal = problem.thermal
    relaxed = problem if thermal is None else problem.replaced(thermal.relaxed())
    relaxed = relaxed.without(*(name for name in problem.nonlinear if name != TemperatureLimit.name))
    first = _tried([relaxed], options)[0]
    return max((answer.proof.lower_bound for answer in _answers(relaxed, options, first)), default=-np.inf)


class Certified(NamedTuple):
    """A solver's answer, its certificate, and what its command does in the problem."""

    solution: Solution
    proof: Certificate
    effect: Effect


def _tried(problems: Sequence[TransientProblem], options: SolverOptions) -> list[Certified]:
    """Each problem's answer by the wanted solver, or the first choice that takes it, and the certificate."""
    answers = solve_all(problems, options)
    done = effects([(problem, answer.command) for problem, answer in zip(problems, answers, strict=True)])
    proofs = certificates([(effect, answer.multipliers) for effect, answer in zip(done, answers, strict=True)])
    return [Certified(*found) for found in zip(answers, proofs, done, strict=True)]


def _answers(problem: TransientProblem, options: SolverOptions, first: Certified) -> Iterator[Certified]:
    """Answers and certificates until one is proven, which is the last: `first`, then those of the other solvers.

    On stiff and extreme problems the methods fail on different cases; the certificate tells.
    """
    asked = False
    for number, name in enumerate(capable(problem, options.solver)):
        found = first if number == 0 else _tried([problem], replace(options, solver=name))[0]
        if not found.proof.is_stationary and _nearly_proven(problem, found.proof):
            found = _pulled_inside(problem, found.proof, replace(options, solver=name))
        answer = found.solution
        if found.proof.is_stationary:
            # What is proven is proven, though the method ran on for digits that it does not have.
            yield found._replace(solution=replace(answer, status=Status.OPTIMAL))
            return
        yield found
        if options.brief:
            return
        if answer.solver == "riccati" and answer.status is Status.INFEASIBLE:
            return  # its claim comes with a proof
        if not asked and problem.grid.stages <= MOST_ASKED_STAGES:
            asked = True
            if not feasible(problem):
                return  # the linear program tells: no other method needs to search


def _nearly_proven(problem: TransientProblem, proof: Certificate) -> bool:
    """Whether all that an answer lacks may be the last digits of its temperature."""
    gap = proof.relative_gap / Certificate.GAP_TOLERANCE
    return problem.thermal is not None and 1 < proof.excess < NEARLY_INSIDE and gap < NEARLY_PROVEN


def _pulled_inside(problem: TransientProblem, proof: Certificate, options: SolverOptions) -> Certified:
    """The answer under a temperature limit that is narrower by little more than what was missed, and its proof."""
    thermal = problem.thermal
    assert thermal is not None
    headroom = thermal.model.headroom_K - ROOM * proof.excess * thermal.tolerance
    narrower = replace(thermal, model=replace(thermal.model, headroom_K=headroom))
    answer = solve(problem.replaced(narrower), options)
    effect = Effect(problem, answer.command)
    return Certified(answer, certified(problem, answer.command, answer.multipliers, effect=effect), effect)


def feasible(problem: TransientProblem) -> bool:
    """Whether some command meets all limits but the temperature; True as well if that was not found out in time."""
    # The linear program is stated in CasADi, which nothing else here needs.
    from transopt.solvers.feasibility import least_widening

    found = least_widening(problem, [limit.name for limit in problem.limits if limit.linear])
    return found is None or found[0] == 1.0


def solve_certified(problems: Sequence[TransientProblem], options: SolverOptions) -> list[Certified]:
    """For each problem the first answer that is certified or, if none is, the wanted solver's.

    The first answers are found and judged side by side; what is not certified by then goes on alone.
    """
    found = []
    for problem, first in zip(problems, _tried(problems, options), strict=True):
        answers = list(_answers(problem, options, first))
        found.append(answers[-1] if answers[-1].proof.is_stationary else answers[0])
    return found
