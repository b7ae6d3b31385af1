"""What all command lines do with words they do not know: one line, exit code 2."""

import re
import shlex
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest
import typer

from controller.cli.play import app as play_app
from tests.benches.commands import Terminal
from tests.benches.places import ROOT
from transopt.base.terminal import run
from transopt.cli.main import app as transopt_app
from transopt.cli.start import COMMANDS


@pytest.mark.parametrize(
    ("line", "code"), [("transopt scene", 2), ("transopt --help", 0), ("transopt-play record", 2)]
)
def test_help_once(line: str, code: int, terminal: Terminal) -> None:
    outcome = terminal(*line.split())
    assert outcome.code == code
    assert (outcome.out + outcome.err).count("Usage:") == 1


def test_help_is_of_whole_paragraphs_and_gives_a_flag_no_type(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    said = terminal("transopt", "solve", "--help").out
    assert "bool>" not in said
    assert "--grid-cap" in said
    for row in (r"--full +Report with", r"--figures +--no-figures +Draw "):
        assert re.search(row, said), f"a word stands behind a flag: {row}"
    (paragraph,) = re.findall(r"Exit 1: .*?\n *\n", said, re.DOTALL)
    lines = [line.strip() for line in paragraph.strip().splitlines()]
    assert all(len(line) + len(after.split()[0]) >= 76 for line, after in pairwise(lines)), paragraph


@pytest.mark.skipif(sys.platform == "win32", reason="the shell of Unix")
@pytest.mark.parametrize(
    ("behind", "code", "words"),
    [
        (">&-", 0, ""),
        ("2>&-", 0, ""),
        (
            "> /dev/full",
            2,
            "error: standard output: cannot be written (No space left on device); choose another place\n",
        ),
        ("| head -1", 141, ""),
    ],
)
def test_an_output_that_takes_nothing_is_no_traceback(behind: str, code: int, words: str) -> None:
    """The pipe's first part has to have more to print than a pipe holds."""
    if "/dev/full" in behind and not Path("/dev/full").exists():
        pytest.skip("no device that is always full")
    many = "for _ in range(3000): terminal.console().print('a line of a long table, again and again')"
    program = f"from transopt.base import terminal\ndef say() -> None:\n    {many}\nterminal.run(say)"
    line = f"{shlex.join([sys.executable, '-c', program])} {behind}; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=60, cwd=ROOT, check=False)
    assert (done.returncode, done.stderr) == (code, words)


@pytest.mark.parametrize(("module", "name"), [("transopt", "transopt"), ("controller", "transopt-play")])
def test_python_runs_them_as_modules(module: str, name: str) -> None:
    """One does so where the folder of commands is not on the path; usage and errors name the command all the same."""
    line = [sys.executable, "-m", module, "--nosuch"]
    done = subprocess.run(line, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2
    assert done.stderr == f"error: --nosuch: no such option; `{name} --help` lists what there is\n"


@pytest.mark.parametrize(("name", "app"), [("transopt", transopt_app), ("transopt-play", play_app)])
def test_each_program_knows_the_commands_of_the_other(name: str, app: typer.Typer) -> None:
    assert sorted(COMMANDS[name]) == sorted(typer.main.get_group(app).commands)


def test_the_version(terminal: Terminal) -> None:
    outcome = terminal("transopt", "--version")
    assert outcome.code == 0
    assert outcome.out.strip().count(".") >= 1


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
@pytest.mark.parametrize("swallowed", [False, True], ids=["", "swallowed"])
def test_asked_to_end_it_ends(number: signal.Signals, code: int, swallowed: bool) -> None:
    """A process ends with all tidied up, or, where a library swallows what the signal raises, all the same."""
    program = (
        "import os, time\n"
        "from transopt.base.terminal import run\n"
        "def work():\n"
        "    try:\n"
        f"        os.kill(os.getpid(), {number.value})\n"
        "    except BaseException:\n"
        f"        if not {swallowed}: raise\n"
        "        time.sleep(600)\n"
        "    finally:\n"
        "        print('tidied up')\n"
        "run(work)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == (1 if swallowed else code)
    assert done.stdout == ("" if swallowed else "tidied up\n")
    assert "Traceback" not in done.stderr


def test_a_signal_that_python_ignores_comes_again() -> None:
    """What is raised in the callback of a weak reference goes nowhere."""
    program = (
        "import os, signal, time, weakref\n"
        "from transopt.base.terminal import run\n"
        "class Thing: pass\n"
        "def work():\n"
        "    thing = Thing()\n"
        "    reference = weakref.ref(thing, lambda _: os.kill(os.getpid(), signal.SIGINT))\n"
        "    del thing\n"
        "    try:\n"
        "        time.sleep(600)\n"
        "    finally:\n"
        "        print('tidied up')\n"
        "run(work)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (130, "tidied up\n", "")


def test_without_a_signal_the_answers_to_signals_stay() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit) as ended:
        run(lambda: 3)
    assert ended.value.code == 3
    assert signal.getsignal(signal.SIGTERM) is before
