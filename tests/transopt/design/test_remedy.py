"""What would do for a refused entry: the search for it, its words, and entries under other numbers."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import problems
from problems.stress.cases import StressCase
from problems.stress.draw import drawn
from problems.stress.parts import Current, DrawnDevice, Horizon, Surface
from transopt.base.errors import InputError
from transopt.design import remedy
from transopt.design.build import Build, build_library
from transopt.design.context import Context
from transopt.design.design import design
from transopt.design.explain import Change, Remedy, infeasibility, what_would_do
from transopt.design.optimum import optimum
from transopt.design.remedy import NEAR, Values, Work, does, remedies
from transopt.design.scene_entry import NOT_ALL, SceneEntry
from transopt.problem.answer import Status
from transopt.problem.stage import layout
from transopt.recordings.recording import Recording
from transopt.references.reference import Reference
from transopt.references.references import References
from transopt.scene.keys import with_values
from transopt.scene.recordings import recordings_of, references_of
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions, TrialOptions

SHORT = Horizon(stages=40)
STARVED = StressCase("rail", current=Current(supply=0.01, limit_A=1.0), horizon=SHORT)
LEANT_ON = StressCase("wall", current=Current(limit_A=0.1), horizon=SHORT, surface=Surface(2000.0))
WARM = drawn(31337, 834)  # a coil that starts so near its limit that the ripple alone is too much
LATE = drawn(27112026, 24)  # a wall that asks for 2500 times the current and the command, after the waveform
BETWEEN = drawn(555, 50)  # a coil that passes its limit within a servo period, and not at any instant
APART = drawn(28112772, 912)  # a coil near its limit, whose optimum lies 1.5 % above the convex bound
OPTIONS = SolverOptions()
ONE_ENTRY = {"grid.speeds_m_s": [0.4], "grid.grips_N": [5.0]}


def refused(case: StressCase) -> tuple[Status, list[Remedy]]:
    """How a case ends, and its remedies."""
    (entry,) = design([case.posed()])
    return entry.status, remedies(case, entry, OPTIONS)


class TestWords:
    def test_a_number_is_printed_as_it_stands_in_a_scene(self) -> None:
        change = Change("limits.supply_V", 0.523, "V")
        assert str(change) == "limits.supply_V = 0.523 V"
        assert str(Change("feedback.latency_ticks", 0.0, "ticks")) == "feedback.latency_ticks = 0 ticks"
        assert str(Change("feedback", None, "")) == "no feedback"

    def test_only_what_was_solved_would_do(self) -> None:
        one = Remedy((Change("limits.current_A", 2.0, "A"), Change("amplifier.command_limit_A", 3.0, "A")), True)
        other = Remedy((Change("feedback", None, ""),), True)
        vain = Remedy((Change("limits.supply_V", 48.0, "V"),), False)
        assert what_would_do([one, vain, other]) == (
            "limits.current_A = 2 A and amplifier.command_limit_A = 3 A, or no feedback would do"
        )
        assert what_would_do([vain]) == "tried in vain, as far as limits.supply_V = 48 V"
        assert "would do" not in what_would_do([])


class TestSearch:
    """A judge takes the place of the solver."""

    def found(
        self, monkeypatch: pytest.MonkeyPatch, case: StressCase, judged: Callable[[Values], bool]
    ) -> tuple[list[Remedy], list[Values]]:
        asked: list[Values] = []

        def answered(_: object, values: Values, __: object) -> bool:
            asked.append(values)
            return judged(values)

        monkeypatch.setattr(remedy, "does", answered)
        return refused(case)[1], asked

    @given(least=st.floats(1.0, 1e5))
    def test_finds_nearly_the_least_and_names_no_other(self, least: float) -> None:
        stated = STARVED.value("limits.supply_V")
        assert stated is not None
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(remedy, "can_widen", lambda _: False)  # this judge knows nothing of the least width
            answers, asked = self.found(patch, STARVED, lambda v: (v.get("limits.supply_V") or 0.0) >= least * stated)
        (answer,) = answers
        (change,) = answer.changes
        assert answer.solved
        assert answer.values in asked
        assert change.value is not None
        assert least * stated <= change.value <= max(NEAR * least, 1.02) * stated * 1.011
        assert float(f"{change.value:.10g}") == change.value
        assert len(asked) < 12

    def test_numbers_that_only_together_do(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def both(values: Values) -> bool:
            pair = values.get("feedback.stiffness_N_m"), values.get("feedback.damping_N_s_m")
            return None not in pair and pair[0] < 1000.0  # type: ignore[operator]

        answers, _ = self.found(monkeypatch, LEANT_ON, both)
        assert [set(answer.values) for answer in answers] == [{"feedback.stiffness_N_m", "feedback.damping_N_s_m"}]

    def test_less_current_is_tried_first_where_a_limit_is_left_between_instants(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """It leaves the temperature out of the problem, so that it is known in time whatever an entry takes."""
        answers, asked = self.found(monkeypatch, BETWEEN, lambda _: True)
        assert set(asked[0]) == {"limits.current_A"}
        assert all((values.get("limits.current_A") or 0.0) < BETWEEN.current.limit_A for values in asked)
        assert {key for answer in answers for key in answer.values} >= {"thermal.start_winding_C", "limits.current_A"}

    def test_a_gap_to_the_convex_bound_is_closed_by_the_limit_that_is_not_convex(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        answers, asked = self.found(monkeypatch, APART, lambda v: v.get("thermal.start_winding_C", 99.0) < 50.0)
        assert [set(answer.values) for answer in answers if answer.solved] == [{"thermal.start_winding_C"}]
        assert all(key.startswith("thermal.") for values in asked for key in values)

    def test_a_flat_problem_gets_a_weight_of_the_movement_beside_what_makes_it_feasible(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        flat = replace(WARM, demand=replace(WARM.demand, rho=0.0))
        answers, _ = self.found(monkeypatch, flat, lambda v: "thermal.start_winding_C" in v and "weights.rho" in v)
        assert answers
        for answer in answers:
            assert answer.solved
            assert answer.values["weights.rho"] == remedy.STEADIER[-1]

    def test_limits_that_the_wall_alone_exceeds_are_widened_together_by_the_factor_that_the_replay_names(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (entry,) = design([LATE.posed()])
        assert entry.status is Status.HAND_OVER
        soft = {"feedback.stiffness_N_m", "feedback.damping_N_s_m"}
        assert sum(entry.played.leaves(limit) for limit in entry.problem.limits) == 2
        over = max(entry.played.peak(each) / each.stated for each in entry.problem.limits if each.linear)

        def enough(values: Values) -> bool:
            by = {key: (value or 0.0) / (LATE.value(key) or 1.0) for key, value in values.items()}
            return len(by) == 2 and (min(by.values()) >= over or (set(by) == soft and max(by.values()) <= 1 / over))

        answers, asked = self.found(monkeypatch, LATE, enough)
        assert [answer.solved for answer in answers] == [True, True]
        for answer in answers:
            for key, value in answer.values.items():
                by = (value or 0.0) / (LATE.value(key) or 1.0)
                assert over <= max(by, 1 / by) <= 1.05 * over
        together = [values for values in asked if len(values) == 2]
        assert len(together) <= 6

    def test_what_helps_nothing_is_said_to_have_been_tried(self, monkeypatch: pytest.MonkeyPatch) -> None:
        answers, asked = self.found(monkeypatch, LEANT_ON, lambda _: False)
        assert answers
        assert not any(answer.solved for answer in answers)
        assert all(answer.values in asked for answer in answers)
        assert what_would_do(answers).startswith("tried in vain, as far as feedback.stiffness_N_m = ")

    def test_the_work_is_counted_and_bounded(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Trials count by number and size, so that a busy machine finds what an idle one does."""
        asked: list[Values] = []
        monkeypatch.setattr(remedy, "does", lambda _, values, __: bool(asked.append(values)))
        (entry,) = design([LEANT_ON.posed()])
        for most in (0.0, 5.0, 20.0, 1e3):
            asked.clear()
            work = Work(most)
            found = remedies(LEANT_ON, entry.stating(status=Status.HAND_OVER), OPTIONS, work)
            assert not any(each.solved for each in found)
            sizes = [1 + (values.get("time.stages") or SHORT.stages) / 1000 for values in asked]
            assert work.spent == pytest.approx(sum(sizes))
            left_out = [values for values in asked if values == {"feedback": None}]
            assert len(left_out) == 1  # the surest change, which is tried when nothing is left too
            assert work.spent < most + 1.04 * (1 + len(left_out))
            assert (asked == left_out) == (most == 0)
            assert work.short == (most < 100.0)
            assert work.left == pytest.approx(max(most - work.spent, 0.0))
        assert len(asked) < 40

    def test_a_longer_window_more_states_the_worst_of_several_devices_and_an_energy_are_more_work(self) -> None:
        (entry,) = design([LEANT_ON.posed()])
        (late,) = design([replace(LEANT_ON, current=replace(LEANT_ON.current, delay_samples=20)).posed()])
        states = layout(late.problem).states
        assert states > 24
        intense = entry.stating(objective="intensity")
        worst = replace(entry, designed=replace(entry.designed, problem=replace(entry.problem, worst=True)))
        spent = []
        for one, values in ((entry, {}), (entry, {"time.stages": 2000.0}), (worst, {}), (intense, {}), (late, {})):
            work = Work()
            work.spend(one, values)
            spent.append(work.spent)
        assert spent == pytest.approx([1.04, 3.0, 5.2, 5.2, 1 + 0.04 * (states / 12) ** 2])


