"""The compiled device in a separate process started from Python, with a simulated stylus in a simulated hand."""

import subprocess
import tempfile
from pathlib import Path
from types import TracebackType

from controller.firmware.build import CORE, FIRMWARE, build, sources
from transopt.base.errors import InputError

ENDS_S = 5.0  # longest wait for the process to end before it is killed


class CompiledDevice:
    """The program `transopt-device`, compiled from the firmware's core and host port, running in real time.

    Parameters
    ----------
    plant : from `plant_file.plant_bytes`. options : command-line options of the program, like "--delay-ms", "16".

    Attributes
    ----------
    name : name of its port, for `driver.Device`. process : the running program.

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
            # The program reads the plant file before it prints the port's name, so the folder may go afterwards.
            self.name = self.process.stdout.readline().strip()
        if not self.name:
            said = self.process.communicate()[1].strip()
            raise InputError(f"transopt-device does not start: {said}")

    def close(self) -> None:
        """End the process, in any state."""
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
