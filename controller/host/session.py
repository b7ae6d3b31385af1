"""The host's end of the protocol, sans-IO: bytes and time in, events and bytes out.

    receive(data, now_s)      take the bytes that came since the last call (may be empty), return events
    bytes_to_send(now_s)      the bytes to send now
    next_deadline_s()         time of the next call at the latest, if no bytes come before

`now_s` is the time of any monotonic clock. Requests are queued and executed one after the other; the outcome of each
is an event, Completed or Refused. Every wait is bounded. The session renews the lease while it is pumped, and never
arms by itself: `arm` queues one ARM and never repeats the request. Not thread-safe: one thread makes all calls.
"""

import secrets
from collections.abc import Callable

from controller.host.clock import ClockFit, ClockRegression
from controller.host.requests import Requests, Stops
from controller.host.session_states import OPEN, OVER, SEEN, TRANSITIONS, MisuseError, SessionState, Trigger
from controller.host.streams import BreachError, EventStream, RecordStream
from controller.host.upload import BadAckError, Patience, Upload
from controller.protocol import events as t
from controller.protocol import messages as m
from controller.protocol.capacity import LEASE_DEFAULT_MS, LEASE_LEAST_MS, LEASE_MOST_MS, checked
from controller.protocol.codes import EVENTS, REASONS, STATES, Kind
from controller.protocol.events import Cause, Ended, News, capacity_of
from controller.protocol.image import sha256, too_large
from controller.protocol.packed import BadBodyError, Packed
from controller.protocol.wire import Decoder, encode
from controller.servo.interface import Fault, State
from transopt.base.errors import InputError

SILENCE_S = 0.6  # the link counts as dead after this time without any answer to a request
HEARTBEAT_S = 0.1  # longest period of the heartbeat; while armed, a quarter of the lease if that is shorter
LEASES_PER_TERM = 4  # heartbeats per lease
LEAST_BODY = 128  # bytes; every request without data must fit


