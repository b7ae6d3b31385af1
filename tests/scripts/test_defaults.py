"""The front of errors over heat, one change of a scene at a time, and what cool commands do on that front."""

from dataclasses import replace

import numpy as np
import pytest

import problems
from controller.waveforms.bank import bank
from tests.benches.scripts import script
from transopt.library.library import Library
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


heat_axis = script("heat_axis")


@pytest.fixture(scope="module")
def library() -> Library:
    return heat_axis.cooled(heat_axis.SHARE)


def test_at_a_third_of_the_heat_what_is_felt_stays(library: Library) -> None:
    found = heat_axis.left(library, heat_axis.SHARE)
    assert [each.grip_N for each in found] == [1.0, 3.0, 5.0]
    for each, most_tap in zip(found, (0.33, 0.35, 0.41), strict=True):
        assert each.optimum.felt_dB >= -0.45
        assert each.optimum.felt_error <= 0.09
        assert each.optimum.tap_error <= most_tap
        assert each.scaled.felt_dB < -4.0
        assert each.scaled.tap_error > each.optimum.tap_error


@pytest.mark.parametrize("bits", [16, 8])
def test_random_blends_of_what_is_stored_keep_the_limits(library: Library, bits: int) -> None:
    found = heat_axis.blended(library, bits, 5000, seed=7)
    assert found.over == 0
    # A blend is weaker than the strongest node, and nearly as strong.
    assert 0.95 * library.input_limit < found.current_A <= library.input_limit + 1e-3
    weights = heat_axis._weights(4, 3, 100, np.random.default_rng(1))
    assert weights.sum(axis=1) == pytest.approx(1.0)
    assert np.all(weights >= 0)


def test_a_warm_coil_plays_a_cool_command_where_it_scaled_the_first(library: Library) -> None:
    """Half a minute is enough where less than a kelvin is left."""
    coil = library.coil()
    meta = {**library.meta, "scene": {**library.meta["scene"]}}
    meta["scene"]["thermal"] = {**meta["scene"]["thermal"], "start_winding_C": 94.9, "start_housing_C": 94.0}
    warm = replace(library, meta=meta)
    stored = bank(warm)
    both = heat_axis.taps_for(warm, stored, 0.5, seed=3)
    alone = heat_axis.taps_for(warm, replace(stored, cool_command_A=None, cool_transient_A=[]), 0.5, seed=3)
    assert alone.played["scaled"] > 0
    assert alone.played["blended"] == 0
    assert both.played["blended"] > 0
    assert both.played["withheld"] <= alone.played["withheld"]
    assert both.worst_dB > alone.worst_dB
    assert max(both.hottest_C, alone.hottest_C) <= coil.limit_C
