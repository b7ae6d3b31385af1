"""What the optimum is compared with: the unlimited optimum, clipped, and the seed's inversion."""

from dataclasses import replace

import numpy as np
from scipy import linalg

from tests.benches.arms import drawn_chain, posed
from tests.conftest import ProblemMaker
from transopt.base.signals import nrmse
from transopt.plant.discretise import discretise
from transopt.plant.state_space import StateSpace
from transopt.problem.baselines import clipped_optimum, seed_inversion
from transopt.solvers import unlimited


def test_clipping_at_no_limit_is_the_unlimited_optimum(make_problem: ProblemMaker) -> None:
    problem = make_problem(0.2, 3.0)
    free = unlimited.solve([problem])[0].command
    again = clipped_optimum(problem.stage, problem.grid, free, 100.0)
    np.testing.assert_allclose(again, free, atol=1e-9)


def test_clipped_optimum_keeps_the_limits(make_problem: ProblemMaker) -> None:
    problem = make_problem(0.4, 5.0)
    command = clipped_optimum(problem.stage, problem.grid, unlimited.solve([problem])[0].command, 4.0)
    _, current = problem.stage.rollout(command)
    assert np.abs(current).max() <= 4 + 1e-9


def test_inversion_recovers_a_known_current(make_problem: ProblemMaker) -> None:
    """A current that comes and goes smoothly while the device comes to rest is what the inverse must return."""
    problem = make_problem(ideal=True)
    grid, fine = replace(problem.grid, stages=4000, lead_s=0.0), 50
    times = grid.dt_s / fine * np.arange(grid.stages * fine)
    current = np.where((times > 0.02) & (times < 0.05), np.sin(np.pi * (times - 0.02) / 0.03) ** 4, 0.0)
    stage = discretise(problem.stage.plant, None, grid.dt_s / fine)
    reference = stage.rollout(current)[0][::fine]
    found = seed_inversion(problem.stage, grid, reference, 100.0, 10)
    assert nrmse(found, current[::fine]) < 0.02


def test_rivals_at_two_limits_are_those_at_each(make_problem: ProblemMaker) -> None:
    problem = make_problem(0.4, 5.0)
    rows = np.stack([problem.reference_m_s2, 0.5 * problem.reference_m_s2])
    limits = np.array([4.0, 1.25])[:, None, None]
    seed = seed_inversion(problem.stage, problem.grid, rows, limits, 10)
    clipped = clipped_optimum(problem.stage, problem.grid, rows / 10, limits)
    for j, limit in enumerate((4.0, 1.25)):
        np.testing.assert_array_equal(seed[j], seed_inversion(problem.stage, problem.grid, rows, limit, 10))
        np.testing.assert_array_equal(clipped[j], clipped_optimum(problem.stage, problem.grid, rows / 10, limit))
    assert not np.allclose(seed[0], seed[1])


def test_inversion_of_decoupled_axes_is_that_of_each_axis() -> None:
    lot = np.random.default_rng(0)
    axes = [drawn_chain(lot, 1, 1) for _ in range(3)]
    joint = StateSpace(*(linalg.block_diag(*(getattr(axis, name) for axis in axes)) for name in "ABCD"))
    whole, alone = posed(joint), [posed(axis) for axis in axes]
    targets = lot.standard_normal((3, whole.grid.stages))
    found = seed_inversion(whole.stage, whole.grid, targets, 1.5, 10)
    for own, problem, target in zip(found, alone, targets, strict=True):
        np.testing.assert_allclose(own, seed_inversion(problem.stage, problem.grid, target, 1.5, 10), atol=1e-9)


def test_each_motor_is_clipped_by_itself() -> None:
    problem = posed(drawn_chain(np.random.default_rng(1), 2))
    free = 3.0 * np.random.default_rng(2).standard_normal(problem.rest.shape)
    limits = np.array([[0.5], [1.0]])
    clipped = clipped_optimum(problem.stage, problem.grid, free, limits)
    wanted = np.clip(problem.stage.motion(free).plant_input, -limits, limits)
    inside = np.abs(clipped[:, :-1]) < problem.command_bound
    made = problem.stage.motion(clipped).plant_input
    assert (np.abs(made) <= limits + 1e-9).mean() > 0.9
    for j in range(2):
        first = int(np.argmin(inside[j])) if not inside[j].all() else inside.shape[1]
        np.testing.assert_allclose(made[j, 1 : first + 1], wanted[j, 1 : first + 1], atol=1e-9)
