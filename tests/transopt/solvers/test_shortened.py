"""The search over the stages before a cut: the answer of the whole search wherever no limit binds later."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import problems
from tests.benches.limits import aiming_in_window, with_numbers
from transopt.design.context import Context
from transopt.library.library import Library
from transopt.plant.wall import reference_course
from transopt.problem.answer import OBJECTIVE_SCALE
from transopt.problem.leave_out import leave_out
from transopt.problem.problem import TransientProblem
from transopt.problem.wall_ticks import pressing
from transopt.proof.certify import certify
from transopt.proof.effect import Effect
from transopt.scene.keys import with_values
from transopt.scene.recordings import recordings_of
from transopt.solvers import riccati
from transopt.solvers.native import extension
from transopt.solvers.options import SolverOptions, TrialOptions
from transopt.solvers.prove import certified
from transopt.solvers.stage_data import Stages, stages

pytestmark = pytest.mark.skipif(not extension.available, reason="the extension is not built")

TOLERANCE = 1e-9
ANSWERED = (extension.SOLVED, extension.ACCURACY)
SCENES = [
    path.stem
    for path in sorted((Path(problems.__file__).parent / "scenes").glob("*.toml"))
    if path.stem != "measured_impacts"
]


def answer(problem: TransientProblem, cut: int) -> extension.Answer:
    (found,) = extension.interior_points([stages(problem)], tolerance=TOLERANCE, max_iterations=60, cut=cut)
    return found


def last_bound(found: extension.Answer) -> int:
    """The last stage with a multiplier of a limit."""
    return int(np.flatnonzero((found.upper + found.lower).max(axis=1, initial=0.0) > 1e-7).max(initial=0))


@pytest.fixture(scope="module")
def saturated(library: Library) -> TransientProblem:
    """The fastest and firmest tap of the default scene, whose current is saturated early, with all its limits."""
    return library.problem(3, 2).without("temperature")


@pytest.mark.parametrize("beyond", [3, 40, 300])
def test_the_answer_is_that_of_the_whole_search(saturated: TransientProblem, beyond: int) -> None:
    whole = answer(saturated, 0)
    cut = last_bound(whole) + beyond
    short = answer(saturated, cut)
    assert short.code in ANSWERED
    assert short.objective == pytest.approx(whole.objective, abs=4 * TOLERANCE * max(whole.objective, 1.0))
    np.testing.assert_allclose(short.command, whole.command, atol=1e-4)
    # The multipliers of the hand-over are those of the whole problem, which the certificate needs.
    given = stages(saturated)
    multipliers = given.multipliers(short.upper - short.lower, short.gradient)
    assert not any(side[cut:].any() for pair in multipliers.pairs.values() for side in pair)
    command = given.command(short.command)
    for proof in (certified(saturated, command, multipliers), certify(saturated, command, multipliers)):
        assert proof.accepted
        assert proof.relative_gap < 1e-7


def test_a_search_is_lengthened_until_it_leaves_no_limit(saturated: TransientProblem) -> None:
    """Taps whose limits bind early and late share the longer searches: the answers of one over all stages."""
    limits = saturated.limits.input_limit * np.random.default_rng(9).permutation(np.linspace(1.0, 0.4, 19))
    given = [stages(with_numbers(saturated, current_A=limit)) for limit in limits]
    found = extension.interior_points(given, tolerance=TOLERANCE, max_iterations=60)
    assert min(map(last_bound, found)) < saturated.grid.stages // 8
    assert max(map(last_bound, found)) > saturated.grid.stages // 4
    for each, own in zip(given, found, strict=True):
        whole = answer(each.problem, saturated.free_stages)
        assert own.objective == pytest.approx(whole.objective, rel=TOLERANCE)
        command = each.command(own.command)
        multipliers = each.multipliers(own.upper - own.lower, own.gradient)
        proof = certify(each.problem, command, multipliers)
        assert proof.accepted
        assert proof.relative_gap < 1e-8


@pytest.mark.parametrize("first", [1, 20, 150, 450, 700])
def test_where_a_search_begins_does_not_change_its_answer(saturated: TransientProblem, first: int) -> None:
    """Too few stages are lengthened; too many take longer."""
    given = [stages(with_numbers(saturated, current_A=limit)) for limit in (1.0, 4.0, 4.0)]
    asked = {"tolerance": TOLERANCE, "max_iterations": 60}
    whole = [answer(each.problem, each.problem.free_stages) for each in given]
    found = extension.interior_points(given, **asked, first=[first, first, 0])
    for each, own, expected in zip(given, found, whole, strict=True):
        assert own.code in ANSWERED
        assert own.objective == pytest.approx(expected.objective, rel=TOLERANCE)
        multipliers = each.multipliers(own.upper - own.lower, own.gradient)
        proof = certify(each.problem, each.command(own.command), multipliers)
        assert proof.accepted
        assert proof.relative_gap < 1e-8
    # A multiplier is written where its limit is stated, also where it does not bind.
    stated = [int(np.flatnonzero((own.upper + own.lower).any(axis=1)).max()) for own in found]
    assert stated[2] < given[2].sizes["stages"] // 4
    assert stated[1] >= max(first - 2, stated[2])


def test_a_trial_begins_where_limits_bound_under_the_next_limits_before(
    saturated: TransientProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = list[list[int]]()

    def noted(given: list[Stages], *, first: list[int], **asked: Any) -> list[extension.Answer]:
        begun.append(first)
        return extension.interior_points(given, first=first, **asked)

    monkeypatch.setattr(riccati, "interior_points", noted)
    trial, late = TrialOptions("riccati"), with_numbers(saturated, current_A=1.0)
    between = with_numbers(saturated, current_A=(1.0 + saturated.limits.input_limit) / 2)
    for problem in (late, late, saturated, saturated, between, late):
        riccati.solve([problem], trial)
    of_late, of_saturated = (last_bound(answer(problem, 0)) for problem in (late, saturated))
    assert of_saturated < of_late
    begins = [first for (first,) in begun]
    assert begins[0] == 0  # nothing is known yet
    for first, last in zip(begins[1:], (of_late, of_late, of_saturated, of_late, of_late), strict=True):
        assert abs(first - last) < 8  # the last multipliers are small, and those of a short search end earlier
    riccati.solve([aiming_in_window(saturated, 2 * saturated.reference_m_s2)], trial)
    riccati.solve([late], SolverOptions("riccati"))
    assert begun[-2:] == [[0], []]


def test_a_limit_that_binds_after_the_cut_is_left_and_not_certified(saturated: TransientProblem) -> None:
    cut = 4
    assert last_bound(answer(saturated, 0)) > 2 * cut
    short, given = answer(saturated, cut), stages(saturated)
    command = given.command(short.command)
    multipliers = given.multipliers(short.upper - short.lower, short.gradient)
    assert not certified(saturated, command, multipliers).accepted
    late = np.abs(Effect(saturated, command).motion.plant_input[cut:])
    assert late.max() > 1.01 * saturated.limits.input_limit


def test_where_the_cut_takes_the_digits_all_stages_are_searched() -> None:
    """A window of 40 ms at a servo period of 2 us: the rest's cost has lost what the certificate asks for."""
    scene = with_values(
        problems.load("wood_on_foam"), {"time.dt_s": 2e-6, "time.stages": 20000, "weights.after_s": 1e-3}
    )
    problem = leave_out(Context.recorded(scene, recordings_of(scene)).posed(0.4, 1.0).problem).problem
    assert "temperature" not in problem.limits
    cut = 2 * problem.grid.stages // 8
    short, (own,) = answer(problem, cut), riccati.solve([problem], SolverOptions())
    assert last_bound(short) < cut
    given = stages(problem)
    multipliers = given.multipliers(short.upper - short.lower, short.gradient)
    assert certify(problem, given.command(short.command), multipliers).relative_gap > 1e-6
    assert certify(problem, own.command, own.multipliers).relative_gap < 2e-7


