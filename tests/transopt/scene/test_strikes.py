"""Simulated taps: both ways of computing them, compiled and in numpy, against each other and against DOP853."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from transopt.base import recursions
from transopt.base.signals import FloatArray
from transopt.recordings.settings import SimulatedTaps
from transopt.scene.builtin import load_scene
from transopt.scene.scene import Scene
from transopt.scene.strikes import contact_force, strike

SPEEDS_M_S = np.array([0.1, 0.25, 0.4])


@pytest.fixture(params=["wood_on_foam", "hard_metal"])
def scene(request: pytest.FixtureRequest) -> Scene:
    """One scene strikes a body that stays in contact, the other a body from which the stylus rebounds."""
    return load_scene(request.param).striking()


def struck(scene: Scene) -> tuple[SimulatedTaps, tuple[FloatArray, FloatArray, FloatArray]]:
    target = scene.recordings.simulated
    assert target is not None
    return target, strike(scene.plant(3.0, struck=True), target, SPEEDS_M_S, 40e-3)


def in_numpy(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> tuple[FloatArray, FloatArray, FloatArray]:
    monkeypatch.setattr(recursions, "COMPILED", None)
    return struck(scene)[1]


@pytest.mark.skipif(recursions.COMPILED is None, reason="the extension is not built")
def test_compiled_and_in_numpy_they_are_the_same(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    _, (times, acceleration, encoder) = struck(scene)
    other = in_numpy(scene, monkeypatch)
    assert times == pytest.approx(other[0], abs=1e-15)
    assert np.abs(acceleration - other[1]).max() < 1e-10 * np.abs(acceleration).max()
    assert np.abs(encoder - other[2]).max() < 1e-10 * np.abs(encoder).max()


def test_they_obey_the_laws_of_motion(scene: Scene) -> None:
    """Stylus and object as one system of equations, integrated by another method."""
    target, (times, acceleration, _) = struck(scene)
    plant = scene.plant(3.0, struck=True)
    n, masses = plant.order, plant.order // 2
    stylus = int(np.flatnonzero(plant.B[masses:, 0])[-1])

    def force(state: FloatArray, t: float, speed_m_s: float) -> FloatArray:
        # The state's elongations up to the stylus add up to its deviation from the motion that the hand means.
        deviation, rate = state[stylus:masses].sum(), state[masses + stylus : n].sum()
        depth = state[n] + speed_m_s * t - deviation
        return contact_force(target, depth, state[n + 1] + speed_m_s - rate)

    def flow(t: float, state: FloatArray, speed_m_s: float) -> FloatArray:
        F = force(state, t, speed_m_s)
        back = target.object_stiffness_N_m * state[n] + target.object_damping_N_s_m * state[n + 1]
        moved = plant.A @ state[:n] + plant.B[:, 0] * F
        return np.array([*moved, state[n + 1], -(F + back) / target.object_mass_kg])

    for speed, found in zip(SPEEDS_M_S, acceleration, strict=True):
        exact = solve_ivp(
            flow, (0, times[-1]), np.zeros(n + 2), "DOP853", times, args=(speed,), rtol=1e-10, atol=1e-13
        )
        forces = [force(state, t, speed) for state, t in zip(exact.y.T, times, strict=True)]
        wanted = plant.C[0] @ exact.y[:n] + plant.D[0, 0] * np.array(forces)
        # The force has a bend where a contact begins or ends, on which a fixed step of fourth order falls back.
        assert np.abs(found - wanted).max() < 1e-5 * np.abs(wanted).max()


@pytest.mark.parametrize("taps", [7, 12, 23, 31, 37])
def test_side_by_side_each_tap_is_as_alone(scene: Scene, taps: int) -> None:
    target, plant = scene.recordings.simulated, scene.plant(3.0, struck=True)
    assert target is not None
    speeds = np.linspace(0.1, 0.4, taps)
    _, *together = strike(plant, target, speeds, 3e-3)
    for i in (0, taps // 2, taps - 1):
        _, *alone = strike(plant, target, speeds[i : i + 1], 3e-3)
        for found, wanted in zip(together, alone, strict=True):
            np.testing.assert_allclose(found[i], wanted[0], rtol=0, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.skipif(recursions.COMPILED is None, reason="the extension is not built")
def test_what_overflows_is_not_hidden() -> None:
    stages = np.hstack([np.ones((8, 2)), np.zeros((8, 4))])
    rows = np.vstack([stages, np.ones((1, 6)), np.hstack([1e6 * np.eye(2), np.ones((2, 4))])])
    found = np.zeros((101, 1, 1))
    last = recursions.strike(rows, (1.0, 1.5, 0.0), np.ones((2, 1)), found)
    assert last is not None
    assert not np.isfinite(found[-1]).any()
    assert not np.isfinite(last).any()


@pytest.mark.skipif(recursions.COMPILED is None, reason="the extension is not built")
@pytest.mark.parametrize("exponent", [1.0, 1.1, 1.5, 2.5])
def test_the_power_of_the_depth_is_that_of_numpy(exponent: float) -> None:
    """One step from a depth on: its force is the output, of as many courses as fill blocks and a half."""
    depth_m = np.geomspace(1e-12, 1e-1, 40)
    rows = np.zeros((8 + 1 + 1, 5))
    rows[0, 0] = rows[9, 0] = 1.0  # the depth is the state, the closing speed zero
    rows[8, 1] = 1.0
    found = np.zeros((1, 1, depth_m.size))
    assert recursions.strike(rows, (2.0, exponent, 0.3), depth_m[None], found) is not None
    assert np.abs(found[0, 0] / (2.0 * depth_m**exponent) - 1).max() < 1e-13
