"""Every kind of limit as rows: what it bounds, backwards as well, and in both programs of the solvers."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from problems.stress.cases import StressCase
from problems.stress.judge import played
from problems.stress.parts import R_OHM, Coil, Current, Horizon, Surface
from tests.benches.limits import supply_of
from tests.conftest import ProblemMaker
from transopt.base.errors import InputError
from transopt.library.library import Library
from transopt.library.multipliers import ARRAYS, MULTIPLIERS
from transopt.plant.discretise import discretise
from transopt.plant.state_space import CURRENT_INPUT
from transopt.problem.answer import Multipliers
from transopt.problem.heat import Budget
from transopt.problem.limits import KINDS, kinds_of, limits_of, needed_outputs
from transopt.problem.limits.command import CommandLimit
from transopt.problem.limits.current import CurrentLimit
from transopt.problem.limits.limit import SIDES, Limit, Limits, Setting
from transopt.problem.limits.output import OutputLimit, StrokeLimit, VelocityLimit
from transopt.problem.limits.slew import SlewLimit
from transopt.problem.limits.supply import SupplyLimit
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import certify, reduced_gradient
from transopt.proof.effect import Effect, boxes
from transopt.proof.replay import replay
from transopt.solvers import riccati
from transopt.solvers.choose import solve
from transopt.solvers.options import SolverOptions
from transopt.solvers.program import state_program
from transopt.solvers.stage_data import stages
from transopt.solvers.statement import state

MOTION = {"current_A": 2.0, "stroke_m": 0.01, "velocity_m_s": 1.0}
COIL = Coil(below_K=20.0, tau_w_s=12.0)


def all_limits(pole_Hz: float | None = 1050.0, *, walled: bool = False, coil: Coil | None = COIL) -> TransientProblem:
    """A short problem with every kind of limit that its amplifier allows."""
    current = Current(limit_A=2.0, pole_Hz=pole_Hz, slew=0.2, supply=1.1)
    surface = Surface(500.0) if walled else None
    case = StressCase("all", current=current, horizon=Horizon(stages=40), coil=coil, surface=surface)
    problem = case.problem()
    plain, grid, speed = problem.stage, problem.grid, case.demand.speed_m_s
    stage = discretise(
        plain.plant, plain.amplifier, grid.dt_s, position=plain.Cp is not None, outputs=needed_outputs(MOTION)
    )
    setting = Setting(
        stage=stage,
        grid=grid,
        circuit=None,
        coil=None,
        budget=Budget(),
        wall=problem.wall,
        reference_m_s2=problem.reference_m_s2,
        nominal_m=-speed * grid.switching_times_s,
        nominal_m_s=np.full(grid.stages, -speed),
    )
    of_motion = (kind.posed(MOTION, setting) for kind in (StrokeLimit, VelocityLimit))
    return replace(problem, stage=stage, limits=limits_of(*problem.limits, *of_motion))


PROBLEMS: dict[str, Callable[[], TransientProblem]] = {
    "amplifier": all_limits,
    "ideal": lambda: all_limits(None),
    "walled": lambda: all_limits(walled=True),
    "ideal, walled": lambda: all_limits(None, walled=True),
}


@pytest.fixture(params=sorted(PROBLEMS))
def problem(request: pytest.FixtureRequest) -> TransientProblem:
    return PROBLEMS[request.param]()


def drawn_command(problem: TransientProblem, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-2.0, 2.0, problem.grid.stages)


def value_of(problem: TransientProblem, row: str, command: np.ndarray) -> np.ndarray:
    (found,) = (each for _, each in problem.rows() if each.name == row)
    return found.value(problem.stage.motion(command), command)


class TestValues:
    def test_the_problems_have_every_kind(self) -> None:
        assert [limit.name for limit in all_limits().limits] == [kind.name for kind in kinds_of(CURRENT_INPUT)]
        # An ideal amplifier has no range, and no pole that would tell di/dt.
        assert [limit.name for limit in all_limits(None).limits] == [
            "current",
            "slew",
            "stroke",
            "velocity",
            "temperature",
        ]

    def test_current(self, problem: TransientProblem) -> None:
        command = drawn_command(problem)
        _, current = problem.stage.rollout(command)
        np.testing.assert_allclose(value_of(problem, "current", command), current, rtol=1e-15, atol=1e-15)

    def test_command_and_slew(self) -> None:
        problem = all_limits()
        command = drawn_command(problem)
        np.testing.assert_array_equal(value_of(problem, "command", command), command)
        movement = np.diff(command, prepend=0.0)
        np.testing.assert_allclose(value_of(problem, "slew", command), movement, rtol=0, atol=1e-15)

    @pytest.mark.parametrize("walled", [False, True])
    def test_supply(self, walled: bool) -> None:
        """R i + L di/dt + k_e dz/dt with di/dt = w (c - i), c the command felt before and after tau_k.

        R is that of the coldest copper, at the start, and that of the hottest, at the limit of the coil.
        """
        problem = all_limits(walled=walled)
        command, supply = drawn_command(problem), supply_of(problem)
        motion, w, coil = problem.stage.motion(command), supply.pole_rad_s, problem.thermal.coil
        i, speed = motion.plant_input, motion.velocity_m_s + supply.nominal_m_s
        coldest = min(coil.start_winding_C, coil.start_housing_C, coil.ambient_C)
        assert coldest < coil.limit_C
        for name, copper_C in (("supply", coldest), ("supply_hot", coil.limit_C)):
            R = R_OHM * (1 + 0.0039 * (copper_C - 25.0))
            for side, felt in (("before", np.append(0.0, command[:-1])), ("after", command)):
                volts = R * i + 0.238e-3 * w * (felt - i) + supply.emf_V_s_m * speed
                np.testing.assert_allclose(
                    value_of(problem, f"{name}_{side}", command), volts, rtol=1e-12, atol=1e-12
                )

    def test_stroke_and_velocity(self, problem: TransientProblem) -> None:
        """y and dy/dt of the motor mass a period later, from the states, with the nominal motion's part there."""
        command, stage = drawn_command(problem), problem.stage
        states = stage.states(np.append(command, 0.0))[1:, : stage.plant.order]
        for row, output in (("stroke", stage.plant.Ce), ("velocity", stage.plant.Ce @ stage.plant.A)):
            limit = problem.limits[row]
            assert isinstance(limit, OutputLimit)
            wanted = states @ output[0] + limit.nominal[1:]
            found = value_of(problem, row, command)
            np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())

    def test_temperature(self, problem: TransientProblem) -> None:
        """No row, since it is no sum of outputs; the certificate reads the limit's own course."""
        command, thermal = drawn_command(problem), problem.thermal
        assert thermal.rows(problem) == ()
        motion = problem.stage.motion(command)
        (box,) = (
            box
            for box in boxes(problem, command, motion, Multipliers.zero(problem))
            if box.limit.name == "temperature"
        )
        course = thermal.temperatures_C(motion.plant_input, command)
        np.testing.assert_allclose(box.value, course, rtol=1e-14)
        np.testing.assert_allclose(box.upper, thermal.limit_C, rtol=1e-12)
        assert np.all(np.isinf(box.lower))

    def test_bounds_are_those_that_were_asked_for(self, problem: TransientProblem) -> None:
        for limit, row in problem.rows():
            assert row.name in limit.row_names
            # What an output may do within a servo period is taken off.
            room = limit.stated - (limit.margin() if isinstance(limit, OutputLimit) else 0.0)
            assert (row.lower, row.upper) == (-room, room)
            assert 0 < room <= limit.stated


