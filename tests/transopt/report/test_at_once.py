"""What is done at once, or by fewer operations, against the same step by step or by a library."""

import os
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import ProblemMaker
from transopt.base import workers
from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.base.signals import FloatArray
from transopt.plant.coil import CoilModel
from transopt.plant.continuous import BLOCK, Flow, accurate
from transopt.plant.discretise import TimeGrid
from transopt.problem.baselines import clipped_optimum, seed_inversion
from transopt.report.publish import Files, publishing
from transopt.scene.scene import Scene
from transopt.scene.strikes import contact_force, rk4_step, strike


def test_strikes_are_those_of_the_plain_integrator(scene: Scene) -> None:
    """Every state by `rk4_step` from the equations as they stand, for taps that touch, part and touch again."""
    target = scene.recordings.simulated
    assert target is not None
    plant, speeds, step_s = scene.plant(target.grip_N, struck=True), np.array([0.1, 0.4]), 1e-5
    n, masses = plant.order, plant.order // 2
    stylus = int(np.flatnonzero(plant.B[masses:, 0])[0])

    def force(state: FloatArray) -> FloatArray:
        z = state[stylus:masses].sum(axis=0) - speeds * state[-1]
        return contact_force(target, state[n] - z, state[n + 1] - state[masses + stylus] + speeds)

    def rate(state: FloatArray) -> FloatArray:
        F = force(state)
        foam = target.object_stiffness_N_m * state[n] + target.object_damping_N_s_m * state[n + 1]
        device = plant.A @ state[:n] + plant.B * F
        object_ = [state[n + 1], -(F + foam) / target.object_mass_kg]
        return np.concatenate([device, object_, np.ones((1, speeds.size))])

    times, acceleration, encoder = strike(plant, target, speeds, 8e-3, step_s)
    state, forces = np.zeros((n + 3, speeds.size)), []
    for k in range(times.size):
        forces.append(force(state))
        expected = plant.C[0] @ state[:n] + plant.D[0, 0] * forces[-1]
        np.testing.assert_allclose(acceleration[:, k], expected, atol=1e-8)
        np.testing.assert_allclose(encoder[:, k], plant.Ce[0] @ state[:n] - speeds * times[k], atol=1e-13)
        state = rk4_step(rate, state, step_s)
    assert np.min(forces) == 0 < np.max(forces)


@pytest.mark.parametrize("delay_s", [68e-6, 100e-6, 168e-6])
@pytest.mark.parametrize("stages", [BLOCK - 3, 5 * BLOCK + 1])
def test_blocks_of_periods_are_the_periods_one_by_one(
    make_problem: ProblemMaker, delay_s: float, stages: int
) -> None:
    problem = make_problem(stages=100, delay_s=delay_s)
    stage, grid = problem.stage, TimeGrid(1e-4, stages, 3e-4, delay_s)
    commands = np.random.default_rng(stages).uniform(-4, 4, (3, stages))
    course = accurate(stage, grid, commands, None).course
    first, second = course.segments
    periods = course.states[0].shape[1]
    issued = np.zeros((3, periods + first.behind))
    issued[:, first.behind : first.behind + stages] = commands
    x = np.zeros((3, Flow.of(stage).A.shape[0]))
    starts = []
    for k in range(periods):
        starts.append(x)
        for segment in (first, second):
            felt = issued[:, k + first.behind - segment.behind]
            x = x @ segment.P[-1].T + felt[:, None] * segment.Q[-1][:, 0]
    expected = np.stack(starts, axis=1)
    size = np.abs(expected).max(axis=(0, 1))
    np.testing.assert_allclose(course.states[0] / size, expected / size, rtol=0, atol=1e-12)


def test_rivals_at_two_limits_are_those_at_each(make_problem: ProblemMaker) -> None:
    problem = make_problem(0.4, 5.0)
    rows = np.stack([problem.reference_m_s2, 0.5 * problem.reference_m_s2])
    limits_A = np.array([4.0, 1.25])[:, None, None]
    seed = seed_inversion(problem.stage, problem.grid, rows, limits_A, 10)
    clipped = clipped_optimum(problem.stage, problem.grid, rows / 10, limits_A)
    for j, limit_A in enumerate((4.0, 1.25)):
        np.testing.assert_array_equal(seed[j], seed_inversion(problem.stage, problem.grid, rows, limit_A, 10))
        np.testing.assert_array_equal(clipped[j], clipped_optimum(problem.stage, problem.grid, rows / 10, limit_A))
    assert not np.allclose(seed[0], seed[1])


