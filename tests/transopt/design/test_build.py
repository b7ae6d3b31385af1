"""The built-in scene end to end, entry by entry."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import problems
from problems.stress.judge import played
from tests.benches.independent import assert_independent_check_is_clean
from tests.benches.limits import with_limit
from tests.benches.places import IMPACTS
from tests.conftest import ProblemMaker
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.design import entry as entries_room
from transopt.design.build import Build, build_library
from transopt.design.context import Context
from transopt.design.design import design
from transopt.design.optimum import optimum
from transopt.design.verify import verify_library
from transopt.library.proven import doubts
from transopt.problem.answer import Solution, Status, held_back, verdict
from transopt.problem.limits.temperature import temperature_limit
from transopt.problem.objective.bands import Levels, levels
from transopt.problem.objective.figures import Figures
from transopt.problem.objective.weighting import pacinian
from transopt.problem.problem import TransientProblem
from transopt.proof.admit import admit
from transopt.proof.certify import certify
from transopt.proof.designed import Designed
from transopt.proof.effect import Effect
from transopt.proof.replay import Replay
from transopt.recordings.recording import Recording
from transopt.recordings.tap import read_recordings
from transopt.report.markdown import build_markdown
from transopt.scene.builtin import load_scene
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.solvers import unlimited
from transopt.solvers.choose import solve, solve_certified
from transopt.solvers.options import SolverOptions


def assert_entries_are_proven(build: Build) -> None:
    for entry in build.all_entries():
        assert entry.status is Status.OPTIMAL, entry.shortfalls
        assert entry.certificate.violation("A") <= 1e-6
        assert entry.certificate.relative_gap <= 1e-6
        assert entry.played.peak_input <= build.scene.limits.transient_input + 1e-6
        assert entry.played.step_error <= 1e-10
        assert entry.played.scale_m_s2 == np.abs(entry.played.acceleration_m_s2).max()
        # What changes of sign within a period add for ever.
        steady = build.scene.thermal.tap_rate_Hz is not None
        assert np.isnan(entry.played.winding_C) or entry.played.winding_C <= 100 + (7.5e-3 if steady else 1e-5)


def test_every_entry_is_certified_and_replayed_clean(build: Build) -> None:
    assert_entries_are_proven(build)
    assert not build.refused


def test_unsaturated_entries_reach_their_floor(build: Build) -> None:
    free = [entry for entry in build.all_entries() if entry.binding == "none"]
    assert len(free) == 8
    for entry in free:
        assert entry.figures.tap_error <= entry.floor + 1e-3
        assert 0.15 < entry.floor < 0.22  # the hand pushes on, and the waveform ends
        assert entry.solution.solver == "unlimited"
        assert "inside all limits" in entry.left_out["limits"]


def test_what_comes_after_the_waveform_is_reported(build: Build) -> None:
    """Free motion after the end, by the design model: no term of the problem holds it down, so it is shown."""
    for entry in build.entries[3]:
        stage, N = entry.problem.stage, entry.problem.grid.stages
        acceleration, _ = stage.rollout(np.append(entry.solution.command, np.zeros(200)))
        after = np.abs(acceleration[N:]).max()
        assert (1 - 1e-9) * after <= entry.played.after_peak_m_s2 <= 1.1 * after


def test_figures_are_within_the_bounds_measured_when_played(build: Build) -> None:
    """Tap error, felt error, least speed and most heat [A^2 ms at 0.1 m/s], as independent equations found them."""
    unbound = {1.0: (0.182, 0.040, 0.50, 28.0), 3.0: (0.215, 0.043, 0.45, 64.0), 5.0: (0.233, 0.045, 0.43, 108.0)}
    bound = {1.0: (0.27, 0.158, 0.30, 250.0), 3.0: (0.32, 0.17, 0.22, 460.0), 5.0: (0.39, 0.17, 0.10, 435.0)}
    for entry in build.all_entries():
        v, grip, figures = entry.speed_m_s, entry.grip_N, entry.figures
        tap, felt, speed, heat = bound[grip] if v > 0.35 else unbound[grip]
        if (v, grip) == (0.3, 5.0):
            tap, felt, speed, heat = 0.277, 0.063, 0.30, 640.0
        elif v < 0.35:
            heat *= (v / 0.1) ** 2
            assert figures.felt_dB >= -0.15
            assert figures.bump_m_s2 / STANDARD_GRAVITY_M_S2 <= 0.12 * v / 0.1
        assert figures.tap_error <= tap
        assert figures.felt_error <= felt
        assert figures.speed >= speed
        assert 1e3 * entry.heat_A2_s <= heat


def test_the_optimum_beats_what_is_clipped_and_the_inverse(build: Build) -> None:
    for entry in build.entries[3]:
        rivals = (entry.baselines.clipped, entry.baselines.seed)
        assert all(entry.figures.tap_error < rival.tap_error for rival in rivals)


def test_measured_impacts_are_solved_and_proven(tmp_path: Path) -> None:
    if not IMPACTS.is_dir():
        pytest.skip(f"the measured impacts are not at {IMPACTS}")
    scene = problems.load("measured_impacts")
    settings = scene.recordings.model_copy(update={"folder": str(IMPACTS)})
    scene = scene.model_copy(update={"recordings": settings})
    build = build_library(scene, read_recordings(settings))
    assert_entries_are_proven(build)
    first = build.references.cells[0]
    assert first.repeatability == pytest.approx(0.030, abs=0.005)
    assert first.repeatability_unaligned == pytest.approx(0.055, abs=0.005)
    # A repeated shock is smooth: at its floor the errors are below those of the struck foam.
    for row in build.entries[:2]:
        for entry in row:
            assert 0.15 < entry.figures.tap_error < 0.20
            assert entry.figures.felt_error < 0.04
    # If nothing after the window counts, the device may hold the hand to its end, and lets go all at once.
    alone = build_library(with_values(scene, {"weights.after_s": 0.0}), read_recordings(settings))
    for lasting, ended in zip(build.entries[0], alone.entries[0], strict=True):
        assert ended.figures.tap_error < 0.5 * lasting.figures.tap_error
        assert ended.played.after_peak_m_s2 > 3 * lasting.played.after_peak_m_s2
    for entry in build.entries[3]:
        for rival in (entry.baselines.clipped, entry.baselines.seed):
            assert entry.figures.tap_error < rival.tap_error
            assert entry.figures.felt_error < 0.5 * rival.felt_error
    assert "scaled to every grid speed" in build.library.meta["sources"][0]["speed_source"]
    assert_independent_check_is_clean(build.library, tmp_path / "library.npz")


def test_no_floor_is_told_where_the_optimum_without_limits_is_not_found(
    make_problem: ProblemMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unfound(problems: Sequence[TransientProblem], *, brief: bool) -> list[Solution]:
        return [
            replace(found, status=Status.NUMERICAL_FAILURE, command=0 * found.command)
            for found in solved(problems, brief=brief)
        ]

    solved = unlimited.solve
    monkeypatch.setattr(unlimited, "solve", unfound)
    designed = optimum(make_problem(), SolverOptions())
    assert designed.certificate.accepted
    assert np.isnan(designed.floor)


def test_answers_played_in_several_simulations_are_those_of_one(
    scene: Scene, taps: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    context = Context.recorded(scene, taps)
    posed = context.posed_together([row[0] for row in context.cells.rows], *scene.axes.devices[0])
    whole = design(posed)
    monkeypatch.setattr("transopt.design.design.PLAYED_TOGETHER", 3)
    parted = design(posed)
    assert [len({id(entry.batch) for entry in found}) for found in (whole, parted)] == [1, 2]
    for one, other in zip(whole, parted, strict=True):
        assert vars(one.figures) == pytest.approx(vars(other.figures), rel=1e-9, nan_ok=True)
        np.testing.assert_allclose(one.plant_input, other.plant_input, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(one.made_m_s2, other.made_m_s2, rtol=1e-9, atol=1e-9)


def test_a_grip_solved_in_parts_gives_the_library_of_one_pass(
    scene: Scene, taps: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = build_library(scene, taps)
    monkeypatch.setattr("transopt.design.build.SOLVED_TOGETHER", 3)
    done = list[int]()
    parted = build_library(scene, taps, progress=done.append)
    assert done == [2, 2] * len(scene.axes.devices)
    assert parted.library is not None
    assert whole.library is not None
    for name, array in whole.library.arrays().items():
        if array.dtype.kind == "f" and name != "solve_time_s":
            np.testing.assert_allclose(parted.library.arrays()[name], array, rtol=1e-6, atol=1e-9, err_msg=name)
    assert [[entry.place for entry in row] for row in parted.entries] == [
        [entry.place for entry in row] for row in whole.entries
    ]


def test_an_entry_that_has_let_its_courses_go_tells_the_same(scene: Scene, taps: list[Recording]) -> None:
    (entry,) = design([Context.recorded(scene, taps).posed(0.4, 5.0)])
    effect, target, tracking = entry.designed.effect, entry.problem.target, entry.problem.tracking
    rise_K, recorded, wanted = effect.rise_K, target.recorded_m_s2, tracking.wanted
    felt, made, played = entry.predicted_m_s2, entry.made_m_s2, entry.played.plant_input
    entry.let_go()
    assert "courses" not in vars(entry.played.samples)
    np.testing.assert_allclose(entry.made_m_s2, made, atol=1e-12 * np.abs(made).max())
    np.testing.assert_allclose(entry.played.plant_input, played, atol=1e-12)
    freed = {"rise_K", "recorded_m_s2", "wanted", "motion", "lasting"}
    assert not freed & {*vars(effect), *vars(target), *vars(tracking)}
    np.testing.assert_allclose(entry.predicted_m_s2, felt)
    np.testing.assert_allclose(effect.rise_K, rise_K)
    np.testing.assert_allclose(target.recorded_m_s2, recorded)
    np.testing.assert_allclose(tracking.wanted, wanted)
    again = certify(entry.problem, entry.solution.command, entry.solution.multipliers)
    assert again.objective == pytest.approx(entry.certificate.objective, rel=1e-9)


def test_a_library_and_its_entries_hold_commands_multipliers_and_targets_once(
    scene: Scene, taps: list[Recording]
) -> None:
    built = build_library(scene, taps)
    assert built.library is not None
    bound = 0
    for (iv, ig), entry in zip(np.ndindex(4, 3), built.all_entries(), strict=True):
        library, answer = built.library, entry.solution
        assert np.shares_memory(answer.command, library.command[iv, ig])
        assert np.shares_memory(entry.problem.target.window_m_s2, library.target_m_s2[iv, ig])
        stated = library.multipliers(iv, ig).pairs
        assert answer.multipliers.pairs.keys() == stated.keys()
        for row, pair in stated.items():
            for own, side in zip(answer.multipliers.pairs[row], pair, strict=True):
                np.testing.assert_array_equal(own, side)
                bound += own.any() and np.shares_memory(own, side)
        assert certify(entry.problem, answer.command, answer.multipliers).accepted
    assert bound > 0


def test_where_no_solver_proves_anything_the_wanted_ones_answer_stands(make_problem: ProblemMaker) -> None:
    """Two iterations are too few for all."""
    (found,) = solve_certified([make_problem(0.4, 5.0)], SolverOptions("casadi-piqp", max_iterations=2))
    refused, proof, _ = found
    assert (refused.solver, refused.status) == ("casadi-piqp", Status.ITERATION_LIMIT)
    assert not proof.is_stationary


def warm(scene: Scene, **start_C: float) -> Scene:
    return scene.model_copy(update={"thermal": scene.thermal.model_copy(update=start_C)})


@pytest.mark.parametrize(("start_C", "binding"), [(99.8, 0), (99.995, 5)])
def test_temperature_that_could_bind_is_kept_and_proven(
    scene: Scene, taps: list[Recording], build: Build, tmp_path: Path, start_C: float, binding: int
) -> None:
    """From 99.8 C, 4 A held throughout would pass 100 C: the bound proves nothing, the solved entries do."""
    hot = warm(scene, start_winding_C=start_C)
    without, build = build, build_library(hot, taps)
    assert_entries_are_proven(build)
    too_warm = 0
    for cold, entry in zip(without.all_entries(), build.all_entries(), strict=True):
        # Not left out for the bound, as it is from 25 C on: the answer itself is shown to stay inside, or it is in.
        assert "cannot pass" not in entry.left_out.get("temperature", "")
        thermal = entry.problem.thermal
        highest = [
            thermal.temperatures_C(each.problem.stage.rollout(each.solution.command)[1], each.solution.command).max()
            for each in (cold, entry)
        ]
        assert highest[1] <= 100 + 1e-6
        # The model starts to look one stage after the start, which may be the hottest instant.
        assert max(highest[1], start_C) == pytest.approx(entry.played.winding_C, abs=2e-4)
        # It binds exactly where the optimum of a cold motor would leave it.
        assert ("coil 100 C" in entry.binding) == (highest[0] > 100)
        too_warm += highest[0] > 100
    assert too_warm == binding
    assert build.library is not None
    assert all(not check.shortfalls for check in verify_library(build.library))
    assert_independent_check_is_clean(build.library, tmp_path / "library.npz")


def test_a_start_that_no_current_can_hold_is_refused_by_name(scene: Scene, taps: list[Recording]) -> None:
    """The housing warms the winding beyond its limit with the motor at rest."""
    hot = warm(scene, start_winding_C=99.9, start_housing_C=300.0)
    hot = hot.model_copy(update={"grid": scene.grid.model_copy(update={"speeds_m_s": [0.2], "grips_N": [3.0]})})
    build = build_library(hot, [tap for tap in taps if "_0.2_m_s_" in tap.name])
    assert build.library is None
    (entry,) = build.refused
    assert entry.status is Status.INFEASIBLE
    assert entry.verdict == "refused"
    assert "coil" in entry.shortfalls[0]
    assert "100 C" in entry.shortfalls[0]


def test_every_part_left_out_has_its_reason(build: Build) -> None:
    for entry in build.all_entries():
        assert set(entry.left_out) >= {"feedback", "position", "supply", "slew", "temperature"}
        assert "25.73 C" in entry.left_out["temperature"]
    limits = build.library.meta["left_out"]["limits"]
    assert limits[3][1] is None
    assert limits[0][0].startswith("the unlimited optimum is inside all limits")


@pytest.mark.parametrize("kind", ["second_order", "fourth_order"])
def test_the_other_models_build_too(scene: Scene, taps: list[Recording], kind: str) -> None:
    from pydantic import TypeAdapter

    from transopt.plant.fourth_order import FourthOrder
    from transopt.plant.second_order import SecondOrder

    table = {"kind": kind} if kind == "second_order" else {**scene.model.model_dump(), "kind": kind}
    model = TypeAdapter(SecondOrder | FourthOrder).validate_python(table)
    build = build_library(scene.model_copy(update={"model": model}), taps)
    assert build.library is not None
    assert_entries_are_proven(build)


class TestAdmission:
    """Both the certificate and the replay decide."""

    @pytest.fixture
    def designed(self, scene: Scene, make_problem: ProblemMaker) -> Designed:
        problem = make_problem(0.4, 5.0)
        solution = solve(problem)
        # The temperature cannot bind, but what is admitted has to keep it all the same.
        coil = scene.coil()
        assert coil is not None
        limit = temperature_limit(coil, problem.stage.amplifier, problem.grid, scene.budget())
        problem = with_limit(problem, limit)
        proof, effect = certify(problem, solution.command, solution.multipliers), Effect(problem, solution.command)
        rest = np.zeros(problem.grid.stages)
        return Designed(problem, solution, proof, effect, rest, 0.0, 0.0, 1.0, {}, None, [])

    @pytest.fixture
    def run(self, designed: Designed) -> Replay:
        return played(designed.problem, designed.solution.command)

    def test_clean(self, designed: Designed, run: Replay) -> None:
        assert admit(designed, run) == (Status.OPTIMAL, [])

    @pytest.mark.parametrize(
        ("part", "change", "status", "words"),
        [
            ("solution", {"status": Status.ITERATION_LIMIT}, Status.ITERATION_LIMIT, "iteration limit"),
            ("certificate", {"duality_gap": 1.0}, Status.NOT_CERTIFIED, "above the optimum, limit 1e-06"),
            ("certificate", {"duality_gap": np.nan}, Status.NOT_CERTIFIED, "above the optimum, limit 1e-06"),
            ("certificate", {"violations": {"A": 1e-5}}, Status.NOT_CERTIFIED, "a limit is violated by 1e-05 A"),
            ("certificate", {"violations": {"V": 1e-5}}, Status.NOT_CERTIFIED, "a limit is violated by 1e-05 V"),
            ("certificate", {"violations": {"K": 1e-5}}, Status.NOT_CERTIFIED, "a limit is violated by 1e-05 K"),
            ("certificate", {"violations": {"K": np.nan}}, Status.NOT_CERTIFIED, "a limit is violated by nan K"),
            ("certificate", {"lower_bound": np.nan}, Status.NOT_CERTIFIED, "its lower bound nan lies above it"),
            ("certificate", {"lower_bound": 1.0}, Status.NOT_CERTIFIED, "its lower bound 1 lies above it"),
            ("certificate", {"finite": False}, Status.NOT_CERTIFIED, "its numbers do not stay finite"),
            ("certificate", {"lower_bound": -np.inf}, Status.NOT_GLOBAL, "above the convex lower bound, limit 1%"),
            ("run", {"reached": {"current": 4.00001}}, Status.REPLAY_VIOLATION, "current 4.000010 A, limit 4 A"),
            ("run", {"reached": {"current": np.nan}}, Status.REPLAY_VIOLATION, "replayed current nan A"),
            (
                "run",
                {"reached": {"current": 4.0, "command": 6.1}},
                Status.REPLAY_VIOLATION,
                "command 6.100000 A, limit 6",
            ),
            ("run", {"winding_C": 100.5}, Status.REPLAY_VIOLATION, "winding 100.500 C, limit 100 C"),
            ("run", {"winding_C": 100.002}, Status.REPLAY_VIOLATION, "winding 100.002 C, limit 100 C"),
            ("run", {"winding_C": np.nan}, Status.REPLAY_VIOLATION, "winding nan C"),
            ("run", {"reached": {}}, Status.REPLAY_VIOLATION, "replayed current nan A"),
            ("run", {"step_error": 1e-3}, Status.REPLAY_VIOLATION, "replay did not converge"),
        ],
    )
    def test_what_any_part_says_against_it(
        self, designed: Designed, run: Replay, part: str, change: dict[str, Any], status: Status, words: str
    ) -> None:
        if part == "run":
            run = replace(run, **change)
        else:
            designed = replace(designed, **{part: replace(getattr(designed, part), **change)})
        found, why = admit(designed, run)
        assert found is status
        assert words in why[0]

    def test_command_other_than_the_one_replayed(self, designed: Designed, run: Replay) -> None:
        status, why = admit(
            replace(designed, solution=replace(designed.solution, command=designed.solution.command + 1e-5)), run
        )
        assert status is Status.REPLAY_VIOLATION
        assert "differs from the predicted one by 1.0e-05 A" in why[0]

    def test_replay_that_misses_the_prediction(self, designed: Designed, run: Replay) -> None:
        motion = designed.effect.motion
        off = replace(motion, acceleration_m_s2=np.roll(motion.acceleration_m_s2, 1))
        effect = Effect(designed.problem, designed.solution.command, off)
        status, why = admit(replace(designed, effect=effect), run)
        assert status is Status.REPLAY_VIOLATION
        assert "differs from the predicted" in why[0]


def of_intensity(dB: float, wanted: np.ndarray) -> Levels:
    return levels(10 ** (dB / 20) * wanted, wanted, 1e-4)


def test_verdicts() -> None:
    tap = np.sin(2 * np.pi * 250 * 1e-4 * np.arange(600)) * np.exp(-np.arange(600) / 100)

    def said(
        tap_error: float,
        dB: float = 0.0,
        *,
        speed: float = 0.5,
        held: Sequence[str] = (),
        named: bool = False,
        felt_error: float = 0.04,
        **more: Any,
    ) -> str:
        found = Figures(tap_error, felt_error, dB, speed, 0.1, 0.1, 0.1)
        return verdict(found, 0.17, 0.03, of_intensity(dB, tap), held, named=named, **more)

    held = ["command +6 A at -0.13, 0.97 ms", "current +4 A at 0.07 ms"]
    assert said(0.02) == "felt within 1.6 dB; nearer than the recordings to each other"
    assert said(0.17) == "felt within 1.6 dB; at its floor: the waveform ends while the hand pushes"
    assert said(0.17, named=True) == "felt within 1.6 dB; at its floor"
    assert said(0.3, -1.5, held=held) == "felt within 1.6 dB; held back by command and current"
    assert said(0.3, -3.0, held=held) == "too weak by 3.0 dB, most at 250 Hz; held back by command and current"
    assert said(0.3, 2.0) == "too strong by 2.0 dB, most at 250 Hz"
    assert said(0.3, speed=-0.1) == "felt within 1.6 dB; the surface pulls"
    assert said(0.17, 0.5, felt_error=0.46).startswith("felt within 1.6 dB, its waveform 46.0 % off; at its floor")
    assert said(0.3, -3.0, felt_error=0.46).startswith("too weak by 3.0 dB, most at 250 Hz")
    assert said(0.3, speed=-0.004) == "felt within 1.6 dB"
    assert said(0.3, speed=-0.1, least_input=(0.2, "A")) == "felt within 1.6 dB; the surface pulls"
    assert said(0.3, speed=-0.1, least_input=(-1.234, "A")).endswith("; the surface pulls, by up to 1.23 A")
    assert said(0.17, held=held) == "felt within 1.6 dB; held back by command and current"


def test_a_limit_holds_back_if_it_costs_tap_error_or_objective() -> None:
    both = "command +6 A at -0.13, 0.97 ms; current +4 A at 0.07 ms"
    assert held_back(0.30, 0.17, 0.04, 0.01, both) == both.split("; ")
    assert held_back(0.15, 0.17, 0.04, 0.01, both) == both.split("; ")
    assert held_back(0.17, 0.17, 0.01, 0.01, both) == []
    assert held_back(0.30, 0.17, 0.04, 0.01, "none") == []
    assert held_back(0.17, np.nan, 0.01, np.nan, both) == both.split("; ")


def test_a_scene_that_asks_for_intensity_stores_price_and_energy(scene: Scene, taps: list[Recording]) -> None:
    changes = {"weights.objective": "intensity", "weights.rapid": "pacinian"}
    asked = with_values(scene, {**changes, "grid.speeds_m_s": [0.4], "grid.grips_N": [5.0]})
    build = build_library(asked, [tap for tap in taps if "_0.4_m_s_" in tap.name])
    assert build.library is not None
    library, filtered = build.library, pacinian(asked.time.dt_s)
    assert {"intensity", "energy_dB"} <= set(library.arrays())
    assert library.meta["derived"]["terms"][-1]["b"] == filtered.b.tolist()
    made, wanted = (filtered.apply(x) for x in (library.acceleration_m_s2[0, 0], library.target_m_s2[0, 0]))
    assert library.energy_dB[0, 0] == pytest.approx(10 * np.log10((made @ made) / (wanted @ wanted)), abs=1e-9)
    assert list(doubts(library)) == []
    louder = replace(library, energy_dB=library.energy_dB + 0.1)
    assert any("energy_dB says" in doubt for doubt in doubts(louder))


@pytest.mark.parametrize(("delay_s", "stages", "lead_s"), [(37e-6, 600, 2e-4), (73e-6, 800, 3e-4)])
def test_a_reader_counts_the_instants_of_the_window(delay_s: float, stages: int, lead_s: float) -> None:
    """The instants that a reader adds up differ in the last bit from the end of the window, where one begins."""
    late = {"amplifier.delay_s": delay_s, "time.stages": stages, "time.lead_s": lead_s, "time.dt_s": 1e-4}
    library = build_library(with_values(load_scene("voice_coil_thud"), late), []).library
    stated = library.meta["derived"]
    tau = stated["amplifier"]["delay_s"] - stated["lead_s"] + stated["dt_s"] * np.arange(stages + 9)
    first = (tau >= -1e-9) & (tau < stated["intention_s"])
    assert first.sum() == (tau[:stages] >= -1e-9).sum()
    off = (library.acceleration_m_s2 + library.free_m_s2 - library.recorded_m_s2)[0, 0, first[:stages]]
    size = np.linalg.norm(library.recorded_m_s2[0, 0, first[:stages]])
    assert library.tap_error[0, 0] == pytest.approx(np.linalg.norm(off) / size, rel=1e-4)


def test_what_few_readers_ask_for_is_made_when_it_is_read(
    scene: Scene, taps: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    real, priced = entries_room.prices, []

    def counted(*given: object, **named: object) -> object:
        priced.append(1)
        return real(*given, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(entries_room, "prices", counted)
    built = build_library(with_values(scene, {"grid.grips_N": [3.0, 5.0]}), taps)
    assert priced == []
    brief = build_markdown(built, full=False)
    assert len(priced) == 1
    assert "## Waveform and intensity" not in brief
    worst = max(built.all_entries(), key=lambda entry: entry.figures.tap_error - entry.floor)
    assert worst.prices
    assert worst.prices[0].stated in brief
    assert len(priced) == 1
    full = build_markdown(built)
    assert len(priced) == len(list(built.all_entries()))
    assert "## Waveform and intensity" in full
