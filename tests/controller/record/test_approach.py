"""Taps whose hand did not come in steadily: the simulator's truth, and what is said of them in place of figures."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from controller.device.device_file import Accelerometer
from controller.protocol.events import Happened, Samples
from controller.protocol.messages import Record
from controller.record import played
from controller.record.played import not_straight, played_tap
from controller.record.recorder import Contact, Recorder
from controller.refine.heard import hear, node_near
from controller.refine.new_hand import record_of
from controller.servo.interface import Output, Readings
from controller.servo.settings import Settings
from controller.sim.played_tap import run
from controller.sim.sensors import SEED_SENSORS
from controller.sim.simulator import Simulator
from controller.sim.true_device import DEFAULT_DEVICE
from controller.sim.user import User
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


def last_contact(library: Library, user: User) -> Contact:
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

    run(Simulator(DEFAULT_DEVICE, user, 1e-4), servo, round(END_S / 1e-4), observe)
    return recorder.contacts[-1]


STEADY = Mover((0.0, 1.0), (-SPEED_M_S, -SPEED_M_S))
PLAYED: dict[str, tuple[Mover, bool]] = {
    "steady": (STEADY, True),
    "faster and faster by 2 m/s^2": (Mover((0.0, 0.15, 1.0), (0.04, -0.26, -0.26)), True),
    "again, after a way of its own": (
        Mover((0.0, 0.15, 0.17, 0.27, 0.29, 1.0), (-0.2, -0.2, 0.3, 0.3, -0.2, -0.2)),
        True,
    ),
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
    assert tap.why.startswith("no straight approach: ")
    assert others == (tap.why, tap.why)
    # What would be told of it without: the error of a device that plays as it shall is 0.6 %.
    monkeypatch.setattr(played, "not_straight", lambda contact, settings: "")
    assert played_tap(contact, library, stated, 1.0, ACCELEROMETER).compared.playback_error > 0.2


def approach(contact: Contact, count_m: float, height_m: Callable[[np.ndarray], np.ndarray]) -> Contact:
    """The contact with other heights at times (n,) before it."""
    return replace(contact, counts=np.round(height_m((contact.ticks - contact.tick) * contact.dt_s) / count_m))


def test_what_is_straight_is_a_matter_of_speed_alone(library: Library, stated: Settings) -> None:
    """Slow taps over coarse counts are, and so is what little was recorded; one of unknown speed is not judged."""
    contact = last_contact(library, STEADY)
    coarse = replace(stated, count_m=2e-4)
    for settings in (stated, coarse):
        for speed in (0.03, 0.1, 0.4):
            steady = approach(contact, settings.count_m, lambda t, v=speed: -v * t)
            assert not not_straight(steady, settings), (settings.count_m, speed)
            turned = approach(contact, settings.count_m, lambda t, v=speed: v * (0.035 - np.abs(t + 0.035)))
            assert "a rebound, or begun too near: begin higher" in not_straight(turned, settings)
    late = {name: getattr(contact, name)[450:] for name in ("ticks", "counts", "acceleration_m_s2")}
    assert not not_straight(replace(contact, **late), stated)
    assert not not_straight(approach(contact, stated.count_m, np.array), stated)
