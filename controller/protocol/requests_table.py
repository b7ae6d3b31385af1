"""What each request of a host is answered with, and why a device refuses it: for the manual and for tests."""

from dataclasses import dataclass

from controller.protocol.codes import Kind, Reason


@dataclass(frozen=True, slots=True)
class Request:
    """answer : kind of the answer where it is granted. states : in which it is. reasons : of a refusal."""

    answer: Kind | None
    states: str
    reasons: tuple[Reason, ...] = ()


R = Reason
_IMAGE = (R.BAD_FORMAT, R.TOO_LARGE, R.BAD_AXES, R.BAD_VALUE, R.BAD_TIMING, R.NO_ZERO_TAIL, R.OVER_LIMIT)
_IDLE = (R.FAULT_LATCHED, R.NOT_IDLE, R.PULSING)
REQUESTS: dict[Kind, Request] = {
    Kind.HELLO: Request(Kind.HELLO_REPLY, "any; disarms what another session has armed"),
    Kind.CONFIGURE: Request(Kind.DONE, "any", (R.BAD_OFFSET,)),
    Kind.CONFIGURE_COMMIT: Request(
        Kind.DONE,
        "idle",
        (*_IDLE, R.WRONG_HASH, R.BAD_FORMAT, R.BAD_VALUE, R.BAD_CONFIGURATION, R.BAD_TIMING, R.BEYOND_HARDWARE),
    ),
    Kind.UPLOAD_BEGIN: Request(Kind.UPLOAD_READY, "idle, fault", (R.NOT_IDLE, R.TOO_LARGE)),
    Kind.DATA: Request(Kind.ACK, "any; taken in idle and fault"),
    Kind.COMMIT: Request(
        Kind.DONE,
        "idle, fault",
        (R.NOT_IDLE, R.NO_CONFIGURATION, R.INCOMPLETE, R.WRONG_HASH, *_IMAGE, R.ONE_WAVEFORM),
    ),
    Kind.ARM: Request(
        Kind.DONE,
        "idle, at rest",
        (
            *_IDLE,
            R.NO_CONFIGURATION,
            R.WRONG_CONFIGURATION,
            R.NO_LIBRARY,
            R.WRONG_LIBRARY,
            R.NO_PULSE,
            R.NO_TRIAL,
            R.BAD_LEASE,
            R.BAD_VALUE,
            R.TOO_HOT,
            R.NOT_AT_REST,
        ),
    ),
    Kind.LEASE: Request(Kind.LEASE_REPLY, "any"),
    Kind.DISARM: Request(Kind.DONE, "any"),
    Kind.RESET: Request(Kind.DONE, "any", (R.FAULT_REMAINS,)),
    Kind.GAIN: Request(Kind.DONE, "any", (R.NO_CONFIGURATION, R.BAD_VALUE)),
    Kind.TELEMETRY: Request(Kind.DONE, "any"),
    Kind.PULSE: Request(
        Kind.DONE, "idle, at rest", (*_IDLE, R.NO_CONFIGURATION, R.BAD_VALUE, R.OTHER_PULSE, R.NOT_AT_REST)
    ),
    Kind.EVIDENCE: Request(Kind.EVIDENCE_REPLY, "any"),
    Kind.EVENT_ACK: Request(None, "any"),
    Kind.EMERGENCY_STOP: Request(None, "any, from any session"),
    Kind.START: Request(
        Kind.DONE,
        "armed",
        (R.FAULT_LATCHED, R.NOT_ARMED, R.BY_CONTACT, R.STILL_PLAYING, R.BAD_VALUE, R.TOO_HOT),
    ),
    Kind.SURFACE: Request(
        Kind.DONE, "idle, armed", (R.NO_CONFIGURATION, R.FAULT_LATCHED, R.STILL_PLAYING, R.BAD_VALUE)
    ),
}
