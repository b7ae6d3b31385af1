"""Methods whose native code is lost: they end in an answer that says so, and in nothing else."""

import os
import threading
from dataclasses import replace

import numpy as np
import pytest

from problems.stress.cases import StressCase
from problems.stress.draw import drawn
from problems.stress.parts import Current, Horizon, Surface
from transopt.base import apart
from transopt.design.optimum import optimum
from transopt.plant.intention import INTENTION_S
from transopt.problem.answer import Status
from transopt.problem.problem import TransientProblem
from transopt.solvers import choose, feasibility, riccati
from transopt.solvers.options import SolverOptions

FALLBACKS = ("casadi-piqp", "casadi-ipopt")


def dies(*_: object) -> None:
    """End the process, as native code does that writes outside its memory."""
    os._exit(134)


def waits(*_: object) -> None:
    """Wait for ever, as native code does that finds no end to its search."""
    threading.Event().wait()


@pytest.fixture
def saturated() -> TransientProblem:
    return StressCase("saturated", current=Current(limit_A=0.5), horizon=Horizon(stages=60)).problem()


@pytest.mark.parametrize("solver", FALLBACKS)
def test_a_method_that_ends_its_process_is_a_breakdown(saturated: TransientProblem, solver: str) -> None:
    answer = choose._apart(solver, dies)([saturated], SolverOptions(solver))[0]
    assert answer.status is Status.NUMERICAL_FAILURE
    assert answer.solver == solver
    assert "ended with code 134" in answer.message
    assert not answer.command.any()


@pytest.mark.parametrize("solver", FALLBACKS)
def test_one_that_does_not_return_is_ended(
    saturated: TransientProblem, solver: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(choose, "most_time_s", lambda stages: 0.0)
    monkeypatch.setattr(choose, "LATE_S", 1e-3)
    answer = choose._apart(solver, waits)([saturated], SolverOptions(solver))[0]
    assert answer.status is Status.NUMERICAL_FAILURE
    assert "no answer within 0.01 s" in answer.message


def test_the_next_method_is_asked(saturated: TransientProblem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(
        choose.SOLVERS, "riccati", choose.Solver(choose._apart("riccati", dies), lambda problem: True)
    )
    answer, proof, _ = choose.solve_certified([saturated], SolverOptions("riccati"))[0]
    assert answer.solver == "casadi-piqp"
    assert proof.is_stationary


def test_feasibility_that_cannot_be_decided_stops_no_other_method(
    saturated: TransientProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    impossible = StressCase("wall", current=Current(limit_A=0.3), horizon=Horizon(stages=40), surface=Surface(2e3))
    assert choose.feasible(saturated)
    assert not choose.feasible(impossible.problem())
    monkeypatch.setattr(feasibility, "available", False)
    assert choose.feasible(impossible.problem())


def test_a_problem_of_any_scale_has_the_same_least_widening() -> None:
    """A wall that asks for a hundred thousand times the limit: the factor goes with the limit, digit by digit."""
    factors = []
    for limit in (3.0, 3e-2, 3e-5):
        case = StressCase("wall", current=Current(limit_A=limit), horizon=Horizon(stages=40), surface=Surface(2e4))
        found = feasibility.least_widening(case.problem(), ["current", "command"])
        assert found is not None
        factors.append(found[0] * limit)
    assert factors[0] / 3e-5 > 1e4
    np.testing.assert_allclose(factors, factors[0], rtol=1e-6)


def test_what_a_factorisation_prints_reaches_no_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    """The sparse factorisation of a system that has broken down complains by itself."""
    case = drawn(3, 286)
    straight = replace(case, demand=replace(case.demand, yields="straight", intention_s=INTENTION_S))
    designed = optimum(straight.problem(), SolverOptions())
    assert designed.solution.status is Status.INFEASIBLE
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(not riccati.available, reason="the extension is not built")
def test_the_own_method_needs_no_other_process(saturated: TransientProblem, monkeypatch: pytest.MonkeyPatch) -> None:
    def started(*_: object, **__: object) -> None:
        raise AssertionError("a process was started")

    monkeypatch.setattr(apart, "call", started)
    assert optimum(saturated, SolverOptions()).is_proven
