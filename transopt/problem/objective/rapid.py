"""The rapid term: the error above some 20 Hz, or in the band of the sense of vibration, with weight 1 throughout."""

import numpy as np

from transopt.base.errors import InputError
from transopt.plant.time_grid import TimeGrid
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.weighting import RAPID, ErrorFilter, highpass, pacinian

NAME = "rapid"


def rapid_filter(kind: str, from_Hz: float, dt_s: float) -> ErrorFilter | None:
    """The filter of the rapid term by the scene's `weights.rapid`; None where the scene has no such term.

    Parameters
    ----------
    kind : "highpass", "pacinian" or "none".
    from_Hz : corner of the high-pass.

    Raises
    ------
    InputError : an unknown kind, or a servo rate too low for the filter.
    """
    if kind not in RAPID:
        raise InputError(f"weights.rapid = {kind!r}: unknown; choose {', '.join(RAPID[:-1])} or {RAPID[-1]}")
    if kind == "none":
        return None
    return highpass(from_Hz, dt_s) if kind == "highpass" else pacinian(dt_s)


def rapid(by: ErrorFilter, grid: TimeGrid) -> ErrorTerm:
    """The filtered error with weight 1 for every sample, lost samples and tail included."""
    return ErrorTerm(NAME, np.ones(grid.stages), 1.0, 1.0, by)
