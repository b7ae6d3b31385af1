"""The plain term: the error as it is, for as long as the motion of the hand is known."""

import numpy as np

from transopt.plant.discretise import TimeGrid
from transopt.problem.objective.error_term import ErrorTerm

NAME = "plain"


def plain(weight: float, grid: TimeGrid, intention_s: float) -> ErrorTerm:
    """The error with one weight until the intention ends, and with none after it.

    Over the intention the hand means to move on as it came, so the whole recorded deceleration comes from the
    surface. What the hand does afterwards no recording tells apart from the surface, so nothing slow is asked for.

    Parameters
    ----------
    weight : >= 0.
    intention_s : how long after contact the hand's intention is known; a named target has the whole window.
    """
    within = grid.switching_times_s < intention_s
    # A target that fills the window has no hand behind it, and what rings after it is all its own.
    after = weight if within.all() else 0.0
    return ErrorTerm(NAME, np.where(within, weight, 0.0), weight, after)
