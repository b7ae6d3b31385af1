"""The interface between the servo and the device under it at each tick, the same for a simulator and for hardware."""

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, Protocol


class State(Enum):
    """State of the servo; FAULT latches until an explicit reset."""

    IDLE = "idle"
    ARMED = "armed"
    PLAYING = "playing"
    FAULT = "fault"


class Fault(Enum):
    """Why the servo went to FAULT; the value is the message and the remedy."""

    OVER_TEMPERATURE = "the coil is too hot: let it cool, then reset"
    BAD_SENSOR = "a sensor gave no number or an absurd one: check its wiring, reset, then `check`"
    ENCODER_JUMP = "the encoder moved faster than a hand can: check its cable, reset, then `check`"
    ENCODER_STUCK = "current flows but the encoder does not move: check coupling and encoder, reset, then `check`"
    GRIP_OPEN = "the grip sensor reads as if it were not connected: check its cable, then reset"
    GRIP_SHORT = "the grip sensor reads as if it were shorted: check its cable, then reset"
    GRIP_LOST = "the stylus was let go while a transient played: hold it, then reset"
    OVER_CURRENT = "the measured current is above the limit: check the amplifier, reset, then `check`"
    NO_CURRENT = "a command was given but no current flows: check amplifier and motor cable, reset, then `check`"
    EMERGENCY_STOP = "emergency stop: release it, then reset"
    HOST_STOP = "the host has stopped the device: reset when it may go on"
    LATE_TICK = "a servo period came late: report this, then reset"
    WRONG_CURRENT = (
        "another current flows than was commanded: check amplifier, supply and monitor, reset, then `check`"
    )
    ACCELEROMETER_DEAD = (
        "current shakes the stylus but the accelerometer is silent: check its cable, reset, then `check`"
    )


class Notice(Enum):
    """Occurrences that are reported but stop nothing; the value is the message."""

    CONTACT = "contact: a transient starts"
    FINISHED = "the transient has ended"
    COMMAND_SATURATED = "transient and feedback together were cut at a limit"
    CONTACT_CHATTER = "a contact came too soon after the last and was not played"
    OUT_OF_GRID = "speed or grip lay outside the library's grid and was moved to its edge"
    TOO_HOT_TO_PLAY = "the transient was withheld: the coil is close to its limit"
    SCALED_FOR_HEAT = "the transient was made cooler, or scaled down, to keep the coil's margin"
    NO_GRIP = "no transient: the stylus is not held, or too loosely"


class Readings(NamedTuple):
    """Readings of the sensors at one tick.

    Attributes
    ----------
    tick : servo tick, from 0.
    encoder_counts : motor encoder; counts grow with z, out of the object.
    grip_N : calibrated reading of the grip sensor; NaN without one.
    current_A : measured by the amplifier.
    acceleration_m_s2 : of the stylus; the servo only checks it against encoder and current.
    emergency_stop : whether the emergency stop is pressed.
    late : whether the port reports this tick as late, so that a command was held for too long.
    host_stop : whether a stop has come over the link since the last tick.
    """

    tick: int
    encoder_counts: int
    grip_N: float
    current_A: float
    acceleration_m_s2: float
    emergency_stop: bool = False
    late: bool = False
    host_stop: bool = False


@dataclass(frozen=True, slots=True)
class Event:
    """An event at a tick; `speed_m_s` and `grip_N` are set for events of a contact.

    SCALED_FOR_HEAT also sets `scale`, the factor on the blend, and `cooled`, the share of the cool command in it.
    """

    tick: int
    what: Notice | Fault
    speed_m_s: float = float("nan")
    grip_N: float = float("nan")
    scale: float = float("nan")
    cooled: float = float("nan")


class Output(NamedTuple):
    """Output of the servo for the readings of one tick.

    Attributes
    ----------
    command_A : total command, within all limits. transient_A, feedback_A : its parts before the clamp.
    winding_C : estimated winding temperature.
    """

    command_A: float
    state: State
    transient_A: float
    feedback_A: float
    winding_C: float
    events: tuple[Event, ...] = ()


class Plant(Protocol):
    """A device under the servo: read the sensors, then let one servo period pass under a held command."""

    def readings(self) -> Readings: ...

    def advance(self, command_A: float) -> None: ...
