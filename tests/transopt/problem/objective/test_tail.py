"""What is lost before the window, what comes after it, the price on intensity: against other ways to find them."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest

from tests.benches import dense
from tests.conftest import ProblemMaker, WalledMaker
from transopt.base.signals import FloatArray
from transopt.plant.chain import Link, chain
from transopt.plant.discretise import StageModel, discretise
from transopt.plant.time_grid import TimeGrid
from transopt.plant.wall import FeedbackLoop
from transopt.problem.answer import OBJECTIVE_SCALE, Multipliers, Status
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.figures import Yardstick
from transopt.problem.objective.tail import tail
from transopt.problem.objective.target import Target
from transopt.problem.objective.weighting import highpass, pacinian
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import linear_stage
from transopt.problem.wall_ticks import pressing_under
from transopt.proof.certify import certify, reduced_gradient
from transopt.proof.effect import Effect
from transopt.solvers import unlimited
from transopt.solvers.choose import solve
from transopt.solvers.options import SolverOptions

AFTER = 80


def another(stage: StageModel) -> StageModel:
    """A further device, heavier, softer and less damped."""
    plant = chain(
        (0.016, 0.03, 0.012),
        [Link(5e4, 6.0), Link(7000.0, 9.0), Link(400.0, 12.0)],
        force_per_current_N_A=1.25,
        stylus=1,
    )
    return discretise(plant, stage.amplifier, stage.dt_s)


def lasting(problem: TransientProblem, after: int = AFTER, lost: int = 3) -> TransientProblem:
    """The problem of a tap that began before the window and rings on after it."""
    last = float(problem.reference_m_s2[-1]) or 5.0
    ringing = last * np.exp(-np.arange(after) / 40) * np.cos(np.arange(after) / 9)
    target = Target(problem.reference_m_s2, ringing, 30.0 * np.arange(lost))
    wall = problem.wall
    if wall is not None:
        step = wall.nominal_m[-1] - wall.nominal_m[-2]
        nominal = np.append(wall.nominal_m, wall.nominal_m[-1] + step * np.arange(1, after + 1))
        wall = replace(wall, nominal_m=nominal, pressing=nominal < 0)
    return replace(problem, grid=replace(problem.grid, after_stages=after), target=target, wall=wall)


@pytest.fixture(scope="module")
def plain(make_problem: ProblemMaker) -> TransientProblem:
    """A saturated entry, cut while the device still moves."""
    return lasting(make_problem(0.4, 5.0, stages=150, current_A=2.5))


WINDOW = np.ones(150)
RISING = np.linspace(0.5, 2.0, 150)
VARIED = {
    "plain": {},
    "filtered": {"terms": (ErrorTerm("rapid", WINDOW, error_filter=pacinian(1e-4)),)},
    "weighted": {"terms": (ErrorTerm("plain", RISING),)},
    "priced": {"intensity": 0.4, "intensity_dB": -0.5},
    "two terms": {
        "terms": (
            ErrorTerm("plain", np.where(np.arange(150) < 90, 0.09, 0.0), before=0.09, after=0.0),
            ErrorTerm("rapid", WINDOW, error_filter=highpass(20.0, 1e-4)),
        )
    },
    "heat": {"heat_price": 3e-4},
}


def varied(problem: TransientProblem, kind: str) -> TransientProblem:
    if kind == "spread":
        return replace(problem, spread=(another(problem.stage),))
    if kind == "all":
        both = replace(problem, spread=(another(problem.stage),), **VARIED["two terms"])
        return replace(both, **VARIED["priced"], **VARIED["heat"])
    return replace(problem, **VARIED[kind])


KINDS = [*VARIED, "spread", "all"]
SOLVERS = ["riccati", "casadi-piqp", "casadi-ipopt"]


@pytest.mark.parametrize(
    ("kind", "solver"),
    [(kind, solver) for kind in KINDS for solver in (SOLVERS if kind in ("weighted", "all") else SOLVERS[:1])],
)
def test_the_optimum_is_that_of_a_dense_program(plain: TransientProblem, kind: str, solver: str) -> None:
    problem = varied(plain, kind)
    answer = solve(problem, SolverOptions(solver))
    proof = certify(problem, answer.command, answer.multipliers)
    command, J = dense.optimum(problem, np.zeros((0, 150)), np.zeros(0), np.zeros(0))
    program = dense.Program.of(problem)
    assert proof.accepted
    assert proof.objective == pytest.approx(program.merits(answer.command)[0], rel=1e-9)
    assert proof.merit == pytest.approx(program.merits(answer.command)[1], rel=1e-9)
    scale = max(J, OBJECTIVE_SCALE)
    assert proof.merit <= program.merits(command)[1] + 1e-6 * scale
    assert proof.lower_bound <= program.merits(command)[1] + 1e-9 * scale
    np.testing.assert_allclose(answer.command, command, atol=2e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_the_unlimited_optimum_is_that_of_a_dense_program(plain: TransientProblem, kind: str) -> None:
    problem = varied(plain, kind)
    H, g = dense.Program.of(problem).quadratic()
    free = problem.free_stages
    command = np.append(np.linalg.solve(H[:free, :free], -g[:free]), np.zeros(problem.hand_over_samples))
    for found in (unlimited.solve([problem])[0], unlimited.solve_sparse(problem)):
        np.testing.assert_allclose(found.command, command, atol=1e-6)


def by_rollout(problem: TransientProblem, command: FloatArray) -> float:
    """The tail's part of J as the certificate sees it."""
    error = problem.tracking.error(problem.accelerations(command))[..., problem.grid.stages :]
    after = np.array([term.after for term in problem.terms])
    return float(after @ np.mean(np.sum(error**2, axis=2), axis=1)) / problem.tracking.energy_m2_s4