@pytest.mark.parametrize("case", [STARVED, LEANT_ON, WARM, BETWEEN], ids=["rail", "wall", "coil", "between"])
def test_what_is_said_to_do_does(case: StressCase) -> None:
    status, found = refused(case)
    assert status in (Status.INFEASIBLE, Status.HAND_OVER, Status.UNRESOLVED)
    assert any(remedy.solved for remedy in found)
    for stated in found:
        if stated.solved:
            designed = optimum(case.problem(stated.values), OPTIONS)
            assert designed.solution.status is Status.OPTIMAL, designed.remarks
            assert designed.certificate.accepted


def test_nothing_is_tried_where_the_replay_has_no_digits(build: Build) -> None:
    entry = build.entries[0][0]
    diverged = replace(entry.played, step_error=1e-3)
    refused = entry.stating(played=diverged, status=Status.REPLAY_VIOLATION)
    posed = SceneEntry(build.context, entry.grip_N, build.references.at(entry.speed_m_s, entry.grip_N))
    assert remedies(posed, refused, OPTIONS) == []
    (said,) = diverged.shortfalls(entry.problem, entry.solution.command, entry.predicted_m_s2)
    fastest_Hz = np.abs(np.linalg.eigvals(entry.problem.stage.plant.A)).max() / (2 * np.pi)
    assert f"fastest mode, at {fastest_Hz:.2g} Hz" in said