def test_a_coil_that_runs_away_is_infinitely_hot_and_no_other_is() -> None:
    coil = CoilModel(2.18, 3.1, 14.0, 12.0, 612.0, 100.0)
    heat = np.array([np.full(50, 1e12), np.full(50, 1.0)])
    winding, housing = coil.simulate(heat, np.full(50, 1e-2))
    assert winding[0, -1] == housing[0, -1] == np.inf
    alone, _ = coil.simulate(heat[1:], np.full(50, 1e-2))
    # In arrays of another shape every one of the steps may round otherwise.
    np.testing.assert_allclose(winding[1], alone[0], rtol=50 * np.finfo(float).eps)


def written(path: Path) -> None:
    path.write_text("new")


def refused(path: Path) -> None:
    raise InputError(f"{path.name}: cannot be written")


@pytest.fixture(params=["here", "pool"])
def pool(request: pytest.FixtureRequest) -> Iterator[Executor | None]:
    """No workers, or two."""
    if request.param == "here":
        yield None
    else:
        with ThreadPoolExecutor(2) as workers:
            yield workers


class TestPublishing:
    def test_a_figure_that_fails_leaves_what_was_there(self, tmp_path: Path, pool: Executor | None) -> None:
        (tmp_path / "a").write_text("old")
        files = Files(here={"a": written}, tasks={"b": refused, "c": written})
        with pytest.raises(InputError, match="b: cannot be written"), publishing(tmp_path, files, [], pool):
            pass
        assert [path.name for path in tmp_path.iterdir()] == ["a"]
        assert (tmp_path / "a").read_text() == "old"

    def test_everything_comes_at_the_end_and_what_is_stale_goes(self, tmp_path: Path, pool: Executor | None) -> None:
        (tmp_path / "stale").write_text("old")
        files = Files(here={"a": written}, tasks={"b": written, "c": written})
        with publishing(tmp_path, files, ["stale"], pool):
            assert not any((tmp_path / name).exists() for name in files.names)
        assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys("abc", "new")

    def test_what_stops_the_block_stops_the_files(self, tmp_path: Path, pool: Executor | None) -> None:
        files = Files(here={"a": written}, tasks={"b": written})
        with pytest.raises(KeyboardInterrupt), publishing(tmp_path, files, [], pool):
            raise KeyboardInterrupt
        assert list(tmp_path.iterdir()) == []

    def test_what_a_dead_worker_has_not_drawn_is_drawn_here(self, tmp_path: Path) -> None:
        files = Files(here={"a": written}, tasks={"b": written, "c": written})
        with ProcessPoolExecutor(1) as workers, publishing(tmp_path, files, [], workers):
            workers.submit(os._exit, 1)
        assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys("abc", "new")

    def test_a_folder_that_is_gone_is_named(self, tmp_path: Path) -> None:
        files = Files(here={"a": written}, tasks={})
        with (
            pytest.raises(InputError, match="gone: cannot be written"),
            publishing(tmp_path / "gone", files, [], None),
        ):
            pass

    def test_no_error_names_the_place_beside(self, tmp_path: Path) -> None:
        def fails(path: Path) -> None:
            with whole_file(path) as file:
                file.write(b"half")
                raise OSError(28, "No space left on device")

        with (
            pytest.raises(InputError, match=r"a: cannot be written .No space left") as caught,
            publishing(tmp_path, Files(here={"a": fails}, tasks={}), [], None),
        ):
            pass
        assert str(caught.value).startswith(f"{tmp_path / 'a'}:")
        assert list(tmp_path.iterdir()) == []


def test_a_dead_worker_is_told_in_one_line() -> None:
    with pytest.raises(InputError, match=r"--jobs 1: a worker process died, .*; try fewer"), workers.pool(1) as pool:
        pool.submit(os._exit, 1).result()


def test_a_coil_that_runs_away_within_one_period_is_hot_for_ever() -> None:
    coil = CoilModel(2.18, 3.1, 14.0, 2e-5, 75.0, 100.0)
    winding, housing = coil.steady_course(np.full((1, 40), 1e4), np.full(40, 2e-4), 0.01, np.zeros(1))
    assert np.all(np.isposinf(winding))
    assert not np.any(np.isnan(housing))
