"""What the steps of the bring-up check share: the device, the person at it, what was read, what was found."""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from typing import Protocol

import numpy as np

from controller.device.device_file import BUILT_IN, DeviceFile
from controller.host.diagnosis import Ratios, diagnosis
from controller.host.driver import Device
from controller.protocol.codes import LinkNotice
from controller.protocol.events import Changed, Happened, News, Samples
from controller.protocol.messages import Record, column
from controller.servo.interface import Fault, Notice
from controller.servo.settings import Settings
from transopt.base.signals import FloatArray
from transopt.library.library import Library

PATIENCE_S = 30.0  # for what a person has to do
KEPT_S = 6.0
WINDOW_S = 0.3  # over which readings are averaged
STILL_M, STILL_COUNTS = 0.3e-3, 2  # in that time; a hand's tremor is 0.1 mm each way


class Person(Protocol):
    """Whoever stands at the device."""

    def asked(self, what: str) -> None:
        """To do something; returns at once."""
        ...


class FailedError(Exception):
    """A step cannot go on; the text says what was seen instead."""


class Check:
    """The state that the steps share.

    Parameters
    ----------
    device : connected, IDLE, with configuration and library if there are any; every record of telemetry on.
    settings : of its configuration.
    loaded : whether it has configuration and library.
    described : what its owner says of it.
    library : that it holds; None without one.
    grip_weight_N : of a known weight that the grip sensor is checked with; None without one.
    configuration : in force; None without one.
    take_measured : puts a configuration in force that predicts the test pulse as it was measured, per ampere, and
        returns its settings; None where a library predicts it.

    Attributes
    ----------
    every : ticks from one record to the next; more than one on a line that does not carry each.
    found : ratios of what was seen to what was expected, as far as the steps have come.
    remarks : on what is off at rest, in words.
    """

    def __init__(
        self,
        device: Device,
        settings: Settings,
        person: Person,
        *,
        loaded: bool,
        described: DeviceFile = BUILT_IN,
        library: Library | None = None,
        grip_weight_N: float | None = None,
        configuration: bytes | None = None,
        take_measured: Callable[[float], Settings] | None = None,
        patience_s: float = PATIENCE_S,
    ) -> None:
        self.device, self.settings, self.person, self.loaded = device, settings, person, loaded
        self.described, self.library, self.grip_weight_N = described, library, grip_weight_N
        self.take_measured, self.patience_s = take_measured, patience_s
        self.configuration = configuration
        self.found = Ratios()
        self.remarks: list[str] = []
        self.dt_s, self.every = device.hello.dt_s, 1
        self.records: deque[tuple[int, Record]] = deque(maxlen=round(KEPT_S / self.dt_s))
        self.happened: list[Happened] = []
        self.missed = 0
        self.still_counts = max(round(STILL_M / settings.count_m), STILL_COUNTS)
        device.listeners.append(self._take)

    def close(self) -> None:
        self.device.listeners.remove(self._take)

    def _take(self, news: News) -> None:
        if isinstance(news, Samples):
            self.missed += news.missed
            self.records.extend((news.tick + j * news.every, r) for j, r in enumerate(news.records))
        elif isinstance(news, Happened):
            self.happened.append(news)

    @property
    def off(self) -> list[str]:
        """Sentences on what is off, one for each part; empty if nothing that could be named is."""
        return [*self.remarks, *diagnosis(self.found)]

    def note(self, **ratios: float) -> None:
        """Keep what a step has found."""
        self.found = replace(self.found, **ratios)

    def wait(self, met: Callable[[], bool], limit_s: float) -> bool:
        """Until it is so; False if it is not within the limit. A fault that nobody asked for ends the step."""
        return met() or self.device.listen(limit_s, until=lambda news: self._unless(news) or met())

    def _unless(self, news: News) -> bool:
        if isinstance(news, Changed) and news.fault not in (None, Fault.EMERGENCY_STOP):
            assert news.fault is not None
            raise FailedError(f"fault: {news.fault.value}")
        return False

    def ticks(self, duration_s: float) -> int:
        """Whole servo periods in it."""
        return round(duration_s / self.dt_s)

    def rows(self, duration_s: float) -> int:
        """Records that come in it."""
        return round(duration_s / (self.every * self.dt_s))

    def look(self, every: int, before: int = 0) -> None:
        """Take one record of so many ticks from now on, see `Device.set_telemetry`."""
        self.device.set_telemetry(every, before)
        self.every = every
        self.forget()

    @contextmanager
    def every_tick(self, before: int = 0) -> Iterator[None]:
        """Take a record of every tick; a device keeps what its line does not carry.

        Parameters
        ----------
        before : not 0 waits for a waveform, and has so many from before it.
        """
        every = self.every
        if every > 1 or before:
            self.look(1, before)
        try:
            yield
        finally:
            if self.every != every or before:
                self.look(every)

    def catch_up(self, tick: int) -> None:
        """Wait for the records up to a tick, for as long as any come."""
        self.device.catch_up(lambda: self.records[-1][0] if self.records else -1, tick)

    def came(self, what: Notice | LinkNotice, begin: int) -> Happened | None:
        """The first such event since there were `begin` of them."""
        return next((event for event in self.happened[begin:] if event.what is what), None)

    def wait_for(self, what: Notice | LinkNotice, begin: int, limit_s: float) -> Happened | None:
        """Wait for the first such event; None if it does not come within the limit."""
        self.wait(lambda: self.came(what, begin) is not None, limit_s)
        return self.came(what, begin)

    def column(self, name: str, duration_s: float = WINDOW_S) -> FloatArray:
        """The newest readings of so long a time."""
        newest = islice(reversed(self.records), self.rows(duration_s))
        return column((record for _, record in newest), name)[::-1]

    def mean(self, name: str) -> float:
        """Mean of a whole window; NaN before one has come."""
        return float(self.column(name).mean()) if self.is_window_full else float("nan")

    @property
    def is_window_full(self) -> bool:
        """Whether readings of a whole window have come."""
        return len(self.records) >= self.rows(WINDOW_S)

    def forget(self) -> None:
        """Forget what was read before now."""
        self.records.clear()

    def still(self, most_counts: float) -> bool:
        """Whether a whole window has come in which the counts stayed within so many."""
        return self.is_window_full and float(np.ptp(self.column("encoder_counts"))) <= most_counts

    def at_rest(self) -> bool:
        """Whether a whole window has come in which the stylus was still."""
        return self.still(self.still_counts)

    def need_rest(self) -> None:
        """
        Raises
        ------
        FailedError : the stylus does not come to rest.
        """
        self.forget()
        if not self.wait(self.at_rest, self.patience_s):
            counts = self.column("encoder_counts")
            raise FailedError(f"no rest: {np.ptp(counts) if counts.size else 0:.0f} counts in {WINDOW_S:g} s")
