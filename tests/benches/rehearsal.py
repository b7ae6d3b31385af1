"""A host session, a link and a device on one virtual clock: what a campaign and the tests run.

Steps are of one servo period. The host looks every millisecond, or when its own deadline comes.
"""

from collections.abc import Callable
from itertools import count
from typing import Generic, Self, TypeVar

from controller.firmware.core_device import DeviceEnd
from controller.host.session import Session
from controller.protocol.events import News
from controller.servo.interface import Output, Readings, State
from tests.benches.virtual_link import Link, Trouble

HOST_TICKS = 10


End = TypeVar("End", bound=DeviceEnd)


REST_S = 0.02  # a device knows of a rest only after it has read for a while


class NotWithinError(TimeoutError):
    """Something did not come about within its time."""


class Rehearsal(Generic[End]):
    """
    Parameters
    ----------
    start : a device as it is after power on, from its boot id.

    Attributes
    ----------
    told : all events so far. listeners : called with each.
    output : of the running device, the last. readings : what the device sees at a tick.
    """

    def __init__(
        self, start: Callable[[int], End], dt_s: float, trouble: Trouble | None = None, seed: int = 0
    ) -> None:
        self.link, self.dt_s = Link(trouble, seed), dt_s
        tokens = count(1)
        self._token: Callable[[], int] = lambda: next(tokens)
        self.session = Session(self._token)
        self._boots, self._start = count(100), start
        self.device = start(next(self._boots))
        self.now_s, self.ticks, self.device_tick = 0.0, 0, 0
        self.last_arrival_s = 0.0  # when the device last got a byte
        self.told: list[News] = []
        self.listeners: list[Callable[[News], None]] = []
        self.host_alive = True
        self.output = Output(0.0, State.IDLE, 0.0, 0.0, float("nan"))
        # The stylus hangs 5 mm above the surface, in a hand.
        self.readings: Callable[[int], Readings] = lambda k: Readings(k, 200, 3.0, 0.0, 0.0)

    def reset_device(self) -> None:
        """Power gone and back: what it knew is lost."""
        self.device = self._start(next(self._boots))
        self.device_tick = 0

    def step(self) -> None:
        data = self.link.to_device.arrived(self.now_s)
        if data:
            self.last_arrival_s = self.now_s
        self.device.receive(data)
        self.output = self.device.step(self.readings(self.device_tick))
        self.link.device_sends(self.device.bytes_to_send(), self.now_s)
        self.ticks += 1
        self.device_tick += 1
        self.now_s = self.ticks * self.dt_s
        if self.host_alive and (self.ticks % HOST_TICKS == 0 or self.session.next_deadline_s() <= self.now_s):
            self.pump()

    def pump(self) -> None:
        news = self.session.receive(self.link.to_host.arrived(self.now_s), self.now_s)
        self.told += news
        for one in news:
            for listener in self.listeners:
                listener(one)
        self.link.host_sends(self.session.bytes_to_send(self.now_s), self.now_s)

    def run(self, duration_s: float) -> Self:
        for _ in range(round(duration_s / self.dt_s)):
            self.step()
        return self

    def until(self, met: Callable[[], bool], within_s: float) -> Self:
        """Run until it is so.

        Raises
        ------
        NotWithinError : it was not so within this virtual time.
        """
        end = self.ticks + round(within_s / self.dt_s)
        while not met():
            if self.ticks >= end:
                raise NotWithinError(f"not within {within_s} s; told so far: {self.told[-5:]}")
            self.step()
        return self

    def ready(self, configuration: bytes, image: bytes) -> Self:
        """Connected, configured, loaded, and long enough at rest to be armed."""
        self.connected()
        self.session.configure(configuration)
        self.session.upload(image)
        return self.until(lambda: self.session.idle, 10.0).run(REST_S)

    def restart_host(self) -> None:
        """Another process, which knows nothing of the one before."""
        self.session, self.host_alive = Session(self._token), True
        self.told, self.listeners = [], []

    def connected(self) -> Self:
        self.session.connect(self.now_s)
        return self.until(lambda: self.session.device is not None and self.session.idle, 3.0)
