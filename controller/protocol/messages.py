"""The message table, for Python and (by `core_header`) for C: kinds, bodies, codes.

A frame's payload is a header of 8 bytes and a body of at most 1024, little-endian, without padding:

    kind u8, flags u8 (0), sequence u16, session u32, body

Each kind's body is the dataclass below of that name: its fields in order, in the format that the annotation names.
Names end in units. The last field may be open (`Tail`), its length is what is left.

    host asks, device answers with the same sequence    HELLO -> HELLO_REPLY, UPLOAD_BEGIN -> UPLOAD_READY,
                                                        EVIDENCE -> EVIDENCE_REPLY, all others -> DONE;
                                                        instead of these REFUSED
    beside that, in any order                           DATA -> ACK, LEASE -> LEASE_REPLY, EVENT_ACK, EMERGENCY_STOP
    the device on its own                               EVENT, TELEMETRY_DATA, LOG

One request is open at a time. The same sequence again is a repetition: it gets the same answer, and is not carried
out twice; an older one is dropped. HELLO opens the session its header names, and everything else from another session
is dropped, but for EMERGENCY_STOP.
"""

import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from operator import attrgetter
from typing import dataclass_transform

import numpy as np

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
from transopt.base.signals import FloatArray

PROTOCOL = 6
MAGIC = 0x54504E54  # "TNPT": a frame of somebody else's protocol does not begin so
HEADER = struct.Struct("<BBHI")
GREETING = struct.Struct("<IH")  # magic and protocol, the beginning of HELLO and HELLO_REPLY in every version
BODY_LIMIT = 1024
NO_HASH = bytes(HASH_BYTES)
NO_COUNTS = -(2**31)  # of an encoder that gave no number
STOP_PRESSED = 1  # flag of a record
PULSE_SOUND, TRIAL_FINISHED = 1, 2  # bits of evidence


class OtherProtocolError(ValueError):
    """HELLO or HELLO_REPLY of another version, or of somebody else's protocol."""

    def __init__(self, magic: int, protocol: int) -> None:
        super().__init__(f"magic {magic:08x}, protocol {protocol}")
        self.foreign, self.protocol = magic != MAGIC, protocol


MESSAGES: dict[Kind, type[Packed]] = {}


@dataclass_transform(frozen_default=True)
def message(kind: Kind) -> Callable[[Message], Message]:
    """Class decorator: the body of a frame of this kind."""

    def laid_out(body: Message) -> Message:
        body = packed(body)
        MESSAGES[kind] = body
        return body

    return laid_out


# Host to device.


@message(Kind.HELLO)
class Hello(Packed):
    """Magic and protocol come first in every version, so that two versions can tell each other theirs."""

    magic: U32
    protocol: U16
    nonce: U32


@message(Kind.CONFIGURE)
class Configure(Packed):
    """A part of the configuration (`configuration`), in any order."""

    offset: U32
    data: Tail


@message(Kind.CONFIGURE_COMMIT)
class ConfigureCommit(Packed):
    """In force from the answer on; IDLE only.

    The coil's temperature and the flowing current survive it. The evidence and the surface are forgotten, also by the
    same configuration once more: so a host drops evidence after a check that failed by its own judgement.
    """

    sha256: Hash


@message(Kind.UPLOAD_BEGIN)
class UploadBegin(Packed):
    """A library image (`image`) is coming; goes on where the same one was interrupted."""

    length: U32
    sha256: Hash


@message(Kind.DATA)
class Data(Packed):
    """A part of the image; taken only at the wanted offset, and every one is answered with ACK."""

    offset: U32
    data: Tail


@message(Kind.COMMIT)
class Commit(Packed):
    """Check the image whole, then play from it; until then the one before stays in force.

    Another library than the one before has its own trial still to come.
    """


@message(Kind.ARM)
class Arm(Packed):
    """trial 1: the bring-up check's own tap, gain at most `capacity.TRIAL_GAIN`; it needs PULSE_SOUND alone.

    The trial counts where a least current was played and measured: `capacity.TRIAL_LIBRARY_PART` of the library's
    peak.
    """

    trial: U8
    lease_ms: U16
    gain: F64
    configuration_sha256: Hash
    library_sha256: Hash


@message(Kind.LEASE)
class Lease(Packed):
    """The host is there; while ARMED or PLAYING the device disarms by itself `lease_ms` after the last one.

    Test pulses end `capacity.PULSE_LEASE_MS` after the last one.
    """

    host_us: U64


@message(Kind.DISARM)
class Disarm(Packed):
    pass


@message(Kind.RESET)
class Reset(Packed):
    """Leave FAULT for IDLE."""


@message(Kind.GAIN)
class Gain(Packed):
    gain: F64


@message(Kind.TELEMETRY)
class Telemetry(Packed):
    """One record every so many ticks; 0 for none.

    before : 0 sends them as they come. Otherwise none is sent until a waveform plays, and only so many of the newest
        are kept until then. What a slow line does not carry of those that follow is kept too and comes afterwards, as
        far as the device has room: its own, and that of the next library while none is arriving.
    """

    every: U16
    before: U16


