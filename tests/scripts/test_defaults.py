"""The front of errors over heat, and one change of a scene at a time."""

import numpy as np
import pytest

import problems
from tests.benches.scripts import script
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene

defaults = script("defaults")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return with_values(problems.load("wood_on_foam"), defaults.ENTRY)


def test_a_price_on_heat_trades_it_for_the_tap_error(scene: Scene) -> None:
    free, priced = (defaults.means(with_values(scene, {"weights.heat_price": price})) for price in (0.0, 1e-5))
    assert priced.heat_A2_ms < 0.5 * free.heat_A2_ms
    assert priced.tap > free.tap
    assert priced.felt < 2 * free.felt


def test_a_window_is_told_as_a_share_and_other_keys_as_they_are(scene: Scene) -> None:
    found = defaults.changed(scene, {"time.stages": 0.75, "weights.plain": 0.25})
    assert (found.time.stages, found.weights.plain) == (600, 0.25)
    assert defaults.changed(scene, {}).time.stages == 800


def test_a_scene_that_a_change_makes_impossible_is_left_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(defaults, "SCENES", ("single_grip", "rapid_tapping"))
    monkeypatch.setattr(defaults, "CHANGES", defaults.CHANGES[:1] + defaults.CHANGES[2:3])
    assert [found is None for found in defaults.by_scene({"time.stages": 1.25})] == [False, True]
    row = next(line for line in defaults.change_table() if "window" in line)
    assert row.startswith("| window five quarters | 0.")
    assert "window five quarters" in capsys.readouterr().out


def test_the_figure_has_a_line_for_each_front() -> None:
    made = [defaults.Means(0.2 + 0.01 * k, 0.04, 0.5, 0.3, 500.0 - 50 * k) for k in range(3)]
    figure = defaults.front_figure({"a": made, "b": made[:2]}, made[0])
    for axes in figure.axes:
        assert [line.get_label() for line in axes.lines] == ["a", "b", "as it is"]
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata(), [20, 21, 22])
