"""Proof of a library: its certificates computed again from the model in the file, in milliseconds.

A file's hash shows that the file is intact, not who made it: whoever changes a number can hash the file again.
Therefore a library is checked before it is played, shown or exported:

- its statements on its problems follow from its scene and its recordings (`transopt.library.statements`);
- every command is feasible and, by its own multipliers, optimal (`transopt.proof.certify`). Where warming copper
  makes it a stationary point only, a convex problem bounds J from below; on a nonlinear plant a stationary point is
  all that is claimed;
- current, acceleration, errors, peaks and binding limits are computed again from the command and compared
  (`departures`).

`transopt verify` uses the same comparison with a replay by another integrator.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.library.answered import Answered, Stored, answers_of, uncorrected_of
from transopt.library.file import BROKEN, load_library
from transopt.library.library import Library
from transopt.library.multipliers import ARRAYS
from transopt.library.statements import SAME, misstatements
from transopt.problem.answer import OBJECTIVE_SCALE, Certificate, Multipliers, Status
from transopt.problem.limits.limit import VIOLATION_TOLERANCE, tolerated
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import certify, certify_all, relaxed_bound
from transopt.proof.effect import Effect
from transopt.solvers.native.extension import (
    ACCURACY,
    SOLVED,
    available,
    interior_points,
    linear_passes,
    takes,
)
from transopt.solvers.stage_data import stages, without_limits_of

FIGURE = 1e-4  # relative difference allowed between a stated figure of an entry and the predicted one
REPLAYED = 1e-6  # relative difference allowed between a stated figure and the replayed one
ROUNDING = 1e-9  # absolute difference allowed, for figures that are zero
LEVEL_dB = 1e-4  # absolute difference allowed for levels
STEADY = 3e-3  # relative difference allowed between two computed steady states
WARM_K = 2e-3  # difference allowed between the winding's peak at the switching instants and that at all times
PASS_GAP = 1e-9  # relative duality gap of the optimum without limits
MOST_ITERATIONS = 60  # iterations of the interior point that bounds an entry with a binding temperature from below


def load_proven(path: str | Path) -> Library:
    """Read a library file and prove it before any of it is used; takes less than a millisecond per entry.

    Raises
    ------
    InputError : what `load_library` refuses, or the first statement that is not proven, in one line.
    """
    library = load_library(path)
    doubt = next(doubts(library), None)
    if doubt is not None:
        raise InputError(
            f"{path}: {doubt}: it was changed, or made by another version, and is not used; `transopt verify` checks "
            "every entry, `transopt solve` makes it anew"
        )
    return library


def doubts(library: Library) -> Iterator[str]:
    """What is not proven of a library, one phrase each; empty if everything is proven."""
    try:
        with np.errstate(all="ignore"):  # an overflow shows as a value that is not finite
            yield from misstatements(library)
            for ig in range(library.grips_N.size):
                yield from _of_grip(library, ig)
                if library.cool is not None:
                    yield from (f"cool command of {said}" for said in _of_grip(library.cool, ig))
    except (InputError, *BROKEN) as error:
        yield (
            f"it does not describe a problem ({error})"
            if isinstance(error, InputError)
            else "it describes no problem"
        )


def _of_grip(library: Library, ig: int) -> Iterator[str]:
    answers = answers_of(library, [ig], _proofs, _unlimited)
    targets = [uncorrected_of(library, iv, ig, designed.problem) for iv, designed in enumerate(answers)]
    made = np.stack([designed.effect.lasting.acceleration_m_s2 for designed in answers])
    figures = answers[0].problem.yardstick.figures_of(targets, made)
    proven = dict[int, Stored]()
    for iv, designed in enumerate(answers):
        where = f"entry {library.axes.place(iv, ig)}: "
        if designed.solution.status is not Status.OPTIMAL:
            yield f"{where}its status is: {library.status[iv, ig]}"
            continue
        proof = designed.certificate
        claims_no_more = library.status[iv, ig] == Status.STATIONARY.value
        if not (proof.accepted or (proof.is_stationary and (claims_no_more or not available))):
            yield where + proof.shortfall
            continue
        proven[iv] = Stored(designed, targets[iv], figures[iv], library.posing().objective)
    for iv, said in departures(library, ig, proven).items():
        where = f"entry {library.axes.place(iv, ig)}: "
        yield from (where + off for off in (*said, *_peaks(library, iv, ig, proven[iv])))


def _proofs(answers: Sequence[tuple[Effect, Multipliers]]) -> list[Certificate]:
    proofs = zip(answers, certify_all(answers), strict=True)
    return [bounded(effect, multipliers, proof) for (effect, multipliers), proof in proofs]


def bounded(effect: Effect, multipliers: Multipliers, proof: Certificate) -> Certificate:
    """A command's certificate; where a limit that is not convex binds, a convex problem bounds J from below."""
    if not proof.is_stationary or np.isfinite(proof.lower_bound):
        return proof
    proof = replace(proof, lower_bound=relaxed_bound(effect, multipliers))
    if not proof.accepted:
        lower = _bound_by_interior_point(effect.problem.relaxed())
        proof = replace(proof, lower_bound=max(proof.lower_bound, lower))
    return proof


