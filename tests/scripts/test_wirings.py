"""The check's trials in short: one wiring of each kind, and the desk."""

from pathlib import Path

import pytest

from scripts import desk, wirings
from transopt.library.library import Library

CASES = wirings.cases(0, quick=True)


@pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])
def test_a_wiring_is_judged_right(library: Library, c_compiler: None, case: wirings.Case) -> None:
    outcome = wirings.judged(library, case)
    assert outcome.right, outcome


@pytest.mark.long
def test_every_wiring_is_judged_right(library: Library, c_compiler: None, tmp_path: Path) -> None:
    library.save(tmp_path / "library.npz")
    outcomes = wirings.trials(wirings.cases(0, quick=False), tmp_path / "library.npz", 2)
    assert [outcome for outcome in outcomes if not outcome.right] == []


def test_taps_on_a_desk(library: Library, c_compiler: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four of the twelve, one at each speed."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(desk, "EACH", 1)
    library.save(tmp_path / "library.npz")
    assert desk.judged(tmp_path / "library.npz", tmp_path, 0, None) == 0
