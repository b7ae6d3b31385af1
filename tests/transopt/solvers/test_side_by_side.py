"""Stage data and searches carried on together are those of each alone; the size of a program."""

import threading
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from problems.stress.cases import StressCase
from problems.stress.parts import Coil, Current, Horizon, Surface
from transopt.base.recursions import address
from transopt.design.context import Context
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import Layout, linear_stage
from transopt.references.references import References
from transopt.scene.scene import Scene
from transopt.solvers import modes, stage_data
from transopt.solvers.program import state_program
from transopt.solvers.shape import Size, program_shape, size
from transopt.solvers.side_by_side import Ask, Search, alone, together
from transopt.solvers.stage_data import NO_LIMITS, Stages, records_of, stages, stages_of, without_limits_of


class Halves:
    """A method that halves even numbers, and remembers what it was asked at once."""

    def __init__(self) -> None:
        self.asked: list[list[int]] = []

    def __call__(self, numbers: Sequence[int], *settings: str) -> list[int]:
        self.asked.append(list(numbers))
        if any(number % 2 for number in numbers):
            raise ValueError("an odd number has no half")
        return [number // 2 for number in numbers]


def halvings(method: Halves, number: int, *settings: str) -> Search[int]:
    """How often a number can be halved until it is 1."""
    count = 0
    while number > 1:
        number = yield Ask(method, number, settings)
        count += 1
    return count


def test_those_that_ask_the_same_are_answered_in_one_call() -> None:
    method = Halves()
    assert together([halvings(method, number) for number in (8, 2, 1, 4)]) == [3, 1, 0, 2]
    assert method.asked == [[8, 2, 4], [4, 2], [2]]


def test_another_setting_is_another_question() -> None:
    method = Halves()
    assert together([halvings(method, 2, "a"), halvings(method, 2, "b"), halvings(method, 2, "b")]) == [1, 1, 1]
    assert method.asked == [[2, 2], [2]]


def test_an_exception_is_raised_in_the_search_that_caused_it() -> None:
    method = Halves()

    def told(number: int) -> Search[str]:
        try:
            found = yield from halvings(method, number)
        except ValueError as error:
            return str(error)
        return f"{found} times"

    assert together([told(4), told(6), told(8)]) == ["2 times", "an odd number has no half", "3 times"]
    with pytest.raises(ValueError, match="an odd number"):
        together([halvings(method, 4), halvings(method, 3)])


def test_alone_a_search_reads_as_it_runs() -> None:
    method = Halves()
    assert alone(halvings(method, 16)) == 4
    assert method.asked == [[16], [8], [4], [2]]
    assert together([]) == []


@pytest.fixture
def problems(scene: Scene, recorded: References) -> list[TransientProblem]:
    """Taps with a tail at two grips in turn, without the temperature, one of them with a price on heat."""
    context = Context(scene, recorded)
    taps = [(speed, grip) for speed in scene.grid.speeds_m_s for grip in scene.grid.grips_N[:2]]
    found = [context.posed(*tap).problem.without("temperature") for tap in taps]
    return [replace(found[0], heat_price=1e-3), *found]


@pytest.fixture
def one_by_one(problems: list[TransientProblem], monkeypatch: pytest.MonkeyPatch) -> list[Stages]:
    found = []
    for problem in problems:
        monkeypatch.setattr(stage_data, "_memory", threading.local())
        found.append(stages(problem))
    monkeypatch.setattr(stage_data, "_memory", threading.local())
    return found


def test_together_as_alone(problems: list[TransientProblem], one_by_one: list[Stages]) -> None:
    for problem, given, other in zip(problems, stages_of(problems), one_by_one, strict=True):
        assert given.problem is problem
        assert given.sizes == other.sizes
        assert given.numbers == pytest.approx(other.numbers, rel=1e-12)
        for name, array in given.arrays.items():
            np.testing.assert_allclose(array, other.arrays[name], rtol=1e-12, atol=1e-14, err_msg=name)


def test_taps_of_one_grip_differ_in_the_target_alone(problems: list[TransientProblem]) -> None:
    given = stages_of(problems)
    first, of_its_grip = given[1], given[3]
    assert first.arrays["A"] is of_its_grip.arrays["A"]
    assert first.arrays["A"] is not given[2].arrays["A"]
    assert np.abs(first.arrays["reference"] - of_its_grip.arrays["reference"]).max() > 1e-3


def test_records_are_those_of_each_alone(problems: list[TransientProblem]) -> None:
    for given in (*stages_of(problems), *without_limits_of(problems)):
        assert given.record == replace(given).record
        (record,) = records_of([given.record])
        for name, value in (given.sizes | given.numbers).items():
            assert record[name] == value
        for name, array in given.arrays.items():
            assert record[name] == address(array)
        assert all(array.flags.c_contiguous for array in given.arrays.values())


def test_what_is_asked_for_again_is_not_computed_again(problems: list[TransientProblem]) -> None:
    first = stages_of(problems)
    again = stages_of([replace(problem) for problem in problems])
    assert all(one.arrays is other.arrays for one, other in zip(first, again, strict=True))


def test_without_limits_nothing_is_bounded(problems: list[TransientProblem]) -> None:
    for given, whole in zip(without_limits_of(problems), stages_of(problems), strict=True):
        assert given.sizes == whole.sizes | {"rows": 0}
        assert whole.sizes["rows"] > 0
        assert all(given.arrays[name].size == 0 for name in NO_LIMITS)


def test_a_current_that_is_lost_in_every_mode_leaves_the_states_as_they_are() -> None:
    """In the unit of the current such a mode would overflow; every warning is an error here."""
    A = np.array([[0.5, 1e308, 0.0], [0.0, 0.25, 0.75], [0.0, 0.0, 1.0]])
    stage: Any = SimpleNamespace(A=A, units=np.ones(3), motors=1)
    found = modes._modes_of(stage, Layout((1,), amplifier=True, filters=(), priced=False, feedback_delay=None))
    np.testing.assert_array_equal(found.T, np.eye(3))
    np.testing.assert_array_equal(found.A, A)


@pytest.mark.parametrize("grips_N", [(2.4, 2.6, 2.8, 3.2, 3.4, 3.6), (2.999, 3.001), (3.0, 3.0)])
def test_the_modes_of_a_spread_are_apart(problems: list[TransientProblem], scene: Scene, grips_N: Any) -> None:
    """The error filters of all its devices have the same eigenvalues, and nearly equal devices nearly equal ones."""
    several = replace(problems[1], spread=tuple(Context(scene).stage(grip) for grip in grips_N))
    A = linear_stage(several).A
    found = modes.modes_of(several, linear_stage(several))
    assert np.linalg.cond(found.T) < 50
    np.testing.assert_allclose(found.T @ found.A, A @ found.T, atol=1e-12 * np.abs(A).max())


def test_a_posed_problem_cannot_be_edited_under_what_is_kept_of_it(problems: list[TransientProblem]) -> None:
    problem = problems[0]
    stages(problem)
    own = problem.target.window_m_s2.copy()
    for kept in (problem.target.window_m_s2, problem.stage.A, problem.stage.C):
        with pytest.raises(ValueError, match="read-only"):
            kept[0] = 0.5
    given = replace(problem.target, window_m_s2=own).window_m_s2
    assert not given.flags.writeable
    assert own.flags.writeable


CASES = {
    "plain": StressCase("plain"),
    "ideal": StressCase("ideal", current=Current(pole_Hz=None)),
    "rail": StressCase("rail", current=Current(supply=2.0, slew=0.05)),
    "wall": StressCase("wall", surface=Surface(200.0)),
    "coil": StressCase("coil", coil=Coil(below_K=5.0)),
    "repeated": StressCase("repeated", coil=Coil(below_K=20.0, tap_share=0.5)),
}


@pytest.mark.parametrize("name", CASES)
def test_the_size_counted_is_that_of_the_program_stated(name: str) -> None:
    problem = replace(CASES[name], horizon=Horizon(stages=90)).problem()
    shape = program_shape(problem)
    stated = state_program(shape)
    assert size(problem) == Size(shape.variables - shape.controls, stated.x.numel(), stated.g.numel())
