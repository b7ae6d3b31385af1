"""The unlimited optimum: the Riccati pass against other solvers and the sparse system, on extreme devices."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy

from problems.stress.draw import drawn
from tests.benches.limits import with_numbers
from tests.conftest import ProblemMaker, WalledMaker
from transopt.design.optimum import ROUNDED
from transopt.plant.chain import Link, chain
from transopt.plant.discretise import Motion, discretise
from transopt.plant.wall import reference_course
from transopt.problem.answer import OBJECTIVE_SCALE, Solution, Status
from transopt.problem.objective.target import Target
from transopt.problem.objective.weighting import error_filter
from transopt.problem.problem import TransientProblem
from transopt.problem.wall_ticks import pressing
from transopt.proof.certify import certify, gradient_rounding
from transopt.solvers import unlimited
from transopt.solvers.choose import solve
from transopt.solvers.native import extension
from transopt.solvers.options import SolverOptions
from transopt.solvers.stage_data import without_limits


@pytest.mark.parametrize("ideal", [False, True])
def test_agrees_with_solvers_whose_limits_are_far_away(make_problem: ProblemMaker, ideal: bool) -> None:
    problem = make_problem(0.3, 3.0, ideal=ideal, stages=60, current_A=40.0, **({} if ideal else {"command_A": 60.0}))
    free = unlimited.solve(problem)
    for solver in ("casadi-piqp", "casadi-ipopt"):
        np.testing.assert_allclose(free.command, solve(problem, SolverOptions(solver)).command, atol=1e-6)
    np.testing.assert_allclose(free.command, unlimited.solve_sparse_kkt(problem).command, atol=1e-9)


def test_every_entry_of_the_default_scene_is_proven_by_the_pass(make_problem: ProblemMaker) -> None:
    for speed in (0.1, 0.2, 0.3, 0.4):
        for grip in (1.0, 3.0, 5.0):
            # Limits wide enough for every optimum, so that the certificate judges nothing else.
            problem = make_problem(speed, grip, current_A=8.0, command_A=20.0)
            answer = unlimited.solve(problem)
            proof = certify(problem, answer.command, answer.multipliers)
            assert answer.status is Status.OPTIMAL
            assert answer.message == "Riccati pass"
            assert proof.accepted
            assert proof.dual_residual < 1e-14
            assert proof.relative_gap < 1e-8


def device(
    problem: TransientProblem,
    masses_kg: tuple[float, ...] = (0.014, 0.026, 0.01),
    transmission_Hz: float = 390.0,
    damping_N_s_m: float = 0.0,
    held: bool = True,
) -> TransientProblem:
    """Another device in the same problem; its transmission alone rings at the stated frequency."""
    motor, stylus = masses_kg[:2]
    stiffness = motor * stylus / (motor + stylus) * (2 * np.pi * transmission_Hz) ** 2
    links = [Link(stiffness, damping_N_s_m)]
    if held:
        links += [Link(13000.0, damping_N_s_m), Link(710.0, damping_N_s_m)]
    plant = chain(masses_kg[: 3 if held else 2], links, force_per_current_N_A=1.25, stylus=1)
    return replace(problem, stage=discretise(plant, problem.stage.amplifier, problem.grid.dt_s))


def limited(problem: TransientProblem, plant_input: float) -> TransientProblem:
    range_A = 1.5 * plant_input if "command" in problem.limits else None
    return with_numbers(problem, current_A=plant_input, command_A=range_A)


def shortened(problem: TransientProblem, stages: int) -> TransientProblem:
    """The middle of the tap alone."""
    return replace(
        problem,
        grid=replace(problem.grid, stages=stages),
        target=Target(problem.reference_m_s2[5 : 5 + stages]),
        tracking_weights=np.ones(stages),
        hand_over_samples=min(10, stages - 1),
    )


EXTREMES = {
    "rho 1e-12": lambda p: replace(p, rho=1e-12),
    "rho 0": lambda p: replace(p, rho=0.0),
    "rho 1e6": lambda p: replace(p, rho=1e6),
    "limit 1e-6 A": lambda p: limited(p, 1e-6),
    "limit 100 A": lambda p: limited(p, 100.0),
    "1 g everywhere": lambda p: device(p, (1e-3, 1e-3, 1e-3)),
    "100 kg everywhere": lambda p: device(p, (100.0, 100.0, 100.0)),
    "1 mg moves 100 kg": lambda p: device(p, (1e-6, 100.0, 0.01)),
    "transmission of 20 kHz, undamped": lambda p: device(p, transmission_Hz=2e4),
    "transmission of 20 kHz, undamped, rho 0": lambda p: replace(device(p, transmission_Hz=2e4), rho=0.0),
    "transmission at the Nyquist frequency": lambda p: device(p, transmission_Hz=5000.0, damping_N_s_m=1.0),
    "free stylus": lambda p: device(p, damping_N_s_m=8.0, held=False),
    "free stylus, rho 0": lambda p: replace(device(p, damping_N_s_m=8.0, held=False), rho=0.0),
    "nothing weighted from stage 100 to 300": lambda p: replace(
        p, tracking_weights=np.repeat([1.0, 0.0, 1.0], (100, 200, 300))
    ),
    "2 stages": lambda p: shortened(p, 2),
    "12 stages": lambda p: shortened(p, 12),
    "13 stages": lambda p: shortened(p, 13),
    "30 stages": lambda p: shortened(p, 30),
    "nothing but hand-over": lambda p: replace(p, hand_over_samples=600),
}


@pytest.mark.parametrize("name", EXTREMES)
@pytest.mark.parametrize("ideal", [False, True])
def test_extreme_problems(make_problem: ProblemMaker, name: str, ideal: bool) -> None:
    problem = EXTREMES[name](make_problem(0.4, 5.0, ideal=ideal))
    answer = unlimited.solve(problem)
    proof = certify(problem, answer.command, answer.multipliers)
    assert answer.status is Status.OPTIMAL
    assert answer.message.startswith("Riccati pass")
    # Masses of 1 g leave little more than rounding, and more or less of it on every processor.
    by_command = gradient_rounding(problem, answer.command, answer.multipliers) / ROUNDED
    rounding = float(by_command @ (problem.command_bound + np.abs(answer.command)))
    assert proof.dual_residual < 1e-12 + by_command.max()
    assert proof.duality_gap <= proof.GAP_TOLERANCE * max(proof.objective, OBJECTIVE_SCALE) + rounding
    assert not answer.command[problem.free_stages :].any()


class TestWithoutTheCompiledPass:
    """The sparse KKT system alone: singular ones, and what its answer is judged by."""

    def test_where_any_command_is_optimal_none_is_the_answer(self, make_problem: ProblemMaker) -> None:
        """Without weights the sparse system is singular; rest is as good as any command, and proven."""
        problem = replace(make_problem(0.2, 3.0, stages=30), rho=0.0, tracking_weights=np.zeros(30))
        answer = unlimited.solve_sparse_kkt(problem)
        assert not answer.command.any()
        assert certify(problem, answer.command, answer.multipliers).accepted

    def test_a_tap_of_zero_is_answered_by_rest(self, make_problem: ProblemMaker) -> None:
        problem = make_problem(0.2, 3.0, stages=30)
        problem = replace(problem, rho=0.0, target=Target(np.zeros(30)))
        answer = unlimited.solve_sparse_kkt(problem)
        assert not answer.command.any()
        assert answer.status is Status.OPTIMAL

    def test_a_singular_system_is_damped(self) -> None:
        """Weights of zero leave movements open, and no factorisation exists without damping."""
        problem = drawn(424242, 1984).problem()
        answer = unlimited.solve_sparse_kkt(problem)
        assert answer.message == "sparse KKT system, damped"
        assert answer.status is Status.OPTIMAL
        free = problem.without(*problem.nonlinear)
        assert certify(free, answer.command, answer.multipliers).relative_gap < unlimited.GAP

    def test_a_spoilt_factorisation_is_refined_or_refused(
        self, make_problem: ProblemMaker, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Wrong factors, as rounding could leave them: the gradient of the certificate notices."""
        problem, exact = make_problem(0.2, 3.0), scipy.sparse.linalg.splu
        wanted = unlimited.solve(problem).command

        def spoil(factor: float) -> None:
            def spoilt(matrix: Any) -> SimpleNamespace:
                factors = exact(matrix)
                return SimpleNamespace(solve=lambda right: factor * factors.solve(right))

            monkeypatch.setattr(unlimited.scipy.sparse.linalg, "splu", spoilt)

        spoil(1 + 1e-5)
        answer = unlimited.solve_sparse_kkt(problem)
        np.testing.assert_allclose(answer.command, wanted, atol=1e-9)
        spoil(float("nan"))
        assert unlimited.solve_sparse_kkt(problem).status is Status.NUMERICAL_FAILURE


