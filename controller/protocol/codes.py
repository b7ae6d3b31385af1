"""Small numbers on the wire and what they mean: message kinds, reasons, events, states.

Append only, and raise `messages.PROTOCOL` when something changes its number.
"""

from enum import Enum, IntEnum

from controller.servo.interface import Fault, Notice, State


class Kind(IntEnum):
    """Below 64 from the host, above from the device."""

    HELLO = 1
    CONFIGURE = 2
    CONFIGURE_COMMIT = 3
    UPLOAD_BEGIN = 4
    DATA = 5
    COMMIT = 6
    ARM = 7
    LEASE = 8
    DISARM = 9
    RESET = 10
    GAIN = 11
    TELEMETRY = 12
    PULSE = 13
    EVIDENCE = 14
    EVENT_ACK = 15
    EMERGENCY_STOP = 16
    START = 17
    SURFACE = 18
    HELLO_REPLY = 64
    DONE = 65
    REFUSED = 66
    UPLOAD_READY = 67
    ACK = 68
    LEASE_REPLY = 69
    EVENT = 70
    TELEMETRY_DATA = 71
    LOG = 72
    EVIDENCE_REPLY = 73


class Reason(Enum):
    """Why the device refused; the value is the message to the user. On the wire: the place in this list, from 1."""

    NOT_IDLE = "the device is armed or playing: disarm it first"
    FAULT_LATCHED = "a fault is latched: remove its cause, then reset"
    FAULT_REMAINS = "the cause of the fault is still there: remove it, then reset again"
    NO_CONFIGURATION = "the device has no configuration: configure it first"
    NO_LIBRARY = "the device has no library in force: upload one first"
    WRONG_CONFIGURATION = "the device's configuration is not the one asked for: configure it again"
    WRONG_LIBRARY = "the device's library is not the one asked for: upload it again"
    NO_PULSE = (
        "no sound test pulse under this configuration since the device started, or since a fault of encoder, current "
        "or accelerometer: run `check`"
    )
    NOT_AT_REST = "the stylus is moving: hold it still, then arm"
    TOO_HOT = "the coil is too hot to play: let it cool"
    BAD_LEASE = "the lease must be 50 to 1000 ms"
    BAD_VALUE = "a value is no number or outside its range"
    PULSING = "a test pulse is still running: try again"
    TOO_LARGE = "the library is larger than the device's memory"
    BAD_OFFSET = "data came for a place that is not the next one: start again"
    INCOMPLETE = "not all of the data has arrived: send the rest"
    WRONG_HASH = "the data that arrived is not what was announced: send it again"
    BAD_FORMAT = "the data is not in the format this firmware reads: bring host and firmware to one version"
    BAD_CONFIGURATION = "the configuration contradicts itself or a number in it is out of range"
    BAD_AXES = "speeds or grips are not finite and strictly increasing"
    BAD_TIMING = "servo period or lead differ between library, configuration and device"
    OVER_LIMIT = "a waveform passes the current or the command limit of the configuration"
    NO_ZERO_TAIL = "a waveform does not end in zero commands"
    BEYOND_HARDWARE = "the configuration, by its scales too, asks for more than the hardware allows: lower its limits"
    ONE_WAVEFORM = "this configuration plays one waveform at the host's word: upload one speed and one grip"
    NOT_ARMED = "the device is not armed: arm it, then start"
    BY_CONTACT = "this configuration plays at a contact, not at the host's word: configure it for an excitation"
    STILL_PLAYING = "something is playing: wait for its end"
    NO_TRIAL = "no finished trial of this library under this configuration since the device started: run `check`"
    OTHER_PULSE = "pairs of pulses are those that the configuration states and predicts: ask for them"
    CURRENT_FLOWS = (
        "a current flows that nobody commanded: check amplifier, supply and the monitor's zero, then try again"
    )
    WALL_PUSHES = "the wall pushes against the stylus: lift it off the surface, then move the surface"


# Unit of the number that a refusal states, where it can be of one kind only.
REFUSED_UNITS = {
    Reason.NOT_AT_REST: "m/s",
    Reason.TOO_HOT: "C",
    Reason.BAD_LEASE: "ms",
    Reason.OVER_LIMIT: "A",
    Reason.BAD_TIMING: "s",
    Reason.CURRENT_FLOWS: "A",
    Reason.WALL_PUSHES: "A",
}


class Stage(IntEnum):
    """How far the device's evidence has come."""

    NOTHING = 0
    PULSING = 1
    PULSED = 2
    TRIAL = 3
    TRIED = 4


class LinkNotice(Enum):
    """Notices of a device on a link, in addition to the servo's notices and faults."""

    LEASE_LOST = "the host was silent for longer than its lease: disarmed, no command"
    PULSE_ENDED = "the test pulse has ended"
    PULSE_CUT = "the test pulse was cut short by a fault, a stop or a host that fell silent"


What = Notice | Fault | LinkNotice
# Faults that take the evidence, since their remedy is at a cable of encoder, amplifier or accelerometer: what is
# plugged in anew may be reversed. The grip is no part of the evidence.
EVIDENCE_FAULTS = (
    Fault.BAD_SENSOR,
    Fault.ENCODER_JUMP,
    Fault.ENCODER_STUCK,
    Fault.OVER_CURRENT,
    Fault.NO_CURRENT,
    Fault.WRONG_CURRENT,
    Fault.ACCELEROMETER_DEAD,
)
STATES = tuple(State)  # code: place in this list
REASONS = dict(enumerate(Reason, 1))
# Code on the wire -> event; 0 means no event.
EVENTS: dict[int, What] = {
    **dict(enumerate(Notice, 1)),
    **dict(enumerate(LinkNotice, 32)),
    **dict(enumerate(Fault, 64)),
}
EVENT_CODES: dict[What, int] = {what: code for code, what in EVENTS.items()}
NOTHING = 0  # no event, no fault
