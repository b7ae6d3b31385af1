"""The optimum of one entry: the smallest problem that has it, solved."""

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
from transopt.proof.certify import Effect, certify, effects, gradient_rounding, inside
from transopt.proof.designed import Designed
from transopt.solvers import unlimited
from transopt.solvers.choose import prove, prove_all, solve, solve_certified
from transopt.solvers.options import SolverOptions
from transopt.solvers.prove import certificates, certified
from transopt.solvers.side_by_side import Ask, Search, alone

NEARLY_PROVEN = 1e-4  # a relative gap that rounding can make
KEPT = 1e-3  # of what is tolerated of limits and hand-over: less is rounding
ROUNDED = 0.2  # of a gap: what the last bits make of it, and no method that computes so gets far below it
MOST_MASKS = 12  # solves until the wall pushes exactly where it was assumed to
STEADIER = 1e-3  # weight of the movement, that of a scene which states none, under which a flat J may have an optimum


def optimum(problem: TransientProblem, options: SolverOptions) -> Designed:
    """What `seek` finds for one entry alone."""
    return alone(seek(problem, options))


def seek(problem: TransientProblem, options: SolverOptions) -> Search[Designed]:
    """Solve one entry, leaving out what it does not need.

    With a wall the ticks at which it pushes are first taken from the reference's motion, then from the answer's,
    until both agree; if they do not, once more from the motion under the wall alone.
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
            # The other course meets the same wall: as long a search, and no proof either.
            break
    assert first is not None
    return _explained(first, options)


def _courses(problem: TransientProblem) -> Iterator[FloatArray]:
    """Courses that the encoder may take: after the reference, or as the wall alone lets it."""
    yield reference_course(problem.grid, problem.target.continued_m_s2)
    with np.errstate(over="ignore", invalid="ignore"):  # a wall that grows by itself presses nowhere then
        yield encoder_course(*silence(problem))


def _settled(problem: TransientProblem, options: SolverOptions) -> Search[tuple[Designed, bool]]:
    """The optimum with the wall pressing where its own answer makes it press, and whether that was found.

    The ticks are taken from the answer again and again; the search ends where they come back to what was tried, and
    with an answer that is none, for where an arbitrary command makes the wall press says nothing.
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
    """Add the reason, if there is no answer because no command meets all limits."""
    problem, answer = designed.problem, designed.solution
    if designed.remarks or designed.is_proven or options.brief:
        return designed
    small = leave_out(problem).problem
    rounding = _rounding(problem, answer)
    if rounding:
        return replace(designed, solution=replace(answer, status=Status.PRECISION), remarks=[rounding])
    if small.wall is None and inside(small, small.rest):
        # Doing nothing is a way out, whatever the solver called it.
        return _flat(designed, options)
    unstable = unstable_wall(small)
    if unstable:
        # Feasible or not, an end that has to follow a wall which grows by itself is no end.
        return replace(designed, solution=replace(answer, status=Status.UNSTABLE_WALL), remarks=[unstable])
    remarks = infeasibility(small, options)
    if not remarks:
        return _flat(designed, options)
    return replace(designed, solution=replace(answer, status=Status.INFEASIBLE), remarks=remarks)


def _flat(designed: Designed, options: SolverOptions) -> Designed:
    """Add the reason, if J is too flat for any method that computes in double precision to find its optimum.

    It hardly depends on some movements of the command where the same problem has a certified optimum under a larger
    weight of the movement. Nor has it one to be found where even the linear system of the problem without limits
    leaves a gap.
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
    """Whether it is rounding that keeps an answer from its proof.

    It is where the same proof succeeds in extended precision, and where the last bits of the answer make a good part
    of its gap. How far the two proofs lie apart would tell less: their gaps may agree by chance, and whether they do
    is another matter on every processor.
    """
    double = certify(problem, answer.command, answer.multipliers)
    if not (double.excess <= 1 and double.relative_gap < NEARLY_PROVEN):
        return ""
    extended = double
    # A wall's filters, and the temperature's recursion, have no other precision.
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
        # Errors that do not depend on each other are bounded as in `movement_bound`: error j is in j + 1 of the sums.
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
    """A zero reference: no transient at all, over a wall nothing but its feedback, which has to keep the limits."""
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
    """Ticks at which the wall pushes, over the hand-over and the tick before it, which the prefilter remembers."""
    assert problem.wall is not None
    return problem.wall.pressing[max(problem.free_stages - 1, 0) :].tobytes()


def _hand_over_excess(problem: TransientProblem) -> str:
    """Whether the wall alone asks for too much when the transient has to end, on the reference's course; or empty."""
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
    """The optimum with the wall's ticks fixed, limits on outputs stated at as many instants as it takes."""
    designed = yield from _at_its_instants(problem, options)
    spent = designed.solution.solve_time_s
    while not options.brief and (parts := finer(designed)):
        again = yield from _at_its_instants(designed.problem.within(parts), options)
        spent += again.solution.solve_time_s
        if not again.is_proven:
            # Whether any command keeps the limits is told with the smaller margin.
            designed = designed if designed.solution.status is not Status.INFEASIBLE else again
            break
        designed = again
    left_out = designed.left_out
    if designed.solved is not None and designed.is_proven:
        left_out = left_out | said_of_instants(designed)
    return replace(designed, solution=replace(designed.solution, solve_time_s=spent), left_out=left_out)


def _at_its_instants(problem: TransientProblem, options: SolverOptions) -> Search[Designed]:
    """The optimum with the wall's ticks and the instants of all limits fixed."""
    reduced = leave_out(problem)
    small, left_out = reduced.problem, dict(reduced.left_out)
    free = yield Ask(unlimited.solve, small)
    effect = yield Ask(effects, (problem, free.command))
    # An optimum without limits that no method finds has no error that is known.
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
        # The compiled pass judges itself in its own units; where rounding rules, the other one may come nearer.
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
        # What no command can do in the cold, none can with the temperature on top.
        if answer.status is not Status.INFEASIBLE:
            answer, proof, its_effect = yield Ask(solve_certified, small, (options,))
            spent += answer.solve_time_s
    proven = answer.status is Status.OPTIMAL and proof.is_stationary
    least_gap = proof.relative_gap if proof.excess <= 1 else np.inf
    if free_proof is not None and not proven and free_proof.relative_gap <= least_gap:
        answer, proof, its_effect = free, free_proof, effect
    answer, whole = replace(answer, solve_time_s=spent), its_effect.of(problem)
    # A wall that grows by itself asks for anything: that is its name then. And what can be handed over in the cold is
    # forbidden by the heat.
    too_deep = "" if proven or cold_proven or unstable_wall(problem) else _hand_over_excess(small)
    if too_deep:
        return (yield from designed(replace(answer, status=Status.HAND_OVER), small, [too_deep], whole))
    return (yield from designed(answer, small, [], whole))
