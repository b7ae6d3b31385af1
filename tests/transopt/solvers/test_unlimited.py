"""The unlimited optimum: the Riccati pass against least squares, the sparse system, solvers, on extreme devices."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from problems.stress.cases import StressCase
from problems.stress.draw import drawn
from tests.benches.endings import waits
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
from transopt.solvers import sparse_kkt, unlimited
from transopt.solvers.choose import solve
from transopt.solvers.native import extension
from transopt.solvers.options import SolverOptions
from transopt.solvers.stage_data import Stages, without_limits


def random_stages(stages: int, ny: int, rule_stages: int) -> Stages:
    """Stage data of no device: several outputs, feed-through, weights that change, an affine rule at the end."""
    random = np.random.default_rng(stages + 10 * ny)
    n, free = 4, stages - rule_stages
    A = random.standard_normal((n, n))
    arrays = {
        "A": A / np.abs(np.linalg.eigvals(A)).max(),
        "C": random.standard_normal((ny, n)),
        "E": random.standard_normal(ny),
        "weight": random.uniform(0, 2, (stages, ny)),
        "reference": random.standard_normal((stages, ny)),
        "rule_gain": 0.5 * random.standard_normal((rule_stages, n)),
        "rule_offset": random.standard_normal(rule_stages),
        "end_gain": random.standard_normal((3, n)),
        "end_target": random.standard_normal(3),
    }
    given = without_limits(StressCase("any").problem())
    sizes = {"stages": stages, "free_stages": free, "states": n, "outputs": ny, "ends": 3}
    return replace(
        given,
        sizes=given.sizes | sizes,
        numbers=given.numbers | {"movement_weight": 0.7},
        arrays=given.arrays | arrays,
    )


def residuals(given: Stages, free: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N,) commands, and what half the sum of the squares of which is the objective, stage by stage as it reads."""
    d, N = given.arrays, given.sizes["stages"]
    z, movement, error = np.zeros(4), np.empty(N), np.empty_like(d["reference"])
    for k in range(N):
        j = k - given.sizes["free_stages"]
        movement[k] = free[k] if j < 0 else d["rule_gain"][j] @ z + d["rule_offset"][j]
        error[k] = d["C"] @ z + d["E"] * movement[k] - d["reference"][k]
        z = d["A"] @ z + d["A"][:, -1] * movement[k]
    weighted = (np.sqrt(d["weight"]) * error).ravel()
    moved = np.sqrt(given.numbers["movement_weight"]) * movement
    return np.cumsum(movement), np.concatenate([weighted, moved, d["end_gain"] @ z - d["end_target"]])


SIZES = [(stages, ny, rule) for ny in (1, 2, 3) for stages, rule in ((2, 1), (5, 0), (9, 3), (24, 4), (25, 25))]


@pytest.mark.skipif(not extension.available, reason="the extension is not built")
@pytest.mark.parametrize(("stages", "ny", "rule_stages"), SIZES)
def test_pass_is_the_dense_least_squares_solution(stages: int, ny: int, rule_stages: int) -> None:
    given = random_stages(stages, ny, rule_stages)
    free = given.sizes["free_stages"]
    _, at_zero = residuals(given, np.zeros(free))
    jacobian = np.array([residuals(given, step)[1] - at_zero for step in np.eye(free)]).reshape(free, at_zero.size).T
    wanted, left = residuals(given, np.linalg.lstsq(jacobian, -at_zero)[0])
    (found,) = extension.linear_passes([given], unlimited.GAP)
    assert found.code == extension.SOLVED
    np.testing.assert_allclose(found.command, wanted, atol=1e-10)
    assert found.objective == pytest.approx(0.5 * left @ left + given.numbers["constant"], rel=1e-10)


@pytest.mark.parametrize("ideal", [False, True])
def test_agrees_with_solvers_whose_limits_are_far_away(make_problem: ProblemMaker, ideal: bool) -> None:
    problem = make_problem(0.3, 3.0, ideal=ideal, stages=60, current_A=40.0, **({} if ideal else {"command_A": 60.0}))
    free = unlimited.solve([problem])[0]
    for solver in ("casadi-piqp", "casadi-ipopt"):
        np.testing.assert_allclose(free.command, solve(problem, SolverOptions(solver)).command, atol=1e-6)
    np.testing.assert_allclose(free.command, unlimited.solve_sparse(problem).command, atol=1e-9)


def test_every_entry_of_the_default_scene_is_proven_by_the_pass(make_problem: ProblemMaker) -> None:
    for speed in (0.1, 0.2, 0.3, 0.4):
        for grip in (1.0, 3.0, 5.0):
            # Limits wide enough for every optimum, so that the certificate judges nothing else.
            problem = make_problem(speed, grip, current_A=8.0, command_A=20.0)
            answer = unlimited.solve([problem])[0]
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
    answer = unlimited.solve([problem])[0]
    proof = certify(problem, answer.command, answer.multipliers)
    assert answer.status is Status.OPTIMAL
    assert answer.message.startswith("Riccati pass")
    # Masses of 1 g leave little more than rounding, and more or less of it on every processor.
    by_command = gradient_rounding(problem, answer.command, answer.multipliers) / ROUNDED
    rounding = float(by_command @ (problem.command_bound + np.abs(answer.command)))
    assert proof.dual_residual < 1e-12 + by_command.max()
    assert proof.duality_gap <= proof.GAP_TOLERANCE * max(proof.objective, OBJECTIVE_SCALE) + rounding
    assert not answer.command[problem.free_stages :].any()


