"""The host session's states and every transition between them, in one table (after h11).

A transition that is not in the table is not allowed: caused by the host it is a misuse, by the device a breach of the
protocol; either ends the session until the next connect. Only the device's report that it is armed leads to ARMED,
and only the user's ARM makes the device report so.
"""

from enum import Enum, auto

from controller.servo.interface import State


class MisuseError(RuntimeError):
    """The program made a call that the state does not allow; the session is over until the next connect."""


class SessionState(Enum):
    NEW = auto()  # never connected
    CONNECTING = auto()  # HELLO is under way
    READY = auto()  # the device is IDLE
    ARMED = auto()  # the device is ARMED or PLAYING
    FAULTED = auto()  # the device is in FAULT
    ENDED = auto()  # unplugged, silent, closed, or not a transopt device
    MISUSED = auto()  # by an error of the host
    BROKEN = auto()  # by an error of the device


class Trigger(Enum):
    CONNECT = auto()  # by the user, as the next four
    ASK = auto()  # any request but the next three
    ARM = auto()
    START = auto()  # start of an excitation
    PREPARE = auto()  # configuration, upload, pulse
    IDLE_SEEN = auto()  # reported by the device, as the next two
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
