"""Queue of the host's requests: one is outstanding at a time and is repeated until answered."""

from collections import deque
from dataclasses import dataclass

from controller.host.upload import Patience
from controller.protocol.messages import Frame
from controller.protocol.packed import Packed

STOP_COPIES, STOP_EVERY_S = 3, 0.01
GIVE_UP_S = 5.0  # longest wait for the answer to one request of a device that is otherwise alive


@dataclass(slots=True)
class _Asked:
    frame: Frame
    first_s: float | None = None
    next_s: float = 0.0
    tries: int = 0


class Requests:
    """First-in first-out queue; each request gets the next sequence number."""

    def __init__(self, session: int, patience: Patience) -> None:
        self._session, self._patience = session, patience
        self._waiting: deque[Packed] = deque()
        self._asked: _Asked | None = None
        self._sequence = 0

    @property
    def open(self) -> Packed | None:
        """The outstanding request; None if there is none."""
        return None if self._asked is None else self._asked.frame.message

    @property
    def empty(self) -> bool:
        return self._asked is None and not self._waiting

    def add(self, *messages: Packed) -> None:
        self._waiting.extend(messages)

    def add_first(self, *messages: Packed) -> None:
        """Put messages before all that wait."""
        self._waiting.extendleft(reversed(messages))

    def forget_waiting(self) -> None:
        self._waiting.clear()

    def clear(self) -> None:
        self._waiting.clear()
        self._asked = None

    def holds(self, *kinds: type[Packed]) -> bool:
        """Whether a request of these kinds is outstanding or waits."""
        return any(isinstance(request, kinds) for request in (self.open, *self._waiting))

    def frame(self, now_s: float) -> Frame | None:
        """The frame to send now; None if there is none."""
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
        """The request that an answer belongs to; None if the answer is a repetition or unexpected."""
        asked = self._asked
        if asked is None or asked.first_s is None or asked.frame.sequence != sequence:
            return None
        if asked.tries == 1:
            self._patience.seen(now_s - asked.first_s)
        self._patience.progressed()
        self._asked = None
        return asked.frame.message

    def overdue(self, now_s: float) -> bool:
        """Whether the outstanding request has gone unanswered for too long."""
        asked = self._asked
        return asked is not None and asked.first_s is not None and now_s - asked.first_s >= GIVE_UP_S

    def deadline_s(self) -> float | None:
        """Time to call `frame` again; minus infinity if a request waits, None if there is nothing to do."""
        if self._asked is not None:
            return self._asked.next_s
        return float("-inf") if self._waiting else None


class Stops:
    """Schedule of the emergency stop: at once, at least three times, and on until the device reports FAULT.

    Attributes
    ----------
    until_fault : whether to repeat until the device reports FAULT.
    """

    def __init__(self) -> None:
        self._left, self._next_s, self.until_fault = 0, 0.0, False

    def start(self, now_s: float, *, until_fault: bool) -> None:
        self._left, self._next_s, self.until_fault = STOP_COPIES, now_s, until_fault

    def fault_seen(self) -> None:
        self.until_fault = False

    @property
    def deadline_s(self) -> float:
        """Time of the next stop; infinity if there is none."""
        return self._next_s if self._left or self.until_fault else float("inf")

    def due(self, now_s: float) -> bool:
        """Whether a stop must be sent now; it then counts as sent."""
        if now_s < self.deadline_s:
            return False
        self._left, self._next_s = max(self._left - 1, 0), now_s + STOP_EVERY_S
        return True
