"""The speeds that taps were meant to have, found among speeds that scatter as a hand's do."""

import numpy as np
import pytest

from transopt.recordings.speed_groups import speed_groups

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
