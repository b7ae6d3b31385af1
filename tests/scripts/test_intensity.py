"""The search for intensity on the default scene: what it costs, and its certificates challenged by IPOPT."""

import json
from pathlib import Path

import pytest

from scripts.intensity import Found, main


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> list[Found]:
    file = tmp_path_factory.mktemp("intensity") / "found.json"
    assert main(json=file) == 0
    return [Found(**row) for row in json.loads(file.read_text())]


def test_every_entry_within_reach_has_the_energy(found: list[Found]) -> None:
    assert len(found) == 36
    searched = [each for each in found if each.searched]
    assert len(searched) == 20
    assert all(abs(each.energy_dB) <= 0.02 for each in searched)
    assert all(each.relative_gap <= 1e-6 and each.accepted for each in found)


def test_it_takes_few_problems(found: list[Found]) -> None:
    problems = sorted(each.problems for each in found if each.searched)
    assert problems[len(problems) // 2] <= 5
    assert problems[-1] <= 8


def test_no_start_of_ipopt_finds_a_nearer_waveform_with_as_much_energy(tmp_path: Path) -> None:
    file = tmp_path / "found.json"
    assert main(currents="2.5", starts=2, json=file) == 0
    rows = [Found(**row) for row in json.loads(file.read_text())]
    challenged = [each for each in rows if each.searched]
    assert challenged
    assert all(each.met > 0 for each in challenged)
    assert all(each.objective <= each.rival + 1e-6 * max(each.objective, 1e-3) for each in challenged)


def test_what_falls_short_is_named(found: list[Found]) -> None:
    worse = Found(**{**vars(found[-1]), "rival": 0.5 * found[-1].objective, "energy_dB": 0.05, "price": 0.5})
    assert len(worse.short) == 2
    assert "IPOPT found" in worse.short[1]
