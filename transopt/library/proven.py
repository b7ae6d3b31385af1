"""Whether what a library plays is proven: its certificates made again from the model in the file, in milliseconds.

A file's hash tells that the file is whole, not who made it: whoever changes a number can hash the file again. What
stands in a library is therefore not believed before it plays, is shown or leaves for another program:

- its plants, its nodes and the numbers in `meta.derived` are those of the scene that the library carries, which alone
  states limits, weights and time axis; its targets and nominal motions follow from what was recorded;
- every command keeps all limits and is optimal by its own multipliers (`transopt.proof.certify`); where the copper's
  warming makes that a stationary point, a convex problem bounds J from below; on a nonlinear plant a stationary point
  is all that is claimed (`transopt.library.nonlinear_proven`);
- current, acceleration, errors, peaks and what binds are recomputed from the command.

`transopt verify` does the same and replays every entry with another integrator.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray, integral
from transopt.library.derived import derived
from transopt.library.file import BROKEN, load_library
from transopt.library.library import PLANT, Library
from transopt.library.meta import heat_is_in
from transopt.plant.discretise import TimeGrid
from transopt.plant.state_space import CURRENT_INPUT
from transopt.problem.answer import OBJECTIVE_SCALE, Certificate, Multipliers, Status
from transopt.problem.limits.limit import VIOLATION_TOLERANCE, tolerated
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.objective.target import Target
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import BINDING_MULTIPLIER, Effect, binding_limits, certify, relaxed_bound
from transopt.solvers.native.extension import (
    ACCURACY,
    MOST_STATES,
    SOLVED,
    LinearPass,
    available,
    buffers_of,
    interior_point,
)
from transopt.solvers.stage_data import stages, without_limits

SAME = 1e-6  # relative, between what a file states of its scene and what the scene it carries comes to
FIGURE = 1e-4  # relative, between a stated figure of an entry and the recomputed one
ROUNDING = 1e-9  # absolute, for figures that are zero
LEVEL_dB = 1e-4  # absolute, of the energy
STEADY = 3e-3  # relative, between two steady states
MOTION = 1e-2  # relative, between a motion that was integrated in fine steps and in those of the file
WARM_K = 2e-3  # between the winding's peak at the switching instants and that at all times
PASS_GAP = 1e-9  # of the optimum without limits, relative
MOST_ITERATIONS = 60  # of the method that bounds a hot entry from below


def load_proven(path: str | Path) -> Library:
    """Read a library file and prove it before anything of it is used; about two milliseconds an entry.

    Raises
    ------
    InputError : what `load_library` refuses, and what is not proven: the first thing, in one line.
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
    """What is not proven of a library, one phrase each; none if all is."""
    try:
        with np.errstate(all="ignore"):  # what overflows is found as not finite
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


def misstatements(library: Library) -> Iterator[str]:
    """Statements of a library that differ from the scene and the recordings it carries, all entries alike."""
    yield from _against_scene(library)
    yield from _targets(library)
    yield from _nominal(library)
    yield from _heat_prices(library)
    for name, array in library.multipliers_of.items():
        if (least := float(array.min())) < -BINDING_MULTIPLIER:
            yield f"{name} reaches {least:.3g}: multipliers must be >= 0"


def _of_grip(library: Library, ig: int) -> Iterator[str]:
    if library.nonlinear:
        yield from _of_nonlinear_plant(library, ig)
        return
    stage = library.stage(ig)
    for iv in range(library.speeds_m_s.size):
        where = f"entry {library.axes.place(iv, ig)}: "
        problem, command = library.problem(iv, ig, stage), library.command[iv, ig]
        effect = Effect(problem, command)
        proof = proof_of(effect, library.multipliers(iv, ig), _bound_by_interior_point)
        said = str(library.status[iv, ig])
        if said != Status.OPTIMAL.value:
            yield f"{where}its status is: {said}"
        elif not (proof.accepted or (proof.is_stationary and not _boundable(problem))):
            yield where + _shortfall(proof)
        else:
            yield from (where + off for off in predictions(library, iv, ig, effect))
            floor = floor_of(problem, library.told(iv, ig))
            yield from (where + off for off in contradictions(library, iv, ig, effect, proof, floor))