class TestTransposed:
    def test_the_reduced_gradient_is_the_derivative_of_the_lagrangian(self, problem: TransientProblem) -> None:
        """All limits are linear here: J and the values are at most quadratic, so central differences are exact."""
        problem = problem.without("temperature")
        random, N = np.random.default_rng(4), problem.grid.stages
        command, multipliers = drawn_command(problem), Multipliers.zero(problem)
        for _, row in problem.rows():
            multipliers = multipliers.with_pair(row.name, *random.exponential(size=(2, N)))

        def lagrangian(c: np.ndarray) -> float:
            effect = Effect(problem, c)
            constraints = sum(
                float((m.upper(row.name) - m.lower(row.name)) @ row.value(effect.motion, c))
                for m in (multipliers,)
                for _, row in problem.rows()
            )
            return problem.objective(c, effect.accelerations_m_s2) + constraints

        gradient = reduced_gradient(Effect(problem, command), multipliers)
        for k in (0, 1, 17, N - 1):
            step = np.eye(N)[k]
            difference = (lagrangian(command + step) - lagrangian(command - step)) / 2
            assert gradient[k] == pytest.approx(difference, rel=1e-8, abs=1e-8 * np.abs(gradient).max())


@pytest.mark.skipif(not riccati.available, reason="the extension is not built")
@pytest.mark.parametrize("name", sorted(PROBLEMS))
def test_both_programs_have_every_limit(name: str) -> None:
    """The stage data of the project's own method and the program of CasADi: one certificate accepts both answers."""
    problem = PROBLEMS[name]().without("temperature")
    found = []
    for solver in ("riccati", "casadi-piqp"):
        answer = solve(problem, SolverOptions(solver))
        proof = certify(problem, answer.command, answer.multipliers)
        assert (answer.solver, proof.accepted) == (solver, True)
        assert set(answer.multipliers.pairs) == {row.name for _, row in problem.rows()}
        found.append(proof.objective)
    assert found[0] == pytest.approx(found[1], rel=1e-6)


