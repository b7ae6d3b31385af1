"""The host session's states and every transition between them, in one table (after h11).

What a trigger may not do in a state does not stand in the table: out of turn from the host it is a misuse, from the
device a breach of the protocol, and either ends the session until another connect. Nothing in the table leads to
ARMED but the device's report that it is armed; only the user's ARM makes the device report so.
"""

from enum import Enum, auto

from controller.servo.interface import State


class MisuseError(RuntimeError):
    """The program asked for something out of turn; the session is over until another connect."""


class SessionState(Enum):
    NEW = auto()  # never connected
    CONNECTING = auto()  # HELLO is under way
    READY = auto()  # the device is IDLE
    ARMED = auto()  # the device is ARMED or PLAYING
    FAULTED = auto()  # the device is in FAULT
    ENDED = auto()  # unplugged, silent, closed, no device of ours
    MISUSED = auto()  # the host's error
    BROKEN = auto()  # the device's error


class Trigger(Enum):
    CONNECT = auto()  # the user's
    ASK = auto()  # any request but those below
    ARM = auto()
    START = auto()  # of an excitation
    PREPARE = auto()  # configuration, upload, pulse
    IDLE_SEEN = auto()  # the device's reports
    ACTIVE_SEEN = auto()
    FAULT_SEEN = auto()
    END = auto()  # silence, unplugged, closed, not our device
    MISUSE = auto()
    BREACH = auto()


S, T = SessionState, Trigger
OPEN = (S.READY, S.ARMED, S.FAULTED)
OVER = (S.NEW, S.ENDED, S.MISUSED, S.BROKEN)

TRANSITIONS: dict[tuple[SessionState, Trigger], SessionState] = {
    **{(state, T.CONNECT): S.CONNECTING for state in OVER},
    **{(state, T.ASK): state for state in OPEN},
    (S.READY, T.ARM): S.READY,
    (S.ARMED, T.START): S.ARMED,
    (S.READY, T.PREPARE): S.READY,
    **{(state, T.IDLE_SEEN): S.READY for state in (S.CONNECTING, *OPEN)},
    **{(state, T.ACTIVE_SEEN): S.ARMED for state in OPEN},
    **{(state, T.FAULT_SEEN): S.FAULTED for state in (S.CONNECTING, *OPEN)},
    **{(state, T.END): S.ENDED for state in (S.NEW, S.CONNECTING, *OPEN)},
    **{(state, T.END): state for state in (S.ENDED, S.MISUSED, S.BROKEN)},
    **{(state, T.MISUSE): S.MISUSED for state in (S.NEW, S.CONNECTING, *OPEN, S.MISUSED)},
    **{(state, T.MISUSE): state for state in (S.ENDED, S.BROKEN)},
    **{(state, T.BREACH): S.BROKEN for state in (S.CONNECTING, *OPEN)},
}
SEEN = {
    State.IDLE: T.IDLE_SEEN,
    State.ARMED: T.ACTIVE_SEEN,
    State.PLAYING: T.ACTIVE_SEEN,
    State.FAULT: T.FAULT_SEEN,
}
