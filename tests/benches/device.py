"""A host session, a link and a device on one virtual clock."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count

import numpy as np

from controller.device.endpoint import Device
from controller.protocol.capacity import Capacity, Hardware
from controller.protocol.configuration import configuration_of
from controller.protocol.events import Told
from controller.protocol.image import image_of
from controller.servo.interface import State
from controller.servo.settings import Settings
from controller.sim.virtual_link import Trouble
from controller.waveforms.bank import Bank, Method
from scripts.campaign.rehearsal import Rehearsal
from tests.benches.servo import AMPLIFIER, DT_S

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
EXCITED = configuration_of(replace(SETTINGS, host_starts=True))
ONE_WAVEFORM = image(speeds=1, grips=1, samples=300)


def tokens() -> Callable[[], int]:
    counter: Iterator[int] = count(1)
    return lambda: next(counter)


class World(Rehearsal[Device]):
    """With the Python device; the stylus hangs 5 mm above the surface, in a hand, unless `readings` says else."""

    def __init__(
        self,
        trouble: Trouble | None = None,
        seed: int = 0,
        capacity: Capacity | None = None,
        hardware: Hardware | None = None,
    ) -> None:
        super().__init__(lambda boot: Device(boot, capacity, hardware), DT_S, trouble, seed)

    def of(self, kind: type[Told]) -> list[Told]:
        return [news for news in self.told if isinstance(news, kind)]

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
