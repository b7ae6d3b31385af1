"""The optimum of one entry, found by solving the smallest problem that has the same optimum."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.design.explain import infeasibility, unavoidable
from transopt.design.within import finer, said_of_instants
from transopt.plant.wall import reference_course
from transopt.problem.answer import Certificate, Solution, Status
from transopt.problem.leave_out import leave_out
from transopt.problem.limits.limit import tolerated
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.problem import TransientProblem
from transopt.problem.wall_ticks import encoder_course, pressing, pressing_under, silence
from transopt.proof.admit import stated_wall, unstable_wall
from transopt.proof.certify import certify, gradient_rounding
from transopt.proof.designed import Designed
from transopt.proof.effect import Effect, effects, inside
from transopt.solvers import unlimited
from transopt.solvers.choose import prove, prove_all, solve, solve_certified
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
            said = f"{gap} is what double precision leaves where J hardly depends on some movements of the command"
            return replace(designed, solution=answer, remarks=[said])
    free = unlimited.solve([problem])[0]
    left = certify(problem, free.command, free.multipliers).relative_gap
    if left <= Certificate.GAP_TOLERANCE:
        return designed
    said = f"{gap} has no digits to rest on: even without any limit double precision leaves one of {left:.1e}"
    return replace(designed, solution=answer, remarks=[said])


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
    floor = problem.tap_error(np.zeros_like(problem.target.window_m_s2))
    return Designed(problem, answer, proof, effect, problem.rest, floor, 0.0, left_out, None, hopeless)


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
    designed = yield from _at_its_instants(problem, options)
    spent = designed.solution.solve_time_s
    while not options.brief and (parts := finer(designed)):
        again = yield from _at_its_instants(designed.problem.within(parts), options)
        spent += again.solution.solve_time_s
        if not again.is_proven:
            # Infeasibility is judged at the finer instants, whose margin is smaller.
            designed = designed if designed.solution.status is not Status.INFEASIBLE else again
            break
        designed = again
    left_out = designed.left_out
    if designed.solved is not None and designed.is_proven:
        left_out = left_out | said_of_instants(designed)
    return replace(designed, solution=replace(designed.solution, solve_time_s=spent), left_out=left_out)


def _at_its_instants(problem: TransientProblem, options: SolverOptions) -> Search[Designed]:
    """Solve with the wall's ticks and the instants of all limits fixed."""
    reduced = leave_out(problem)
    small, left_out = reduced.problem, dict(reduced.left_out)
    free = yield Ask(unlimited.solve, small)
    effect = yield Ask(effects, (problem, free.command))
    # Without a solved unlimited optimum the floor is unknown.
    floor = problem.tap_error(effect.motion.acceleration_m_s2) if free.status is Status.OPTIMAL else np.nan
    peak = float(np.abs(effect.motion.plant_input).max())

    def designed(
        answer: Solution,
        solved: TransientProblem | None,
        remarks: list[str],
        effect: Effect,
        proof: Certificate | None = None,
    ) -> Search[Designed]:
        if proof is None:
            proof = yield Ask(prove_all, (effect, answer.multipliers), (options,))
        return Designed(problem, answer, proof, effect, free.command, floor, peak, left_out, solved, remarks)

    free_proof = None
    if peak <= problem.limits.input_limit + tolerated(problem.limits.input_limit):
        judged = yield Ask(certificates, (effect, free.multipliers))
        free_proof = judged if judged.excess <= KEPT else None
    if free_proof is not None and not free_proof.is_stationary:
        # The compiled pass may lose digits in ill-conditioned problems; the other method may leave a smaller gap.
        other = unlimited.solve_apart(small)
        its_effect = Effect(problem, other.command)
        its_proof = certified(problem, other.command, other.multipliers, effect=its_effect)
        if its_proof.excess <= KEPT and its_proof.relative_gap < free_proof.relative_gap:
            free, free_proof, effect = other, its_proof, its_effect
    if free_proof is not None and free.status is Status.OPTIMAL and free_proof.is_stationary:
        unit = problem.driven_by.unit
        left_out["limits"] = (
            f"the unlimited optimum is inside all limits: {problem.driven_by.name} {peak:.3g} {unit} of "
            f"{problem.limits.input_limit:g} {unit}, "
            f"command {np.abs(free.command).max():.3g} {unit} of {problem.command_bound:g} {unit}"
        )
        return (yield from designed(free, None, [], effect, free_proof))
    hopeless = unavoidable(small)
    if hopeless:
        return (yield from designed(replace(free, status=Status.INFEASIBLE), None, hopeless, effect))
    spent, cold = free.solve_time_s, small.without(TemperatureLimit.name)
    answer, proof, its_effect = yield Ask(solve_certified, cold, (options,))
    spent += answer.solve_time_s
    cold_proven = answer.status is Status.OPTIMAL and proof.is_stationary
    if small.thermal is not None:
        whole = its_effect.of(problem)
        if answer.status is Status.OPTIMAL and inside(
            problem, answer.command, only=TemperatureLimit.name, effect=whole
        ):
            hottest = float(small.thermal.temperatures_C(whole.motion.plant_input, answer.command).max())
            left_out["temperature"] = (
                f"the optimum without it stays inside: {hottest:.3f} C, limit {small.thermal.limit_C:g} C"
            )
            answer = replace(answer, solve_time_s=spent)
            return (yield from designed(answer, cold, [], whole))
        # A problem that is infeasible without the temperature limit is infeasible with it.
        if answer.status is not Status.INFEASIBLE:
            answer, proof, its_effect = yield Ask(solve_certified, small, (options,))
            spent += answer.solve_time_s
    proven = answer.status is Status.OPTIMAL and proof.is_stationary
    least_gap = proof.relative_gap if proof.excess <= 1 else np.inf
    if free_proof is not None and not proven and free_proof.relative_gap <= least_gap:
        answer, proof, its_effect = free, free_proof, effect
    answer, whole = replace(answer, solve_time_s=spent), its_effect.of(problem)
    # Not a hand-over problem: an unstable wall has a status of its own, and if the problem without the temperature
    # limit has an optimum, the temperature is to blame.
    too_deep = "" if proven or cold_proven or unstable_wall(problem) else _hand_over_excess(small)
    if too_deep:
        return (yield from designed(replace(answer, status=Status.HAND_OVER), small, [too_deep], whole))
    return (yield from designed(answer, small, [], whole))
