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
from transopt.proof.certify import TEMPERATURE, Effect, boxes_of, certify, is_stated, left_over
from transopt.solvers.native.extension import MOST_ROWS, MOST_STATES, Judged, Proof, available, prove
from transopt.solvers.stage_data import Stages, stages


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
    means = [(_in_the_mean(effect), each) for effect, each in answers]
    asked = [_asked(mean, each) if _is_known(mean, each) else None for mean, each in means]
    known = [each for each in asked if each is not None]
    proofs = iter(prove(known) if known else ())  # `known` is empty without the extension
    found = []
    for (effect, each), (mean, _), judged in zip(answers, means, asked, strict=True):
        proof = None if judged is None else _certificate(mean, each, judged.stages, next(proofs))
        if proof is None:
            proof = certify(effect.problem, effect.command, each, effect=effect)
        elif effect.problem.worst:
            proof = _of_the_worst(proof, effect)
        found.append(proof)
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
    if (
        not available
        or problem.stage.motors > 1
        or problem.reference_is_zero
        or set(problem.nonlinear) - {TemperatureLimit.name}
    ):
        return False
    # Extended precision and values that are not finite are left to `proof.certify`.
    if not command.dtype == problem.stage.A.dtype == np.float64 or multipliers.upper(TEMPERATURE).any():
        return False
    return is_stated(problem, command, multipliers)


def _asked(effect: Effect, multipliers: Multipliers) -> Judged | None:
    """Arguments of the compiled call; None where the problem is too large."""
    problem, m = effect.problem, multipliers.clipped()
    given = stages(problem.without(TemperatureLimit.name))
    if given.sizes["rows"] > MOST_ROWS or given.sizes["states"] > MOST_STATES:
        return None
    by_row = None
    if any(side.any() for name, pair in m.pairs.items() if name != TEMPERATURE for side in pair):
        names, by = [row.name for _, row in problem.rows()], _units(problem, given) / OBJECTIVE_SCALE
        by_row = (
            np.stack([m.lower(name) for name in names], -1) * by,
            np.stack([m.upper(name) for name in names], -1) * by,
        )
    return Judged(
        given, effect.command / given.input_scale, by_row, m.hand_over * (given.input_scale / OBJECTIVE_SCALE)
    )


def _units(problem: TransientProblem, given: Stages) -> FloatArray:
    """(rows,) unit of each row of the stage data, in the physical unit of its limit."""
    return np.asarray(given.limits.unit * [limit.stated for limit, _ in problem.rows()])


def _certificate(effect: Effect, multipliers: Multipliers, given: Stages, found: Proof) -> Certificate | None:
    """The certificate from the compiled call's result; None where a number is not finite."""
    problem, unit, units = effect.problem, given.input_scale, _units(effect.problem, given)
    hot = list(boxes_of(effect, multipliers, only=TemperatureLimit.name))
    if not np.isfinite([*found[1:6], *found.excess, *(box.value.max() for box in hot)]).all():
        return None
    merit = found.objective * OBJECTIVE_SCALE
    reward = problem.tracking.reward(effect.accelerations_m_s2) if problem.intensity > 0 else 0.0
    outside = [(limit, off) for (limit, _), off in zip(problem.rows(), (found.excess * units).tolist(), strict=True)]
    outside += [(box.limit, float(box.excess.max())) for box in hot]
    violations, excess = left_over(problem, outside, found.residual * unit)
    gap = (found.by_command + found.slack) * OBJECTIVE_SCALE
    if gap > Certificate.GAP_TOLERANCE * max(merit + reward, OBJECTIVE_SCALE) and problem.movement.weight > 0:
        gap = float(np.fmin(gap, (found.by_movement + found.slack) * OBJECTIVE_SCALE))
    return Certificate(
        objective=merit + reward,
        merit=merit,
        violations=violations,
        excess=excess,
        dual_residual=found.dual_residual * OBJECTIVE_SCALE / unit,
        duality_gap=gap,
        lower_bound=merit - gap,
        finite=True,
    )
