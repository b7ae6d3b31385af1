"""What the device tells on its own, put back in order: events once each, telemetry with its gaps counted."""

from controller.protocol.codes import EVENTS, STATES
from controller.protocol.events import Happened, Samples
from controller.protocol.messages import Event, Record, TelemetryData

NUMBERS = 1 << 32


class BreachError(Exception):
    """What the device sent cannot follow what was said before."""


class EventStream:
    """Events in order; goes on over any number of connections with a device that has not started anew.

    Attributes
    ----------
    wanted : number of the next event to tell. ack_due : whether the device waits to hear that number.
    """

    def __init__(self) -> None:
        self.wanted, self.ack_due = 0, False
        self._boot: int | None = None

    def connected(self, boot: int, oldest: int) -> None:
        """A device greets: what it has reported before and the host has acknowledged is not reported again."""
        if boot != self._boot or oldest > self.wanted:
            self.wanted = oldest
        self._boot, self.ack_due = boot, False

    def take(self, event: Event) -> list[Happened]:
        """What to report: nothing if it was reported already, or if one before it is still to come."""
        self.ack_due = True
        if event.number != self.wanted:
            return []
        what = EVENTS.get(event.code)
        if what is None:
            raise BreachError(f"event code {event.code}")
        self.wanted = (self.wanted + 1) % NUMBERS
        place = event.speed_m_s, event.grip_N
        return [Happened(event.number, event.tick, what, *place, event.lost, event.scale, event.cooled)]


class RecordStream:
    """Telemetry since it was last asked for.

    Attributes
    ----------
    missed : records lost so far.
    """

    def __init__(self) -> None:
        self.missed = self._next = 0

    def restart(self) -> None:
        """The device numbers from 0 again."""
        self._next = 0

    def take(self, data: TelemetryData) -> list[Samples]:
        """What to report: nothing if it was reported already."""
        size = Record.FORMAT.size
        if not data.records or len(data.records) % size or not data.every:
            raise BreachError(f"telemetry of {len(data.records)} bytes")
        missed = (data.first - self._next) % NUMBERS
        if missed >= NUMBERS // 2:
            return []
        records = tuple(Record(*values) for values in Record.FORMAT.iter_unpack(data.records))
        if any(record.state >= len(STATES) for record in records):
            raise BreachError("telemetry: state out of range")
        self.missed += missed
        self._next = (data.first + len(records)) % NUMBERS
        return [Samples(data.tick, data.every, records, missed)]
