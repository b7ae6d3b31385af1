"""What a limit costs: with a step more, and from where on it does not bind, each against solving again."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from tests.benches import dense
from tests.benches.limits import numbers_of, supply_of, with_limit, with_numbers, with_rail
from tests.benches.quick_part import without_slow_part
from tests.benches.tails import without_tail
from transopt.base.writing import percent
from transopt.design.build import Build, build_library
from transopt.design.context import Context
from transopt.design.optimum import optimum
from transopt.design.price import Price, library_prices, price_step, prices
from transopt.problem.answer import Status
from transopt.problem.heat import Budget
from transopt.problem.limits.current import CurrentLimit
from transopt.problem.limits.limit import Limit
from transopt.problem.limits.slew import SlewLimit
from transopt.problem.limits.temperature import temperature_limit
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.target import Target
from transopt.problem.objective.weighting import pacinian
from transopt.problem.problem import TransientProblem
from transopt.proof.designed import Designed
from transopt.recordings.recording import Recording
from transopt.references.reference import Reference
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions

HOT_C = 60.0
POINT = 0.01  # of a percent of tap error


@dataclass(frozen=True, eq=False)
class Case:
    """One limit of one problem that can be moved; `start` in the limit's own unit."""

    name: str
    problem: TransientProblem
    start: float
    moved: Callable[[TransientProblem, float], TransientProblem]


def moved_current(problem: TransientProblem, bound: float) -> TransientProblem:
    return with_numbers(problem, current_A=bound)


def moved_command(problem: TransientProblem, bound: float) -> TransientProblem:
    return with_numbers(problem, command_A=bound)


def moved_slew(problem: TransientProblem, bound: float) -> TransientProblem:
    return with_numbers(problem, slew_A_per_s=bound)


def moved_supply(problem: TransientProblem, bound: float) -> TransientProblem:
    return with_rail(problem, bound)


def moved_coil(problem: TransientProblem, bound: float) -> TransientProblem:
    thermal = temperature_limit(
        problem.thermal.coil, problem.stage.amplifier, problem.grid, Budget(headroom_K=bound - HOT_C)
    )
    return with_limit(problem, thermal)


MOVED = {"current": moved_current, "command": moved_command, "slew": moved_slew, "supply": moved_supply}


def pulse(scene: Scene, reference: Reference, grip_N: float) -> TransientProblem:
    """An entry for the quick part of a tap, of whose J all but the movement is the squared tap error."""
    quick = without_slow_part(reference, scene.time_grid())
    problem = without_tail(Context(scene).posed_as(quick, grip_N).problem)
    plain = ErrorTerm("plain", np.ones(problem.grid.stages))
    return replace(problem, terms=(plain,), intention_s=problem.grid.end_s)


def railed(scene: Scene, reference: Reference, grip_N: float, limit_V: float) -> TransientProblem:
    data = scene.model_dump()
    data["limits"]["supply_V"] = limit_V
    return pulse(Scene.model_validate(data), reference, grip_N)


@pytest.fixture(scope="module")
def cases(scene: Scene, references: list[Reference]) -> dict[str, Case]:
    """At 0.4 m/s and 5 N, each limit alone: the others are out of the way."""
    data = scene.model_dump()
    data["thermal"].update(start_winding_C=HOT_C, start_housing_C=HOT_C)
    hot = Scene.model_validate(data)
    problem = pulse(hot, references[-1], 5.0)
    wide = with_numbers(problem, current_A=8.0, command_A=16.0)
    rail = with_numbers(railed(scene, references[-1], 5.0, 9.0).without("temperature"), current_A=8.0, command_A=16.0)
    return {
        "current 4 A": Case("current", wide.without("temperature"), 4.0, moved_current),
        "current 2 A": Case("current", wide.without("temperature"), 2.0, moved_current),
        "command 3 A": Case("command", wide.without("temperature"), 3.0, moved_command),
        "supply 9 V": Case("supply", rail, 9.0, moved_supply),
        "supply 6 V": Case("supply", rail, 6.0, moved_supply),
        "coil 60.05 C": Case("coil", wide, HOT_C + 0.05, moved_coil),
        "slew 5000 A/s": Case("slew", wide.without("temperature"), 5000.0, moved_slew),
    }


NAMES = ["current 4 A", "current 2 A", "command 3 A", "supply 9 V", "supply 6 V", "coil 60.05 C", "slew 5000 A/s"]


