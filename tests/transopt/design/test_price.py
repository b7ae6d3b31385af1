"""What a limit costs: slopes, steps and the limit that is enough, each against solving again."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import pytest

from tests.benches.limits import with_limit, with_numbers, with_rail
from tests.benches.tails import without_tail
from transopt.base.signals import nrmse
from transopt.design.entry import entry_problem, scene_stage
from transopt.design.optimum import Designed, optimum
from transopt.design.price import Price, prices
from transopt.problem.answer import Status
from transopt.problem.heat import Budget
from transopt.problem.limits.supply import SupplyLimit
from transopt.problem.limits.temperature import temperature_limit
from transopt.problem.objective.weighting import pacinian
from transopt.problem.problem import TransientProblem
from transopt.recordings.reference import Reference
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions

HOT_C = 60.0


@dataclass(frozen=True, eq=False)
class Case:
    """One limit of one problem that can be moved; `start` in the limit's own unit."""

    name: str
    problem: TransientProblem
    start: float
    moved: Callable[[TransientProblem, float], TransientProblem]


def moved_current(problem: TransientProblem, bound: float) -> TransientProblem:
    return with_numbers(problem, current_A=bound)


def moved_slew(problem: TransientProblem, bound: float) -> TransientProblem:
    return with_numbers(problem, slew_A_per_s=bound / problem.grid.dt_s)


def moved_supply(problem: TransientProblem, bound: float) -> TransientProblem:
    return with_rail(problem, bound)


def moved_coil(problem: TransientProblem, bound: float) -> TransientProblem:
    thermal = temperature_limit(
        problem.thermal.coil, problem.stage.amplifier, problem.grid, Budget(headroom_K=bound - HOT_C)
    )
    return with_limit(problem, thermal)


@pytest.fixture(scope="module")
def cases(scene: Scene, references: list[Reference]) -> dict[str, Case]:
    """At 0.4 m/s and 5 N, each limit alone: the others are out of the way."""
    data = scene.model_dump()
    data["thermal"].update(start_winding_C=HOT_C, start_housing_C=HOT_C)
    hot = Scene.model_validate(data)
    # Without a tail J is the squared NRMSE but for the movement.
    problem = without_tail(entry_problem(hot, scene_stage(hot, 5.0), references[-1]))
    circuit = scene.circuit()
    assert circuit is not None
    rail = SupplyLimit(9.0, circuit, problem.stage.amplifier.rate_rad_s, references[-1].nominal_velocity_m_s)
    wide = with_numbers(problem, current_A=8.0, command_A=16.0)
    return {
        "current 4 A": Case("current", wide.without("temperature"), 4.0, moved_current),
        "current 2 A": Case("current", wide.without("temperature"), 2.0, moved_current),
        "supply 9 V": Case("supply", with_limit(wide.without("temperature"), rail), 9.0, moved_supply),
        "supply 6 V": Case("supply", with_limit(wide.without("temperature"), rail), 6.0, moved_supply),
        "coil 60.05 C": Case("coil", wide, HOT_C + 0.05, moved_coil),
        "slew 0.5 A/tick": Case("slew", wide.without("temperature"), 0.5, moved_slew),
    }


NAMES = ["current 4 A", "current 2 A", "supply 9 V", "supply 6 V", "coil 60.05 C", "slew 0.5 A/tick"]


def solved(problem: TransientProblem) -> tuple[Designed, float, list[Price]]:
    """The optimum, its NRMSE and its prices."""
    designed = optimum(problem, SolverOptions())
    assert designed.solution.status is Status.OPTIMAL
    assert designed.certificate.accepted
    command = designed.solution.command_A
    error = nrmse(problem.stage.rollout(command)[0], problem.reference_m_s2)
    return (
        designed,
        error,
        prices(problem, command, designed.solution.multipliers, designed.unlimited_command_A, SolverOptions()),
    )


@cache
def solved_at(case: Case, bound: float) -> tuple[Designed, float, list[Price]]:
    return solved(case.moved(case.problem, bound))


