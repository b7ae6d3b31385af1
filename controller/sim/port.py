"""The port `sim:`: a device that is computed, behind the same bytes as one on a serial port, in virtual time.

    host session  <- bytes ->  virtual link  <- bytes ->  compiled core  <- readings, command ->  simulated world

Time passes only while the host waits in `read`, by one servo period at a time: nothing sleeps, and the same seed
gives the same run. The core is the firmware's, compiled for this machine.
"""

import time
from typing import Protocol

from controller.firmware.build import NoCompilerError
from controller.firmware.core_device import CoreDevice, DeviceEnd
from controller.protocol.capacity import Capacity, Hardware
from controller.servo.interface import Output, Readings
from controller.servo.settings import Settings
from controller.sim.virtual_link import Link
from transopt.base.errors import InputError

SIMULATED = "sim:"
BOOT = 1
SLEEP_S = 1e-3  # shorter waits are not slept: the next ticks catch up


class Clock(Protocol):
    """Real time; `time.monotonic` and `time.sleep` as `WallClock`, something faster in tests."""

    def now_s(self) -> float: ...

    def sleep(self, duration_s: float) -> None: ...


class WallClock:
    """For people who watch."""

    def now_s(self) -> float:
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        time.sleep(duration_s)


class World(Protocol):
    """What the device's sensors see and its motor moves."""

    def readings(self, tick: int) -> Readings: ...

    def advance(self, output: Output) -> None:
        """Let one servo period pass under what the device answered."""
        ...


class SimulatedPort:
    """A `controller.host.connection.Connection`.

    Parameters
    ----------
    dt_s : servo period of the device.
    link : between host and device; without one bytes arrive at once and whole.
    clock : paces the run, for people who watch; without one nothing waits.

    Attributes
    ----------
    ticks : servo periods that have passed.
    behind_s : how far a paced run fell behind its clock at most.
    """

    name, harmless = SIMULATED, True

    def __init__(
        self, end: DeviceEnd, world: World, dt_s: float, *, link: Link | None = None, clock: Clock | None = None
    ) -> None:
        self.end, self.world, self.dt_s = end, world, dt_s
        self.link = Link() if link is None else link
        self.ticks, self.behind_s = 0, 0.0
        self._clock, self._began_s = clock, 0.0 if clock is None else clock.now_s()

    def now_s(self) -> float:
        return self.ticks * self.dt_s

    def step(self) -> None:
        """One servo period."""
        now_s = self.now_s()
        if arrived := self.link.to_device.arrived(now_s):
            self.end.receive(arrived)
        self.world.advance(self.end.step(self.world.readings(self.ticks)))
        self.link.device_sends(self.end.bytes_to_send(), now_s)
        self.ticks += 1
        if self._clock is not None:
            ahead_s = self.now_s() - (self._clock.now_s() - self._began_s)
            self.behind_s = max(self.behind_s, -ahead_s)
            if ahead_s >= SLEEP_S:
                self._clock.sleep(ahead_s)

    def read(self, timeout_s: float) -> bytes:
        end_s = self.now_s() + timeout_s
        while True:
            self.step()
            data = self.link.to_host.arrived(self.now_s())
            if data or self.now_s() >= end_s:
                return data

    def write(self, data: bytes) -> None:
        self.link.host_sends(data, self.now_s())

    def close(self) -> None:
        """Nothing is held."""


def core_end(settings: Settings, samples: int = 0, longest: int = 0) -> CoreDevice:
    """The compiled core, on hardware that is good for these settings.

    Parameters
    ----------
    samples : of all waveforms together, for which there is room at least.
    longest : samples of one waveform.

    Raises
    ------
    InputError : there is no C compiler, and the core did not come with the package or is too small.
    """
    known, off = Hardware(), settings.amplifier_tolerance
    pole_Hz = known.pole_most_Hz if settings.amplifier is None else settings.amplifier.pole_Hz
    amplifier, monitor = (min(abs(scale), 1.0) for scale in (settings.amplifier_scale, settings.monitor_scale))
    slowest_Hz, fastest_Hz = pole_Hz * (1.0 - off), pole_Hz * (1.0 + off)
    hardware = Hardware(
        current_A=max(known.current_A, settings.current_limit_A / amplifier),
        command_A=max(known.command_A, settings.command_limit_A / amplifier),
        dt_s=settings.dt_s,
        pole_least_Hz=min(known.pole_least_Hz, slowest_Hz),
        pole_most_Hz=max(known.pole_most_Hz, fastest_Hz),
        over_current_A=max(known.over_current_A, settings.over_current * settings.current_limit_A / monitor),
    )
    usual = Capacity()
    sizes = {
        "TD_MAX_LIBRARY_SAMPLES": (usual.samples, max(samples, longest)),
        "TD_MAX_SAMPLES": (usual.waveform_samples, longest),
    }
    flags = tuple(
        f"-D{name}={size << (wanted // size).bit_length()}" for name, (size, wanted) in sizes.items() if wanted > size
    )
    try:
        return CoreDevice(BOOT, hardware, flags, simulated=True)
    except NoCompilerError as missing:
        why = f"--simulate runs the device's own C code, which needs the wheel or a compiler: {missing}"
        if flags:
            why = f"{why}; the wheel's device is too small for this library"
        raise InputError(why) from None