def test_a_trial_asks_one_solver_and_explains_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> list[str]:
        raise AssertionError

    monkeypatch.setattr("transopt.design.optimum.infeasibility", never)
    monkeypatch.setattr("transopt.solvers.choose.feasible", never)
    case = StressCase("wall", current=Current(limit_A=0.3, slew=0.05), horizon=SHORT, surface=Surface(2000.0))
    assert not does(case, {}, OPTIONS)
    assert not optimum(case.problem(), TrialOptions()).is_proven


def test_limits_whose_program_finds_nothing_are_refused_by_their_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    """A claim without numbers is no reason: the optimum without limits has some."""
    case = StressCase("wall", current=Current(limit_A=0.3, slew=0.05), horizon=SHORT, surface=Surface(2000.0))
    monkeypatch.setattr("transopt.design.explain.least_widening", lambda *_: None)
    (reason,) = infeasibility(case.problem(), OPTIONS)
    assert ": proven that no command keeps all limits and ends in what the wall asks for: without limits " in reason
    assert "A/s over its limit 150 A/s" in reason or "A/s, limit 150 A/s" in reason
    plain = StressCase("plain", DrawnDevice(), horizon=SHORT).problem()
    assert infeasibility(plain, OPTIONS) == []


class TestOfAScene:
    def entry(self, scene: Scene, references: Sequence[Reference], values: Values) -> SceneEntry:
        return SceneEntry(Context(with_values(scene, values)), 5.0, references[-1])

    def test_knows_what_stands_there(self, scene: Scene, references: list[Reference]) -> None:
        entry = self.entry(scene, references, {})
        assert entry.value("limits.current_A") == scene.limits.transient_input
        assert entry.value("limits.supply_V") is None
        assert entry.value("feedback.stiffness_N_m") is None
        assert entry.value("thermal.ambient_C") == scene.thermal.ambient_C
        assert entry.value("no.such.key") is None

    def test_is_posed_with_other_numbers(self, scene: Scene, references: list[Reference]) -> None:
        entry = self.entry(scene, references, {"limits.supply_V": 12.0})
        assert entry.posed({"limits.supply_V": 13.0}).problem.limits["supply"].stated == 13.0
        assert "supply" not in entry.posed({"limits.supply_V": None}).problem.limits
        with pytest.raises(InputError, match="above the motor's i_peak_A"):
            entry.posed({"limits.current_A": 1e3})

    def test_another_time_axis_takes_the_reference_anew(
        self, scene: Scene, taps: list[Recording], references: list[Reference]
    ) -> None:
        values = {"time.dt_s": 5e-5, "time.stages": 1200.0}
        finer = with_values(scene, values)
        wanted, recorded = references_of(finer, taps), Context.recorded(scene, taps)
        for speed_m_s in (0.4, 0.35):
            found = SceneEntry(recorded, 5.0, recorded.reference(speed_m_s, 5.0)).posed(values).problem
            np.testing.assert_allclose(
                found.target.window_m_s2, wanted.at(speed_m_s, 5.0).target.window_m_s2, rtol=1e-12, atol=1e-12
            )

    def test_without_the_recordings_there_is_no_other_time_axis(
        self, scene: Scene, references: list[Reference]
    ) -> None:
        unknown = References((replace(references[-1], taps=(), factors=np.zeros(0)),))
        entry = SceneEntry(Context(scene, unknown), 5.0, references[-1])
        with pytest.raises(InputError, match="its recordings are not at hand"):
            entry.posed({"time.dt_s": 5e-5, "time.stages": 1200.0})

    def test_a_refused_library_says_what_would_do(self, taps: list[Recording], scene: Scene) -> None:
        """Both entries take the same rail: what does for one is tried for the next."""
        values = {"limits.supply_V": 0.3, "grid.speeds_m_s": [0.4], "grid.grips_N": [1.0, 5.0]}
        low = with_values(scene, values)
        chosen = [tap for tap in taps if tap.speed_m_s is None or tap.speed_m_s > 0.35]
        built = build_library(low, chosen)
        assert len(built.refused) == 2
        sentences = {entry.shortfalls[-1] for entry in built.refused}
        assert len(sentences) == 1
        assert sentences.pop().endswith(" V would do")
        (stated,) = built.refused[0].remedies
        changed = with_values(low, stated.values)
        for grip_N in (1.0, 5.0):
            (entry,) = design([Context.recorded(changed, chosen).posed(0.4, grip_N)])
            assert entry.status is Status.OPTIMAL


