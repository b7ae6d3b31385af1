"""What encoder and accelerometer say of each other, by itself; `test_faults` has it in a servo."""

import pytest

from controller.servo.rules import FOLLOW_STILL_S
from controller.servo.settings import Settings
from tests.benches.oracle.crosscheck import Crosscheck


def test_a_path_without_a_count_grows_until_the_stylus_counts_as_at_rest(stated: Settings) -> None:
    check, ticks, acceleration = Crosscheck(stated), stated.ticks(FOLLOW_STILL_S), 5.0
    for k in range(1, ticks):
        check.step(0, acceleration, 0.0, playing=False)
        assert check.path_m == pytest.approx(acceleration * stated.dt_s**2 * k * (k + 1) / 2)
    check.step(0, acceleration, 0.0, playing=False)
    assert check.path_m == pytest.approx(0.0, abs=1e-15)
