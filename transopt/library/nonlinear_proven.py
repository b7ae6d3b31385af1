"""Whether an entry on a nonlinear plant is what its file claims: a stationary point, with the errors that it states.

The stored command is rolled out on the nonlinear plant of the library's own scene, and the gradient of the Lagrangian
is formed with the stored multipliers (`transopt.proof.nonlinear`). Nothing is solved.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from transopt.library.library import Library
from transopt.library.nonlinear import as_on_linear
from transopt.library.proven import FIGURE, ROUNDING, contradictions, floor_of, not_feasible, predictions
from transopt.problem.answer import Certificate, Status
from transopt.problem.nonlinear import NonlinearEffect, NonlinearProblem
from transopt.proof.nonlinear import certify_nonlinear


def certificate_of(library: Library, iv: int, ig: int, effect: NonlinearEffect) -> Certificate:
    """Certificate of a stored command and its multipliers; its lower bound is 0, below which no sum of squares is.

    Parameters
    ----------
    effect : of that command.
    """
    proof = certify_nonlinear(effect.problem, effect.command, library.multipliers(iv, ig), effect=effect)
    return replace(proof, lower_bound=0.0) if proof.finite else proof


def shortfall(library: Library, iv: int, ig: int, proof: Certificate) -> str:
    """Why an entry may not stand in a library; empty if it may."""
    said = str(library.status[iv, ig])
    if said != Status.STATIONARY.value:
        return f"its status is: {said}"
    if proof.is_stationary:
        return ""
    return not_feasible(proof) or (
        f"not certified: no stationary point: its gap is {proof.relative_gap:.1e}, limit {proof.GAP_TOLERANCE:.0e}"
    )


def nonlinear_doubts(library: Library, iv: int, ig: int, problem: NonlinearProblem) -> Iterator[str]:
    """What is not proven of an entry, one phrase each; none if all is."""
    own = problem.effect(library.command[iv, ig])
    proof = certificate_of(library, iv, ig, own)
    if said := shortfall(library, iv, ig, proof):
        yield said
        return
    effect = as_on_linear(own)
    yield from predictions(library, iv, ig, effect)
    floor = floor_of(problem.linear, library.told(iv, ig))
    yield from contradictions(library, iv, ig, effect, proof, floor)
    played = problem.figures(library.linear_command[iv, ig]).tap_error
    # If a motion has no value one method may come further than another.
    if math.isnan(played) or math.isnan(library.tap_error_linear[iv, ig]):
        played = float(library.tap_error_linear[iv, ig])
    yield from of_linear_design(library, iv, ig, problem, played, FIGURE)


def of_linear_design(
    library: Library, iv: int, ig: int, problem: NonlinearProblem, linear_tap_error: float, tolerance: float
) -> Iterator[str]:
    """Errors of the linear design that the file states and that are other ones.

    Parameters
    ----------
    linear_tap_error : of the linear design on the nonlinear plant, as found now; NaN where its motion has no value.
    tolerance : relative, of the linear design's errors.
    """
    linear, command = problem.linear, library.linear_command[iv, ig]
    promised = linear.yardstick.tap_error(linear.target, linear.stage.rollout(command)[0])
    for name, value in {"tap_error_promised": promised, "tap_error_linear": linear_tap_error}.items():
        stored = float(getattr(library, name)[iv, ig])
        if not np.isclose(stored, value, rtol=tolerance, atol=ROUNDING, equal_nan=True):
            yield f"{name} says {stored:.6g}, recomputed {value:.6g}"
