"""What a device tells on its own: events until they are acknowledged, telemetry once. Times are ticks."""

import math
from collections import deque

from controller.protocol.capacity import EVENT_QUEUE, EVENT_WINDOW
from controller.protocol.codes import EVENT_CODES, STATES, What
from controller.protocol.messages import NO_COUNTS, RECORDS_LIMIT, Event, Record, TelemetryData
from controller.servo.interface import Output, Readings

F32_MOST = 3.4028234663852886e38


class EventQueue:
    """Events in order, numbered without gaps; the oldest few are in flight, again and again until acknowledged."""

    def __init__(self, repeat_ticks: int) -> None:
        self._repeat_ticks = repeat_ticks
        self._queue: deque[Event] = deque()
        self._number = self._lost = self._sent = self._age = 0

    @property
    def oldest(self) -> int:
        """Number of the first event not acknowledged, of the next one if all are."""
        return self._queue[0].number if self._queue else self._number

    def put(self, tick: int, what: What, speed_m_s: float = math.nan, grip_N: float = math.nan) -> None:
        """An event without room is lost, and the events after it say so."""
        if len(self._queue) == EVENT_QUEUE:
            self._lost = min(self._lost + 1, 0xFFFF)
            return
        self._queue.append(Event(self._number, tick, EVENT_CODES[what], self._lost, speed_m_s, grip_N))
        self._number += 1

    def acknowledge(self, wanted: int) -> None:
        """Everything below `wanted` has arrived; a number that is not in the queue means nothing."""
        while self._queue and self._queue[0].number < wanted <= self._number:
            self._queue.popleft()
            self._sent = max(self._sent - 1, 0)
            self._age = 0

    def restart(self) -> None:
        """Send all that is not acknowledged once more."""
        self._sent = self._age = 0

    def due(self) -> list[Event]:
        """What is to be sent in this tick; call it once per tick while somebody listens."""
        if self._sent:
            self._age += 1
            if self._age >= self._repeat_ticks:
                self.restart()
        fresh = [self._queue[j] for j in range(self._sent, min(EVENT_WINDOW, len(self._queue)))]
        self._sent += len(fresh)
        return fresh


class RecordBatch:
    """Telemetry records of every n-th tick, sent when a frame is full or the first has waited long enough."""

    def __init__(self, hold_ticks: int) -> None:
        self._hold_ticks = hold_ticks
        self.restart(0)

    def restart(self, every: int) -> None:
        """One record every so many ticks from now on, numbered from 0; 0 for none."""
        self._every, self._skip = every, 0
        self._first = self._tick = self._age = 0
        self._records: list[bytes] = []

    def step(self, readings: Readings, output: Output) -> TelemetryData | None:
        """One tick; the frame that it completes."""
        if not self._every:
            return None
        if self._skip == 0:
            if not self._records:
                self._tick, self._age = readings.tick, 0
            self._records.append(record_of(readings, output).pack())
            self._skip = self._every
        self._skip -= 1
        self._age += 1
        if not self._records or (len(self._records) < RECORDS_LIMIT and self._age < self._hold_ticks):
            return None
        data = TelemetryData(self._first, self._tick, self._every, b"".join(self._records))
        self._first = (self._first + len(self._records)) % (1 << 32)
        self._records = []
        return data


def _narrow(value: float) -> float:
    """For a float32: what is beyond its range is infinite, as a processor would have it."""
    return math.copysign(math.inf, value) if abs(value) > F32_MOST else value


def record_of(readings: Readings, output: Output) -> Record:
    """One tick's readings and answer."""
    counts = readings.encoder_counts
    # A broken encoder gives anything, also what is no number.
    sound = -(2**31) < counts < 2**31
    return Record(
        encoder_counts=int(counts) if sound else NO_COUNTS,
        grip_N=_narrow(readings.grip_N),
        measured_current_A=_narrow(readings.current_A),
        acceleration_m_s2=_narrow(readings.acceleration_m_s2),
        command_A=output.command_A,
        transient_A=output.transient_A,
        feedback_A=output.feedback_A,
        winding_C=output.winding_C,
        state=STATES.index(output.state),
        flags=int(readings.emergency_stop),
    )