class TestLimitsThatAreNotThere:
    @pytest.mark.parametrize("kind", [CommandLimit, SlewLimit, SupplyLimit, StrokeLimit, VelocityLimit])
    def test_no_rows_no_multipliers_and_no_stage_data(self, kind: type[Limit]) -> None:
        """The amplifier's range goes with its pole."""
        problem = all_limits(None if kind is CommandLimit else 1050.0, coil=None).without(kind.name)
        assert kind.name in all_limits().limits
        assert kind.name not in problem.limits
        assert problem.limits.get(kind.name) is None
        with pytest.raises(KeyError, match=kind.name):
            problem.limits[kind.name]
        named = {row.name for _, row in problem.rows()}
        assert not named & set(kind.row_names)
        assert set(stages(problem).limits.kinds) == named
        statement = state(problem)
        assert {row.name for row in statement.rows} == named
        assert not set(state_program(statement.shape).rows) & set(kind.row_names)
        answer = solve(problem, SolverOptions())
        assert set(answer.multipliers.pairs) == named
        for row in kind.row_names:
            for side in SIDES:
                assert not getattr(answer.multipliers, side)(row).any()
        proof = certify(problem, answer.command, answer.multipliers)
        assert proof.accepted
        assert ("V" in proof.violations) == ("supply" in problem.limits)
        assert set(played(problem, answer.command).reached) == {limit.name for limit in problem.limits}

    def test_no_temperature(self) -> None:
        problem = all_limits().without("temperature")
        assert problem.thermal is None
        assert stages(problem).sizes["nodes"] == 0
        assert "winding" not in stages(problem).limits.kinds
        answer = solve(problem, SolverOptions())
        assert "temperature" not in answer.multipliers.pairs
        assert not answer.multipliers.slope.any()
        assert "K" not in certify(problem, answer.command, answer.multipliers).violations

    def test_multipliers_on_it_change_nothing(self) -> None:
        """Neither the gradient nor the gap: there is nothing that they could price."""
        problem = all_limits(coil=None).without("supply")
        answer = solve(problem, SolverOptions())
        stray = answer.multipliers.with_pair("supply_after", *np.ones((2, problem.grid.stages)))
        own, other = (certify(problem, answer.command, m) for m in (answer.multipliers, stray))
        assert own == other

    def test_a_replay_that_was_not_asked_about_a_limit_does_not_pass_it(self) -> None:
        problem = all_limits(coil=None)
        answer = solve(problem, SolverOptions())
        predicted, _ = problem.stage.rollout(answer.command)

        def shortfalls(limits: Limits | None) -> list[str]:
            (run,) = replay(
                problem.stage,
                problem.grid,
                answer.command[None],
                [problem.target],
                None,
                limits=None if limits is None else [limits],
            )
            return run.shortfalls(problem, answer.command, predicted)

        assert shortfalls(problem.limits) == []
        assert [text.split(" nan")[0] for text in shortfalls(problem.limits.without("supply"))] == [
            "terminal voltage"
        ]
        assert len(shortfalls(None)) == len(tuple(problem.limits))


