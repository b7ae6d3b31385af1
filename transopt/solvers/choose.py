"""Solvers behind one function: `solve_all(problems, options) -> list[Solution]`. One file per solver."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from transopt.base import apart
from transopt.base.errors import InputError, did_you_mean
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.problem.answer import Certificate, Multipliers, Solution, Status
from transopt.problem.problem import TransientProblem
from transopt.proof.effect import Effect, effects
from transopt.solvers import riccati
from transopt.solvers.feasibility import can_widen, least_widening
from transopt.solvers.options import SolverOptions, default_solver, most_time_s
from transopt.solvers.prove import certificates, certified

__all__ = [
    "SOLVERS",
    "Solver",
    "SolverOptions",
    "check_name",
    "default_solver",
    "global_bounds",
    "one_by_one",
    "prove",
    "prove_all",
    "solve",
    "solve_all",
    "solve_certified",
]

NEARLY_INSIDE = 100.0  # excess of the temperature, in tolerances, that rounding of a slow steady state may cause
NEARLY_PROVEN = 100.0  # gap, in tolerances, of an answer that is worth pulling inside the temperature limit
ROOM = 1.5  # the temperature limit is then tightened by this factor times the excess
LATE_S = 20.0  # time beyond a method's own time limit after which its process is ended
Method = Callable[[Sequence[TransientProblem], SolverOptions], list[Solution]]
Certify = Callable[[Sequence[tuple[Effect, Multipliers]]], list[Certificate]]


def one_by_one(method: Callable[[TransientProblem, SolverOptions], Solution]) -> Method:
    """Turn a method for a single problem into one for any number of problems."""
    return lambda problems, options: [method(problem, options) for problem in problems]


def _apart(name: str, method: Callable[[TransientProblem, SolverOptions], Solution]) -> Method:
    """Run a method in a process of its own: a library's native code ignores signals and may never return."""

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
    # Imported here, so that CasADi is loaded only in the separate process.
    from transopt.solvers import casadi_piqp

    return casadi_piqp.solve(problem, options)


def _casadi_ipopt(problem: TransientProblem, options: SolverOptions) -> Solution:
    from transopt.solvers import casadi_ipopt

    return casadi_ipopt.solve(problem, options)


@dataclass(frozen=True)
class Solver:
    """A method for any number of problems, and the test whether it can take a problem."""

    method: Method
    takes: Callable[[TransientProblem], bool]


# In order of preference; the first solver that takes a problem is its first choice. The project's own method needs
# its compiled extension, PIQP takes QPs only, IPOPT takes every problem.
SOLVERS: dict[str, Solver] = {
    "riccati": Solver(riccati.solve, riccati.can_solve),
    "casadi-piqp": Solver(_apart("casadi-piqp", _casadi_piqp), lambda problem: not problem.nonlinear),
    "casadi-ipopt": Solver(_apart("casadi-ipopt", _casadi_ipopt), lambda problem: True),
}


def check_name(solver: str) -> None:
    """Refuse an unknown solver name before any work is done.

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
    """Names of the solvers that can take this problem: the wanted one first, then the others by preference."""
    return (name for name in dict.fromkeys((wanted, *SOLVERS)) if SOLVERS[name].takes(problem))


@one_blas_thread()
def solve(problem: TransientProblem, options: SolverOptions | None = None) -> Solution:
    """Solve one problem, by `solve_all`."""
    return solve_all([problem], SolverOptions() if options is None else options)[0]


@one_blas_thread()
def solve_all(problems: Sequence[TransientProblem], options: SolverOptions) -> list[Solution]:
    """Solve problems; the answers are judged by `certify` and `replay`, not here.

    The answer to a zero reference is the zero waveform; it is returned without a solver. If the wanted solver cannot
    take a problem (such as PIQP one with the temperature), the first choice among the others is used. The project's
    own method solves problems of equal sizes side by side.

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
    """Certificate of an answer; if the temperature binds, with the lower bound of a convex relaxation.

    Parameters
    ----------
    effect : the command's effect in this problem, if it is known already.
    """
    return prove_all([(effect or Effect(problem, command), multipliers)], options)[0]


def prove_all(
    answers: Sequence[tuple[Effect, Multipliers]], options: SolverOptions, certify_all: Certify = certificates
) -> list[Certificate]:
    """Certificates of several answers, as `prove` gives them; each answer is an effect with its multipliers."""
    found = certify_all(answers)
    unbounded = [
        i
        for i, ((effect, _), certificate) in enumerate(zip(answers, found, strict=True))
        if effect.problem.nonlinear
        and certificate.finite
        and not np.isfinite(certificate.lower_bound)
        and (certificate.is_stationary or not options.brief)  # else a trial that has failed anyway
    ]
    bounds = global_bounds([answers[i][0].problem for i in unbounded], options)
    for i, bound in zip(unbounded, bounds, strict=True):
        found[i] = replace(found[i], lower_bound=bound)
    return found