@pytest.mark.parametrize("name", NAMES)
def test_slope_against_solving_again(cases: dict[str, Case], name: str) -> None:
    """Two percent up and down; measured within 0.03 % of the difference quotient."""
    case = cases[name]
    _, error, found = solved_at(case, case.start)
    (price,) = found
    assert (price.limit, price.bound) == (case.name, pytest.approx(case.start, rel=1e-9))
    assert price.nrmse == pytest.approx(error, rel=1e-12)
    room = case.start - HOT_C if case.name == "coil" else case.start
    step = 0.02 * room
    up, down = (solved_at(case, case.start + sign * step)[1] for sign in (1, -1))
    assert price.slope == pytest.approx((up - down) / (2 * step), rel=2e-3)


@pytest.mark.parametrize("name", NAMES)
def test_the_sentences_step_against_solving_again(cases: dict[str, Case], name: str) -> None:
    """First order and J is convex, so the gain is overstated, never understated.

    Measured: by 5.1, 0.9, 4.0, 1.0, 8.7 and 18 % of the true gain, in the order of the names. Near the floor that is
    much of what is left: 2.1 % foretold and 2.9 % had at 5 A, 0.5 % and 1.1 % at 11 V.
    """
    case = cases[name]
    _, error, (price,) = solved_at(case, case.start)
    _, truly, _ = solved_at(case, case.start + price.step)
    foretold, had = error - price.then, error - truly
    assert had > 0
    assert had * (1 - 1e-6) <= foretold <= 1.25 * had
    unit = "K" if case.name == "coil" else price.unit
    assert f": {price.step:g} {unit} more: NRMSE {100 * error:.3g} % to {100 * price.then:.3g} %" in price.sentence


def printed_enough(price: Price) -> float:
    """The figure as a user reads it."""
    return float(price.sentence.split("would not bind from ")[1].split(" ")[0])


@pytest.mark.parametrize("name", NAMES)
def test_enough_is_enough_and_slightly_less_is_not(cases: dict[str, Case], name: str) -> None:
    case = cases[name]
    _, _, (price,) = solved_at(case, case.start)
    enough = printed_enough(price)
    assert price.enough <= enough <= price.enough * (1 + 1e-3)
    designed, error, left = solved_at(case, enough)
    assert left == []
    assert error == pytest.approx(designed.floor, rel=1e-9)
    room = price.enough - HOT_C if case.name == "coil" else price.enough
    _, _, short = solved_at(case, price.enough - 5e-3 * room)
    assert [p.limit for p in short] == [case.name]


def test_enough_while_another_limit_binds(scene: Scene, references: list[Reference]) -> None:
    """Current and rail bind together: raised alone to what is said to be enough, each of them lets go."""
    data = scene.model_dump()
    data["limits"]["supply_V"] = 9.0
    both = Scene.model_validate(data)
    problem = entry_problem(both, scene_stage(both, 5.0), references[-1])
    _, _, found = solved(problem)
    by_name = {price.limit: price for price in found}
    assert {"current", "supply"} <= set(by_name)
    for name, moved in (("current", moved_current), ("supply", moved_supply)):
        _, _, left = solved(moved(problem, printed_enough(by_name[name])))
        assert name not in [price.limit for price in left], name


def test_dearest_first_and_nothing_where_nothing_binds(scene: Scene, references: list[Reference]) -> None:
    problem = entry_problem(scene, scene_stage(scene, 5.0), references[-1])
    _, _, found = solved(problem)
    assert found[0].limit == "current"
    assert [p.then for p in found] == sorted(p.then for p in found)
    slow = entry_problem(scene, scene_stage(scene, 3.0), references[1])
    assert solved(slow)[2] == []


def test_no_price_in_nrmse_where_the_objective_is_another(cases: dict[str, Case]) -> None:
    case = cases["current 4 A"]
    weighted = replace(moved_current(case.problem, 4.0), error_filter=pacinian(1e-4))
    designed, _, found = solved(weighted)
    assert designed.solution.multipliers.upper("current").max() > 1e-6
    assert found == []