def solved(problem: TransientProblem) -> tuple[Designed, float, list[Price]]:
    """The optimum, its tap error and its prices."""
    designed = optimum(problem, SolverOptions())
    assert designed.solution.status is Status.OPTIMAL
    assert designed.certificate.accepted
    command = designed.solution.command
    error = problem.yardstick.tap_error(problem.target, problem.stage.rollout(command)[0])
    return (
        designed,
        error,
        prices(problem, command, designed.solution.multipliers, designed.unlimited_command, SolverOptions()),
    )


@cache
def solved_at(case: Case, bound: float) -> tuple[Designed, float, list[Price]]:
    return solved(case.moved(case.problem, bound))


@pytest.mark.parametrize("name", NAMES)
def test_a_step_more_is_solved_for(cases: dict[str, Case], name: str) -> None:
    case = cases[name]
    _, error, (price,) = solved_at(case, case.start)
    assert (price.limit, price.bound) == (case.name, pytest.approx(case.start, rel=1e-9))
    assert price.tap_error == pytest.approx(error, rel=1e-12)
    _, truly, _ = solved_at(case, case.start + price.step)
    assert price.then < price.tap_error
    assert price.then == pytest.approx(truly, rel=1e-5)


def test_the_slope_of_an_entry_is_what_a_small_step_buys(build: Build, taps: list[Recording]) -> None:
    """J falls along the multipliers; the second order of so small a step is about half a per cent of it."""
    hardest, step_A = build.entries[3][2], 0.01
    alone = {"grid.speeds_m_s": [0.4], "grid.grips_N": [5.0], "limits.current_A": 4.0 + step_A}
    fast = [tap for tap in taps if abs(tap.speed_m_s / 0.4 - 1) < 0.1]
    [[wider]] = build_library(with_values(build.scene, alone), fast).entries
    bought = hardest.certificate.objective - wider.certificate.objective
    assert set(hardest.slopes) == {"current", "command"}
    assert bought == pytest.approx(hardest.slopes["current"] * step_A, rel=0.01)
    assert build.entries[0][0].slopes == {}


@pytest.mark.parametrize(
    "asked",
    [
        {"weights.objective": "intensity"},
        {"robust.grip_spread": 0.2, "robust.samples": 3, "robust.minimise": "worst"},
    ],
    ids=["intensity", "worst"],
)
def test_where_the_objective_takes_a_search_another_limit_has_its_own(
    scene: Scene, taps: list[Recording], asked: dict[str, object]
) -> None:
    """A wider limit changes the price of intensity, and the worst of the devices, at 0.4 m/s and 5 N.

    The energy is met within 0.01 dB, which leaves the error some hundredths of a percent.
    """
    fast = [tap for tap in taps if abs(tap.speed_m_s / 0.4 - 1) < 0.1]
    place = with_values(scene, {"grid.speeds_m_s": [0.4], "grid.grips_N": [5.0], **asked})

    def at(limit_A: float) -> Build:
        return build_library(with_values(place, {"limits.current_A": limit_A}), fast)

    now = at(4.0)
    [price] = [each for each in now.entries[0][0].prices if each.limit == "current"]
    for limit_A, told in ((price.bound + price.step, price.then), (price.enough, price.there)):
        [[truly]] = at(limit_A).entries
        assert told == pytest.approx(truly.figures.tap_error, abs=1e-3)
    assert "current" not in truly.slopes
    [again] = [each for each in library_prices(now.library, 0, 0) if each.limit == "current"]
    assert (again.then, again.there) == pytest.approx((price.then, price.there), abs=1e-3)


def test_limits_along_a_command(build: Build) -> None:
    hardest = build.entries[3][2]
    own = {box.limit.name: box for box in hardest.boxes()}
    assert own["current"].peak == pytest.approx(4.0, abs=1e-6)
    assert own["current"].by_upper.sum() > 0
    doubled = {box.limit.name: box for box in hardest.boxes(2 * hardest.solution.command)}
    assert doubled["current"].excess.max() == pytest.approx(4.0, abs=1e-6)
    assert not doubled["current"].by_upper.any()


def last_digit(rise: float) -> float:
    """One of the second digit of the rise to a sufficient bound, to which it is rounded up."""
    return float(10.0 ** (np.floor(np.log10(rise)) - 1))


@pytest.mark.parametrize("name", NAMES)
def test_at_what_is_enough_it_does_not_bind_and_just_below_it_does(cases: dict[str, Case], name: str) -> None:
    case = cases[name]
    _, _, (price,) = solved_at(case, case.start)
    assert f"% from {price.enough:.8g} " in price.sentence
    designed, error, left = solved_at(case, price.enough)
    assert left == []
    assert error == pytest.approx(designed.floor, rel=1e-6)
    assert price.there == pytest.approx(error, rel=1e-6)
    # A limit that one step of all meets hardly binds.
    _, _, short = solved_at(case, price.enough - 1.1 * last_digit(price.enough - case.start))
    assert [p.limit for p in short] == [case.name]


