"""Problems of several motors: the compiled method against an independent program, other methods and itself."""

from dataclasses import replace

import numpy as np
import pytest

from tests.benches.arms import drawn, drawn_chain, phantom, posed, pulse
from tests.benches.dense_motors import Dense
from tests.benches.limits import aiming_in_window
from transopt.base.errors import InputError
from transopt.plant.chain import Link
from transopt.plant.coil import Circuit
from transopt.plant.drive import drive
from transopt.plant.hand import HandSection
from transopt.plant.state_space import StateSpace
from transopt.plant.wall import HandOver, Wall
from transopt.problem.answer import OBJECTIVE_SCALE, Status
from transopt.problem.limits import limits_of
from transopt.problem.limits.command import CommandLimit
from transopt.problem.limits.current import CurrentLimit
from transopt.problem.limits.slew import SlewLimit
from transopt.problem.limits.supply import CopperEnd, SupplyLimit
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import layout, linear_stage
from transopt.proof.certify import binding_limits, certify, reduced_gradient
from transopt.proof.effect import Effect
from transopt.proof.farkas import is_infeasible
from transopt.solvers import modes, riccati, unlimited
from transopt.solvers.choose import solve, solve_all, solve_certified
from transopt.solvers.native import extension
from transopt.solvers.options import SolverOptions

pytestmark = pytest.mark.skipif(not extension.available, reason="the extension is not built")
OPTIONS = SolverOptions("riccati")


def within(one: float, other: float, tolerance: float) -> bool:
    """Whether two objectives agree, relative to max(J, 1e-3)."""
    return abs(one - other) <= tolerance * max(other, OBJECTIVE_SCALE)


