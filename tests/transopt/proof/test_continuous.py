"""What a replay keeps of a course, against all its samples."""

from dataclasses import replace

import numpy as np
import pytest

from problems.stress.cases import StressCase
from problems.stress.parts import Surface
from tests.conftest import ProblemMaker
from transopt.proof.continuous import MOST_KEPT, Loop, accurate

pytestmark = pytest.mark.usefixtures("way")


@pytest.mark.parametrize("late_ticks", [0.0, 0.3, 2.0, 2.6])
@pytest.mark.parametrize("after", [0, 300])
def test_the_largest_values_are_those_of_all_samples(
    make_problem: ProblemMaker, late_ticks: float, after: int
) -> None:
    problem = make_problem(stages=40)
    grid = replace(problem.grid, delay_s=late_ticks * problem.grid.dt_s, after_stages=after)
    random, N, M = np.random.default_rng(after), grid.stages, 3
    course = accurate(problem.stage, grid, random.uniform(-4, 4, (M, N)), None)
    period, flow = course.period, course.period.flow
    K, y, u, felt = period.to_samples.shape[2], 0, flow.tracked, len(flow.rows)
    rows = np.eye(len(flow.rows) + 1)[[u, felt, u]]
    offset = random.standard_normal((M, N + 1))
    reached, late = course.reached(rows, {2: offset}, np.eye(1, len(flow.rows) + 1))

    def samples(row: int) -> np.ndarray:
        values = period.sampled(np.eye(len(flow.rows) + 1)[[row]]).outputs(course.acting)
        return values.swapaxes(1, 2).reshape(M, -1)

    dt, segments = grid.dt_s, period.segments
    times = np.add.outer(
        dt * np.arange(period.periods) - grid.lead_s, np.concatenate([s.offsets_s for s in segments])
    )
    times = times.ravel()
    assert np.all(np.diff(times) >= -1e-15)
    assert times[-1] >= grid.end_s + 20e-3 - 1e-12
    knots = np.append(grid.switching_times_s, grid.end_s)
    moved = samples(u) + np.stack([np.interp(times, knots, of) for of in offset])
    # An instant has two samples, just before and just after it: parts end after both at tau_(N-1) and at tau_N.
    begins, over, ends = period.bounds
    assert times[begins] == pytest.approx(grid.switching_times_s[0], abs=1e-12)
    assert times[over - 1] == pytest.approx(grid.switching_times_s[-1], abs=1e-12)
    assert over % (K // 2) == 1
    assert times[ends - 1] <= grid.end_s < times[ends]
    for part, at in enumerate(np.split(np.arange(times.size), period.bounds)):
        for row, values in enumerate((samples(u), samples(felt), moved)):
            expected = np.abs(values[:, at]).max(axis=1, initial=0.0)
            np.testing.assert_allclose(reached[:, row, part], expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(late[:, 0], np.abs(samples(y)[:, ends:]).max(axis=1), rtol=1e-12)


def test_rounding_is_that_of_the_terms_of_the_acceleration(make_problem: ProblemMaker) -> None:
    problem = make_problem(stages=30)
    course = accurate(problem.stage, problem.grid, np.random.default_rng(0).uniform(-4, 4, (2, 30)), None)
    period, flow, acting = course.period, course.period.flow, course.acting
    n = flow.A.shape[0]
    parts = period.terms.outputs(acting)[..., period.at_switching]
    assert parts.shape[1] == n + 1
    np.testing.assert_allclose(parts.sum(axis=1), course.accelerations, rtol=1e-9, atol=1e-9)
    expected = 16 * np.finfo(float).eps * np.abs(parts).sum(axis=1).max(axis=1)
    np.testing.assert_allclose(course.rounding, expected, rtol=1e-12)


def test_the_systems_that_a_period_keeps_are_few_and_those_asked_for(make_problem: ProblemMaker) -> None:
    problem = make_problem(stages=20)
    course = accurate(problem.stage, problem.grid, np.random.default_rng(0).uniform(-4, 4, (1, 20)), None)
    period, rows = course.period, np.eye(1, course.period.to_samples.shape[0])
    first, acting = period.sampled(rows), course.acting
    assert period.sampled(rows.copy()) is first
    for scale in range(2, 2 * MOST_KEPT):
        found = period.sampled(scale * rows).outputs(acting)
        np.testing.assert_allclose(found, scale * first.outputs(acting), rtol=1e-12, atol=1e-12)
        assert period.sampled(scale * rows, [0]) is not period.sampled(scale * rows)
    assert len(period._kept) <= MOST_KEPT


def test_a_motion_of_which_one_tick_is_known_goes_on_as_it_approached() -> None:
    problem = StressCase("wall", surface=Surface()).problem()
    wall, command = problem.wall, np.zeros((1, problem.grid.stages))
    assert wall is not None
    straight_m = -wall.approach_m_s * problem.grid.dt_s * np.arange(5)
    one, *others = (
        accurate(problem.stage, problem.grid, command, Loop([replace(wall, nominal_m=straight_m[:ticks])], 0.0))
        for ticks in (1, 2, 5)
    )
    assert np.abs(one.accelerations).max() > 0.1
    for other in others:
        np.testing.assert_allclose(one.accelerations, other.accelerations, rtol=1e-9, atol=1e-9)
