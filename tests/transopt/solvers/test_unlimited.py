"""The unlimited optimum: the Riccati pass against dense least squares, against solvers, on extreme devices."""

from dataclasses import replace

import numpy as np
import pytest

from problems.stress.draw import drawn
from tests.benches.limits import with_numbers
from tests.conftest import ProblemMaker, WalledMaker
from transopt.base.signals import FloatArray
from transopt.design.optimum import ROUNDED
from transopt.plant.chain import Link, chain
from transopt.plant.discretise import Motion, discretise
from transopt.plant.wall import reference_course
from transopt.problem.answer import OBJECTIVE_SCALE, Solution, Status
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.target import Target
from transopt.problem.objective.weighting import pacinian
from transopt.problem.problem import TransientProblem
from transopt.problem.wall_ticks import pressing
from transopt.proof.certify import certify, gradient_rounding
from transopt.solvers import lq_pass, unlimited
from transopt.solvers.choose import solve
from transopt.solvers.lq_pass import Gains, Pass, Tracking
from transopt.solvers.native import extension
from transopt.solvers.options import SolverOptions
from transopt.solvers.stage_data import without_limits


def random_tracking(stages: int, ny: int, rule_stages: int) -> Tracking:
    random = np.random.default_rng(stages + 10 * ny)
    n = 4
    A = random.standard_normal((n, n))
    return Tracking(
        A=A / np.abs(np.linalg.eigvals(A)).max(),
        B=random.standard_normal(n),
        C=random.standard_normal((ny, n)),
        D=random.standard_normal(ny),
        reference=random.standard_normal((stages, ny)),
        weights=random.uniform(0, 2, (stages, ny)),
        movement_weights=random.uniform(0.1, 2, stages),
        rule_gains=0.5 * random.standard_normal((rule_stages, n)),
        rule_offsets=random.standard_normal(rule_stages),
        end_gain=random.standard_normal((3, n)),
        end_target=random.standard_normal(3),
    )


