"""Taps carried over to another hand: exact for a linear object, and near the truth for a real contact."""

import numpy as np
import pytest
from scipy.linalg import expm

from transopt.base.signals import FloatArray
from transopt.design.another_hand import in_another_hand
from transopt.plant.state_space import StateSpace
from transopt.scene import strikes
from transopt.scene.builtin import POPULATION
from transopt.scene.population import load_population
from transopt.scene.scene import Scene

DT_S, SPEED_M_S = 1e-4, 0.3
CONTACT_N_M, OBJECT_KG, OBJECT_N_M, OBJECT_N_S_M = 3e4, 0.04, 8e3, 14.0


def struck(plant: StateSpace, samples: int) -> FloatArray:
    """(K,) stylus acceleration in a tap on a linear object, by the flow of plant and object together."""
    n = plant.order
    # States: the chain's, position and velocity of the object, and v t with v; force on the stylus by a row of these.
    force = np.zeros(n + 4)
    force[:n] = -CONTACT_N_M * plant.outputs["stylus position"].row[0]
    force[[n, n + 2]] = CONTACT_N_M
    flow = np.zeros((n + 4, n + 4))
    flow[:n, :n] = plant.A
    flow[:n] += plant.B @ force[None]
    flow[n, n + 1] = flow[n + 2, n + 3] = 1.0
    flow[n + 1] = -force / OBJECT_KG
    flow[n + 1, [n, n + 1]] -= np.array([OBJECT_N_M, OBJECT_N_S_M]) / OBJECT_KG
    row = np.append(plant.C[0], np.zeros(4)) + plant.D[0, 0] * force
    step, state, found = expm(flow * DT_S), np.zeros(n + 4), np.empty(samples)
    state[-1] = SPEED_M_S
    for k in range(samples):
        found[k] = row @ state
        state = step @ state
    return found


@pytest.fixture(scope="module")
def others(scene: Scene) -> list[Scene]:
    population = load_population(POPULATION)
    return [scene.in_hand(hand) for hand in population.drawn(4, 17, scene.grid.grips_N, wider=1.5)]


@pytest.mark.parametrize("grip_N", [1.0, 5.0])
def test_the_tap_on_a_linear_object_is_that_of_the_other_hand(
    scene: Scene, others: list[Scene], grip_N: float
) -> None:
    old = scene.plant(grip_N, struck=True)
    recorded = struck(old, 900)
    for other in others:
        new = other.plant(grip_N, struck=True)
        wanted = struck(new, 900)
        found = in_another_hand(recorded, SPEED_M_S, old, new, DT_S)
        # What is left is of the sampling: the contact begins with a kink.
        assert np.linalg.norm(found - wanted) < 0.02 * np.linalg.norm(recorded - wanted)
        back = in_another_hand(found, SPEED_M_S, new, old, DT_S)
        assert np.linalg.norm(back - recorded) < 2e-3 * np.linalg.norm(recorded)


def test_in_the_same_hand_nothing_changes(scene: Scene) -> None:
    plant = scene.plant(3.0, struck=True)
    recorded = struck(plant, 500)
    assert in_another_hand(recorded, SPEED_M_S, plant, plant, DT_S) == pytest.approx(recorded, abs=1e-8)


def test_noise_does_not_grow(scene: Scene, others: list[Scene]) -> None:
    """A deconvolution would amplify it; an equation of the second kind passes it on."""
    noise = np.random.default_rng(2).standard_normal(900)
    for other in others:
        plants = scene.plant(3.0, struck=True), other.plant(3.0, struck=True)
        recorded = struck(plants[0], 900)
        clean, noisy = (in_another_hand(each, SPEED_M_S, *plants, DT_S) for each in (recorded, recorded + noise))
        assert np.linalg.norm(noisy - clean) < 1.5 * np.linalg.norm(noise)


def test_a_contact_that_stiffens_is_met_nearly(scene: Scene, others: list[Scene]) -> None:
    """Hunt and Crossley's contact, by the simulated strikes: most of the difference between the hands is told."""
    target = scene.recordings.simulated
    assert target is not None

    def tap(of: Scene) -> FloatArray:
        times, course, _ = strikes.strike(of.plant(1.0, struck=True), target, np.array([SPEED_M_S]), 0.08)
        return np.interp(np.arange(800) * DT_S, times, course[0])

    recorded = tap(scene)
    for other in others:
        plants = scene.plant(1.0, struck=True), other.plant(1.0, struck=True)
        wanted, found = tap(other), in_another_hand(recorded, SPEED_M_S, *plants, DT_S)
        assert np.linalg.norm(found - wanted) < 0.35 * np.linalg.norm(recorded - wanted)
