"""The linear stage, which problems of one device share."""

from dataclasses import fields

import numpy as np

from tests.conftest import ProblemMaker
from transopt.problem.stage import LinearStage, linear_stage


def assert_same(one: LinearStage, other: LinearStage) -> None:
    for field in fields(LinearStage):
        value = getattr(one, field.name)
        if isinstance(value, float | np.ndarray):
            np.testing.assert_allclose(value, getattr(other, field.name), rtol=1e-14, atol=0)


def test_that_of_another_reference_follows_from_it(make_problem: ProblemMaker) -> None:
    slow, fast = make_problem(0.1, 3.0), make_problem(0.4, 3.0)
    assert_same(linear_stage(slow).rescaled(fast), linear_stage(fast))


def test_other_limits_have_units_of_their_own(make_problem: ProblemMaker) -> None:
    strong, weak = make_problem(0.4, 3.0), make_problem(0.2, 3.0, current_A=1.25)
    assert weak.input_scale < strong.input_scale
    assert_same(linear_stage(strong).rescaled(weak), linear_stage(weak))
