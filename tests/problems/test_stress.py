"""The stress suite in its short form, and its judge: what is not proven must come out as bad."""

import os
import time
from dataclasses import replace

import numpy as np
import pytest

from problems.stress.__main__ import LIMIT_S
from problems.stress.cases import StressCase
from problems.stress.draw import drawn
from problems.stress.families import SMALL_A, directed, rescaled
from problems.stress.judge import CERTIFIED, WITHOUT_FLOOR, Outcome, judge, judge_design, played
from problems.stress.oracle import Verdict, admits_a_command
from problems.stress.parts import Coil, Current, Demand, DrawnDevice, Horizon, Surface
from problems.stress.run import run_cases, summary
from tests.benches.commands import Terminal, assert_refused
from transopt.design.optimum import optimum
from transopt.problem.answer import Certificate, Status
from transopt.proof.certify import admissible, movement_bound, reduced_gradient
from transopt.proof.designed import Designed
from transopt.proof.effect import Effect
from transopt.proof.replay import Samples
from transopt.solvers.choose import prove
from transopt.solvers.options import SolverOptions

SATURATED = StressCase("saturated", current=Current(limit_A=SMALL_A), horizon=Horizon(stages=40))
STARVED = StressCase("starved", current=Current(supply=0.01, limit_A=1.0))  # less than its back-EMF
SHORT = 40  # stages, of the random cases that run here
# Refused for their hand-over at a wall: eight remedies are played through the contact, for six seconds each.
LONG_REMEDIES = {35, 52}


@pytest.fixture(scope="module")
def designed() -> Designed:
    return optimum(SATURATED.problem(), SolverOptions())


def families() -> list[str]:
    return sorted({case.family for case in directed()})


@pytest.mark.parametrize("family", families())
def test_every_named_extreme_is_certified_or_refused_by_name(family: str) -> None:
    for case in directed():
        if case.family == family and case.horizon.stages <= 100:
            outcome = judge(case)
            assert not outcome.bad, f"{case}: {outcome.kind}: {outcome.detail}"
            assert family != "input" or outcome.kind.startswith("refused: input")
            assert not outcome.gap > Certificate.GAP_TOLERANCE


def test_random_cases_are_certified_or_refused_by_name() -> None:
    indices = [index for index in range(60) if index not in LONG_REMEDIES]
    cases = [case for case in (drawn(0, index) for index in indices) if case.horizon.stages <= SHORT]
    assert len(cases) > 20
    outcomes = [judge(case) for case in cases]
    assert not [f"{case}: {outcome}" for case, outcome in zip(cases, outcomes, strict=True) if outcome.bad]
    assert sum(outcome.kind == CERTIFIED for outcome in outcomes) > len(cases) / 2


def test_a_tap_that_has_faded_where_it_counts_ends_by_its_own_cause() -> None:
    """The ringing of 50 ms after contact: no answer to it has digits, and no wider limit gives it any."""
    faded = Demand(speed_m_s=0.26, weights="late")
    late = Horizon(dt_s=1.8e-4, stages=600)
    assert judge(StressCase("faded", horizon=late, demand=faded)).kind == CERTIFIED
    starved = judge(StressCase("faded", current=Current(supply=0.1, limit_A=0.1), horizon=late, demand=faded))
    assert starved.kind == "refused: INFEASIBLE"
    assert starved.detail.endswith(" V would do")


def test_a_spread_of_devices_is_drawn_for_its_mean_and_for_its_worst() -> None:
    several = [case for case in (drawn(5, index) for index in range(200)) if case.spread is not None]
    assert {case.spread.worst for case in several if case.spread is not None} == {True, False}
    assert any(case.actuator is not None for case in several)
    small = [case for case in several if case.horizon.stages <= SHORT]
    outcomes = [judge(case) for case in small]
    assert not [f"{case}: {outcome}" for case, outcome in zip(small, outcomes, strict=True) if outcome.bad]
    assert sum(outcome.kind == CERTIFIED for outcome in outcomes) > len(small) / 2


def test_a_search_for_intensity_is_not_thrown_off_by_energies_that_are_nearly_alike() -> None:
    """Two answers point to a price far below zero, whose exponential no double holds."""
    assert judge(drawn(28112026, 901)).kind == CERTIFIED


def test_states_that_grow_beyond_all_numbers_within_a_servo_period_give_no_warning() -> None:
    """The bound on what an output does between two instants is infinite then."""
    assert judge(drawn(777000111, 860)).kind == CERTIFIED


def test_the_certificate_of_the_worst_device_is_as_sharp_as_that_of_the_mean() -> None:
    """States in microunits: summed in double precision the gradient alone leaves more than a certificate may."""
    assert judge(drawn(90817263, 71)).kind == CERTIFIED


