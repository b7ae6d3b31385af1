"""The checker that reads a library without the project's code, where one lies beside the checkout."""

import sys
import warnings
from contextlib import redirect_stdout
from importlib import import_module
from io import StringIO
from pathlib import Path
from unittest import mock

import pytest

from tests.benches.places import IMPACTS
from transopt.library.library import Library

CHECKER = IMPACTS.parents[1] / "tools" / "check_table.py"


def assert_independent_check_is_clean(library: Library, path: Path, *, resolved: int = 1) -> None:
    """Save a library, and let the checker discretise, replay and evaluate every entry and solve some of them again.

    It runs in this process, since an interpreter of its own takes five times as long to start as it to check.

    Parameters
    ----------
    resolved : how many entries it solves again, by an interior-point program of another make.
    """
    if not CHECKER.exists():
        pytest.skip(f"the independent checker is not at {CHECKER}")
    library.save(path)
    words, said = [str(CHECKER), str(path), "--resolve", str(resolved)], StringIO()
    if str(CHECKER.parent) not in sys.path:
        sys.path.append(str(CHECKER.parent))
    with (
        mock.patch.object(sys, "argv", words),
        redirect_stdout(said),
        warnings.catch_warnings(action="ignore"),
        pytest.raises(SystemExit) as end,
    ):
        import_module(CHECKER.stem).main()
    assert not end.value.code, said.getvalue()
    assert "0 shortfalls" in said.getvalue()
