"""What plays at the host's word: when it may start, what ends it, and that nothing else is as it was not in a tap."""

from dataclasses import replace

import numpy as np
import pytest

from controller.protocol import messages as m
from controller.protocol.codes import EVENT_CODES, REASONS, LinkNotice, Reason
from controller.protocol.configuration import configuration_of
from controller.protocol.image import image_of, sha256
from controller.servo.interface import Notice, Output, State
from controller.servo.settings import Settings
from controller.waveforms.bank import Bank, Method
from tests.benches.device import Talker
from tests.benches.servo import AMPLIFIER, DT_S, WALL
from tests.benches.servo import Bench as ServoBench
from transopt.base.errors import InputError
from transopt.plant.coil import CoilModel
from transopt.problem.warm_coil import currents, norms

COIL = CoilModel(2.18, 3.1, 14.0, 12.0, 612.0, 100.0)
SETTINGS = Settings(DT_S, 0.0, 1.25, AMPLIFIER, coil=COIL, host_starts=True, stuck_A_s=100.0)
SAMPLES = 300


def excitation(peak_A: float = 0.7) -> Bank:
    """A sine of 150 Hz that ends in a zero."""
    command = peak_A * np.sin(2 * np.pi * 150 * DT_S * np.arange(SAMPLES))[None, None]
    command[..., -1] = 0.0
    size = norms(currents(command, AMPLIFIER, DT_S), AMPLIFIER, DT_S).tolist()
    return Bank(Method.BILINEAR, [1.0], [0.0], command, size, [[0.0]], 0.0, False, False)


def still(_: float) -> float:
    return 2e-3


@pytest.fixture
def bench() -> ServoBench:
    bench = ServoBench(SETTINGS, excitation(), still)
    bench.run(5)
    assert bench.servo.arm()
    return bench


def test_it_plays_the_waveform_from_the_next_tick_on_to_its_end(bench: ServoBench) -> None:
    bench.run(10)
    assert bench.servo.excite()
    bench.run(SAMPLES + 5)
    played = np.array(bench.commands()[15:])
    np.testing.assert_array_equal(played[:SAMPLES], bench.servo.bank.command_A[0, 0])
    assert not np.any(played[SAMPLES:])
    states = [output.state for output in bench.outputs[15:]]
    assert states == [State.PLAYING] * SAMPLES + [State.ARMED] * 5
    assert bench.events() == [Notice.FINISHED]
    assert bench.outputs[15 + SAMPLES].events[0].what is Notice.FINISHED


def test_the_free_device_is_excited_and_may_be_taken_hold_of(bench: ServoBench) -> None:
    """Who lets go of what he held ends it; whoever did not hold it cannot."""
    bench.grip_N = 0.0
    bench.step()
    assert bench.servo.excite()
    bench.run(100)
    bench.grip_N = 3.0
    bench.run(50)
    bench.grip_N = 0.0
    bench.run(SAMPLES)
    assert bench.events() == [Notice.FINISHED]


def test_no_wall_beside_it() -> None:
    with pytest.raises(InputError, match="host_starts beside a wall"):
        replace(SETTINGS, wall=WALL)


# The device around the servo.

CONFIGURATION = configuration_of(SETTINGS)
IMAGE = image_of(excitation(), DT_S, 0.0, 1)
# Half: without a current that is measured, less than what the servo misses.
ARM = m.Arm(0, 200, 0.5, sha256(CONFIGURATION), sha256(IMAGE))


def ready(configuration: bytes = CONFIGURATION) -> Talker:
    return Talker().configured(configuration).loaded(IMAGE)


def test_start_is_refused_with_its_reason() -> None:
    bench = Talker()
    assert bench.refused(m.Start(0)) is Reason.NOT_ARMED
    by_contact = configuration_of(replace(SETTINGS, host_starts=False))
    bench = ready(by_contact)
    assert bench.refused(m.Start(0)) is Reason.NOT_ARMED
    bench.done(replace(ARM, configuration_sha256=sha256(by_contact)))
    assert bench.refused(m.Start(0)) is Reason.BY_CONTACT
    bench = ready()
    bench.done(ARM)
    assert bench.refused(m.Start(2)) is Reason.BAD_VALUE
    bench.done(m.Start(1))
    assert bench.refused(m.Start(0)) is Reason.STILL_PLAYING
    bench.put(m.EmergencyStop())
    bench.step()
    assert bench.refused(m.Start(0)) is Reason.FAULT_LATCHED


def test_too_hot_is_said_with_the_temperature() -> None:
    hot = configuration_of(replace(SETTINGS, coil=replace(COIL, start_winding_C=94.999, start_housing_C=94.999)))
    bench = ready(hot)
    bench.done(replace(ARM, configuration_sha256=sha256(hot)))
    answer = bench.ask(m.Start(0))
    assert isinstance(answer, m.Refused)
    assert REASONS[answer.reason] is Reason.TOO_HOT
    assert answer.value == pytest.approx(94.999)


def test_a_repeated_start_starts_nothing_twice() -> None:
    bench = ready()
    bench.done(ARM, m.Start(0))
    for tick in range(SAMPLES + 2):
        if tick % 50 == 0:
            bench.put(bench.lease())
        bench.step()
    bench.heard()
    (again,) = bench.put(m.Start(0))
    assert isinstance(again, m.Done)
    assert bench.device.state is State.ARMED


def test_telemetry_of_every_tick_holds_the_whole_of_it() -> None:
    bench = ready()
    bench.done(m.Telemetry(1, 0), ARM)
    bench.step(10)
    bench.done(m.Start(0))
    records, events = [], []
    outputs: list[Output] = []
    for _ in range(SAMPLES + 200):
        bench.put(bench.lease())
        outputs.append(bench.step())
        for said in bench.heard():
            if isinstance(said, m.TelemetryData):
                size = m.Record.FORMAT.size
                rows = [m.Record.unpack(said.records[j : j + size]) for j in range(0, len(said.records), size)]
                records += [(said.tick + j, row) for j, row in enumerate(rows)]
            elif isinstance(said, m.Event):
                events.append(said)
    playing = [(tick, row.command_A) for tick, row in records if row.state == 2]
    assert len(playing) == SAMPLES
    np.testing.assert_array_equal([c for _, c in playing], np.float32([o.command_A for o in outputs[:SAMPLES]]))
    (finished,) = {event.tick for event in events if event.code == EVENT_CODES[Notice.FINISHED]}
    assert finished - SAMPLES == playing[0][0]


def test_a_silent_host_ends_it_within_the_lease() -> None:
    bench = ready()
    bench.done(replace(ARM, lease_ms=50))
    bench.put(bench.lease())
    bench.step(490)
    bench.done(m.Start(0))
    outputs = [bench.step() for _ in range(200)]
    assert [output.state for output in outputs] == [State.PLAYING] * 10 + [State.IDLE] * 190
    assert not np.any([output.command_A for output in outputs[10:]])
    codes = {said.code for said in bench.heard() if isinstance(said, m.Event)}
    assert codes == {EVENT_CODES[LinkNotice.LEASE_LOST]}
