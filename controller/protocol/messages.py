"""The message table for Python and, through `c_header`, for C: kinds, bodies, codes.

The payload of a frame is a header of 8 bytes and a body of at most 1024 bytes, little-endian, without padding:

    kind u8, flags u8 (0), sequence u16, session u32, body

The body of each kind is the dataclass below of the same name: its fields in order, in the formats of their
annotations. Names end in units. A last field of type `Tail` takes the remaining bytes.

    request of the host, reply with its sequence   HELLO -> HELLO_REPLY, UPLOAD_BEGIN -> UPLOAD_READY,
                                                   EVIDENCE -> EVIDENCE_REPLY, all others -> DONE; or REFUSED
    in any order, without a request                DATA -> ACK, LEASE -> LEASE_REPLY, EVENT_ACK, EMERGENCY_STOP
    sent by the device unasked                     EVENT, TELEMETRY_DATA, LOG

One request is open at a time. The last sequence again is a repetition: the device repeats its reply and executes
nothing; older ones are dropped. HELLO opens its session; frames of others are dropped, except EMERGENCY_STOP.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import dataclass_transform

from controller.protocol.codes import Kind
from controller.protocol.packed import (
    F32,
    F64,
    HASH_BYTES,
    I32,
    U8,
    U16,
    U32,
    U64,
    BadBodyError,
    Hash,
    Message,
    Packed,
    Tail,
    packed,
)

PROTOCOL = 6
MAGIC = 0x54504E54  # "TNPT": HELLO of another protocol does not begin with it
HEADER = struct.Struct("<BBHI")
GREETING = struct.Struct("<IH")  # magic and protocol, with which HELLO and HELLO_REPLY begin in every version
BODY_LIMIT = 1024
NO_HASH = bytes(HASH_BYTES)
NO_COUNTS = -(2**31)  # reading of an encoder that gave no number
STOP_PRESSED = 1  # flag of a record: the emergency stop is pressed
PULSE_SOUND, TRIAL_FINISHED = 1, 2  # bits of evidence


class OtherProtocolError(ValueError):
    """A HELLO or HELLO_REPLY of another version, or of a foreign protocol."""

    def __init__(self, magic: int, protocol: int) -> None:
        super().__init__(f"magic {magic:08x}, protocol {protocol}")
        self.foreign, self.protocol = magic != MAGIC, protocol


MESSAGES: dict[Kind, type[Packed]] = {}


@dataclass_transform(frozen_default=True)
def message(kind: Kind) -> Callable[[Message], Message]:
    """Class decorator: this class is the body of frames of `kind`."""

    def laid_out(body: Message) -> Message:
        body = packed(body)
        MESSAGES[kind] = body
        return body

    return laid_out


# Host to device.


@message(Kind.HELLO)
class Hello(Packed):
    """Open a session. Magic and protocol come first in every version, so that each end learns the other's version."""

    magic: U32
    protocol: U16
    nonce: U32


@message(Kind.CONFIGURE)
class Configure(Packed):
    """A part of the configuration (see `configuration`); parts come in any order."""

    offset: U32
    data: Tail


@message(Kind.CONFIGURE_COMMIT)
class ConfigureCommit(Packed):
    """Activate the configuration, from the reply on; only in IDLE.

    The estimates of coil temperature and current are kept. Evidence and surface are cleared, also when the same
    configuration is activated again: so a host discards evidence after a check that failed by its own judgement.
    """

    sha256: Hash


@message(Kind.UPLOAD_BEGIN)
class UploadBegin(Packed):
    """Begin the upload of a library image (see `image`), or resume that of the same image after an interruption.

    What was cut off is forgotten once another session asks for TELEMETRY.
    """

    length: U32
    sha256: Hash


@message(Kind.DATA)
class Data(Packed):
    """A part of the image; stored only at the wanted offset, and always answered by ACK."""

    offset: U32
    data: Tail


@message(Kind.COMMIT)
class Commit(Packed):
    """Check the whole image and activate it; until then the previous library stays active.

    A library other than the previous one requires a trial of its own.
    """


@message(Kind.ARM)
class Arm(Packed):
    """Arm the device. trial 1 : for a trial, which requires PULSE_SOUND only; gain at most `capacity.TRIAL_GAIN`.

    A trial counts if both played and measured current reached `capacity.TRIAL_LIBRARY_PART` of the library's peak.
    """

    trial: U8
    lease_ms: U16
    gain: F64
    configuration_sha256: Hash
    library_sha256: Hash


