"""The independent checker of library files, which uses none of the project's code; without it a test skips."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.benches.places import IMPACTS
from transopt.library.library import Library

CHECKER = IMPACTS.parents[1] / "tools" / "check_table.py"


def assert_independent_check_is_clean(library: Library, path: Path, *, resolved: int = 1) -> None:
    """Save a library, and let the checker discretise, replay and evaluate every entry and solve some of them again.

    Parameters
    ----------
    resolved : how many entries it solves again, by an interior-point program of another make.
    """
    if not CHECKER.exists():
        pytest.skip(f"the independent checker is not at {CHECKER}")
    library.save(path)
    words = [sys.executable, str(CHECKER), str(path), "--resolve", str(resolved)]
    run = subprocess.run(words, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "0 shortfalls" in run.stdout