@pytest.mark.parametrize("seed", [*range(8), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(8, 40))])
def test_the_optimum_is_that_of_an_independent_dense_program(seed: int) -> None:
    problem = drawn(seed)
    answer = solve(problem, OPTIONS)
    proof = certify(problem, answer.command, answer.multipliers)
    independent = Dense.of(problem)
    _, optimum = independent.optimum(problem)
    assert answer.status is Status.OPTIMAL
    assert proof.accepted
    assert within(independent.value(answer.command[:, : problem.free_stages]), proof.objective, 1e-10)
    assert within(proof.objective, optimum, 1e-8)


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_modes_and_dense_matrices_give_one_answer(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    by_modes = solve(drawn(seed), OPTIONS)
    monkeypatch.setattr(modes, "MOST_CONDITION", 0.0)
    problem = drawn(seed)
    dense = solve(problem, OPTIONS)
    assert np.array_equal(modes.modes_of(problem, linear_stage(problem)).T, np.eye(layout(problem).states))
    values = [certify(problem, each.command, each.multipliers).objective for each in (by_modes, dense)]
    assert within(*values, 1e-8)


def test_problems_side_by_side_have_the_answers_that_they_have_alone() -> None:
    problem = posed(phantom().plant(2.0))
    several = [aiming_in_window(problem, problem.reference_m_s2 * by) for by in np.linspace(0.6, 1.4, 9)]
    together = solve_all(several, OPTIONS)
    # Two of them beside each other, whatever the others are, have the same bits.
    again = solve_all(several[:8], OPTIONS)
    for one, other in zip(together[:8], again, strict=True):
        np.testing.assert_array_equal(one.command, other.command)
    for each, answer in zip(several, together, strict=True):
        proof, alone = certify(each, answer.command, answer.multipliers), solve(each, OPTIONS)
        assert proof.accepted
        assert within(proof.objective, certify(each, alone.command, alone.multipliers).objective, 1e-8)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_piqp_finds_the_same_optimum_by_the_casadi_statement(seed: int) -> None:
    problem = drawn(seed)
    own, other = solve(problem, OPTIONS), solve(problem, SolverOptions("casadi-piqp"))
    proofs = [certify(problem, each.command, each.multipliers) for each in (own, other)]
    assert all(proof.accepted for proof in proofs)
    assert within(proofs[0].objective, proofs[1].objective, 1e-8)


def test_states_in_modes_are_the_same_device() -> None:
    problem = posed(phantom().plant(2.0))
    stage = linear_stage(problem)
    found = modes.modes_of(problem, stage)
    A, T = found.A, found.T
    assert not np.array_equal(T, np.eye(T.shape[0]))
    np.testing.assert_allclose(T @ A, stage.A @ T, atol=1e-10 * np.abs(stage.A).max())


class TestDecoupled:
    """An arm whose axes do not couple gives three designs of one motor."""

    @staticmethod
    def axes() -> list[StateSpace]:
        def of(scale: float) -> StateSpace:
            values = {
                "mass_kg": 0.010,
                "skin_stiffness_N_m": 5000.0 * scale,
                "skin_damping_N_s_m": 9.0,
                "arm_stiffness_N_m": 400.0,
                "arm_damping_N_s_m": 12.0 / scale,
            }
            hand = HandSection(**values)
            return drive(
                3.0,
                hand=hand,
                stylus_mass_kg=0.026 * scale,
                moving_mass_kg=0.014,
                transmission=Link(6e4, 8.0),
                force_per_current_N_A=1.25,
            )

        return [of(scale) for scale in (0.7, 1.0, 1.6)]

    def problems(self) -> tuple[TransientProblem, list[TransientProblem]]:
        axes, size = self.axes(), 6
        joint = StateSpace(
            *(
                np.block(
                    [
                        [
                            getattr(axes[i], name) if i == j else np.zeros_like(axes[i].__dict__[name])
                            for j in range(3)
                        ]
                        for i in range(3)
                    ]
                )
                for name in ("A", "B", "C", "D")
            )
        )
        assert joint.order == 3 * size
        whole = posed(joint)
        times = np.append(whole.grid.switching_times_s, whole.grid.after_times_s)
        targets = np.array([pulse(times, peak) for peak in (60.0, 40.0, -80.0)])
        alone = [posed(axis, targets=target[None], limit_A=1.5) for axis, target in zip(axes, targets, strict=True)]
        # J of the joint problem is the mean of the three: each direction's weight is over its own energy.
        weights = tuple(1 / each.tracking.energy_m2_s4 for each in alone)
        rho = alone[0].rho / 3
        return posed(joint, targets=targets, limit_A=1.5, weights=weights, rho=rho), alone

    def test_has_the_designs_of_its_axes(self) -> None:
        joint, alone = self.problems()
        answer = solve(joint, OPTIONS)
        single = [solve(each, OPTIONS) for each in alone]
        proofs = [certify(p, s.command, s.multipliers) for p, s in zip(alone, single, strict=True)]
        found = certify(joint, answer.command, answer.multipliers)
        assert max(np.abs(each.command).max() for each in single) > 1.0
        assert within(found.objective, float(np.mean([proof.objective for proof in proofs])), 1e-9)
        for own, each in zip(answer.command, single, strict=True):
            np.testing.assert_allclose(own, each.command, atol=1e-5)


class TestCertificate:
    def test_gradient_is_the_derivative_of_the_lagrangian(self) -> None:
        problem = drawn(3)
        lot = np.random.default_rng(1)
        command, way = lot.standard_normal((2, *problem.rest.shape))
        found = reduced_gradient(Effect(problem, command), solve(problem, OPTIONS).multipliers)
        zero = reduced_gradient(Effect(problem, 0 * command), solve(problem, OPTIONS).multipliers)

        def value(of: np.ndarray) -> float:
            return problem.objective(of, problem.accelerations(of))

        # J is quadratic and the limits are linear: central differences have no error but rounding.
        slope = (value(command + way) - value(command - way)) / 2
        at_rest = (value(way) - value(-way)) / 2
        assert np.vdot(found - zero, way) == pytest.approx(slope - at_rest, rel=1e-9)

    @pytest.mark.parametrize("what", ["command", "multiplier", "sign", "nan"])
    def test_rejects_what_is_no_optimum(self, what: str) -> None:
        problem = drawn(6)
        answer = solve(problem, OPTIONS)
        command, multipliers = answer.command.copy(), answer.multipliers
        name = max(multipliers.pairs, key=lambda row: max(side.max() for side in multipliers.pairs[row]))
        lower, upper = multipliers.pairs[name]
        if what == "command":
            command[1, 20] -= 1e-2 * np.sign(command[1, 20])
        elif what == "nan":
            command[0, 5] = np.nan
        elif what == "multiplier":
            multipliers = multipliers.with_pair(name, 0.9 * lower, 0.9 * upper)
        else:
            multipliers = multipliers.with_pair(name, upper, lower)
        assert certify(problem, answer.command, answer.multipliers).accepted
        assert not certify(problem, command, multipliers).accepted

    def test_names_the_motor_that_is_at_its_limit(self) -> None:
        problem = posed(drawn_chain(np.random.default_rng(0), 3), limit_A=0.5, shares=(1.0, 1.0, 0.4))
        answer = solve(problem, OPTIONS)
        said = binding_limits(problem, answer.command, answer.multipliers)
        assert "of motor 1" in said
        assert "of motor 3, which has 0.4 of it" in said


def slow(problem: TransientProblem) -> TransientProblem:
    """The problem with a limit on how fast every command may move."""
    slew = SlewLimit(20.0, problem.grid.dt_s)
    return replace(problem, limits=limits_of(CurrentLimit(2.5), CommandLimit(6.0), slew))


def test_slew_of_every_motor_is_kept() -> None:
    problem = slow(posed(drawn_chain(np.random.default_rng(2), 3)))
    answer = solve(problem, OPTIONS)
    assert certify(problem, answer.command, answer.multipliers).accepted
    steps = np.abs(np.diff(answer.command, prepend=0.0, axis=1)).max(axis=1)
    np.testing.assert_allclose(steps, 20.0 * problem.grid.dt_s, rtol=1e-6)


def test_claims_infeasibility_only_with_a_proof() -> None:
    problem = posed(drawn_chain(np.random.default_rng(2), 2))

    class Pushed(CurrentLimit):
        """A current that has to be above its limit in the middle."""

        def rows(self, problem):  # type: ignore[no-untyped-def]
            rows = super().rows(problem)
            lower = np.full(problem.grid.stages, -self.limit)
            lower[40] = 3.0 * self.limit
            return (replace(rows[0], lower=lower, upper=np.maximum(lower, self.limit)), *rows[1:])

    impossible = replace(problem, limits=limits_of(Pushed(2.5), CommandLimit(2.6)))
    answer = solve(impossible, OPTIONS)
    assert answer.status is Status.INFEASIBLE
    assert is_infeasible(impossible, answer.command, answer.multipliers)
    assert not is_infeasible(problem, answer.command, answer.multipliers)


def test_unlimited_optimum_is_the_limited_one_where_no_limit_binds() -> None:
    problem = posed(drawn_chain(np.random.default_rng(4), 3), limit_A=500.0)
    problem = replace(problem, limits=limits_of(CurrentLimit(500.0), CommandLimit(500.0)))
    free = unlimited.solve([problem])[0]
    assert free.message == "Riccati pass"
    assert certify(problem, free.command, free.multipliers).accepted


def test_unlimited_optimum_without_the_extension(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = posed(drawn_chain(np.random.default_rng(4), 3), limit_A=500.0)
    problem = replace(problem, limits=limits_of(CurrentLimit(500.0), CommandLimit(500.0)))
    own = unlimited.solve([problem])[0]
    monkeypatch.setattr(extension, "available", False)
    free = unlimited.solve([problem])[0]
    assert free.message == "sparse KKT system"
    assert certify(problem, free.command, free.multipliers).accepted
    np.testing.assert_allclose(free.command, own.command, atol=1e-6)


def test_falls_back_to_piqp_where_the_method_takes_it_not(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = drawn(5)
    monkeypatch.setattr(riccati, "takes", lambda *_: False)
    found = solve_certified([problem], OPTIONS)[0]
    assert found.solution.solver == "casadi-piqp"
    assert found.proof.accepted


def test_one_motor_with_several_directions() -> None:
    problem = posed(drawn_chain(np.random.default_rng(8), 1), limit_A=0.7)
    found = solve_certified([problem], OPTIONS)[0]
    assert found.proof.accepted
    _, optimum = Dense.of(problem).optimum(problem)
    assert within(found.proof.objective, optimum, 1e-8)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"intensity": 0.5}, "weights.objective: a plant with 3 motors and 3 directions cannot have it yet"),
        ({"shares": None}, "shares: a plant with 3 motors and 3 directions needs 3 weights >= 0, the first above 0"),
        ({"shares": np.array([0.0, 1.0, 1.0])}, "shares: a plant with 3 motors"),
        ({"shares": np.array([1.0, np.nan, 1.0])}, "shares: a plant with 3 motors"),
    ],
)
def test_refuses_what_several_motors_cannot_have(changed: dict[str, object], said: str) -> None:
    problem = posed(drawn_chain(np.random.default_rng(8), 3))
    with pytest.raises(InputError, match=said):
        replace(problem, **changed)  # type: ignore[arg-type]


