"""The heating of a servo period and the recursion of the winding's temperature, against independent oracles."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import CoilModel
from transopt.plant.time_grid import TimeGrid
from transopt.problem.heat import Budget, HeatModel, heating
from transopt.problem.limits.temperature import temperature_limit
from transopt.scene.scene import Scene

AMPLIFIER = Amplifier(pole_Hz=1050.0, delay_s=0.0, command_limit=6.0)
DT_S = 1e-4


@pytest.fixture(scope="module")
def coil(scene: Scene) -> CoilModel:
    model = scene.coil()
    assert model is not None
    return model


def quadrature(before: float, command: float, amplifier: Amplifier, dt_s: float) -> float:
    """Mean of (|i| + 0.02)^2 along i(t) = c + (i - c) exp(-w t), split where the sign changes."""
    w = 2 * np.pi * amplifier.pole_Hz
    ends = [0.0, dt_s]
    if before * (before - command) > 0 and command / (command - before) > 0:
        crossing = np.log((before - command) / -command) / w
        if 0 < crossing < dt_s:
            ends.insert(1, crossing)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    total = 0.0
    for start, end in itertools.pairwise(ends):
        t = start + (end - start) * (nodes + 1) / 2
        current = command + (before - command) * np.exp(-w * t)
        total += float((np.abs(current) + 0.02) ** 2 @ weights) * (end - start) / 2
    return total / dt_s


class TestHeating:
    def test_against_quadrature_while_the_sign_stays(self) -> None:
        """Exact: between a current and a command of one sign the current keeps it."""
        random = np.random.default_rng(1)
        for pole, dt in ((1050.0, 1e-4), (300.0, 1e-4), (5000.0, 2e-4), (1050.0, 2e-5)):
            amplifier = replace(AMPLIFIER, pole_Hz=pole)
            model = heating(amplifier, dt)
            for _ in range(50):
                i, c = random.choice([-1.0, 1.0]) * random.uniform(0.0, [4.0, 6.0])
                found = float(model.mean_square(np.array(i), np.array(c)))
                assert found == pytest.approx(quadrature(i, c, amplifier, dt), rel=1e-11)

    def test_a_change_of_sign_is_underestimated_by_the_ripple_of_the_smaller_side(self) -> None:
        """|mean i| instead of the mean of |i|: short by twice the smaller of the two areas, in the ripple term."""
        random = np.random.default_rng(2)
        model, changes, largest = heating(AMPLIFIER, DT_S), 0, 0.0
        for _ in range(400):
            i, c = random.uniform(-4, 4), random.uniform(-6, 6)
            after = float(model.after(np.array(i), np.array(c)))
            if i * after >= 0:
                continue
            short = quadrature(i, c, AMPLIFIER, DT_S) - float(model.mean_square(np.array(i), np.array(c)))
            changes += 1
            assert -1e-12 <= short <= 0.04 * 2 * min(abs(i), abs(after))
            largest = max(largest, short)
        assert changes > 50
        assert largest < 0.05, "of up to 16 A^2"

    def test_an_ideal_amplifier_heats_by_its_command(self) -> None:
        command = np.array([-4.0, 0.0, 0.5])
        found = heating(None, DT_S).mean_square(np.full(3, 9.0), command)
        np.testing.assert_allclose(found, (np.abs(command) + 0.02) ** 2, rtol=1e-14)

    @pytest.mark.parametrize("amplifier", [AMPLIFIER, None])
    def test_gradient_by_differences(self, amplifier: Amplifier | None) -> None:
        model, random, step = heating(amplifier, DT_S), np.random.default_rng(3), 1e-6
        i, c = random.uniform(-4, 4, (2, 200))
        mean = model.mean_current(i, c)
        i, c = i[np.abs(mean) > 1e-3], c[np.abs(mean) > 1e-3]
        by_current, by_command = model.gradient(i, c, np.sign(model.mean_current(i, c)))
        differences = (model.mean_square(i + step, c) - model.mean_square(i - step, c)) / (2 * step)
        np.testing.assert_allclose(by_current, differences, atol=1e-8)
        differences = (model.mean_square(i, c + step) - model.mean_square(i, c - step)) / (2 * step)
        np.testing.assert_allclose(by_command, differences, atol=1e-8)

    @pytest.mark.parametrize("slope", [-1.0, 0.3, 1.0])
    def test_at_the_kink_every_slope_is_a_tangent_from_below(self, slope: float) -> None:
        """What the certificate takes it for: a subgradient of a convex function."""
        model = heating(AMPLIFIER, DT_S)
        i = 0.7
        # The command at which the mean current is zero.
        weight = model.share + (1 - model.share) * model.decay
        c = -i * weight / ((1 - model.share) * (1 - model.decay))
        assert float(model.mean_current(np.array(i), np.array(c))) == pytest.approx(0, abs=1e-15)
        by_current, by_command = model.gradient(np.array(i), np.array(c), np.array(slope))
        random = np.random.default_rng(12)
        for size in (1.0, 1e-2, 1e-4):
            di, dc = random.uniform(-size, size, (2, 1000))
            tangent = float(model.mean_square(np.array(i), np.array(c))) + by_current * di + by_command * dc
            assert np.all(model.mean_square(i + di, c + dc) >= tangent - 1e-14)

    @pytest.mark.parametrize("pole_Hz", [100.0, 1050.0, 20e3, None])
    def test_convex_in_current_and_command(self, pole_Hz: float | None) -> None:
        """What the lower bound on J rests on, the kink included."""
        model = heating(None if pole_Hz is None else replace(AMPLIFIER, pole_Hz=pole_Hz), DT_S)
        random = np.random.default_rng(4)
        for size in (6.0, 0.1, 0.004):
            a, b = random.uniform(-size, size, (2, 2, 5000))
            chord = (model.mean_square(*a) + model.mean_square(*b)) / 2
            assert np.all(model.mean_square(*((a + b) / 2)) <= chord + 1e-14)


def ode(coil: CoilModel, command: np.ndarray, *, housing_held: bool = False) -> np.ndarray:
    """(N + 1, 2) winding and housing at tau_0 to tau_N, DOP853 on the equations of `CoilModel`'s docstring."""
    w = 2 * np.pi * AMPLIFIER.pole_Hz
    C_w, C_h = coil.tau_w_s / coil.R_wh_K_W, coil.tau_h_s / coil.R_ha_K_W
    course = [np.array([coil.start_winding_C, coil.start_housing_C])]
    current = 0.0
    # From the first tick on; the first command is felt a delay later.
    for c, duration in [(0.0, AMPLIFIER.delay_s), *((c, DT_S) for c in command)]:

        def rate(t: float, T: np.ndarray, i: float = current, c: float = c) -> list[float]:
            heat = coil.R_ohm * (1 + 0.0039 * (T[0] - 25)) * (abs(c + (i - c) * np.exp(-w * t)) + 0.02) ** 2
            through = (T[0] - T[1]) / coil.R_wh_K_W
            away = (T[1] - coil.ambient_C) / coil.R_ha_K_W
            return [(heat - through) / C_w, 0.0 if housing_held else (through - away) / C_h]

        course.append(solve_ivp(rate, (0, duration), course[-1], method="DOP853", rtol=1e-12, atol=1e-10).y[:, -1])
        current = c + (current - c) * np.exp(-w * duration)
    return np.array(course[1:])


