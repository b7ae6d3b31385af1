"""The speed fitted to the position before contact, and the speeds that taps were meant to have."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray, Signal
from transopt.recordings.recording import Recording
from transopt.recordings.speed import UNKNOWN, contradiction, incoming_speed, two_sided
from transopt.recordings.speed_groups import speed_groups

RATE_HZ = 10e3
COUNT_M = 24.5e-6


def counted(z: FloatArray) -> FloatArray:
    return np.asarray(np.round(z / COUNT_M) * COUNT_M)


def approach(lead_s: float, *, speed_m_s: float = 0.2, count: bool = True, scatter_m: float = 0.0) -> Recording:
    """A hand that brakes with 2 m/s^2 and touches `lead_s` after the recording begins, at t = 0."""
    t = np.arange(-lead_s, 0.02, 1 / RATE_HZ)
    z = -speed_m_s * t + t**2
    z = counted(z) if count else z + scatter_m * np.random.default_rng(2).standard_normal(t.size)
    x = Signal(-lead_s, 1 / RATE_HZ, z)
    return Recording(name="tap", source="", sha256="", acceleration=x, position=x)


def test_a_full_lead_says_nothing() -> None:
    speed, source, notes = incoming_speed(approach(0.02), 0.0)
    assert speed == pytest.approx(0.2, rel=0.02)
    assert (source, notes) == ("position", [])


def test_without_scatter_a_short_lead_is_enough() -> None:
    speed, _, notes = incoming_speed(approach(1e-3, count=False), 0.0)
    assert speed == pytest.approx(0.2, rel=1e-6)
    assert notes == []


def test_a_short_lead_is_said_and_one_too_short_is_refused() -> None:
    speed, _, notes = incoming_speed(approach(2.5e-3), 0.0)
    assert speed == pytest.approx(0.2, rel=0.2)
    assert "the position of the 2.5 ms before contact: 0.198 +- 0.0" in notes[0]
    assert "record 10 ms before contact" in notes[0]
    with pytest.raises(InputError, match=r"tap: speed fitted to the position of the 1.2 ms .* limit \+- 20 %"):
        incoming_speed(approach(1.2e-3), 0.0)
    with pytest.raises(InputError, match=r"position_m has 6 samples in the 10 ms before contact, 8 needed"):
        incoming_speed(approach(0.5e-3), 0.0)


def test_the_interval_holds_the_speed() -> None:
    """In 95 of 100 takes, with the scatter that the residuals show."""
    held = 0
    for seed in range(200):
        t = np.arange(-0.004, 0.0, 1 / RATE_HZ)
        z = -0.2 * t + 6e-6 * np.random.default_rng(seed).standard_normal(t.size)
        x = Signal(-0.004, 1 / RATE_HZ, z)
        speed, _, notes = incoming_speed(Recording(name="t", source="", sha256="", acceleration=x, position=x), 0.0)
        half = float(notes[0].partition("+- ")[2].partition(" ")[0]) if notes else 0.05 * speed
        held += abs(speed - 0.2) <= half
    assert held >= 180


def test_a_stated_speed_that_the_position_contradicts_is_said() -> None:
    taken = approach(0.02)
    assert not contradiction(taken, 0.0)
    assert not contradiction(replace(taken, speed_m_s=0.21), 0.0)
    assert not contradiction(replace(taken, speed_m_s=0.3, position=None), 0.0)
    assert not contradiction(replace(approach(1.2e-3), speed_m_s=0.3), 0.0)  # too short to tell
    said = contradiction(replace(taken, speed_m_s=0.3), 0.0)
    assert "the position before contact has 0.2" in said
    assert "stated are 0.3 m/s" in said


def test_nobody_knows() -> None:
    x = Signal(0.0, 1e-4, np.ones(100))
    speed, source, _ = incoming_speed(Recording(name="tap", source="", sha256="", acceleration=x), 0.0)
    assert np.isnan(speed)
    assert source == UNKNOWN


@pytest.mark.parametrize("free", [1, 2, 3, 4, 5, 97, 500, 2001, 2188])
def test_the_quantile_is_that_of_students_distribution(free: int) -> None:
    # SciPy's own quantile has fewer digits before version 1.17, so the probability beyond ours is judged.
    assert scipy.special.stdtr(free, -two_sided(free)) == pytest.approx(0.025, rel=1e-10)


# Fitted speeds of 18 taps at 0.1, 0.2 and 0.3 m/s with a scatter of 5 %: within 0.2 m/s they differ by 24 %.
OF_A_HAND = [
    *(0.0968, 0.1009, 0.0939, 0.0992, 0.0975, 0.0993),
    *(0.2144, 0.2029, 0.1807, 0.2067, 0.2251, 0.204),
    *(0.2935, 0.3154, 0.3247, 0.2968, 0.3038, 0.2822),
]
TOLERANCE = 0.15


def sizes(speeds: list[float], tolerance: float = TOLERANCE) -> list[int]:
    return [len(group) for group in speed_groups(speeds, tolerance)]


def test_a_hands_scatter_makes_no_speeds_of_its_own() -> None:
    assert sizes(OF_A_HAND) == [6, 6, 6]
    assert sizes(OF_A_HAND[::-1]) == [6, 6, 6]


def test_speeds_close_to_each_other_are_told_apart_by_steady_repeats() -> None:
    assert sizes([0.1, 0.101, 0.102, 0.115, 0.116, 0.117]) == [3, 3]
    assert sizes([0.1, 0.108, 0.104, 0.113, 0.117, 0.121]) == [6]
    assert sizes([0.1, 0.12, 0.14]) == [1, 1, 1]


@pytest.mark.parametrize("nominal", [(0.1, 0.2, 0.3), (0.1, 0.15, 0.2, 0.3), (0.2,)])
def test_most_sets_with_five_percent_of_scatter_are_grouped_as_meant(nominal: tuple[float, ...]) -> None:
    random, right = np.random.default_rng(3), 0
    for _ in range(100):
        speeds = [v * (1 + 0.05 * random.standard_normal()) for v in nominal for _ in range(6)]
        right += sizes(speeds) == [6] * len(nominal)
    assert right >= 85  # 92 to 96 of 100


@pytest.mark.parametrize("seed", range(20))
def test_every_tap_is_within_the_tolerance_of_its_speed(seed: int) -> None:
    speeds = np.random.default_rng(seed).uniform(0.05, 0.5, 40).tolist()
    groups = speed_groups(speeds, TOLERANCE)
    assert sorted(speeds) == [speed for group in groups for speed in group]
    assert all(abs(np.mean(group) / speed - 1) <= TOLERANCE + 1e-9 for group in groups for speed in group)


def test_no_tap_one_tap_and_equal_taps() -> None:
    assert speed_groups([], TOLERANCE) == []
    assert sizes([0.2]) == [1]
    assert sizes([0.2] * 9, tolerance=0.0) == [9]
    assert sizes([0.2, 0.21], tolerance=0.0) == [1, 1]
