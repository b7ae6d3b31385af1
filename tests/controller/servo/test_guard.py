"""The servo's coil temperature and the scale it allows."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize

from controller.waveforms.bank import Bank, bank
from tests.benches.oracle.blend import blend_at
from tests.benches.oracle.guard import Guard
from transopt.library.library import Library
from transopt.plant.coil import CoilModel, effective_square
from transopt.problem.warm_coil import currents, norms

DT_S = 1e-4
COIL = CoilModel(R_ohm=2.18, R_wh_K_W=3.1, R_ha_K_W=14.0, tau_w_s=12.0, tau_h_s=612.0, limit_C=100.0)


def _guard(coil: CoilModel = COIL) -> Guard:
    return Guard(coil, DT_S, withhold_K=5.0, least_scale=0.25)


@pytest.mark.parametrize("nodes", [1, 2])
def test_follows_the_coil_model(nodes: int) -> None:
    coil = replace(COIL, nodes=nodes, start_winding_C=60.0, start_housing_C=45.0)
    guard = _guard(coil)
    current = 3 * np.random.default_rng(0).standard_normal(20_000)
    for value in current.tolist():
        guard.step(value)
    heat = effective_square(current).reshape(1, -1, 100).mean(axis=2)
    winding, housing = coil.simulate(heat, np.full(heat.shape[1], 0.01))
    # The guard's midpoint rule against the model's exact steps: second order in 10 ms over 12 s, 3e-7 K.
    assert guard.winding_C == pytest.approx(winding[0, -1], abs=1e-6)
    assert guard.housing_C == pytest.approx(housing[0, -1], abs=1e-6)


@pytest.mark.parametrize("ripple_A", [0.03, 0.1])
@pytest.mark.parametrize("pattern", [[1.0], [1.0, 0.0], [1.0, 0.2, 0.0, 0.0, 0.0], [1.0] * 20 + [0.0] * 1000])
def test_a_limit_by_another_ripple_keeps_the_coils_own(ripple_A: float, pattern: list[float]) -> None:
    """A device counts 0.02 A: currents that just keep the limit by its estimate truly keep the coil's."""
    coil, steps = replace(COIL, ripple_A=ripple_A), np.full(6000, 0.5)
    told = coil.on_a_device()
    course = np.resize(pattern, steps.size)

    def hottest(size_A: float, counted_A: float) -> float:
        winding, _ = coil.simulate(effective_square(size_A * course, counted_A)[None], steps)
        return float(winding.max())

    size_A = optimize.brentq(lambda size: hottest(size, 0.02) - told.limit_C, 0.5, 20.0)
    assert hottest(size_A, ripple_A) <= coil.limit_C
    if pattern == [1.0]:
        assert hottest(size_A, ripple_A) > coil.limit_C - 0.5
    assert replace(coil, ripple_A=0.02).on_a_device().limit_C == coil.limit_C


@settings(max_examples=200, deadline=None)
@given(st.floats(0, 200), st.floats(0, 50), st.floats(25, 99), st.floats(25, 99))
def test_scale_uses_up_the_margin_and_no_more(
    transient_A: float, feedback_A: float, winding_C: float, housing_C: float
) -> None:
    guard = _guard()
    guard.winding_C, guard.housing_C = winding_C, housing_C
    scale = guard.scale(transient_A, feedback_A, 600)
    left = guard.play_limit_C - winding_C
    assert scale == 0.0 or 0.25 <= scale <= 1.0
    if scale > 0.0:
        assert guard.rise_K(transient_A, feedback_A, 600, scale) <= left + 1e-9
    if scale < 1.0:
        assert guard.rise_K(transient_A, feedback_A, 600, 1.0) > left
    if 0.0 < scale < 1.0:
        assert guard.rise_K(transient_A, feedback_A, 600, scale) == pytest.approx(left, abs=1e-9)


@pytest.fixture(scope="module")
def table(library: Library) -> Bank:
    return bank(library)


@pytest.mark.parametrize("seed", range(8))
def test_four_corners_bound_the_heat_of_a_blend(library: Library, table: Bank, seed: int) -> None:
    rng = np.random.default_rng(seed)
    part, scale = rng.uniform(0, 1), rng.uniform(0.25, 1)
    play = blend_at(table, rng.uniform(0.1, 0.4), rng.uniform(1, 5))
    held = np.concatenate([[0.0], play.samples_A, [0.0]])
    command = scale * ((1 - part) * held[1:] + part * held[:-1])
    amplifier = library.amplifier()
    current = currents(command, amplifier, DT_S)
    assert norms(current, amplifier, DT_S) <= scale * play.transient_A * (1 + 1e-12)
    # The real rise, in fine steps, stays below the predicted one.
    coil = replace(COIL, start_winding_C=80.0, start_housing_C=rng.choice([60.0, 90.0]))
    fine = np.linspace(current[:-1], current[1:], 5)[:-1].T.ravel()
    winding, _ = coil.simulate(effective_square(fine)[None], np.full(fine.size, DT_S / 4))
    predicted = _guard(coil).rise_K(play.transient_A, play.feedback_A, len(play.samples_A) + 1, scale)
    assert winding.max() - 80.0 <= predicted


@pytest.mark.parametrize("current_A", [1.5, 2.5, 4.0])
def test_trips_before_the_true_winding_passes_its_limit(current_A: float) -> None:
    """A wall leaned on, between two updates too, with two more ticks until the answer is felt."""
    coil = replace(COIL, start_winding_C=99.8, start_housing_C=99.0)
    guard, heat = _guard(coil), float(effective_square(np.array([current_A]))[0])
    ticks = 0
    while not guard.too_hot:
        guard.step(current_A)
        ticks += 1
    winding, _ = coil.simulate(np.full((1, ticks + 2), heat), np.full(ticks + 2, DT_S))
    assert coil.limit_C - 0.01 < winding[0, -1] <= coil.limit_C
