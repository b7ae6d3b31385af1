"""One command on one hostile input: run in a process of its own under bounds, and judged by what a user would see."""

import importlib
import os
import resource
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

MOST_BYTES = 1_000_000_000
MOST_S = 10.0  # of processor time, so that other work on the machine does not count, on one as fast as this:
YARDSTICK_S = 0.08  # of processor time for the yardstick; a slower machine is given as much more
ALARM_S = 120  # of the clock, after which a command hangs
GUARD_BYTES = 4_000_000_000  # of address space, so that what unpacks to 9 GB ends here and not the machine
PLAIN = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}  # a terminal that knows ASCII only
MAINS = {"transopt": "transopt.cli.main", "transopt-play": "controller.cli.play"}


@cache
def most_s() -> float:
    """Most processor time for a command on this machine."""
    began_s, total = time.process_time(), 0
    for number in range(2_000_000):
        total += number * number
    return MOST_S * max((time.process_time() - began_s) / YARDSTICK_S, 1.0)


@dataclass(frozen=True)
class Seen:
    """What a command left behind.

    Attributes
    ----------
    code : its exit code, negative for a signal that ended it.
    peak_bytes : of resident memory. cpu_s : of processor time.
    """

    code: int
    out: str
    err: str
    peak_bytes: int
    cpu_s: float

    @property
    def said(self) -> str:
        """Last line that the command wrote to its errors."""
        lines = self.err.strip().splitlines()
        return lines[-1] if lines else ""


def run(command: Sequence[str], folder: Path) -> Seen:
    """A command of this project in a child of this process, in which all that it imports is loaded already."""
    outputs = [folder / ".out", folder / ".err"]
    child = os.fork()
    if child == 0:
        _become(command, folder, outputs)
    _, status, used = os.wait4(child, 0)
    code = os.waitstatus_to_exitcode(status)
    out, err = (path.read_text(encoding="utf-8", errors="surrogateescape") for path in outputs)
    return Seen(code, out, err, used.ru_maxrss * 1024, used.ru_utime + used.ru_stime)


def _become(command: Sequence[str], folder: Path, outputs: Sequence[Path]) -> None:
    """Run the command in the place of this process; never returns."""
    code = 70
    try:
        os.chdir(folder)
        for number, path in enumerate(outputs, 1):
            file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(file, number)
        sys.stdout, sys.stderr = (os.fdopen(number, "w", encoding="utf-8") for number in (1, 2))
        sys.argv = list(command)
        signal.alarm(ALARM_S)
        resource.setrlimit(resource.RLIMIT_AS, (GUARD_BYTES, GUARD_BYTES))
        main = sys.modules[MAINS[command[0]]].main
        code = main() or 0
    except SystemExit as stop:
        code = stop.code if isinstance(stop.code, int) else 1
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def run_afresh(command: Sequence[str], folder: Path) -> Seen:
    """Run a command as a user starts it: in an interpreter of its own, here in the plain C locale."""
    program = f"import sys; sys.argv = {list(command)!r}; import {MAINS[command[0]]} as m; m.main()"
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONIOENCODING", "LANG")} | PLAIN
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=folder,
        env=environment,
        capture_output=True,
        encoding="utf-8",
        errors="surrogateescape",
        timeout=ALARM_S,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Seen(done.returncode, done.stdout, done.stderr, 0, cpu_s)


def fault(seen: Seen, codes: Sequence[int]) -> str:
    """What a user could complain of; empty where the command did as it should.

    Parameters
    ----------
    codes : exit codes that are right for the input; with 2 there is one line and nothing else.
    """
    if seen.code not in codes:
        return f"exit code {seen.code}, right are {', '.join(map(str, codes))}"
    for text in (seen.out, seen.err):
        if "Traceback" in text or "Warning" in text or "defect" in text:
            return "a traceback, a warning or a defect"
        if any(ord(c) < 32 and c not in "\n\t" for c in text):
            return "control characters"
    if seen.code == 2 and (seen.err.count("\n") != 1 or not seen.err.startswith("error: ")):
        return f"{seen.err.count(chr(10))} lines in place of one"
    if seen.peak_bytes > MOST_BYTES:
        return f"{seen.peak_bytes / 1e6:.0f} MB"
    if seen.cpu_s > most_s():
        return f"{seen.cpu_s:.1f} s, at most {most_s():.1f} s"
    return ""


LOADED = (
    "controller.cli.play",
    "controller.cli.tap",
    "controller.cli.bench",
    "transopt.cli.main",
    "transopt.cli.questions",
    "transopt.library.export",
    "transopt.library.proven",
    "transopt.recordings.tap",
    "transopt.report.tables",
    "transopt.report.taps",
    "transopt.report.tried",
    "transopt.report.write",
    "transopt.scene.file",
)


def load_commands() -> None:
    """Import all that the commands need, once: children then start with it."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for module in LOADED:
        importlib.import_module(module)


def elapsed(since: float) -> str:
    """For the line of progress."""
    return f"{time.monotonic() - since:.0f} s"