def _bound_by_interior_point(relaxed: TransientProblem) -> float:
    if not available:
        return -np.inf
    given = stages(relaxed)
    (answer,) = interior_points([given], tolerance=1e-9, max_iterations=MOST_ITERATIONS)
    if answer.code not in (SOLVED, ACCURACY):
        return -np.inf
    multipliers = given.multipliers(answer.upper - answer.lower, answer.gradient)
    return certify(relaxed, given.command(answer.command), multipliers).lower_bound


def _unlimited(problems: Sequence[TransientProblem]) -> list[FloatArray | None]:
    """(N,) or (m, N) optima of J without limits by the compiled pass; None without it or with too large a gap."""
    given = without_limits_of(problems) if available else []
    if not all(takes(each.sizes["states"], each.sizes["motors"], 0) for each in given) or not given:
        return [None] * len(problems)
    return [
        each.free_command(answer.command)
        if answer.code in (SOLVED, ACCURACY) and answer.relative_gap <= PASS_GAP
        else None
        for each, answer in zip(given, linear_passes(given, PASS_GAP), strict=True)
    ]


def _peak(course: Any) -> float:
    """Largest magnitude in a course or of one number; numpy would take ten times as long for a number."""
    if isinstance(course, float):
        return abs(float(course))
    return float(np.abs(course).max(initial=0.0))


def _size(again: Answered) -> float:
    """Largest acceleration of the target [m/s^2]."""
    return _peak(again.uncorrected.window_m_s2)


def _scale(again: Answered) -> float:
    return max(again.certificate.objective, OBJECTIVE_SCALE)


def _violation(again: Answered) -> float:
    # One number is stored, the largest over A, V and K. Only if all limits are in A does the limit set the tolerance.
    limits = again.problem.limits
    return tolerated(limits.input_limit) if all(each.unit.startswith("A") for each in limits) else VIOLATION_TOLERANCE


# Array -> largest difference allowed between the file and the value of an answer that was not replayed.
WITHIN: dict[str, Callable[[Answered, Any], float]] = {
    "plant_input": lambda again, value: SAME * again.problem.limits.input_limit,
    "acceleration_m_s2": lambda again, value: SAME * max(_size(again), _peak(value)),
    "acceleration_after_m_s2": lambda again, value: SAME * max(_size(again), _peak(value)),
    "transient_command": lambda again, value: tolerated(again.problem.limits.input_limit),
    "objective": lambda again, value: SAME * _scale(again),
    "primal_violation": lambda again, value: _violation(again),
    "duality_gap": lambda again, value: Certificate.GAP_TOLERANCE * _scale(again),
    "dual_residual": lambda again, value: Certificate.GAP_TOLERANCE / min(again.problem.command_bound, 1.0),
    "floor": lambda again, value: SAME,
    "unlimited_objective": lambda again, value: SAME * _scale(again),
    "energy": lambda again, value: SAME * value,
    "energy_dB": lambda again, value: LEVEL_dB,
    "heat_price": lambda again, value: SAME * value,
    "heat_A2_s": lambda again, value: FIGURE * value + ROUNDING,
    "tap_error": lambda again, value: FIGURE * value + SAME,
    "tangential_error": lambda again, value: FIGURE * value + SAME,
    "direction_rad": lambda again, value: FIGURE * value + SAME,
    "felt_error": lambda again, value: FIGURE * value + SAME,
    "felt_dB": lambda again, value: LEVEL_dB,
    "speed_change": lambda again, value: FIGURE * abs(value) + SAME,
    "bump_m_s2": lambda again, value: FIGURE * value + SAME * _size(again),
    "error_after": lambda again, value: FIGURE * value + SAME,
    "peak_after_m_s2": lambda again, value: FIGURE * value + SAME * _size(again),
    "tap_error_promised": lambda again, value: FIGURE * value + ROUNDING,
    "tap_error_linear": lambda again, value: FIGURE * value + ROUNDING,
}
# Arrays that may be NaN by one method and known by another.
MAY_BE_UNKNOWN = (
    "objective",
    "primal_violation",
    "duality_gap",
    "dual_residual",
    "floor",
    "unlimited_objective",
    "tap_error_linear",
)


