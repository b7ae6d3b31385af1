"""Validity of a limit's bounds, checked before any solver gets them."""

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray


def check_bounds(name: str, lower: FloatArray, upper: FloatArray) -> None:
    """Refuse invalid bounds: NaN, crossing bounds, or an infinite bound on the wrong side.

    A solver would silently treat NaN, or an infinite bound on the wrong side, as no limit.

    Parameters
    ----------
    name : name of the row. lower, upper : (stages,) -inf and inf where there is no limit.

    Raises
    ------
    InputError : a bound is NaN, the lower one above the upper one, the lower one inf or the upper one -inf.
    """
    wrong = ~(lower <= upper) | (lower == np.inf) | (upper == -np.inf)
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise InputError(
            f"limit {name}: bounds {lower[k]:g} and {upper[k]:g} at stage {k}, in units of the limit: "
            "must be numbers, the lower one not above the upper one, infinite only where there is no limit"
        )