def test_where_several_bind_the_others_stay_in_force(scene: Scene, references: list[Reference]) -> None:
    """Rail and current bind together: raised alone to what is said to be enough, each of them lets go."""
    problem = railed(scene, references[-1], 5.0, 11.0)
    _, _, found = solved(problem)
    by_name = {price.limit: price for price in found}
    assert {"current", "supply"} <= set(by_name)
    for name, price in by_name.items():
        _, error, left = solved(MOVED[name](problem, price.enough))
        assert name not in [each.limit for each in left]
        assert error == pytest.approx(price.there, rel=1e-6)
        assert left, "without any limit that binds the error would be the floor"
        _, _, short = solved(MOVED[name](problem, price.enough - 1.1 * last_digit(price.enough - price.bound)))
        assert name in [each.limit for each in short]


def drawn(scene: Scene, references: list[Reference], seed: int) -> tuple[TransientProblem, dense.Rail | None]:
    """An entry of the default scene cut to 10 ms, its limits by lot, and its rail in plain numbers."""
    lot, N = np.random.default_rng(seed), 100
    grip, limit_A = float(lot.uniform(1.0, 5.0)), float(lot.uniform(1.2, 4.0))
    volts = 2.8 * limit_A * float(lot.uniform(0.8, 1.2))  # hot copper has 2.8 ohm
    reference = references[int(lot.integers(2, 4))]
    problem = railed(scene, reference, grip, volts).without("temperature")
    nominal = reference.nominal_velocity_m_s[:N]
    limits = problem.limits.replaced(replace(supply_of(problem), nominal_m_s=nominal))
    limits = numbers_of(
        limits,
        problem.grid.dt_s,
        current_A=limit_A,
        command=float(lot.uniform(2.0, 8.0)),
        slew_A_per_s=float(lot.uniform(3e3, 2e4)) if lot.random() < 0.5 else None,
    )
    with_rail = lot.random() < 0.6
    problem = replace(
        problem,
        grid=replace(problem.grid, stages=N),
        intention_s=problem.grid.end_s,
        target=Target(problem.reference_m_s2[:N]),
        terms=(ErrorTerm("plain", np.ones(N)),),
        limits=limits if with_rail else limits.without("supply"),
    )
    motor, emf = scene.motor, scene.motor.kt_Nm_A * scene.transmission.ratio_1_m
    hot_ohm = motor.R_ohm * (1 + 0.0039 * (motor.winding_max_C - 25.0))
    rail = dense.Rail(volts, (motor.R_ohm, hot_ohm), motor.L_H, scene.amplifier.pole_Hz, emf, nominal)
    return problem, rail if with_rail else None


def by_dense(problem: TransientProblem, rail: dense.Rail | None, name: str, bound: float) -> dense.Limited:
    """The dense optimum with one limit at a bound."""
    slew = problem.limits.get("slew")
    step_A = None if slew is None else slew.stated
    if name == "slew":
        step_A = bound * problem.grid.dt_s
    elif name == "supply":
        assert rail is not None
        rail = replace(rail, limit_V=bound)
    else:
        problem = MOVED[name](problem, bound)
    return dense.limited(problem, step_A, rail)


# Every combination of binding limits that 30 seeds draw; the others repeat one of them.
EACH_COMBINATION = (0, 3, 7, 10, 12, 13, 23)


@pytest.mark.parametrize(
    "seed",
    [pytest.param(seed, marks=[] if seed in EACH_COMBINATION else pytest.mark.long) for seed in range(30)],
)
def test_against_an_independent_dense_program(scene: Scene, references: list[Reference], seed: int) -> None:
    """Every figure of every price of an entry drawn by lot; measured 3e-5 points at the most."""
    problem, rail = drawn(scene, references, seed)
    _, error, found = solved(problem)
    assert found
    for price in found:
        name, bound = price.limit, price.bound
        now = by_dense(problem, rail, name, bound)
        assert 100 * abs(now.tap_error - error) <= POINT
        scale = next(limit for limit in problem.limits if limit.label == name).key_scale
        assert scale * now.reached[name] == pytest.approx(bound, rel=1e-6)
        then = by_dense(problem, rail, name, bound + price.step)
        assert 100 * abs(price.then - then.tap_error) <= POINT
        free = by_dense(problem, rail, name, price.enough)
        assert 100 * abs(price.there - free.tap_error) <= POINT
        # What is enough is not reached, or more of it buys nothing; and what is little less is reached.
        if not scale * free.reached[name] < price.enough * (1 - 1e-6):
            more = by_dense(problem, rail, name, price.enough * 1.01)
            assert 100 * (free.tap_error - more.tap_error) <= POINT / 100
        less = price.enough - 1.1 * last_digit(price.enough - price.bound)
        assert scale * by_dense(problem, rail, name, less).reached[name] == pytest.approx(less, rel=1e-6)