@message(Kind.PULSE)
class Pulse(Packed):
    """Test pulses, IDLE and at rest only; PULSE_ENDED tells the end.

    Before each lies a rest of `capacity.REST_BETWEEN_PULSES_S`. pairs 0 : a single pulse, of which nothing is
    judged. Otherwise so many pairs of the pulse that the configuration states, with alternating sign; after the first
    that is wrong no other follows. At the end the device judges them (EVIDENCE).
    """

    current_A: F64
    ticks: U16
    pairs: U8


@message(Kind.EVIDENCE)
class Evidence(Packed):
    """What has the device seen of itself since it started under this configuration?"""


@message(Kind.EVENT_ACK)
class EventAck(Packed):
    """All events below this number have been told to the user."""

    wanted: U32


@message(Kind.EMERGENCY_STOP)
class EmergencyStop(Packed):
    """Obeyed from any session, in any state, never answered: the fault's event is the answer."""


@message(Kind.START)
class Start(Packed):
    """Play the one waveform of a configuration that the host starts, ARMED only; negative 1: with the other sign.

    PLAYING from the answer on, FINISHED tells the end; an event of a fault, a disarming or a lost lease ends it too.
    """

    negative: U8


@message(Kind.SURFACE)
class Surface(Packed):
    """Tell where the surface is, in counts of the encoder after its direction; not while PLAYING or in FAULT.

    In place of the configuration's `surface_counts` until the next CONFIGURE_COMMIT; the evidence stays. As after
    ARM, no wall pushes and no contact plays before the stylus has been above it.
    """

    counts: F64


# Device to host.


@message(Kind.HELLO_REPLY)
class HelloReply(Packed):
    """Who the device is, what it holds, what it does.

    boot : another after every start. real_bytes : 8 computes in double, 4 in float. fault : event code, 0 for none.
    evidence : bits PULSE_SOUND and TRIAL_FINISHED. simulated : 1 for a device of which nothing is wired.
    event : number of the oldest event not yet acknowledged. Hashes are zero for what is not there.
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
    """The request of this kind has been carried out."""

    request: U8
    state: U8
    fault: U8


@message(Kind.REFUSED)
class Refused(Packed):
    """`value` is the number that offended, NaN if there is none."""

    request: U8
    reason: U8
    state: U8
    fault: U8
    value: F64


@message(Kind.UPLOAD_READY)
class UploadReady(Packed):
    offset: U32


@message(Kind.ACK)
class Ack(Packed):
    """Everything below this offset has arrived."""

    wanted: U32


@message(Kind.LEASE_REPLY)
class LeaseReply(Packed):
    host_us: U64
    tick: U64
    state: U8
    fault: U8


@message(Kind.EVENT)
class Event(Packed):
    """Numbered without gaps from 0 at each start of the device, sent again until acknowledged.

    lost : events that found no room in the device's queue so far. speed, grip : NaN where no contact is meant.
    scale, cooled : of SCALED_FOR_HEAT, else NaN: what is played is scale times a blend with a part `cooled`, 0 to 1,
    of the cool command and the rest of the first.
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
    """Records of ticks tick, tick + every, ...; `first` numbers them, so that gaps can be counted.

    The first after TELEMETRY that could be sent has the number 0.
    """

    first: U32
    tick: U64
    every: U16
    records: Tail


@message(Kind.LOG)
class Log(Packed):
    """For people: UTF-8."""

    text: Tail


@message(Kind.EVIDENCE_REPLY)
class EvidenceReply(Packed):
    """The device's own evidence, for this start and this configuration; TRIAL_FINISHED for the library in force.

    bits : PULSE_SOUND, TRIAL_FINISHED. stage : `codes.Stage`. pulses : judged since the last PULSE.
    Ratios, measured on predicted, 1 for a sound device and NaN where not measured: of the pulses' current, of the
    acceleration at their beginning, of the path to their end; and, at the contact of the last trial, of the encoder's
    motion on the accelerometer's, over the half second before.
    """

    bits: U8
    stage: U8
    pulses: U16
    current_ratio: F64
    acceleration_ratio: F64
    path_ratio: F64
    speed_ratio: F64


KINDS: dict[type[Packed], Kind] = {message: kind for kind, message in MESSAGES.items()}
DATA_LIMIT = BODY_LIMIT - Data.FORMAT.size  # bytes of an image in one frame
RECORDS_LIMIT = (BODY_LIMIT - TelemetryData.FORMAT.size) // Record.FORMAT.size


def column(records: Iterable[Record], name: str) -> FloatArray:
    """(n,) one field of records."""
    return np.fromiter(map(attrgetter(name), records), dtype=float)


@dataclass(frozen=True, slots=True)
class Frame:
    """A message with its header."""

    sequence: int
    session: int
    message: Packed

    def payload(self) -> bytes:
        return HEADER.pack(KINDS[type(self.message)], 0, self.sequence, self.session) + self.message.pack()


def read_frame(payload: bytes) -> Frame:
    """What a sound payload says.

    Raises
    ------
    BadBodyError : unknown kind, flags of a later version, a body of the wrong length.
    OtherProtocolError : HELLO or its reply, by another protocol.
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
