"""The optimum of one entry, found by solving the smallest problem that has the same optimum."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from transopt.base.signals import FloatArray
from transopt.design.explain import infeasibility, unavoidable
from transopt.design.within import finer, why_no_more_instants
from transopt.plant.wall import reference_course
from transopt.problem.answer import Certificate, Solution, Status
from transopt.problem.leave_out import leave_out, leave_out_all
from transopt.problem.limits.limit import tolerated
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.problem import TransientProblem
from transopt.problem.wall_ticks import encoder_course, pressing, pressing_under, silence
from transopt.proof.admit import stated_wall, unstable_wall
from transopt.proof.certify import certify, gradient_rounding, under_further_limits
from transopt.proof.designed import Designed
from transopt.proof.effect import Effect, Free, free_optima, inside, warm_up
from transopt.solvers import unlimited
from transopt.solvers.choose import Certified, prove, prove_all, solve, solve_certified
from transopt.solvers.options import SolverOptions
from transopt.solvers.prove import certificates, certified
from transopt.solvers.side_by_side import Ask, Search, alone

NEARLY_PROVEN = 1e-4  # largest relative gap that rounding can cause
KEPT = 1e-3  # share of the violation tolerance below which the unlimited optimum's violation is rounding
ROUNDED = 0.2  # share of a gap from which on the command's last bits count as its cause
MOST_MASKS = 12  # most solves until the assumed ticks of the wall's push agree with those of the answer
STEADIER = 1e-3  # movement weight under which a flat J may have a certifiable optimum; the default of a scene


def optimum(problem: TransientProblem, options: SolverOptions) -> Designed:
    """Solve one entry alone, by `seek`."""
    return alone(seek(problem, options))


def seek(problem: TransientProblem, options: SolverOptions) -> Search[Designed]:
    """Search for the optimum of one entry, leaving out the parts of the problem that it does not need.

    A wall pushes only at ticks at which the stylus is below the surface. These ticks are fixed in each solve: first
    those of the reference's motion, then those of the answer, until both agree. If they never do, the search starts
    once more from the motion under the wall alone.
    """
    if problem.reference_is_zero:
        return _silent(problem, options)
    if problem.wall is None:
        return _explained((yield from _solved(problem, options)), options)
    first = None
    for course in _courses(problem):
        designed, settled = yield from _settled(pressing(problem, course), options)
        if settled or designed.remarks:
            return designed
        first = designed if first is None else first
        if not designed.is_proven and unstable_wall(problem):
            # The second start meets the same unstable wall: it would take as long and prove nothing either.
            break
    assert first is not None
    return _explained(first, options)


def _courses(problem: TransientProblem) -> Iterator[FloatArray]:
    """Encoder positions to start from: the reference's motion, then the motion under the wall alone."""
    yield reference_course(problem.grid, problem.target.continued_m_s2)
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable wall overflows; it then presses nowhere
        yield encoder_course(*silence(problem))


def _settled(problem: TransientProblem, options: SolverOptions) -> Search[tuple[Designed, bool]]:
    """Fixed-point iteration over the ticks at which the wall presses; the last answer and whether it converged.

    Each solve takes the ticks of the previous answer. The iteration stops without convergence when a set of ticks
    repeats, or when an answer is not proven: the ticks of an arbitrary command carry no information.
    """
    spent, tried = 0.0, {_mask(problem)}
    for _ in range(MOST_MASKS):
        designed = yield from _solved(problem, options)
        spent += designed.solution.solve_time_s
        designed = replace(designed, solution=replace(designed.solution, solve_time_s=spent))
        if not designed.is_proven:
            return designed, False
        again = pressing_under(designed.problem, designed.solution.command)
        if _mask(again) == _mask(problem):
            return designed, True
        if _mask(again) in tried:
            return designed, False
        tried.add(_mask(again))
        problem = again
    return designed, False