def test_without_the_extension_the_sparse_system_runs_apart_and_gives_the_same(
    make_problem: ProblemMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = make_problem(0.2, 3.0)
    monkeypatch.setattr(extension, "available", False)
    np.testing.assert_array_equal(unlimited.solve(problem).command, unlimited.solve_sparse_kkt(problem).command)


@pytest.mark.skipif(not extension.available, reason="the extension is not built")
class TestCompiledPass:
    """The pass of the extension against the sparse KKT system, and its cached gains."""

    @staticmethod
    def difference(problem: TransientProblem) -> float:
        own, other = unlimited.solve(problem), unlimited.solve_sparse_kkt(problem)
        assert own.message == "Riccati pass"
        np.testing.assert_allclose(
            own.multipliers.hand_over,
            other.multipliers.hand_over,
            rtol=0,
            atol=1e-8 * max(np.abs(other.multipliers.hand_over).max(), 1e-6),
        )
        return float(np.abs(own.command - other.command).max() / np.abs(other.command).max())

    @pytest.mark.parametrize("ideal", [False, True])
    @pytest.mark.parametrize("stages", [11, 600])
    def test_agrees_with_the_other(self, make_problem: ProblemMaker, ideal: bool, stages: int) -> None:
        assert self.difference(make_problem(0.4, 3.0, ideal=ideal, stages=stages)) < 1e-9

    def test_over_a_wall_whose_hand_over_moves(self, walled: WalledMaker) -> None:
        problem = walled(300, 0.3)
        problem = pressing(problem, reference_course(problem.grid, problem.target.continued_m_s2))
        assert problem.hand_over_command(Motion.zero(problem.grid.stages)).any()
        assert self.difference(problem) < 1e-9

    def test_with_several_devices_and_an_error_filter(self, make_problem: ProblemMaker) -> None:
        problem = make_problem(0.3, 3.0)
        problem = replace(
            problem,
            spread=(make_problem(0.3, 1.0).stage, make_problem(0.3, 5.0).stage),
            error_filter=error_filter("pacinian", problem.grid.dt_s),
        )
        assert self.difference(problem) < 1e-9

    def test_in_shared_memory_no_pass_takes_anothers_gains(self, make_problem: ProblemMaker) -> None:
        """Nor what an interior point leaves there."""
        light, firm = (without_limits(make_problem(0.2, grip)) for grip in (1.0, 5.0))
        alone = extension.LinearPass(light)
        assert alone.solve(unlimited.GAP).code == extension.SOLVED
        shared = extension.Buffers(light.sizes)
        first, second = (extension.LinearPass(stages, shared) for stages in (light, firm))
        for other in (second, None, second):
            assert first.solve(unlimited.GAP).code == extension.SOLVED
            np.testing.assert_array_equal(first.command(), alone.command())
            if other is None:
                extension.interior_point(firm, shared, tolerance=1e-9, max_iterations=5)
            else:
                assert other.solve(unlimited.GAP).code == extension.SOLVED
                assert np.abs(other.command() - alone.command()).max() > 0.1

    def test_without_any_weight_it_breaks_down_and_keeps_no_gains(self, make_problem: ProblemMaker) -> None:
        problem = make_problem(0.2, 3.0, stages=30)
        run = extension.LinearPass(without_limits(replace(problem, rho=0.0, tracking_weights=np.zeros(30))))
        assert all(run.solve(unlimited.GAP).code not in (extension.SOLVED, extension.ACCURACY) for _ in range(2))


@pytest.mark.skipif(not extension.available, reason="the extension is not built")
def test_a_gap_that_is_only_rounding_asks_no_other_method(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first bound may be above what the pass may leave; that by the movement's curvature is far below."""
    problem = drawn(2, 727).problem()

    def asked(_: TransientProblem) -> Solution:
        raise AssertionError("another method was asked")

    monkeypatch.setattr(unlimited, "solve_apart", asked)
    found = unlimited.solve(problem)
    assert certify(problem, found.command, found.multipliers).is_stationary