class TestSparseSystem:
    """The sparse KKT system is solved in a process of its own where the pass falls short, or is not there."""

    @pytest.mark.parametrize("change", [{"gap": 1e6}, {"gap": float("nan")}, {"code": 4}])
    def test_is_asked_where_the_pass_leaves_a_gap(
        self, make_problem: ProblemMaker, monkeypatch: pytest.MonkeyPatch, change: dict[str, Any]
    ) -> None:
        problem = make_problem(0.2, 3.0)
        wanted, passes = unlimited.solve([problem])[0], extension.linear_passes

        def spoilt(given: Sequence[Stages], tolerance: float) -> list[extension.Answer]:
            return [answer._replace(command=answer.command * 1.01, **change) for answer in passes(given, tolerance)]

        monkeypatch.setattr(extension, "linear_passes", spoilt)
        (trial,) = unlimited.solve([problem], brief=True)
        assert trial.status is Status.NUMERICAL_FAILURE
        assert not trial.command.any()
        (answer,) = unlimited.solve([problem])
        assert answer.message == "sparse KKT system"
        assert answer.status is Status.OPTIMAL
        proof = certify(problem, answer.command, answer.multipliers)
        assert proof.accepted
        assert proof.dual_residual < 1e-12
        np.testing.assert_allclose(answer.command, wanted.command, atol=1e-9)

    def test_is_asked_where_there_is_no_pass(
        self, make_problem: ProblemMaker, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        problem = make_problem(0.2, 3.0)
        (wanted,) = unlimited.solve([problem])
        monkeypatch.setattr(extension, "available", False)
        for brief in (False, True):
            (answer,) = unlimited.solve([problem], brief=brief)
            assert answer.message == "sparse KKT system"
        np.testing.assert_allclose(answer.command, wanted.command, atol=1e-9)
        assert certify(problem, answer.command, answer.multipliers).accepted

    def test_where_any_command_is_optimal_none_is_the_answer(self, make_problem: ProblemMaker) -> None:
        """Without weights pass and sparse system would break down; rest is as good as any command, and proven."""
        problem = replace(make_problem(0.2, 3.0, stages=30), rho=0.0, terms=(ErrorTerm("plain", np.zeros(30)),))
        answer = unlimited.solve_sparse(problem)
        assert not answer.command.any()
        assert certify(problem, answer.command, answer.multipliers).accepted

    def test_what_overflows_on_an_unstable_wall_is_no_warning(self) -> None:
        problem = drawn(20261126, 773).problem()  # the defective plant and its wall grow within the tail
        answer = unlimited.solve_sparse(problem)
        assert not certify(problem, answer.command, answer.multipliers).accepted

    def test_that_is_singular_is_a_failure(self, make_problem: ProblemMaker, monkeypatch: pytest.MonkeyPatch) -> None:
        def singular(_: object) -> None:
            raise RuntimeError("Factor is exactly singular")

        monkeypatch.setattr(sparse_kkt.scipy.sparse.linalg, "splu", singular)
        answer = unlimited.solve_sparse(make_problem(0.2, 3.0))
        assert answer.status is Status.NUMERICAL_FAILURE
        assert np.isnan(answer.command).any()


@pytest.mark.skipif(not extension.available, reason="the extension is not built")
class TestCompiledPass:
    """The pass of the extension against the sparse system."""

    @staticmethod
    def difference(problem: TransientProblem) -> float:
        own, other = unlimited.solve([problem])[0], unlimited.solve_sparse(problem)
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

    def test_without_any_weight_it_breaks_down(self, make_problem: ProblemMaker) -> None:
        problem = make_problem(0.2, 3.0, stages=30)
        nothing = without_limits(replace(problem, rho=0.0, terms=(ErrorTerm("plain", np.zeros(30)),)))
        fine = without_limits(problem)
        answers = extension.linear_passes([nothing, fine, nothing, fine], unlimited.GAP)
        assert [answer.code <= extension.ACCURACY for answer in answers] == [False, True, False, True]


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
    found = unlimited.solve([problem])[0]
    assert certify(problem, found.command, found.multipliers).is_stationary


def test_a_sparse_system_without_an_end_is_given_up(
    make_problem: ProblemMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unlimited, "solve_sparse", waits)
    monkeypatch.setattr(unlimited, "MOST_S", 1e-3)
    monkeypatch.setattr(unlimited, "MOST_PER_STAGE_S", 0.0)
    monkeypatch.setattr(extension, "available", False)
    answer = unlimited.solve([make_problem(0.4, 5.0)])[0]
    assert answer.status is Status.NUMERICAL_FAILURE
    assert answer.message == "no answer within 0.01 s"
