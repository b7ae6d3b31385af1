"""The inverse question for one tap: which value of a limit an error requires, and which keys change the error."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from transopt.base.errors import InputError
from transopt.base.writing import percent
from transopt.problem.answer import Status
from transopt.scene.keys import Value, find_key
from transopt.study.inverse import Question, Requirement, answer
from transopt.study.rows import Row
from transopt.web.controls import Control
from transopt.web.service import Service

PRECISION = 1e-3  # relative precision of the value that is found
LEAST_MOVE = 5e-4  # smallest change of the tap error for which a key is offered


@dataclass(frozen=True)
class Found:
    """The answer to an inverse question.

    Attributes
    ----------
    value : value of the key; None if none within its slider meets the error.
    needed : whether the present error is too large; otherwise the value is an alternative.
    words : the answer, or how near the search came.
    """

    value: Value
    needed: bool
    words: str


@dataclass(frozen=True)
class Mover:
    """A number of the scene that changes the error of one tap.

    Attributes
    ----------
    key, label : key and label of its control.
    best, worst : least and greatest tap error among its present value and the two ends of its slider.
    """

    key: str
    label: str
    best: float
    worst: float


def movers(service: Service, index: int, given_up: Callable[[], bool] = lambda: False) -> list[Mover] | None:
    """The numbers that change the error of a tap or make a refused one possible, solved at the ends of their sliders.

    Limits come before weights; those with the lowest error come first.

    Parameters
    ----------
    given_up : called before every solution; if it returns true, the search ends with None.
    """
    now = _tap_error(service, index, {})[0]
    found = []
    for control in service.controls:
        if control.choices or control.value is None:
            continue
        errors = [now]
        for value in (control.low, control.high):
            if given_up():
                return None
            errors.append(_tap_error(service, index, {control.key: value})[0])
        known = [error for error in errors if np.isfinite(error)]
        if known and (not np.isfinite(now) or max(known) - min(known) > LEAST_MOVE):
            found.append(Mover(control.key, control.label, min(known), max(known)))
    return sorted(found, key=lambda mover: (mover.key.startswith("weights."), mover.best))


def limit_for_error(service: Service, index: int, control: Control, tap_error: float) -> Found:
    """The least value of a key at which one tap has at most this error, every value solved and certified.

    Parameters
    ----------
    control : control of the number; its slider is the range of the search.
    tap_error : 0.05 for 5 %.

    Raises
    ------
    InputError : a key that is not a number, or an error outside 0 to 100 %.
    """
    if control.choices:
        raise InputError(f"{control.label}: a choice and no number: ask about a limit")
    if not 0 < tap_error < 1:
        raise InputError(f"error {100 * tap_error:g} %: must be between 0 and 100 %")
    place, (shown,) = service.places[index], service.quick([index])
    question = Question(
        find_key(service.scene, control.key),
        control.low,
        control.high,
        max(PRECISION * control.start, 1.0 if control.integer else 0.0),
        greatest=False,
        requirements=(Requirement("tap_error", at_most=True, bound=tap_error),),
    )

    def row(value: float) -> Row:
        error, reason = _tap_error(service, index, {control.key: value})
        cells = {"speed_m_s": str(place.speed_m_s), "grip_N": str(place.grip_N), "target": place.target}
        status = Status.NOT_CERTIFIED.name if reason else Status.OPTIMAL.name
        return {**cells, "status": status, "reason": reason, "tap_error": "" if reason else repr(error)}

    answered = answer(question, lambda values: [[row(value)] for value in values])
    unit = f" {control.unit}" if control.unit else ""
    wanted = f"{place.title}: an error of at most {100 * tap_error:.3g} %"
    now = shown.figures.tap_error if shown.figures is not None else np.inf
    needed = now > tap_error
    if answered.met is None:
        nearest = min(answered.tried, key=lambda tried: tried.excess)
        reached = nearest.rows[0]["tap_error"]
        how_near = f"; the nearest is {100 * float(reached):.3g} % at {nearest.value:.4g}{unit}" if reached else ""
        floor = f"; no limit at all leaves {percent(shown.floor)} %" if shown.floor > tap_error else ""
        span = f"from {control.low:.4g} to {control.high:.4g}{unit}"
        return Found(None, needed, f"{wanted} is met by no {control.label} {span}{how_near}{floor}")
    ends = "" if answered.missed is not None else ", the end of its slider"
    least = f"{answered.met.value:.4g}{unit}{ends}"
    if needed:
        return Found(answered.met.value, needed, f"{wanted} takes a {control.label} of {least}")
    words = f"Nothing need be done: {place.title} has {percent(now)} % already"
    return Found(answered.met.value, needed, f"{words}; a {control.label} of {least} would do")


def _tap_error(service: Service, index: int, changes: dict[str, Value]) -> tuple[float, str]:
    """Tap error with other values, NaN if it is not certified, and the reason."""
    try:
        (found,) = service.changed(changes).quick([index])
    except InputError as error:
        return np.nan, str(error)
    return np.nan if found.figures is None else found.figures.tap_error, found.reason
