"""A surface that the host moves while the device is armed: no wall and no contact that the stylus did not make."""

from dataclasses import replace

import numpy as np
import pytest

from controller.protocol import messages as m
from controller.protocol.codes import REASONS, Reason
from controller.protocol.configuration import configuration_of
from controller.servo.interface import State
from tests.benches.device import IMAGE, REST, SETTINGS, Talker
from tests.controller.firmware.conftest import Start
from tests.controller.firmware.test_attacks import arm
from transopt.plant.wall import Wall


def over(start: Start, wall: Wall, ticks: int) -> Talker:
    """A device armed over a wall, so many ticks later."""
    walled = replace(SETTINGS, wall=wall)
    talker = Talker(start())
    talker.configured(configuration_of(walled)).loaded()
    talker.done(arm(walled, IMAGE))
    talker.step(ticks)
    return talker


def test_a_surface_that_moves_over_the_stylus_engages_no_wall(start: Start) -> None:
    """A host that lifts the surface of an armed device commands no current; the wall waits for free air again."""
    talker = over(start, Wall(4000.0, 20.0, 1.25, 2, 500.0), 200)
    talker.tell(talker.lease())
    for counts in (REST.encoder_counts + 80, REST.encoder_counts - 80, REST.encoder_counts + 400):
        talker.done(m.Surface(float(counts)))
        commands = [talker.step().command_A for _ in range(200)]
        talker.tell(talker.lease())
        if counts > REST.encoder_counts:
            assert not np.any(commands)
    # The stylus goes out by itself and comes back: then the wall pushes, as it has to.
    for counts in (*range(REST.encoder_counts, 640, 2), *range(640, 602, -2)):
        output = talker.step(1, REST._replace(encoder_counts=counts))
    assert not output.feedback_A
    pushed = [talker.step(1, REST._replace(encoder_counts=k)).feedback_A for k in range(602, 580, -2)]
    assert max(pushed) > 1.0


def test_a_surface_is_not_moved_under_a_wall_that_pushes(start: Start) -> None:
    """The wall of another surface would drop the hand that leans on this one."""
    talker = over(start, Wall(4000.0, 1.0, 1.25, 1, 500.0), 100)
    feedback_A = 0.0
    for counts in (*np.repeat(range(REST.encoder_counts, -20, -1), 10), *[-20] * 20):
        feedback_A = talker.step(1, REST._replace(encoder_counts=int(counts), current_A=feedback_A)).feedback_A
    answer = talker.ask(m.Surface(-20.0))
    assert isinstance(answer, m.Refused)
    assert REASONS[answer.reason] is Reason.WALL_PUSHES
    assert answer.value == pytest.approx(feedback_A, rel=0.01)
    assert talker.step(1, REST._replace(encoder_counts=-20, current_A=feedback_A)).feedback_A > 1.0
    for counts in np.repeat(range(-20, 5), 10):
        feedback_A = talker.step(1, REST._replace(encoder_counts=int(counts), current_A=feedback_A)).feedback_A
    talker.done(m.Surface(-20.0))


def test_a_surface_that_moves_plays_no_contact_that_the_stylus_did_not_make(start: Start) -> None:
    talker = Talker(start())
    talker.ready()
    talker.done(arm(SETTINGS, IMAGE))
    states = set()
    # It comes in at 0.1 m/s, far above the surface, which meets it.
    for tick in range(120):
        if tick == 60:
            talker.tell(m.Surface(REST.encoder_counts - 0.5 * tick + 3.0))
        states.add(talker.step(1, REST._replace(encoder_counts=REST.encoder_counts - tick // 2)).state)
    assert State.PLAYING not in states
