"""Taps from rest close above the surface: how well the device foresees when they touch it.

    python -m pytest -m long -n 0 tests/campaigns/test_from_rest.py
        --campaign="[--taps 200] [--seed 1] [--quick]"

A stylus rests 1 to 5 mm above the surface in a hand that trembles (0.1 mm at 8 Hz, four counts of the usual encoder),
and is pushed down with 5 to 30 m/s^2: by a constant force, along a minimum-jerk course that ends 20 mm below the
surface, or by a half sine of 20 ms. The encoder rounds down, at a phase of its own in every tap. The courses are made
here, by closed formulas, and have nothing to do with the simulator. What is compared is the instant of contact that
the fit foresees (`tests.benches.oracle.approach`) in the tick that holds the first command, with the course's own;
the trigger says whether the tap would have been played. Beside them stand steady approaches.

Prints one table. It fails if taps from rest, all courses together, miss by more than 25 us rms, or if one would
not be played.
"""

from collections.abc import Callable
from typing import Annotated

import numpy as np
import typer

from controller.servo.settings import Settings
from tests.benches.oracle.approach import Approach, Touch, Trigger
from tests.campaigns.harness import Seed, at_least, long_form, show
from transopt.base.signals import FloatArray

LIMIT_US = 25.0
LEAD_S = 3e-4
TREMOR_M, TREMOR_HZ = 98e-6, 8.0
HEIGHTS_M, PUSHES_M_S2 = (1e-3, 5e-3), (5.0, 30.0)
DEPTH_M = 20e-3  # below the surface, where a minimum-jerk course ends
PUSH_S = 20e-3  # of a half sine
RESTING_S, AFTER_S = 0.2, 0.1
MOST_MINIMUM_JERK = 10 / np.sqrt(3)  # peak acceleration of the course by distance / duration^2

Course = Callable[[FloatArray], FloatArray]


def constant(push_m_s2: float, height_m: float) -> Course:
    """Distance gone [m] after so long [s], under a constant force."""
    return lambda t: push_m_s2 * t**2 / 2


def minimum_jerk(push_m_s2: float, height_m: float) -> Course:
    """10 x^3 - 15 x^4 + 6 x^5 of the distance (Flash and Hogan 1985), with the push as peak acceleration."""
    distance_m = height_m + DEPTH_M
    duration_s = np.sqrt(MOST_MINIMUM_JERK * distance_m / push_m_s2)

    def gone(t: FloatArray) -> FloatArray:
        x = np.minimum(t / duration_s, 1)
        return distance_m * (10 * x**3 - 15 * x**4 + 6 * x**5)

    return gone


def half_sine(push_m_s2: float, height_m: float) -> Course:
    """One half sine of acceleration, and on with the speed that it gives."""
    w = np.pi / PUSH_S

    def gone(t: FloatArray) -> FloatArray:
        within = np.minimum(t, PUSH_S)
        return push_m_s2 / w * (within - np.sin(w * within) / w) + 2 * push_m_s2 / w * (t - within)

    return gone


COURSES: dict[str, Callable[[float, float], Course]] = {
    "constant force": constant,
    "minimum jerk": minimum_jerk,
    "half sine": half_sine,
}


def crossing_s(z: Course, begin_s: float, end_s: float) -> float:
    """First instant at which a position is zero, by bisection of the first step that holds it."""
    fine = np.linspace(begin_s, end_s, 2001)
    first = int(np.argmax(z(fine) <= 0))
    low, high = float(fine[first - 1]), float(fine[first])
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if z(np.array([middle]))[0] <= 0 else (middle, high)
    return low


def foreseen(z: Course, settings: Settings, end_s: float, phase_counts: float) -> float | None:
    """Instant of contact [s] that the device has in mind when c_0 is due; None if it would not play.

    Parameters
    ----------
    z : position over time [m]. phase_counts : part of a count by which the encoder is late in counting.
    """
    s = settings
    fit = Approach(
        s.dt_s,
        s.lead_s,
        count_m=s.count_m,
        surface_counts=phase_counts - 0.5,  # of an encoder that rounds down
        window_ticks=s.window_ticks,
        least_speed_m_s=s.least_speed_m_s,
    )
    trigger = Trigger(s.count_m, s.touch_height_m, s.rearm_height_m, s.ticks(s.rearm_s))
    times_s = np.arange(0.0, end_s, s.dt_s)
    counts = np.floor(z(times_s) / s.count_m + phase_counts).astype(int)
    for time_s, count in zip(times_s.tolist(), counts.tolist(), strict=True):
        fit.step(count)
        touch = trigger.step((count - (phase_counts - 0.5)) * s.count_m, fit.speed_m_s, fit.phase)
        if touch is Touch.CONTACT:
            return time_s - fit.phase * s.dt_s + s.lead_s
        if touch is Touch.CHATTER:
            return None
    return None


