"""Host session against the compiled device over a link in virtual time."""

from collections.abc import Callable

import pytest

from controller.host.session import SILENCE_S, Session
from controller.host.session_states import OVER, SEEN, TRANSITIONS, MisuseError, SessionState, Trigger
from controller.protocol import messages as m
from controller.protocol.capacity import Capacity
from controller.protocol.codes import REASONS, Kind, LinkNotice, Reason
from controller.protocol.events import Cause, Changed, Connected, Ended, Happened, Refused
from controller.protocol.image import image_of, sha256
from controller.protocol.wire import Decoder, encode
from controller.servo.interface import Fault, Notice, Readings, State
from tests.benches.compiled import smooth_bank as table
from tests.benches.device import CONFIGURATION, DT_S, IMAGE, SETTINGS, World, image, reframed, tokens
from tests.benches.servo import COUNT_M
from tests.benches.virtual_link import Trouble
from transopt.base.errors import InputError


def last(world: World) -> object:
    return world.told[-1]


def test_connect_tells_who_is_there() -> None:
    world = World().connected()
    assert isinstance(world.told[0], Connected)
    assert world.told[0].device.boot == 100
    assert world.told[0].capacity == Capacity()
    assert not world.told[0].restarted
    assert world.session.state is SessionState.READY


def test_armed_while_the_lease_is_kept_and_no_longer() -> None:
    world = World().armed(lease_ms=100)
    world.run(2.0)
    assert world.device.state is State.ARMED
    world.host_alive = False
    # The last one went out a quarter of a lease ago at most.
    world.run(0.07)
    assert world.device.state is State.ARMED
    world.run(0.031)
    assert world.device.state is State.IDLE
    world.host_alive = True
    world.run(1.0)
    lost = [x for x in world.told if isinstance(x, Happened)]
    assert [x.what for x in lost] == [LinkNotice.LEASE_LOST]
    assert world.session.device_state is State.IDLE
    assert world.device.state is State.IDLE


def test_a_queued_arm_is_given_up_by_disarm_and_by_a_refusal() -> None:
    world = World().ready()
    world.session.arm(1.0)
    world.session.disarm()
    world.run(0.5)
    assert world.device.state is State.IDLE
    world.session.upload(image_of(table(peak_A=20.0), DT_S, SETTINGS.lead_s, 10))
    world.session.arm(1.0)
    world.run(0.5)
    refused = [x for x in world.told if isinstance(x, Refused)]
    assert [(x.request, x.reason) for x in refused] == [(Kind.COMMIT, Reason.OVER_LIMIT)]
    assert "passes the current or the command limit" in str(refused[0])
    assert world.device.state is State.IDLE
    # The library before stays in force.
    assert world.device.look().library_sha256 == sha256(IMAGE)


def test_events_of_a_tap_are_told_once_in_order() -> None:
    world = World(Trouble(latency_s=0.005, loss=0.2, repetition=0.2, corruption=0.1), seed=3)
    taps_in(world)
    world.armed(lease_ms=1000)
    start = world.device_tick
    world.readings = lambda k: tap_reading(k - start)
    world.run(0.5)
    world.link.set_trouble(Trouble())
    world.run(0.5)
    happened = world.of(Happened)
    assert [x.what for x in happened if isinstance(x, Happened)] == [Notice.CONTACT, Notice.FINISHED]
    assert [x.number for x in happened if isinstance(x, Happened)] == [0, 1]
    assert isinstance(happened[0], Happened)
    assert happened[0].speed_m_s == pytest.approx(0.2, rel=0.05)
    assert happened[0].grip_N == pytest.approx(3.0)


def taps_in(world: World) -> None:
    world.readings = lambda k: Readings(k, round(0.01 / COUNT_M), 3.0, 0.0, 0.0)


def tap_reading(k: int) -> Readings:
    """From 10 mm above at 0.2 m/s to 2 mm deep, there with a tremor."""
    z = 0.01 - 0.2 * k * DT_S if k < 600 else -2e-3 + 5e-5 * (k % 7)
    return Readings(k + 1_000_000, round(z / COUNT_M), 3.0, 0.0, 0.0)


def test_a_fault_is_told_and_needs_reset_and_a_new_arm() -> None:
    world = World().armed()
    world.readings = lambda k: Readings(k, 200, 3.0, 0.0, 0.0, emergency_stop=True)
    world.run(0.3)
    assert (world.session.device_state, world.session.fault) == (State.FAULT, Fault.EMERGENCY_STOP)
    assert world.session.state is SessionState.FAULTED
    world.session.reset()
    world.until(lambda: world.session.idle, 0.1)
    assert isinstance(last(world), Refused)
    assert world.told[-1].reason is Reason.FAULT_REMAINS  # type: ignore[union-attr]
    world.readings = lambda k: Readings(k, 200, 3.0, 0.0, 0.0)
    world.run(0.01)
    world.session.reset()
    world.run(0.5)
    assert world.device.state is State.IDLE
    assert world.session.state is SessionState.READY


