"""What a command does while it is being loaded: on Ctrl-C, and where a file has the name of one of the packages."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from transopt.base.start import in_the_way

INTERRUPTED = "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(60)\n"


def started(command: str, first: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """An entry point, called where Python looks into a folder before all others."""
    paths = os.pathsep.join([str(first), *filter(None, [os.environ.get("PYTHONPATH")])])
    return subprocess.run(
        [sys.executable, "-c", f"from transopt.cli.start import {command}; {command}()", *arguments],
        cwd=first,
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )


@pytest.mark.skipif(os.name != "posix", reason="a signal cannot be sent to oneself")
@pytest.mark.parametrize("command", ["transopt", "play", "device"])
def test_while_it_is_loaded_it_ends_without_a_traceback(tmp_path: Path, command: str) -> None:
    # In place of the library that takes longest to load, one that is interrupted.
    (tmp_path / "typer.py").write_text(INTERRUPTED)
    ended = started(command, tmp_path)
    assert ended.returncode == -signal.SIGINT
    assert ended.stderr == ""


@pytest.mark.parametrize("name", ["controller.py", "controller/__init__.py"])
@pytest.mark.parametrize("command", ["play", "device"])
def test_a_file_in_the_way_of_the_package_is_named_in_one_line(tmp_path: Path, name: str, command: str) -> None:
    file = tmp_path / name
    file.parent.mkdir(exist_ok=True)
    file.write_text("raise RuntimeError('the wrong file')\n")
    ended = started(command, tmp_path, "--help")
    assert ended.returncode == 2
    assert ended.stderr.startswith(f"error: {file}: stands in the way of the package controller")
    assert ended.stderr.count("\n") == 1


@pytest.mark.parametrize("name", ["problems.py", "controller.py"])
def test_a_file_in_nobodys_way_is_left_alone(tmp_path: Path, name: str) -> None:
    """`transopt` imports neither: the scenes are found by their place."""
    (tmp_path / name).write_text("raise RuntimeError('the wrong file')\n")
    ended = started("transopt", tmp_path, "scene", "list")
    assert ended.returncode == 0, ended.stderr
    assert "wood_on_foam" in ended.stdout


def test_the_packages_themselves_are_in_nobodys_way() -> None:
    assert [in_the_way(package) for package in ("transopt", "problems", "controller")] == [None] * 3


def test_the_end_of_a_command_searches_nothing_for_garbage(tmp_path: Path) -> None:
    counted = "import atexit, gc; atexit.register(lambda: print(gc.get_freeze_count(), len(gc.get_objects())))"
    ended = subprocess.run(
        [sys.executable, "-c", f"{counted}; from transopt.cli.start import transopt; transopt()", "scene", "list"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=50,
        check=True,
    )
    left_out, searched = map(int, ended.stdout.splitlines()[-1].split())
    assert left_out > 20 * searched


def test_a_solve_loads_nothing_that_only_others_need(tmp_path: Path) -> None:
    """What is loaded is a good part of the time of `transopt solve`: scipy.linalg and scipy.special a sixth of it."""
    counted = (
        "import atexit, sys; needless = ('linalg', 'fft', 'special', 'signal', 'sparse', 'optimize', 'interpolate');"
        "atexit.register(lambda: print([name for name in needless if f'scipy.{name}' in sys.modules]))"
    )
    ended = subprocess.run(
        [sys.executable, "-c", f"{counted}; from transopt.cli.start import transopt; transopt()", "solve"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=110,
        check=True,
    )
    assert ended.stdout.splitlines()[-1] == "[]"