class Session:
    """One host and one device, over any number of successive connections.

    Attributes
    ----------
    state : state of the session, see `session_states`. device : last reply to HELLO, None before the first.
    device_state, fault : as the device last reported.
    decoder : decoder of this connection, with its counters. events, records : streams that the device sends unasked.
    dropped_frames : number of intact frames of another session or without meaning.
    """

    def __init__(self, token: Callable[[], int] = lambda: secrets.randbits(31) + 1) -> None:
        self._token = token
        self.state = SessionState.NEW
        self.device: m.HelloReply | None = None
        self.device_state = State.IDLE
        self.fault: Fault | None = None
        self.events, self.records = EventStream(), RecordStream()
        self.dropped_frames = 0
        self._news: list[News] = []
        self._stops = Stops()
        self._begin(0)

    def _begin(self, session: int) -> None:
        """Reset everything that belongs to one connection."""
        self._session, self.decoder, self._patience = session, Decoder(), Patience()
        self._requests = Requests(session, self._patience)
        self._upload: Upload | None = None
        self._image = b""
        self._configuration_sha256 = self._library_sha256 = m.NO_HASH  # requested in this connection
        self._configuration_there = self._library_there = m.NO_HASH  # known to be active on the device
        self._clock: ClockRegression | None = None
        self._bytes_seen, self._connect_until_s = 0, 0.0
        self._unanswered_s: float | None = None  # time of the first frame sent since the last one received
        self._lease_ms, self._next_lease_s, self._lease_number = LEASE_DEFAULT_MS, 0.0, 0

    # What the user asks for.

    def connect(self, now_s: float, timeout_s: float = 2.0) -> None:
        """Send HELLO; Connected or Ended is reported within `timeout_s`."""
        self._go(Trigger.CONNECT)
        self._begin(self._token())
        self._connect_until_s = now_s + timeout_s
        self._requests.add(m.Hello(m.MAGIC, m.PROTOCOL, self._token()))

    def configure(self, configuration: bytes, *, anew: bool = False) -> None:
        """Activate a configuration (`configuration.configuration_of`), unless it is active already.

        anew : send it even then, so that the device discards its evidence.
        """
        self._go(Trigger.PREPARE)
        device = self._known()
        self._configuration_sha256 = sha256(configuration)
        if self._configuration_there == self._configuration_sha256 and not anew:
            self._news.append(t.Completed(Kind.CONFIGURE_COMMIT, skipped=True))
            return
        # Both are unknown until the request is done; the device drops a library that does not fit the configuration.
        self._configuration_there = self._library_there = m.NO_HASH
        chunk = device.body_limit - m.Configure.FORMAT.size
        parts = [m.Configure(at, configuration[at : at + chunk]) for at in range(0, len(configuration), chunk)]
        self._requests.add(*parts, m.ConfigureCommit(self._configuration_sha256))

    def upload(self, image: bytes) -> None:
        """Activate a library (`image.image_of`), unless it is active already.

        Raises
        ------
        InputError : the image exceeds the device's capacity; the message tells what would fit. The session continues.
        """
        device = self._known() if self.state in OPEN else None
        reason = None if device is None else too_large(image, capacity_of(device))
        if reason is not None:
            raise InputError(reason)
        self._go(Trigger.PREPARE)
        if self._upload is not None or self._requests.holds(m.UploadBegin, m.Commit):
            self._misused("one upload at a time")
        self._library_sha256 = sha256(image)
        if self._library_there == self._library_sha256:
            self._news += [t.Progress(len(image), len(image)), t.Completed(Kind.COMMIT, skipped=True)]
            return
        self._image, self._library_there = image, m.NO_HASH
        self._requests.add(m.UploadBegin(len(image), self._library_sha256))

    def arm(self, gain: float, lease_ms: int = LEASE_DEFAULT_MS, *, trial: bool = False) -> None:
        """Arm with the configuration and the library of this connection. trial : the bring-up check's own tap.

        Raises
        ------
        InputError : the lease or the gain is out of the range that every device has.
        """
        checked("lease_ms", lease_ms, LEASE_LEAST_MS, LEASE_MOST_MS, " ms")
        checked("gain", gain, 0.0, 1.0)
        self._go(Trigger.ARM)
        if m.NO_HASH in (self._configuration_sha256, self._library_sha256):
            self._misused("arm: configure and upload come first")
        self._lease_ms = lease_ms
        self._requests.add(m.Arm(int(trial), lease_ms, gain, self._configuration_sha256, self._library_sha256))

    def start(self, *, negative: bool = False) -> None:
        """Start an excitation once, while ARMED; FINISHED reports its end. negative : play it with opposite sign."""
        self._ask(m.Start(int(negative)), Trigger.START)

    def disarm(self) -> None:
        """Disarm; cancels all other requests. The lease is not renewed until the device answers."""
        self._go(Trigger.ASK)
        self._requests.clear()
        self._upload = None
        self._requests.add(m.Disarm())

    def reset(self) -> None:
        """Make the device leave FAULT, if the cause is gone."""
        self._ask(m.Reset())

    def set_gain(self, gain: float) -> None:
        self._ask(m.Gain(checked("gain", gain, 0.0, 1.0)))

    def set_telemetry(self, every: int, before: int = 0) -> None:
        """Request one record per `every` ticks, 0 for none; before : see `messages.Telemetry`."""
        ticks, kept = (int(checked("telemetry", each, 0, 0xFFFF, " ticks")) for each in (every, before))
        self._ask(m.Telemetry(ticks, kept))

    def pulse(self, current_A: float, ticks: int, pairs: int = 0) -> None:
        """Play test pulses; their end is an event. pairs : 0 for a single one, else pairs that the device judges."""
        limit_A = self._known().pulse_A if self.state in OPEN else current_A
        checked("pulse", current_A, -limit_A, limit_A, " A")
        checked("pairs", pairs, 0, 0xFF)
        self._ask(m.Pulse(current_A, int(checked("pulse", ticks, 1, 0xFFFF, " ticks")), pairs), Trigger.PREPARE)

    def evidence(self) -> None:
        """Request the evidence since the device's start under this configuration; it comes as `Witnessed`."""
        self._ask(m.Evidence())

    def surface(self, counts: float) -> None:
        """Set the surface's position, in counts along the encoder's direction."""
        self._ask(m.Surface(counts))

    def emergency_stop(self, now_s: float) -> None:
        """Send an emergency stop at once, in any state; at least three times, until the device reports FAULT."""
        self._stops.start(now_s, until_fault=self.state in OPEN and self.device_state is not State.FAULT)
        self._upload = None
        if self.state in OPEN:
            self._requests.clear()
            self._requests.add(m.Disarm())

    def unplugged(self, detail: str = "") -> None:
        """Report that the transport has failed."""
        self._end(Cause.UNPLUGGED, detail)

    def close(self) -> None:
        """End the session; nothing more is sent. Call `disarm` first: an armed device disarms only with its lease."""
        self._end(Cause.CLOSED)

    @property
    def clock(self) -> ClockFit | None:
        """Fit of host time against device ticks; None before the first heartbeat."""
        return None if self._clock is None else self._clock.fit()

    @property
    def idle(self) -> bool:
        """Whether all requests have been answered."""
        return self._requests.empty and self._upload is None

    @property
    def arming(self) -> bool:
        """Whether an ARM or DISARM is unanswered, so that the device may be armed whatever it last reported."""
        return self._requests.holds(m.Arm, m.Disarm)

    def _ask(self, message: Packed, trigger: Trigger = Trigger.ASK) -> None:
        self._go(trigger)
        self._requests.add(message)

    def _known(self) -> m.HelloReply:
        assert self.device is not None  # requests are possible only in states after a HELLO_REPLY
        return self.device

    def _go(self, trigger: Trigger) -> None:
        after = TRANSITIONS.get((self.state, trigger))
        if after is not None:
            self.state = after
        elif trigger in SEEN.values():
            raise BreachError(f"device reports {trigger.name} in {self.state.name}")
        else:
            self._misused(f"{trigger.name.lower()} in state {self.state.name}")

    def _misused(self, detail: str) -> None:
        self._end(Cause.MISUSED, detail, Trigger.MISUSE)
        raise MisuseError(detail)

    def _end(self, cause: Cause, detail: str = "", trigger: Trigger = Trigger.END) -> None:
        before = self.state
        self._go(trigger)
        if before not in OVER:
            self._requests.clear()
            self._upload = None
            self._stops.until_fault = False
            self._news.append(Ended(cause, detail))

    def _seen(self, state: int, fault: int) -> None:
        """Take over the state that the device reports."""
        if state >= len(STATES) or (fault and not isinstance(EVENTS.get(fault), Fault)):
            raise BreachError(f"state {state}, fault {fault}")
        now, why = STATES[state], EVENTS.get(fault)
        self._go(SEEN[now])
        if now is State.FAULT:
            self._stops.fault_seen()
        if (now, why) != (self.device_state, self.fault):
            self.device_state, self.fault = now, why if isinstance(why, Fault) else None
            self._news.append(t.Changed(self.device_state, self.fault))

    # What comes in.

    def receive(self, data: bytes, now_s: float) -> list[News]:
        """Process received bytes; return the events since the last call, timeouts included."""
        if self.state not in OVER:
            self._bytes_seen += len(data)
            try:
                for payload in self.decoder.feed(data):
                    self._payload(payload, now_s)
                    if self.state in OVER:
                        break
            except (BreachError, BadAckError) as breach:
                self._end(Cause.BROKE_PROTOCOL, str(breach), Trigger.BREACH)
            self._time(now_s)
        news, self._news = self._news, []
        return news

    def _payload(self, payload: bytes, now_s: float) -> None:
        try:
            frame = m.read_frame(payload)
        except m.OtherProtocolError as other:
            if self.state is SessionState.CONNECTING:
                detail = f"it speaks {other.protocol}, the host {m.PROTOCOL}"
                self._end(Cause.NOT_OURS if other.foreign else Cause.OTHER_VERSION, "" if other.foreign else detail)
            return
        except BadBodyError:
            self.dropped_frames += 1
            return
        if frame.session != self._session or (self._clock is None and not isinstance(frame.message, m.HelloReply)):
            self.dropped_frames += 1
            return
        self._unanswered_s = None
        match frame.message:
            case m.HelloReply() | m.Done() | m.Refused() | m.UploadReady() | m.EvidenceReply() as answer:
                request = self._requests.answered(frame.sequence, now_s)
                if request is not None:
                    self._answer(request, answer, now_s)
            case m.LeaseReply() as reply:
                self._lease_reply(reply, now_s)
            case m.Ack(wanted) if self._upload is not None:
                if self._upload.acknowledge(wanted, now_s):
                    self._news.append(t.Progress(wanted, len(self._image)))
            case m.Event() as event:
                self._news += self.events.take(event)
            case m.TelemetryData() as data:
                self._news += self.records.take(data)
            case m.Log(text):
                self._news.append(t.Logged(text.decode("utf-8", "replace")))
            case _:
                self.dropped_frames += 1

    def _answer(self, request: Packed, answer: Packed, now_s: float) -> None:
        kind = m.KINDS[type(request)]
        match request, answer:
            case m.Hello(), m.HelloReply() if answer.nonce == request.nonce:
                self._hello_reply(answer, now_s)
            case m.UploadBegin(), m.UploadReady(offset) if offset <= len(self._image):
                chunk = min(m.DATA_LIMIT, self._known().body_limit - m.Data.FORMAT.size)
                self._upload = Upload(self._image, offset, self._known().upload_frames, chunk, self._patience)
                self._news.append(t.Progress(offset, len(self._image)))
            case m.Evidence(), m.EvidenceReply():
                self._news += [t.Witnessed(answer), t.Completed(kind)]
            case _, m.Done() if answer.request == kind:
                self._seen(answer.state, answer.fault)
                self._done(kind)
            case _, m.Refused() if answer.request == kind and answer.reason in REASONS:
                self._seen(answer.state, answer.fault)
                self._requests.forget_waiting()
                self._news.append(t.Refused(kind, REASONS[answer.reason], answer.value))
            case _:
                raise BreachError(f"{type(answer).__name__} to {type(request).__name__}")

    def _done(self, kind: Kind) -> None:
        if kind is Kind.CONFIGURE_COMMIT:
            self._configuration_there = self._configuration_sha256
        elif kind is Kind.COMMIT:
            self._library_there = self._library_sha256
        elif kind is Kind.TELEMETRY:
            self.records.restart()
        if kind is not Kind.CONFIGURE:
            self._news.append(t.Completed(kind))

    def _hello_reply(self, reply: m.HelloReply, now_s: float) -> None:
        if reply.body_limit < LEAST_BODY or not 0 < reply.dt_s < 1:
            raise BreachError(f"body limit {reply.body_limit}, period {reply.dt_s:g} s")
        restarted, self.device = self.device is not None and self.device.boot != reply.boot, reply
        self._configuration_there, self._library_there = reply.configuration_sha256, reply.library_sha256
        self.events.connected(reply.boot, reply.event)
        self._clock = ClockRegression(reply.dt_s)
        self._next_lease_s = now_s
        self._news.append(t.Connected(reply, capacity_of(reply), restarted))
        self._seen(reply.state, reply.fault)

    def _lease_reply(self, reply: m.LeaseReply, now_s: float) -> None:
        if self._clock is not None and reply.host_us * 1e-6 <= now_s + 1e-6:
            self._clock.add(reply.host_us * 1e-6, now_s, reply.tick)
        self._seen(reply.state, reply.fault)

    def _time(self, now_s: float) -> None:
        """Check the timeouts."""
        if self.state is SessionState.CONNECTING:
            if now_s >= self._connect_until_s:
                if self._bytes_seen:
                    self._end(Cause.NOT_OURS, f"{self._bytes_seen} bytes, none of them a reply")
                else:
                    self._end(Cause.NO_ANSWER)
        elif self.state in OPEN:
            if self._unanswered_s is not None and now_s - self._unanswered_s >= SILENCE_S:
                self._end(Cause.SILENT, f"for {now_s - self._unanswered_s:.2f} s")
            elif self._requests.overdue(now_s) or (self._upload is not None and self._upload.stalled(now_s)):
                name = "Data" if self._upload is not None else type(self._requests.open).__name__
                self._end(Cause.BROKE_PROTOCOL, f"no answer to {name}", Trigger.BREACH)

    # What goes out.

    def bytes_to_send(self, now_s: float) -> bytes:
        """All bytes that are due at `now_s`."""
        frames = [self._loose(m.EmergencyStop())] if self._stops.due(now_s) else []
        if self.state not in OVER:
            if self.events.ack_due:
                self.events.ack_due = False
                frames.append(self._loose(m.EventAck(self.events.wanted)))
            if self._upload is not None and self._upload.complete:
                self._upload = None
                self._requests.add_first(m.Commit())
            if self._upload is not None:
                frames += [self._loose(data) for data in self._upload.frames(now_s)]
            else:
                asked = self._requests.frame(now_s)
                frames += [] if asked is None else [asked]
                if asked is not None and isinstance(self._requests.open, m.Arm):
                    # The heartbeat of a device at rest may be slower than the lease that begins here.
                    self._next_lease_s = min(self._next_lease_s, now_s)
            if self._leasing and now_s >= self._next_lease_s:
                armed = self.state is SessionState.ARMED or isinstance(self._requests.open, m.Arm)
                self._next_lease_s = now_s + min(
                    self._lease_ms * 1e-3 / LEASES_PER_TERM if armed else 1.0, HEARTBEAT_S
                )
                self._lease_number = (self._lease_number + 1) % 0x10000
                lease = m.Lease(max(int(now_s * 1e6), 0))
                frames.append(m.Frame(self._lease_number, self._session, lease))
            if frames and self._unanswered_s is None:
                self._unanswered_s = now_s
        return b"".join(encode(frame.payload()) for frame in frames)

    def _loose(self, message: Packed) -> m.Frame:
        return m.Frame(0, self._session, message)

    @property
    def _leasing(self) -> bool:
        # No lease is renewed while a DISARM is unanswered: even if the DISARM is lost, the device then disarms.
        return self._clock is not None and not isinstance(self._requests.open, m.Disarm)

    def next_deadline_s(self) -> float:
        """Latest time of the next call of `receive` and `bytes_to_send`; infinity if only bytes matter."""
        deadlines = [self._stops.deadline_s]
        if self.state is SessionState.CONNECTING:
            deadlines.append(self._connect_until_s)
        elif self.state in OPEN and self._unanswered_s is not None:
            deadlines.append(self._unanswered_s + SILENCE_S)
        if self.state not in OVER:
            upload = self._upload
            due = self._requests.deadline_s() if upload is None else upload.deadline_s
            if upload is not None and (upload.complete or due is None):
                due = float("-inf")
            deadlines += [] if due is None else [due]
            deadlines += [float("-inf")] if self.events.ack_due else []
            deadlines += [self._next_lease_s] if self._leasing else []
        return min(deadlines, default=float("inf"))
