"""What a trial tap proves: encoder and accelerometer tell of one motion, and a tap ran to its end."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from controller.firmware.core_device import CoreDevice
from controller.protocol import messages as m
from controller.protocol.codes import Stage
from controller.protocol.configuration import configuration_of
from controller.servo.interface import Output, Readings, State
from controller.servo.settings import Settings
from tests.benches.compiled import DT_S
from tests.benches.device import IMAGE, SETTINGS, Talker
from tests.controller.firmware.test_attacks import HARDWARE, PULSE_TICKS, WATCHED, Plant, arm, evidence, pulsed

pytestmark = pytest.mark.usefixtures("c_compiler")

BLIND = replace(WATCHED, has_accelerometer=False)  # a device without accelerometer
Start = Callable[..., CoreDevice]


@pytest.fixture(params=[(), ("-DTD_REAL_FLOAT",)], ids=["double", "single"])
def start(request: pytest.FixtureRequest) -> Start:
    def started(**others: Any) -> CoreDevice:
        return CoreDevice(9, HARDWARE, request.param, **others)

    return started


class Hand:
    """Moves the stylus up and down, farther each time, until it passes the surface; the motor moves nothing.

    The accelerometer reads the second derivative of the motion times `accelerometer`, the encoder the way from
    where the hand began times `encoder`.
    """

    def __init__(self, talker: Talker, *, encoder: float = 1.0, accelerometer: float = 1.0) -> None:
        self.talker, self.encoder, self.accelerometer = talker, encoder, accelerometer
        self.keep = math.exp(-2 * math.pi * 1050.0 * DT_S)
        self.true_A, self.tick = 0.0, 0
        self.output = Output(0.0, State.IDLE, 0.0, 0.0, math.nan)
        self.states = {State.IDLE}

    @staticmethod
    def height_m(time_s: float) -> float:
        return 5e-3 + 8e-3 * time_s**2 * math.sin(2 * math.pi * 5 * time_s)

    def step(self, ticks: int) -> None:
        for _ in range(ticks):
            time_s = DT_S * self.tick
            z, before, after = (self.height_m(time_s + d) for d in (0.0, -DT_S, DT_S))
            bend = (before - 2 * z + after) / DT_S**2 if self.tick else 0.0
            counts = math.floor((5e-3 + self.encoder * (z - 5e-3)) / SETTINGS.count_m + 0.5)
            readings = Readings(0, counts, 3.0, self.true_A, self.accelerometer * bend)
            self.output = self.talker.step(1, readings)
            self.states.add(self.output.state)
            self.true_A = self.keep * self.true_A + (1 - self.keep) * self.output.command_A
            self.tick += 1


def tried(talker: Talker, hand: Hand, settings: Settings = WATCHED, **others: float) -> m.EvidenceReply:
    """A trial, and the hand's motion until a tap has been played and is over."""
    talker.loaded(IMAGE)
    resting = Readings(0, math.floor(5e-3 / SETTINGS.count_m + 0.5), 3.0, 0.0, 0.0)
    talker.step(5000, resting)
    talker.heard()
    talker.done(arm(settings, IMAGE, **{"trial": 1, "gain": 0.1, **others}))
    assert evidence(talker).stage == Stage.TRIAL
    while State.PLAYING not in hand.states and hand.tick < 15_000:
        hand.step(1)
        if hand.tick % 500 == 0:
            talker.tell(m.Lease(0))
            talker.heard()
    while hand.output.state is State.PLAYING:
        hand.step(1)
    assert State.PLAYING in hand.states
    talker.heard()
    return evidence(talker)


def ready(start: Start) -> Talker:
    talker = Talker(start(simulated=False))
    assert pulsed(talker, Plant(talker)).bits == m.PULSE_SOUND
    return talker


