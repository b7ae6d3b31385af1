"""What a trial tap proves: encoder and accelerometer tell of one motion, and a tap ran to its end."""

import math
from dataclasses import replace

import pytest

from controller.protocol import messages as m
from controller.protocol.codes import Reason, Stage
from controller.protocol.image import image_of
from controller.servo.interface import Fault, Output, Readings, State
from controller.servo.settings import Settings
from tests.benches.compiled import DT_S, smooth_bank
from tests.benches.device import IMAGE, SETTINGS, Talker
from tests.controller.firmware.conftest import Start
from tests.controller.firmware.test_attacks import WATCHED, Plant, arm, evidence, pulsed, pulses
from transopt.plant.wall import Wall

BLIND = replace(WATCHED, has_accelerometer=False)  # a device without accelerometer


class Hand:
    """Moves the stylus up and down, farther each time, until it passes the surface; the motor moves nothing.

    The accelerometer reads the second derivative of the motion times `accelerometer`, the encoder the way from
    where the hand began times `encoder`.
    """

    def __init__(
        self, talker: Talker, *, encoder: float = 1.0, accelerometer: float = 1.0, monitor: float = 1.0
    ) -> None:
        self.talker, self.encoder, self.accelerometer, self.monitor = talker, encoder, accelerometer, monitor
        self.keep = math.exp(-2 * math.pi * 1050.0 * DT_S)
        self.true_A, self.tick, self.counts = 0.0, 0, 204
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
            self.counts = math.floor((5e-3 + self.encoder * (z - 5e-3)) / SETTINGS.count_m + 0.5)
            readings = Readings(0, self.counts, 3.0, self.monitor * self.true_A, self.accelerometer * bend)
            self.output = self.talker.step(1, readings)
            self.states.add(self.output.state)
            self.true_A = self.keep * self.true_A + (1 - self.keep) * self.output.command_A
            self.tick += 1

    def rest(self, ticks: int) -> None:
        """Back to where it began, a count per tick, and still."""
        for _ in range(ticks):
            self.counts += (self.counts < 204) - (self.counts > 204)
            self.talker.step(1, Readings(0, self.counts, 3.0, 0.0, 0.0))

    def step_down(self) -> None:
        """Straight down through the surface and on until the tap is over."""
        while State.PLAYING not in self.states or self.output.state is State.PLAYING:
            counts = 204 - self.tick // 2
            self.output = self.talker.step(1, Readings(0, counts, 3.0, self.true_A, 0.0))
            self.states.add(self.output.state)
            self.true_A = self.keep * self.true_A + (1 - self.keep) * self.output.command_A
            self.tick += 1
            assert self.tick < 1000


def tried(
    talker: Talker, hand: Hand, settings: Settings = WATCHED, image: bytes = IMAGE, **others: float
) -> m.EvidenceReply:
    """A trial, and the hand's motion until a tap has been played and is over."""
    talker.loaded(image)
    resting = Readings(0, math.floor(5e-3 / SETTINGS.count_m + 0.5), 3.0, 0.0, 0.0)
    talker.step(5000, resting)
    talker.heard()
    talker.done(arm(settings, image, **{"trial": 1, "gain": 0.1, **others}))
    assert evidence(talker).stage == Stage.TRIAL
    while State.PLAYING not in hand.states and hand.tick < 15_000:
        hand.step(1)
        if hand.tick % 500 == 0:
            talker.tell(talker.lease())
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
    found = pulsed(talker, Plant(talker), BLIND)
    assert found.bits == m.PULSE_SOUND
    assert math.isnan(found.acceleration_ratio)
    assert found.path_ratio == pytest.approx(1.0, abs=0.1)
    assert tried(talker, Hand(talker), BLIND).bits == m.PULSE_SOUND | m.TRIAL_FINISHED


@pytest.mark.parametrize("encoder", [0.3, 3.0, -1.0, 0.0])
def test_without_an_accelerometer_a_path_that_is_wrong_proves_nothing(single: Start, encoder: float) -> None:
    talker = Talker(single(simulated=False))
    assert pulsed(talker, Plant(talker, encoder=encoder), BLIND).bits == 0


@pytest.mark.parametrize(
    "wrong",
    [{"encoder": 1.4}, {"encoder": 0.6}, {"accelerometer": 2.0}, {"accelerometer": 0.6}, {"accelerometer": -1.0}],
    ids=str,
)
def test_sensors_that_disagree_prove_nothing(single: Start, wrong: dict[str, float]) -> None:
    talker = ready(single)
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


