"""Errors of recorded taps relative to the real ones: noise, spread of the repeats, and the estimated onset."""

from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

import problems
from controller.sim.true_device import device_of
from played.figures import Told, as_recorded, told
from played.motion import Hand, Tap, Taps
from transopt.base.signals import FloatArray
from transopt.base.writing import table
from transopt.scene import strikes
from transopt.scene.keys import with_values
from transopt.scene.recordings import references_of
from transopt.scene.scene import Scene

MOST_LATE_S = 3e-4  # largest shift of the contact that is searched around the estimated onset
SCENES = ("hard_metal", "soft_rubber", "free_stylus")  # scenes whose recordings have the largest errors
KINDS: dict[str, dict[str, Any]] = {
    "as they are": {},
    "without noise": {"recordings.simulated.noise_g_rtHz": 0.0},
    "and one tap, at the node's speed": {
        "recordings.simulated.noise_g_rtHz": 0.0,
        "recordings.simulated.speed_spread": 0.0,
        "recordings.simulated.repeats": 1,
    },
}


def missed() -> list[str]:
    """Table of kinds of recordings: errors relative to the real tap, as they are and shifted to the true onset."""
    rows = []
    for name in SCENES:
        scene = problems.load(name)
        times, real = real_taps(scene)
        for words, values in KINDS.items():
            made = with_values(scene, values)
            references = references_of(made, strikes.recordings(made))
            found = [
                placed(times, course, references.at(*cell).target.recorded_m_s2, scene.hand.intention_s)
                for cell, course in real.items()
            ]
            late_us = [1e6 * late_s for _, late_s, _ in found]
            row = [name, words, *largest([whole for whole, *_ in found])]
            rows.append([*row, f"{min(late_us):+.0f} to {max(late_us):+.0f}", *largest([left for *_, left in found])])
            print(*rows[-1], sep="  ", flush=True)
    head = ("scene", "recordings", "tap %", "felt %", "contact late by us", "tap %, contact in place", "felt %")
    return table(head, rows)


def largest(figures: list[Told]) -> list[str]:
    """The largest tap and felt error of some taps."""
    return [f"{100 * max(getattr(one, figure) for one in figures):.2f}" for figure in ("tap", "felt")]


def real_taps(scene: Scene) -> tuple[FloatArray, dict[tuple[float, float], FloatArray]]:
    """(K,) instants, and by speed and grip what a recording without noise has there (K,) [m/s^2]."""
    target, grid = scene.recordings.simulated, scene.time_grid()
    assert target is not None
    times = np.concatenate([grid.before_times_s, grid.switching_times_s, grid.after_times_s])
    cells = [(speed, grip) for grip in strikes.grips_of(scene) for speed in scene.grid.speeds_m_s]
    taps = [Tap(*cell, Hand(scene.hand.yields)) for cell in cells]
    struck = Taps(device_of(scene), target, taps, scene.hand.intention_s).courses(times, times[-1:])
    return times, {
        cell: as_recorded(course, 1 / grid.dt_s) for cell, course in zip(cells, struck.acceleration_m_s2, strict=True)
    }


def placed(times: FloatArray, real: FloatArray, recorded: FloatArray, intention_s: float) -> tuple[Told, float, Told]:
    """A recorded tap's figures, by how much its contact is late [s], and the figures with contact in its place."""
    course = CubicSpline(times, real)

    def beside(late_s: float) -> Told:
        return told(times, course(np.clip(times + late_s, times[0], times[-1])), recorded, 0.0, intention_s)

    best = minimize_scalar(lambda late_s: beside(late_s).tap, bounds=(-MOST_LATE_S, MOST_LATE_S), method="bounded")
    return beside(0.0), float(best.x), beside(float(best.x))