def _explained(designed: Designed, options: SolverOptions) -> Designed:
    """Add the reason why there is no proven optimum: rounding, a flat J, an unstable wall or infeasibility."""
    problem, answer = designed.problem, designed.solution
    if designed.remarks or designed.is_proven or options.brief:
        return designed
    small = leave_out(problem).problem
    rounding = _rounding(problem, answer)
    if rounding:
        return replace(designed, solution=replace(answer, status=Status.PRECISION), remarks=[rounding])
    if small.wall is None and inside(small, small.rest):
        # The zero command is feasible, whatever status the solver reported.
        return _flat(designed, options)
    unstable = unstable_wall(small)
    if unstable:
        # Feasible or not, a hand-over to an unstable wall does not end the transient.
        return replace(designed, solution=replace(answer, status=Status.UNSTABLE_WALL), remarks=[unstable])
    remarks = infeasibility(small, options)
    if not remarks:
        return _flat(designed, options)
    return replace(designed, solution=replace(answer, status=Status.INFEASIBLE), remarks=remarks)


def _flat(designed: Designed, options: SolverOptions) -> Designed:
    """Add the reason, if J is too flat for any method that computes in double precision to find its optimum.

    J is flat in some directions of the command if the same problem has a certified optimum under a larger weight of
    the movement. Double precision is also too coarse if even the linear system of the unlimited problem leaves a gap.
    """
    problem, answer = designed.problem, replace(designed.solution, status=Status.PRECISION)
    gap = f"precision: the gap of {designed.certificate.relative_gap:.1e}, limit {Certificate.GAP_TOLERANCE:.0e},"
    if problem.rho < STEADIER:
        found = alone(_solved(replace(problem, rho=STEADIER), options))
        if found.is_proven and found.certificate.accepted:
            remark = f"{gap} is what double precision leaves where J hardly depends on some movements of the command"
            return replace(designed, solution=answer, remarks=[remark])
    free = unlimited.solve([problem])[0]
    left = certify(problem, free.command, free.multipliers).relative_gap
    if left <= Certificate.GAP_TOLERANCE:
        return designed
    remark = f"{gap} has no digits to rest on: even without any limit double precision leaves one of {left:.1e}"
    return replace(designed, solution=answer, remarks=[remark])


def _rounding(problem: TransientProblem, answer: Solution) -> str:
    """Explain an unproven answer by rounding, in a sentence; empty if rounding is not the cause.

    Rounding is the cause if the same proof succeeds in extended precision, or if the last bits of the command account
    for a good part of the gap. The difference between the gaps in double and extended precision is no criterion: they
    may agree by chance, differently on each processor.
    """
    double = certify(problem, answer.command, answer.multipliers)
    if not (double.excess <= 1 and double.relative_gap < NEARLY_PROVEN):
        return ""
    extended = double
    # The wall's filters and the temperature's recursion exist in double precision only.
    if problem.thermal is None and problem.wall is None:
        wide = replace(
            problem,
            stage=problem.stage.extended(),
            spread=tuple(device.extended() for device in problem.spread),
            target=problem.target.extended(),
        )
        extended = certify(wide, answer.command.astype(np.longdouble), answer.multipliers)
    by_command = gradient_rounding(problem, answer.command, answer.multipliers)
    rounding = float(np.vdot(by_command, problem.command_bound + np.abs(answer.command)))
    weight = problem.movement.weight
    if weight > 0:
        # Independent rounding errors are bounded as in `movement_bound`: error j enters j + 1 of the sums.
        sums = by_command**2 @ np.arange(1, problem.grid.stages + 1)
        rounding = min(rounding, float(np.sum(sums)) / (4 * weight))
    if not (extended.relative_gap <= Certificate.GAP_TOLERANCE or rounding > ROUNDED * double.duality_gap):
        return ""
    taken = float(np.abs(answer.command).max())
    in_extended = "" if extended is double else f", in extended precision {extended.relative_gap:.1e}"
    unit = problem.driven_by.unit
    return (
        f"precision: the gap of {double.relative_gap:.1e} is at the rounding of double precision{in_extended}, limit "
        f"{double.GAP_TOLERANCE:.0e}; the answer takes {taken:.4g} {unit} of "
        f"{problem.limits.input_limit:.4g} {unit} in {problem.grid.stages} stages"
    )