@pytest.mark.parametrize(("gain", "bits"), [(0.04, 0), (0.06, m.TRIAL_FINISHED)])
def test_a_trial_below_half_its_gain_proves_nothing_though_its_current_flows(
    single: Start, gain: float, bits: int
) -> None:
    """The most current of a strong library is measured even at a gain of 0.04."""
    talker = ready(single)
    assert tried(talker, Hand(talker), image=quiet_image(3.9), gain=gain).bits == m.PULSE_SOUND | bits


def test_a_second_trial_forgets_the_first_at_its_beginning(start: Start) -> None:
    talker = ready(start)
    hand = Hand(talker)
    tried(talker, hand)
    talker.tell(m.Disarm())
    hand.rest(1500)
    talker.heard()
    assert evidence(talker).bits == m.PULSE_SOUND | m.TRIAL_FINISHED
    talker.done(arm(WATCHED, IMAGE, trial=1, gain=0.1))
    found = evidence(talker)
    assert (found.bits, found.stage) == (m.PULSE_SOUND, Stage.TRIAL)
    assert math.isnan(found.speed_ratio)


def quiet_image(peak_A: float) -> bytes:
    return image_of(smooth_bank(peak_A=peak_A), DT_S, SETTINGS.lead_s, 10)


@pytest.mark.parametrize("peak_A", [1e-12, 1e-6, 1e-2])
def test_a_trial_of_silence_proves_nothing(single: Start, peak_A: float) -> None:
    """At a tenth of the gain 10 mA are 1 mA, of a hardware of 4.5 A."""
    talker, image = ready(single), quiet_image(peak_A)
    hand = Hand(talker)
    found = tried(talker, hand, image=image)
    assert (found.bits, found.stage) == (m.PULSE_SOUND, Stage.TRIED)
    talker.tell(m.Disarm())
    hand.rest(1500)
    talker.heard()
    assert talker.refused(arm(WATCHED, image)) is Reason.NO_TRIAL


@pytest.mark.parametrize("monitor", [0.0, 0.5, 2.0, -1.0])
def test_a_trial_whose_current_is_not_measured_proves_nothing(single: Start, monitor: float) -> None:
    talker = ready(single)
    assert tried(talker, Hand(talker, monitor=monitor)).bits == m.PULSE_SOUND


def test_a_trial_is_of_one_library(start: Start) -> None:
    """What a quiet library has proved does not arm a loud one; the way that the two sensors agree by is kept."""
    talker, loud = ready(start), quiet_image(2.0)
    hand = Hand(talker)
    assert tried(talker, hand).bits == m.PULSE_SOUND | m.TRIAL_FINISHED
    talker.tell(m.Disarm())
    hand.rest(1500)
    # The one in force, once more, is not another.
    assert evidence(talker.loaded(IMAGE)).bits == m.PULSE_SOUND | m.TRIAL_FINISHED
    assert evidence(talker.loaded(loud)).bits == m.PULSE_SOUND
    hand.rest(100)
    talker.heard()
    assert talker.refused(arm(WATCHED, loud)) is Reason.NO_TRIAL
    # Too soon after the motion for another comparison: it need not be made again.
    talker.done(arm(WATCHED, loud, trial=1, gain=0.1))
    down = Hand(talker)
    down.step_down()
    found = evidence(talker)
    assert found.bits == m.PULSE_SOUND | m.TRIAL_FINISHED


STILL = Readings(0, 204, 3.0, 0.0, 0.0)
OF_CABLES = {
    Fault.BAD_SENSOR: STILL._replace(current_A=math.nan),
    Fault.ENCODER_JUMP: STILL._replace(encoder_counts=704),
    Fault.OVER_CURRENT: STILL._replace(current_A=5.5),
    Fault.WRONG_CURRENT: STILL._replace(current_A=2.0),
}
OF_OTHERS = {
    Fault.EMERGENCY_STOP: STILL._replace(emergency_stop=True),
    Fault.LATE_TICK: STILL._replace(late=True),
    Fault.GRIP_OPEN: STILL._replace(grip_N=math.nan),
}


def checked(start: Start, settings: Settings = WATCHED) -> Talker:
    """A device at rest with all evidence."""
    talker = Talker(start(simulated=False))
    assert pulsed(talker, Plant(talker), settings).bits == m.PULSE_SOUND
    hand = Hand(talker)
    assert tried(talker, hand, settings).bits == m.PULSE_SOUND | m.TRIAL_FINISHED
    talker.tell(m.Disarm())
    hand.rest(1500)
    talker.heard()
    return talker


