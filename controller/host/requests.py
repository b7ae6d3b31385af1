"""Requests of the host, one under way at a time, asked again until answered."""

from collections import deque
from dataclasses import dataclass

from controller.host.upload import Patience
from controller.protocol.messages import Frame
from controller.protocol.packed import Packed

STOP_COPIES, STOP_EVERY_S = 3, 0.01
GIVE_UP_S = 5.0  # a device that is there but does not answer this one question


@dataclass(slots=True)
class _Asked:
    frame: Frame
    first_s: float | None = None
    next_s: float = 0.0
    tries: int = 0


class Requests:
    """First in, first out; each gets the next sequence number."""

    def __init__(self, session: int, patience: Patience) -> None:
        self._session, self._patience = session, patience
        self._waiting: deque[Packed] = deque()
        self._asked: _Asked | None = None
        self._sequence = 0

    @property
    def open(self) -> Packed | None:
        """The one that is under way."""
        return None if self._asked is None else self._asked.frame.message

    @property
    def empty(self) -> bool:
        return self._asked is None and not self._waiting

    def add(self, *messages: Packed) -> None:
        self._waiting.extend(messages)

    def add_first(self, *messages: Packed) -> None:
        """Before all that wait."""
        self._waiting.extendleft(reversed(messages))

    def forget_waiting(self) -> None:
        self._waiting.clear()

    def clear(self) -> None:
        self._waiting.clear()
        self._asked = None

    def holds(self, *kinds: type[Packed]) -> bool:
        """Whether such a request is under way or waits."""
        return any(isinstance(request, kinds) for request in (self.open, *self._waiting))

    def frame(self, now_s: float) -> Frame | None:
        """What is to be sent now, if anything."""
        if self._asked is None:
            if not self._waiting:
                return None
            self._sequence = (self._sequence + 1) % 0x10000
            self._asked = _Asked(Frame(self._sequence, self._session, self._waiting.popleft()), next_s=now_s)
        asked = self._asked
        if now_s < asked.next_s:
            return None
        if asked.first_s is None:
            asked.first_s = now_s
        else:
            self._patience.in_vain()
        asked.tries += 1
        asked.next_s = now_s + self._patience.now_s()
        return asked.frame

    def answered(self, sequence: int, now_s: float) -> Packed | None:
        """The request that an answer belongs to; None if it is a repetition or of none."""
        asked = self._asked
        if asked is None or asked.first_s is None or asked.frame.sequence != sequence:
            return None
        if asked.tries == 1:
            self._patience.seen(now_s - asked.first_s)
        self._patience.progressed()
        self._asked = None
        return asked.frame.message

    def overdue(self, now_s: float) -> bool:
        """Whether the one under way has been asked in vain for too long."""
        asked = self._asked
        return asked is not None and asked.first_s is not None and now_s - asked.first_s >= GIVE_UP_S

    def deadline_s(self) -> float | None:
        """When to come back; minus infinity: now, something waits to be asked."""
        if self._asked is not None:
            return self._asked.next_s
        return float("-inf") if self._waiting else None


class Stops:
    """When an emergency stop is due: at once, thrice, and on until the device is seen in FAULT.

    Attributes
    ----------
    until_fault : whether the device's report is waited for.
    """

    def __init__(self) -> None:
        self._left, self._next_s, self.until_fault = 0, 0.0, False

    def start(self, now_s: float, *, until_fault: bool) -> None:
        self._left, self._next_s, self.until_fault = STOP_COPIES, now_s, until_fault

    def fault_seen(self) -> None:
        self.until_fault = False

    @property
    def deadline_s(self) -> float:
        """Infinity if none is to come."""
        return self._next_s if self._left or self.until_fault else float("inf")

    def due(self, now_s: float) -> bool:
        """Whether one has to go out now; it then counts as sent."""
        if now_s < self.deadline_s:
            return False
        self._left, self._next_s = max(self._left - 1, 0), now_s + STOP_EVERY_S
        return True