def _silent(problem: TransientProblem, options: SolverOptions) -> Designed:
    """The answer for a zero reference: a zero transient; with a wall, its feedback alone has to keep the limits."""
    problem, command = silence(problem)
    answer, effect = replace(solve(problem, options), command=command), Effect(problem, command)
    proof = prove(problem, command, answer.multipliers, options, effect=effect)
    hopeless = unavoidable(problem)
    unstable = unstable_wall(problem)
    if hopeless:
        answer = replace(answer, status=Status.INFEASIBLE)
    elif unstable and not proof.excess <= 1:
        answer, hopeless = replace(answer, status=Status.UNSTABLE_WALL), [unstable]
    elif problem.wall is not None and not proof.excess <= 1:
        answer = replace(answer, status=Status.HAND_OVER)
        hopeless = [
            f"hand-over: without any transient the wall alone asks for {np.abs(command).max():.3g} A, limit "
            f"{problem.limits.input_limit:g} A, with {stated_wall(problem.wall.wall)}"
        ]
    left_out = {"limits": "zero reference: zero waveform"}
    ((_, free),) = free_optima([(problem, problem.rest)])
    return Designed(problem, answer, proof, effect, *free, left_out, None, hopeless)


def _mask(problem: TransientProblem) -> bytes:
    """Ticks at which the wall pushes, as a key: those of the hand-over and one before, stored in the prefilter."""
    assert problem.wall is not None
    return problem.wall.pressing[max(problem.free_stages - 1, 0) :].tobytes()


def _hand_over_excess(problem: TransientProblem) -> str:
    """A sentence if the wall's feedback at the hand-over, on the reference's motion, exceeds the limit; or empty."""
    wall, limit = problem.wall, problem.limits.input_limit
    if wall is None:
        return ""
    z = wall.encoder(reference_course(problem.grid, problem.target.continued_m_s2))[problem.free_stages :]
    deepest = float(-z.min())
    current = wall.wall.stiffness_N_m * deepest / wall.wall.force_per_current_N_A
    if current <= limit:
        return ""
    return (
        f"hand-over: K_p z / k_f = {current:.3g} A at {deepest * 1e3:.3g} mm below the surface, where the reference "
        f"goes, limit {limit:g} A"
    )


def _solved(problem: TransientProblem, options: SolverOptions) -> Search[Designed]:
    """Solve with the wall's ticks fixed, refining the instants at which limits on outputs are stated as needed."""
    designed: Designed = yield Ask(at_their_instants, problem, (options,))
    spent = designed.solution.solve_time_s
    while not options.brief and (parts := finer(designed)):
        again = yield Ask(at_their_instants, designed.problem.within(parts), (options,))
        spent += again.solution.solve_time_s
        if not again.is_proven:
            # Infeasibility is judged at the finer instants, whose margin is smaller.
            designed = designed if designed.solution.status is not Status.INFEASIBLE else again
            break
        designed = again
    if spent != designed.solution.solve_time_s:
        designed = replace(designed, solution=replace(designed.solution, solve_time_s=spent))
    if designed.solved is not None and designed.is_proven and (reasons := why_no_more_instants(designed)):
        designed = replace(designed, left_out=designed.left_out | reasons)
    return designed


@dataclass(frozen=True)
class _Attempt:
    """One problem with its optimum without limits.

    Attributes
    ----------
    problem : the problem with all limits. small : without those that cannot bind. left_out : part -> why it has not.
    free : that optimum, and its effect in `problem`; its certificate there, or None where it leaves a limit.
    figures : of that optimum.
    """

    problem: TransientProblem
    small: TransientProblem
    left_out: dict[str, str]
    free: Solution
    effect: Effect
    proof: Certificate | None
    figures: Free

    @cached_property
    def inside(self) -> str:
        """Why no limit is needed, in words; empty where one is."""
        problem, proof = self.problem, self.proof
        if proof is None or not (self.free.status is Status.OPTIMAL and proof.is_stationary):
            return ""
        unit = problem.driven_by.unit
        return (
            f"the unlimited optimum is inside all limits: {problem.driven_by.name} {self.figures.peak:.3g} {unit} of "
            f"{problem.limits.input_limit:g} {unit}, "
            f"command {np.abs(self.free.command).max():.3g} {unit} of {problem.command_bound:g} {unit}"
        )

    def best(self, limited: Certified) -> Certified:
        """The answer under limits, or the one without where neither is proven and its gap is no larger."""
        proof = limited.proof
        least_gap = proof.relative_gap if proof.excess <= 1 else np.inf
        if self.proof is None or limited.is_proven or self.proof.relative_gap > least_gap:
            return limited
        return Certified(self.free, self.proof, self.effect)

    def designed(
        self,
        found: Certified,
        solved: TransientProblem | None,
        remarks: Sequence[str] = (),
        without: Mapping[str, str] = MappingProxyType({}),
    ) -> Designed:
        """The answer; `without` has what else was left out."""
        answer, proof, effect = found
        left_out = {**self.left_out, **without}
        return Designed(self.problem, answer, proof, effect, *self.figures, left_out, solved, list(remarks))


