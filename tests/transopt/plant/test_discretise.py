"""Exact hold: the defining property, the adjoint, and an independent integrator."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.conftest import ProblemMaker
from transopt.base.matrices import powers
from transopt.base.signals import FloatArray, nrmse
from transopt.design.build import build_library
from transopt.design.solve import solve
from transopt.design.verify import verify_library
from transopt.plant.amplifier import Amplifier
from transopt.plant.chain import Link, chain
from transopt.plant.discretise import Motion, discretise
from transopt.plant.scaling import state_scale
from transopt.plant.state_space import Input, StateSpace
from transopt.plant.time_grid import TimeGrid
from transopt.problem.objective.target import Target
from transopt.problem.problem import TransientProblem
from transopt.proof.continuous import accurate
from transopt.proof.replay import replay
from transopt.recordings.recording import Recording
from transopt.scene.builtin import load_scene
from transopt.scene.file import with_plant
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene


def integrate_independently(problem: TransientProblem, command: FloatArray) -> tuple[FloatArray, FloatArray]:
    """y'' and i at the switching instants by DOP853, with the delay as a shift of the command in true time."""
    stage, grid = problem.stage, problem.grid
    plant, amplifier = stage.plant, stage.amplifier
    n = plant.order

    def rate(_: float, x: FloatArray, held: float) -> FloatArray:
        if amplifier is None:
            return plant.A @ x + plant.B[:, 0] * held
        drive = amplifier.rate_rad_s * (held - x[n])
        return np.append(plant.A @ x[:n] + plant.B[:, 0] * x[n], drive)

    x = np.zeros(n + (amplifier is not None))
    acceleration, current = [], []
    issued = grid.issue_times_s
    for k in range(grid.stages):
        i = command[k] if amplifier is None else x[n]
        acceleration.append(float(plant.C[0] @ x[:n] + plant.D[0, 0] * i))
        current.append(i)
        start = issued[k] + grid.delay_s
        run = solve_ivp(
            rate, (start, start + grid.dt_s), x, method="DOP853", rtol=1e-12, atol=1e-15, args=(command[k],)
        )
        x = run.y[:, -1]
    return np.array(acceleration), np.array(current)


@pytest.mark.parametrize(
    ("delay_samples", "ideal"), [(0.0, False), (0.3, False), (1.0, False), (2.7, False), (0.0, True)]
)
def test_design_and_replay_agree_with_an_independent_integrator(
    make_problem: ProblemMaker, delay_samples: float, ideal: bool
) -> None:
    problem = make_problem(stages=80, delay_s=delay_samples * 1e-4, ideal=ideal)
    random = np.random.default_rng(7)
    command = random.uniform(-4, 4, 80)
    expected, expected_current = integrate_independently(problem, command)
    peak = np.abs(expected).max()

    predicted, predicted_current = problem.stage.rollout(command)
    assert np.abs(predicted - expected).max() <= 1e-9 * peak
    assert np.abs(predicted_current - expected_current).max() <= 1e-9 * 4

    (played,) = replay(problem.stage, problem.grid, command[None], [problem.target], None)
    assert np.abs(played.acceleration_m_s2 - expected).max() <= 1e-9 * peak
    assert np.abs(played.plant_input - expected_current).max() <= 1e-9 * 4


@pytest.mark.parametrize("ideal", [False, True])
def test_adjoint_is_the_transpose_of_the_rollout(make_problem: ProblemMaker, ideal: bool) -> None:
    known = make_problem(ideal=ideal).stage
    random = np.random.default_rng(5)
    command, *weights = random.standard_normal((5, 60))
    for position in (False, True):
        stage = discretise(known.plant, known.amplifier, known.dt_s, position=position)
        motion = stage.motion(command)
        assert np.any(motion.encoder_m != 0) == position
        names = [field.name for field in fields(Motion) if field.name != "outputs"]
        outputs = [getattr(motion, name) for name in names]
        # One by one, and all at once: in SI an acceleration would drown a position.
        for wanted in (*np.eye(4), np.ones(4)):
            scales = [
                factor / max(np.abs(output).max(), 1e-30) for factor, output in zip(wanted, outputs, strict=True)
            ]
            gradient = Motion(*(scale * weight for scale, weight in zip(scales, weights, strict=True)))
            forward = sum(getattr(gradient, name) @ output for name, output in zip(names, outputs, strict=True))
            assert stage.adjoint(gradient) @ command == pytest.approx(forward, rel=1e-11, abs=1e-13)


def test_replay_converges_and_says_how_far(make_problem: ProblemMaker) -> None:
    problem = make_problem(stages=80)
    command = np.random.default_rng(1).uniform(-4, 4, 80)
    (played,) = replay(problem.stage, problem.grid, command[None], [problem.target], None)
    assert played.step_error <= 1e-10
    course = accurate(problem.stage, problem.grid, command[None], None)
    period = course.period
    at_starts = period.sampled(np.eye(1, period.to_samples.shape[0])).outputs(course.acting)[0]
    arrived = at_starts[period.arriving * period.segments[0].offsets_s.size, period.at_switching]
    np.testing.assert_allclose(arrived, course.accelerations[0], rtol=1e-12, atol=1e-12)


def test_what_a_device_keeps_is_made_again_where_a_part_is_another(make_problem: ProblemMaker) -> None:
    stage, part, made = make_problem().stage.extended(), np.zeros(2), list[int]()

    def kept(same: tuple[object, ...], equal: object) -> int:
        def make() -> int:
            made.append(len(made))
            return made[-1]

        return stage.kept("kind", same, equal, make)

    assert [kept((part,), (3, "b")) for _ in range(2)] == [0, 0]
    assert kept((part.copy(),), (3, "b")) == 1  # equal, but not the same
    assert kept((part,), (4, "b")) == 2
    assert kept((part, part), (4, "b")) == 3
    assert kept((part, part), (4, "b")) == 3


def test_many_commands_are_replayed_as_each_alone(make_problem: ProblemMaker) -> None:
    problem = make_problem(stages=40)
    M = 18
    commands, targets = np.random.default_rng(1).uniform(-4, 4, (M, 40)), [problem.target] * M
    wider = problem.limits.replaced(problem.limits["current"].wider(2.0))
    limits = [wider if m % 3 == 1 else problem.limits for m in range(M)]
    together = replay(problem.stage, problem.grid, commands, targets, None, limits=limits)
    for m, (command, found) in enumerate(zip(commands, together, strict=True)):
        (alone,) = replay(problem.stage, problem.grid, command[None], targets[:1], None, limits=limits[m : m + 1])
        np.testing.assert_allclose(found.acceleration_m_s2, alone.acceleration_m_s2, rtol=1e-9, atol=1e-9)
        assert found.reached == pytest.approx(alone.reached, rel=1e-9)
        assert found.after_peak_m_s2 == pytest.approx(alone.after_peak_m_s2, rel=1e-9)
        np.testing.assert_array_equal(found.command, command)


def test_a_box_at_the_switching_instants_bounds_the_current_for_all_times(make_problem: ProblemMaker) -> None:
    problem = make_problem(stages=120)
    command = np.random.default_rng(9).uniform(-6, 6, 120)
    command[-10:] = 0
    _, current = problem.stage.rollout(command)
    (played,) = replay(problem.stage, problem.grid, command[None], [problem.target], None)
    assert played.peak_input == pytest.approx(np.abs(current).max(), rel=1e-9)


def test_states_that_nothing_depends_on_are_left_out(scene: Scene) -> None:
    """The free device without its position behaves as with it, and a held one has nothing to leave out."""
    free = scene.plant(0.0)
    stage = discretise(free, scene.amplifier_model(), 1e-4)
    assert stage.A.shape == (free.order, free.order)  # one state fewer, one for the current
    assert discretise(scene.plant(3.0), None, 1e-4).A.shape == (6, 6)
    command = np.random.default_rng(8).uniform(-4, 4, 100)
    grid = replace(scene.time_grid(), stages=100)
    predicted, _ = stage.rollout(command)
    (played,) = replay(stage, grid, command[None], [Target(predicted)], None)
    assert nrmse(played.acceleration_m_s2, predicted) < 1e-11


def test_a_free_mass_under_a_force_is_solved_and_verified() -> None:
    """The force alone is the acceleration, so that none of the states matters."""
    bare = {f"limits.{key}": None for key in ("stroke_m", "velocity_m_s", "current_A")}
    few = {"time.dt_s": 2e-4, "time.stages": 300, "weights.after_s": 0.0}
    shaker = with_values(load_scene("shaker_pulse"), {**bare, **few, "amplifier": "ideal"})
    A, B, force = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [100.0]]), np.array([[100.0]])
    library = solve(with_plant(shaker, StateSpace(A, B, np.zeros((1, 2)), force, driven_by=Input("voltage", "V"))))
    np.testing.assert_allclose(force[0, 0] * library.command[:, 0], library.target_m_s2[:, 0], atol=1e-3)
    assert all(not check.shortfalls for check in verify_library(library))


def test_free_device_is_solved_and_verified(scene: Scene, taps: list[Recording]) -> None:
    alone = scene.model_copy(update={"grid": scene.grid.model_copy(update={"grips_N": [0.0]})})
    build = build_library(alone, taps)
    assert build.library is not None, [entry.shortfalls for entry in build.refused]
    assert build.entries[0][0].left_out["hand"] == "free device, grip 0"
    assert build.entries[0][0].left_out["position"].endswith("1 state fewer")
    assert all(not check.shortfalls for check in verify_library(build.library))
    assert not build.library.at(0.2, 0.0).silent


def test_a_stiff_undamped_mode_does_not_die_out_in_the_replay() -> None:
    """332 kHz, 2000 rad per servo period: an L-stable step that does not resolve it would damp it away unnoticed."""
    springs = [Link(1.65e8, 3e-3), Link(0.0, 0.0)]
    plant = chain([1e-2, 4e-5], springs, force_per_current_N_A=1.0, stylus=1)
    assert np.abs(np.linalg.eigvals(plant.A)).max() / (2 * np.pi) > 3e5
    stage = discretise(plant, Amplifier(87e3, 0.0, 6.0), 1e-3)
    grid = TimeGrid(1e-3, 60, 0.0, 0.0)
    command = np.where(np.arange(60) < 30, 1.0, 0.0)
    predicted, _ = stage.rollout(command)
    (played,) = replay(stage, grid, command[None], [Target(predicted)], None)
    assert np.abs(played.acceleration_m_s2 - predicted).max() <= 1e-6 * np.abs(predicted).max()


@pytest.mark.parametrize("stages", [1, 20, 21, 90, 400, 3000])
def test_state_scale_is_the_peak_under_the_square_wave(stages: int) -> None:
    """Tick by tick, at most ten periods of 40 ticks; a state that nothing moves keeps 1."""
    random = np.random.default_rng(stages)
    A, B = random.standard_normal((5, 5)), random.standard_normal(5)
    A *= 0.98 / np.abs(np.linalg.eigvals(A)).max()
    A[4, :4], B[4] = 0.0, 0.0
    x, peak = np.zeros(5), np.zeros(5)
    for k in range(-(-min(stages, 400) // 20) * 20):
        x = A @ x + B * (3.0 if k // 20 % 2 == 0 else -3.0)
        peak = np.maximum(peak, np.abs(x))
    np.testing.assert_allclose(state_scale(A, B, 3.0, stages), np.append(peak[:4], 1.0), rtol=1e-10)


@pytest.mark.parametrize("last", [-1, 0, 1, 2, 5, 12, 33])
def test_powers_lie_one_below_the_other(last: int) -> None:
    A = np.random.default_rng(3).standard_normal((4, 4)) / 3
    found = powers(A, last)
    assert found.shape == (4 * (last + 1), 4)
    for j in range(last + 1):
        np.testing.assert_allclose(found[4 * j : 4 * j + 4], np.linalg.matrix_power(A, j), rtol=1e-12, atol=1e-14)
