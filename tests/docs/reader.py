"""A reader who does what a page says: saves its files, types its commands, and has a device on the port it names."""

import io
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path

from controller.protocol.codes import LinkNotice
from tests.benches.places import ROOT
from tests.docs.pages import Block
from transopt.scene.builtin import load_scene

DEFAULT_SCENE = ROOT / "problems/scenes/wood_on_foam.toml"
PORT = "/dev/ttyACM0"
# A device in a hand that taps refuses to be armed in the middle of a tap, and no machine that has other work to do
# keeps every lease.
PASSING = ("the stylus is moving", LinkNotice.LEASE_LOST.value)

NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")

# Beginning of a command on a port -> the options that stand for the person at the device, who stops it when it has
# been seen.
PERSON = {
    "transopt-play monitor": "--for 1",
    "transopt-play tap": "--taps 2",
    "transopt-play record tap": "--taps 2",
    "transopt-play record sweep": "--seconds 1 --trials 2",
}


class Reader:
    """Works through the blocks of one page in one folder.

    Parameters
    ----------
    folder : where everything is saved and run; what it holds before is what the page assumes.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self._names = folder, dict[str, object]()

    def do(self, block: Block) -> None:
        """Save it or run it, as its language asks for; it prints what the page says."""
        does = {"sh": self._type, "python": self._python, "toml": self._scene, "c": self._compile}
        printed = does[block.language](block)
        if block.prints:
            assert not (missing := unsaid(block.prints, printed)), f"{missing}\n{printed}"

    def run(self, *command: str) -> "subprocess.CompletedProcess[str]":
        """Without input from a terminal, in the environment of the tests."""
        return subprocess.run(
            command,
            cwd=self.folder,
            capture_output=True,
            text=True,
            check=False,
            stdin=subprocess.DEVNULL,
        )

    def _type(self, block: Block) -> str:
        if PORT in block.code:
            self._type_at_a_device(block.code)
            return ""
        ended = self.run("bash", "-euc", block.code)
        assert ended.returncode == 0, f"{block.code}\n{ended.stdout[-2000:]}\n{ended.stderr[-2000:]}"
        return ended.stdout + ended.stderr

    def _type_at_a_device(self, lines: str) -> None:
        """Each line at a simulated device: sweeps at one that is held still, the rest at one that taps."""
        whole = [line.partition("#")[0].strip() for line in lines.splitlines()]
        for sweeps in (False, True):
            of_this = [line for line in whole if line and ("sweep" in line) == sweeps]
            if of_this:
                with self._device("--hold=3" if sweeps else "--rest=2") as port:
                    for line in of_this:
                        self._type_until_taken(line, port)

    def _type_until_taken(self, line: str, port: str) -> None:
        """What passes by itself is answered as a person would answer it: the command is typed again."""
        stands_for = next((options for begin, options in PERSON.items() if line.startswith(begin)), "")
        command = f"{line.replace(PORT, port)} {stands_for}"
        for _ in range(5):
            ended = self.run("bash", "-euc", command)
            if not any(words in ended.stdout + ended.stderr for words in PASSING):
                break
        assert ended.returncode == 0, f"{command}\n{ended.stdout[-2000:]}\n{ended.stderr[-2000:]}"

    @contextmanager
    def _device(self, option: str) -> Iterator[str]:
        """A device that runs, by the name of its pseudo-terminal."""
        command = ["transopt-device", option, "--like", "wood_on_foam", "--vouches"]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as device:
            try:
                yield device.stdout.readline().strip()
            finally:
                device.terminate()

    def _python(self, block: Block) -> str:
        """In one interpreter's names from block to block of the page."""
        said = io.StringIO()
        if block.file:
            (self.folder / block.file).write_text(block.code, encoding="utf-8")
        there = Path.cwd()
        os.chdir(self.folder)
        sys.path.insert(0, str(self.folder))  # where `python` started in this folder looks for what it imports
        try:
            with redirect_stdout(said):
                exec(compile(block.code, f"<{self.folder.name}>", "exec"), self._names)
        finally:
            sys.path.remove(str(self.folder))
            os.chdir(there)
        return said.getvalue()

    def _scene(self, block: Block) -> str:
        """A whole scene if it has a file's name, else tables that a reader puts into a copy of the default scene."""
        path = self.folder / (block.file or "fragment.toml")
        path.write_text(block.code if block.file else put_into_a_scene(block.code), encoding="utf-8")
        load_scene(path)
        return ""

    def _compile(self, block: Block) -> str:
        compiler = shutil.which("cc") or shutil.which("gcc")
        if compiler is not None:
            source = self.folder / "block.c"
            source.write_text(block.code, encoding="utf-8")
            ended = self.run(
                compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", f"-I{self.folder}", str(source)
            )
            assert ended.returncode == 0, ended.stderr
        return ""


def unsaid(page: str, printed: str) -> list[str]:
    """Lines of a page's output that a command has not printed, in their order; `...` stands for lines left out.

    Frames and spaces do not count, and a number is the same within two units of its last digit or a hundredth.
    """
    lines, missing = iter(map(_bare, printed.splitlines())), []
    for line in map(_bare, page.splitlines()):
        if line and line != "..." and not any(_same(line, other) for other in lines):
            missing.append(line)
    return missing


def _bare(line: str) -> str:
    return " ".join(re.sub(r"[\u2500-\u257f]", " ", line).split())


def _same(line: str, other: str) -> bool:
    if NUMBER.sub("0", line) != NUMBER.sub("0", other):
        return False
    pairs = zip(NUMBER.findall(line), NUMBER.findall(other), strict=True)
    return all(abs(float(a) - float(b)) <= max(2.01 * _unit(a), 0.01 * abs(float(a))) for a, b in pairs)


def _unit(number: str) -> float:
    """What one in the last digit of a printed number is worth."""
    mantissa, _, exponent = number.partition("e")
    return float(10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2])))


def put_into_a_scene(fragment: str) -> str:
    """The default scene with the keys and tables of a fragment in place of its own of the same name."""
    stated = tomllib.loads(fragment)
    first, *tables = re.split(r"^(?=\[)", DEFAULT_SCENE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    lines = [line for line in first.splitlines() if line.partition("=")[0].strip() not in stated]
    own_keys, *own_tables = re.split(r"^(?=\[)", fragment, flags=re.MULTILINE)
    kept = [table for table in tables if re.split(r"[].[]+", table)[1] not in stated]
    return "\n".join([*lines, own_keys, *kept, *own_tables])
