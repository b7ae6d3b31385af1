"""A host session, a link and a device on one virtual clock."""

from collections.abc import Callable, Iterator
from itertools import count

import numpy as np

from controller.bank import Bank, Method
from controller.configuration import configuration_of
from controller.device import Device
from controller.image import image_of
from controller.interface import Output, Readings, State
from controller.limits import Capacity, Hardware
from controller.link import Link, Trouble
from controller.session import Session
from controller.settings import Settings
from controller.told import Told
from tests.servo_bench import AMPLIFIER, DT_S

HOST_TICKS = 10  # the host looks every ms, or when its own deadline comes
SETTINGS = Settings(DT_S, 3 * DT_S, 4.0, AMPLIFIER, window_ticks=20)
CONFIGURATION = configuration_of(SETTINGS)


def table(speeds: int = 2, grips: int = 2, samples: int = 60, peak_A: float = 1.0) -> Bank:
    """A bank of smooth pulses that end in 10 zeros."""
    shape = np.zeros(samples)
    shape[: samples - 10] = np.sin(np.linspace(0, 3 * np.pi, samples - 10)) * np.linspace(1, 0.2, samples - 10) + 0.01
    size = np.linspace(0.5, 1.0, speeds * grips).reshape(speeds, grips, 1)
    norms = np.linalg.norm(shape) * size[..., 0] * peak_A
    return Bank(
        method=Method.BILINEAR,
        speeds_m_s=np.linspace(0.1, 0.4, speeds).tolist() if speeds > 1 else [0.2],
        grips_N=np.linspace(1.0, 5.0, grips).tolist() if grips > 1 else [3.0],
        command_A=peak_A * size * shape,
        transient_A=norms.tolist(),
        feedback_A=(0.0 * norms).tolist(),
        grip_min_N=0.5,
        by_grip=True,
        nearest=False,
    )


def image(**sizes: int) -> bytes:
    return image_of(table(**sizes), DT_S, SETTINGS.lead_s, 10)


IMAGE = image()


def tokens() -> Callable[[], int]:
    counter: Iterator[int] = count(1)
    return lambda: next(counter)


class World:
    """Steps of one servo period; the stylus hangs 5 mm above the surface, in a hand, unless `readings` says else.

    Attributes
    ----------
    told : all events so far, with the time at which they were told.
    outputs : of the running device, the last.
    """

    def __init__(
        self,
        trouble: Trouble | None = None,
        seed: int = 0,
        capacity: Capacity | None = None,
        hardware: Hardware | None = None,
    ) -> None:
        self.link = Link(trouble, seed)
        self._tokens = tokens()
        self.session = Session(self._tokens)
        self._boots = count(100)
        self._capacity, self._hardware = capacity, hardware
        self.device = Device(next(self._boots), capacity, hardware)
        self.now_s, self.ticks, self.device_tick = 0.0, 0, 0
        self.last_arrival_s = 0.0  # when the device last got a byte
        self.told: list[Told] = []
        self.told_s: list[float] = []
        self.host_alive = True
        self.output = Output(0.0, State.IDLE, 0.0, 0.0, float("nan"))
        self.readings: Callable[[int], Readings] = lambda k: Readings(k, 200, 3.0, 0.0, 0.0)

    def reset_device(self) -> None:
        """Power gone and back: what it knew is lost."""
        self.device = Device(next(self._boots), self._capacity, self._hardware)
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
        self.now_s = self.ticks * DT_S
        if self.host_alive and (self.ticks % HOST_TICKS == 0 or self.session.next_deadline_s() <= self.now_s):
            self.pump()

    def pump(self) -> None:
        news = self.session.receive(self.link.to_host.arrived(self.now_s), self.now_s)
        self.told += news
        self.told_s += [self.now_s] * len(news)
        self.link.host_sends(self.session.bytes_to_send(self.now_s), self.now_s)

    def run(self, duration_s: float) -> "World":
        for _ in range(round(duration_s / DT_S)):
            self.step()
        return self

    def until(self, met: Callable[[], bool], within_s: float) -> "World":
        """Run until it is so; it must be within this virtual time."""
        end = self.ticks + round(within_s / DT_S)
        while not met():
            assert self.ticks < end, f"not within {within_s} s; told so far: {self.told[-5:]}"
            self.step()
        return self

    def of(self, kind: type[Told]) -> list[Told]:
        return [news for news in self.told if isinstance(news, kind)]

    def restart_host(self) -> None:
        """Another process, which knows nothing of the one before."""
        self.session, self.host_alive = Session(self._tokens), True
        self.told, self.told_s = [], []

    def connected(self) -> "World":
        self.session.connect(self.now_s)
        return self.until(lambda: self.session.device is not None and self.session.idle, 3.0)

    def ready(self, library: bytes = IMAGE, configuration: bytes = CONFIGURATION) -> "World":
        """Connected, configured, loaded, checked."""
        self.connected()
        self.session.configure(configuration)
        self.session.upload(library)
        self.session.checked()
        return self.until(lambda: self.session.idle, 10.0)

    def armed(self, lease_ms: int = 200, gain: float = 1.0) -> "World":
        self.ready()
        self.session.arm(gain, lease_ms)
        return self.until(lambda: self.session.device_state is State.ARMED, 1.0)