@pytest.mark.parametrize("trouble", [Trouble(), Trouble(latency_s=0.02, loss=0.5)])
def test_emergency_stop_goes_past_everything(trouble: Trouble) -> None:
    world = World(seed=9).armed()
    world.link.set_trouble(trouble)
    world.session.emergency_stop(world.now_s)
    world.pump()
    if trouble.loss == 0:
        world.step()
        assert world.device.state is State.FAULT
        assert world.output.command_A == 0.0
    world.until(lambda: world.device.state is State.FAULT, 0.5)
    world.until(lambda: world.session.fault is Fault.HOST_STOP, 1.0)
    stops = world.link.to_device.kinds[Kind.EMERGENCY_STOP]
    world.run(0.3)
    assert stops >= 3
    assert world.link.to_device.kinds[Kind.EMERGENCY_STOP] <= max(stops, 3)
    world.session.reset()
    world.until(lambda: world.session.state is SessionState.READY, 2.0)


def test_emergency_stop_during_an_upload_and_before_any_connection() -> None:
    world = World(Trouble(latency_s=0.016)).connected()
    world.session.configure(CONFIGURATION)
    world.until(lambda: world.session.idle, 1.0)
    world.session.upload(image(speeds=17, grips=20, samples=580))
    world.run(0.2)
    world.session.emergency_stop(world.now_s)
    world.run(0.0175)
    assert world.device.state is State.FAULT
    other = World()
    other.session.emergency_stop(0.0)
    other.pump()
    other.run(0.03)
    assert other.link.to_device.kinds[Kind.EMERGENCY_STOP] == 3
    assert other.device.state is State.FAULT
    assert other.session.state is SessionState.NEW


@pytest.mark.parametrize("armed", [False, True])
@pytest.mark.parametrize("what", ["unplug", "reset"])
def test_a_dead_link_is_reported_within_a_second_and_never_armed_again(what: str, armed: bool) -> None:
    world = World().armed() if armed else World().ready()
    died = world.now_s
    if what == "unplug":
        world.link.unplug()
    else:
        world.reset_device()
    world.until(lambda: world.session.state in OVER, 1.0)
    assert isinstance(last(world), Ended)
    assert world.told[-1].cause is Cause.SILENT  # type: ignore[union-attr]
    assert world.now_s - died <= SILENCE_S + 0.2
    world.link.plug()
    world.run(1.0)
    assert world.device.state is State.IDLE
    assert world.link.to_device.kinds[Kind.ARM] == int(armed)
    world.connected().run(0.3)
    greeted = world.of(Connected)[-1]
    assert isinstance(greeted, Connected)
    assert greeted.restarted == (what == "reset")
    assert world.device.state is State.IDLE


def test_a_new_connection_takes_the_lease_of_the_old_one_away() -> None:
    world = World().armed(lease_ms=1000)
    world.session = Session(iter(range(500, 600)).__next__)
    world.session.connect(world.now_s)
    world.until(lambda: world.session.device is not None, 0.1)
    assert world.device.state is State.IDLE


def test_a_foreign_device_and_another_version_are_named() -> None:
    session = Session(tokens())
    session.connect(0.0, timeout_s=0.5)
    session.bytes_to_send(0.0)
    assert session.receive(b"$GPGGA,123519,4807.038,N\r\n" * 20, 0.1) == []
    (ended,) = session.receive(b"", 0.6)
    assert isinstance(ended, Ended)
    assert ended.cause is Cause.NOT_OURS
    assert "520 bytes" in str(ended)

    for magic, protocol, cause in ((m.MAGIC, 9, Cause.OTHER_VERSION), (7, m.PROTOCOL, Cause.NOT_OURS)):
        session.connect(1.0)
        reply = m.HEADER.pack(Kind.HELLO_REPLY, 0, 1, 1) + m.GREETING.pack(magic, protocol) + b"whatever"
        (ended,) = session.receive(encode(reply), 1.1)
        assert isinstance(ended, Ended)
        assert ended.cause is cause
        assert (f"it speaks 9, the host {m.PROTOCOL}" in str(ended)) == (protocol == 9)


def test_a_device_tells_another_version_its_own() -> None:
    world = World()
    hello = m.HEADER.pack(Kind.HELLO, 0, 1, 77) + m.GREETING.pack(m.MAGIC, 9) + b"of another length"
    world.device.receive(encode(hello))
    (payload,) = Decoder().feed(world.device.bytes_to_send())
    reply = m.read_frame(payload)
    assert isinstance(reply.message, m.HelloReply)
    assert reply.session == 77
    foreign = m.HEADER.pack(Kind.HELLO, 0, 1, 77) + m.GREETING.pack(5, 9)
    world.device.receive(encode(foreign))
    assert world.device.bytes_to_send() == b""


