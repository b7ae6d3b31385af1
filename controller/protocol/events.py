"""Events that a session reports to its user: frozen, in the order in which they happened."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from operator import attrgetter

import numpy as np

from controller.protocol.capacity import Capacity
from controller.protocol.codes import REFUSED_UNITS, Kind, Reason, What
from controller.protocol.messages import EvidenceReply, HelloReply, Record
from controller.servo.interface import Fault, State
from transopt.base.signals import FloatArray


class Cause(Enum):
    """Why a session ended; the value is the message and the remedy."""

    NO_ANSWER = "nothing answers on this port: is the device powered, and its firmware running?"
    NOT_OURS = "not our device: it sends, but not this protocol; choose another port or flash the firmware"
    OTHER_VERSION = "the device speaks another version of the protocol: bring host and firmware to one version"
    SILENT = "the device has fallen silent: reset, off or with another host? Connect again; it does not arm by itself"
    UNPLUGGED = "the connection is gone: plug the device in and connect again; it does not arm by itself"
    CLOSED = "closed by the host"
    BROKE_PROTOCOL = "the device broke the protocol: reset it, and report this"
    MISUSED = "the program asked for something out of turn"


@dataclass(frozen=True, slots=True)
class Connected:
    """The device has answered HELLO. restarted : it has restarted since the last connection and lost its state."""

    device: HelloReply
    capacity: Capacity
    restarted: bool


@dataclass(frozen=True, slots=True)
class Completed:
    """A request has been carried out. skipped : nothing was sent, since the device had it already."""

    request: Kind
    skipped: bool = False


@dataclass(frozen=True, slots=True)
class Refused:
    """A request was refused, and those queued behind it are cancelled. value : offending number, NaN if none."""

    request: Kind
    reason: Reason
    value: float

    def __str__(self) -> str:
        number = f"{self.value:g} {REFUSED_UNITS.get(self.reason, '')}".rstrip()
        seen = "" if self.value != self.value else f" (device saw {number})"
        return f"{self.request.name.lower().replace('_', ' ')} refused: {self.reason.value}{seen}"


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of an upload, in bytes that have arrived."""

    done: int
    total: int


@dataclass(frozen=True, slots=True)
class Changed:
    """The state that the device last reported has changed."""

    state: State
    fault: Fault | None


@dataclass(frozen=True, slots=True)
class Happened:
    """An event of the device, reported exactly once.

    lost : number of events so far that the device's queue had no room for.
    scale, cooled : see `controller.servo.interface.Event`.
    """

    number: int
    tick: int
    what: What
    speed_m_s: float
    grip_N: float
    lost: int
    scale: float = float("nan")
    cooled: float = float("nan")


@dataclass(frozen=True, slots=True)
class Samples:
    """Telemetry of ticks tick, tick + every, ... missed : records lost before these."""

    tick: int
    every: int
    records: tuple[Record, ...]
    missed: int


@dataclass(frozen=True, slots=True)
class Witnessed:
    """The device's evidence, on request."""

    evidence: EvidenceReply


@dataclass(frozen=True, slots=True)
class Logged:
    text: str


@dataclass(frozen=True, slots=True)
class Ended:
    """The session is over; no event follows before the next connect."""

    cause: Cause
    detail: str = ""

    def __str__(self) -> str:
        return f"{self.cause.value} ({self.detail})" if self.detail else self.cause.value


News = Connected | Completed | Refused | Progress | Changed | Happened | Samples | Witnessed | Logged | Ended


def column(records: Iterable[Record], name: str) -> FloatArray:
    """(n,) one field of records."""
    return np.fromiter(map(attrgetter(name), records), dtype=float)


def capacity_of(reply: HelloReply) -> Capacity:
    """The capacity that a device states in its reply to HELLO."""
    return Capacity(
        samples=reply.capacity_samples,
        speeds=reply.capacity_speeds,
        grips=reply.capacity_grips,
        waveform_samples=reply.capacity_waveform_samples,
        approach_ticks=reply.capacity_approach_ticks,
        latency_ticks=reply.capacity_latency_ticks,
        upload_frames=reply.upload_frames,
    )
