"""Taps whose hand did not come in steadily: the simulator's truth, and what is said of them in place of figures."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from controller.device.device_file import Accelerometer
from controller.protocol.events import Happened, Samples
from controller.protocol.messages import Record
from controller.record import played
from controller.record.played import encoder_ratio, played_tap, why_not_steady
from controller.record.recorder import Contact, Recorder
from controller.refine.heard import hear, node_near
from controller.refine.new_hand import record_of
from controller.servo.interface import Output, Readings
from controller.servo.settings import Settings
from controller.sim.played_tap import run
from controller.sim.sensors import SEED_SENSORS
from controller.sim.simulator import Simulator
from controller.sim.true_device import DEFAULT_DEVICE, TrueDevice
from controller.sim.user import User
from controller.waveforms.prediction import predict
from tests.benches.compiled import servo_of
from transopt.library.library import Library

pytestmark = pytest.mark.usefixtures("c_compiler")
SPEED_M_S, CONTACT_S, END_S = 0.2, 0.12, 0.55
ACCELEROMETER = Accelerometer(bandwidth_Hz=SEED_SENSORS.accelerometer_bandwidth_Hz)


@dataclass(frozen=True)
class Mover(User):
    """A hand whose speed goes straight from one of these speeds to the next; its first contact is at `CONTACT_S`."""

    times_s: tuple[float, ...]
    speeds_m_s: tuple[float, ...]

    @cached_property
    def _path(self) -> CubicHermiteSpline:
        """Exact, as a speed that goes straight is a parabola of the way."""
        times, speeds = np.array(self.times_s), np.array(self.speeds_m_s)
        way = np.concatenate([[0.0], np.cumsum(np.diff(times) * (speeds[1:] + speeds[:-1]) / 2)])
        path = CubicHermiteSpline(times, way, speeds)
        return CubicHermiteSpline(times, way - path(CONTACT_S), speeds)

    def intention_m(self, time_s: float) -> float:
        return float(self._path(time_s))

    def grip_N(self, time_s: float) -> float:
        return 3.0


def back_at(leaves_s: float, turns_s: float, height_s: float = 0.1) -> Mover:
    """A tap, and a second one of a hand that has turned round `turns_s` long, at 0.1 m/s out before."""
    times = np.cumsum([CONTACT_S + 0.03, leaves_s, height_s, turns_s])
    return Mover((0.0, *times, 1.0), (-SPEED_M_S, -SPEED_M_S, 0.1, 0.1, -SPEED_M_S, -SPEED_M_S))


class Misread(Simulator):
    """A device whose encoder counts so many times what it should."""

    times = 1.0

    def readings(self) -> Readings:
        r = super().readings()
        return r._replace(encoder_counts=round(self.times * r.encoder_counts))


def last_contact(library: Library, user: User, device: TrueDevice = DEFAULT_DEVICE, encoder: float = 1.0) -> Contact:
    """The last contact that the device tells of, as it is recorded."""
    servo, recorder = servo_of(library), Recorder(None, 1e-4, SEED_SENSORS.count_m)
    servo.arm()

    def observe(r: Readings, o: Output) -> None:
        for event in o.events:
            recorder.take(Happened(0, event.tick, event.what, event.speed_m_s, event.grip_N, 0))
        record = Record(
            int(r.encoder_counts),
            r.grip_N,
            r.current_A,
            r.acceleration_m_s2,
            o.command_A,
            o.transient_A,
            o.feedback_A,
            o.winding_C,
            0,
            0,
        )
        recorder.take(Samples(r.tick, 1, (record,), 0))

    plant = Misread(device, user, 1e-4)
    plant.times = encoder
    run(plant, servo, round(END_S / 1e-4), observe)
    return recorder.contacts[-1]


STEADY = Mover((0.0, 1.0), (-SPEED_M_S, -SPEED_M_S))
PLAYED: dict[str, tuple[Mover, bool]] = {
    "steady": (STEADY, True),
    "faster and faster by 2 m/s^2": (Mover((0.0, 0.15, 1.0), (0.04, -0.26, -0.26)), True),
    "again, after a way of its own": (
        Mover((0.0, 0.15, 0.17, 0.27, 0.29, 1.0), (-0.2, -0.2, 0.3, 0.3, -0.2, -0.2)),
        True,
    ),
    "turned round 60 ms before": (Mover((0.0, 0.04, 0.06, 1.0), (0.1, 0.1, -0.2, -0.2)), True),
    "slowed down 30 ms before": (Mover((0.0, 0.07, 0.09, 0.11, 1.0), (-0.2, -0.2, -0.02, -0.2, -0.2)), False),
    "turned round just now": (back_at(0.02, 0.05), False),
    "turned round fast": (back_at(0.02, 0.02), False),
    "begun from rest": (Mover((0.0, 0.07, CONTACT_S, 1.0), (0.0, 0.0, -0.2, -0.2)), False),
}


@pytest.mark.parametrize(("user", "straight"), PLAYED.values(), ids=PLAYED)
def test_a_rebound_has_a_reason_in_place_of_figures(
    library: Library, stated: Settings, user: Mover, straight: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    contact = last_contact(library, user)
    node = node_near(library, SPEED_M_S, 3.0)
    assert node is not None
    tap = played_tap(contact, library, stated, 1.0, ACCELEROMETER)
    others = (
        hear(contact, library, stated, node, ACCELEROMETER),
        record_of(contact, library, stated, ACCELEROMETER),
    )
    if straight:
        assert not tap.why
        assert tap.compared.playback_error < 0.05
        assert not any(isinstance(each, str) for each in others)
        return
    assert tap.why.startswith("no steady approach: ")
    assert others == (tap.why, tap.why)
    # What would be told of it without: the error of a device that plays as it shall is 0.6 %.
    monkeypatch.setattr(played, "why_not_steady", lambda contact, settings, prediction: "")
    assert played_tap(contact, library, stated, 1.0, ACCELEROMETER).compared.playback_error > 0.2


@pytest.mark.parametrize(("deceleration_m_s2", "force"), [(6.0, 1.0), (0.0, 1.4)], ids=["hand", "device"])
def test_a_hand_is_told_from_a_device_that_is_off(
    library: Library, stated: Settings, deceleration_m_s2: float, force: float
) -> None:
    """A hand that brakes from contact on came in as it should: the tap has its figures, and says whose they are."""
    brakes = Mover((0.0, CONTACT_S, CONTACT_S + 0.03, 1.0), (-0.2, -0.2, *[-0.2 + 0.03 * deceleration_m_s2] * 2))
    pushes = replace(DEFAULT_DEVICE, force_per_current_N_A=force * DEFAULT_DEVICE.force_per_current_N_A)
    tap = played_tap(last_contact(library, brakes, pushes), library, stated, 1.0, ACCELEROMETER)
    assert not tap.why
    assert 0.3 < tap.compared.playback_error < 0.45
    assert ("as by a hand that brakes" in tap.remark) == (deceleration_m_s2 > 0)
    assert (tap.compared.by_hand > 0.3) == (deceleration_m_s2 > 0)


@pytest.mark.parametrize("encoder", [1.2, 1.0, 0.8])
def test_a_scale_that_is_off_is_told_where_all_else_agrees(
    library: Library, stated: Settings, encoder: float
) -> None:
    """The tap of another speed is played, as predicted."""
    contact = last_contact(library, STEADY, encoder=encoder)
    tap = played_tap(contact, library, stated, 1.0, ACCELEROMETER)
    assert contact.speed_m_s == pytest.approx(encoder * SPEED_M_S, rel=0.02)
    assert tap.compared.playback_error < 0.02
    assert tap.compared.encoder == pytest.approx(encoder, rel=0.03)
    assert ("times the motion by the encoder" in tap.remark) == (encoder != 1.0)
    # Half a count is too much of the way where counts are coarse.
    coarse = replace(contact, counts=np.round(contact.counts * stated.count_m / 4e-4))
    assert np.isnan(encoder_ratio(coarse, replace(stated, count_m=4e-4), ACCELEROMETER.bandwidth_Hz))


def test_coarse_counts_and_few_records_are_no_reason(library: Library, stated: Settings) -> None:
    contact, prediction = last_contact(library, STEADY), predict(library, SPEED_M_S, 3.0)
    coarse = replace(contact, counts=np.round(contact.counts * stated.count_m / 2e-4))
    assert not why_not_steady(coarse, replace(stated, count_m=2e-4), prediction)
    for first in (450, 595):
        late = {name: getattr(contact, name)[first:] for name in ("ticks", "counts", "acceleration_m_s2")}
        assert not why_not_steady(replace(contact, **late), stated, prediction)


def test_a_rail_of_an_earlier_contact_hides_nothing_of_the_approach(library: Library, stated: Settings) -> None:
    contact, prediction = last_contact(library, back_at(0.02, 0.02)), predict(library, SPEED_M_S, 3.0)
    acceleration = contact.acceleration_m_s2.copy()
    acceleration[:300] = np.nan
    railed = replace(contact, acceleration_m_s2=acceleration)
    assert why_not_steady(railed, stated, prediction).startswith("no steady approach: ")
