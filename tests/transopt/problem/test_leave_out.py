"""Parts left out by proof: forced in they change nothing but the size, and each proof's bound is a bound."""

from dataclasses import replace

import numpy as np
import pytest

import problems
from tests.benches.limits import command_limit_A, supply_of, with_limit, with_numbers, with_rail
from tests.conftest import ProblemMaker, is_stationary
from transopt.design.context import Context
from transopt.design.optimum import optimum
from transopt.plant.discretise import discretise
from transopt.plant.wall import HandOver, Wall
from transopt.problem.answer import Status
from transopt.problem.leave_out import leave_out, without_position
from transopt.problem.limits.temperature import temperature_limit
from transopt.problem.problem import TransientProblem
from transopt.problem.wall_ticks import pressing
from transopt.proof.certify import certify
from transopt.proof.effect import inside
from transopt.proof.replay import replay
from transopt.references.reference import Reference
from transopt.scene.scene import Scene
from transopt.solvers.choose import solve
from transopt.solvers.options import SolverOptions
from transopt.solvers.shape import size
from transopt.solvers.statement import state

DT_S = 1e-4


def entry(scene: Scene, reference: Reference, grip_N: float, **tables: dict[str, object]) -> TransientProblem:
    data = scene.model_dump()
    for name, table in tables.items():
        data[name] = {**(data[name] or {}), **table}
    varied = Scene.model_validate(data)
    return Context(varied).posed_as(reference, grip_N).problem


def certified_objective(whole: TransientProblem, solved: TransientProblem, solver: str = "casadi-piqp") -> float:
    """J of the answer to `solved`, proven for `whole`."""
    answer = solve(solved, SolverOptions(solver))
    assert answer.status is Status.OPTIMAL
    assert answer.solver == solver
    # An interior-point method leaves 1e-13 on a temperature that does not bind; so the global bound, another solve,
    # is not asked for: there is no warming copper in the answer's way.
    assert is_stationary(whole, answer)
    return certify(whole, answer.command, answer.multipliers).objective


def check_same(whole: TransientProblem, small: TransientProblem, solver: str = "casadi-piqp") -> None:
    """Forced in, the part changes nothing; the small answer is one to the whole problem, multipliers and all."""
    first, second = certified_objective(whole, whole, solver), certified_objective(whole, small)
    assert abs(first - second) <= 1e-6 * max(second, 1e-3)


def bounds_stated(problem: TransientProblem) -> int:
    statement = state(problem)
    return int(np.isfinite(statement.lower_x).sum() + np.isfinite(statement.upper_x).sum())


