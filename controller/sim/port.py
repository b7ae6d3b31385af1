"""The port `sim:`: a simulated device in virtual time, behind the same bytes as a device on a serial port.

    host session  <- bytes ->  line  <- bytes ->  compiled core  <- readings, command ->  simulated world

Time advances only while the host waits in `read`, one servo period at a time: nothing sleeps, and the same seed gives
the same run. The core is the firmware's, compiled for this machine.
"""

import time
from typing import Protocol

from controller.firmware.build import NoCompilerError
from controller.firmware.core_device import CoreDevice, DeviceEnd
from controller.protocol.capacity import Capacity, Hardware
from controller.servo.interface import Output, Readings
from controller.servo.settings import Settings
from transopt.base.errors import InputError

SIMULATED = "sim:"
BOOT = 1
SLEEP_S = 1e-3  # shorter waits are skipped; the following ticks catch up


class Clock(Protocol):
    """Clock that paces a run: `WallClock` for real time, a faster one in tests."""

    def now_s(self) -> float: ...

    def sleep(self, duration_s: float) -> None: ...


class WallClock:
    """Real time, for runs that people watch."""

    def now_s(self) -> float:
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        time.sleep(duration_s)


class World(Protocol):
    """The simulated world that the device's sensors read and its motor drives."""

    def readings(self, tick: int) -> Readings: ...

    def advance(self, output: Output) -> None:
        """Advance by one servo period under the device's output."""
        ...


class Line:
    """The line between host and device, which carries all bytes at once; that of a test may have troubles."""

    def __init__(self) -> None:
        self._for_device = self._for_host = b""

    def host_sends(self, data: bytes, now_s: float) -> None:
        self._for_device += data

    def device_sends(self, data: bytes, now_s: float) -> None:
        self._for_host += data

    def at_device(self, now_s: float) -> bytes:
        """The bytes that have arrived there by now."""
        data, self._for_device = self._for_device, b""
        return data

    def at_host(self, now_s: float) -> bytes:
        """The bytes that have arrived there by now."""
        data, self._for_host = self._for_host, b""
        return data


class SimulatedPort:
    """A `controller.host.connection.Connection` to a simulated device.

    Parameters
    ----------
    dt_s : servo period of the device.
    line : between host and device; None for one without delay and faults.
    clock : clock that paces the run; None runs as fast as possible.

    Attributes
    ----------
    ticks : number of servo periods so far.
    behind_s : largest delay of a paced run against its clock.
    """

    name, harmless = SIMULATED, True

    def __init__(
        self, end: DeviceEnd, world: World, dt_s: float, *, line: Line | None = None, clock: Clock | None = None
    ) -> None:
        self.end, self.world, self.dt_s = end, world, dt_s
        self._line = Line() if line is None else line
        self.ticks, self.behind_s = 0, 0.0
        self._clock, self._began_s = clock, 0.0 if clock is None else clock.now_s()

    def now_s(self) -> float:
        return self.ticks * self.dt_s

    def step(self) -> None:
        """One servo period."""
        now_s = self.now_s()
        if arrived := self._line.at_device(now_s):
            self.end.receive(arrived)
        self.world.advance(self.end.step(self.world.readings(self.ticks)))
        self._line.device_sends(self.end.bytes_to_send(), now_s)
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
            data = self._line.at_host(self.now_s())
            if data or self.now_s() >= end_s:
                return data

    def write(self, data: bytes) -> None:
        self._line.host_sends(data, self.now_s())

    def close(self) -> None:
        """Nothing to release."""


def core_end(settings: Settings, samples: int = 0, longest: int = 0) -> CoreDevice:
    """The compiled core on hardware with limits wide enough for these settings.

    Parameters
    ----------
    samples : least capacity for the samples of all waveforms together.
    longest : least capacity for the samples of one waveform.

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
