"""Replays of several motors: against the prediction, against an independent program, and what they refuse."""

from dataclasses import replace

import numpy as np
import pytest

from tests.benches.arms import drawn, drawn_chain, posed
from tests.benches.dense_motors import impulse
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