def _without_limits(problems: Sequence[TransientProblem], options: SolverOptions) -> list[_Attempt]:
    """The optima without limits, certified where they keep all limits."""
    reduced, limits = leave_out_all(problems), [problem.limits.input_limit for problem in problems]
    # Beside the problem, this optimum depends on the limit on the input alone, the unit of the command's movement.
    keys = [(limit, options.brief) for limit in limits]
    known = [problem.unlimited.get(key) for problem, key in zip(problems, keys, strict=True)]
    new = [i for i, found in enumerate(known) if found is None]
    answers = unlimited.solve([reduced[i].problem for i in new], brief=options.brief)
    made = free_optima([(problems[i].without_optimum(), each.command) for i, each in zip(new, answers, strict=True)])
    for i, answer, (effect, figures) in zip(new, answers, made, strict=True):
        known[i] = answer, effect, figures
        problems[i].unlimited.clear()
        problems[i].unlimited[keys[i]] = known[i]
    free, effects, figures_of = zip(*known, strict=True) if known else ((), (), ())
    done = [(effect.of(problem), of) for problem, effect, of in zip(problems, effects, figures_of, strict=True)]
    low = [i for i, limit in enumerate(limits) if done[i][1].peak <= limit + tolerated(limit)]
    proofs = dict(zip(low, certificates([(done[i][0], free[i].multipliers) for i in low]), strict=True))
    found = []
    for i, (problem, each) in enumerate(zip(problems, reduced, strict=True)):
        answer, (effect, figures), proof = free[i], done[i], proofs.get(i)
        if proof is not None and not proof.excess <= KEPT:
            proof = None
        if proof is not None and not proof.is_stationary and not options.brief:
            # The compiled pass may lose digits in ill-conditioned problems; the other method may leave a smaller gap.
            other = unlimited.solve_apart(each.problem)
            ((its_effect, its_figures),) = free_optima([(problem, other.command)])
            its_proof = certified(problem, other.command, other.multipliers, effect=its_effect)
            if its_proof.excess <= KEPT and its_proof.relative_gap < proof.relative_gap:
                answer, proof, effect, figures = other, its_proof, its_effect, its_figures
        if answer.status is not Status.OPTIMAL:
            figures = figures._replace(floor=np.nan, objective=np.nan)  # unknown without a solved unlimited optimum
        found.append(_Attempt(problem, each.problem, each.left_out, answer, effect, proof, figures))
    return found


def at_their_instants(problems: Sequence[TransientProblem], options: SolverOptions) -> list[Designed]:
    """Solve problems side by side, with the wall's ticks and the instants of all limits fixed."""
    attempts, found = _without_limits(problems, options), dict[int, Designed]()
    limited = list[int]()
    for i, each in enumerate(attempts):
        if each.inside:
            assert each.proof is not None
            own = Certified(each.free, each.proof, each.effect)
            found[i] = each.designed(own, None, without={"limits": each.inside})
        elif hopeless := unavoidable(each.small):
            answer = replace(each.free, status=Status.INFEASIBLE)
            found[i] = each.designed(_proven(each, answer, each.effect, options), None, hopeless)
        else:
            limited.append(i)
    found |= zip(limited, _under_limits([attempts[i] for i in limited], options), strict=True)
    return [found[i] for i in range(len(problems))]


def _proven(attempt: _Attempt, answer: Solution, effect: Effect, options: SolverOptions) -> Certified:
    """An answer with its certificate in the problem with all limits."""
    (proof,) = prove_all([(effect, answer.multipliers)], options)
    return Certified(answer, proof, effect)


