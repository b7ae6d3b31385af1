"""The plain term: the unfiltered error, for as long as the motion of the hand is known."""

import numpy as np

from transopt.plant.time_grid import TimeGrid
from transopt.problem.objective.error_term import ErrorTerm

NAME = "plain"


def plain(weight: float, grid: TimeGrid, intention_s: float) -> ErrorTerm:
    """The unfiltered error with a constant weight until the intention ends, and with zero weight after it.

    During the intention the hand moves on as it came, so the surface causes the whole recorded deceleration.
    Afterwards a recording does not separate the hand's own motion from the surface's effect, so slow motion is not
    tracked.

    Parameters
    ----------
    weight : >= 0.
    intention_s : duration after contact for which the hand's intention is known; infinite for a named target.
    """
    within = grid.switching_times_s < intention_s
    # A target that fills the window is a named one, without a hand: ringing after it is error too.
    after = weight if within.all() else 0.0
    return ErrorTerm(NAME, np.where(within, weight, 0.0), weight, after)
