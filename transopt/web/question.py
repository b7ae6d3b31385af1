"""The inverse question of one tap: which limit does its error need."""

from dataclasses import dataclass

from transopt.base.errors import InputError
from transopt.design.design import design
from transopt.problem.answer import Status
from transopt.scene.keys import Value, find_key, with_values
from transopt.study.inverse import Question, Requirement, answer
from transopt.study.rows import OPTIMAL, Row
from transopt.web.controls import Control
from transopt.web.service import Service

PRECISION = 1e-3  # of the answer


@dataclass(frozen=True)
class Found:
    """What an inverse question came to.

    Attributes
    ----------
    value : of the key; None where none within its slider does.
    words : what was found, or how near the search came.
    """

    value: Value
    words: str


def asked(service: Service, index: int, control: Control, tap_error: float) -> Found:
    """The least value of a key at which one tap has at most this error, every value solved and certified.

    Parameters
    ----------
    control : of the number that is asked for; its slider is the range.
    tap_error : 0.05 for 5 %.

    Raises
    ------
    InputError : a key that is no number, or an error that is none.
    """
    if control.choices:
        raise InputError(f"{control.key}: a choice and no number: ask about a limit")
    if not 0 < tap_error < 1:
        raise InputError(f"error {100 * tap_error:g} %: must be between 0 and 100 %")
    place, reference = service.places[index], service.reference(service.places[index])
    question = Question(
        find_key(service.scene, control.key),
        control.low,
        control.high,
        max(PRECISION * control.start, 1.0 if control.integer else 0.0),
        greatest=False,
        requirements=(Requirement("tap_error", at_most=True, bound=tap_error),),
    )

    def row(value: float) -> Row:
        cells = {"speed_m_s": str(place.speed_m_s), "grip_N": str(place.grip_N), "target": place.target}
        try:
            scene = with_values(service.scene, {control.key: value})
            posed = service.context.varied(scene).posed_as(reference, place.grip_N)
            (found,) = design([posed], options=service.trial)
        except InputError as error:
            return {**cells, "status": "REFUSED", "reason": str(error), "tap_error": ""}
        if found.solution.status is not Status.OPTIMAL or not found.certificate.accepted:
            said = found.solution.status.value
            return {**cells, "status": Status.NOT_CERTIFIED.name, "reason": said, "tap_error": ""}
        return {
            **cells,
            "status": OPTIMAL,
            "reason": "",
            "tap_error": repr(found.problem.yardstick.tap_error(found.told, found.predicted_m_s2)),
        }

    answered = answer(question, lambda values: [[row(value)] for value in values])
    unit = f" {control.unit}" if control.unit else ""
    wanted = f"{place.title}: an error of at most {100 * tap_error:.3g} %"
    if answered.met is None:
        nearest = min(answered.tried, key=lambda tried: tried.excess)
        reached = nearest.rows[0]["tap_error"]
        how_near = f"; the nearest is {100 * float(reached):.3g} % at {nearest.value:.4g}{unit}" if reached else ""
        return Found(
            None,
            f"{wanted} is met by no {control.label} from {control.low:.4g} to {control.high:.4g}{unit}{how_near}",
        )
    ends = "" if answered.missed is not None else ", the end of its slider"
    return Found(answered.met.value, f"{wanted} takes a {control.label} of {answered.met.value:.4g}{unit}{ends}")