@pytest.mark.parametrize("fault", [*OF_CABLES, *OF_OTHERS], ids=lambda fault: fault.name)
def test_a_fault_at_a_cable_takes_the_evidence_and_the_check_brings_it_back(single: Start, fault: Fault) -> None:
    talker = checked(single)
    talker.step(30, {**OF_CABLES, **OF_OTHERS}[fault])
    assert talker.device.look().fault is fault
    talker.step(500, STILL)
    talker.heard()
    talker.done(m.Reset())
    talker.step(500, STILL)
    talker.heard()
    if fault in OF_OTHERS:
        talker.done(arm(WATCHED, IMAGE))
        return
    assert (evidence(talker).bits, evidence(talker).stage) == (0, Stage.NOTHING)
    assert talker.refused(arm(WATCHED, IMAGE)) is Reason.NO_PULSE
    # What the message says to do, without another configuration.
    assert pulses(talker, Plant(talker)).bits == m.PULSE_SOUND
    assert tried(talker, Hand(talker)).bits == m.PULSE_SOUND | m.TRIAL_FINISHED


def test_motor_leads_that_are_crossed_at_the_repair_are_not_armed(start: Start) -> None:
    talker = checked(start)
    talker.step(1, OF_CABLES[Fault.BAD_SENSOR])
    talker.step(500, STILL)
    talker.heard()
    talker.done(m.Reset())
    assert pulses(talker, Plant(talker, accelerometer=-1.0)).bits == 0
    assert talker.refused(arm(WATCHED, IMAGE, trial=1, gain=0.1)) is Reason.NO_PULSE


def test_one_open_channel_of_the_encoder_ends_the_push_of_a_wall_and_takes_the_evidence(start: Start) -> None:
    """In the wall its counts go back and forth between two while the hand draws the stylus out."""
    settings = replace(BLIND, wall=Wall(1000.0, 1.0, 1.25, 1, 500.0))
    talker = checked(start, settings)
    talker.done(arm(settings, IMAGE, lease_ms=1000))
    flows_A = 0.0
    for tick in range(14_000):
        if tick % 5000 == 0:
            talker.tell(talker.lease())
            talker.heard()
        counts = 204 - min(tick // 10, 284) + (tick % 2 if tick >= 3000 else 0)
        output = talker.step(1, Readings(0, counts, 3.0, flows_A, 0.0))
        flows_A = 0.517 * flows_A + 0.483 * output.command_A
        if output.state is State.FAULT:
            break
    assert tick - 3000 <= settings.ticks(settings.stuck_s) + 2
    assert talker.device.look().fault is Fault.ENCODER_STUCK
    assert evidence(talker).bits == 0


class Tremor(Hand):
    """A motion that grows up to 0.8 mm, over the last half second less than the sensors are compared by."""

    @staticmethod
    def height_m(time_s: float) -> float:
        return 5e-3 + 8e-4 * min(time_s / 1.2, 1.0) ** 2 * math.sin(2 * math.pi * 10 * time_s)


def test_a_motion_too_small_to_compare_the_sensors_is_no_agreement(start: Start) -> None:
    talker = ready(start)
    talker.done(m.Surface((5e-3 - 0.93 * 8e-4) / SETTINGS.count_m))
    found = tried(talker, Tremor(talker))
    assert (found.bits, found.stage) == (m.PULSE_SOUND, Stage.TRIED)
    assert math.isnan(found.speed_ratio)


@pytest.mark.parametrize(("scale", "bits"), [(5.0, 0), (1.0, m.TRIAL_FINISHED)])
def test_a_trial_is_as_large_as_its_current_is_in_the_hardwares_units(single: Start, scale: float, bits: int) -> None:
    """A host that states an amplifier of five times its gain makes 5 mA of 1 mA, of a hardware of 4.5 A."""
    settings = replace(WATCHED, amplifier_scale=scale, monitor_scale=scale)
    talker = Talker(single(simulated=False))
    plant = Plant(talker, amplifier=scale, monitor=1 / scale)
    assert pulsed(talker, plant, settings).bits == m.PULSE_SOUND
    assert tried(talker, Hand(talker), settings, quiet_image(0.05)).bits == m.PULSE_SOUND | bits