class TestSteps:
    @pytest.mark.parametrize(
        ("limit", "step"),
        [
            (CurrentLimit(4.0), 1.0),
            (CurrentLimit(1.0), 1.0),
            (CurrentLimit(0.9), 0.2),
            (CurrentLimit(0.05), 0.01),
            (SlewLimit(1e4, 1e-4), 0.2),
        ],
    )
    def test_that_of_the_kind_or_a_share(self, limit: Limit, step: float) -> None:
        assert price_step(limit) == pytest.approx(step, rel=1e-12)

    def test_ten_kelvin_where_there_are_as_many(self, cases: dict[str, Case]) -> None:
        case = cases["coil 60.05 C"]
        assert price_step(case.problem.thermal) == pytest.approx(10.0)
        assert price_step(case.moved(case.problem, HOT_C + 0.05).thermal) == pytest.approx(0.01)
        assert price_step(supply_of(cases["supply 9 V"].problem)) == pytest.approx(1.0)


class TestWords:
    def test_a_sentence_says_what_was_solved(self, cases: dict[str, Case]) -> None:
        case = cases["current 4 A"]
        _, error, (price,) = solved_at(case, 4.0)
        assert price.sentence == (
            f"current 4 A: tap error {percent(error)} %, {percent(price.then)} % at 5 A, "
            f"{percent(price.there)} % from {price.enough:.8g} A on, where it no longer binds"
        )
        rise = price.enough - price.bound
        assert rise == pytest.approx(float(f"{rise:.2g}"), rel=1e-9)  # as a person would write it

    def test_an_answer_that_is_not_certified_gives_no_price(self, cases: dict[str, Case]) -> None:
        # Two limits bind, so that no optimum without one of them is that without any.
        problem = moved_command(moved_current(cases["current 2 A"].problem, 2.0), 3.0)
        designed, _, _ = solved(problem)
        answer, in_vain = designed.solution, SolverOptions(max_iterations=1)
        found = prices(problem, answer.command, answer.multipliers, designed.unlimited_command, in_vain)
        assert {price.limit for price in found} == {"current", "command"}
        for price in found:
            assert np.isnan(price.then)
            assert np.isnan(price.enough)
            assert price.sentence == (
                f"{price.stated}: tap error {percent(price.tap_error)} %, no certified answer at "
                f"{price.bound + 1:.8g} A and so no price, not certified from where on it no longer binds"
            )

    def test_what_one_linear_solve_finds_needs_no_iterations(self, cases: dict[str, Case]) -> None:
        case = cases["current 4 A"]
        designed, _, (price,) = solved_at(case, 4.0)
        problem, answer = case.moved(case.problem, 4.0), designed.solution
        in_vain = SolverOptions(max_iterations=1)
        (without,) = prices(problem, answer.command, answer.multipliers, designed.unlimited_command, in_vain)
        assert np.isnan(without.then)
        assert without.enough == price.enough
        assert without.there == price.there

    def test_a_limit_that_always_binds_says_up_to_where(self) -> None:
        price = Price("current", "A", "A", 4.0, 0.2, 1.0, 0.18, np.inf, np.nan, 120.0)
        assert price.sentence.endswith(", still binds at 120 A")


def test_dearest_first_and_nothing_where_nothing_binds(scene: Scene, references: list[Reference]) -> None:
    problem = Context(scene).posed_as(references[-1], 5.0).problem
    _, _, found = solved(problem)
    assert [p.limit for p in found] == ["current", "command"]
    assert found[0].then < found[1].then
    slow = Context(scene).posed_as(references[1], 3.0).problem
    assert solved(slow)[2] == []


def test_where_errors_are_weighed_the_plain_one_is_told(cases: dict[str, Case]) -> None:
    """J is another figure then, and what more would buy of it may cost something of this one."""
    case = cases["current 4 A"]
    rapid = replace(case.problem.terms[0], error_filter=pacinian(1e-4))
    weighted = replace(moved_current(case.problem, 4.0), terms=(rapid,))
    _, error, (price,) = solved(weighted)
    _, truly, _ = solved(moved_current(weighted, 5.0))
    assert price.tap_error == pytest.approx(error, rel=1e-12)
    assert price.then == pytest.approx(truly, rel=1e-5)
