"""Proof that no command meets all limits, from multipliers alone (Farkas' lemma over the commands' box)."""

from dataclasses import fields, replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.problem import Multipliers, TransientProblem
from transopt.proof.certify import admissible, boxes, kink_gap, reduced_gradient

MARGIN = 1e-9  # of the sum of all terms' sizes: a hundred thousand times what rounding leaves of it


def is_infeasible(problem: TransientProblem, command_A: FloatArray, multipliers: Multipliers) -> bool:
    """Whether these multipliers prove that no command meets all limits and the hand-over.

    For any mu >= 0 a command that meets them has sum_j mu_j (value_j - limit_j) + sum_k nu_k (c_k - feedback_k) <= 0.
    The values are affine in the commands, so over |c| <= c_max the sum is at least its value at any command c less
    sum_k |g_k| (c_max + |c_k|), g its gradient by the adjoint recursion. If that is positive, there is none. As a
    solver runs into infeasibility its multipliers grow along such a ray; nothing else of it is used here.

    What the stated slope of |mean i| leaves below it counts as in the certificate. Heat is convex in the commands
    only while copper keeps its resistance: with multipliers on a temperature that warms it nothing is proven.

    Parameters
    ----------
    command_A : (N,) any command; the closer to all limits, the sharper.
    """
    sizes = [
        float(np.abs(getattr(multipliers, f.name)).max()) for f in fields(multipliers) if f.name != "current_sign"
    ]
    largest = max(sizes)
    if not 0 < largest < np.inf or not np.all(np.isfinite(command_A)):
        return False
    clipped = admissible(problem, multipliers)
    ray = replace(
        clipped, **{f.name: getattr(clipped, f.name) / largest for f in fields(clipped) if f.name != "current_sign"}
    )
    thermal = problem.thermal
    if thermal is not None and thermal.model.copper != 0 and ray.temperature_upper.any():
        return False
    limits_alone = replace(problem, tracking_weights=np.zeros(problem.grid.stages), rho=0.0)
    motion = problem.stage.motion(command_A)
    total = size = 0.0
    for box in boxes(problem, command_A, motion, ray):
        stated = np.isfinite(box.bound)
        value, bound = box.value[stated], box.bound[stated]
        sides = [(box.upper[stated], value)] + ([] if box.lower is None else [(box.lower[stated], -value)])
        for mu, signed in sides:
            total += float(mu @ (signed - bound))
            size += float(mu @ (np.abs(signed) + bound))
    tail = (command_A - problem.hand_over_command(motion))[problem.free_stages :]
    total += float(ray.hand_over @ tail)
    g = reduced_gradient(limits_alone, command_A, motion, ray)
    loss = float(np.abs(g) @ (problem.limits.command_bound_A + np.abs(command_A)))
    loss += kink_gap(problem, command_A, motion, ray)
    # Written so that a NaN proves nothing. The gradient's rounding counts in `loss` itself.
    return bool(total - loss > MARGIN * (size + float(np.abs(ray.hand_over) @ np.abs(tail))))