def test_refuses_limits_spread_and_wall() -> None:
    problem = posed(drawn_chain(np.random.default_rng(8), 3))
    N = problem.grid.stages
    rail = SupplyLimit(12.0, (CopperEnd("supply", Circuit(2.0, 2e-4, 1.25), None),), 6600.0, np.zeros(N))
    with pytest.raises(InputError, match=r"limits\.supply_V: a plant with 3 motors"):
        replace(problem, limits=limits_of(CurrentLimit(2.5), CommandLimit(6.0), rail))
    with pytest.raises(InputError, match="robust: a plant with 3 motors"):
        replace(problem, spread=(problem.stage,))
    wall = Wall(200.0, 0.2, force_per_current_N_A=1.25, latency_ticks=1, derivative_filter_Hz=500.0)
    over = HandOver(wall, np.zeros(N + 60), 0.1, np.zeros(N + 60, dtype=bool))
    with pytest.raises(InputError, match="feedback: a plant with 3 motors"):
        replace(problem, wall=over)


@pytest.mark.parametrize("share", [0.0, -1.0, 1.5, np.nan])
def test_refuses_a_share_of_the_limit_that_is_none(share: float) -> None:
    with pytest.raises(InputError, match="for motor 2: must be > 0 and at most 1"):
        CurrentLimit(2.5, shares=(1.0, share, 1.0))
