"""State shared by the steps of the bring-up check: the device, the person at it, readings and results."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from operator import attrgetter
from typing import Protocol

import numpy as np

from controller.device.device_file import BUILT_IN, DeviceFile
from controller.host.diagnosis import Ratios, diagnosis
from controller.host.driver import Device
from controller.protocol.codes import LinkNotice
from controller.protocol.events import Changed, Happened, News, Samples
from controller.protocol.messages import Record
from controller.servo.interface import Fault, Notice
from controller.servo.settings import Settings
from transopt.base.signals import FloatArray
from transopt.library.library import Library

PATIENCE_S = 30.0  # longest wait for a person to do what is asked
KEPT_S = 6.0  # newest telemetry that is kept
WINDOW_S = 0.3  # readings are averaged over this time
STILL_M, STILL_COUNTS = 0.3e-3, 2  # motion within the window that counts as rest; a hand's tremor is +-0.1 mm


class Person(Protocol):
    """Whoever stands at the device."""

    def asked(self, what: str) -> None:
        """Ask the person to do something; return at once."""
        ...


class Readings:
    """The newest records of a device, in columns, so that a condition on hundreds of them is read at each message.

    Parameters
    ----------
    most : number of records that are kept.
    """

    _OF = attrgetter(*Record.NAMES)

    def __init__(self, most: int) -> None:
        self.most = most
        self._kept, self._begin, self._end = np.empty((2 * most, 1 + len(Record.NAMES))), 0, 0

    def __len__(self) -> int:
        return self._end - self._begin

    def add(self, samples: Samples) -> None:
        ticks = range(samples.tick, samples.tick + samples.every * len(samples.records), samples.every)
        rows = np.array([(tick, *self._OF(each)) for tick, each in zip(ticks, samples.records, strict=True)])
        rows = rows[-self.most :]
        if self._end + len(rows) > len(self._kept):
            # Half of the memory is free again, once in as many records.
            newest = self._kept[self._begin : self._end]
            self._kept[: len(newest)] = newest.copy()
            self._begin, self._end = 0, len(newest)
        self._kept[self._end : self._end + len(rows)] = rows
        self._end += len(rows)
        self._begin = max(self._begin, self._end - self.most)

    def clear(self) -> None:
        self._begin = self._end

    def column(self, name: str) -> FloatArray:
        """(n,) one field of each; valid until the next message."""
        return self._kept[self._begin : self._end, 1 + Record.NAMES.index(name)]

    @property
    def newest(self) -> int | None:
        """Tick of the newest; None before one has come."""
        return int(self._kept[self._end - 1, 0]) if len(self) else None


class FailedError(Exception):
    """A step cannot continue; the text tells what was seen instead."""


class Check:
    """The state that the steps share.

    Parameters
    ----------
    device : connected and IDLE, with configuration and library if there are any, sending telemetry of every tick.
    settings : settings of its configuration.
    loaded : whether it has configuration and library.
    described : its device file.
    library : the library on the device; None without one.
    grip_weight_N : known weight to check the grip sensor with; None without one.
    configuration : the active configuration; None without one.
    take_measured : function that activates a configuration with the measured response to the test pulse (per ampere)
        as its prediction, and returns its settings; None if a library predicts it.

    Attributes
    ----------
    every : ticks from one record to the next; more than one on a line too slow for every tick.
    found : ratios of seen to expected values that the steps have measured so far.
    remarks : sentences on readings that are wrong at rest.
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
        self.records = Readings(round(KEPT_S / self.dt_s))
        self.happened: list[Happened] = []
        self.missed = 0
        self.still_counts = max(round(STILL_M / settings.count_m), STILL_COUNTS)
        device.listeners.append(self._take)

    def close(self) -> None:
        self.device.listeners.remove(self._take)

    def _take(self, news: News) -> None:
        if isinstance(news, Samples):
            self.missed += news.missed
            self.records.add(news)
        elif isinstance(news, Happened):
            self.happened.append(news)

    @property
    def off(self) -> list[str]:
        """One sentence for each part that is off; empty if none could be identified."""
        return [*self.remarks, *diagnosis(self.found)]

    def note(self, **ratios: float) -> None:
        """Store ratios that a step has measured."""
        self.found = replace(self.found, **ratios)

    def wait(self, met: Callable[[], bool], limit_s: float) -> bool:
        """Wait until `met` is true; False if it is not within the limit. Any fault but the emergency stop raises."""
        return met() or self.device.listen(limit_s, until=lambda news: self._unless(news) or met())

    def _unless(self, news: News) -> bool:
        if isinstance(news, Changed) and news.fault not in (None, Fault.EMERGENCY_STOP):
            assert news.fault is not None
            raise FailedError(f"fault: {news.fault.value}")
        return False

    def ticks(self, duration_s: float) -> int:
        """Number of servo periods in a duration."""
        return round(duration_s / self.dt_s)

    def rows(self, duration_s: float) -> int:
        """Number of records that come in a duration."""
        return round(duration_s / (self.every * self.dt_s))

    def look(self, every: int, before: int = 0) -> None:
        """Request one record per `every` ticks from now on, see `Device.set_telemetry`."""
        self.device.set_telemetry(every, before)
        self.every = every
        self.forget()

    @contextmanager
    def every_tick(self, before: int = 0) -> Iterator[None]:
        """Request a record of every tick within the block; the device buffers what a slow line does not carry.

        Parameters
        ----------
        before : if not 0, records start with the next waveform, this many ticks before it.
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
        """Wait for the records up to a tick, as long as records keep coming."""
        self.device.catch_up(lambda: -1 if self.records.newest is None else self.records.newest, tick)

    def came(self, what: Notice | LinkNotice, begin: int) -> Happened | None:
        """The first event of this kind from index `begin` of `happened` on; None if there is none."""
        return next((event for event in self.happened[begin:] if event.what is what), None)

    def wait_for(self, what: Notice | LinkNotice, begin: int, limit_s: float) -> Happened | None:
        """Wait for the first event of this kind from index `begin` on; None if it does not come within the limit."""
        self.wait(lambda: self.came(what, begin) is not None, limit_s)
        return self.came(what, begin)

    def column(self, name: str, duration_s: float = WINDOW_S) -> FloatArray:
        """The newest readings, up to this duration of them."""
        found = self.records.column(name)
        return found[max(found.size - self.rows(duration_s), 0) :]

    def mean(self, name: str) -> float:
        """Mean over the newest window; NaN before a whole window has come."""
        return float(self.column(name).mean()) if self.is_window_full else float("nan")

    @property
    def is_window_full(self) -> bool:
        """Whether the readings fill a whole window."""
        return len(self.records) >= self.rows(WINDOW_S)

    def forget(self) -> None:
        """Discard all readings up to now."""
        self.records.clear()

    def still(self, most_counts: float) -> bool:
        """Whether the encoder's range over a whole window is at most `most_counts`."""
        return self.is_window_full and float(np.ptp(self.column("encoder_counts"))) <= most_counts

    def at_rest(self) -> bool:
        """Whether the stylus was at rest for a whole window."""
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