class TestForcedIn:
    def test_slew(self, make_problem: ProblemMaker) -> None:
        """A box on a variable that is there anyway: no row more, but a bound per stage and side."""
        whole = make_problem(0.4, 5.0, slew_A_per_s=12.0 / DT_S)
        reduced = leave_out(whole)
        assert "slew" not in reduced.problem.limits
        assert "no command inside +-6 A changes faster than 120000 A/s, limit 120000 A/s" in reduced.left_out["slew"]
        check_same(whole, reduced.problem)
        assert size(whole) == size(reduced.problem)
        assert bounds_stated(whole) == bounds_stated(reduced.problem) + 2 * whole.grid.stages

    def test_slew_is_kept_where_it_can_matter(self, make_problem: ProblemMaker) -> None:
        kept = leave_out(make_problem(0.4, 5.0, slew_A_per_s=11.9 / DT_S))
        assert "slew" not in kept.left_out
        assert "slew" in kept.problem.limits

    def test_supply(self, scene: Scene, references: list[Reference]) -> None:
        whole = entry(scene, references[-1], 5.0, limits={"supply_V": 16.0}).without("temperature")
        reduced = leave_out(whole)
        assert "supply" not in reduced.problem.limits
        assert "takes more than 16.0 V, limit 16 V" in reduced.left_out["supply"]
        check_same(whole, reduced.problem)
        larger, smaller = size(whole), size(reduced.problem)
        assert larger.rows == smaller.rows + 2 * (2 * whole.grid.stages - 1)
        kept = leave_out(entry(scene, references[-1], 5.0, limits={"supply_V": 15.0}).without("temperature"))
        assert "supply" in kept.problem.limits

    def test_temperature(self, scene: Scene, references: list[Reference]) -> None:
        whole = entry(scene, references[-1], 5.0)
        reduced = leave_out(whole)
        assert reduced.problem.thermal is None
        assert "limit 100 C" in reduced.left_out["temperature"]
        check_same(whole, reduced.problem, "casadi-ipopt")
        larger, smaller = size(whole), size(reduced.problem)
        assert larger.states >= smaller.states + 2
        assert larger.rows > smaller.rows

    def test_temperature_is_left_out_after_the_fact_too(self, scene: Scene, references: list[Reference]) -> None:
        """4 A throughout would be too hot, the optimum without the limit is not."""
        whole = entry(scene, references[-1], 5.0, thermal={"headroom_K": 0.3})
        assert "temperature" not in leave_out(whole).left_out
        designed = optimum(whole, SolverOptions())
        assert "the optimum without it stays inside" in designed.left_out["temperature"]
        assert designed.certificate.accepted
        forced = certified_objective(whole, whole, "casadi-ipopt")
        assert abs(forced - designed.certificate.objective) <= 1e-6 * max(forced, 1e-3)

    def test_feedback_of_a_wall_that_is_not_pressed(self, scene: Scene, references: list[Reference]) -> None:
        """A hand that has lifted the stylus off before the transient ends."""
        walled = entry(scene, references[-1], 5.0, feedback={"stiffness_N_m": 500.0})
        nominal = walled.wall.nominal_m.copy()
        N = walled.grid.stages
        nominal[N - 60 :] = 5e-3
        walled = replace(walled.without("temperature"), wall=replace(walled.wall, nominal_m=nominal))
        whole = pressing(walled, np.zeros(nominal.size))
        assert whole.wall.pressing[100:500].all()
        assert not whole.wall.pressing[N - 11 :].any()
        reduced = leave_out(whole)
        assert reduced.problem.wall is None
        assert reduced.problem.stage.Cp is None
        assert "above the surface from the hand-over on" in reduced.left_out["feedback"]
        check_same(whole, reduced.problem)
        larger, smaller = size(whole), size(reduced.problem)
        assert larger.states == smaller.states + 4  # position, velocity, a demand and its predecessor
        assert larger.variables > smaller.variables
        # Half the hand-over pressed: it stays.
        kept = replace(whole.wall, pressing=np.arange(nominal.size) > N - 5)
        assert "feedback" not in leave_out(replace(whole, wall=kept)).left_out

    def test_position_of_a_free_stylus(self, make_problem: ProblemMaker) -> None:
        """Nothing holds a free device, so its position only integrates; a held one's arm needs it."""
        free = problems.load("free_stylus")
        held = make_problem(0.4, 5.0)
        stage = discretise(free.plant(0.0), held.stage.amplifier, DT_S, position=True)
        whole = replace(with_numbers(held, current_A=1.0), stage=stage)
        small = replace(whole, stage=without_position(stage))
        assert small.stage.A.shape[0] == stage.A.shape[0] - 1
        check_same(whole, small)
        larger, smaller = size(whole), size(small)
        assert larger.states == smaller.states + 1
        arm = discretise(held.stage.plant, held.stage.amplifier, DT_S, position=True)
        assert without_position(arm).A.shape == arm.A.shape

    def test_limits_that_the_unlimited_optimum_keeps(self, scene: Scene, references: list[Reference]) -> None:
        """The linear solve alone, no program at all."""
        whole = entry(scene, references[1], 3.0)
        designed = optimum(whole, SolverOptions())
        assert designed.left_out["limits"].startswith("the unlimited optimum is inside all limits: current ")
        assert designed.solved is None
        assert designed.certificate.accepted
        assert inside(whole, designed.solution.command)
        for forced, solver in ((whole.without("temperature"), "casadi-piqp"), (whole, "casadi-ipopt")):
            objective = certified_objective(whole, forced, solver)
            assert abs(objective - designed.certificate.objective) <= 1e-6 * max(objective, 1e-3)

    def test_all_at_once(self, scene: Scene, references: list[Reference]) -> None:
        tables = {"limits": {"supply_V": 24.0, "slew_A_per_s": 2e5}, "feedback": {"stiffness_N_m": 500.0}}
        whole = entry(scene, references[-1], 5.0, **tables)
        wall = whole.wall
        assert isinstance(wall, HandOver)
        above = replace(wall, nominal_m=np.full(wall.nominal_m.size, 5e-3), pressing=np.zeros_like(wall.pressing))
        reduced = leave_out(replace(whole, wall=above))
        assert set(reduced.left_out) == {"slew", "supply", "temperature", "feedback"}
        check_same(replace(whole, wall=above), reduced.problem, "casadi-ipopt")


def admissible(problem: TransientProblem, wanted: np.ndarray) -> np.ndarray:
    """(M, N) commands whose currents go for the wanted ones (M, N) as fast as |c| allows, inside both limits."""
    limits, range_A, amplifier = problem.limits, command_limit_A(problem), problem.stage.amplifier
    p = np.exp(-amplifier.rate_rad_s * problem.grid.dt_s)
    command, current = np.zeros(wanted.shape), np.zeros(wanted.shape[0])
    for k in range(wanted.shape[1]):
        target = np.clip(wanted[:, k], -limits.input_limit, limits.input_limit)
        command[:, k] = np.clip((target - p * current) / (1 - p), -range_A, range_A)
        current = p * current + (1 - p) * command[:, k]
    return command