def test_an_optimum_without_limits_that_no_method_finds_leaves_the_floor_unknown() -> None:
    """No weight of the movement, and a price on heat alone: the sparse system answers with 1e287 A."""
    assert judge(drawn(90817263, 311)).kind == WITHOUT_FLOOR


@pytest.mark.parametrize(("seed", "index"), [(5, 645), (8112001, 298)])
def test_the_worst_of_devices_that_are_nearly_alike_is_found(seed: int, index: int) -> None:
    """Their losses differ by a ten-thousandth or less: the search over the shares has hardly a slope to follow."""
    outcome = judge(drawn(seed, index))
    assert outcome.kind == CERTIFIED
    assert outcome.gap < Certificate.GAP_TOLERANCE


def test_another_method_takes_arrays_in_any_order() -> None:
    """The compiled pass leaves a gap, and arrays of a spread stand column by column."""
    assert judge(drawn(6, 333)).kind == "refused: INFEASIBLE"


@pytest.mark.parametrize("times", [1.0, 5.0])
def test_a_proof_does_not_hang_on_the_last_bits(times: float) -> None:
    """Masses of 1.5 mg over ticks of 0.8 ms, where rounding makes all of the gradient that is left.

    Times the size of the commands the gradient's last bits alone are about as much as a gap may be, more on one
    processor and less on another. By the curvature of the movement they are worth a thirtieth of it or less.
    """
    case = drawn(1, 204)
    problem = replace(case, current=replace(case.current, limit_A=times * case.current.limit_A)).problem()
    found = optimum(problem, SolverOptions())
    assert found.solution.status is Status.OPTIMAL
    assert found.certificate.accepted
    effect = Effect(found.problem, found.solution.command)
    left = reduced_gradient(effect, admissible(found.problem, found.solution.multipliers))
    assert movement_bound(found.problem, left) < 0.2 * Certificate.GAP_TOLERANCE * found.certificate.objective


def test_a_case_follows_from_seed_and_index_alone() -> None:
    forwards = [drawn(7, index) for index in range(20)]
    assert forwards == [drawn(7, index) for index in range(19, -1, -1)][::-1]
    assert len({str(case) for case in forwards}) == 20
    assert drawn(8, 3) != drawn(7, 3)


@pytest.mark.parametrize("units", [1e-6, 1e-3, 1e3, 1e6])
@pytest.mark.parametrize("limit_A", [SMALL_A, 1e-6])
def test_the_same_problem_in_other_units_has_the_same_command(units: float, limit_A: float) -> None:
    case = StressCase("units", DrawnDevice(mode_Hz=2e3), Current(limit_A=limit_A), Horizon(stages=60))
    own, other = (optimum(c.problem(), SolverOptions()) for c in (case, rescaled(case, units)))
    assert own.certificate.accepted
    assert other.certificate.accepted
    off = np.abs(own.solution.command - other.solution.command).max()
    assert off <= 1e-6 * limit_A
    assert other.certificate.objective == pytest.approx(own.certificate.objective, rel=1e-9)


def test_a_small_limit_is_held_as_exactly_as_a_large_one() -> None:
    """A microampere over a limit of a microampere is twice the limit."""
    case = StressCase("limit", current=Current(limit_A=1e-6), horizon=Horizon(stages=40), demand=Demand(rho=0.0))
    found = optimum(case.problem(), SolverOptions())
    assert found.certificate.accepted
    over = found.solution.command * (1 + 1e-3)
    assert not prove(found.problem, over, found.solution.multipliers, SolverOptions()).accepted


