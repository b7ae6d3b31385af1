"""What the bounds of a limit must be before any method is asked to keep them."""

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray


def check_bounds(name: str, lower: FloatArray, upper: FloatArray) -> None:
    """Refuse bounds between which no value can lie.

    A method would take NaN, or an infinite bound on the wrong side, for no limit at all.

    Parameters
    ----------
    name : of the row. lower, upper : (stages,) -inf and inf where there is no limit.

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