Act = Callable[[Session], object]
MISUSES: list[tuple[str, Act]] = [
    ("connect", lambda s: s.connect(1.0)),
    ("upload", lambda s: (s.upload(IMAGE), s.upload(image(speeds=3)))),
    ("arm", lambda s: s.arm(1.0)),
    ("start", lambda s: s.start()),
]


@pytest.mark.parametrize(("name", "act"), MISUSES)
def test_misuse_raises_and_latches(name: str, act: Act) -> None:
    world = World().connected()
    with pytest.raises(MisuseError):
        act(world.session)
    assert world.session.state is SessionState.MISUSED
    with pytest.raises(MisuseError):
        world.session.disarm()
    world.run(0.01)
    assert world.told[-1].cause is Cause.MISUSED  # type: ignore[union-attr]
    world.connected()
    assert world.session.state is SessionState.READY


@pytest.mark.parametrize(
    "message",
    [
        m.Done(Kind.ARM, 0, 0),
        m.Done(Kind.RESET, 9, 0),
        m.Done(Kind.RESET, 0, 5),
        m.Refused(Kind.RESET, 200, 0, 0, 0.0),
        m.UploadReady(3),
        m.Event(0, 1, 255, 0, 0.0, 0.0, 0.0, 0.0),
        m.TelemetryData(0, 1, 1, b"short"),
        m.TelemetryData(0, 1, 0, bytes(m.Record.FORMAT.size)),
        m.TelemetryData(0, 1, 1, b"\xff" * m.Record.FORMAT.size),
        m.LeaseReply(0, 0, 7, 0),
    ],
)
def test_a_breach_of_the_protocol_latches(message: m.Done) -> None:
    world = World().connected()
    session = world.session
    session.reset()
    session.bytes_to_send(world.now_s)
    frame = m.Frame(2, 1, message)
    (ended,) = session.receive(encode(frame.payload()), world.now_s)
    assert isinstance(ended, Ended)
    assert ended.cause is Cause.BROKE_PROTOCOL
    assert session.state is SessionState.BROKEN
    assert session.receive(encode(frame.payload()), world.now_s) == []
    assert session.bytes_to_send(world.now_s + 0.3) == b""
    with pytest.raises(MisuseError):
        session.reset()
    assert session.state is SessionState.BROKEN


def test_a_device_that_is_there_but_does_not_answer_ends_the_session(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World().connected()
    hear = world.device.receive
    leases = lambda payload: payload if payload[0] == Kind.LEASE else b""  # noqa: E731
    monkeypatch.setattr(world.device, "receive", lambda data: hear(reframed(data, leases)))
    world.session.reset()
    world.until(lambda: world.session.state in OVER, 6.0)
    assert world.told[-1] == Ended(Cause.BROKE_PROTOCOL, "no answer to Reset")


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (lambda s: s.arm(1.5), "gain = 1.5: must be 0 to 1"),
        (lambda s: s.arm(1.0, 20), "lease_ms = 20 ms: must be 50 to 1000 ms"),
        (lambda s: s.set_gain(float("nan")), "gain = nan"),
        (lambda s: s.set_telemetry(70_000), "telemetry = 70000 ticks"),
        (lambda s: s.pulse(0.2, 10), "pulse = 0.2 A: must be -0.1 to 0.1 A"),
    ],
)
def test_a_value_out_of_range_is_an_input_error(act: Act, words: str) -> None:
    world = World().ready()
    with pytest.raises(InputError) as error:
        act(world.session)
    assert words in str(error.value)
    assert world.session.state is SessionState.READY


def test_the_table_of_states_is_closed() -> None:
    """Each state can be left, ends on misuse, and only the device's own report leads to ARMED."""
    for (before, trigger), after in TRANSITIONS.items():
        if after is SessionState.ARMED and before is not SessionState.ARMED:
            assert trigger is Trigger.ACTIVE_SEEN
    for state in SessionState:
        assert (state, Trigger.END) in TRANSITIONS
        assert (state, Trigger.MISUSE) in TRANSITIONS
        if state in OVER:
            assert TRANSITIONS[state, Trigger.CONNECT] is SessionState.CONNECTING
            assert not any((state, seen) in TRANSITIONS for seen in SEEN.values())
    assert (SessionState.CONNECTING, Trigger.ACTIVE_SEEN) not in TRANSITIONS
    assert [state for state in SessionState if (state, Trigger.ARM) in TRANSITIONS] == [SessionState.READY]
    assert [state for state in SessionState if (state, Trigger.START) in TRANSITIONS] == [SessionState.ARMED]


def test_changes_of_the_device_are_told_once() -> None:
    world = World().armed()
    world.run(0.5)
    assert world.of(Changed) == [Changed(State.ARMED, None)]
    assert REASONS[1] is Reason.NOT_IDLE
