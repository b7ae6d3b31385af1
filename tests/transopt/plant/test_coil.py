"""Coil temperature: the datasheet's continuous current, an independent integrator, the bound."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from transopt.base import recursions
from transopt.base.errors import InputError
from transopt.plant.coil import CoilModel, effective_square, following_square_mean
from transopt.scene.scene import Scene


@pytest.fixture
def coil(scene: Scene) -> CoilModel:
    model = scene.coil()
    assert model is not None
    return model


def rate(coil: CoilModel, T: np.ndarray, i_A: float) -> list[float]:
    power = coil.R_ohm * (1 + 0.0039 * (T[0] - 25)) * (abs(i_A) + 0.02) ** 2
    through = (T[0] - T[1]) / coil.R_wh_K_W
    away = (T[1] - coil.ambient_C) / coil.R_ha_K_W
    return [(power - through) * coil.R_wh_K_W / coil.tau_w_s, (through - away) * coil.R_ha_K_W / coil.tau_h_s]


def test_the_model_returns_the_datasheets_continuous_current(coil: CoilModel) -> None:
    assert coil.continuous_current_A() == pytest.approx(1.24, rel=0.01)
    assert coil.continuous_current_A() == pytest.approx(1.2476, abs=1e-4)


def test_continuous_current_is_the_steady_state_of_the_simulation(coil: CoilModel) -> None:
    steps = np.full(4000, 2.0)
    heat = np.full((1, 4000), coil.continuous_current_A() ** 2)
    winding, _ = coil.simulate(heat, steps)
    assert winding[0, -1] == pytest.approx(coil.limit_C, abs=0.05)


@pytest.mark.usefixtures("way")
def test_simulation_agrees_with_an_independent_integrator(coil: CoilModel) -> None:
    hot = replace(coil, start_winding_C=80.0, start_housing_C=60.0)
    currents = np.array([4.0, -3.0, 0.0, 2.0])
    T = np.array([80.0, 60.0])
    for i in currents:
        T = solve_ivp(lambda _, T, i=i: rate(hot, T, i), (0, 0.5), T, rtol=1e-11, atol=1e-11).y[:, -1]
    steps = np.full(2000, 1e-3)
    winding, housing = hot.simulate(np.repeat(effective_square(currents), 500)[None], steps)
    assert winding[0, -1] == pytest.approx(T[0], abs=1e-6)
    assert housing[0, -1] == pytest.approx(T[1], abs=1e-6)


@pytest.mark.parametrize(
    ("winding_C", "housing_C", "ambient_C"), [(25, 25, 25), (90, 30, 25), (30, 90, 25), (30, 40, 60)]
)
def test_the_adiabatic_bound_holds_and_is_not_idle(
    coil: CoilModel, winding_C: float, housing_C: float, ambient_C: float
) -> None:
    start = replace(coil, start_winding_C=winding_C, start_housing_C=housing_C, ambient_C=ambient_C)
    for duration in (0.06, 5.0):
        run = solve_ivp(
            lambda _, T: rate(start, T, 4.0),
            (0, duration),
            [winding_C, housing_C],
            rtol=1e-10,
            max_step=duration / 50,
        )
        bound = start.adiabatic_bound_C(4.0, duration)
        assert run.y[0].max() <= bound
        if winding_C == housing_C == ambient_C and duration < 1:
            # From equal temperatures next to no heat leaves within a tap.
            assert bound - run.y[0].max() < 0.01


def test_a_start_above_the_limit_is_named(scene: Scene) -> None:
    hot = scene.model_copy(update={"thermal": scene.thermal.model_copy(update={"start_winding_C": 101.0})})
    with pytest.raises(InputError, match=r"start_winding_C = 101 C is above the winding limit 100 C"):
        hot.coil()


@pytest.mark.parametrize("pole_Hz", [100.0, 1050.0, 30e3, 1e6])
@pytest.mark.parametrize(("before", "command"), [(0.0, 4.0), (-2.5, 2.5), (4.0, -0.01), (1.0, 1.0), (0.3, 0.0)])
def test_heat_of_a_current_that_follows_a_held_command(pole_Hz: float, before: float, command: float) -> None:
    """Against quadrature on points that are dense where the current moves; poles far below and above the step."""
    w, step = 2 * np.pi * pole_Hz, 12.5e-6
    t = (
        np.concatenate([[0.0], np.geomspace(1e-4 / w, step, 200_000)])
        if 1e-4 / w < step
        else np.linspace(0, step, 2000)
    )
    wanted = np.trapezoid(effective_square(command + (before - command) * np.exp(-w * t)), t) / step
    found = following_square_mean(np.array([before]), np.array([command]), np.array([w * step]))
    assert found[0] == pytest.approx(wanted, rel=1e-6)


def test_a_step_without_length_heats_as_its_current() -> None:
    assert following_square_mean(np.array([3.0]), np.array([-1.0]), np.array([0.0]))[0] == pytest.approx(3.02**2)


@pytest.mark.skipif(recursions.COMPILED is None, reason="the extension is not built")
def test_heat_is_the_same_with_and_without_the_extension(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(0)
    before, command, decays = random.uniform(-3, 3, (4, 70)), random.uniform(-3, 3, (4, 70)), random.uniform(0, 9, 70)
    before[1, 3], command[2, 50], decays[7] = np.nan, np.inf, 0.0
    with np.errstate(invalid="ignore"):
        compiled = following_square_mean(before, command, decays, 0.05)
        monkeypatch.setattr(recursions, "COMPILED", None)
        np.testing.assert_allclose(compiled, following_square_mean(before, command, decays, 0.05), rtol=1e-12)


@pytest.mark.skipif(recursions.COMPILED is None, reason="the extension is not built")
@pytest.mark.parametrize("nodes", [1, 2])
@pytest.mark.parametrize(("tau_w_s", "tau_h_s"), [(7.5, 700.0), (1e-6, 1e-5), (1e3, 1e-4)])
def test_temperatures_are_the_same_with_and_without_the_extension(
    coil: CoilModel, nodes: int, tau_w_s: float, tau_h_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    varied = replace(coil, nodes=nodes, tau_w_s=tau_w_s, tau_h_s=tau_h_s)
    random = np.random.default_rng(nodes)
    # Courses are worked on in turns of four, and the rest one by one.
    heat, steps = random.uniform(0.0, 2.0, (6, 60)), 10.0 ** random.uniform(-7, 0, 60)
    heat[1, 30], heat[4, 40] = np.nan, np.inf
    compiled = np.stack(varied.simulate(heat, steps))
    monkeypatch.setattr(recursions, "COMPILED", None)
    banded = np.stack(varied.simulate(heat, steps))
    np.testing.assert_array_equal(np.isinf(compiled), np.isinf(banded))
    assert np.isfinite(compiled[:, [0, 2, 3, 5]]).all()
    assert np.isinf(compiled[0, [1, 4], -1]).all()
    known = np.isfinite(compiled)
    np.testing.assert_allclose(compiled[known], banded[known], rtol=1e-9)


@pytest.mark.usefixtures("way")
def test_a_coil_that_runs_away_within_one_period_is_hot_for_ever() -> None:
    coil = CoilModel(2.18, 3.1, 14.0, 2e-5, 75.0, 100.0)
    winding, housing = coil.steady_course(np.full((1, 40), 1e4), np.full(40, 2e-4), 0.01, np.zeros(1))
    assert np.all(np.isposinf(winding))
    assert not np.any(np.isnan(housing))


def test_a_coil_that_runs_away_is_infinitely_hot_and_no_other_is() -> None:
    coil = CoilModel(2.18, 3.1, 14.0, 12.0, 612.0, 100.0)
    heat = np.array([np.full(50, 1e12), np.full(50, 1.0)])
    winding, housing = coil.simulate(heat, np.full(50, 1e-2))
    assert winding[0, -1] == housing[0, -1] == np.inf
    alone, _ = coil.simulate(heat[1:], np.full(50, 1e-2))
    # In arrays of another shape every one of the steps may round otherwise.
    np.testing.assert_allclose(winding[1], alone[0], rtol=50 * np.finfo(float).eps)
