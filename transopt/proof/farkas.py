"""Proof that no command meets all limits, from multipliers alone (Farkas' lemma over the commands' box)."""

from dataclasses import replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.answer import Multipliers
from transopt.problem.limits import hand_over
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import TEMPERATURE, Effect, admissible, boxes, kink_gap, reduced_gradient

MARGIN = 1e-9  # of the sum of all terms' sizes: a hundred thousand times what rounding leaves of it


def is_infeasible(problem: TransientProblem, command: FloatArray, multipliers: Multipliers) -> bool:
    """Whether these multipliers prove that no command meets all limits and the hand-over.

    For any mu >= 0 a command that meets them has sum_j mu_j (value_j - limit_j) + sum_k nu_k (c_k - feedback_k) <= 0.
    The values are affine in the commands, so over |c| <= c_max the sum is at least its value at any command c less
    sum_k |g_k| (c_max + |c_k|), g its gradient by the adjoint recursion. If that is positive, there is none. As a
    solver runs into infeasibility its multipliers grow along such a ray; nothing else of it is used here.

    What the stated slope of |mean i| leaves below it counts as in the certificate. Heat is convex in the commands
    only while copper keeps its resistance: with multipliers on a temperature that warms it nothing is proven.

    Parameters
    ----------
    command : (N,) any command; the closer to all limits, the sharper.
    """
    sides = [side for pair in multipliers.pairs.values() for side in pair]
    largest = max(float(np.abs(side).max()) for side in (*sides, multipliers.hand_over))
    if not 0 < largest < np.inf or not np.all(np.isfinite(command)):
        return False
    clipped = admissible(problem, multipliers)
    ray = replace(
        clipped,
        pairs={row: (lower / largest, upper / largest) for row, (lower, upper) in clipped.pairs.items()},
        hand_over=clipped.hand_over / largest,
    )
    thermal = problem.thermal
    if thermal is not None and thermal.model.copper != 0 and ray.upper(TEMPERATURE).any():
        return False
    effect = Effect(problem, command)
    motion = effect.motion
    total = size = 0.0
    for box in boxes(problem, command, motion, ray):
        for mu, value, bound in ((box.by_upper, box.value, box.upper), (box.by_lower, -box.value, -box.lower)):
            stated = np.isfinite(bound)
            total += float(mu[stated] @ (value[stated] - bound[stated]))
            size += float(mu[stated] @ (np.abs(value[stated]) + np.abs(bound[stated])))
    tail = hand_over.residual(problem, command, motion)
    total += float(np.vdot(ray.hand_over, tail))
    g = reduced_gradient(effect, ray, of_limits_alone=True)
    loss = float(np.vdot(np.abs(g), problem.command_bound + np.abs(command)))
    loss += kink_gap(problem, command, motion, ray)
    # Written so that a NaN proves nothing. The gradient's rounding counts in `loss` itself.
    return bool(total - loss > MARGIN * (size + float(np.vdot(np.abs(ray.hand_over), np.abs(tail)))))
