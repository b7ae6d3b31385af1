"""The terms of the objective against their formulas, their gradients against differences."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from transopt.base.signals import FloatArray
from transopt.problem.objective.movement import Movement
from transopt.problem.objective.target import Target
from transopt.problem.objective.tracking import Tracking
from transopt.problem.objective.weighting import ErrorFilter, error_filter

N, DT_S = 40, 1e-4


def drawn(seed: int, *shape: int) -> FloatArray:
    return np.random.default_rng(seed).normal(size=shape)


@pytest.mark.parametrize("weighting", [None, error_filter("pacinian", DT_S)])
def test_tracking_is_its_formula_and_its_gradient_the_difference(weighting: ErrorFilter | None) -> None:
    weights = np.linspace(0.0, 2.0, N)
    term = Tracking(Target(drawn(1, N)), weights, weighting)
    accelerations = drawn(2, 3, N)
    impulse = np.zeros(N)
    impulse[0] = 1.0
    response = impulse if weighting is None else weighting.apply(impulse)
    expected = 0.0
    for acceleration in accelerations:
        error = np.convolve(response, acceleration - term.target.window_m_s2)[:N]
        expected += sum(w * e**2 for w, e in zip(weights, error, strict=True)) / 3
    expected /= float(np.sum(term.target.window_m_s2**2))
    assert term.value(accelerations) == pytest.approx(expected, rel=1e-12)

    direction, step = drawn(3, N), 1e-3
    ends = [np.vstack([accelerations[0] + sign * step * direction, accelerations[1:]]) for sign in (-1, 1)]
    # The term is quadratic, so that the central difference is its slope.
    slope = (term.value(ends[1]) - term.value(ends[0])) / (2 * step)
    assert float(term.gradient(accelerations[0], 1 / 3) @ direction) == pytest.approx(slope, rel=1e-9)


def test_a_perfect_copy_has_no_error_and_silence_all_of_it() -> None:
    term = Tracking(Target(drawn(4, N)), np.ones(N), error_filter("pacinian", DT_S))
    assert term.nrmse(term.target.window_m_s2) < 1e-12
    assert term.nrmse(np.zeros(N)) == pytest.approx(1.0, rel=1e-12)
    assert not replace(term, target=Target(np.zeros(N))).unit_reference.any()


def test_movement_is_its_formula_its_gradient_and_its_relief_the_differences() -> None:
    term = Movement(rho=3e-3, stages=N, dt_s=2e-4, input_limit=1.25)
    command, direction, step = drawn(5, N), drawn(6, N), 1e-3
    movement = [command[0], *(after - before for before, after in pairwise(command))]
    expected = 3e-3 / (N * 1.25**2) * sum((dc * 1e-4 / 2e-4) ** 2 for dc in movement)
    assert term.value(command) == pytest.approx(expected, rel=1e-12)
    slope = (term.value(command + step * direction) - term.value(command - step * direction)) / (2 * step)
    assert float(term.gradient(command) @ direction) == pytest.approx(slope, rel=1e-9)
    higher, lower = (replace(term, input_limit=1.25 + sign * 1e-4).value(command) for sign in (1, -1))
    assert term.relief(command) == pytest.approx((lower - higher) / 2e-4, rel=1e-6)