def _of_nonlinear_plant(library: Library, ig: int) -> Iterator[str]:
    # Only a library of a nonlinear plant needs this import.
    from transopt.library.nonlinear import nonlinear_problem
    from transopt.library.nonlinear_proven import nonlinear_doubts

    plant = library.scene().nonlinear_plant()
    for iv in range(library.speeds_m_s.size):
        found = nonlinear_doubts(library, iv, ig, nonlinear_problem(library, iv, ig, plant))
        yield from (f"entry {library.axes.place(iv, ig)}: {said}" for said in found)


def not_feasible(proof: Certificate) -> str:
    """Why a certificate is of no admissible command; empty if it is of one."""
    if not proof.finite:
        return "not certified: its numbers do not stay finite"
    if proof.excess > 1:
        over = ", ".join(f"{by:.3g} {unit}" for unit, by in proof.stated_violations.items() if by > 0)
        return f"not certified: a limit is exceeded by {over}"
    return ""


def _shortfall(proof: Certificate) -> str:
    """What a certificate that is not accepted lacks."""
    if said := not_feasible(proof):
        return said
    if proof.relative_gap > proof.GAP_TOLERANCE:
        return f"not certified: may lie {proof.relative_gap:.1e} above the optimum, limit {proof.GAP_TOLERANCE:.0e}"
    return f"not certified: lies {proof.relative_bound:.1e} above the bound, limit {proof.BOUND_TOLERANCE:.0e}"


def proof_of(effect: Effect, multipliers: Multipliers, bound: Callable[[TransientProblem], float]) -> Certificate:
    """A command's certificate; where the temperature binds, a convex problem bounds J from below.

    Parameters
    ----------
    bound : lower bound of the convex problem, asked for where the entry's own multipliers bound too little.
    """
    problem, command = effect.problem, effect.command
    proof = certify(problem, command, multipliers, effect=effect)
    if problem.thermal is not None and proof.is_stationary and not np.isfinite(proof.lower_bound):
        proof = replace(proof, lower_bound=relaxed_bound(effect, multipliers))
        if not proof.accepted:
            lower = bound(problem.replaced(problem.thermal.relaxed()))
            proof = replace(proof, lower_bound=max(proof.lower_bound, lower))
    return proof


def _bound_by_interior_point(relaxed: TransientProblem) -> float:
    if not available:
        return -np.inf
    given = stages(relaxed)
    buffers = buffers_of(given.sizes)
    answer = interior_point(given, buffers, tolerance=1e-9, max_iterations=MOST_ITERATIONS)
    if answer.code not in (SOLVED, ACCURACY):
        return -np.inf
    multipliers = given.multipliers(buffers.upper - buffers.lower, buffers.gradient)
    return certify(relaxed, given.command(buffers.command), multipliers).lower_bound


def _boundable(problem: TransientProblem) -> bool:
    """Whether a bound from below can be had here: not of a user's own limit that is bent, nor without the solver."""
    return available and not any(name != TemperatureLimit.name for name in problem.nonlinear)


def floor_of(problem: TransientProblem, target: Target) -> float:
    """Tap error against a target of the optimum of J without limits; NaN where there is none, or it loses digits."""
    free = np.zeros(problem.grid.stages)
    if not problem.reference_is_zero:
        given = without_limits(problem.without_intensity())
        if not available or given.sizes["states"] > MOST_STATES:
            return np.nan
        run = LinearPass(given, buffers_of(given.sizes))
        answer = run.solve(PASS_GAP)
        if answer.code not in (SOLVED, ACCURACY) or not answer.relative_gap <= PASS_GAP:
            return np.nan
        free = run.command()
    return problem.yardstick.tap_error(target, problem.stage.rollout(free)[0])