def tap_like(stages: int, sign_changes: bool, seed: int = 5) -> np.ndarray:
    random = np.random.default_rng(seed)
    return random.uniform(-5 if sign_changes else 0.5, 5, stages)


def currents(command: np.ndarray) -> np.ndarray:
    """(N,) currents at the switching instants."""
    p = np.exp(-2 * np.pi * AMPLIFIER.pole_Hz * DT_S)
    i = np.zeros(command.size)
    for k in range(command.size - 1):
        i[k + 1] = p * i[k] + (1 - p) * command[k]
    return i


def model_of(coil: CoilModel, stages: int, **budget: float) -> HeatModel:
    return temperature_limit(coil, AMPLIFIER, TimeGrid(DT_S, stages, 3e-4, 0.0), Budget(**budget)).model


class TestHeatModel:
    @pytest.mark.parametrize("start_C", [(25.0, 25.0), (90.0, 55.0), (30.0, 60.0)])
    @pytest.mark.parametrize("nodes", [1, 2])
    def test_rise_against_an_independent_integration(
        self, coil: CoilModel, start_C: tuple[float, float], nodes: int
    ) -> None:
        """Measured 1.1e-7 K at most: what is heated within a step does not warm the copper of the same step."""
        started = replace(coil, start_winding_C=start_C[0], start_housing_C=start_C[1], nodes=nodes)
        command = tap_like(150, sign_changes=False)
        model = model_of(started, command.size)
        # What a change of sign costs is tested above: here the heating is the true one.
        true = np.array([quadrature(i, c, AMPLIFIER, DT_S) for i, c in zip(currents(command), command, strict=True)])
        winding = model.rise(true)[1:, 0] + model.unpowered_C
        expected = ode(started, command, housing_held=nodes == 1)[1:, 0]
        assert expected.max() > start_C[0] + 0.05 or start_C[0] > start_C[1]
        np.testing.assert_allclose(winding, expected, rtol=0, atol=5e-7)

    def test_with_changes_of_sign_it_errs_by_little_to_the_cold_side(self, coil: CoilModel) -> None:
        """For a command at random; a tap changes its sign a few times."""
        command = tap_like(150, sign_changes=True)
        model = model_of(coil, command.size)
        h = model.heating.mean_square(currents(command), command)
        excess = model.rise(h)[1:, 0] + model.unpowered_C - ode(coil, command)[1:, 0]
        assert excess.max() <= 1e-6
        assert excess.min() > -1e-4

    @pytest.mark.parametrize(("nodes", "budget"), [(1, {}), (2, {}), (2, {"tap_rate_Hz": 8.0, "idle_A": 0.3})])
    def test_adjoint_by_differences(self, coil: CoilModel, nodes: int, budget: dict[str, float]) -> None:
        random = np.random.default_rng(8)
        model = model_of(replace(coil, start_winding_C=70.0, start_housing_C=50.0, nodes=nodes), 40, **budget)
        h, weights = random.uniform(0, 16, 40), random.standard_normal(40)
        gradient = model.adjoint(h, weights)
        step = 1e-2  # nearly linear in h: differences this wide are exact to 1e-9
        for k in (0, 1, 20, 39):
            up, down = (model.rise(h + sign * step * np.eye(40)[k])[1:, 0] @ weights for sign in (1, -1))
            assert gradient[k] == pytest.approx((up - down) / (2 * step), rel=1e-6, abs=1e-11)

    @pytest.mark.parametrize("nodes", [1, 2])
    def test_prices_are_what_the_adjoint_makes_them(self, coil: CoilModel, nodes: int) -> None:
        """For copper that does not warm, over the whole horizon and both ways."""
        hot = model_of(replace(coil, start_winding_C=70.0, start_housing_C=50.0, nodes=nodes), 600)
        model, random = replace(hot, copper=0.0), np.random.default_rng(12)
        h, weights = random.uniform(0, 16, 600), random.standard_normal(600)
        np.testing.assert_allclose(model.prices(model.adjoint(h, weights)), weights, atol=1e-10)
        by_h = random.standard_normal(600)
        np.testing.assert_allclose(model.adjoint(h, model.prices(by_h)), by_h, atol=1e-10)

    def test_the_closure_is_a_fixed_point_of_tap_and_pause(self, coil: CoilModel) -> None:
        model = model_of(coil, 40, tap_rate_Hz=8.0, idle_A=0.3)
        course = model.rise(np.random.default_rng(9).uniform(0, 16, 40))
        assert model.closure is not None
        F, f = model.closure
        np.testing.assert_allclose(F @ course[-1] + f, course[0], rtol=1e-12)

    def test_past_runaway_there_is_no_steady_state(self, coil: CoilModel) -> None:
        """The fixed point of such a period lies below absolute zero; it must not pass for a cool coil."""
        model = model_of(coil, 600, tap_rate_Hz=16.0)
        hot = np.full(600, 30.0)
        assert np.all(np.isinf(model.rise(hot)))
        assert np.all(np.isfinite(model.rise(np.full(600, 0.5))))
        heat = np.stack([hot, np.full(600, 0.5)])
        winding, housing = coil.steady_course(heat, np.full(600, DT_S), 1 / 16 - 0.06, np.zeros(2))
        assert np.all(np.isinf(winding[0]))
        assert np.all(np.isinf(housing[0]))
        assert winding[1].max() == pytest.approx(model.rise(heat[1])[:, 0].max() + 25, abs=0.01)
