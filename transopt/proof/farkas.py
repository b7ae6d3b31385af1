"""Proof of infeasibility from multipliers alone (Farkas' lemma over the commands' box)."""

from dataclasses import replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.answer import Multipliers
from transopt.problem.limits import hand_over
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import admissible, is_convex, kink_gap, reduced_gradient
from transopt.proof.effect import Effect, boxes_of

MARGIN = 1e-9  # of the sum of the terms' absolute values, 1e5 times its rounding error


def is_infeasible(problem: TransientProblem, command: FloatArray, multipliers: Multipliers) -> bool:
    """Whether these multipliers prove that no command meets all limits and the hand-over.

    For any mu >= 0 a feasible command has sum_j mu_j (value_j - limit_j) + sum_k nu_k (c_k - feedback_k) <= 0. The
    values are affine in the commands, so over |c| <= c_max the sum is at least its value at any command c minus
    sum_k |g_k| (c_max + |c_k|), with g its gradient by the adjoint recursion. If that is positive, no command is
    feasible. The multipliers of a solver that meets infeasibility grow along such a ray; nothing else of the solver
    is used here.

    The kink of |mean i| counts as in the certificate. Multipliers of a limit that is not convex prove nothing: such
    is the temperature of copper whose resistance rises with it.

    Parameters
    ----------
    command : (N,) any command; the nearer to all limits, the sharper the test.
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
    if not is_convex(problem, ray):
        return False
    effect = Effect(problem, command)
    total = size = 0.0
    for box in boxes_of(effect, ray):
        for mu, value, bound in ((box.by_upper, box.value, box.upper), (box.by_lower, -box.value, -box.lower)):
            stated = np.isfinite(bound)
            total += float(mu[stated] @ (value[stated] - bound[stated]))
            size += float(mu[stated] @ (np.abs(value[stated]) + np.abs(bound[stated])))
    tail = hand_over.residual(problem, command, effect.motion)
    total += float(np.vdot(ray.hand_over, tail))
    g = reduced_gradient(effect, ray, of_limits_alone=True)
    loss = float(np.vdot(np.abs(g), problem.command_bound + np.abs(command)))
    loss += kink_gap(effect, ray, effect.by_heating(ray))
    # The comparison is false for NaN. The rounding error of the gradient is included in `loss`.
    return bool(total - loss > MARGIN * (size + float(np.vdot(np.abs(ray.hand_over), np.abs(tail)))))