def departures(
    library: Library,
    ig: int,
    again: Mapping[int, Answered],
    *,
    replayed: bool = False,
    of_bound: float = Certificate.BOUND_TOLERANCE,
) -> dict[int, list[str]]:
    """Differences between what a file states of entries and the answers computed again, one phrase each.

    Parameters
    ----------
    again : iv of an entry of the grip -> its answer computed again, which `Array.made` reads.
    replayed : whether its figures come from a replay, so that all replayed arrays (`Array.replayed`) are compared.
    of_bound : relative excess of the stated lower bound over the one computed here; methods find different bounds.
    """
    found, rows = {iv: list[str]() for iv in again}, [*again]
    for name, array in ARRAYS.items():
        by_replay = replayed and array.replayed
        if array.made is None or not (by_replay or name in WITHIN):
            continue
        stated, values = getattr(library, name)[rows, ig], [array.made(each) for each in again.values()]
        # Most values are the same to the last bit, which is found faster than how far apart two of them are.
        differ = (stated != np.array(values)).reshape(len(rows), -1).any(axis=1)
        for number in np.flatnonzero(differ).tolist():
            stored, value, answer = stated[number], values[number], again[rows[number]]
            within = REPLAYED * _peak(value) + ROUNDING if by_replay else WITHIN[name](answer, value)
            off = _peak(stored - value)
            if off <= within or np.array_equal(stored, value, equal_nan=True):
                continue
            if isinstance(value, np.ndarray):
                found[rows[number]].append(f"{name} is off by {off:.3g}")
            elif not (name in MAY_BE_UNKNOWN and np.isnan(off)):
                found[rows[number]].append(f"{name} says {stored:.8g}, recomputed {value:.8g}")
    for iv, answer in again.items():
        found[iv] += _off_bound(float(library.lower_bound[iv, ig]), answer.certificate, of_bound)
        if str(library.binding[iv, ig]) != answer.binding:
            found[iv].append(f"binding says {str(library.binding[iv, ig])!r}, recomputed {answer.binding!r}")
    return found


def _off_bound(claimed: float, proof: Certificate, of_bound: float) -> Iterator[str]:
    """What speaks against a stated lower bound.

    A bound below the one that can be proven is true as well. It must still be high enough to accept the entry;
    otherwise the file calls an entry optimal that its own figures do not prove.
    """
    scale, least = max(proof.objective, OBJECTIVE_SCALE), proof.lower_bound
    if not claimed <= least + of_bound * scale and np.isfinite(least):
        yield f"lower_bound says {claimed:.8g}, no more than {least:.8g} can be proven"
    elif proof.accepted and not proof.merit - claimed <= (proof.BOUND_TOLERANCE + proof.GAP_TOLERANCE) * scale:
        yield f"lower_bound says {claimed:.8g}, which does not prove {proof.merit:.8g}; {least:.8g} can be proven"


def _peaks(library: Library, iv: int, ig: int, again: Answered) -> Iterator[str]:
    """Peaks in the file that differ from the predicted ones by more than sampling at the instants explains."""
    problem, unit = again.problem, again.unit
    stored, peak = float(library.peak_input[iv, ig]), _peak(again.plant_input)
    # A wall keeps pressing after the waveform; the replay checks the limit there.
    most = problem.limits.input_limit * (1 + SAME) if problem.wall is not None else peak * (1 + FIGURE) + ROUNDING
    if not peak * (1 - FIGURE) - ROUNDING <= stored <= most:
        yield f"peak_input says {stored:.6g} {unit}, recomputed {peak:.6g} {unit}"
    stored = float(library.peak_temperature_C[iv, ig])
    if problem.thermal is None:
        if not np.isnan(stored):
            yield f"peak_temperature_C says {stored:.6g} C of a device without a coil"
        return
    model, coil = problem.thermal.model, problem.thermal.coil
    hottest = max(float(again.designed.effect.winding_C.max()), coil.start_winding_C)
    # For endless taps the two methods sum the steady state, and so the rise from ambient, in different ways.
    rise_K = 0.0 if model.closure is None else abs(hottest - coil.ambient_C)
    if not abs(stored - hottest) <= WARM_K + STEADY * rise_K:
        yield f"peak_temperature_C says {stored:.5g} C, recomputed {hottest:.5g} C"