def ended(problem: TransientProblem, seed: int) -> FloatArray:
    """(N,) a command that ends as the hand-over asks, tick by tick."""
    command = np.random.default_rng(seed).normal(size=problem.grid.stages)
    for k in range(problem.free_stages, problem.grid.stages):
        command[k] = problem.hand_over_command(problem.stage.motion(command))[k]
    return command


class TestTail:
    @pytest.mark.parametrize("kind", KINDS)
    @pytest.mark.parametrize("ideal", [False, True])
    def test_it_is_a_function_of_the_last_state(
        self, plain: TransientProblem, make_problem: ProblemMaker, kind: str, ideal: bool
    ) -> None:
        problem = varied(lasting(make_problem(0.4, 5.0, stages=150, ideal=True)) if ideal else plain, kind)
        stage = linear_stage(problem)
        command = np.append(np.random.default_rng(0).normal(size=140), np.zeros(10))
        found, x = tail(problem, stage), np.zeros(stage.units.size)
        for movement in np.diff(command, prepend=0.0) / stage.input_scale:
            x = stage.A @ x + stage.A[:, -1] * movement
        squares = float(np.sum((found.gain @ x - found.target) ** 2)) + found.rest
        assert squares == pytest.approx(by_rollout(problem, command), rel=1e-9)

    def test_none_without_instants_after_the_window(self, plain: TransientProblem) -> None:
        bare = replace(plain, grid=replace(plain.grid, after_stages=0), target=Target(plain.reference_m_s2))
        assert tail(bare, linear_stage(bare)).target.size == 0

    def test_fewer_instants_than_states(self, make_problem: ProblemMaker) -> None:
        problem = lasting(make_problem(0.4, 5.0, stages=150, current_A=2.5), after=2)
        answer = solve(problem, SolverOptions())
        _, J = dense.optimum(problem, np.zeros((0, 150)), np.zeros(0), np.zeros(0))
        assert certify(problem, answer.command, answer.multipliers).accepted
        assert problem.objective(answer.command, problem.accelerations(answer.command)) <= J * (1 + 1e-6)


@pytest.fixture(scope="module")
def problem(walled: WalledMaker) -> TransientProblem:
    """Pose the problem of an entry over a wall, with a tap that lasts beyond the window."""
    return lasting(walled(500.0, 0.2).without("temperature"))


