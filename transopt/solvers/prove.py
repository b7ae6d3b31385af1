"""Certificates in one compiled call, for all problems but those with a binding temperature or a nonlinear limit.

The results equal those of `proof.certify`, but are computed from the stage data of the project's own method.
`proof.certify` does not use stage data. It checks both in the tests, and every library in `verify`.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.answer import OBJECTIVE_SCALE, Certificate, Multipliers
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import certify, is_stated, left_over
from transopt.proof.effect import TEMPERATURE, Effect
from transopt.solvers.native.extension import Judged, Proof, available, prove, takes
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
    fit = [takes(*(each.sizes[name] for name in ("states", "motors", "rows"))) for each in given]
    asked = [_asked(*means[i], each) for i, each, fits in zip(known, given, fit, strict=True) if fits]
    proofs: dict[int, Certificate | None] = {}
    if asked:  # empty without the extension
        for i, judged, proof in zip(compress(known, fit), asked, prove(asked), strict=True):
            proofs[i] = _certificate(*means[i], judged.stages, proof)
    found = []
    for i, (effect, multipliers) in enumerate(answers):
        own = proofs.get(i)
        if own is None:
            own = certify(effect.problem, effect.command, multipliers, effect=effect)
        elif effect.problem.worst:
            own = _of_the_worst(own, effect)
        found.append(own)
    return found


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
    if not available or problem.reference_is_zero or set(problem.nonlinear) - {TemperatureLimit.name}:
        return False
    # Extended precision and values that are not finite are left to `proof.certify`.
    if not command.dtype == problem.stage.A.dtype == np.float64 or multipliers.upper(TEMPERATURE).any():
        return False
    return is_stated(problem, command, multipliers)


def _asked(effect: Effect, multipliers: Multipliers, given: Stages) -> Judged:
    """Arguments of the compiled call."""
    problem, N, by_row = effect.problem, given.sizes["stages"], None
    pairs = [pair for name, pair in multipliers.pairs.items() if name != TEMPERATURE]
    if any(side.any() for pair in pairs for side in pair):
        sides, by = np.zeros((2, N, given.sizes["rows"])), _units(problem, given) / OBJECTIVE_SCALE
        for j, (_, row) in enumerate(problem.rows()):
            if row.name in multipliers.pairs:
                sides[..., j] = multipliers.pairs[row.name]
        lower, upper = np.maximum(sides, 0.0) * by
        by_row = lower, upper
    # Stage by stage, with the numbers of several motors side by side.
    command = np.ascontiguousarray(effect.command.T / given.input_scale)
    by_rule = np.ascontiguousarray(multipliers.hand_over.T * (given.input_scale / OBJECTIVE_SCALE))
    return Judged(given, command, by_row, by_rule)


def _units(problem: TransientProblem, given: Stages) -> FloatArray:
    """(rows,) unit of each row of the stage data, in the physical unit of its limit."""
    return np.asarray(given.limits.unit * [limit.stated for limit, _ in problem.rows()])


def _certificate(effect: Effect, multipliers: Multipliers, given: Stages, found: Proof) -> Certificate | None:
    """The certificate from the compiled call's result; None where a number is not finite."""
    problem, unit, thermal = effect.problem, given.input_scale, effect.problem.thermal
    excess = (found.excess * _units(problem, given)).tolist()
    outside = [(limit, off) for (limit, _), off in zip(problem.rows(), excess, strict=True)]
    if thermal is not None:
        outside.append((thermal, float((effect.winding_C - thermal.bounds_C).max())))
        excess.append(float(effect.winding_C.max()))
    if not np.isfinite([*found[1:6], *excess]).all():
        return None
    merit = found.objective * OBJECTIVE_SCALE
    reward = problem.tracking.reward(effect.accelerations_m_s2) if problem.intensity > 0 else 0.0
    violations, relative = left_over(problem, outside, found.residual * unit)
    gap = (found.by_command + found.slack) * OBJECTIVE_SCALE
    if gap > Certificate.GAP_TOLERANCE * max(merit + reward, OBJECTIVE_SCALE) and problem.movement.weight > 0:
        gap = float(np.fmin(gap, (found.by_movement + found.slack) * OBJECTIVE_SCALE))
    return Certificate(
        objective=merit + reward,
        merit=merit,
        violations=violations,
        excess=relative,
        dual_residual=found.dual_residual * OBJECTIVE_SCALE / unit,
        duality_gap=gap,
        lower_bound=merit - gap,
        finite=True,
    )
