"""The compiled device as a process of its own, started from Python, with a simulated stylus in a simulated hand."""

import subprocess
import tempfile
from pathlib import Path
from types import TracebackType

from controller.firmware.build import CORE, FIRMWARE, build, sources
from transopt.base.errors import InputError

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
