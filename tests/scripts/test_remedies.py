"""What is said to do for a refused entry does: the script of that name in short, and on request in full."""

import pytest

from problems.stress.draw import drawn
from scripts.remedies import SCENES, Place, campaign, few_scenes, main, read, refusals, stress

SEED, CASES = 31337, 120
SHORT = 60  # stages


def test_a_sentence_is_read_as_it_is_meant() -> None:
    assert read("limits.current_A = 2 A and amplifier.command_limit_A = 3e-05 A, or no feedback would do") == [
        {"limits.current_A": 2.0, "amplifier.command_limit_A": 3e-5},
        {"feedback": None},
    ]
    assert read("tried in vain, as far as limits.supply_V = 48 V") == []


@pytest.mark.parametrize("place", few_scenes(), ids=lambda place: place.name)
def test_every_remedy_of_a_scene_does(place: Place) -> None:
    found = refusals(place)
    assert found
    for refusal in found:
        assert refusal.stated, refusal.sentence
        assert refusal.failed == []


def test_every_remedy_of_random_cases_does() -> None:
    short = [place for place in stress(SEED, CASES) if place.case is not None and place.case.horizon.stages <= SHORT]
    found, broken = campaign(short, 1)
    assert broken == []
    assert len(found) >= 5
    for refusal in found:
        assert refusal.stated, f"{refusal.place}: {refusal.sentence}"
        assert refusal.failed == [], refusal.place


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_every_remedy_of_three_thousand_cases_and_a_grid_of_scenes_does() -> None:
    assert main([]) == 0


def test_a_grid_holds_every_kind_of_limit() -> None:
    keys = {key for place in SCENES["all"]() for key in place.values}
    assert keys >= {
        "limits.current_A",
        "limits.slew_A_per_s",
        "limits.supply_V",
        "limits.stroke_m",
        "limits.velocity_m_s",
        "feedback.stiffness_N_m",
        "thermal.start_winding_C",
        "thermal.headroom_K",
        "thermal.idle_A",
    }
    assert drawn(SEED, 3) == stress(SEED, 4)[3].case
