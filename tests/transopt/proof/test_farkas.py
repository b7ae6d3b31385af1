"""Proofs from multipliers alone: what they must never claim, with a coil and without."""

from dataclasses import replace

import numpy as np
import pytest

from problems.stress.cases import StressCase
from problems.stress.parts import Coil, Current, Demand, Horizon
from tests.benches.limits import drawn_ray, with_limit
from tests.conftest import ProblemMaker
from transopt.problem.answer import Multipliers
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import certify, reduced_gradient
from transopt.proof.effect import Effect, inside
from transopt.proof.farkas import is_infeasible
from transopt.solvers.choose import capable, solve
from transopt.solvers.options import SolverOptions

COIL = Coil(below_K=0.0005, nodes=1, tau_w_s=12.0, warming=50.0)


def with_headroom(problem: TransientProblem, headroom_K: np.ndarray) -> TransientProblem:
    thermal = problem.thermal
    return problem.replaced(replace(thermal, model=replace(thermal.model, headroom_K=headroom_K)))


@pytest.fixture(scope="module")
def warm() -> TransientProblem:
    """A convex coil that doing nothing keeps cool, and the limit current does not."""
    case = StressCase("coil", current=Current(limit_A=1e-3), horizon=Horizon(stages=40), coil=COIL)
    problem = case.problem()
    thermal = problem.thermal
    problem = with_limit(problem, thermal.relaxed())
    rest, full = np.zeros(40), np.full(40, 1e-3)
    full[problem.free_stages :] = 0.0
    idle, hot = (problem.thermal.temperatures_C(problem.stage.motion(c).plant_input, c) for c in (rest, full))
    limit = idle + 0.2 * (hot - idle).max()
    problem = with_headroom(problem, limit - problem.thermal.model.unpowered_C)
    assert inside(problem, rest)
    assert not inside(problem, full)
    return problem


class TestFarkas:
    def test_no_sign_of_the_ripple_proves_a_feasible_coil_infeasible(self, warm: TransientProblem) -> None:
        """The slope of |mean i| may be anything; what it leaves below the size has to count."""
        full = np.full(40, 1e-3)
        full[warm.free_stages :] = 0.0
        sign = np.sign(warm.stage.motion(full).plant_input)
        last = np.eye(40)[-1]
        for slope in (np.zeros(40), sign, -sign, *np.random.default_rng(1).uniform(-1, 1, (20, 40))):
            ray = replace(Multipliers.zero(warm), slope=slope).with_pair("temperature", np.zeros(40), last)
            assert not is_infeasible(warm, full, ray)

    def test_a_coil_that_nothing_keeps_cool_is_proven(self, warm: TransientProblem) -> None:
        frozen = with_headroom(warm, warm.thermal.model.headroom_K - 1.0)
        rest = np.zeros(40)
        ray = Multipliers.zero(frozen).with_pair("temperature", rest, np.eye(40)[-1])
        assert is_infeasible(frozen, rest, ray)

    @pytest.mark.parametrize("length", [1e-8, 1.0, 1e8])
    def test_how_long_a_ray_is_does_not_matter(self, warm: TransientProblem, length: float) -> None:
        frozen, rest = with_headroom(warm, warm.thermal.model.headroom_K - 1.0), np.zeros(40)
        hot = Multipliers.zero(frozen).with_pair("temperature", rest, length * np.eye(40)[-1])
        assert is_infeasible(frozen, rest, hot.with_pair("current", 1e-6 * length * np.ones(40), rest))

    def test_random_rays_prove_nothing_of_a_feasible_problem(self, make_problem: ProblemMaker) -> None:
        problem = make_problem(0.4, 5.0, slew_A_per_s=5000.0)
        random = np.random.default_rng(5)
        answer = solve(problem)
        for _ in range(10):
            ray = drawn_ray(problem, random)
            assert not is_infeasible(problem, answer.command, ray)


def test_no_multiplier_counts_where_there_is_no_limit() -> None:
    """Half the optimum with a multiplier on an infinite headroom that cancels its gradient is no optimum."""
    case = StressCase(
        "forged",
        current=Current(limit_A=4.0, pole_Hz=None),
        horizon=Horizon(stages=2, hand_over=1, lead_s=0.0),
        coil=Coil(below_K=20.0, nodes=1, tau_w_s=12.0, warming=0.1, tap_share=0.05),
        demand=Demand(kind="constant", speed_m_s=0.01),
    )
    problem = case.problem()
    thermal = problem.thermal
    problem = with_headroom(with_limit(problem, thermal.relaxed()), np.array([np.inf, 5.0]))
    command = 0.5 * solve(problem.without("temperature")).command
    motion = problem.stage.motion(command)
    slope = np.sign(problem.thermal.model.heating.mean_current(motion.plant_input, command))
    forged = replace(Multipliers.zero(problem), slope=slope)
    plain = reduced_gradient(Effect(problem, command), forged)
    unit = forged.with_pair("temperature", np.zeros(2), np.array([1.0, 0.0]))
    by_unit = reduced_gradient(Effect(problem, command), unit) - plain
    forged = forged.with_pair("temperature", np.zeros(2), np.array([-plain[0] / by_unit[0], 0.0]))
    forged = replace(forged, hand_over=-reduced_gradient(Effect(problem, command), forged)[1:])
    assert not certify(problem, command, forged).accepted


def test_too_many_devices_give_way_to_another_method(make_problem: ProblemMaker) -> None:
    problem = make_problem(0.4, 3.0, stages=30)
    spread = tuple(make_problem(0.4, grip, stages=30).stage for grip in np.linspace(1.0, 5.0, 20))
    many = replace(problem, spread=spread)
    assert "riccati" not in capable(many)
    answer = solve(many, SolverOptions())
    assert certify(many, answer.command, answer.multipliers).accepted
