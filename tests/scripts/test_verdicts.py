"""Verdicts against the drive of other make in short, and the arithmetic by which one is said to hold."""

from pathlib import Path

import numpy as np
import pytest
import verdicts
from verdicts import Verdict

from tests.benches.other_device import Device, NoCompilerError, simulate


@pytest.fixture
def _compiled() -> None:
    try:
        simulate(Device(), np.zeros(1))
    except NoCompilerError as missing:
        pytest.skip(str(missing))


def of(effect: str, predicted: float, true: float, **more: list[str]) -> Verdict:
    return Verdict(effect, 0, predicted=[[predicted, predicted]], true=[[true, true]], **more)


@pytest.mark.parametrize(
    ("predicted", "true", "holds"),
    [(0.05, 0.05, True), (0.09, 0.05, True), (0.03, 0.05, True), (0.11, 0.05, False), (0.02, 0.05, False)],
)
def test_half_to_twice_the_true_error_holds(predicted: float, true: float, holds: bool) -> None:
    assert (not of("friction", predicted, true).shortcoming) is holds


def test_small_errors_are_held_to_a_tenth_of_a_point() -> None:
    assert not of("none", 0.0010, 0.0001).shortcoming
    assert of("none", 0.0013, 0.0001).shortcoming


def test_the_worst_entry_counts_as_the_median_does() -> None:
    found = Verdict("drift", 0, predicted=[[0.05, 0.05, 0.05]], true=[[0.05, 0.05, 0.2]])
    assert found.of(np.max) == (0.05, 0.2)
    assert found.shortcoming


def test_a_refusal_holds_by_the_right_name_only_and_never_on_the_plain_device() -> None:
    said = {"shortfalls": ["misses 9 %"]}
    assert not of("friction", 0.5, 0.05, causes=["friction"], **said).shortcoming
    assert of("friction", 0.5, 0.05, causes=["backlash"], **said).shortcoming
    assert of("friction", 0.5, 0.05, causes=["friction"]).shortcoming
    assert of("none", 0.0, 0.0, causes=["friction"]).shortcoming == "false alarm"


@pytest.mark.usefixtures("_compiled")
@pytest.mark.parametrize("effect", ["none", "pole", "stiffening"])
def test_verdicts_in_short(effect: str, tmp_path: Path) -> None:
    found = verdicts.judge(effect, 0, tmp_path, grips_N=(1.0, 3.0, 5.0), trials=2)
    assert not found.shortcoming
    assert found.against_taps < found.nominal_against_taps
    expected = {"pole": "unstated accelerometer pole", "stiffening": "stiffening"}
    assert effect == "none" or expected[effect] in found.causes
