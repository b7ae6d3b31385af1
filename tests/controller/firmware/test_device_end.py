"""The device's end alone: what it refuses and why, repetitions, pulses, the coil's memory, what it tells."""

import math
from dataclasses import replace

import pytest

from controller.protocol import messages as m
from controller.protocol.capacity import LINK_SILENCE_MS, REST_BETWEEN_PULSES_S
from controller.protocol.codes import EVENT_CODES, STATES, Kind, LinkNotice, Reason
from controller.protocol.configuration import configuration_of
from controller.protocol.image import sha256
from controller.servo.interface import Fault, Readings, State
from tests.benches.device import ARM, DT_S, HASHES, IMAGE, REST, SETTINGS, Talker
from transopt.plant.coil import CoilModel

RESTS = round(REST_BETWEEN_PULSES_S / SETTINGS.dt_s)  # ticks before every pulse
COIL = CoilModel(2.18, 3.1, 14.0, 12.0, 612.0, 100.0)


def test_arm_is_refused_for_each_reason_in_turn() -> None:
    bench = Talker()
    other = bytes(31) + b"x"
    assert bench.refused(ARM) is Reason.NO_CONFIGURATION
    bench.configured()
    assert bench.refused(replace(ARM, configuration_sha256=other)) is Reason.WRONG_CONFIGURATION
    assert bench.refused(ARM) is Reason.NO_LIBRARY
    bench.loaded()
    assert bench.refused(replace(ARM, library_sha256=other)) is Reason.WRONG_LIBRARY
    for lease_ms in (0, 49, 1001, 65_535):
        assert bench.refused(replace(ARM, lease_ms=lease_ms)) is Reason.BAD_LEASE
    for gain in (-0.1, 1.1, math.nan, math.inf):
        assert bench.refused(replace(ARM, gain=gain)) is Reason.BAD_VALUE
    assert bench.refused(replace(ARM, trial=2)) is Reason.BAD_VALUE
    bench.done(m.Pulse(0.05, 10, 0))
    assert bench.refused(ARM) is Reason.PULSING
    bench.step(RESTS + 10)
    for k in range(40):
        bench.step(1, REST._replace(encoder_counts=200 - k))
    assert bench.refused(ARM) is Reason.NOT_AT_REST
    bench.step(40, REST._replace(encoder_counts=161))
    assert bench.device.state is State.IDLE
    bench.done(ARM)
    assert bench.device.state is State.ARMED
    assert bench.refused(ARM) is Reason.NOT_IDLE
    for message in (m.Commit(), m.UploadBegin(1, other), m.ConfigureCommit(other), m.Pulse(0.05, 1, 0)):
        assert bench.refused(message) is Reason.NOT_IDLE
    bench.put(m.EmergencyStop())
    bench.step()
    assert bench.refused(ARM) is Reason.FAULT_LATCHED


def test_a_repeated_request_is_answered_again_and_not_carried_out_again() -> None:
    bench = Talker().ready()
    bench.done(ARM)
    bench.step(2500)  # the lease runs out
    assert bench.device.state is State.IDLE
    bench.heard()
    (again,) = bench.put(ARM)
    assert again == m.Done(Kind.ARM, STATES.index(State.ARMED), 0)
    assert bench.device.state is State.IDLE
    # An older one is not even answered, nor is one of another session.
    assert bench.put(ARM, sequence=bench.sequence - 1) == []
    assert bench.put(ARM, sequence=bench.sequence + 1, session=8) == []
    assert bench.put(m.Lease(1), session=8) == []
    assert bench.device.state is State.IDLE
    assert bench.device.look().dropped_frames == 3


def test_sequence_numbers_go_round() -> None:
    bench = Talker()
    bench.put(m.Gain(0.5), sequence=32_000)
    bench.put(m.Gain(0.5), sequence=64_000)
    assert bench.put(m.Disarm(), sequence=5) != []
    assert bench.put(m.Disarm(), sequence=64_000) == []