class TestArraysOfALibrary:
    def test_one_for_every_side_of_every_row(self) -> None:
        wanted = [f"mu_{row}_{side}" for kind in KINDS for row in kind.row_names for side in kind.sides]
        assert list(MULTIPLIERS) == list(dict.fromkeys(wanted))  # a current and a voltage share their command's
        assert set(wanted) <= set(ARRAYS)
        assert "mu_temperature_lower" not in ARRAYS

    def test_one_that_is_not_in_force_has_none_in_the_file(self, library: Library) -> None:
        names = set(library.arrays())
        for kind in kinds_of(CURRENT_INPUT):
            asked = library.posing().asked.get(kind.key) is not None
            for row in kind.row_names:
                for side in kind.sides:
                    name = f"mu_{row}_{side}"
                    assert (name in names) == (kind.in_every_file or asked)
                    if name not in names:
                        assert not library.array(name).any()

    def test_multipliers_of_an_entry_are_the_arrays(self, library: Library) -> None:
        found = library.multipliers(3, 2)
        np.testing.assert_array_equal(found.upper("current"), library.array("mu_current_upper")[3, 2])
        np.testing.assert_array_equal(found.lower("command"), library.array("mu_command_lower")[3, 2])
        assert found.upper("current").any()
        assert not found.upper("slew").any()


class TestCollection:
    def test_in_the_order_of_the_kinds_whatever_they_are_given_in(self) -> None:
        made = limits_of(SlewLimit(1e4, 1e-4), None, CommandLimit(6.0), CurrentLimit(4.0))
        assert [limit.name for limit in made] == ["current", "command", "slew"]
        assert made.input_limit == pytest.approx(4.0)
        assert made.command_bound(ideal=False) == pytest.approx(6.0)
        assert made["slew"].stated == pytest.approx(1.0)

    def test_without_and_replaced(self) -> None:
        made = limits_of(CurrentLimit(4.0), CommandLimit(6.0))
        assert [limit.name for limit in made.without("command", "supply")] == ["current"]
        assert made.replaced(CurrentLimit(2.0)).input_limit == pytest.approx(2.0)
        # In the place of one of its name only.
        assert "slew" not in made.replaced(SlewLimit(1e4, 1e-4))

    @pytest.mark.parametrize("factor", [1.5, 4.0])
    def test_wider(self, factor: float) -> None:
        for limit in all_limits().limits:
            if limit.name != "temperature":
                assert limit.wider(factor).stated == pytest.approx(factor * limit.stated)
        thermal = all_limits().thermal
        assert thermal.wider(factor).room == pytest.approx(thermal.room + (factor - 1) * max(thermal.room, 1.0))

    @pytest.mark.parametrize("number", [0.0, -1.0, np.nan, np.inf])
    def test_a_number_that_is_no_limit_is_refused(self, number: float) -> None:
        supply = supply_of(all_limits())
        made: list[tuple[str, Callable[[], object]]] = [
            ("current_A", lambda: CurrentLimit(number)),
            ("command_A", lambda: CommandLimit(number)),
            ("slew_A_per_s", lambda: SlewLimit(number, 1e-4)),
            ("supply_V", lambda: replace(supply, limit_V=number)),
        ]
        for key, make in made:
            with pytest.raises(InputError, match=rf"limits.{key} = {number:g}: must be > 0 and finite"):
                make()


def test_the_scenes_slew_is_a_step_per_tick(make_problem: ProblemMaker) -> None:
    problem = make_problem(0.4, 5.0, slew_A_per_s=5000.0)
    assert problem.limits["slew"].stated == pytest.approx(5000.0 * problem.grid.dt_s)