def rolled_out(data: Tracking, free: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Movement (N,), error (N, ny) and error at the end (m,), stage by stage as the statement reads."""
    z = np.zeros(data.B.size)
    movement, error = np.empty(data.movement_weights.size), np.empty_like(data.reference)
    for k in range(movement.size):
        j = k - data.free_stages
        movement[k] = free[k] if j < 0 else data.rule_gains[j] @ z + data.rule_offsets[j]
        error[k] = data.C @ z + data.D * movement[k] - data.reference[k]
        z = data.A @ z + data.B * movement[k]
    return movement, error, data.end_gain @ z - data.end_target


def residuals(data: Tracking, free: FloatArray) -> FloatArray:
    """The objective is the sum of their squares; affine in the free movement."""
    movement, error, end_error = rolled_out(data, free)
    weighted = (np.sqrt(data.weights) * error).ravel()
    return np.concatenate([weighted, np.sqrt(data.movement_weights) * movement, end_error])


SIZES = [(stages, ny, rule) for ny in (1, 2, 3) for stages, rule in ((2, 1), (5, 0), (9, 3), (24, 4), (25, 25))]


@pytest.mark.parametrize(("stages", "ny", "rule_stages"), SIZES)
def test_pass_is_the_dense_least_squares_solution(stages: int, ny: int, rule_stages: int) -> None:
    """Several outputs, feed-through, weights that change, an affine rule at the end."""
    data = random_tracking(stages, ny, rule_stages)
    free = data.free_stages
    at_zero = residuals(data, np.zeros(free))
    jacobian = np.array([residuals(data, step) - at_zero for step in np.eye(free)]).reshape(free, at_zero.size).T
    best = np.linalg.lstsq(jacobian, -at_zero)[0]

    run = Pass(data)
    found = run.improved(run.at_rest(), run.factored())
    movement, error, end_error = rolled_out(data, best)
    np.testing.assert_allclose(found.movement, movement, atol=1e-11)
    np.testing.assert_allclose(found.error, error, atol=1e-11)
    np.testing.assert_allclose(found.end_error, end_error, atol=1e-11)
    assert np.abs(run.gradient(found)).max(initial=0.0) < 1e-11


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
        terms=(ErrorTerm("plain", np.ones(stages)),),
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
        p, terms=(ErrorTerm("plain", np.repeat([1.0, 0.0, 1.0], (100, 200, 300))),)
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


class TestWhenThePassFallsShort:
    """Gains that are wrong, as rounding could leave them: the gradient notices."""

    @staticmethod
    def spoil(monkeypatch: pytest.MonkeyPatch, factor: float) -> None:
        exact = lq_pass.Pass.factored

        def spoilt(run: Pass) -> Gains:
            gains = exact(run)
            return Gains(gains.feedback, factor * gains.inverse_factor)

        monkeypatch.setattr(lq_pass.Pass, "factored", spoilt)

    def test_a_small_error_is_refined_away(self, make_problem: ProblemMaker, monkeypatch: pytest.MonkeyPatch) -> None:
        problem = make_problem(0.2, 3.0)
        wanted = unlimited.solve(problem).command
        self.spoil(monkeypatch, 1 + 1e-5)
        answer = unlimited.solve_in_casadi(problem)
        assert answer.message == "Riccati pass, refined"
        assert certify(problem, answer.command, answer.multipliers).dual_residual < 1e-14
        np.testing.assert_allclose(answer.command, wanted, atol=1e-10)

    @pytest.mark.parametrize("factor", [2.0, float("nan")])
    def test_a_large_one_is_left_to_the_sparse_system(
        self, make_problem: ProblemMaker, monkeypatch: pytest.MonkeyPatch, factor: float
    ) -> None:
        problem = make_problem(0.2, 3.0)
        self.spoil(monkeypatch, factor)
        answer = unlimited.solve_in_casadi(problem)
        assert answer.message == "sparse KKT system"
        assert answer.status is Status.OPTIMAL
        proof = certify(problem, answer.command, answer.multipliers)
        assert proof.accepted
        assert proof.dual_residual < 1e-14

    def test_where_any_command_is_optimal_none_is_the_answer(self, make_problem: ProblemMaker) -> None:
        """Without weights pass and sparse system would break down; rest is as good as any command, and proven."""
        problem = replace(make_problem(0.2, 3.0, stages=30), rho=0.0, terms=(ErrorTerm("plain", np.zeros(30)),))
        answer = unlimited.solve_in_casadi(problem)
        assert not answer.command.any()
        assert certify(problem, answer.command, answer.multipliers).accepted


def test_the_other_passes_run_apart_and_give_the_same(
    make_problem: ProblemMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = make_problem(0.2, 3.0)
    monkeypatch.setattr(extension, "available", False)
    np.testing.assert_array_equal(unlimited.solve(problem).command, unlimited.solve_in_casadi(problem).command)


@pytest.mark.skipif(not extension.available, reason="the extension is not built")
class TestCompiledPass:
    """The pass of the extension against the one in CasADi's virtual machine, and its cached gains."""

    @staticmethod
    def difference(problem: TransientProblem) -> float:
        own, other = unlimited.solve(problem), unlimited.solve_in_casadi(problem)
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
            terms=(replace(problem.terms[0], error_filter=pacinian(problem.grid.dt_s)),),
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
        run = extension.LinearPass(
            without_limits(replace(problem, rho=0.0, terms=(ErrorTerm("plain", np.zeros(30)),)))
        )
        assert all(run.solve(unlimited.GAP).code not in (extension.SOLVED, extension.ACCURACY) for _ in range(2))


@pytest.mark.skipif(not extension.available, reason="the extension is not built")
def test_a_gap_that_is_only_rounding_asks_no_other_method(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first bound may be above what the pass may leave; that by the movement's curvature is far below."""
    case = drawn(2, 727)
    weights = "one" if case.demand.weights == "intention" else case.demand.weights
    demand = replace(case.demand, weights=weights, rapid="none", heat_price=0.0)
    problem = replace(case, demand=demand).problem()

    def asked(_: TransientProblem) -> Solution:
        raise AssertionError("another method was asked")

    monkeypatch.setattr(unlimited, "solve_apart", asked)
    found = unlimited.solve(problem)
    assert certify(problem, found.command, found.multipliers).is_stationary
