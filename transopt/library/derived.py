"""`meta.derived` of a library: its problem in numbers, for readers that have numpy but not this project.

This project never reads these numbers. It poses the problem of a library from its scene; `transopt.library.proven`
computes the numbers again and refuses a file that states different ones.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.limits.command import CommandLimit
from transopt.problem.limits.current import CurrentLimit
from transopt.problem.limits.limit import Limit
from transopt.problem.limits.slew import SlewLimit
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.limits.voltage import SaggingVoltageLimit, VoltageLimit
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.figures import FELT_Hz, ROUNDING_s
from transopt.problem.objective.weighting import bandpass
from transopt.problem.posing import Posing
from transopt.problem.problem import TransientProblem

if TYPE_CHECKING:  # which loads pydantic
    from transopt.scene.scene import Scene

WHOLE = (CurrentLimit, VoltageLimit, CommandLimit, SlewLimit)  # limits that these numbers describe completely


def places(scene: "Scene") -> dict[str, FloatArray]:
    """Array -> (g, 3) normal and angles of each device of an arm; (0, 3) for any other plant."""
    of = [scene.arm().place(*at) for at in scene.axes.places]
    found = {"normals": [each.normal for each in of], "postures_rad": [each.posture_rad for each in of]}
    return {name: np.array(each).reshape(-1, 3) for name, each in found.items()}


def derived(posing: Posing, problems: Sequence[TransientProblem], *, warm: bool) -> dict[str, Any]:
    """The value of `meta.derived` for the problems of a library.

    Parameters
    ----------
    posing : what all its problems share.
    problems : one per speed or named target, all at the same grip; for a nonlinear plant those of the plant at rest.
    warm : whether the winding's temperature is a constraint of at least one entry.
    """
    problem = problems[0]
    grid, amplifier, limits = problem.grid, problem.stage.amplifier, problem.limits
    slew = next((limit for limit in limits if isinstance(limit, SlewLimit)), None)
    alone = problem.wall is None and not problem.spread and posing.objective == "waveform"
    alone = alone and problem.stage.motors == 1
    return {
        "dt_s": grid.dt_s,
        "lead_s": grid.lead_s,
        "hand_over_samples": problem.hand_over_samples,
        "intention_s": problem.intention_s - ROUNDING_s,  # the rounding of a reader's instants moves no sample
        "amplifier": None
        if amplifier is None
        else {
            "pole_Hz": amplifier.pole_Hz,
            "delay_s": amplifier.delay_s,
            "command_limit": amplifier.command_limit,
        },
        "limits": {"plant_input": limits.input_limit, "slew_per_s": None if slew is None else slew.rate},
        "exact": alone and all(_is_whole(limit, warm=warm) for limit in limits),
        "wall": problem.wall is not None,
        "spread": bool(problem.spread),
        "movement_weight": problem.movement.weight,
        "terms": [_term([each.terms[j] for each in problems]) for j in range(len(problem.terms))],
        "felt": _felt(grid.dt_s),
    }


def _is_whole(limit: Limit, *, warm: bool) -> bool:
    """Whether these numbers describe the limit completely, or no entry has it as a constraint."""
    if isinstance(limit, TemperatureLimit):
        return not warm
    return isinstance(limit, WHOLE) and not isinstance(limit, SaggingVoltageLimit)


def _term(of_problems: Sequence[ErrorTerm]) -> dict[str, Any]:
    """One term of the error; its weights in the window are a single list if those of all problems are equal."""
    first, by = of_problems[0], of_problems[0].error_filter
    weights = [term.weights.tolist() for term in of_problems]
    return {
        "name": first.name,
        "b": [1.0] if by is None else by.b.tolist(),
        "a": [1.0] if by is None else by.a.tolist(),
        "weights": weights[0] if all(each == weights[0] for each in weights) else weights,
        "before": first.before,
        "after": first.after,
    }


def _felt(dt_s: float) -> dict[str, list[float]] | None:
    """First-order band-pass of the felt error; None if the band exceeds half the servo rate."""
    if not 2 * FELT_Hz[1] * dt_s < 1:
        return None
    (by,) = bandpass(*FELT_Hz, dt_s, 1)
    return {"b": by.b.tolist(), "a": by.a.tolist()}
