"""What all command lines do with words they do not know: one line, exit code 2."""

import os
import signal
import subprocess
import sys

import pytest

from tests.benches.commands import MAINS, Terminal, assert_refused
from transopt.base.terminal import run


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("transopt solve --grid-cap abc", "valid integer"),
        ("transopt solve --speedd 3", "No such option: --speedd"),
        ("transopt nosuch", "No such command 'nosuch'"),
        ("transopt verify", "Missing argument"),
        ("transopt-play tap x.npz --simulate --speed abc", "'--speed'"),
        ("transopt-device --nothing", "No such option: --nothing"),
    ],
)
def test_one_line(line: str, words: str, terminal: Terminal) -> None:
    program, *arguments = line.split()
    assert_refused(terminal(program, *arguments), words, f"`{program}", "--help` lists what there is")


@pytest.mark.parametrize(("line", "code"), [("transopt", 2), ("transopt --help", 0), ("transopt-play record", 2)])
def test_help_once(line: str, code: int, terminal: Terminal) -> None:
    outcome = terminal(*line.split())
    assert outcome.code == code
    assert (outcome.out + outcome.err).count("Usage:") == 1


def test_the_version(terminal: Terminal) -> None:
    outcome = terminal("transopt", "--version")
    assert outcome.code == 0
    assert outcome.out.strip().count(".") >= 1


@pytest.mark.parametrize("module", MAINS.values())
def test_help_comes_at_once(module: str) -> None:
    """No command line loads what only its commands need."""
    program = f"import sys, {module}; print(sorted({{'numpy', 'scipy', 'casadi', 'matplotlib'}} & set(sys.modules)))"
    said = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    assert said.strip() == "[]"


def test_asked_to_end_it_ends_as_by_ctrl_c() -> None:
    ended, before = [], signal.getsignal(signal.SIGTERM)

    def work() -> None:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        finally:
            ended.append("tidied up")

    with pytest.raises(SystemExit) as stopped:
        run(work)
    assert stopped.value.code == 143
    assert ended == ["tidied up"]
    assert signal.getsignal(signal.SIGTERM) is before
