"""The device's end of the protocol in front of a `Servo`, sans-IO: bytes and readings in, commands and bytes out.

    receive(data)          whatever came over the link since the last call
    step(readings)         one servo period: the command to hold until the next
    bytes_to_send()        what goes out since the last call

It knows no clock but its ticks and no link but bytes, and is the oracle of the C core. Not thread-safe: one thread
calls all three. On a microcontroller `step` runs in the timer's interrupt and the others between.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

from controller.device.outbox import EventQueue, RecordBatch
from controller.device.store import RefusedError, Store
from controller.protocol import messages as m
from controller.protocol.capacity import (
    EVENT_REPEAT_MS,
    LEASE_LEAST_MS,
    LEASE_MOST_MS,
    LINK_SILENCE_MS,
    PULSE_LIMIT_A,
    PULSE_LIMIT_S,
    REST_SPEED_M_S,
    TELEMETRY_HOLD_MS,
    TRIAL_GAIN,
    Capacity,
    Hardware,
)
from controller.protocol.codes import EVENT_CODES, NOTHING, REASON_CODES, STATES, Kind, LinkNotice, Reason
from controller.protocol.packed import BadBodyError, Packed
from controller.protocol.wire import Decoder, encode
from controller.servo.interface import Fault, Output, Readings, State
from controller.servo.servo import Servo

FIRMWARE = 1 << 16 | 1 << 8  # major, minor, patch: 16, 8, 8 bits
OUTPUT_LIMIT_BYTES = 65_536  # telemetry that nobody fetches is dropped beyond
ACTIVE = (State.ARMED, State.PLAYING)


class Device:
    """One device from one start to the next.

    Parameters
    ----------
    boot : another number at every start.

    Attributes
    ----------
    servo : None before a configuration is in force. tick : of the last readings.
    dropped_frames : sound frames that were not for this session, out of order, or of no meaning.
    """

    def __init__(self, boot: int, capacity: Capacity | None = None, hardware: Hardware | None = None) -> None:
        self.boot = boot
        self.capacity = Capacity() if capacity is None else capacity
        self.hardware = Hardware() if hardware is None else hardware
        self.servo: Servo | None = None
        self.store = Store(self.capacity, self.hardware)
        self.checked_sha256 = m.NO_HASH
        self.tick = self.dropped_frames = 0
        self._decoder, self._out, self._out_bytes = Decoder(), deque[bytes](), 0
        self._session: int | None = None
        self._sequence, self._reply = 0, b""  # of the last request
        self._stop_wanted = self._stop_latched = self._stop_pressed = self._trial = False
        self._lease_ticks = self._lease_left = self._pulse_left = 0
        self._pulse_A = 0.0
        self._silent_ticks = 0
        self._events = EventQueue(self._ticks(EVENT_REPEAT_MS))
        self._records = RecordBatch(self._ticks(TELEMETRY_HOLD_MS))
        self._requests: dict[Kind, Callable[[Any], Packed | None]] = {
            Kind.CONFIGURE: self._configure,
            Kind.CONFIGURE_COMMIT: self._configure_commit,
            Kind.UPLOAD_BEGIN: self._upload_begin,
            Kind.COMMIT: self._commit,
            Kind.ARM: self._arm,
            Kind.DISARM: self._disarm,
            Kind.RESET: self._reset,
            Kind.GAIN: self._gain,
            Kind.TELEMETRY: self._telemetry,
            Kind.PULSE: self._pulse,
            Kind.CHECKED: self._checked,
            Kind.START: self._start,
        }

    @property
    def state(self) -> State:
        if self.servo is not None:
            return self.servo.state
        return State.FAULT if self._stop_latched else State.IDLE

    @property
    def fault(self) -> Fault | None:
        if self.servo is not None:
            return self.servo.fault
        return Fault.EMERGENCY_STOP if self._stop_latched else None

    # Bytes in and out.

    def receive(self, data: bytes) -> None:
        for payload in self._decoder.feed(data):
            try:
                frame = m.read_frame(payload)
            except m.OtherProtocolError as other:
                # Another version learns ours; whoever is not of ours learns nothing.
                if not other.foreign and payload[0] == Kind.HELLO:
                    _, _, sequence, session = m.HEADER.unpack_from(payload)
                    self._send(m.Frame(sequence, session, self._hello_reply(0)))
                continue
            except BadBodyError:
                self.dropped_frames += 1
                continue
            self._handle(frame)

    def bytes_to_send(self) -> bytes:
        data, self._out_bytes = b"".join(self._out), 0
        self._out.clear()
        return data

    def _send(self, frame: m.Frame) -> bytes:
        data = encode(frame.payload())
        self._put(data)
        return data

    def _put(self, data: bytes) -> None:
        self._out.append(data)
        self._out_bytes += len(data)

    def _tell(self, message: Packed) -> None:
        if self._session is not None:
            self._send(m.Frame(0, self._session, message))

    def _handle(self, frame: m.Frame) -> None:
        message, kind = frame.message, m.KINDS[type(frame.message)]
        if kind is Kind.EMERGENCY_STOP:
            self._stop_wanted = True
        elif isinstance(message, m.Hello):
            self._hello(frame, message.nonce)
        elif frame.session != self._session or kind >= Kind.HELLO_REPLY:
            # What only devices send is no sign of a host.
            self.dropped_frames += 1
        else:
            self._silent_ticks = 0
            if isinstance(message, m.Lease):
                self._lease_left = self._lease_ticks
                reply = m.LeaseReply(message.host_us, self.tick, STATES.index(self.state), self._fault_code())
                self._send(m.Frame(frame.sequence, frame.session, reply))
            elif isinstance(message, m.Data):
                self._data(message)
            elif isinstance(message, m.EventAck):
                self._events.acknowledge(message.wanted)
            elif kind in self._requests:
                self._request(frame, kind)
            else:
                self.dropped_frames += 1

    def _request(self, frame: m.Frame, kind: Kind) -> None:
        newer = (frame.sequence - self._sequence) % 0x10000
        if newer == 0:
            self._put(self._reply)
        elif newer >= 0x8000:
            self.dropped_frames += 1
        else:
            try:
                answer = self._requests[kind](frame.message)
                reply = answer or m.Done(kind, STATES.index(self.state), self._fault_code())
            except RefusedError as no:
                code = REASON_CODES[no.reason]
                reply = m.Refused(kind, code, STATES.index(self.state), self._fault_code(), no.value)
            self._sequence = frame.sequence
            self._reply = self._send(m.Frame(frame.sequence, frame.session, reply))

    def _fault_code(self) -> int:
        return NOTHING if self.fault is None else EVENT_CODES[self.fault]

    # What the host asks for.

    def _hello(self, frame: m.Frame, nonce: int) -> None:
        if frame.session == self._session:
            # The one that opened this session, once more, or late.
            if frame.sequence == self._sequence:
                self._put(self._reply)
            return
        # The lease was the other session's.
        self._give_up()
        self._session, self._sequence, self._silent_ticks = frame.session, frame.sequence, 0
        self._events.restart()
        self._records.restart(0)
        self._reply = self._send(m.Frame(frame.sequence, frame.session, self._hello_reply(nonce)))

    def _hello_reply(self, nonce: int) -> m.HelloReply:
        c, h = self.capacity, self.hardware
        return m.HelloReply(
            magic=m.MAGIC,
            protocol=m.PROTOCOL,
            real_bytes=8,
            state=STATES.index(self.state),
            fault=self._fault_code(),
            body_limit=m.BODY_LIMIT,
            upload_frames=c.upload_frames,
            firmware=FIRMWARE,
            boot=self.boot,
            nonce=nonce,
            event=self._events.oldest,
            **{f"capacity_{f.name}": getattr(c, f.name) for f in fields(c) if f.name != "upload_frames"},
            tick=self.tick,
            dt_s=h.dt_s,
            current_limit_A=h.current_A,
            command_limit_A=h.command_A,
            configuration_sha256=self.store.configuration_sha256,
            library_sha256=self.store.library_sha256,
            checked_sha256=self.checked_sha256,
        )

    def _configure(self, message: m.Configure) -> None:
        self.store.configure(message.offset, message.data)

    def _configure_commit(self, message: m.ConfigureCommit) -> None:
        before = self._need_idle()
        configuration, bank = self.store.configure_commit(message.sha256)
        servo = Servo(configuration.settings, bank)
        if before is not None and before.guard is not None and servo.guard is not None:
            # The coil has not cooled because somebody sent numbers.
            servo.guard.winding_C = max(servo.guard.winding_C, before.guard.winding_C)
            servo.guard.housing_C = max(servo.guard.housing_C, before.guard.housing_C)
        self.servo = servo

    def _upload_begin(self, message: m.UploadBegin) -> m.UploadReady:
        self._need_silent()
        return m.UploadReady(self.store.begin(message.length, message.sha256))

    def _data(self, message: m.Data) -> None:
        if self.state not in ACTIVE:
            self.store.take(message.offset, message.data)
        self._tell(m.Ack(self.store.arrived))

    def _commit(self, message: m.Commit) -> None:
        self._need_silent()
        bank = self.store.commit()
        if self.servo is not None:
            self.servo.bank = bank

    def _need_silent(self) -> None:
        if self.state in ACTIVE:
            raise RefusedError(Reason.NOT_IDLE)

    def _need_idle(self) -> Servo | None:
        if self.state is State.FAULT:
            raise RefusedError(Reason.FAULT_LATCHED)
        self._need_silent()
        if self._pulse_left:
            raise RefusedError(Reason.PULSING)
        return self.servo

    def _arm(self, message: m.Arm) -> None:
        servo = self._need_idle()
        if servo is None:
            raise RefusedError(Reason.NO_CONFIGURATION)
        if message.configuration_sha256 != self.store.configuration_sha256:
            raise RefusedError(Reason.WRONG_CONFIGURATION)
        if self.store.library_sha256 == m.NO_HASH:
            raise RefusedError(Reason.NO_LIBRARY)
        if message.library_sha256 != self.store.library_sha256:
            raise RefusedError(Reason.WRONG_LIBRARY)
        if self.checked_sha256 != self.store.configuration_sha256 and message.trial != 1:
            raise RefusedError(Reason.NOT_CHECKED)
        if not LEASE_LEAST_MS <= message.lease_ms <= LEASE_MOST_MS:
            raise RefusedError(Reason.BAD_LEASE, message.lease_ms)
        if message.trial > 1:
            raise RefusedError(Reason.BAD_VALUE, message.trial)
        self._trial = message.trial == 1
        self._need_gain(message.gain)
        if servo.guard is not None and not servo.guard.winding_C <= servo.guard.play_limit_C:
            raise RefusedError(Reason.TOO_HOT, servo.guard.winding_C)
        if not abs(servo.approach.speed_m_s) <= REST_SPEED_M_S:
            raise RefusedError(Reason.NOT_AT_REST, servo.approach.speed_m_s)
        servo.set_gain(message.gain)
        servo.arm()
        self._lease_ticks = self._lease_left = self._ticks(message.lease_ms)

    def _need_gain(self, gain: float) -> None:
        if not 0.0 <= gain <= (TRIAL_GAIN if self._trial else 1.0):
            raise RefusedError(Reason.BAD_VALUE, gain)

    def _disarm(self, message: m.Disarm) -> None:
        if self.servo is not None:
            self.servo.disarm()
        self._cut_pulse()

    def _reset(self, message: m.Reset) -> None:
        if self.servo is None:
            if self._stop_pressed or self._stop_wanted:
                raise RefusedError(Reason.FAULT_REMAINS)
            self._stop_latched = False
        elif self._stop_wanted or not self.servo.reset():
            raise RefusedError(Reason.FAULT_REMAINS)

    def _gain(self, message: m.Gain) -> None:
        if self.servo is None:
            raise RefusedError(Reason.NO_CONFIGURATION)
        if self.state not in ACTIVE:
            self._trial = False
        self._need_gain(message.gain)
        self.servo.set_gain(message.gain)

    def _telemetry(self, message: m.Telemetry) -> None:
        self._records.restart(message.every)

    def _pulse(self, message: m.Pulse) -> None:
        if self._need_idle() is None:
            raise RefusedError(Reason.NO_CONFIGURATION)
        if not abs(message.current_A) <= PULSE_LIMIT_A:
            raise RefusedError(Reason.BAD_VALUE, message.current_A)
        if not 0 < message.ticks <= self._ticks(1e3 * PULSE_LIMIT_S):
            raise RefusedError(Reason.BAD_VALUE, message.ticks)
        self._pulse_A, self._pulse_left = message.current_A, message.ticks

    def _start(self, message: m.Start) -> None:
        servo = self.servo
        if self.state is State.FAULT:
            raise RefusedError(Reason.FAULT_LATCHED)
        if servo is None or self.state is State.IDLE:
            raise RefusedError(Reason.NOT_ARMED)
        if not servo.settings.host_starts:
            raise RefusedError(Reason.BY_CONTACT)
        if self.state is State.PLAYING:
            raise RefusedError(Reason.STILL_PLAYING)
        if message.negative > 1:
            raise RefusedError(Reason.BAD_VALUE, message.negative)
        if not servo.excite(negative=message.negative == 1):
            raise RefusedError(Reason.TOO_HOT, math.nan if servo.guard is None else servo.guard.winding_C)

    def _checked(self, message: m.Checked) -> None:
        if self.servo is None:
            raise RefusedError(Reason.NO_CONFIGURATION)
        if message.configuration_sha256 != self.store.configuration_sha256:
            raise RefusedError(Reason.WRONG_CONFIGURATION)
        self.checked_sha256 = message.configuration_sha256

    # One servo period.

    def step(self, readings: Readings) -> Output:
        """The command that answers one tick's readings, to be held until the next tick."""
        self.tick = readings.tick
        if self._stop_wanted:
            # As if it had been pressed for one tick: latched like any other fault.
            readings, self._stop_wanted = replace(readings, emergency_stop=True), False
        self._silent_ticks += 1
        if self.state in ACTIVE:
            if self._lease_left == 0:
                self._give_up()
            else:
                self._lease_left -= 1
        output = self._unconfigured(readings) if self.servo is None else self.servo.step(readings)
        for event in output.events:
            self._events.put(event.tick, event.what, event.speed_m_s, event.grip_N)
        if self._pulse_left:
            output = self._pulsed(output)
        records = self._records.step(readings, output)
        if self._session is not None and self._silent_ticks < self._ticks(LINK_SILENCE_MS):
            if records is not None and self._out_bytes < OUTPUT_LIMIT_BYTES:
                self._tell(records)
            for told in self._events.due():
                self._tell(told)
        return output

    def _unconfigured(self, readings: Readings) -> Output:
        self._stop_pressed = readings.emergency_stop
        if readings.emergency_stop and not self._stop_latched:
            self._stop_latched = True
            self._events.put(self.tick, Fault.EMERGENCY_STOP)
        return Output(0.0, self.state, 0.0, 0.0, math.nan)

    def _pulsed(self, output: Output) -> Output:
        if output.state is not State.IDLE:
            self._cut_pulse()
            return output
        self._pulse_left -= 1
        if self._pulse_left == 0:
            self._events.put(self.tick, LinkNotice.PULSE_ENDED)
        return replace(output, command_A=self._pulse_A)

    def _cut_pulse(self) -> None:
        if self._pulse_left:
            self._pulse_left = 0
            self._events.put(self.tick, LinkNotice.PULSE_CUT)

    def _give_up(self) -> None:
        """Without a host that is there nothing plays."""
        self._cut_pulse()
        if self.servo is not None and self.state in ACTIVE:
            self.servo.disarm()
            self._events.put(self.tick, LinkNotice.LEASE_LOST)

    def _ticks(self, duration_ms: float) -> int:
        return round(duration_ms * 1e-3 / self.hardware.dt_s)