def contradictions(
    library: Library,
    iv: int,
    ig: int,
    effect: Effect,
    proof: Certificate,
    floor: float,
    of_bound: float = Certificate.BOUND_TOLERANCE,
) -> Iterator[str]:
    """Figures of an entry in the file that do not follow from its waveform and its model.

    Parameters
    ----------
    effect : of the entry's command in its problem.
    floor : tap error of the optimum without limits, as found now; NaN where it was not.
    of_bound : relative, by which the stated lower bound may lie above the one found; other methods find others.
    """
    problem = effect.problem
    ampere, scale = problem.limits.input_limit, max(proof.objective, OBJECTIVE_SCALE)
    # The largest over A, V and K is stored; only where A is all there is the limit tells how exact it has to be.
    in_ampere_only = all(limit.unit.startswith("A") for limit in problem.limits)
    claims = {
        "objective": (proof.objective, SAME * scale),
        "primal_violation": (proof.primal_violation, tolerated(ampere) if in_ampere_only else VIOLATION_TOLERANCE),
        "duality_gap": (proof.duality_gap, Certificate.GAP_TOLERANCE * scale),
        "dual_residual": (proof.dual_residual, Certificate.GAP_TOLERANCE / min(problem.command_bound, 1.0)),
        "floor": (floor, SAME),
    }
    for name, (value, tolerance) in claims.items():
        stored = float(getattr(library, name)[iv, ig])
        if not abs(stored - value) <= tolerance and np.isfinite(value):
            yield f"{name} says {stored:.4g}, recomputed {value:.4g}"
    # A bound is a claim from below: one that says less than what can be proven is true as well. It still has to be
    # one by which the entry was accepted, or the file calls optimal what its own figures do not prove.
    claimed, least = float(library.lower_bound[iv, ig]), proof.lower_bound
    if not claimed <= least + of_bound * scale and np.isfinite(least):
        yield f"lower_bound says {claimed:.8g}, no more than {least:.8g} can be proven"
    elif proof.accepted and not proof.merit - claimed <= (proof.BOUND_TOLERANCE + proof.GAP_TOLERANCE) * scale:
        yield f"lower_bound says {claimed:.8g}, which does not prove {proof.merit:.8g}; {least:.8g} can be proven"
    binds = binding_limits(problem, effect.command, library.multipliers(iv, ig), effect=effect)
    if str(library.binding[iv, ig]) != binds:
        yield f"binding says {str(library.binding[iv, ig])!r}, recomputed {binds!r}"
    transient = problem.transient_command(effect.command)
    if not np.abs(library.transient_command[iv, ig] - transient).max() <= tolerated(ampere):
        yield "transient_command is not command less the wall's feedback"


def predictions(library: Library, iv: int, ig: int, effect: Effect) -> Iterator[str]:
    """What the file predicts of an entry and its command does not do."""
    problem, motion, target = effect.problem, effect.motion, library.told(iv, ig)
    size = max(float(np.abs(target.window_m_s2).max()), float(np.abs(motion.acceleration_m_s2).max()))
    for name, value, tolerance in (
        ("plant_input", motion.plant_input, SAME * problem.limits.input_limit),
        ("acceleration_m_s2", motion.acceleration_m_s2, SAME * size),
    ):
        off = float(np.abs(getattr(library, name)[iv, ig] - value).max())
        if not off <= tolerance:
            yield f"{name} is off by {off:.3g}"
    yield from _afterwards(library, iv, ig, effect, target)
    stored, peak = float(library.peak_input[iv, ig]), float(np.abs(motion.plant_input).max())
    # A wall pushes on after the waveform; its limit there is the replay's to check.
    most = problem.limits.input_limit * (1 + SAME) if problem.wall is not None else peak * (1 + FIGURE) + ROUNDING
    if not peak * (1 - FIGURE) - ROUNDING <= stored <= most:
        unit = library.driven_by.unit
        yield f"peak_input says {stored:.6g} {unit}, recomputed {peak:.6g} {unit}"
    stored = float(library.peak_temperature_C[iv, ig])
    if problem.thermal is None:
        if not np.isnan(stored):
            yield f"peak_temperature_C says {stored:.6g} C of a device without a coil"
        return
    model = problem.thermal.model
    hottest = max(float((effect.rise_K[1:, 0] + model.unpowered_C).max()), problem.thermal.coil.start_winding_C)
    # For taps without end the two methods find the steady state, and the rise from ambient, by different sums.
    rise_K = 0.0 if model.closure is None else abs(hottest - problem.thermal.coil.ambient_C)
    if not abs(stored - hottest) <= WARM_K + STEADY * rise_K:
        yield f"peak_temperature_C says {stored:.5g} C, recomputed {hottest:.5g} C"


