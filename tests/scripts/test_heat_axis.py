"""Cool commands beside scaled first ones, their blends, and minutes on a warm coil."""

from dataclasses import replace

import numpy as np
import pytest

from controller.waveforms.bank import bank
from tests.benches.scripts import script
from transopt.library.library import Library

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