def test_a_current_takes_the_place_of_a_beta(scene: Scene, taps: list[Recording]) -> None:
    wall = {"stiffness_N_m": 200.0, "damping_N_s_m": 0.2}
    changes = {"limits.beta": 1.0, "limits.steady_current_A": 0.5, "hand.yields": "brakes", "feedback": wall}
    weak = with_values(scene, {**changes, **ONE_ENTRY})
    chosen = [tap for tap in taps if tap.speed_m_s is None or tap.speed_m_s > 0.35]
    (entry,) = build_library(weak, chosen).refused
    (stated,) = [each for each in entry.remedies if "limits.current_A" in each.values]
    assert stated.solved
    assert stated.values["limits.beta"] is None
    assert "limits.current_A = " in entry.shortfalls[-1]
    assert " A and no limits.beta" in entry.shortfalls[-1]
    assert not build_library(with_values(weak, stated.values), chosen).refused


@pytest.mark.parametrize(("most", "short"), [(10.0, True), (100.0, False)])
def test_an_entry_whose_trials_took_all_their_work_says_so(
    monkeypatch: pytest.MonkeyPatch, most: float, short: bool
) -> None:
    monkeypatch.setattr("transopt.design.scene_entry.MOST_WORK", most)
    monkeypatch.setattr(remedy, "does", lambda *_: False)
    scene = with_values(problems.load("low_supply"), {"limits.stroke_m": 5e-3, **ONE_ENTRY})
    (entry,) = build_library(scene, recordings_of(scene)).refused
    (vain,) = [said for said in entry.shortfalls if said.startswith("tried in vain")]
    assert "limits.stroke_m" in vain
    assert (NOT_ALL in entry.shortfalls) == short