class TestJudge:
    def judged(self, designed: Designed, command_A: np.ndarray) -> Outcome:
        proof = prove(designed.problem, command_A, designed.solution.multipliers, SolverOptions())
        changed = replace(designed, solution=replace(designed.solution, command=command_A), certificate=proof)
        return judge_design(changed, played(designed.problem, np.nan_to_num(command_A)))

    def test_accepts_what_is_right(self, designed: Designed) -> None:
        outcome = self.judged(designed, designed.solution.command)
        assert outcome.kind == CERTIFIED
        assert outcome.gap <= 1e-6
        assert outcome.difference <= 1e-6

    def test_a_perturbed_answer_is_bad(self, designed: Designed) -> None:
        off = designed.solution.command.copy()
        off[10] -= 0.01
        assert self.judged(designed, off).kind == "bad: NOT_CERTIFIED"

    def test_a_flipped_multiplier_is_bad(self, designed: Designed) -> None:
        m = designed.solution.multipliers
        flipped = m.with_pair("current", m.upper("current"), m.lower("current"))
        solution = replace(designed.solution, multipliers=flipped)
        proof = prove(designed.problem, solution.command, flipped, SolverOptions())
        outcome = judge_design(
            replace(designed, solution=solution, certificate=proof), played(designed.problem, solution.command)
        )
        assert outcome.kind == "bad: NOT_CERTIFIED"

    def test_a_command_that_is_no_number_is_bad(self, designed: Designed) -> None:
        off = designed.solution.command.copy()
        off[3] = np.nan
        assert self.judged(designed, off).bad

    def test_a_figure_that_is_no_number_is_bad(self, designed: Designed) -> None:
        run = played(designed.problem, designed.solution.command)
        assert judge_design(replace(designed, floor=float("nan")), run).kind == WITHOUT_FLOOR
        assert judge_design(replace(designed, floor=float("inf")), run).kind == "bad: NaN"
        assert judge_design(designed, replace(run, peak_input=float("nan"))).bad

    def test_another_replay_is_bad(self, designed: Designed) -> None:
        run = played(designed.problem, designed.solution.command)
        courses = run.samples.courses
        other = courses._replace(accelerations_m_s2=courses.accelerations_m_s2 * (1 + 1e-5))
        off = replace(run, samples=Samples(lambda: other))
        assert judge_design(designed, off).kind == "bad: REPLAY_VIOLATION"

    @pytest.mark.parametrize("status", [Status.NUMERICAL_FAILURE, Status.ITERATION_LIMIT, Status.INFEASIBLE])
    def test_a_refusal_without_a_cause_is_bad(self, designed: Designed, status: Status) -> None:
        refused = replace(designed, solution=replace(designed.solution, status=status))
        outcome = judge_design(refused, played(designed.problem, designed.solution.command))
        assert outcome.kind == f"bad: {status.name}"

    def test_a_false_claim_that_nothing_is_feasible_is_bad(self, designed: Designed) -> None:
        refused = replace(
            designed,
            solution=replace(designed.solution, status=Status.INFEASIBLE),
            remarks=["current 0.5 A over its limit 0.3 A at 1.0 ms at the least; 0.8 A would do"],
        )
        outcome = judge_design(refused, played(designed.problem, designed.solution.command))
        assert outcome.kind == "bad: feasible after all"

    def test_warnings_and_exceptions_are_bad(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def divides(*_: object, **__: object) -> None:
            np.ones(1) / np.zeros(1)

        def breaks(*_: object, **__: object) -> None:
            raise KeyError("x")

        for broken, kind in ((divides, "bad: RuntimeWarning"), (breaks, "bad: KeyError")):
            monkeypatch.setattr("problems.stress.judge.design", broken)
            assert judge(SATURATED).kind == kind

    def test_the_oracle_sees_both_ways(self) -> None:
        assert admits_a_command(SATURATED.problem()).way_out
        assert admits_a_command(STARVED.problem()) == Verdict("", decided=True)

    def test_a_claim_that_the_linear_program_cannot_decide_has_a_line_of_its_own(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        assert judge(STARVED).kind == "refused: INFEASIBLE"
        monkeypatch.setattr("problems.stress.oracle.LONGEST_S", 0.0)
        assert admits_a_command(STARVED.problem()) == Verdict("", decided=False)
        assert judge(STARVED).kind == "refused: INFEASIBLE, unchecked"

    def test_a_linear_limit_that_is_blamed_has_to_fail_without_the_temperature(self) -> None:
        walled = StressCase("wall", horizon=Horizon(stages=SHORT), coil=Coil(), surface=Surface(200.0)).problem()
        assert admits_a_command(walled) == Verdict("", decided=False)
        assert "to spare" in admits_a_command(walled, ignoring_heat=True).way_out
        found = optimum(walled, SolverOptions())
        kinds = {}
        for limit in ("current 0.5 A over its limit 0.3 A", "coil 0.5 K over its limit 100 C"):
            refused = replace(found.solution, status=Status.INFEASIBLE)
            claim = replace(found, solution=refused, remarks=[f"{limit} at 1.0 ms at the least; 0.8 would do, raise"])
            kinds[limit[:4]] = judge_design(claim, played(found.problem, found.solution.command)).kind
        assert kinds == {"curr": "bad: feasible after all", "coil": "refused: INFEASIBLE, unchecked"}

    def test_no_current_heats_less_than_the_ripple(self) -> None:
        warm = StressCase("start", horizon=Horizon(stages=SHORT), coil=Coil(below_K=1e-6)).problem()
        model = replace(warm.thermal.model, headroom_K=np.full_like(warm.thermal.model.headroom_K, -1.0))
        hot = warm.replaced(replace(warm.thermal, model=model))
        assert admits_a_command(hot) == Verdict("", decided=True)


def fails(case: StressCase) -> Outcome:
    while case.family == "hang":
        time.sleep(0.1)
    if case.family == "die":
        os._exit(3)
    if case.family == "print":
        os.write(2, b"a library says so\n")
    return fine(case)


def fine(_: StressCase) -> Outcome:
    return Outcome(CERTIFIED, "", 0.0, 0.0, 0.0)


def test_the_runner_goes_on_after_a_worker_that_fails() -> None:
    cases = [StressCase(name) for name in ("one", "print", "two", "die", "three")]
    outcomes = dict(run_cases(cases, 1, LIMIT_S, fails))
    said = [outcomes[index].kind for index in range(5)]
    assert said == [CERTIFIED, "bad: printed", CERTIFIED, "bad: worker died", CERTIFIED]
    _, lines = summary(cases, outcomes, "python -m problems.stress")
    for index in (1, 3):
        assert any(f"--case {index}" in line for line in lines)


def test_a_worker_that_hangs_is_ended_and_the_next_case_given_to_another() -> None:
    cases = [StressCase("hang")] * 2
    outcomes = dict(run_cases(cases, 1, 0.5, fails))
    assert [outcomes[index].kind for index in range(2)] == ["bad: hang"] * 2
    assert "--case 1" in "".join(summary(cases, outcomes, "python -m problems.stress")[1])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("--cases 0", "'--cases'"),
        ("--seed 1.5", "'--seed'"),
        ("--jobs -1", "'--jobs'"),
        ("--limit-s nan", "'--limit-s'"),
        ("--directed --case 100000", "--case 100000: there are"),
        ("--bogus", "--bogus"),
    ],
)
def test_wrong_options_end_in_one_line(terminal: Terminal, arguments: str, said: str) -> None:
    outcome = terminal("problems.stress", *arguments.split())
    assert_refused(outcome, said)
    assert outcome.out == ""


