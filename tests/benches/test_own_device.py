"""The device of the check's trials against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from controller.servo.interface import Output, State
from tests.benches.own_device import HAND, OwnWorld, Sensing, Truth

DT_S, BEFORE = 1e-4, 20


def answer(delay_s: float) -> list[float]:
    """Readings of the current [A] about a step of 1 A; the loop of the motor's voltage is fast, and has one pole."""
    truth = replace(Truth(), delay_s=delay_s, bearing_N_s_m=0.0)
    world = OwnWorld(DT_S, truth=truth, sensing=Sensing(current_noise_A=0.0), tremor=0.0)
    seen = []
    for tick in range(2 * BEFORE):
        seen.append(world.readings(tick).current_A)
        world.advance(Output(1.0 if tick >= BEFORE else 0.0, State.IDLE, 0.0, 0.0, 25.0))
    return seen


@pytest.mark.parametrize("delay_s", [0.0, 70e-6, 1e-4, 1.7e-4, 4e-4, 1.235e-3])
def test_the_current_comes_by_the_delay_late_however_long_it_is(delay_s: float) -> None:
    since_s = np.maximum((np.arange(2 * BEFORE) - BEFORE) * DT_S - delay_s, 0.0)
    wanted = 1 - np.exp(-2 * np.pi * Truth().pole_Hz * since_s)
    # What the stylus's motion induces is below this.
    np.testing.assert_allclose(answer(delay_s), wanted, rtol=0, atol=5e-3)


def test_the_hand_is_where_it_means_to_be_after_every_period() -> None:
    world = OwnWorld(DT_S)
    world.asked("move")
    begin_m = world.hand_m(0.0)
    for _ in range(2000):
        world.advance(Output(0.0, State.IDLE, 0.0, 0.0, 25.0))
        assert world._x[HAND] == pytest.approx(world.hand_m(world.now_s), abs=1e-12)
    assert world.hand_m(world.now_s) - begin_m > 1e-3
