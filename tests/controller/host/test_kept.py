"""What a host keeps of devices: the names of their libraries, and what their test pulses did."""

from pathlib import Path

import pytest

from controller.host.kept import (
    LIBRARIES,
    PULSES,
    library_in_words,
    measured_pulse,
    remember_library,
    remember_pulse,
)


@pytest.fixture(autouse=True)
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """File of the names, in a home of its own."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path / "transopt" / "libraries"


@pytest.fixture
def pulses(file: Path) -> Path:
    """File of the measured pulses, beside it."""
    return file.with_name("pulses")


def test_a_library_has_the_last_name_it_was_given() -> None:
    assert library_in_words(bytes(32)) == "no library"
    assert library_in_words(b"\xab" * 32) == "library abababab"
    remember_library(b"\xab" * 32, "wood on\nfoam")
    remember_library(b"\xcd" * 32, "metal")
    assert library_in_words(b"\xab" * 32) == "wood on foam (abababab)"
    remember_library(b"\xab" * 32, "wood")
    assert library_in_words(b"\xab" * 32) == "wood (abababab)"
    assert library_in_words(b"\xcd" * 32) == "metal (cdcdcdcd)"


def test_the_file_stays_small_and_a_damaged_one_names_nothing(file: Path) -> None:
    for number in range(LIBRARIES.most + 5):
        remember_library(number.to_bytes(32, "big"), f"scene {number}")
    assert len(file.read_text(encoding="utf-8").splitlines()) == LIBRARIES.most
    file.write_bytes(b"\xff\xfe")
    assert library_in_words(b"\x07" * 32) == "library 07070707"
    remember_library(b"\x07" * 32, "wood")
    assert library_in_words(b"\x07" * 32) == "wood (07070707)"


HASH, OTHER = b"\xab" * 32, b"\xcd" * 32


def test_a_measured_pulse_is_that_of_one_configuration(pulses: Path) -> None:
    assert measured_pulse(HASH) is None
    for value in (3.0, 15.25):
        remember_pulse(HASH, value)
    assert measured_pulse(HASH) == pytest.approx(15.25)
    assert measured_pulse(OTHER) is None
    assert len(pulses.read_text().splitlines()) == 1


def test_the_pulses_stay_few_and_a_damaged_file_means_not_measured(pulses: Path) -> None:
    hashes = [number.to_bytes(32, "big") for number in range(PULSES.most + 50)]
    for each in hashes:
        remember_pulse(each, 2.0)
    assert len(pulses.read_text().splitlines()) == PULSES.most
    assert measured_pulse(hashes[-1]) == pytest.approx(2.0)
    assert measured_pulse(hashes[0]) is None
    pulses.write_text(f"{HASH.hex()} -3.0\n{OTHER.hex()} many\n")
    assert [measured_pulse(each) for each in (HASH, OTHER)] == [None, None]
    pulses.write_bytes(b"\xff\xfe")
    assert measured_pulse(HASH) is None
    pulses.unlink()
    pulses.mkdir()
    remember_pulse(HASH, 2.0)
    assert measured_pulse(HASH) is None