def global_bounds(problems: Sequence[TransientProblem], options: SolverOptions) -> list[float]:
    """Rigorous lower bounds on J where the copper's warming or a user-defined limit makes problems nonconvex.

    A bound is the optimum of `TransientProblem.relaxed` less its certified gap; minus infinity if that fails.
    """
    relaxed = [problem.relaxed() for problem in problems]
    return [
        max(answer.proof.lower_bound for answer in _answers(problem, options, first))
        for problem, first in zip(relaxed, _tried(relaxed, options), strict=True)
    ]


class Certified(NamedTuple):
    """A solver's answer, its certificate, and the effect of its command in the problem."""

    solution: Solution
    proof: Certificate
    effect: Effect

    @property
    def is_proven(self) -> bool:
        """Whether it is a certified stationary point."""
        return self.solution.status is Status.OPTIMAL and self.proof.is_stationary


def _tried(problems: Sequence[TransientProblem], options: SolverOptions) -> list[Certified]:
    """Answers and certificates by the wanted solver or, where it cannot take a problem, by the first choice."""
    answers = solve_all(problems, options)
    done = effects([(problem, answer.command) for problem, answer in zip(problems, answers, strict=True)])
    proofs = certificates([(effect, answer.multipliers) for effect, answer in zip(done, answers, strict=True)])
    return [Certified(*found) for found in zip(answers, proofs, done, strict=True)]


def _answers(problem: TransientProblem, options: SolverOptions, first: Certified) -> Iterator[Certified]:
    """Yield `first`, then the answers of the other solvers, until one is proven.

    On stiff and extreme problems the solvers fail in different cases; the certificate decides.
    """
    for number, name in enumerate(capable(problem, options.solver)):
        found = first if number == 0 else _tried([problem], replace(options, solver=name))[0]
        if not found.proof.is_stationary and _nearly_proven(problem, found.proof):
            found = _pulled_inside(problem, found.proof, replace(options, solver=name))
        answer = found.solution
        if found.proof.is_stationary:
            # A certified answer is optimal even if the solver stopped short of its own, tighter tolerance.
            yield found._replace(solution=replace(answer, status=Status.OPTIMAL))
            return
        yield found
        if options.brief:
            return
        if answer.solver == "riccati" and answer.status is Status.INFEASIBLE:
            return  # the own method proves infeasibility before it claims it
        if number == 0 and not feasible(problem):
            return  # no other solver needs to search


def _nearly_proven(problem: TransientProblem, proof: Certificate) -> bool:
    """Whether rounding in the temperature may be all that keeps an answer from its proof."""
    gap = proof.relative_gap / Certificate.GAP_TOLERANCE
    return problem.thermal is not None and 1 < proof.excess < NEARLY_INSIDE and gap < NEARLY_PROVEN


def _pulled_inside(problem: TransientProblem, proof: Certificate, options: SolverOptions) -> Certified:
    """Solve again, with the temperature limit tightened by slightly more than the excess, and certify the answer."""
    thermal = problem.thermal
    assert thermal is not None
    headroom = thermal.model.headroom_K - ROOM * proof.excess * thermal.tolerance
    narrower = replace(thermal, model=replace(thermal.model, headroom_K=headroom))
    answer = solve(problem.replaced(narrower), options)
    effect = Effect(problem, answer.command)
    return Certified(answer, certified(problem, answer.command, answer.multipliers, effect=effect), effect)


def feasible(problem: TransientProblem) -> bool:
    """Whether a command meets all linear limits; True also if that was not decided."""
    linear = [limit.name for limit in problem.limits if limit.linear]
    found = least_widening(problem, linear) if can_widen(problem) else None
    return found is None or found.factor == 1.0


def solve_certified(problems: Sequence[TransientProblem], options: SolverOptions) -> list[Certified]:
    """For each problem the first certified answer or, if there is none, the wanted solver's answer.

    The wanted solver's answers are computed and certified side by side; other solvers then take the rest one by one.
    """
    found = []
    for problem, first in zip(problems, _tried(problems, options), strict=True):
        answers = list(_answers(problem, options, first))
        found.append(answers[-1] if answers[-1].proof.is_stationary else answers[0])
    return found
