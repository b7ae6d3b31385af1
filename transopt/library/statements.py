"""Whether a library's statements follow from the scene and the recordings in its file, over all entries.

Its plants, its nodes and the numbers in `meta.derived` must be those of the scene, which alone states limits, weights
and time axis; its targets and nominal motions must follow from the recorded accelerations.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from transopt.base.signals import FloatArray, integral
from transopt.library.derived import derived, places
from transopt.library.library import Library
from transopt.library.meta import heat_is_in
from transopt.library.posed import PLANT
from transopt.plant.time_grid import TimeGrid
from transopt.proof.certify import BINDING_MULTIPLIER

SAME = 1e-6  # relative difference allowed between a statement and its value by the scene
MOTION = 1e-2  # relative difference allowed between motions integrated in fine steps and in the file's steps
COOLER = 1e-4  # relative excess allowed of a cool command's heat over that of the first command


def misstatements(library: Library) -> Iterator[str]:
    """Statements of a library that differ from its scene and recordings, over all entries."""
    yield from _against_scene(library)
    yield from _targets(library)
    yield from _nominal(library)
    yield from _heat_prices(library)
    for name, array in library.multipliers_of.items():
        if (least := float(array.min())) < -BINDING_MULTIPLIER:
            yield f"{name} reaches {least:.3g}: multipliers must be >= 0"


def _against_scene(library: Library) -> Iterator[str]:
    """Differences between the file's problem and its scene: limits, weights, time axis, plants."""
    scene, at_rest = library.scene(), library.scene().at_rest()
    problems = library.problems(0, range(library.speeds_m_s.size))
    warm = heat_is_in(library.meta["left_out"])
    own = derived(library.posing(), problems, warm=warm)
    yield from _different("derived", library.meta["derived"], own)
    if stray_targets := set(library.axes.targets) - set(scene.axes.targets):
        yield f"targets: {min(stray_targets)} is no target of its scene"
    for name, nodes in (("speeds_m_s", scene.axes.speeds_m_s), ("grips_N", scene.grid.grips_N)):
        # A library may hold a part of its scene's nodes.
        stray = [node for node in getattr(library, name) if not np.isclose(node, nodes, rtol=SAME, atol=0).any()]
        if stray:
            yield f"{name}: {stray[0]:g} is no node of its scene"
    for name, own_places in places(scene).items():
        yield from _different(name, getattr(library, name), own_places)
    for ig, device in enumerate(library.axes.devices):
        plant, grip = at_rest.plant(*device), library.axes.device(ig)
        for name in PLANT:
            stored, value = getattr(library, f"plant_{name}")[ig], getattr(plant, name)
            if stored.shape != value.shape or not np.abs(stored - value).max() <= SAME * np.abs(value).max():
                yield f"plant_{name} at {grip} is not the device of its scene"
        for name, output in library.plant(ig).outputs.items():
            yield from _different(f"output {name} at {grip}", output, plant.outputs.get(name))


def _nominal(library: Library) -> Iterator[str]:
    """Nominal motions that are not the integrals of a_free, starting from minus the speed at the surface."""
    grid, free, after = library.time_grid(), library.free_m_s2, library.free_after_m_s2
    if free.ndim > 3:  # the nominal motion is along the normal
        free, after = free[..., 0, :], after[..., 0, :]
    times, speed = grid.switching_times_s, library.speeds_m_s[:, None, None]
    velocity, position = library.nominal_velocity_m_s, library.nominal_position_m
    at_ticks, later = library.nominal_position_at_ticks_m, library.nominal_after_at_ticks_m
    lasting = np.concatenate([free[..., -1:], after], axis=-1)
    onward = _onward(grid, velocity[..., -1:], position[..., -1:], lasting)
    step, far = speed[..., 0] * grid.dt_s, _largest(position)
    off = {
        "nominal_velocity_m_s": _largest(velocity - _from_contact(times, free) + speed) - MOTION * _largest(velocity),
        "nominal_position_m": _largest(position - _from_contact(times, velocity)) - MOTION * far - step,
        "nominal_position_at_ticks_m": _largest(at_ticks + grid.delay_s * velocity - position) - MOTION * far - step,
        "nominal_after_at_ticks_m": _largest(later - onward) - MOTION * np.maximum(far, _largest(onward)) - step,
    }
    for iv, ig in np.ndindex(free.shape[:2]):
        for name, excess in off.items():
            if not excess[iv, ig] <= 0:
                yield f"{name} at {library.axes.place(iv, ig)} is not the motion of a_free"


def _largest(courses: FloatArray) -> FloatArray:
    """(...) largest magnitude along each course (..., K)."""
    return np.asarray(np.abs(courses).max(axis=-1, initial=0.0))


def _targets(library: Library) -> Iterator[str]:
    """Targets that differ from r - a_free plus the correction of a refined library."""
    for part, correction in (("before_", 0.0), ("", library.correction_m_s2), ("after_", 0.0)):
        target, recorded, free = (getattr(library, f"{of}_{part}m_s2") for of in ("target", "recorded", "free"))
        size = max(float(np.abs(course).max(initial=0.0)) for course in (target, recorded, free))
        off = np.abs(target - (recorded - free + correction)).max(axis=tuple(range(2, target.ndim)), initial=0.0)
        for iv, ig in np.argwhere(~(off <= SAME * size)):
            yield f"entry {library.axes.place(iv, ig)}: target_{part}m_s2 is not what was recorded less a_free"


def _heat_prices(library: Library) -> Iterator[str]:
    """Heat prices that differ from the scene's, and cool commands that are no cooler than the first ones."""
    stated, own = library.heat_price, library.posing().heat_price
    if not np.allclose(stated, own, rtol=SAME, atol=0):
        yield f"heat_price reaches {stated.max():.4g}, its scene says {own:.4g}"
    if library.cool is None:
        return
    if not np.all(library.cool.heat_price >= own * (1 - SAME)):
        yield f"cool_heat_price falls to {library.cool.heat_price.min():.4g}, below that of the first commands"
    if not np.all(library.cool.heat_A2_s <= library.heat_A2_s * (1 + COOLER)):
        yield "cool_heat_A2_s is above that of the first commands"


def _onward(grid: TimeGrid, velocity_m_s: FloatArray, position_m: FloatArray, rate_m_s2: FloatArray) -> FloatArray:
    """(..., M) position at the ticks after the window, from the state at tau_(N-1) and the acceleration (..., M + 1).

    Parameters
    ----------
    velocity_m_s, position_m : (..., 1).
    """
    velocity = velocity_m_s + integral(rate_m_s2, grid.dt_s)
    course = position_m + integral(velocity, grid.dt_s)
    return np.asarray((course - grid.delay_s * velocity)[..., 1:])


def _from_contact(times_s: FloatArray, rate: FloatArray) -> FloatArray:
    """(..., N) integral of a rate by the trapezoidal rule, zero at contact, which may precede the first instant."""
    course = np.zeros(rate.shape)
    np.cumsum(0.5 * np.diff(times_s) * (rate[..., 1:] + rate[..., :-1]), axis=-1, out=course[..., 1:])
    place = float(np.interp(0.0, times_s, np.arange(times_s.size)))
    first = course[..., int(place), None]
    next_one = course[..., min(int(place) + 1, times_s.size - 1), None]
    before = min(times_s[0], 0.0) - times_s[0]  # minus the first instant, if contact precedes it
    return np.asarray(course - first - (place - int(place)) * (next_one - first) - before * rate[..., :1])


def _different(name: str, stated: Any, own: Any) -> Iterator[str]:
    """Numbers and words of `stated` that differ from their counterparts in `own`, the scene's."""
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
