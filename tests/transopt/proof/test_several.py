"""Replays of several motors and of the full arm: against independent programs."""

from dataclasses import replace

import numpy as np
import pytest

from tests.benches.arms import drawn, drawn_chain, phantom, posed
from tests.benches.dense_motors import impulse
from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.arm import Arm, Place
from transopt.plant.discretise import discretise
from transopt.plant.time_grid import TimeGrid
from transopt.proof.arm_replay import ArmMotion, replay_on_arm
from transopt.proof.effect import Effect
from transopt.proof.replay import replayed
from transopt.solvers.choose import solve
from transopt.solvers.options import SolverOptions


@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_the_prediction(seed: int) -> None:
    problem = drawn(seed)
    command = solve(problem, SolverOptions()).command
    (played,) = replayed([problem], command[None])
    effect = Effect(problem, command)
    assert played.shortfalls(problem, command, effect.motion.acceleration_m_s2) == []
    scale = np.abs(effect.motion.acceleration_m_s2).max()
    np.testing.assert_allclose(
        played.after_m_s2, effect.lasting.acceleration_m_s2[:, problem.grid.stages :], atol=1e-9 * scale
    )
    np.testing.assert_allclose(played.plant_input, effect.motion.plant_input, atol=1e-9)


def test_agrees_with_impulses_of_each_motor_alone() -> None:
    problem = posed(drawn_chain(np.random.default_rng(3), 3))
    commands = np.random.default_rng(4).uniform(-1, 1, (1, *problem.rest.shape))
    commands[..., problem.free_stages :] = 0.0
    (played,) = replayed([problem], commands)
    N, C = problem.grid.stages, problem.stage.plant.C
    made = np.zeros((3, N))
    for j in range(3):
        states = impulse(problem, j, N)[:, :-1]
        for i in range(3):
            made[i] += np.convolve(states @ C[i], commands[0, j])[:N]
    np.testing.assert_allclose(played.acceleration_m_s2, made, atol=1e-9 * np.abs(made).max())


def test_a_stronger_command_leaves_the_limits() -> None:
    problem = posed(drawn_chain(np.random.default_rng(3), 3), limit_A=0.5, shares=(1.0, 1.0, 0.5))
    command = solve(problem, SolverOptions()).command
    within, beyond = replayed([problem] * 2, np.stack([command, 1.001 * command]))
    limit = problem.limits.input
    assert not within.leaves(limit)
    assert beyond.leaves(limit)
    assert within.peak(limit) == pytest.approx(0.5, rel=1e-6)


def test_a_share_of_the_limit_counts_for_its_motor() -> None:
    problem = posed(drawn_chain(np.random.default_rng(3), 2))
    narrow = replace(problem.limits.input, shares=(1.0, 0.25))
    narrower = replace(problem, limits=problem.limits.replaced(narrow))
    commands = np.zeros((1, 2, problem.grid.stages))
    commands[0, 1, :40] = 1.0
    (played,) = replayed([narrower], commands)
    assert played.peak(narrow) == pytest.approx(4.0, rel=1e-6)
    assert played.leaves(narrow)


def test_a_wrong_prediction_is_found() -> None:
    problem = drawn(2)
    command = solve(problem, SolverOptions()).command
    (played,) = replayed([problem], command[None])
    predicted = Effect(problem, command).motion.acceleration_m_s2.copy()
    predicted[2, 30] += 1e-4 * np.abs(predicted).max()
    assert "replayed acceleration differs from the predicted one" in played.shortfalls(problem, command, predicted)[0]


GRID = TimeGrid(1e-4, 40, 3e-4, 68e-6, 10)
STILL_M_S = 1e-9  # a speed that turns nothing
PLACE = Place(np.radians([10.0, 25.0, 35.0]), np.array([0.6, 0.0, 0.8]))


def command(size_A: float) -> FloatArray:
    return size_A * np.random.default_rng(0).uniform(-1, 1, (3, GRID.stages))


def played(arm: Arm, size_A: float, amplifier: Amplifier | None, speed_m_s: float = STILL_M_S) -> ArmMotion:
    return replay_on_arm(arm, PLACE, 2.0, speed_m_s, GRID, amplifier, command(size_A))


def off_linear(size_A: float, amplifier: Amplifier | None) -> float:
    """Largest difference to the linear plant, relative to its peak."""
    arm = phantom()
    stage = discretise(arm.plant_at(2.0, PLACE), amplifier, GRID.dt_s)
    lasting = np.concatenate([command(size_A), np.zeros((3, GRID.after_stages))], axis=1)
    linear = stage.motion(lasting).acceleration_m_s2
    found = played(arm, size_A, amplifier).acceleration_m_s2
    return float(np.abs(found - linear).max() / np.abs(linear).max())


@pytest.mark.parametrize("amplifier", [None, Amplifier(1050.0, 68e-6, 6.0)], ids=["ideal", "one pole"])
def test_small_motions_are_those_of_the_linear_plant(amplifier: Amplifier | None) -> None:
    assert off_linear(1e-3, amplifier) < 1e-5


def test_the_difference_grows_in_proportion_to_the_motion() -> None:
    amplifier = Amplifier(1050.0, 68e-6, 6.0)
    small, large = (off_linear(size, amplifier) for size in (10.0, 20.0))
    assert large / small == pytest.approx(2.0, rel=0.1)


def test_an_arm_that_moves_accelerates_by_itself_with_the_square_of_its_speed() -> None:
    slow, fast = (np.abs(played(phantom(), 0.0, None, v).without_m_s2).max() for v in (0.2, 0.4))
    assert fast / slow == pytest.approx(4.0, rel=0.1)
    assert slow < 0.1


def test_a_tap_moves_on_as_the_hand_means_to() -> None:
    found = played(phantom(), 0.0, None, 0.2)
    times = np.append(GRID.switching_times_s, GRID.after_times_s)
    np.testing.assert_allclose(found.moved_m, 0.2 * np.abs(times), atol=1e-6)