def test_one_case_alone_is_told_in_full(terminal: Terminal) -> None:
    assert "certified in" in terminal("problems.stress", "--directed", "--case", 0).out


def test_a_seed_of_its_own_is_told_with_the_command_that_repeats_it(terminal: Terminal) -> None:
    first, again = (terminal("problems.stress", "--cases", 1, "--case", 0).out.splitlines() for _ in range(2))
    assert first[0] != again[0]
    repeated = terminal(
        "problems.stress", *first[0].split("problems.stress ")[1].split(), "--case", 0
    ).out.splitlines()
    assert repeated[:-2] == first[:-2]


@pytest.mark.long
@pytest.mark.parametrize("index", LONG_REMEDIES)
def test_remedies_that_take_long_are_found_too(index: int) -> None:
    outcome = judge(drawn(0, index))
    assert not outcome.bad, outcome
    assert outcome.kind == "refused: HAND_OVER"


@pytest.mark.long
@pytest.mark.timeout(2 * 3600)
def test_thousands_of_cases_that_nobody_has_tried_are_certified_or_refused_by_name(terminal: Terminal) -> None:
    outcome = terminal("problems.stress", "--cases", 5000)
    assert outcome.code == 0, outcome.out


def test_what_a_yielding_hand_does_by_itself_is_not_asked_of_the_motor() -> None:
    plain = StressCase("hand", surface=Surface())
    yielding = replace(plain, demand=Demand(yields="brakes", intention_s=2e-3))
    straight, found = plain.problem(), yielding.problem()
    np.testing.assert_allclose(found.target.recorded_m_s2, straight.target.recorded_m_s2, atol=1e-12)
    late = found.grid.switching_times_s > 6e-3
    speed_m_s, braking_s = plain.demand.speed_m_s, 60e-3
    given = found.target.free_window_m_s2[late]
    assert np.all((given > 0) & (given <= speed_m_s / braking_s * (1 + 1e-9)))
    way = found.wall.nominal_m - straight.wall.nominal_m
    assert np.all(np.diff(way) >= 0)
    assert way[-1] > 0


def test_hands_and_recordings_of_every_kind_are_drawn() -> None:
    demands = [drawn(1, index).demand for index in range(200)]
    assert {demand.yields for demand in demands} == {"straight", "brakes", "stops", "decays", "pulls"}
    untrusted = [index for index, demand in enumerate(demands) if demand.weights == "untrusted"]
    assert untrusted
    posed = drawn(1, untrusted[0])
    assert [term.name for term in posed.demand.terms(posed.grid())] == ["rapid"]