@message(Kind.LEASE)
class Lease(Packed):
    """Heartbeat of the host: without it the device disarms after `lease_ms` while ARMED or PLAYING.

    Test pulses end after `capacity.PULSE_LEASE_MS` without one. host_us : clock of the host; a LEASE whose clock has
    not advanced since the one before, in this session, renews nothing and gets no answer.
    """

    host_us: U64


@message(Kind.DISARM)
class Disarm(Packed):
    """Leave ARMED or PLAYING for IDLE, and cut test pulses."""


@message(Kind.RESET)
class Reset(Packed):
    """Leave FAULT for IDLE."""


@message(Kind.GAIN)
class Gain(Packed):
    """Change the factor on transients and feedback, also while they play; it follows in small steps."""

    gain: F64


@message(Kind.TELEMETRY)
class Telemetry(Packed):
    """Send one record per `every` ticks; none if `every` is 0.

    before : 0 sends them from now on. Otherwise the device keeps this many of the newest records, and sends them once
        a waveform plays. Records that a slow line does not carry are kept and sent later, as long as there is room:
        in the device's own memory, and in that of the next library while none is arriving.
    """

    every: U16
    before: U16


@message(Kind.PULSE)
class Pulse(Packed):
    """Play test pulses, only in IDLE and at rest; the event PULSE_ENDED reports the end.

    A rest of `capacity.REST_BETWEEN_PULSES_S` precedes each pulse. pairs 0 : a single pulse, which is not judged.
    Otherwise this many pairs of the configuration's pulse with alternating sign; the first wrong pulse is the last.
    At the end the device judges them (EVIDENCE).
    """

    current_A: F64
    ticks: U16
    pairs: U8


@message(Kind.EVIDENCE)
class Evidence(Packed):
    """Request the evidence that the device has gathered since its start under this configuration."""


@message(Kind.EVENT_ACK)
class EventAck(Packed):
    """The host has received all events below this number."""

    wanted: U32


@message(Kind.EMERGENCY_STOP)
class EmergencyStop(Packed):
    """Stop at once, in any session and any state. There is no reply but the event of the fault."""


@message(Kind.START)
class Start(Packed):
    """Play the one waveform of a configuration with `host_starts`, only in ARMED; negative 1 : with opposite sign.

    The state is PLAYING from the reply on. The event FINISHED reports the end, unless a fault, DISARM or a lost lease
    ends it before.
    """

    negative: U8


@message(Kind.SURFACE)
class Surface(Packed):
    """Set the surface, in counts along the encoder's direction; not in PLAYING or FAULT.

    It replaces the configuration's `surface_counts` until the next CONFIGURE_COMMIT; the evidence is kept. As after
    ARM, neither wall nor contact acts before the stylus has been above the surface.
    """

    counts: F64


# Device to host.


@message(Kind.HELLO_REPLY)
class HelloReply(Packed):
    """Identity, state, contents and limits of the device.

    boot : a different number after every start. real_bytes : 8 for double precision, 4 for float. fault : event code,
    0 for none. evidence : bits PULSE_SOUND and TRIAL_FINISHED. simulated : 1 if nothing is wired. event : number of
    the oldest unacknowledged event. A hash is zero if there is no configuration or library.
    From dt_s to ambient_C: `capacity.Hardware`.
    """

    magic: U32
    protocol: U16
    real_bytes: U8
    state: U8
    fault: U8
    evidence: U8
    simulated: U8
    body_limit: U16
    upload_frames: U16
    firmware: U32
    boot: U32
    nonce: U32
    event: U32
    capacity_samples: U32
    capacity_waveform_samples: U32
    capacity_speeds: U16
    capacity_grips: U16
    capacity_approach_ticks: U16
    capacity_latency_ticks: U16
    tick: U64
    dt_s: F64
    current_A: F64
    command_A: F64
    pulse_A: F64
    pulse_s: F64
    pole_least_Hz: F64
    pole_most_Hz: F64
    over_current_A: F64
    has_coil: U8
    R_ohm: F64
    R_wh_K_W: F64
    R_ha_K_W: F64
    tau_w_s: F64
    tau_h_s: F64
    limit_C: F64
    ambient_C: F64
    configuration_sha256: Hash
    library_sha256: Hash


@message(Kind.DONE)
class Done(Packed):
    """The request of this kind has been executed."""

    request: U8
    state: U8
    fault: U8


