"""Populations of hands: their file, the hands drawn from them, and the robust designs that serve them."""

from pathlib import Path

import numpy as np
import pytest

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.plant.hand import HandSection
from transopt.scene.builtin import FOLDER, POPULATION, SCENES, load_scene
from transopt.scene.file import read_scene
from transopt.scene.keys import with_values
from transopt.scene.population import PARAMETERS, Population, load_population


@pytest.fixture(scope="module")
def population() -> Population:
    return load_population(POPULATION)


def logarithms(hand: HandSection, grips_N: list[float]) -> FloatArray:
    """(10,) as a population has them."""
    return np.log([hand.line(name).at(grip) for grip in grips_N for name in PARAMETERS])


def test_the_median_hand_is_that_of_the_default_scene(population: Population) -> None:
    median = population.hand(population.mean())
    own = load_scene("wood_on_foam").model.hand  # type: ignore[union-attr]
    for grip in (1.0, 3.0, 5.0):
        for name in PARAMETERS:
            assert median.line(name).at(grip) == pytest.approx(own.line(name).at(grip))


def test_drawn_hands_have_the_medians_spreads_and_correlations_of_the_file(population: Population) -> None:
    drawn = population.drawn(4000, 3, population.grips_N)
    found = np.array([logarithms(hand, population.grips_N) for hand in drawn])
    # Pairs of opposite deviations: the mean is that of the file but for pairs of which one is cut off.
    assert found.mean(axis=0) == pytest.approx(population.mean(), abs=0.01)
    assert np.abs(np.cov(found.T) - population.covariance()).max() < 0.02
    assert population.factor() @ population.factor().T == pytest.approx(population.covariance(), abs=1e-12)


def test_the_same_seed_draws_the_same_hands_and_wider_ones_lie_farther_out(population: Population) -> None:
    grips = population.grips_N
    first, again, other = (population.drawn(3, seed, grips) for seed in (5, 5, 6))
    assert first == again
    assert first != other
    far = [logarithms(each, grips) - population.mean() for each in population.drawn(3, 5, grips, wider=1.5)]
    near = [logarithms(each, grips) - population.mean() for each in first]
    assert np.array(far) == pytest.approx(1.5 * np.array(near))


def test_hands_that_are_not_passive_at_a_grip_are_not_drawn(population: Population) -> None:
    for hand in population.drawn(50, 1, [0.3, 1.0, 5.0, 9.0], wider=1.5):
        assert all(hand.line(name).at(grip) > 0 for name in PARAMETERS for grip in (0.3, 9.0))
    steep = population.model_dump()
    steep["skin_damping_N_s_m"]["median"] = [1.0, 100.0]
    with pytest.raises(InputError, match=r"hardly any is passive at 0\.1, 5 N"):
        Population.model_validate(steep).drawn(2, 1, [0.1, 5.0])


@pytest.mark.parametrize(
    ("line", "instead", "words"),
    [
        ("spread = 0.40", "spraed = 0.40", "unknown key.*did you mean spread"),
        ("spread = 0.40", "spread = 4.0", r"arm_stiffness_N_m.spread = 4\.0: must be less than or equal to 1"),
        ("grips_N = [1.0, 5.0]", "grips_N = [5.0, 1.0]", "the light one first"),
        ('of = ["mass_kg", "arm_stiffness_N_m"]', 'of = ["mass_kg", "arm"]', "name two of mass_kg"),
        ("value = 0.3", "value = -0.99", "negative eigenvalue"),
        ("median = [270.0, 710.0]", "median = [270.0, -1.0]", "must be greater than 0"),
    ],
)
def test_a_file_that_is_no_population_is_told_in_one_line(
    tmp_path: Path, line: str, instead: str, words: str
) -> None:
    text = POPULATION.read_text()
    assert line in text
    if "0.99" in instead:  # mass against arm stiffness, while both go with damping
        text += '\n[[correlations]]\nof = ["mass_kg", "arm_damping_N_s_m"]\nvalue = 0.9\nsource = "a test"\n'
    (tmp_path / "hands.toml").write_text(text.replace(line, instead))
    with pytest.raises(InputError, match=words):
        load_population(tmp_path / "hands.toml")


class TestRobust:
    def scene_file(self, tmp_path: Path, name: str, population: str) -> Path:
        text = (SCENES / f"{name}.toml").read_text()
        made = tmp_path / "made.toml"
        made.write_text(f'{text}\n[robust]\npopulation = "{population}"\nsamples = 3\n')
        return made

    def test_a_scene_names_the_file_and_serves_its_hands(self, tmp_path: Path, population: Population) -> None:
        scene = read_scene(self.scene_file(tmp_path, "wood_on_foam", "populations/stylus_grip.toml"), search=[FOLDER])
        spread = scene.spread(3.0)
        assert [grip for _, grip in spread] == [3.0] * 3
        hands = [device.model.hand for device, _ in spread]  # type: ignore[union-attr]
        assert hands == [device.model.hand for device, _ in scene.spread(1.0)]  # type: ignore[union-attr]
        assert len({str(hand) for hand in hands}) == 3
        for device, _ in spread:
            assert not np.allclose(device.plant(3.0).A, scene.plant(3.0).A, rtol=1e-3)

    def test_what_has_no_hand_of_its_own_is_refused(self, tmp_path: Path, population: Population) -> None:
        with pytest.raises(InputError, match=r"robust\.population: spreads the hand that a scene states"):
            read_scene(self.scene_file(tmp_path, "second_order", "populations/stylus_grip.toml"), search=[FOLDER])
        with pytest.raises(InputError, match=r"robust\.population = 'hands.toml': no such file"):
            read_scene(self.scene_file(tmp_path, "wood_on_foam", "hands.toml"), search=[FOLDER])
        with pytest.raises(InputError, match="has no separate hand"):
            load_scene("second_order").in_hand(population.hand(population.mean()))

    def test_a_robust_scene_is_another_one_by_its_population(self, population: Population) -> None:
        scene = load_scene("wood_on_foam")
        robust = with_values(scene, {"robust": {"population": population.model_dump(), "samples": 2}})
        assert robust.robust.population == population
