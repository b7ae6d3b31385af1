"""Methods whose native code is lost end in an answer that says so; bounds on J and of limits."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from problems.stress.cases import StressCase
from problems.stress.draw import drawn
from problems.stress.parts import Coil, Current, Demand, Horizon, Surface
from tests.benches.endings import dies, waits
from tests.conftest import ProblemMaker
from transopt.base import apart
from transopt.base.errors import InputError
from transopt.design.optimum import optimum
from transopt.plant.intention import INTENTION_S
from transopt.problem.answer import Certificate, Solution, Status
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import relaxed_bound
from transopt.proof.effect import Effect
from transopt.solvers import choose, feasibility, riccati
from transopt.solvers.choose import global_bounds
from transopt.solvers.native import extension
from transopt.solvers.options import SolverOptions
from transopt.solvers.stage_data import stages

FALLBACKS = ("casadi-piqp", "casadi-ipopt")


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


# What an answer may lie below the optimum that it is proven to be: it may leave its limits by a millionth.
ROUNDING = 1e-8


def with_little_room(seed: int) -> TransientProblem:
    """A tap on the default device whose coil has little room: one and two nodes, repeated or not."""
    random = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    coil = Coil(
        tau_w_s=between(1e-2, 1e3),
        tau_h_s=between(1e-2, 1e4),
        below_K=between(1e-2, 30.0),
        warming=between(2.0, 30.0),
        nodes=1 + seed % 2,
        tap_share=between(0.02, 0.8) if seed // 2 % 2 else None,
    )
    current = Current(limit_A=between(0.3, 8.0), pole_Hz=None if random.random() < 0.2 else between(300.0, 2e4))
    demand = Demand(speed_m_s=between(0.1, 1.0))
    return StressCase("bounds", current=current, horizon=Horizon(stages=60), demand=demand, coil=coil).problem()


def answers(seeds: range) -> list[tuple[TransientProblem, np.ndarray, Certificate, list[float]]]:
    """Give problem, command, certificate and every bound that there is, of the optima whose temperature binds."""
    found = []
    for seed in seeds:
        problem = with_little_room(seed)
        designed = optimum(problem, SolverOptions())
        answer = designed.solution
        if designed.is_proven and answer.multipliers.upper("temperature").any():
            effect = Effect(problem, answer.command)
            bounds = [
                designed.certificate.lower_bound,
                global_bounds([problem], SolverOptions())[0],
                relaxed_bound(effect, answer.multipliers),
            ]
            found.append((problem, answer.command, designed.certificate, bounds))
    return found


def worst(seeds: range) -> tuple[int, float, float]:
    """How many answers; how far the highest of their bounds lies above J; and how far the stated one lies below."""
    made = answers(seeds)
    above = [(max(bounds) - proof.objective) / max(proof.objective, 1e-3) for _, _, proof, bounds in made]
    return len(made), max(above), float(np.median([proof.relative_bound for *_, proof, _ in made]))


def test_certified_answers_lie_above_their_bounds() -> None:
    count, above, below = worst(range(60))
    assert count >= 25
    assert above <= ROUNDING
    assert below < Certificate.BOUND_TOLERANCE


@pytest.mark.long
@pytest.mark.parametrize("first", range(1000, 3000, 100))
def test_a_thousand_certified_answers_lie_above_their_bounds(first: int) -> None:
    count, above, _ = worst(range(first, first + 100))
    assert count >= 35
    assert above <= ROUNDING


def test_the_bound_of_a_cooler_limit_is_too_high_for_the_stated_one() -> None:
    """The comparison can fail: what bounds the problem with a fiftieth less room does not bound this one."""
    (problem, _, proof, _), *_ = answers(range(2, 12))
    thermal = problem.thermal
    assert thermal is not None
    less = replace(thermal.model, headroom_K=0.98 * thermal.model.headroom_K)
    assert global_bounds([problem.replaced(replace(thermal, model=less))], SolverOptions())[0] > proof.objective


def test_bounds_are_searched_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    problems, solve, sizes = [problem for problem, *_ in answers(range(6))], choose.solve_all, list[int]()

    def counted(some: list[TransientProblem], options: SolverOptions) -> list[Solution]:
        sizes.append(len(some))
        return solve(some, options)

    alone = [global_bounds([problem], SolverOptions())[0] for problem in problems]
    monkeypatch.setattr(choose, "solve_all", counted)
    assert global_bounds(problems, SolverOptions()) == pytest.approx(alone, rel=1e-7)
    assert len(problems) > 1
    assert sizes[0] == len(problems)


@pytest.mark.skipif(not extension.available, reason="the extension is not built")
class TestLimits:
    """What no value can lie between is refused, by the extension and by the statement of the other methods."""

    @pytest.mark.parametrize(
        ("name", "value"),
        [("upper", np.nan), ("lower", np.nan), ("upper", -2.0), ("upper", -np.inf), ("lower", np.inf)],
    )
    def test_are_refused_by_name_and_stage(self, make_problem: ProblemMaker, name: str, value: float) -> None:
        given = stages(make_problem(0.4, 5.0))
        row = given.limits.kinds.index("current")
        bounds = getattr(given.limits, name).copy()
        bounds[7, row] = value
        limits = replace(given.limits, **{name: bounds})
        broken = replace(given, limits=limits, arrays=given.arrays | {name: bounds})
        with pytest.raises(InputError, match=r"limit current: bounds .* at stage 7, .* must be numbers"):
            extension.interior_points([given, broken], tolerance=1e-9, max_iterations=9)

    @pytest.mark.parametrize("solver", ["riccati", "casadi-piqp", "casadi-ipopt"])
    def test_are_refused_by_every_method(self, make_problem: ProblemMaker, solver: str) -> None:
        problem = make_problem(0.4, 5.0)
        limit = copy(problem.limits["current"])
        object.__setattr__(limit, "limit", float("nan"))  # whatever a limit's own checks let through
        problem = problem.replaced(limit)
        with pytest.raises(InputError, match=r"limit .*bounds nan and nan at stage"):
            choose.SOLVERS[solver].method([problem], SolverOptions(solver))