class TestOverAWall:
    """The wall goes on pushing when the waveform is over."""

    def test_the_command_goes_on_as_the_law_asks_tick_by_tick(self, problem: TransientProblem) -> None:
        assert problem.wall is not None
        command = ended(problem, 1)
        problem = pressing_under(problem, command)
        wall, stage, N = problem.wall, problem.stage, problem.grid.stages
        ticks = N + problem.grid.after_stages
        loop = FeedbackLoop(wall.wall, stage.amplifier, stage.dt_s, wall.nominal_m[:1], np.array([wall.approach_m_s]))
        course, late, x = np.zeros(ticks + 10), stage.whole_delay + 1, np.zeros((stage.A.shape[0], 1))
        told = np.zeros(ticks)
        assert stage.Cp is not None
        assert stage.Dp is not None
        for k in range(ticks):
            asked = loop.step(wall.nominal_m[k : k + 1] + course[k])[0]
            told[k] = command[k] if k < N else asked
            course[k + late] = (stage.Cp @ x + stage.Dp * told[k])[0, 0]
            x = stage.A @ x + stage.B * told[k]
        assert wall.pressing[N:].any()
        np.testing.assert_allclose(problem.continued(command), told, atol=1e-9)

    def test_its_transpose_is_the_difference(self, problem: TransientProblem) -> None:
        random = np.random.default_rng(2)
        N, M = problem.grid.stages, problem.grid.after_stages
        command, direction, by_lasting = random.normal(size=N), random.normal(size=N), random.normal(size=N + M)
        change = problem.continued(command + direction) - problem.continued(command)
        through = problem.feedback.continued_transposed(by_lasting)
        assert through @ direction == pytest.approx(by_lasting @ change, rel=1e-8)

    def test_the_gradient_is_the_difference(self, problem: TransientProblem) -> None:
        command, direction = ended(problem, 3), np.random.default_rng(4).normal(size=problem.grid.stages)
        multipliers = Multipliers.zero(problem)
        gradient = reduced_gradient(Effect(problem, command), multipliers)

        def merit(step: float) -> float:
            moved = command + step * direction
            made = problem.accelerations(moved)
            return problem.objective(moved, made) - problem.tracking.reward(made)

        assert gradient @ direction == pytest.approx((merit(1e-3) - merit(-1e-3)) / 2e-3, rel=1e-6)

    def test_the_tail_is_a_function_of_the_last_state(self, problem: TransientProblem) -> None:
        command, stage = ended(problem, 5), linear_stage(problem)
        found, x = tail(problem, stage), np.zeros(stage.units.size)
        for movement in np.diff(command, prepend=0.0) / stage.input_scale:
            x = stage.A @ x + stage.A[:, -1] * movement
        squares = float(np.sum((found.gain @ x - found.target) ** 2)) + found.rest
        assert squares == pytest.approx(by_rollout(problem, command), rel=1e-7)

    @pytest.mark.parametrize("solver", SOLVERS)
    def test_it_is_solved_and_proven(self, problem: TransientProblem, solver: str) -> None:
        answer = solve(problem, SolverOptions(solver))
        assert answer.status is Status.OPTIMAL
        assert certify(problem, answer.command, answer.multipliers).accepted


def test_a_tap_that_is_all_lost_has_an_error_of_one() -> None:
    target = Target(np.zeros(50), np.zeros(10), np.full(4, 20.0))
    assert target.asks_for_nothing
    assert not target.is_zero
    yardstick = Yardstick(TimeGrid(1e-4, 50, 0.0, 4e-4, 10))
    assert yardstick.tap_error(target, np.zeros(60)) == pytest.approx(1.0)
    assert yardstick.tap_error(Target(np.zeros(50)), np.zeros(50)) == 0.0


def test_the_tap_error_of_a_window_within_the_intention_takes_the_motion_after_it() -> None:
    made, recorded = np.random.default_rng(1).standard_normal((2, 60))
    target, yardstick = Target(recorded[:50], recorded[50:]), Yardstick(TimeGrid(1e-4, 50, 0.0, 0.0, 10))
    truly = float(np.linalg.norm(made - recorded) / np.linalg.norm(recorded))
    assert yardstick.tap_error(target, made) == pytest.approx(truly, rel=1e-12)
    assert yardstick.figures(target, made).tap_error == pytest.approx(truly, rel=1e-12)
    with pytest.raises(ValueError, match="broadcast"):
        yardstick.tap_error(target, made[:50])


@pytest.mark.parametrize("directions", [(), (3,)], ids=["one direction", "three directions"])
def test_a_target_is_freed_without_a_search_for_garbage(directions: tuple[int, ...]) -> None:
    target = Target(*(np.ones((*directions, samples)) for samples in (9, 2, 1)))
    assert target.normal.window_m_s2.shape == (9,)
    known = weakref.ref(target)
    gc.disable()
    try:
        del target
        assert known() is None
    finally:
        gc.enable()
