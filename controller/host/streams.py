"""Streams that the device sends unasked, put in order: each event once, telemetry with its gaps counted."""

from controller.protocol.codes import EVENTS, STATES
from controller.protocol.events import Happened, Samples
from controller.protocol.messages import Event, Record, TelemetryData

NUMBERS = 1 << 32


class BreachError(Exception):
    """The device broke the protocol: its message is invalid or does not fit what it sent before."""


class EventStream:
    """Events in order, over any number of connections to a device that has not restarted.

    Attributes
    ----------
    wanted : number of the next event. ack_due : whether this number must be sent to the device.
    """

    def __init__(self) -> None:
        self.wanted, self.ack_due = 0, False
        self._boot: int | None = None

    def connected(self, boot: int, oldest: int) -> None:
        """Resume at a HELLO: acknowledged events are not reported again, unless the device has restarted."""
        if boot != self._boot or oldest > self.wanted:
            self.wanted = oldest
        self._boot, self.ack_due = boot, False

    def take(self, event: Event) -> list[Happened]:
        """The event to report; empty if it was reported before, or if an earlier event is still missing."""
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
    """Telemetry since the last request for it.

    Attributes
    ----------
    missed : number of records lost so far.
    """

    def __init__(self) -> None:
        self.missed = self._next = 0

    def restart(self) -> None:
        """Start a new stream, numbered from 0."""
        self._next = 0

    def take(self, data: TelemetryData) -> list[Samples]:
        """The samples to report; empty if they were reported before."""
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
