"""The names of the libraries that devices hold."""

from pathlib import Path

import pytest

from controller.host import library_names


@pytest.fixture(autouse=True)
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """File of the names, in a home of its own."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path / "transopt" / "libraries"


def test_a_library_has_the_last_name_it_was_given() -> None:
    assert library_names.in_words(bytes(32)) == "no library"
    assert library_names.in_words(b"\xab" * 32) == "library abababab"
    library_names.remember(b"\xab" * 32, "wood on\nfoam")
    library_names.remember(b"\xcd" * 32, "metal")
    assert library_names.in_words(b"\xab" * 32) == "wood on foam (abababab)"
    library_names.remember(b"\xab" * 32, "wood")
    assert library_names.in_words(b"\xab" * 32) == "wood (abababab)"
    assert library_names.in_words(b"\xcd" * 32) == "metal (cdcdcdcd)"


def test_the_file_stays_small_and_a_damaged_one_names_nothing(file: Path) -> None:
    for number in range(library_names.KEPT + 5):
        library_names.remember(number.to_bytes(32, "big"), f"scene {number}")
    assert len(file.read_text(encoding="utf-8").splitlines()) == library_names.KEPT
    file.write_bytes(b"\xff\xfe")
    assert library_names.in_words(b"\x07" * 32) == "library 07070707"
    library_names.remember(b"\x07" * 32, "wood")
    assert library_names.in_words(b"\x07" * 32) == "wood (07070707)"
