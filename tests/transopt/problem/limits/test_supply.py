"""The rail at any temperature of the copper, against another integrator; rail and slew limit: solvers, refusals."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import problems as built_in
from problems.stress.judge import played
from tests.benches.libraries import proven_again
from tests.benches.limits import supply_of, with_rail
from tests.benches.rail import Tap, terminal_voltages
from tests.conftest import is_stationary
from transopt.design.build import build_library
from transopt.design.context import Context, wanted_of
from transopt.design.design import design
from transopt.design.explain import infeasibility
from transopt.design.optimum import optimum
from transopt.library.library import Library
from transopt.library.other_limits import with_limits
from transopt.problem.answer import Status
from transopt.problem.leave_out import leave_out
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.target import Target
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import binding_limits, certify
from transopt.references.reference import Reference
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings
from transopt.solvers.choose import solve
from transopt.solvers.options import SolverOptions

RAILS_V, POLES_Hz, WINDING_C = (9.0, 11.0, 14.0), (1050.0, 5000.0), (25.0, 60.0, 90.0, 100.0)
ENTRIES = ((0.2, 1.0), (0.4, 1.0), (0.4, 5.0))
# Problems without an answer keep an interior-point method busy until its last iteration.
SHORT = SolverOptions(max_iterations=60)
Maker = Callable[..., TransientProblem]
Case = tuple[float, float, float, float]
SLOW: Case = (11.0, POLES_Hz[0], 0.4, 5.0)
FAST: Case = (11.0, POLES_Hz[1], 0.4, 5.0)


def varied(scene: Scene, pole_Hz: float, supply_V: float, **thermal: float) -> Scene:
    data = scene.model_dump()
    data["amplifier"]["pole_Hz"] = pole_Hz
    data["limits"]["supply_V"] = supply_V
    data["thermal"].update(thermal)
    return Scene.model_validate(data)


@pytest.fixture(scope="module")
def problems(scene: Scene, references: list[Reference]) -> dict[Case, TransientProblem]:
    """Pose one problem for each rail, pole, speed and grip."""
    by_speed = {reference.speed_m_s: reference for reference in references}
    found = {}
    for volts, pole, (speed, grip) in product(RAILS_V, POLES_Hz, ENTRIES):
        of = varied(scene, pole, volts)
        found[volts, pole, speed, grip] = Context(of).posed_as(by_speed[speed], grip).problem
    return found


def at_one_end(problem: TransientProblem, end: int) -> TransientProblem:
    """Keep the rail for cold (0) or for hot (1) copper alone."""
    supply = supply_of(problem)
    return problem.replaced(replace(supply, ends=(supply.ends[end],)))


@pytest.fixture(scope="module")
def highest_V(
    scene: Scene, references: list[Reference], problems: dict[Case, TransientProblem]
) -> dict[tuple[Case, str], np.ndarray]:
    """The largest voltage (4,) of an optimum with the winding at `WINDING_C`, by case and by the ends it is kept for.

    All are played at once: the integrator takes about as long for one tap.
    """
    posed = {(case, "both ends"): problem for case, problem in problems.items()}
    posed[SLOW, "cold end"] = at_one_end(problems[SLOW], 0)
    posed[FAST, "hot end"] = at_one_end(problems[FAST], 1)
    by_speed, taps = {reference.speed_m_s: reference for reference in references}, []
    for ((_, pole, speed, grip), _), problem in posed.items():
        designed = optimum(problem, SolverOptions())
        assert designed.solution.status is Status.OPTIMAL
        assert designed.certificate.accepted
        taps.append(Tap(designed.solution.command, grip, pole, by_speed[speed]))
    return dict(zip(posed, terminal_voltages(scene, taps, WINDING_C), strict=True))


def test_at_any_temperature_of_the_copper_the_rail_is_kept(highest_V: dict[tuple[Case, str], np.ndarray]) -> None:
    """At every instant of an own integrator, and some of the taps do reach it."""
    found = {case: reached for (case, ends), reached in highest_V.items() if ends == "both ends"}
    assert len(found) == len(RAILS_V) * len(POLES_Hz) * len(ENTRIES)
    for (volts, *_), reached in found.items():
        assert reached.max() <= volts * (1 + 1e-3)
    at_the_rail = [case for case, reached in found.items() if reached.max() >= case[0] * (1 - 1e-6)]
    assert len(at_the_rail) >= 10


def test_neither_end_alone_is_enough(highest_V: dict[tuple[Case, str], np.ndarray]) -> None:
    """Cold rows alone let 12.8 V pass an 11 V rail at 90 C, hot ones alone 11.7 V at 25 C behind a fast amplifier."""
    cold_only = highest_V[SLOW, "cold end"]
    assert cold_only[WINDING_C.index(25.0)] == pytest.approx(11.0, abs=1e-4)
    assert cold_only[WINDING_C.index(90.0)] == pytest.approx(12.77, abs=0.05)
    hot_only = highest_V[FAST, "hot end"]
    assert hot_only[WINDING_C.index(100.0)] == pytest.approx(11.0, abs=1e-4)
    assert hot_only[WINDING_C.index(25.0)] == pytest.approx(11.65, abs=0.05)


class TestEnds:
    def ends_C(self, scene: Scene, references: list[Reference], **thermal: float) -> list[float] | None:
        of = varied(scene, 1050.0, 9.0, **thermal)
        return supply_of(Context(of).posed_as(references[-1], 5.0).problem).copper_C

    def test_the_coldest_and_the_hottest_of_the_entry(self, scene: Scene, references: list[Reference]) -> None:
        assert self.ends_C(scene, references) == [25.0, 100.0]
        # A winding that starts hot over a warm housing cools towards the ambient, at the most.
        warm = {"start_winding_C": 80.0, "start_housing_C": 60.0, "ambient_C": 35.0}
        assert self.ends_C(scene, references, **warm) == [35.0, 100.0]
        assert self.ends_C(scene, references, **warm, headroom_K=5.0) == [35.0, 85.0]
        cold = {"start_winding_C": 10.0, "start_housing_C": 15.0}
        assert self.ends_C(scene, references, **cold) == [10.0, 100.0]

    def test_one_pair_of_rows_where_the_copper_has_one_temperature(
        self, scene: Scene, references: list[Reference]
    ) -> None:
        at_limit = {"start_winding_C": 100.0, "start_housing_C": 100.0, "ambient_C": 100.0}
        assert self.ends_C(scene, references, **at_limit) == [100.0]

    def test_without_a_coil_the_resistance_is_the_stated_one(self, scene: Scene, references: list[Reference]) -> None:
        of = varied(scene, 1050.0, 9.0)
        posing = replace(of.posing(), coil=None)
        supply = supply_of(posing.problem(wanted_of(references[-1]), Context(of).stage(5.0)))
        (end,) = supply.ends
        assert (supply.copper_C, end.in_words) == (None, "")
        assert end.circuit.R_ohm == pytest.approx(scene.motor.R_ohm, rel=1e-15)


class TestWords:
    def binding(self, problem: TransientProblem) -> str:
        designed = optimum(problem, SolverOptions())
        return binding_limits(problem, designed.solution.command, designed.solution.multipliers)

    def test_which_end_binds_is_said(self, problems: dict[Case, TransientProblem]) -> None:
        slow = self.binding(problems[9.0, 1050.0, 0.4, 5.0])
        assert "supply +9 V with the copper at 100 C at " in slow
        assert "with the copper at 25 C" not in slow
        fast = self.binding(problems[11.0, 5000.0, 0.4, 5.0])
        assert "with the copper at 25 C at " in fast
        assert "with the copper at 100 C at " in fast

    def test_an_end_that_cannot_bind_is_left_out_with_its_bound(self, problems: dict[Case, TransientProblem]) -> None:
        """At a rail between the bounds of the two ends only one of them is in the problem that is solved."""
        problem = problems[9.0, 1050.0, 0.4, 5.0]
        cold_V, hot_V = supply_of(problem).bounds_V(problem)
        between = with_rail(problem, (cold_V + hot_V) / 2)
        reduced = leave_out(between)
        said = reduced.left_out["supply with the copper at 25 C"]
        rail = between.limits["supply"].stated
        assert said == f"no current inside its limits reaches the rail then: at most {cold_V:.1f} V of {rail:g} V"
        assert [row.name for limit, row in reduced.problem.rows() if limit.name == "supply"] == [
            "supply_hot_before",
            "supply_hot_after",
        ]
        # Behind a fast amplifier it is the other one.
        fast = problems[9.0, 5000.0, 0.4, 5.0]
        cold_V, hot_V = supply_of(fast).bounds_V(fast)
        assert hot_V < cold_V
        assert "supply with the copper at 100 C" in leave_out(with_rail(fast, (cold_V + hot_V) / 2)).left_out

    def test_the_answer_without_it_is_proven_for_both(self, problems: dict[Case, TransientProblem]) -> None:
        problem = problems[14.0, 5000.0, 0.4, 5.0]
        fewer = optimum(problem, SolverOptions())
        all_rows = solve(problem.without("temperature"), SolverOptions())
        proof = certify(problem, all_rows.command, all_rows.multipliers)
        assert fewer.certificate.accepted
        assert proof.accepted
        assert fewer.certificate.objective == pytest.approx(proof.objective, rel=1e-8)


@pytest.fixture(scope="module")
def low() -> Library:
    scene = built_in.load("low_supply")
    scene = scene.model_copy(update={"grid": scene.grid.model_copy(update={"speeds_m_s": [0.4]})})
    built = build_library(scene, recordings(scene)).library
    assert built is not None
    return built


class TestLibrary:
    def test_the_rail_is_kept_at_both_temperatures(self, low: Library, tmp_path: Path) -> None:
        assert supply_of(low.problem(0, 0)).copper_C == [25.0, 100.0]
        assert low.array("mu_supply_hot_after_upper").any()
        proven_again(low, tmp_path)

    def test_a_rail_for_a_single_tap_is_kept_at_both_ends(self, low: Library, library: Library) -> None:
        for of in (low, library):
            posing = with_limits({"supply_V": 9.0}, of.posing())
            assert supply_of(posing.problem(of.wanted_of(0, 0), of.stage(0))).copper_C == [25.0, 100.0]


# ---- rail and slew limit where they bind, and where no command keeps them ---------------------------------------


@pytest.fixture(scope="module")
def entry(scene: Scene, references: list[Reference]) -> Maker:
    def make(
        speed_m_s: float = 0.4, grip_N: float = 5.0, feedback: dict[str, Any] | None = None, **limits: float
    ) -> TransientProblem:
        other = with_values(scene, {"feedback": feedback, **{f"limits.{key}": n for key, n in limits.items()}})
        reference = next(r for r in references if r.speed_m_s == speed_m_s)
        return Context(other).posed_as(reference, grip_N).problem

    return make


def cut(problem: TransientProblem, stages: int) -> TransientProblem:
    """The first stages of a problem, without its temperature."""
    wall, limits = problem.wall, problem.limits.without("temperature")
    if "supply" in limits:
        supply = supply_of(problem)
        limits = limits.replaced(replace(supply, nominal_m_s=supply.nominal_m_s[:stages]))
    if wall is not None:
        wall = replace(wall, nominal_m=wall.nominal_m[:stages], pressing=wall.pressing[:stages])
    return replace(
        problem,
        grid=replace(problem.grid, stages=stages, after_stages=0),
        target=Target(problem.reference_m_s2[:stages]),
        terms=(ErrorTerm("plain", np.ones(stages)),),
        limits=limits,
        wall=wall,
    )


class TestBinding:
    def test_the_nominal_motion_comes_in_at_the_stated_speed(self, entry: Maker) -> None:
        for speed in (0.1, 0.4):
            supply = supply_of(entry(speed, supply_V=9.0))
            assert supply.nominal_m_s[0] == pytest.approx(-speed, rel=1e-2)
            assert supply.nominal_V[0] == pytest.approx(-1.25 * speed, rel=1e-2)

    @pytest.mark.parametrize("supply_V", [5.0, 7.0, 9.0])
    def test_it_is_met_and_kept_between_the_instants_too(self, entry: Maker, supply_V: float) -> None:
        """There the back-EMF is left to itself, 1e-3 of the limit being allowed; measured 2e-6."""
        problem = entry(supply_V=supply_V)
        designed = optimum(problem, SolverOptions())
        assert designed.certificate.accepted
        assert designed.certificate.violation("V") <= 1e-9
        reached = played(problem, designed.solution.command).reached["supply"]
        assert supply_V * (1 - 1e-6) <= reached <= supply_V * (1 + 1e-5)

    def test_slew_is_kept(self, entry: Maker) -> None:
        problem = entry(slew_A_per_s=5000.0)
        designed = optimum(problem, SolverOptions())
        assert designed.certificate.accepted
        movement = np.abs(np.diff(designed.solution.command, prepend=0.0))
        assert movement.max() == pytest.approx(0.5, abs=1e-9)
        text = binding_limits(problem, designed.solution.command, designed.solution.multipliers)
        assert "slew +5000 A/s" in text


class TestInfeasible:
    def test_a_rail_below_the_incoming_hands_back_emf(self, scene: Scene, references: list[Reference]) -> None:
        """At 0.4 m/s the motor generates 0.5 V before anything is commanded: 0.3 V cannot hold that."""
        low = with_values(scene, {"limits.supply_V": 0.3})
        (entry,) = design([Context(low).posed_as(references[-1], 5.0)])
        assert entry.status is not Status.OPTIMAL
        (reason,) = entry.shortfalls
        assert reason == "supply 0.2 V over its limit 0.3 V at -0.2 ms by the back-EMF of the incoming stylus alone"

    def test_a_rail_that_no_command_keeps_is_refused_by_name(self, entry: Maker) -> None:
        designed = optimum(cut(entry(supply_V=0.02), 30), SolverOptions())
        assert designed.solution.status is Status.INFEASIBLE
        assert any(text.startswith("supply ") for text in designed.remarks), designed.remarks

    def test_what_the_supplys_sentence_says_is_true(self, entry: Maker) -> None:
        problem = cut(entry(supply_V=0.02), 30)
        (reason,) = infeasibility(problem, SHORT)
        assert reason.startswith("supply ")
        assert " V over its limit 0.02 V at " in reason
        assert reason.endswith(" ms at the least")
        least = 0.02 + float(reason.split(" ")[1])
        for limit, status in ((1.02 * least, True), (0.98 * least, False)):
            moved = with_rail(problem, limit)
            assert is_stationary(moved, solve(moved, SHORT)) is status

    def test_a_slew_that_cannot_follow_the_wall_is_refused_by_name(self, entry: Maker) -> None:
        """The hand-over asks for the wall's command, which moves faster than 50 A/s."""
        wall = {"stiffness_N_m": 500.0, "damping_N_s_m": 5.0}
        designed = optimum(cut(entry(0.4, 3.0, feedback=wall, slew_A_per_s=50.0), 100), SolverOptions())
        assert designed.solution.status is Status.INFEASIBLE
        assert any(text.startswith("slew ") for text in designed.remarks), designed.remarks