def _under_limits(attempts: Sequence[_Attempt], options: SolverOptions) -> list[Designed]:
    """Answers where limits bind: without the temperature or, where that would be exceeded, with it."""
    cold = [each.small.without(TemperatureLimit.name) for each in attempts]
    first = _in_problems([each.problem for each in attempts], solve_certified(cold, options))
    warm_up(
        [
            its.effect
            for each, its in zip(attempts, first, strict=True)
            if each.small.thermal is not None and its.solution.status is Status.OPTIMAL
        ]
    )
    cool = {i: reason for i, each in enumerate(attempts) if (reason := _cool(each, first[i]))}
    # A problem that is infeasible without the temperature limit is infeasible with it.
    hot = [
        i
        for i, each in enumerate(attempts)
        if each.small.thermal is not None and i not in cool and first[i].solution.status is not Status.INFEASIBLE
    ]
    last = dict(enumerate(first))
    again = solve_certified([attempts[i].small for i in hot], options)
    last |= zip(hot, _in_problems([attempts[i].problem for i in hot], again), strict=True)
    solved = [cold[i] if i in cool else each.small for i, each in enumerate(attempts)]
    best = [last[i] if i in cool else each.best(last[i]) for i, each in enumerate(attempts)]
    found = _with_all_limits(solved, best, options)
    designed = []
    for i, (each, own) in enumerate(zip(attempts, found, strict=True)):
        spent = [each.free, first[i].solution, *([last[i].solution] if i in hot else [])]
        # Not a hand-over problem: an unstable wall has a status of its own, and if the problem without the
        # temperature limit has an optimum, the temperature is to blame.
        proven = first[i].is_proven or last[i].is_proven
        too_deep = "" if proven or unstable_wall(each.problem) else _hand_over_excess(each.small)
        answer = replace(
            own.solution,
            status=Status.HAND_OVER if too_deep else own.solution.status,
            solve_time_s=sum(of.solve_time_s for of in spent),
        )
        without = {"temperature": cool[i]} if i in cool else {}
        remarks = [too_deep] if too_deep else []
        designed.append(each.designed(own._replace(solution=answer), solved[i], remarks, without))
    return designed


def _cool(attempt: _Attempt, cold: Certified) -> str:
    """Why an answer needs no temperature limit, in words; empty where it does, or where there is none."""
    problem, thermal = attempt.problem, attempt.small.thermal
    if thermal is None or cold.solution.status is not Status.OPTIMAL:
        return ""
    if not inside(problem, cold.solution.command, only=TemperatureLimit.name, effect=cold.effect):
        return ""
    hottest = float(cold.effect.winding_C.max())
    return f"the optimum without it stays inside: {hottest:.3f} C, limit {thermal.limit_C:g} C"


def _in_problems(problems: Sequence[TransientProblem], found: Sequence[Certified]) -> list[Certified]:
    """Answers with the effects of their commands in problems with further limits."""
    return [each._replace(effect=each.effect.of(problem)) for each, problem in zip(found, problems, strict=True)]


def _with_all_limits(
    solved: Sequence[TransientProblem], found: Sequence[Certified], options: SolverOptions
) -> list[Certified]:
    """Answers to problems `solved`, certified in the problems of their effects, which have all limits."""
    proofs = {
        i: under_further_limits(proof, effect, small)
        for i, ((_, proof, effect), small) in enumerate(zip(found, solved, strict=True))
        if proof.is_stationary and np.isfinite(proof.lower_bound) and _differ_in_limits(small, effect.problem)
    }
    rest = [i for i in range(len(found)) if i not in proofs]
    proofs |= zip(
        rest, prove_all([(found[i].effect, found[i].solution.multipliers) for i in rest], options), strict=True
    )
    return [each._replace(proof=proofs[i]) for i, each in enumerate(found)]


def _differ_in_limits(one: TransientProblem, other: TransientProblem) -> bool:
    """Whether nothing but limits that bound no command distinguishes two problems."""
    return one.wall is other.wall and one.stage is other.stage and one.command_bound == other.command_bound