@message(Kind.REFUSED)
class Refused(Packed):
    """The request was not executed. value : the offending number; NaN if there is none."""

    request: U8
    reason: U8
    state: U8
    fault: U8
    value: F64


@message(Kind.UPLOAD_READY)
class UploadReady(Packed):
    """Send the data from this offset on; the device has those before."""

    offset: U32


@message(Kind.ACK)
class Ack(Packed):
    """All data below this offset have arrived."""

    wanted: U32


@message(Kind.LEASE_REPLY)
class LeaseReply(Packed):
    """Answer of the device to LEASE, whose `host_us` it returns: its tick, state and fault."""

    host_us: U64
    tick: U64
    state: U8
    fault: U8


@message(Kind.EVENT)
class Event(Packed):
    """An event, numbered without gaps from 0 at each start of the device; repeated until acknowledged.

    lost : number of events so far that found no room in the device's queue. speed, grip : NaN except for a contact.
    scale, cooled : for SCALED_FOR_HEAT, else NaN: the transient is scale times a blend with the share `cooled`, 0 to
    1, of the cool command.
    """

    number: U32
    tick: U64
    code: U8
    lost: U16
    speed_m_s: F64
    grip_N: F64
    scale: F64
    cooled: F64


@packed
class Record(Packed):
    """Telemetry of one tick."""

    encoder_counts: I32
    grip_N: F32
    measured_current_A: F32
    acceleration_m_s2: F32
    command_A: F32
    transient_A: F32
    feedback_A: F32
    winding_C: F32
    state: U8
    flags: U8


@message(Kind.TELEMETRY_DATA)
class TelemetryData(Packed):
    """Records of the ticks tick, tick + every, ...; `first` is the number of the first one, which reveals gaps.

    Numbers start from 0 with the first record after TELEMETRY that could be sent.
    """

    first: U32
    tick: U64
    every: U16
    records: Tail


@message(Kind.LOG)
class Log(Packed):
    """A text for people, in UTF-8."""

    text: Tail


@message(Kind.EVIDENCE_REPLY)
class EvidenceReply(Packed):
    """The device's own evidence since its start, for its configuration and, as to the trial, for its library.

    bits : PULSE_SOUND, TRIAL_FINISHED. stage : `codes.Stage`. pulses : number judged since the last PULSE.
    Ratios are measured over predicted, 1 for a sound device, NaN if not measured: current of the pulses, acceleration
    at their beginning, path until their end; before the last trial's contact, motion by encoder over accelerometer.
    """

    bits: U8
    stage: U8
    pulses: U16
    current_ratio: F64
    acceleration_ratio: F64
    path_ratio: F64
    speed_ratio: F64


KINDS: dict[type[Packed], Kind] = {message: kind for kind, message in MESSAGES.items()}
DATA_LIMIT = BODY_LIMIT - Data.FORMAT.size  # most bytes of an image in one frame
RECORDS_LIMIT = (BODY_LIMIT - TelemetryData.FORMAT.size) // Record.FORMAT.size


@dataclass(frozen=True, slots=True)
class Frame:
    """A message with its header."""

    sequence: int
    session: int
    message: Packed

    def payload(self) -> bytes:
        return HEADER.pack(KINDS[type(self.message)], 0, self.sequence, self.session) + self.message.pack()


def read_frame(payload: bytes) -> Frame:
    """The frame with this payload, whose CRC was correct.

    Raises
    ------
    BadBodyError : unknown kind, flags of a later version, or a body of the wrong length.
    OtherProtocolError : HELLO or HELLO_REPLY of another protocol.
    """
    if len(payload) < HEADER.size:
        raise BadBodyError(f"{len(payload)} bytes")
    kind, flags, sequence, session = HEADER.unpack_from(payload)
    message = MESSAGES.get(kind)
    if message is None or flags or len(payload) - HEADER.size > BODY_LIMIT:
        raise BadBodyError(f"kind {kind}, flags {flags}, {len(payload)} bytes")
    body = payload[HEADER.size :]
    if message in (Hello, HelloReply):
        if len(body) < GREETING.size:
            raise BadBodyError(f"{message.__name__}: {len(body)} bytes")
        magic, protocol = GREETING.unpack_from(body)
        if (magic, protocol) != (MAGIC, PROTOCOL):
            raise OtherProtocolError(magic, protocol)
    return Frame(sequence, session, message.unpack(body))