@pytest.mark.parametrize("host_us", [0, 7, 2**64 - 1])
def test_a_lease_that_comes_again_keeps_nothing_armed(host_us: int) -> None:
    """Neither the same frame for ever nor an older one; a clock at its end renews to the end."""
    bench = Talker().ready()
    bench.done(ARM)
    (first,) = (x for x in bench.put(m.Lease(host_us)) if isinstance(x, m.LeaseReply))
    assert first.host_us == host_us
    for sequence in range(1, 22):
        bench.step(100)
        stale = [m.Lease(host_us), m.Lease(host_us // 2)] if host_us < 2**64 - 1 else [m.Lease(host_us - 1)]
        assert not any(isinstance(x, m.LeaseReply) for lease in stale for x in bench.put(lease, sequence=sequence))
    assert bench.device.state is State.IDLE
    # A new session is a new clock.
    bench.put(m.Hello(m.MAGIC, m.PROTOCOL, 6), session=10, sequence=1)
    assert [x.host_us for x in bench.put(m.Lease(0), session=10) if isinstance(x, m.LeaseReply)] == [0]


def test_a_late_hello_of_the_same_session_does_not_disarm() -> None:
    bench = Talker().ready()
    bench.done(ARM)
    assert bench.put(m.Hello(m.MAGIC, m.PROTOCOL, 5), sequence=1) == []
    assert bench.device.state is State.ARMED
    (reply,) = (x for x in bench.put(m.Hello(m.MAGIC, m.PROTOCOL, 6), session=10) if isinstance(x, m.HelloReply))
    assert bench.device.state is State.IDLE
    assert (reply.nonce, reply.boot, reply.evidence) == (6, 7, 3)


def test_a_session_of_number_0_is_none() -> None:
    """It is what a host has before its HELLO, and would take the answers of another for its own."""
    bench = Talker()
    dropped = bench.device.look().dropped_frames
    assert bench.put(m.Hello(m.MAGIC, m.PROTOCOL, 6), session=0) == []
    assert bench.device.look().dropped_frames == dropped + 1
    # The session that is open goes on; and whoever has none may stop the device all the same.
    assert bench.put(m.Evidence(), sequence=2)
    bench.put(m.EmergencyStop(), session=0)
    bench.step(1)
    assert bench.device.look().fault is Fault.HOST_STOP


def test_a_pulse_is_small_short_and_told() -> None:
    bench = Talker()
    assert bench.refused(m.Pulse(0.05, 50, 0)) is Reason.NO_CONFIGURATION
    bench.configured()
    for current_A in (0.11, -0.11, math.nan, math.inf):
        assert bench.refused(m.Pulse(current_A, 50, 0)) is Reason.BAD_VALUE
    for ticks in (0, 201):
        assert bench.refused(m.Pulse(0.05, ticks, 0)) is Reason.BAD_VALUE
    bench.done(m.Pulse(-0.1, 200, 0))
    assert bench.refused(m.Pulse(0.05, 50, 0)) is Reason.PULSING
    commands = [bench.step().command_A for _ in range(RESTS + 250)]
    assert commands == [0.0] * RESTS + [-0.1] * 200 + [0.0] * 50
    assert [m.Event(0, 199, 33, 0, *4 * (math.nan,)).code] == [
        x.code for x in bench.heard() if isinstance(x, m.Event)
    ]
    bench.done(m.Pulse(0.1, 200, 0))
    bench.step(RESTS + 3)
    output = bench.step(1, REST._replace(emergency_stop=True))
    assert (output.command_A, output.state) == (0.0, State.FAULT)
    assert bench.step().command_A == 0.0
    codes = [x.code for x in bench.heard() if isinstance(x, m.Event)]
    assert EVENT_CODES[LinkNotice.PULSE_CUT] in codes


def test_a_stop_is_reported_to_a_host_that_said_nothing_for_long() -> None:
    bench = Talker().ready()
    bench.step(LINK_SILENCE_MS * 10 + 1)
    for session, told in ((12345, []), (bench.session, [EVENT_CODES[Fault.HOST_STOP]])):
        said = bench.put(m.EmergencyStop(), session=session)
        assert bench.step().state is State.FAULT
        assert [x.code for x in (*said, *bench.heard()) if isinstance(x, m.Event)] == told


def test_emergency_stop_without_configuration_latches() -> None:
    bench = Talker()
    bench.put(m.EmergencyStop(), session=12345)
    assert bench.step().state is State.FAULT
    assert bench.device.look().fault is Fault.HOST_STOP
    assert bench.refused(m.ConfigureCommit(HASHES[0])) is Reason.FAULT_LATCHED
    bench.step(1, REST._replace(emergency_stop=True))
    assert bench.refused(m.Reset()) is Reason.FAULT_REMAINS
    bench.step()
    bench.done(m.Reset())
    assert bench.step().state is State.IDLE


def test_what_goes_wrong_beside_a_latched_fault_bars_the_reset() -> None:
    bench = Talker().configured()
    bench.step(1, REST._replace(emergency_stop=True))
    bench.step(1, REST._replace(grip_N=100.0))
    assert bench.device.look().fault is Fault.EMERGENCY_STOP
    assert bench.refused(m.Reset()) is Reason.FAULT_REMAINS
    bench.step()
    bench.done(m.Reset())


def test_commit_takes_nothing_half() -> None:
    bench = Talker()
    bench.ask(m.UploadBegin(len(IMAGE), HASHES[1]))
    bench.put(m.Data(0, IMAGE))
    assert bench.refused(m.Commit()) is Reason.NO_CONFIGURATION
    bench.configured()
    bench.ask(m.UploadBegin(len(IMAGE), HASHES[1]))
    assert bench.put(m.Data(500, IMAGE[500:])) == [m.Ack(len(IMAGE))]
    bench.done(m.Commit())
    assert bench.refused(m.Commit()) is Reason.INCOMPLETE
    wrong = bytes(32)
    bench.ask(m.UploadBegin(len(IMAGE), wrong))
    assert bench.put(m.Data(0, IMAGE[:100])) == [m.Ack(100)]
    assert bench.put(m.Data(200, IMAGE[200:])) == [m.Ack(100)]
    assert bench.refused(m.Commit()) is Reason.INCOMPLETE
    assert bench.put(m.Data(100, IMAGE[100:] + b"more")) == [m.Ack(100)]
    bench.put(m.Data(100, IMAGE[100:]))
    assert bench.refused(m.Commit()) is Reason.WRONG_HASH
    assert bench.device.look().library_sha256 == HASHES[1]
    assert bench.refused(m.UploadBegin(2**31, wrong)) is Reason.TOO_LARGE
    assert bench.refused(m.Configure(1_000_000, b"x")) is Reason.BAD_OFFSET
    assert bench.refused(m.ConfigureCommit(wrong)) is Reason.WRONG_HASH


def test_a_library_that_a_new_configuration_forbids_goes_out_of_force() -> None:
    bench = Talker().ready()
    small = replace(SETTINGS, current_limit_A=0.2)
    bench.configured(configuration_of(small))
    assert bench.device.look().library_sha256 == m.NO_HASH
    assert bench.refused(replace(ARM, configuration_sha256=sha256(configuration_of(small)))) is Reason.NO_LIBRARY


def test_events_are_repeated_until_acknowledged_and_only_while_somebody_listens() -> None:
    bench = Talker().configured()
    bench.put(m.EmergencyStop())
    bench.step()
    (first,) = (x for x in bench.heard() if isinstance(x, m.Event))
    again = []
    for _ in range(20):
        bench.step(100)
        again += [x.number for x in bench.heard() if isinstance(x, m.Event)]
    assert again == [0] * 4
    bench.step(LINK_SILENCE_MS * 10)
    bench.heard()
    bench.step(5000)
    assert bench.heard() == []
    bench.put(bench.lease())
    bench.step(800)
    assert first.number in [x.number for x in bench.heard() if isinstance(x, m.Event)]
    bench.put(m.EventAck(1))
    bench.step(2000)
    assert bench.heard() == []


def test_the_event_queue_counts_what_it_loses() -> None:
    bench = Talker()
    pressed, sent = REST._replace(emergency_stop=True), list[int]()
    for _ in range(80):
        bench.step(1, pressed)
        bench.step()
        bench.sequence += 1
        sent += [x.number for x in bench.put(m.Reset()) if isinstance(x, m.Event)]
    look = bench.device.look()
    assert (look.oldest_event, look.events) == (0, 64)
    while bench.device.look().oldest_event != 64:
        bench.step()
        sent += [x.number for x in bench.heard() if isinstance(x, m.Event)]
        said = bench.put(m.EventAck(min(bench.device.look().oldest_event + 3, 64)))
        said += bench.put(m.EventAck(1000))  # nobody can have seen that
        sent += [x.number for x in said if isinstance(x, m.Event)]
    bench.step(1, pressed)
    (last,) = (x for x in bench.heard() if isinstance(x, m.Event))
    assert (last.number, last.lost) == (64, 16)
    assert sorted(set(sent)) == list(range(64))


def test_telemetry_survives_absurd_readings() -> None:
    bench = Talker()
    bench.done(m.Telemetry(1, 0))
    nan, inf = math.nan, math.inf
    absurd = (nan, inf, -inf, 1e30, 2**31, -(2**31))
    for counts in absurd:
        bench.step(1, Readings(0, counts, inf, 1e300, -1e300, emergency_stop=True))  # type: ignore[arg-type]
    bench.step(1, Readings(0, -5, nan, 0.0, 0.0))
    bench.step(200)
    size = m.Record.FORMAT.size
    data = b"".join(x.records for x in bench.heard() if isinstance(x, m.TelemetryData))
    records = [m.Record.unpack(data[j : j + size]) for j in range(0, len(data), size)]
    for record in records[: len(absurd)]:
        assert record.encoder_counts == m.NO_COUNTS
        assert (record.grip_N, record.measured_current_A, record.acceleration_m_s2) == (inf, inf, -inf)
        assert record.flags == 1
    assert records[len(absurd)].encoder_counts == -5
    assert math.isnan(records[len(absurd)].grip_N)


@pytest.mark.parametrize("every", [1, 7, 65_535])
def test_telemetry_records_every_nth_tick_without_gaps(every: int) -> None:
    bench = Talker().configured()
    bench.done(m.Telemetry(every, 0))
    ticks: list[int] = []
    for _ in range(3000):
        bench.step()
        for data in bench.heard():
            assert isinstance(data, m.TelemetryData)
            assert data.first == len(ticks)
            count = len(data.records) // m.Record.FORMAT.size
            ticks += range(data.tick, data.tick + count * data.every, data.every)
            # No record waits longer than it may.
            assert bench.tick - data.tick <= 100
    assert ticks == list(range(0, 3000, every))[: len(ticks)]
    assert len(ticks) * every > 3000 - 100 - every
    assert DT_S == 1e-4
