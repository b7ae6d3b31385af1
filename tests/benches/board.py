"""A whole board under QEMU: its images, built by CMake, and its three lines: to the host, to a hand, of its clock."""

import re
import secrets
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from controller.firmware.build import FIRMWARE
from transopt.base.errors import InputError

PORT = FIRMWARE / "port" / "stm32f405"
TOOLS = {
    "arm-none-eabi-gcc": "gcc-arm-none-eabi",
    "qemu-system-arm": "qemu-system-arm",
    "cmake": "cmake",
    "make": "make",
}
IMAGES = ("stm32f405", "emulated", "template")
START, LINE_BAUD = 0x2002FFF0, 0x2002FFF4  # where the image looks for its number and its line's rate, see emulated.c
BUILD_S = 120.0


class MissingToolError(InputError):
    """A tool that is not on this machine."""


def need_tools(*tools: str) -> None:
    """Raises
    ------
    MissingToolError : which, and the package that has it.
    """
    for tool in tools or TOOLS:
        if shutil.which(tool) is None:
            raise MissingToolError(f"{tool}: not found; install {TOOLS[tool]} (Debian)")


def build_images(folder: Path) -> dict[str, Path]:
    """All images by name, built in this folder.

    Raises
    ------
    InputError : what the compiler or the linker says.
    """
    made = {name: folder / f"{name}.elf" for name in IMAGES}
    for command in (["cmake", "-S", str(PORT), "-B", str(folder)], ["cmake", "--build", str(folder), "-j", "2"]):
        done = subprocess.run(command, capture_output=True, text=True, timeout=BUILD_S, check=False)
        if done.returncode:
            raise InputError(f"{' '.join(command)}: {done.stdout[-500:]}{done.stderr[-1500:]}")
    return made


@dataclass
class Emulated:
    """A board that runs.

    Attributes
    ----------
    port : its name, as `--port` takes it. line : on which the hand is asked.
    """

    port: str
    line: TextIO

    def ask(self, words: str) -> None:
        """Let the hand do something, in the words in which a command asks a person: `please tap`."""
        print(words, file=self.line, flush=True)


@contextmanager
def emulated(image: Path, baud: int = 0) -> Iterator[Emulated]:
    """The image in the emulator, which goes as fast as it can, with another number at every start.

    Parameters
    ----------
    baud : rate of its line to the host; 0 for one that takes all.
    """
    command = ["qemu-system-arm", "-M", "netduinoplus2", "-icount", "shift=3", "-display", "none", "-monitor", "none"]
    command += 3 * ["-serial", "pty"]
    for address, value in ((START, 1 + secrets.randbelow(1 << 30)), (LINE_BAUD, baud)):
        command += ["-device", f"loader,addr={address:#x},data={value},data-len=4"]
    with subprocess.Popen(
        [*command, "-kernel", str(image)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as running:
        try:
            names: list[str] = []
            while len(names) < 3 and (said := running.stdout.readline()):
                names += re.findall(r"redirected to (\S+)", said)
            if len(names) < 3:
                raise InputError("qemu-system-arm: ended before it had its ports")
            with Path(names[1]).open("w", encoding="ascii") as line:
                yield Emulated(f"{names[0]},clock={names[2]}", line)
        finally:
            running.kill()


class Ear:
    """What commands print, of which the hand hears what a person is asked for.

    Attributes
    ----------
    text : all of it.
    """

    def __init__(self, board: Emulated) -> None:
        self.board, self._rest, self.text = board, "", ""

    def write(self, text: str) -> int:
        self.text += text
        *lines, self._rest = (self._rest + text).split("\n")
        for line in lines:
            if line.startswith("  please "):
                self.board.ask(line.strip())
        return len(text)

    def flush(self) -> None:
        """Everything is out already."""

    def isatty(self) -> bool:
        return False
