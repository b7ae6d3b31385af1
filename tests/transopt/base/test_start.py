"""What a command does while it is being loaded: on Ctrl-C, and where a file has the name of one of the packages."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benches.places import ROOT
from transopt.base.start import in_the_way
from transopt.library.library import Library

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


# What a command must not load. Most of these take as long to load as a small library to solve.
SCIPY = tuple(f"scipy.{room}" for room in ("linalg", "fft", "special", "signal", "sparse", "optimize", "interpolate"))
FIGURES = ("matplotlib", "PIL")
LOADS_NOT = {
    "solve --no-figures": ("casadi", "numpy.ma", "rich._emoji_codes", "transopt.files.table", *FIGURES, *SCIPY),
    "show out/wood_on_foam/library.npz": ("casadi", *FIGURES, *SCIPY),
    "verify out/wood_on_foam/library.npz": ("casadi", *FIGURES, *SCIPY),
    "compare out/wood_on_foam/library.npz out/wood_on_foam/library.npz": ("casadi", *FIGURES, *SCIPY),
    "export out/wood_on_foam/library.npz wood.csv": ("casadi", *FIGURES, *SCIPY),
    "scene list": ("numpy", "casadi", *FIGURES, *SCIPY),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, library: Library) -> Path:
    """A folder with the library that the commands read, where they may write."""
    place = tmp_path_factory.mktemp("commands")
    (place / "out" / "wood_on_foam").mkdir(parents=True)
    library.save(place / "out" / "wood_on_foam" / "library.npz")
    return place


def loaded(*names: str) -> str:
    """An expression: those of the modules that are loaded."""
    return f"[name for name in {names} if name in sys.modules]"


def told_at_its_end(what: str, words: str, folder: Path) -> str:
    """What expressions say at the end of a command, in a process of its own."""
    counted = f"import atexit, sys; atexit.register(lambda: print({what}))"
    ended = subprocess.run(
        [sys.executable, "-c", f"{counted}; from transopt.cli.start import transopt; transopt()", *words.split()],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))},
        capture_output=True,
        text=True,
        timeout=110,
        check=True,
    )
    return ended.stdout.splitlines()[-1]


@pytest.mark.parametrize("command", LOADS_NOT)
def test_a_command_loads_nothing_that_only_others_need(folder: Path, command: str) -> None:
    assert told_at_its_end(loaded(*LOADS_NOT[command]), command, folder) == "[]"


def test_figures_are_drawn_without_the_optimiser_and_without_lists_of_properties(folder: Path) -> None:
    """What a command leaves out of matplotlib are docstrings of classes; what the classes can do is the same."""
    line = "sys.modules['matplotlib.lines'].Line2D"
    others = loaded("casadi", "matplotlib.pyplot", *SCIPY)
    what = f"{others}, 'alpha' in {line}.set.__doc__, {line}([0], [0], alpha=0.5).get_alpha()"
    assert told_at_its_end(what, "solve", folder) == "[] False 0.5"


def test_who_calls_from_python_finds_matplotlib_documented() -> None:
    from matplotlib.lines import Line2D

    assert "alpha" in str(Line2D.set.__doc__)
