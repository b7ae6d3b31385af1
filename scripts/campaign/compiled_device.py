"""The compiled device as a process of its own, with a simulated stylus in a stated hand; for the scripts here."""

import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType

import numpy as np

from controller.firmware.build import CORE, FIRMWARE, build, sources
from controller.host.driver import Device, DeviceError, LinkLostError
from controller.servo.settings import Settings
from controller.sim.default_device import DEFAULT_DEVICE
from controller.sim.plant_file import plant_bytes
from controller.sim.simulator import Simulator
from controller.sim.user import User
from controller.waveforms.bank import Bank, Method, currents, norms
from transopt.base.errors import InputError

DT_S = 1e-4
TAIL = 10  # zero commands at the end of every waveform
SETTINGS = Settings(DT_S, 3 * DT_S, 4.0, DEFAULT_DEVICE.amplifier)
ENDS_S = 5.0  # a process that is asked to end has this long


class CompiledDevice:
    """`transopt-device` as it is compiled from firmware/core and firmware/host, in real time.

    Parameters
    ----------
    plant : `plant_file.plant_bytes`. options : of the program, like "--delay-ms", "16".

    Attributes
    ----------
    name : of its port, as `driver.Device` opens it. process : the device's own.

    Raises
    ------
    NoCompilerError : no C compiler. InputError : no pseudo-terminal.
    """

    def __init__(self, plant: bytes, *options: str) -> None:
        program = build("transopt-device", [*sources(CORE), *sources(FIRMWARE / "host")])
        with tempfile.TemporaryDirectory(prefix="transopt-") as folder:
            path = Path(folder) / "plant"
            path.write_bytes(plant)
            self.process = subprocess.Popen(
                [str(program), "--plant", str(path), "--simulated", "1", *options],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            assert self.process.stdout is not None
            # The plant is read before the port is named.
            self.name = self.process.stdout.readline().strip()
        if not self.name:
            said = self.process.communicate()[1].strip()
            raise InputError(f"transopt-device does not start: {said}")

    def close(self) -> None:
        """Whatever state it is in."""
        self.process.terminate()
        try:
            self.process.communicate(timeout=ENDS_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()

    def __enter__(self) -> "CompiledDevice":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def arm_at_rest(device: Device, lease_ms: int, within_s: float) -> None:
    """Arm as soon as the hand is at rest.

    Raises
    ------
    DeviceError : it was not within this time.
    """
    end_s = time.monotonic() + within_s
    while True:
        try:
            device.arm(1.0, lease_ms)
            return
        except LinkLostError:
            raise
        except DeviceError:
            if time.monotonic() > end_s:
                raise
            device.listen(0.02)


def plant_of(user: User, period_s: float) -> bytes:
    """The default device in the hand of a user whose motion has this period, a whole number of ticks."""
    return plant_bytes(Simulator(DEFAULT_DEVICE, user, DT_S), user, period_s)


def smooth_bank(speeds: int = 2, grips: int = 2, samples: int = 60, peak_A: float = 1.0) -> Bank:
    """Smooth pulses from 0.1 to 0.4 m/s and 1 to 5 N, the larger the faster and firmer."""
    shape = np.zeros(samples)
    pulse = samples - TAIL
    shape[:pulse] = np.sin(np.linspace(0, 3 * np.pi, pulse)) * np.linspace(1, 0.2, pulse)
    size = np.linspace(0.5, 1.0, speeds * grips).reshape(speeds, grips, 1)
    command = peak_A * size * shape
    transient = norms(currents(command, SETTINGS.amplifier, DT_S), SETTINGS.amplifier, DT_S)
    return Bank(
        method=Method.BILINEAR,
        speeds_m_s=np.linspace(0.1, 0.4, speeds).tolist() if speeds > 1 else [0.2],
        grips_N=np.linspace(1.0, 5.0, grips).tolist() if grips > 1 else [3.0],
        command_A=command,
        transient_A=transient.tolist(),
        feedback_A=(0.0 * transient).tolist(),
        grip_min_N=0.5,
        by_grip=True,
        nearest=False,
    )