@pytest.mark.parametrize("rate_Hz", [17.0, 50.0, 1e3])
def test_the_rate_of_taps_that_is_named_is_taken(rate_Hz: float) -> None:
    scene = with_values(problems.load("rapid_tapping"), {"time.stages": 800})
    with pytest.raises(InputError, match="must be at most") as refusal:
        with_values(scene, {"thermal.tap_rate_Hz": rate_Hz})
    most_Hz = float(str(refusal.value).split("must be at most ")[1].split(",")[0])
    assert most_Hz > 0.98 / (scene.stages * scene.time.dt_s + 2 * scene.time.dt_s)
    entry = SceneEntry(Context(scene), 1.0, _reference(scene))
    assert entry.posed({"thermal.tap_rate_Hz": most_Hz}).problem.thermal is not None


@pytest.mark.parametrize("rate_Hz", [13.0, 20.0, 100.0])
def test_a_window_that_is_not_stated_is_over_before_the_next_tap(rate_Hz: float) -> None:
    own = problems.load("rapid_tapping")
    scene = with_values(own, {"thermal.tap_rate_Hz": rate_Hz})
    grid = scene.time_grid()
    over_s = (grid.stages + 1) * grid.dt_s + grid.delay_s
    assert over_s < 1 / rate_Hz < over_s + 1.01 * grid.dt_s
    assert own.stages == 800, "which ends before the next of twelve taps a second"
    entry = SceneEntry(Context(scene), 1.0, _reference(scene))
    assert entry.posed({}).problem.grid == grid
    assert entry.value("time.stages") == grid.stages


def test_a_rate_that_leaves_no_room_for_the_hand_over_is_refused_by_the_most_there_may_be() -> None:
    scene = problems.load("rapid_tapping")
    with pytest.raises(InputError, match="must be at most") as refusal:
        with_values(scene, {"thermal.tap_rate_Hz": 1e4})
    most_Hz = float(str(refusal.value).split("must be at most ")[1])
    assert with_values(scene, {"thermal.tap_rate_Hz": most_Hz}).stages == scene.hand_over_samples + 1


def _reference(scene: Scene) -> Reference:
    from transopt.scene.recordings import recordings_of

    return references_of(scene, recordings_of(scene)).at(scene.grid.speeds_m_s[0], scene.grid.grips_N[0])