def test_a_binding_temperature(library: Library) -> None:
    coil = library.coil()
    assert coil is not None
    # A cold housing cools the winding, so that its limit binds early.
    hot = replace(library.posing(), coil=replace(coil, start_winding_C=coil.limit_C - 0.03))
    problem = hot.problem(library.wanted_of(3, 2), library.stage(2))
    whole = answer(problem, 0)
    winding = stages(problem).limits.kinds.index("winding")
    assert whole.upper[:, winding].max() > 1e-3
    cut = int(np.flatnonzero(whole.upper[:, winding] > 1e-4 * whole.upper[:, winding].max()).max()) + 30
    assert cut < problem.free_stages // 2
    short = answer(problem, cut)
    assert short.code in ANSWERED
    assert short.objective == pytest.approx(whole.objective, rel=1e-7)
    np.testing.assert_allclose(short.command, whole.command, atol=2e-4)


@pytest.mark.parametrize("name", SCENES)
def test_every_scene(name: str) -> None:
    """Other states: stiff drives, a wall, an ideal amplifier, voltages, named targets, temperatures, three motors."""
    scene = problems.load(name)
    context, (speed_m_s, target) = Context.recorded(scene, recordings_of(scene)), scene.axes.rows[-1]
    problem = context.posed(speed_m_s, scene.grid.grips_N[-1], target).problem
    if problem.wall is not None:
        problem = pressing(problem, reference_course(problem.grid, problem.target.continued_m_s2))
    if problem.thermal is not None and problem.thermal.period_s is not None:
        assert answer(problem, 20).code not in ANSWERED  # taps that repeat are left to the whole search
        problem = problem.without("temperature")
    whole = answer(problem, 0)
    cut = min(last_bound(whole) + 20, problem.free_stages)
    short, given = answer(problem, cut), stages(problem)
    assert short.code in ANSWERED
    command = given.command(short.command)
    proof = certified(problem, command, given.multipliers(short.upper - short.lower, short.gradient))
    assert proof.is_stationary
    assert proof.objective == pytest.approx(whole.objective * OBJECTIVE_SCALE, rel=1e-6, abs=1e-9)


def test_a_cut_in_the_hand_over_is_refused(saturated: TransientProblem) -> None:
    assert answer(saturated, saturated.free_stages).code in ANSWERED
    assert answer(saturated, saturated.free_stages + 1).code not in ANSWERED


def test_what_is_not_finite_is_no_answer(saturated: TransientProblem) -> None:
    given = stages(saturated)
    for name in ("reference", "A", "end_gain"):
        array = given.arrays[name].copy()
        array.flat[array.size // 2] = np.nan
        broken = replace(given, arrays=given.arrays | {name: array})
        (found,) = extension.interior_points([broken], tolerance=TOLERANCE, max_iterations=60, cut=50)
        assert found.code not in ANSWERED