def _afterwards(library: Library, iv: int, ig: int, effect: Effect, target: Target) -> Iterator[str]:
    """What the file says of the motion after the window, and of its energy, and its command does not do."""
    problem, N = effect.problem, effect.command.size
    later = effect.lasting.acceleration_m_s2[N:]
    size = float(np.abs(target.window_m_s2).max())
    figures = problem.yardstick.figures(target, effect.lasting.acceleration_m_s2)
    current = effect.lasting.plant_input
    heat_A2_s = problem.grid.dt_s * float(current @ current) if library.driven_by is CURRENT_INPUT else np.nan
    claims = {
        "energy": (problem.tracking.energy_m2_s4, SAME, 0.0),
        "heat_price": (problem.heat_price, SAME, 0.0),
        "heat_A2_s": (heat_A2_s, FIGURE, ROUNDING),
        "tap_error": (figures.tap_error, FIGURE, SAME),
        "felt_error": (figures.felt_error, FIGURE, SAME),
        "felt_dB": (figures.felt_dB, 0.0, LEVEL_dB),
        "speed_change": (figures.speed, FIGURE, SAME),
        "bump_m_s2": (figures.bump_m_s2, FIGURE, SAME * size),
        "error_after": (figures.error_after, FIGURE, SAME),
        "peak_after_m_s2": (figures.peak_after_m_s2, FIGURE, SAME * size),
    }
    if problem.tracking.energy_m2_s4 > 0 and library.posing().objective == "intensity":
        silent = problem.reference_is_zero
        made_dB = 0.0 if silent else problem.tracking.energy_dB(effect.accelerations_m_s2)
        claims["energy_dB"] = (made_dB, 0.0, LEVEL_dB)
    off = float(np.abs(library.acceleration_after_m_s2[iv, ig] - later).max(initial=0.0))
    if not off <= SAME * max(size, float(np.abs(later).max(initial=0.0))):
        yield f"acceleration_after_m_s2 is off by {off:.3g}"
    for name, (value, relative, absolute) in claims.items():
        stored = float(getattr(library, name)[iv, ig])
        if not np.isclose(stored, value, rtol=relative, atol=absolute, equal_nan=True):
            yield f"{name} says {stored:.6g}, recomputed {value:.6g}"


def _against_scene(library: Library) -> Iterator[str]:
    """Differences between the file's problem and the scene that it carries: limits, weights, time axis, plants."""
    scene, at_rest = library.scene(), library.scene().at_rest()
    problems = [library.problem(iv, 0) for iv in range(library.speeds_m_s.size)]
    warm = heat_is_in(library.meta["left_out"])
    own = derived(library.posing(), problems, warm=warm)
    yield from _different("derived", library.meta["derived"], own)
    if stray_targets := set(library.axes.targets) - set(scene.axes.targets):
        yield f"targets: {min(stray_targets)} is no target of its scene"
    for name, nodes in (("speeds_m_s", scene.axes.speeds_m_s), ("grips_N", scene.grid.grips_N)):
        # A library may be a part of what its scene asked for.
        stray = [node for node in getattr(library, name) if not np.isclose(node, nodes, rtol=SAME, atol=0).any()]
        if stray:
            yield f"{name}: {stray[0]:g} is no node of its scene"
    for ig, grip in enumerate(library.grips_N):
        plant = at_rest.plant(float(grip))
        for name in PLANT:
            stored, value = getattr(library, f"plant_{name}")[ig], getattr(plant, name)
            if stored.shape != value.shape or not np.abs(stored - value).max() <= SAME * np.abs(value).max():
                yield f"plant_{name} at {grip:g} N is not the device of its scene"
        for name, output in library.plant(ig).outputs.items():
            yield from _different(f"output {name} at {grip:g} N", output, plant.outputs.get(name))


def _nominal(library: Library) -> Iterator[str]:
    """Nominal motions that are not the integrals of a_free, from minus the speed and the surface on."""
    grid, free, after = library.time_grid(), library.free_m_s2, library.free_after_m_s2
    times = grid.switching_times_s
    for iv, ig in np.ndindex(free.shape[:2]):
        speed, where = float(library.speeds_m_s[iv]), library.axes.place(iv, ig)
        velocity, position = library.nominal_velocity_m_s[iv, ig], library.nominal_position_m[iv, ig]
        at_ticks = library.nominal_position_at_ticks_m[iv, ig]
        for name, stated, integrated, size in (
            ("nominal_velocity_m_s", velocity, _from_contact(times, free[iv, ig]) - speed, np.abs(velocity).max()),
            ("nominal_position_m", position, _from_contact(times, velocity), np.abs(position).max()),
            ("nominal_position_at_ticks_m", at_ticks + grid.delay_s * velocity, position, np.abs(position).max()),
        ):
            step = speed * grid.dt_s if name != "nominal_velocity_m_s" else 0.0
            if not np.abs(stated - integrated).max() <= MOTION * size + step:
                yield f"{name} at {where} is not the motion of a_free"
        later = library.nominal_after_at_ticks_m[iv, ig]
        onward = _onward(grid, velocity[-1], position[-1], np.append(free[iv, ig, -1], after[iv, ig]))
        size = max(float(np.abs(position).max()), float(np.abs(onward).max(initial=0.0)))
        if not np.abs(later - onward).max(initial=0.0) <= MOTION * size + speed * grid.dt_s:
            yield f"nominal_after_at_ticks_m at {where} is not the motion of a_free"


