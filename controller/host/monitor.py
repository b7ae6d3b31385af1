"""Live view of a device in the terminal; its events line by line if the output is no terminal."""

import time
from collections import Counter, deque
from collections.abc import Callable

from rich.console import Console
from rich.live import Live
from rich.table import Table

from controller.protocol.codes import STATES
from controller.protocol.events import Changed, Happened, Logged, News, Samples
from controller.protocol.messages import STOP_PRESSED, Record
from controller.servo.interface import Fault, Notice, State

REFRESH_S = 0.1
EVENTS_SHOWN = 6


class Monitor:
    """A listener of `driver.Device` that shows a session's news; a context manager.

    The caller's thread draws, at most ten times a second, so that a slow terminal does not delay the lease.

    Attributes
    ----------
    events : number of each kind of event. faults : in order of arrival.
    """

    def __init__(
        self,
        console: Console,
        title: str,
        dt_s: float,
        count_m: float,
        surface_counts: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._console, self._title, self._dt_s, self._clock = console, title, dt_s, clock
        self._count_m, self._surface_counts = count_m, surface_counts
        self.events: Counter[object] = Counter()
        self.faults: list[Fault] = []
        self._tick, self._missed, self._lost = 0, 0, 0
        self._record: Record | None = None
        self._state, self._fault = State.IDLE, None  # type: State, Fault | None
        self._recent: deque[str] = deque(maxlen=EVENTS_SHOWN)
        self._drawn_s = float("-inf")
        self._live = Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None

    def take(self, news: News) -> None:
        if isinstance(news, Samples):
            self._record, self._missed = news.records[-1], self._missed + news.missed
            self._tick = news.tick + (len(news.records) - 1) * news.every
            self._state = STATES[self._record.state]
        elif isinstance(news, Changed):
            self._state, self._fault = news.state, news.fault
        elif isinstance(news, Happened):
            self.events[news.what] += 1
            if isinstance(news.what, Fault):
                self.faults.append(news.what)
            if news.lost > self._lost:
                self._lost = news.lost
                self._say(f"{news.lost} events before this one found no room in the device's queue: they are lost")
            self._say(event_line(news, self._dt_s))
        elif isinstance(news, Logged):
            self._say(f"device: {news.text}")
        if self._live is not None and self._clock() - self._drawn_s >= REFRESH_S:
            self._drawn_s = self._clock()
            self._live.update(self.table(), refresh=True)

    def table(self) -> Table:
        """The table with its present values."""
        table = Table(title=self._title, show_header=False)
        table.add_column("what", no_wrap=True, min_width=len("emergency stop"))
        # This fits 60 columns with the frame, and keeps its width while the readings change.
        table.add_column("value", min_width=38, overflow="fold")
        table.add_row("state", self._state.value if self._fault is None else f"fault: {self._fault.value}")
        table.add_row("device time", f"{self._tick * self._dt_s:.2f} s")
        r = self._record
        if r is not None:
            table.add_row("z", f"{1e3 * (r.encoder_counts - self._surface_counts) * self._count_m:+.2f} mm")
            table.add_row("grip", f"{r.grip_N:.2f} N")
            table.add_row("current", f"{r.measured_current_A:+.3f} A, command {r.command_A:+.3f} A")
            table.add_row("acceleration", f"{r.acceleration_m_s2:+.2f} m/s²")
            table.add_row("winding", f"{r.winding_C:.1f} °C" if r.winding_C == r.winding_C else "not known")
            table.add_row("emergency stop", "pressed" if r.flags & STOP_PRESSED else "released")
        table.add_row("contacts", str(self.events[Notice.CONTACT]))
        table.add_row("records lost", str(self._missed))
        for line in self._recent:
            table.add_row("", line)
        return table

    def __enter__(self) -> "Monitor":
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def _say(self, line: str) -> None:
        self._recent.append(line)
        if self._live is None:
            self._console.print(line)


def event_line(event: Happened, dt_s: float) -> str:
    """An event as one line of text."""
    where = "" if event.speed_m_s != event.speed_m_s else f" ({event.speed_m_s:.3f} m/s, {event.grip_N:.2f} N)"
    kind = "FAULT: " if isinstance(event.what, Fault) else ""
    return f"{event.tick * dt_s:9.4f} s  {kind}{event.what.value}{where}"
