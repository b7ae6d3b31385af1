"""Certificates in one compiled call, for all problems but those with a binding temperature or a nonlinear limit.

The results equal those of `proof.certify`, but are computed from the stage data of the project's own method.
`proof.certify` does not use stage data. It checks both in the tests, and every library in `verify`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.answer import OBJECTIVE_SCALE, Certificate, Multipliers
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import admissible, certify_all, is_stated, left_over
from transopt.proof.effect import TEMPERATURE, Effect, warm_up
from transopt.solvers.native.extension import available, of_equal_sizes, prove, takes
from transopt.solvers.stage_data import Stages, stages_of


def certified(
    problem: TransientProblem, command: FloatArray, multipliers: Multipliers, *, effect: Effect | None = None
) -> Certificate:
    """Certificate of a command (N,), equal to that of `proof.certify.certify`.

    Parameters
    ----------
    effect : the command's effect in this problem, if it is known already.
    """
    return certificates([(effect or Effect(problem, command), multipliers)])[0]


def certificates(answers: Sequence[tuple[Effect, Multipliers]]) -> list[Certificate]:
    """Certificates of commands, each given by its effect; problems of equal sizes are computed side by side."""
    means = [(_in_the_mean(effect), multipliers) for effect, multipliers in answers]
    known = [i for i, mean in enumerate(means) if _is_known(*mean)]
    problems = [means[i][0].problem for i in known]
    given = stages_of([problem.without(TemperatureLimit.name) for problem in problems])
    proofs: dict[int, Certificate | None] = {}
    for group in of_equal_sizes(given):
        if takes(*(given[group[0]].sizes[name] for name in ("states", "motors", "rows"))):
            some = [known[j] for j in group]
            proofs |= zip(some, _side_by_side([means[i] for i in some], [given[j] for j in group]), strict=True)
    found = {
        i: _of_the_worst(own, answers[i][0]) if answers[i][0].problem.worst else own
        for i, own in proofs.items()
        if own is not None
    }
    rest = [i for i in range(len(answers)) if i not in found]
    found |= zip(rest, certify_all([answers[i] for i in rest]), strict=True)
    return [found[i] for i in range(len(answers))]


def _in_the_mean(effect: Effect) -> Effect:
    """The command's effect in the problem of the devices' weighted mean, in place of the worst device."""
    return effect.of(replace(effect.problem, worst=False)) if effect.problem.worst else effect


def _of_the_worst(mean: Certificate, effect: Effect) -> Certificate:
    """The certificate for the worst device: its loss is bounded from below by the weighted mean."""
    above = effect.problem.tracking.above_mean(effect.accelerations_m_s2)
    return replace(
        mean,
        objective=mean.objective + above,
        merit=mean.merit + above,
        duality_gap=mean.duality_gap + above,
    )


def _is_known(effect: Effect, multipliers: Multipliers) -> bool:
    """Whether the compiled call can judge a problem, its command and its multipliers."""
    problem, command = effect.problem, effect.command
    if not available or problem.reference_is_zero or problem.own_nonlinear:
        return False
    # Extended precision and values that are not finite are left to `proof.certify`.
    if not command.dtype == problem.stage.A.dtype == np.float64 or multipliers.upper(TEMPERATURE).any():
        return False
    return is_stated(problem, command, multipliers)


def _side_by_side(answers: Sequence[tuple[Effect, Multipliers]], given: Sequence[Stages]) -> list[Certificate | None]:
    """Certificates from stage data of equal sizes; None where a number is not finite."""
    scale = np.array([each.input_scale for each in given])[:, None, None]
    units = np.stack([_units(effect.problem, each) for (effect, _), each in zip(answers, given, strict=True)])
    commands = _by_stage([effect.command for effect, _ in answers]) / scale
    by_rule = _by_stage([m.hand_over for _, m in answers]) * (scale / OBJECTIVE_SCALE)
    by_row = [
        _by_row(effect.problem, multipliers, unit / OBJECTIVE_SCALE)
        for (effect, multipliers), unit in zip(answers, units, strict=True)
    ]
    warm_up([effect for effect, _ in answers if not effect.problem.stays_cool])
    found = prove(given, commands, by_row, by_rule)
    excess, unit = found.excess * units, scale[:, 0, 0]
    finite = np.asarray(np.isfinite(np.column_stack([excess, *found[1:6]])).all(axis=1))
    numbers = (
        found.objective * OBJECTIVE_SCALE,
        found.residual * unit,
        found.dual_residual * OBJECTIVE_SCALE / unit,
        (found.by_command + found.slack) * OBJECTIVE_SCALE,
        (found.by_movement + found.slack) * OBJECTIVE_SCALE,
    )
    return [
        _certificate(effect, *of) if known else None
        for (effect, _), known, *of in zip(
            answers, finite.tolist(), excess.tolist(), *np.stack(numbers).tolist(), strict=True
        )
    ]


def _by_stage(courses: Sequence[FloatArray]) -> FloatArray:
    """(P, N, m) courses (N,), or (m, N) of m motors, stage by stage with the motors side by side."""
    found = np.stack(courses)
    return found[..., None] if found.ndim == 2 else np.swapaxes(found, 1, 2)


def _by_row(problem: TransientProblem, multipliers: Multipliers, by: FloatArray) -> FloatArray | None:
    """(2, N, rows) `admissible` multipliers of bounds in units `by` (rows,), contiguous; None if all are zero."""
    if not any(multipliers.most(name) > 0 for name in multipliers.pairs if name != TEMPERATURE):
        return None
    pairs, sides = admissible(problem, multipliers).pairs, np.zeros((2, problem.grid.stages, by.size))
    for j, (_, row) in enumerate(problem.rows()):
        if row.name in pairs:
            for side, values in zip(sides, pairs[row.name], strict=True):
                np.multiply(values, by[j], out=side[:, j])
    return sides


def _units(problem: TransientProblem, given: Stages) -> FloatArray:
    """(rows,) unit of each row of the stage data, in the physical unit of its limit."""
    return np.asarray(given.limits.unit * [limit.stated for limit, _ in problem.rows()])


def _certificate(
    effect: Effect, excess: list[float], merit: float, residual: float, dual: float, gap: float, by_movement: float
) -> Certificate | None:
    """The certificate from excesses of all rows and numbers in SI; None where the temperature is not finite."""
    problem = effect.problem
    outside = [(limit, off) for (limit, _), off in zip(problem.rows(), excess, strict=True)]
    violations, relative = left_over(problem, outside, residual, winding=effect)
    if not np.isfinite(relative):
        return None
    reward = problem.tracking.reward(effect.accelerations_m_s2) if problem.intensity > 0 else 0.0
    return of_numbers(
        problem, violations, relative, merit, dual_residual=dual, gaps=(gap, by_movement), reward=reward
    )


def of_numbers(
    problem: TransientProblem,
    violations: dict[str, float],
    excess: float,
    merit: float,
    *,
    dual_residual: float,
    gaps: tuple[float, float],
    reward: float = 0.0,
) -> Certificate:
    """The certificate from finite numbers in SI.

    Parameters
    ----------
    violations, excess : of the limits, as `certify.left_over` gives them.
    gaps : on the merit, from the bound on the commands and from the movement's curvature; the second counts only
        where the first is too large.
    reward : of the intensity, which the objective has in addition.
    """
    gap, by_movement = gaps
    if gap > Certificate.GAP_TOLERANCE * max(merit + reward, OBJECTIVE_SCALE) and problem.movement.weight > 0:
        gap = float(np.fmin(gap, by_movement))
    return Certificate(
        objective=merit + reward,
        merit=merit,
        violations=violations,
        excess=excess,
        dual_residual=dual_residual,
        duality_gap=gap,
        lower_bound=merit - gap,
        finite=True,
    )