def test_a_tap_to_its_end_with_sensors_that_agree_is_the_proof_that_arms(start: Start) -> None:
    talker = ready(start)
    hand = Hand(talker)
    found = tried(talker, hand)
    assert (found.bits, found.stage) == (m.PULSE_SOUND | m.TRIAL_FINISHED, Stage.TRIED)
    assert found.speed_ratio == pytest.approx(1.0, abs=0.1)


def test_without_an_accelerometer_the_path_is_the_proof_of_the_pulse_and_the_end_that_of_the_trial(
    start: Start,
) -> None:
    talker = Talker(start(simulated=False))
    plant = Plant(talker)
    talker.configured(configuration_of(BLIND))
    plant.step(200)
    talker.done(m.Pulse(BLIND.pulse_A, PULSE_TICKS, 3))
    plant.step(6 * (1000 + PULSE_TICKS + 20))
    talker.heard()
    found = evidence(talker)
    assert found.bits == m.PULSE_SOUND
    assert math.isnan(found.acceleration_ratio)
    assert found.path_ratio == pytest.approx(1.0, abs=0.1)
    assert tried(talker, Hand(talker), BLIND).bits == m.PULSE_SOUND | m.TRIAL_FINISHED


@pytest.mark.parametrize("encoder", [0.3, 3.0, -1.0, 0.0])
def test_without_an_accelerometer_a_path_that_is_wrong_proves_nothing(start: Start, encoder: float) -> None:
    talker = Talker(start(simulated=False))
    plant = Plant(talker, encoder=encoder)
    talker.configured(configuration_of(BLIND))
    plant.step(200)
    talker.done(m.Pulse(BLIND.pulse_A, PULSE_TICKS, 3))
    plant.step(6 * (1000 + PULSE_TICKS + 20))
    talker.heard()
    assert evidence(talker).bits == 0


@pytest.mark.parametrize(
    "wrong",
    [{"encoder": 1.4}, {"encoder": 0.6}, {"accelerometer": 2.0}, {"accelerometer": 0.6}, {"accelerometer": -1.0}],
    ids=str,
)
def test_sensors_that_disagree_prove_nothing(start: Start, wrong: dict[str, float]) -> None:
    talker = ready(start)
    found = tried(talker, Hand(talker, **wrong))
    assert (found.bits, found.stage) == (m.PULSE_SOUND, Stage.TRIED)
    ((name, k),) = wrong.items()
    expected = k if name == "encoder" else 1 / k
    # An encoder that reads too much tells of a contact before there was a motion to compare.
    if expected > 0 and not (expected > 1 and name == "encoder" and math.isnan(found.speed_ratio)):
        assert found.speed_ratio == pytest.approx(expected, rel=0.15)


def test_a_dead_accelerometer_is_no_agreement(start: Start) -> None:
    talker = ready(start)
    found = tried(talker, Hand(talker, accelerometer=0.0))
    assert found.bits == m.PULSE_SOUND
    assert math.isnan(found.speed_ratio)


def test_a_trial_too_quiet_to_be_felt_proves_nothing(start: Start) -> None:
    talker = ready(start)
    assert tried(talker, Hand(talker), gain=0.01).bits == m.PULSE_SOUND


def test_a_second_trial_forgets_the_first_at_its_beginning(start: Start) -> None:
    talker = ready(start)
    tried(talker, Hand(talker))
    talker.tell(m.Disarm())
    talker.step(500, Readings(0, 200, 3.0, 0.0, 0.0))  # an encoder that jumps is a fault
    talker.tell(m.Reset())
    talker.step(500, Readings(0, 200, 3.0, 0.0, 0.0))
    talker.heard()
    assert evidence(talker).bits == m.PULSE_SOUND | m.TRIAL_FINISHED
    talker.done(arm(WATCHED, IMAGE, trial=1, gain=0.1))
    found = evidence(talker)
    assert (found.bits, found.stage) == (m.PULSE_SOUND, Stage.TRIAL)
    assert math.isnan(found.speed_ratio)