def square_waves(limit: float, stages: int, seed: int) -> np.ndarray:
    """(12, N) held, alternating with periods from 2 to 300 ticks, and at random."""
    random = np.random.default_rng(seed)
    ticks = np.arange(stages)
    periods = (2, 4, 8, 16, 26, 52, 100, 300)
    waves = [np.where(ticks // (period // 2) % 2 == 0, 1.0, -1.0) for period in periods]
    return limit * np.stack([np.ones(stages), *waves, *random.choice([-1.0, 1.0], (3, stages))])


class TestBounds:
    @pytest.mark.parametrize(
        "start",
        [
            {},
            {"start_winding_C": 90.0, "start_housing_C": 40.0},
            {"start_winding_C": 40.0, "start_housing_C": 90.0},
            {"start_winding_C": 30.0, "start_housing_C": 30.0, "ambient_C": 70.0},
            {"start_winding_C": 60.0, "start_housing_C": 80.0, "nodes": 1},
            {"tap_rate_Hz": 3.0, "idle_A": 0.2},
        ],
    )
    def test_no_admissible_command_is_hotter(
        self, scene: Scene, references: list[Reference], start: dict[str, float]
    ) -> None:
        problem = entry(scene, references[-1], 5.0, thermal=start)
        commands = admissible(problem, square_waves(4.0, 800, 1))
        currents = problem.stage.rollout(commands)[1]
        assert np.abs(currents).max() <= 4 + 1e-12
        bound = problem.thermal.bound_C(problem)
        stated = [problem.thermal.temperatures_C(i, c).max() for i, c in zip(currents, commands, strict=True)]
        assert max(stated) <= bound
        played = replay(
            problem.stage,
            problem.grid,
            commands,
            [problem.target] * len(commands),
            problem.thermal.coil,
            budgets=[problem.thermal.budget] * len(commands),
        )
        hottest = max(run.winding_C for run in played)
        assert hottest <= bound
        if not start or "tap_rate_Hz" in start:
            # From rest and for ever it is no idle bound either.
            assert bound - hottest < 0.05 * (bound - 25)

    def test_past_runaway_there_is_no_bound(self, scene: Scene, references: list[Reference]) -> None:
        """4 A most of the time has no equilibrium above 2.6 A: the fixed point lies below the ambient."""
        problem = entry(scene, references[-1], 5.0, thermal={"tap_rate_Hz": 11.0})
        assert problem.thermal.bound_C(problem) == float("inf")
        assert "temperature" not in leave_out(problem).left_out

    @pytest.mark.parametrize(("speed", "grip_N"), [(0, 1.0), (3, 1.0), (3, 5.0)])
    def test_no_admissible_command_takes_more_voltage(
        self, scene: Scene, references: list[Reference], speed: int, grip_N: float
    ) -> None:
        """Also not the one that drives the motor mass to its highest speed, nor between the switching instants."""
        problem = entry(scene, references[speed], grip_N, limits={"supply_V": 100.0})
        impulse = problem.stage.motion(np.eye(600)[0]).velocity_m_s
        fastest = [np.append(4.0 * np.sign(impulse[1 : k + 1][::-1]), np.zeros(600 - k)) for k in (40, 200, 599)]
        turned = [
            np.where(np.arange(600) == k, -np.sign(w[k - 1]) * 4.0, w)
            for k, w in zip((40, 200), fastest, strict=False)
        ]
        waves = np.stack([*square_waves(4.0, 600, 2), *fastest, *turned])
        commands = admissible(problem, np.concatenate([waves, -waves]))
        bound = max(supply_of(problem).bounds_V(problem))
        played = replay(
            problem.stage,
            problem.grid,
            commands,
            [problem.target] * len(commands),
            None,
            limits=[problem.limits] * len(commands),
        )
        highest = max(run.reached["supply"] for run in played)
        assert 0.75 * bound < highest <= bound

    def test_left_out_is_what_lies_below_its_bound(self, scene: Scene, references: list[Reference]) -> None:
        """A limit a hair above the bound goes, a hair below it stays."""
        problem = entry(scene, references[-1], 5.0, limits={"supply_V": 24.0})
        volts, celsius = max(supply_of(problem).bounds_V(problem)), problem.thermal.bound_C(problem)
        amplifier, budget = problem.stage.amplifier, problem.thermal.budget
        for shift, gone in ((1e-6, True), (-1e-6, False)):
            coil = replace(problem.thermal.coil, limit_C=celsius + shift)
            hot = temperature_limit(coil, amplifier, problem.grid, budget)
            moved = with_limit(with_rail(problem, volts + shift), hot)
            left_out = leave_out(moved).left_out
            assert ("supply" in left_out) is gone
            assert ("temperature" in left_out) is gone


def test_wall_of_no_stiffness_is_still_a_wall() -> None:
    """What `Wall` allows though no scene may state it: the damper alone."""
    assert Wall(0.0, 5.0, 1.25, 1, 500.0).current(np.array([-1e-3]), np.array([-0.2]))[0] == pytest.approx(0.8)
