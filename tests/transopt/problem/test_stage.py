"""The linear stage, which problems of one device share."""

import pickle
from dataclasses import fields, replace

import numpy as np
import pytest

from tests.conftest import ProblemMaker, WalledMaker
from transopt.problem.objective.weighting import pacinian
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import LinearStage, linear_stage
from transopt.proof.continuous import accurate


def assert_same(one: LinearStage, other: LinearStage) -> None:
    for field in fields(LinearStage):
        value = getattr(one, field.name)
        if isinstance(value, float | np.ndarray):
            np.testing.assert_allclose(value, getattr(other, field.name), rtol=1e-13, atol=0)
    for own, its in zip(one.outputs, other.outputs, strict=True):
        assert own.keys() == its.keys()
        for name, (by_state, by_movement) in own.items():
            np.testing.assert_allclose(by_state, its[name][0], rtol=1e-13, atol=0)
            assert by_movement == pytest.approx(its[name][1], rel=1e-13)


def alone(problem: TransientProblem) -> TransientProblem:
    """Copy the problem, with devices of which nothing was computed before."""
    return replace(problem, stage=replace(problem.stage), spread=tuple(replace(device) for device in problem.spread))


def test_what_problems_share_is_that_of_each_alone(make_problem: ProblemMaker, walled: WalledMaker) -> None:
    problem, over_wall = make_problem(0.4, 3.0), walled(800.0, 0.4)
    stage, wall = problem.stage, over_wall.wall
    stiffer = replace(wall, wall=replace(wall.wall, stiffness_N_m=900.0))
    other = replace(make_problem(0.4, 5.0).stage)
    variants = [
        problem,
        replace(make_problem(0.1, 3.0), stage=stage),
        replace(make_problem(0.2, 3.0, current_A=1.25), stage=stage),
        replace(make_problem(0.4, 3.0, stages=90), stage=stage),
        replace(problem, terms=(replace(problem.terms[0], error_filter=pacinian(problem.grid.dt_s)),)),
        replace(
            problem, terms=(problem.terms[0], replace(problem.terms[0], error_filter=pacinian(problem.grid.dt_s)))
        ),
        replace(problem, heat_price=1e-4),
        replace(problem, spread=(other,)),
        replace(problem, spread=(other, stage)),
        over_wall,
        replace(over_wall, wall=stiffer),
        problem,
    ]
    for variant in variants:
        assert_same(linear_stage(variant), linear_stage(alone(variant)))


def test_units_are_those_of_the_limit(make_problem: ProblemMaker) -> None:
    strong, weak = make_problem(0.4, 3.0), make_problem(0.2, 3.0, current_A=1.25)
    assert weak.input_scale < strong.input_scale
    one, other = linear_stage(strong), linear_stage(replace(weak, stage=strong.stage))
    assert other.A is one.A
    np.testing.assert_allclose(other.units / one.units, weak.input_scale / strong.input_scale)


def test_scaled_and_physical_matrices_are_one_system(make_problem: ProblemMaker) -> None:
    problem = make_problem(0.4, 3.0)
    scaled, physical = linear_stage(problem), linear_stage(problem, physical_scale=False)
    # Apart from the current and the command, which have the limit as their unit in both.
    by = scaled.units / physical.units
    np.testing.assert_allclose(scaled.A, physical.A * by / by[:, None], rtol=1e-12, atol=1e-300)
    np.testing.assert_allclose(scaled.C, physical.C * by, rtol=1e-12)
    np.testing.assert_allclose(scaled.E, physical.E, rtol=1e-12)


def test_a_device_of_which_things_are_kept_goes_to_another_process(make_problem: ProblemMaker) -> None:
    problem = make_problem(0.4, 3.0)
    command = np.eye(1, problem.grid.stages)[0]
    linear_stage(problem)
    accurate(problem.stage, problem.grid, command[None], None)
    assert problem.stage.derived
    there = pickle.loads(pickle.dumps(problem))
    assert_same(linear_stage(there), linear_stage(problem))
    np.testing.assert_array_equal(there.stage.rollout(command)[0], problem.stage.rollout(command)[0])
