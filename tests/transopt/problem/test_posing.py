"""Problems of one grip posed together and the linear stage that they share."""

import pickle
from dataclasses import fields, replace

import numpy as np
import pytest

import problems
from tests.conftest import ProblemMaker, WalledMaker
from transopt.base.errors import InputError
from transopt.design.context import Context, wanted_of
from transopt.problem.leave_out import leave_out, leave_out_all
from transopt.problem.objective.weighting import pacinian
from transopt.problem.posing import Wanted
from transopt.problem.problem import FIELDS, TransientProblem
from transopt.problem.stage import LinearStage, linear_stage
from transopt.proof.continuous import accurate
from transopt.scene.keys import with_values
from transopt.scene.recordings import recordings_of

# Without and with courses of the nominal motion in the limits, with a wall, and with several motors.
SCENES = ("wood_on_foam", "hot_coil", "low_supply", "walled", "stylus_3d")


def posed(name: str) -> tuple[Context, list[Wanted], list[TransientProblem]]:
    scene = problems.load(name)
    context = Context.recorded(scene, recordings_of(scene))
    device = scene.axes.devices[-1]
    references = [context.reference(speed, device[0], target) for speed, target in scene.axes.rows]
    found = [each.problem for each in context.posed_together(references, *device)]
    return context, list(map(wanted_of, references)), found


def rows_of(problem: TransientProblem) -> list[tuple[str, object, object, object]]:
    found = [(row.name, row.lower, row.upper, row.offset) for _, row in problem.rows()]
    return [(name, *(np.asarray(each).tolist() for each in numbers)) for name, *numbers in found]


def check_alike(one: TransientProblem, other: TransientProblem) -> None:
    for name in sorted(FIELDS - {"limits", "target", "wall", "shares"}):
        assert getattr(one, name) == getattr(other, name) or getattr(one, name) is getattr(other, name), name
    assert rows_of(one) == rows_of(other)
    np.testing.assert_array_equal(one.target.whole_m_s2, other.target.whole_m_s2)
    assert one.tracking.energy_m2_s4 == pytest.approx(other.tracking.energy_m2_s4, rel=1e-13)
    assert (one.command_bound, one.thermal is None) == (other.command_bound, other.thermal is None)


@pytest.mark.parametrize("name", SCENES)
def test_each_is_the_problem_posed_alone(name: str) -> None:
    context, wanted, found = posed(name)
    for problem, each in zip(found, wanted, strict=True):
        check_alike(problem, context.posing.problem(each, problem.stage, problem.spread))


def test_they_share_limits_that_no_tap_changes_alone() -> None:
    _, _, alike = posed("hot_coil")
    assert all(problem.limits is alike[0].limits and problem.rows() is alike[0].rows() for problem in alike)
    _, wanted, apart = posed("low_supply")
    assert len({id(problem.limits["supply"]) for problem in apart}) == len(apart) == len(wanted)


@pytest.mark.parametrize("name", SCENES)
def test_what_is_left_out_of_each_is_left_out_of_all(name: str) -> None:
    _, _, found = posed(name)
    for problem, reduced in zip(found, leave_out_all(found), strict=True):
        alone = leave_out(problem)
        assert reduced.left_out == alone.left_out
        check_alike(reduced.problem, alone.problem)
        np.testing.assert_array_equal(reduced.problem.target.whole_m_s2, problem.target.whole_m_s2)


def test_another_target_is_checked() -> None:
    _, _, (problem, *_) = posed("wood_on_foam")
    window = problem.target.window_m_s2
    with pytest.raises(InputError, match=r"reference_m_s2 has shape \(\d+,\), expected \(\d+,\)"):
        problem.aiming_at(replace(problem.target, window_m_s2=window[1:]))
    with pytest.raises(InputError, match="reference_m_s2 holds a number that is not finite"):
        problem.aiming_at(replace(problem.target, window_m_s2=np.where(np.arange(window.size) == 3, np.nan, window)))


def test_a_raised_temperature_limit_is_another_one() -> None:
    _, _, (problem, *_) = posed("hot_coil")
    assert problem.thermal is not None
    assert problem.thermal.raised(1.0) != problem.thermal
    assert problem.replaced(problem.thermal.raised(1.0)).limits != problem.limits


def test_equal_devices_of_any_scene_are_one() -> None:
    scene, changed = problems.load("wood_on_foam"), {"limits.current_A": 3.0, "weights.rho": 0.5}
    own, same, heavier = (
        Context(each).stage(5.0)
        for each in (scene, with_values(scene, changed), with_values(scene, {"model.stylus_mass_kg": 0.027}))
    )
    assert own is same
    assert own is not heavier
    assert not np.array_equal(own.A, heavier.A)
    faster = Context(with_values(scene, {"amplifier.pole_Hz": 2000.0})).stage(5.0)
    assert own is not faster
    assert own.plant.numbers == faster.plant.numbers != heavier.plant.numbers


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