def pushed(name: str, random: np.random.Generator, dt_s: float) -> tuple[Course, float]:
    """Position over time [m] of one tap from rest, and when its push begins [s]."""
    height_m, push_m_s2 = random.uniform(*HEIGHTS_M), random.uniform(*PUSHES_M_S2)
    begin_s, turn = RESTING_S + random.uniform(0, dt_s), random.uniform(0, 2 * np.pi)
    gone = COURSES[name](push_m_s2, height_m)

    def z(t: FloatArray) -> FloatArray:
        tremor = TREMOR_M * np.sin(2 * np.pi * TREMOR_HZ * t + turn)
        return np.asarray(height_m + tremor - gone(np.maximum(t - begin_s, 0)))

    return z, begin_s


def steady(speed_m_s: float, random: np.random.Generator, dt_s: float) -> tuple[Course, float]:
    """Draw a course at one speed, under 2 m/s^2 to either side, that began long before, and give its contact [s]."""
    contact_s, hand_m_s2 = 0.05 + random.uniform(0, dt_s), 2.0 * random.choice([-1, 1])

    def z(t: FloatArray) -> FloatArray:
        return np.asarray(-speed_m_s * (t - contact_s) + hand_m_s2 * (t - contact_s) ** 2 / 2)

    return z, contact_s


def of_rest(name: str, settings: Settings, taps: int, random: np.random.Generator) -> tuple[FloatArray, int]:
    """Errors of the contact's instant [s] of the taps that play, and how many do not."""
    errors, unplayed = [], 0
    for _ in range(taps):
        z, begin_s = pushed(name, random, settings.dt_s)
        found = foreseen(z, settings, begin_s + AFTER_S, random.uniform())
        if found is None:
            unplayed += 1
        else:
            errors.append(found - crossing_s(z, begin_s, begin_s + AFTER_S))
    return np.array(errors), unplayed


def of_steady(speed_m_s: float, settings: Settings, taps: int, random: np.random.Generator) -> tuple[FloatArray, int]:
    """Give the errors of the contact's instant [s] of the steady taps that play, and how many do not."""
    errors, unplayed = [], 0
    for _ in range(taps):
        z, contact_s = steady(speed_m_s, random, settings.dt_s)
        found = foreseen(z, settings, contact_s + 0.01, random.uniform())
        if found is None:
            unplayed += 1
        else:
            errors.append(found - contact_s)
    return np.array(errors), unplayed


def rms_us(errors_s: FloatArray) -> float:
    return 1e6 * float(np.sqrt(np.mean(errors_s**2))) if errors_s.size else float("inf")


def main(
    taps: Annotated[int, at_least(1, "of each row")] = 200,
    seed: Seed = 1,
    quick: Annotated[bool, typer.Option("--quick", help="20 of each row")] = False,
) -> int:
    taps = 20 if quick else taps
    rows: list[tuple[object, ...]] = []
    failed = False
    for count_m in (24.5e-6, 10e-6):
        settings = Settings(1e-4, LEAD_S, 4.0, count_m=count_m)

        def row(name: str, errors_s: FloatArray, unplayed: int, um: str = f"{1e6 * count_m:g}") -> None:
            worst_us = 1e6 * float(np.abs(errors_s).max(initial=0.0))
            rows.append((name, um, f"{rms_us(errors_s):.1f}", f"{worst_us:.0f}", unplayed))

        found = {name: of_rest(name, settings, taps, np.random.default_rng(seed)) for name in COURSES}
        for name, (errors_s, unplayed) in found.items():
            row(name, errors_s, unplayed)
        every, left = np.concatenate([errors_s for errors_s, _ in found.values()]), sum(n for _, n in found.values())
        row("all from rest", every, left)
        failed |= left > 0 or not rms_us(every) <= LIMIT_US
        for speed in (0.05, 0.1, 0.2, 0.4, 1.0):
            row(f"steady {speed:g} m/s", *of_steady(speed, settings, taps, np.random.default_rng(seed)))
    show(("motion, instant of contact foreseen", "encoder um", "rms us", "worst us", "not played"), rows)
    return 1 if failed else 0


test_long_form = long_form(main)
