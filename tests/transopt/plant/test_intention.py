"""How a stylus moves without current, against masses in absolute coordinates and an adaptive method."""

import itertools
from typing import get_args

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import problems
from controller.sim.true_device import device_of
from transopt.plant.intention import FOLLOWS_S, FreeMotion, Intention, Path, Yielding
from transopt.plant.state_space import StateSpace
from transopt.scene.keys import with_values

STEP_S = 1e-4
TIMES_S = np.arange(-50, 900) * STEP_S


def integrated(path: Path, grip_N: float) -> np.ndarray:
    """(K,) acceleration of the stylus of the default scene, its hand's end moved along a path."""
    mass, spring, damper = device_of(problems.load("wood_on_foam")).at(grip_N)
    n, stylus = mass.size, device_of(problems.load("wood_on_foam")).stylus
    h = 1e-7

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        z, v = np.append(x[:n], path.at(t)), np.append(x[n:], (path.at(t + h) - path.at(t - h)) / (2 * h))
        pull = spring * np.diff(z) + damper * np.diff(v)
        return np.concatenate([v[:-1], (pull - np.append(0.0, pull[:-1])) / mass])

    joined = np.eye(n) - np.eye(n, k=1)
    lag = -np.linalg.solve(joined.T @ np.diag(spring) @ joined, mass * path.incoming_m_s2)
    start, first = path.at(-10e-3), -path.speed_m_s - 10e-3 * path.incoming_m_s2
    T = path.intention.intention_s
    edges = [-10e-3, T, *(T + each for each in (60e-3,)), 0.095]
    x, found = np.concatenate([start + lag, np.full(n, first)]), np.full(TIMES_S.size, np.nan)
    for begin, end in itertools.pairwise(edges):
        inside = np.flatnonzero((begin - 1e-9 <= TIMES_S) & (end - 1e-9 > TIMES_S))
        at = np.clip(TIMES_S[inside], begin, end)
        ran = solve_ivp(rates, (begin, end), x, "DOP853", t_eval=np.append(at, end), rtol=1e-9, atol=1e-12)
        found[inside] = [rates(t, y)[n + stylus] for t, y in zip(at, ran.y.T[:-1], strict=True)]
        x = ran.y[:, -1]
    return found


@pytest.mark.parametrize(
    ("yields", "incoming_m_s2"),
    list(zip([each for each in get_args(Yielding) if each != "stops"], (3.0, 0.0, -2.0, 3.0), strict=True)),
)
def test_the_stylus_follows_the_hand_as_its_masses_do(yields: Yielding, incoming_m_s2: float) -> None:
    scene = with_values(problems.load("wood_on_foam"), {"hand.yields": yields})
    found = scene.free_motion(3.0).acceleration_m_s2(0.3, incoming_m_s2, TIMES_S)
    wanted = integrated(Path(0.3, scene.hand.intention(), incoming_m_s2), 3.0)
    # A law is held at its mean over each step: where it begins, it is half a step early.
    away = np.abs(np.subtract.outer(TIMES_S, [30e-3, 90e-3])).min(axis=1) > 1.5 * STEP_S
    np.testing.assert_allclose(found[away], wanted[away], atol=0.03 * max(np.abs(wanted).max(), 1e-3))
    np.testing.assert_allclose(found[TIMES_S < 30e-3 - STEP_S], incoming_m_s2, atol=1e-9)


def test_a_stylus_that_is_no_chain_or_whose_hand_has_no_spring_follows_in_its_own_time() -> None:
    loose = StateSpace(
        np.array([[0.0, 1.0], [0.0, -40.0]]),
        np.array([[0.0], [10.0]]),
        np.array([[0.0, -40.0]]),
        np.array([[10.0]]),
    )
    after = TIMES_S[TIMES_S > 30e-3] - 30e-3
    for chain in (None, loose):
        free = FreeMotion(Intention(yields="straight"), chain)
        found = free.acceleration_m_s2(0.2, 4.0, TIMES_S)
        np.testing.assert_allclose(found[TIMES_S <= 30e-3], 4.0)
        np.testing.assert_allclose(found[TIMES_S > 30e-3], 4.0 * np.exp(-after / FOLLOWS_S), rtol=1e-6)


def test_a_free_stylus_goes_on_as_it_came() -> None:
    free = FreeMotion(Intention(yields="stops"), None, is_held=False)
    assert not free.acceleration_m_s2(0.2, 4.0, TIMES_S).any()