def _targets(library: Library) -> Iterator[str]:
    """Targets that are not the recorded acceleration less the free one, with the correction of a refined library."""
    for part, correction in (("before_", 0.0), ("", library.correction_m_s2), ("after_", 0.0)):
        target, recorded, free = (getattr(library, f"{of}_{part}m_s2") for of in ("target", "recorded", "free"))
        size = max(float(np.abs(course).max(initial=0.0)) for course in (target, recorded, free))
        off = np.abs(target - (recorded - free + correction)).max(axis=2, initial=0.0)
        for iv, ig in np.argwhere(~(off <= SAME * size)):
            yield f"entry {library.axes.place(iv, ig)}: target_{part}m_s2 is not what was recorded less a_free"


def _heat_prices(library: Library) -> Iterator[str]:
    """Prices on heat that are not the scene's, and cool commands that are no cooler than the first."""
    stated, own = library.heat_price, library.posing().heat_price
    if not np.allclose(stated, own, rtol=SAME, atol=0):
        yield f"heat_price reaches {stated.max():.4g}, its scene says {own:.4g}"
    if library.cool is None:
        return
    if not np.all(library.cool.heat_price >= own * (1 - SAME)):
        yield f"cool_heat_price falls to {library.cool.heat_price.min():.4g}, below that of the first commands"
    if not np.all(library.cool.heat_A2_s <= library.heat_A2_s * (1 + FIGURE)):
        yield "cool_heat_A2_s is above that of the first commands"


def _onward(grid: TimeGrid, velocity_m_s: float, position_m: float, rate_m_s2: FloatArray) -> FloatArray:
    """(M,) position at the ticks after the window, from that at tau_(N-1) on and its second derivative (M + 1,)."""
    velocity = velocity_m_s + integral(rate_m_s2, grid.dt_s)
    course = position_m + integral(velocity, grid.dt_s)
    return np.asarray((course - grid.delay_s * velocity)[1:])


def _from_contact(times_s: FloatArray, rate: FloatArray) -> FloatArray:
    """(N,) integral of a rate by the trapezoidal rule, zero at contact, which may lie before the first instant."""
    steps = 0.5 * np.diff(times_s) * (rate[1:] + rate[:-1])
    course = np.append(0.0, np.cumsum(steps))
    before = min(times_s[0], 0.0) - times_s[0]  # of the first instant, where contact comes before it
    return np.asarray(course - np.interp(0.0, times_s, course) - before * rate[0])


def _different(name: str, stated: Any, own: Any) -> Iterator[str]:
    """Numbers and words in `stated` that differ from those of the same place in `own`, the scene's."""
    if is_dataclass(own) and type(stated) is type(own):
        for field in fields(own):
            yield from _different(f"{name}.{field.name}", getattr(stated, field.name), getattr(own, field.name))
    elif isinstance(own, Mapping) and isinstance(stated, Mapping):
        for key, value in own.items():
            yield from _different(f"{name}.{key}", stated.get(key), value)
        if stray := sorted(map(str, set(stated) - set(own))):
            yield f"{name} has keys that follow from nothing: {', '.join(stray)}"
    elif isinstance(own, np.ndarray):
        if np.shape(stated) != own.shape or not np.allclose(stated, own, rtol=SAME, atol=0):
            yield f"{name} is not what its scene says"
    elif isinstance(own, Sequence) and not isinstance(own, str):
        if not isinstance(stated, Sequence) or len(stated) != len(own):
            yield f"{name} has other items than its scene"
            return
        for one, other in zip(stated, own, strict=True):
            yield from _different(name, one, other)
    elif isinstance(own, float) and isinstance(stated, int | float):
        if not math.isclose(stated, own, rel_tol=SAME):
            yield f"{name} is {stated:g}, its scene says {own:g}"
    elif stated != own:
        yield f"{name} is {stated!r}, its scene says {own!r}"
