"""The optimum for a measured tap: against the designer, against the blend, and where there is none."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controller.waveforms.bank import Method, bank, solved_for
from tests.benches.libraries import under
from tests.benches.oracle.blend import blend_at
from tests.benches.places import ROOT
from tests.conftest import walled_scene
from transopt.base.errors import InputError
from transopt.design.build import build_library
from transopt.design.context import Context
from transopt.design.optimum import optimum
from transopt.library import online, proven
from transopt.library.library import Library
from transopt.library.online import Online
from transopt.proof.certify import certify
from transopt.proof.replay import replay
from transopt.recordings.recording import Recording
from transopt.references.references import References
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.solvers.native import extension
from transopt.solvers.options import SolverOptions

pytestmark = pytest.mark.skipif(not extension.available, reason="the extension is not built")


@pytest.fixture(scope="module")
def solver(library: Library) -> Online:
    return Online(library, library.scene().plant)


def test_at_every_node_it_is_the_entry(library: Library, solver: Online) -> None:
    for iv, speed in enumerate(library.speeds_m_s):
        for ig, grip in enumerate(library.grips_N):
            tap = solver.solve(float(speed), float(grip))
            assert tap.solved
            assert tap.certificate.accepted
            assert tap.certificate.objective == pytest.approx(library.objective[iv, ig], rel=1e-6, abs=1e-9)
            np.testing.assert_allclose(tap.wave.command, library.command[iv, ig], atol=1e-4)
            np.testing.assert_array_equal(tap.wave.command, tap.wave.transient_command)


@pytest.mark.parametrize(("speed", "grip"), [(0.37, 4.2), (0.15, 1.3), (0.4, 2.0)])
def test_between_nodes_it_is_the_optimum_of_another_solver(
    library: Library, solver: Online, speed: float, grip: float
) -> None:
    tap = solver.solve(speed, grip)
    problem = solver._posed(library.posing(), speed, grip, library.coil())
    other = optimum(problem, SolverOptions("casadi-piqp"))
    assert tap.certificate.objective == pytest.approx(other.certificate.objective, rel=1e-6)
    blend = library.at(speed, grip).command
    rolled_out = problem.objective(blend, problem.accelerations(blend))
    assert tap.certificate.objective <= rolled_out + tap.certificate.duality_gap


class TestFreshTaps:
    """Random taps within the grid, against a search that starts from nothing the library knows."""

    def test_they_are_the_designers_optima(self, library: Library, solver: Online) -> None:
        draws, bound = np.random.default_rng(11), 0
        for _ in range(12):
            speed, grip = draws.uniform(0.1, 0.4), draws.uniform(1.0, 5.0)
            tap = solver.solve(speed, grip)
            assert tap.certificate is not None, tap.remark
            problem = solver._posed(library.posing(), speed, grip, library.coil())
            cold = optimum(problem, SolverOptions())
            scale = max(cold.certificate.objective, 1e-3)
            assert abs(tap.certificate.objective - cold.certificate.objective) <= 4e-9 * scale
            np.testing.assert_allclose(tap.wave.command, cold.solution.command, atol=1e-3)
            # A certificate that shares no code with the one of the answer.
            assert certify(problem, tap.wave.command, cold.solution.multipliers).relative_gap <= 1e-6
            bound += any(side.max() > 1e-9 for pair in cold.solution.multipliers.pairs.values() for side in pair)
        assert 3 <= bound <= 9  # some are limited, some are not

    @pytest.mark.parametrize("guess", [0, 1, 40, 500])
    def test_where_a_limit_is_expected_to_bind_changes_no_answer(
        self, library: Library, solver: Online, monkeypatch: pytest.MonkeyPatch, guess: int
    ) -> None:
        taps = [(0.4, 5.0), (0.31, 4.8), (0.12, 1.5)]
        own = [solver.solve(*tap) for tap in taps]
        standing = solver._standing(library.posing(), {})
        assert standing is not None
        monkeypatch.setattr(standing, "_bound", np.full_like(standing._bound, guess))
        for tap, known in zip(taps, own, strict=True):
            found = solver.solve(*tap)
            assert found.certificate is not None
            assert known.certificate is not None
            assert found.certificate.accepted
            assert found.certificate.objective == pytest.approx(known.certificate.objective, rel=1e-7)
            np.testing.assert_allclose(found.wave.command, known.wave.command, atol=1e-3)


class TestHeat:
    def test_a_hot_start_keeps_the_limit_which_the_blend_leaves(self, library: Library, solver: Online) -> None:
        coil = library.coil()
        start = coil.limit_C - 0.03
        tap, warm = solver.solve(0.4, 5.0, start, start), replace(coil, start_winding_C=start, start_housing_C=start)
        assert tap.certificate is not None
        # Not convex: the bound is that of the convex problem.
        c = tap.certificate
        assert c.accepted
        assert c.objective - c.duality_gap > c.lower_bound > 0.9 * c.objective
        commands = np.stack([tap.wave.command, library.at(0.4, 5.0).command])
        problem = solver._posed(library.posing(), 0.4, 5.0, warm)
        wanted = [problem.target] * 2
        cool, hot = replay(problem.stage, problem.grid, commands, wanted, warm, limits=[problem.limits] * 2)
        assert cool.winding_C == pytest.approx(coil.limit_C, abs=1e-3)
        assert hot.winding_C > coil.limit_C + 0.01
        assert not cool.shortfalls(problem, commands[0], problem.stage.rollout(commands[0])[0])

    @pytest.mark.parametrize(("winding_C", "housing_C"), [(100.0, 100.0), (99.99, 120.0)])
    def test_a_coil_that_no_command_keeps_below_its_limit_has_nothing_played(
        self, library: Library, solver: Online, winding_C: float, housing_C: float
    ) -> None:
        """The ripple's current or the housing alone heats it; the whole blend took the winding to 100.5 C."""
        tap = solver.solve(0.4, 5.0, winding_C, housing_C)
        assert tap.remark == "no certified optimum; nothing is played, for the library's blend leaves the limits"
        assert tap.wave.silent
        assert not tap.wave.command.any()

    @pytest.mark.parametrize("start_C", [99.5, 99.97])
    def test_which_problem_comes_first_changes_no_answer(
        self, solver: Online, monkeypatch: pytest.MonkeyPatch, start_C: float
    ) -> None:
        """The winding binds from one of the starts on; a wrong guess costs time alone."""
        taps = []
        for guess in (None, 500):
            monkeypatch.setattr(online, "_hottest", lambda effect, guess=guess: guess)
            taps.append(solver.solve(0.4, 5.0, start_C, start_C))
        cold, hot = taps
        assert hot.certificate.accepted
        assert cold.certificate.objective == pytest.approx(hot.certificate.objective, rel=1e-7)
        np.testing.assert_allclose(cold.wave.command, hot.wave.command, atol=1e-4)
        # Only where it binds is a convex problem needed to bound J from below.
        convex = [
            abs(c.objective - c.duality_gap - c.lower_bound) < 1e-12 for c in (cold.certificate, hot.certificate)
        ]
        assert convex == [start_C == 99.5] * 2

    def test_without_a_bound_of_its_own_the_convex_problem_is_solved(
        self, solver: Online, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        own = solver.solve(0.4, 5.0, 99.97, 99.97).certificate
        monkeypatch.setattr(proven, "relaxed_bound", lambda effect, multipliers: -np.inf)
        solved = solver.solve(0.4, 5.0, 99.97, 99.97).certificate
        assert own.lower_bound == pytest.approx(solved.lower_bound, rel=1e-4)

    def test_far_below_the_limit_it_changes_nothing(self, solver: Online) -> None:
        cold, warm = solver.solve(0.4, 5.0, 25.0), solver.solve(0.4, 5.0, 90.0)
        np.testing.assert_array_equal(cold.wave.command, warm.wave.command)

    def test_above_the_limit_nothing_is_played_and_the_reason_said(self, solver: Online) -> None:
        tap = solver.solve(0.3, 2.0, 101.0)
        assert not tap.solved
        assert tap.remark.startswith("winding 101 C is above its limit 100 C")
        assert tap.wave.silent
        assert not tap.wave.command.any()

    @pytest.mark.parametrize(
        ("temperatures", "wrong"),
        [
            ((-300.0, None), "winding"),
            ((-41.0, None), "winding"),
            ((25.0, -242.0), "housing"),
            ((None, 850.0), "housing"),
        ],
    )
    def test_at_a_faulty_sensor_nothing_is_played_and_the_reason_said(
        self, solver: Online, temperatures: tuple[float | None, float | None], wrong: str
    ) -> None:
        tap = solver.solve(0.4, 5.0, *temperatures)
        assert tap.remark.startswith(wrong)
        assert tap.remark.endswith("check its sensor")
        assert tap.wave.silent
        assert not tap.wave.command.any()

    def test_a_measured_housing_counts_without_a_measured_winding(self, library: Library, solver: Online) -> None:
        known = solver.solve(0.4, 5.0, library.coil().start_winding_C, 60.0)
        np.testing.assert_array_equal(solver.solve(0.4, 5.0, housing_C=60.0).wave.command, known.wave.command)

    @pytest.mark.parametrize("temperatures", [(float("nan"), None), (25.0, float("inf"))])
    def test_no_number_is_refused(self, solver: Online, temperatures: tuple[float, float | None]) -> None:
        with pytest.raises(InputError, match="must be a finite number"):
            solver.solve(0.3, 2.0, *temperatures)


def test_outside_the_grid_its_edge_is_solved_and_said(library: Library, solver: Online) -> None:
    tap = solver.solve(0.9, 7.0)
    assert tap.solved
    assert tap.wave.speed_clamped
    assert tap.wave.grip_clamped
    np.testing.assert_array_equal(tap.wave.command, solver.solve(0.4, 5.0).wave.command)


def test_without_grip_nothing_is_solved(solver: Online) -> None:
    tap = solver.solve(0.3, 0.1)
    assert not tap.solved
    assert tap.wave.silent
    assert not tap.wave.command.any()


def test_what_is_not_certified_is_not_played(library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two iterations are too few."""
    monkeypatch.setattr(online, "MOST_ITERATIONS", 2)
    tap = Online(library).solve(0.4, 5.0)
    assert tap.remark == "no certified optimum"
    np.testing.assert_array_equal(tap.wave.command, library.at(0.4, 5.0).command)


class TestOtherLimits:
    """A tap with limits that are not the library's is the entry of a scene that states them."""

    @pytest.mark.parametrize(
        ("limits", "section", "changes"),
        [
            ({"current_A": 3.0}, "limits", {"beta": None, "current_A": 3.0}),
            ({"command_A": 3.5}, "amplifier", {"command_limit_A": 3.5}),
            ({"slew_A_per_s": 15000.0}, "limits", {"slew_A_per_s": 15000.0}),
            ({"supply_V": 8.0}, "limits", {"supply_V": 8.0}),
            ({"temperature_C": 25.05}, "motor", {"winding_max_C": 25.05}),
            (
                {"current_A": 3.0, "slew_A_per_s": 15000.0},
                "limits",
                {"beta": None, "current_A": 3.0, "slew_A_per_s": 15000.0},
            ),
        ],
        ids=lambda value: "+".join(value) if isinstance(value, dict) else "",
    )
    def test_it_is_the_designers_optimum(
        self,
        scene: Scene,
        recorded: References,
        solver: Online,
        limits: dict[str, float],
        section: str,
        changes: dict[str, float | None],
    ) -> None:
        data = scene.model_dump()
        data[section] = {**data[section], **changes}
        stated = Scene.model_validate(data)
        problem = Context(stated, recorded).posed(0.4, 5.0).problem
        designed = optimum(problem, SolverOptions())
        tap = solver.solve(0.4, 5.0, limits=limits)
        assert tap.certificate is not None, tap.remark
        assert tap.certificate.objective == pytest.approx(designed.certificate.objective, rel=1e-6)
        np.testing.assert_allclose(tap.wave.command, designed.solution.command, atol=1e-4)
        # It does bind: with the library's own limits the answer is another one.
        own = solver.solve(0.4, 5.0)
        assert np.abs(tap.wave.command - own.wave.command).max() > 1e-2
        np.testing.assert_allclose(own.wave.command, solver.solve(0.4, 5.0, limits={}).wave.command, atol=1e-12)

    def test_a_wider_limit_is_used(self, solver: Online) -> None:
        wider, own = solver.solve(0.4, 5.0, limits={"current_A": 5.0}), solver.solve(0.4, 5.0)
        assert wider.certificate.accepted
        assert wider.certificate.objective < 0.8 * own.certificate.objective

    @pytest.mark.parametrize(
        ("limits", "message"),
        [
            ({"curent_A": 3.0}, "limits.curent_A: unknown; known here: current_A, "),
            ({"current_A": 0.0}, "limits.current_A = 0: must be > 0 and finite"),
            ({"supply_V": -12.0}, "limits.supply_V = -12: must be > 0 and finite"),
            ({"slew_A_per_s": float("nan")}, "limits.slew_A_per_s = nan: must be > 0 and finite"),
            ({"current_A": float("inf")}, "limits.current_A = inf: must be > 0 and finite"),
            ({"current_A": "3 A"}, "limits.current_A = '3 A': must be a number > 0"),
        ],
    )
    def test_what_is_no_limit_is_refused_in_one_line(
        self, solver: Online, limits: dict[str, float], message: str
    ) -> None:
        with pytest.raises(InputError) as caught:
            solver.solve(0.3, 2.0, limits=limits)
        assert str(caught.value).startswith(message)
        assert "\n" not in str(caught.value)

    @pytest.mark.parametrize(
        ("name", "message"),
        [
            ("command_A", "limits.command_A: the amplifier is ideal"),
            ("supply_V", "limits.supply_V: needs "),
            ("temperature_C", "limits.temperature_C: needs "),
        ],
    )
    def test_a_part_that_the_library_does_not_have_cannot_be_limited(
        self, library: Library, name: str, message: str
    ) -> None:
        # A drive that is stated at the tip has no coil and no circuit.
        tip = library.scene().drive_at_tip().model_dump()
        bare = under(library, {"motor": None, "transmission": None, "tip": tip, "amplifier": "ideal"})
        solver = Online(bare, library.scene().plant)
        with pytest.raises(InputError, match=message):
            solver.solve(0.3, 2.0, limits={name: 20.0})

    def test_without_an_optimum_the_blend_is_played_only_within_the_limits(
        self, library: Library, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(online, "MOST_ITERATIONS", 2)
        solver = Online(library)
        tight, loose = (solver.solve(0.4, 5.0, limits={"current_A": limit}) for limit in (3.0, 4.5))
        assert tight.wave.silent
        assert not tight.wave.command.any()
        assert tight.remark == "no certified optimum; nothing is played, for the library's blend leaves the limits"
        assert loose.remark == "no certified optimum"
        np.testing.assert_array_equal(loose.wave.command, library.at(0.4, 5.0).command)

    def test_a_winding_above_its_other_limit_plays_nothing(self, solver: Online) -> None:
        tap = solver.solve(0.3, 2.0, 60.0, limits={"temperature_C": 50.0})
        assert tap.remark == "winding 60 C is above its limit 50 C: let the motor cool"
        assert tap.wave.silent
        assert not tap.wave.command.any()
        assert solver.solve(0.3, 2.0, limits={"temperature_C": 20.0}).remark.startswith("winding 25 C is above")


class TestTheLibrarysOwnDevice:
    def test_without_a_plant_it_is_that_of_the_scene(self, library: Library, solver: Online) -> None:
        own = Online(library).solve(0.37, 4.2)
        np.testing.assert_array_equal(own.wave.command, solver.solve(0.37, 4.2).wave.command)

    def test_a_robust_librarys_spread_is_served(self, scene: Scene, taps: list[Recording]) -> None:
        data = scene.model_dump()
        data["robust"] = {"grip_spread": 0.2, "samples": 3}
        data["grid"] = {**data["grid"], "speeds_m_s": [0.4], "grips_N": [5.0]}
        robust = build_library(Scene.model_validate(data), [tap for tap in taps if "_0.4_m_s_" in tap.name]).library
        tap = Online(robust).solve(0.4, 5.0)
        assert tap.certificate.objective == pytest.approx(robust.objective[0, 0], rel=1e-6)
        np.testing.assert_allclose(tap.wave.command, robust.command[0, 0], atol=1e-4)


def test_over_a_wall(scene: Scene, taps: list[Recording]) -> None:
    """The ticks at which it pushes are those of the answer; the feedback is taken off the command."""
    walled = build_library(walled_scene(scene, 60.0), taps).library
    solver = Online(walled, walled.scene().plant)
    for speed, grip in ((0.2, 3.0), (0.4, 5.0), (0.33, 2.2)):
        tap = solver.solve(speed, grip)
        assert tap.solved, tap.remark
        handed_over = tap.wave.transient_command[-walled.hand_over_samples :]
        assert not handed_over.any()
        assert np.abs(tap.wave.command - tap.wave.transient_command).max() > 0.1
    problem = walled.problem(1, 1)
    entry = solver.solve(0.2, 3.0)
    np.testing.assert_allclose(entry.wave.command, walled.command[1, 1], atol=1e-4)
    assert certify(problem, walled.command[1, 1], walled.multipliers(1, 1)).objective == pytest.approx(
        entry.certificate.objective, rel=1e-6
    )


def test_without_the_extension_it_is_refused(library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(online, "available", False)
    with pytest.raises(InputError, match="online: the solver's extension is not built"):
        Online(library, library.scene().plant)


class TestBank:
    def test_plays_the_optimum_and_bounds_its_heat(self, library: Library, solver: Online) -> None:
        table = bank(library, Method.ONLINE)
        found = solved_for(library, table, 0.37, 4.2)
        np.testing.assert_array_equal(found.command_A[0, 0], solver.solve(0.37, 4.2).wave.transient_command)
        assert (found.speeds_m_s, found.grips_N) == ([0.37], [4.2])
        assert found.transient_A[0][0] == pytest.approx(blend_at(table, 0.37, 4.2).transient_A, rel=0.1)
        assert found.feedback_A[0][0] == pytest.approx(0.0, abs=1e-12)
        assert np.abs(found.command_A[0, 0] - library.at(0.37, 4.2).transient_command).max() > 1e-3

    def test_silence_stays_silence(self, library: Library) -> None:
        table = bank(library, Method.ONLINE)
        assert solved_for(library, table, 0.3, 0.1) is table


def test_a_tap_played_online_never_loads_the_optimiser(library: Library, tmp_path: Path) -> None:
    library.save(tmp_path / "library.npz")
    program = (
        "import sys; import controller.cli.play\n"
        "sys.argv = ['transopt-play', 'tap', sys.argv[1], '--simulate', '--method', 'online']\n"
        "try:\n    controller.cli.play.main()\nexcept SystemExit as stop:\n    assert not stop.code\n"
        "assert 'transopt.library.online' in sys.modules\n"
        "assert not {'casadi', 'matplotlib', 'serial'} & set(sys.modules)"
    )
    path = str(tmp_path / "library.npz")
    subprocess.run([sys.executable, "-c", program, path], check=True, cwd=ROOT, timeout=60)


class TestWhatIsNoInput:
    """Whoever calls it from another program may be wrong about anything: one line, never another exception."""

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (("fast", 2.0), "speed 'fast' m/s: must be a finite number"),
            ((None, 2.0), "speed None m/s"),
            ((np.array([0.1, 0.2]), 2.0), "speed array"),
            ((0.3, float("nan")), "grip nan N"),
            ((0.3, True), "grip True N"),
            ((0.3, 2.0 + 1j), "grip (2+1j) N"),
            ((0.3, 2.0, "warm"), "winding 'warm' C"),
            ((0.3, 2.0, 25.0, [25.0]), "housing [25.0] C"),
            ((0.3, 2.0, None, None, 4.0), "limits = 4.0: must be a table"),
            ((0.3, 2.0, None, None, {"current_A": "4"}), "limits.current_A = '4': must be a number > 0"),
            ((0.3, 2.0, None, None, {"current_A": 1e9}), "must be > 0 and finite, at most 10000 A"),
            ((0.3, 2.0, None, None, {"current_A": 10**400}), "must be > 0 and finite"),
        ],
    )
    def test_a_tap(self, solver: Online, arguments: tuple[Any, ...], words: str) -> None:
        with pytest.raises(InputError) as caught:
            solver.solve(*arguments)
        assert words in str(caught.value)
        assert str(caught.value).isprintable()

    def test_numbers_of_numpy_are_numbers(self, solver: Online) -> None:
        plain, numpy = solver.solve(0.3, 2.0), solver.solve(np.float64(0.3), np.array([2.0]))  # type: ignore[arg-type]
        np.testing.assert_array_equal(plain.wave.command, numpy.wave.command)

    @pytest.mark.parametrize(
        ("plant", "spread", "words"),
        [
            ("drive", None, "plant = 'drive': must be a function"),
            (lambda grip: None, None, "is None: must be a StateSpace"),
            (None, lambda grip: [1.0], "must be a tuple of StateSpace"),
        ],
    )
    def test_a_device(self, library: Library, plant: Any, spread: Any, words: str) -> None:
        with pytest.raises(InputError, match=words):
            Online(library, plant, spread)

    def test_a_library(self) -> None:
        with pytest.raises(InputError, match=r"'library.npz' is no library: give what `load_library` returns"):
            Online("library.npz")  # type: ignore[arg-type]


def test_intensity_is_solved_at_the_lam_between_the_nodes(scene: Scene, taps: list[Recording]) -> None:
    loud = with_values(scene, {"limits.current_A": 2.5, "weights.objective": "intensity"})
    library = build_library(loud, taps).library
    online = Online(library)
    node = online.solve(0.4, 5.0)
    assert node.certificate is not None
    assert node.certificate.objective == pytest.approx(library.objective[3, 2], rel=1e-8)
    np.testing.assert_allclose(node.wave.command, library.command[3, 2], atol=1e-4)
    for speed_m_s, grip_N in ((0.35, 5.0), (0.33, 2.0)):
        tap = online.solve(speed_m_s, grip_N)
        assert tap.solved, tap.remark
        made, _ = library.posing().stage(loud.plant(grip_N)).rollout(tap.wave.command)
        wanted = library.wanted(speed_m_s, grip_N).target.window_m_s2
        rapid = library.posing().rapid
        made, wanted = rapid.apply(made), rapid.apply(wanted)
        # A lam between those of the nodes has about the energy; an optimum of the waveform lacks 2 to 3 dB.
        assert abs(10 * np.log10(float(made @ made) / float(wanted @ wanted))) < 0.4
