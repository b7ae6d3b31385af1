"""Grid refinement: the error of blends between the nodes, the nodes that it adds, and what is written of them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

import problems
from tests.benches.commands import Outcome, Terminal
from tests.campaigns.test_grid_refinement import excess, random_points, soft_hand
from transopt.base.errors import InputError
from transopt.design.build import Build, build_library
from transopt.design.refine_grid import OffNode, Refinement, lacking, refine_grid
from transopt.design.verify import verify_library
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.proof.replay import replayed
from transopt.recordings.recording import Recording
from transopt.references.references import References
from transopt.report.markdown import build_markdown
from transopt.report.report_json import build_json
from transopt.report.tables import refinement_summary
from transopt.scene.builtin import load_scene
from transopt.scene.keys import with_values
from transopt.scene.recordings import recordings_of, references_of
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings
from transopt.solvers.options import SolverOptions


def with_grid(scene: Scene, speeds_m_s: list[float], grips_N: list[float]) -> Scene:
    grid = scene.grid.model_copy(update={"speeds_m_s": speeds_m_s, "grips_N": grips_N})
    return scene.model_copy(update={"grid": grid})


@pytest.fixture(scope="module")
def refinement(scene: Scene, taps: list[Recording]) -> Refinement:
    return refine_grid(scene, taps, 0.02)


@pytest.fixture(scope="module")
def refined(scene: Scene, taps: list[Recording], refinement: Refinement) -> Build:
    return build_library(scene, taps, refinement=refinement)


class TestTolerance:
    def test_default_scene(
        self, scene: Scene, refinement: Refinement, refined: Build, library: Library, recorded: References
    ) -> None:
        assert not refinement.shortfall
        assert refined.library is not None
        before, after = excess(scene, recorded, random_points(scene, 25), library, refined.library).T
        assert before.max() > 0.02
        assert after.max() <= 0.02
        assert refinement.entries <= 40
        assert all(not check.shortfalls for check in verify_library(refined.library))

    def test_resonance_that_moves_with_grip(self, scene: Scene) -> None:
        soft = with_grid(soft_hand(scene), [0.35, 0.4], [1.0, 3.0])
        taps = recordings(soft)
        found = refine_grid(soft, taps, 0.02)
        assert not found.shortfall
        assert max(p.excess_before for p in found.points) > 0.07
        assert max(p.excess_after for p in found.points) <= 0.02
        built = build_library(soft, taps, refinement=found)
        assert built.library is not None
        recorded = references_of(soft, taps)
        assert excess(soft, recorded, random_points(soft, 15), built.library).max() <= 0.02

    def test_nodes_of_the_scene_stay(self, scene: Scene, refinement: Refinement) -> None:
        assert set(scene.grid.speeds_m_s) < set(refinement.grid.speeds_m_s)
        assert set(scene.grid.grips_N) <= set(refinement.grid.grips_N)
        assert refinement.grid.grip_min_N == scene.grid.grip_min_N

    def test_points_are_what_a_device_would_play(
        self, scene: Scene, refinement: Refinement, refined: Build, library: Library, recorded: References
    ) -> None:
        """The map says the same as the definition applied to the two library files."""
        assert refined.library is not None
        points = refinement.off(refinement.grid)[::40]
        at = np.array([(p.speed_m_s, p.grip_N) for p in points])
        expected = [(p.before - p.optimum, p.after - p.optimum) for p in points]
        np.testing.assert_allclose(expected, excess(scene, recorded, at, library, refined.library), atol=1e-9)

    def test_what_a_blend_lacks_in_amplitude_counts_as_excess(self, refinement: Refinement) -> None:
        weak = OffNode(0.3, 2.0, optimum=0.1, before=0.1, after=0.09, before_dB=20 * np.log10(0.97), after_dB=0.1)
        assert weak.excess_before == pytest.approx(0.03)
        assert weak.excess_after == pytest.approx(-0.01)
        assert max(lacking(p.after_dB) for p in refinement.points) <= 0.02
        assert min(p.before_dB for p in refinement.off(refinement.recorded)) < 0

    def test_an_optimum_of_intensity_is_not_blended_weaker(self, scene: Scene, taps: list[Recording]) -> None:
        """The tap error alone would pass a blend that is nearer to the waveform and weaker."""
        loud = with_values(
            with_grid(scene, [0.2, 0.4], [5.0]), {"weights.objective": "intensity", "limits.current_A": 2.5}
        )
        own = [tap for tap in taps if min(abs(tap.speed_m_s / v - 1) for v in (0.2, 0.4)) < 0.1]
        found = refine_grid(loud, own, 0.02)
        assert not found.shortfall
        assert min(p.before_dB for p in found.points) < -0.2
        assert min(p.after_dB for p in found.points) > 20 * np.log10(0.98)

    def test_nothing_to_blend_at_a_node(self, scene: Scene, refinement: Refinement) -> None:
        """Optimum and blend are the same commands there; replayed side by side, each stage may round otherwise."""
        nodes = [p for p in refinement.points if p not in refinement.off(refinement.grid)]
        assert len(nodes) == refinement.entries
        rounding = scene.stages * np.finfo(float).eps  # of a tap error, which is of the size of 1 at most
        assert max(abs(p.excess_after) for p in nodes) <= rounding


def fastest_m_s(build: Build) -> float:
    """Largest speed of the motor at an instant of the blend at 0.4 m/s and 2 N, by matrix exponentials."""
    plant, pole = build.scene.plant(2.0), 2 * np.pi * 1050.0
    n = plant.order
    flow = np.zeros((n + 2, n + 2))
    flow[:n, :n], flow[:n, n], flow[n, n:] = plant.A, plant.B[:, 0], (-pole, pole)
    hold, x, fastest = scipy.linalg.expm(flow * 1e-4), np.zeros(n + 1), 0.0
    nominal_m_s = build.library.nominal_velocity_m_s[0, 0]
    for command, own in zip(build.library.at(0.4, 2.0).command, nominal_m_s, strict=True):
        fastest = max(fastest, abs(own + x[n // 2 : n].sum()))  # the rates of all links
        x = hold[:-1, :-1] @ x + hold[:-1, -1] * command
    return float(fastest)


class TestBetweenTheNodes:
    def test_optimum_and_blend_are_what_a_build_and_the_library_say(
        self, scene: Scene, taps: list[Recording], build: Build, library: Library
    ) -> None:
        """At a grip between the nodes: the optimum as an entry of its own, the blend through its device."""
        [point] = build.between_nodes([(0.4, 4.0)])
        own = [tap for tap in taps if abs(tap.speed_m_s / 0.4 - 1) < 0.1]
        [[exact]] = build_library(with_grid(scene, [0.4], [4.0]), own).entries
        assert point.optimum == pytest.approx(exact.figures.tap_error, abs=1e-6)
        played, _ = exact.problem.stage.rollout(library.at(0.4, 4.0).command)
        assert point.after == pytest.approx(exact.problem.yardstick.tap_error(exact.problem.target, played), abs=1e-6)
        # The blend may be nearer to the tap as it is: what it cannot have is a smaller J.
        blended = library.at(0.4, 4.0).command
        assert exact.problem.objective(blended, exact.problem.accelerations(blended)) > exact.certificate.objective

    def test_over_a_wall_the_feedback_is_that_of_the_motion_between(self) -> None:
        """A device blends the transients and adds its own feedback; the blend of total commands is another motion."""
        walled = with_grid(load_scene("walled"), [0.25], [1.0, 5.0])
        build = build_library(walled, recordings_of(walled))
        [point] = build.between_nodes([(0.25, 2.0)])
        problem, played = build.context.posed(0.25, 2.0).problem, build.library.at(0.25, 2.0)
        [alone] = replayed([problem], played.transient_command[None])
        assert point.after == pytest.approx(alone.figures.tap_error, abs=1e-9)
        moved, _ = problem.stage.rollout(played.command)
        assert abs(problem.yardstick.tap_error(problem.target, moved) - point.after) > 1e-3

    def test_a_limit_that_a_blend_leaves_between_grips_is_excess(self, scene: Scene) -> None:
        """Both nodes keep the velocity's limit, their blend does not: it moves a device with another hand."""
        tight = with_values(with_grid(scene, [0.4], [1.0, 5.0]), {"limits.velocity_m_s": 0.41})
        taps = recordings(tight)
        build = build_library(tight, taps)
        [point] = build.between_nodes([(0.4, 2.0)])
        assert point.after_beyond == pytest.approx(fastest_m_s(build) / 0.41 - 1, rel=1e-2)
        assert point.after_beyond > 5e-3
        by_limit = replace(point, optimum=1.0, after_dB=0.0)
        assert by_limit.excess_after == point.after_beyond
        found = refine_grid(tight, taps, 0.05)
        assert max(each.after_beyond for each in found.points) > 5e-3
        assert "blends leave a limit by up to" in refinement_summary(found)

    def test_a_limit_of_a_users_own_that_a_blend_leaves_counts_too(self, tmp_path: Path) -> None:
        """Stated at the switching instants alone, so that the designs are others than under the built-in limit."""
        law = 'to.own_limit("v", "m/s", lambda s: s.velocity, lower=-0.41)'
        (tmp_path / "own.py").write_text(f"import transopt as to\nLIMITS = [{law}]\n")
        text = problems.scene_path("wood_on_foam").read_text().replace("beta = 3.2", 'own = ["own.py"]\nbeta = 3.2')
        (tmp_path / "own.toml").write_text(text)
        own = with_grid(load_scene(str(tmp_path / "own.toml")), [0.4], [1.0, 5.0])
        build = build_library(own, recordings(own))
        [point] = build.between_nodes([(0.4, 2.0)])
        assert point.after_beyond == pytest.approx(fastest_m_s(build) / 0.41 - 1, rel=1e-6)
        assert point.after_beyond > 5e-3

    def test_each_point_has_its_result_in_the_order_asked(self, build: Build) -> None:
        """Points of one grip are replayed side by side; who reads them one after the other must not notice."""
        asked = [(0.3, 5.0), (0.2, 1.0), (0.1, 5.0), (0.2, 1.0)]
        assert [(each.speed_m_s, each.grip_N) for each in build.between_nodes(asked)] == asked

    @pytest.mark.parametrize("point", [(0.05, 3.0), (0.5, 3.0), (0.2, 0.9), (0.2, float("nan"))])
    def test_a_point_outside_is_refused(self, build: Build, point: tuple[float, float]) -> None:
        with pytest.raises(InputError, match=r"between_nodes: .* outside of the nodes"):
            build.between_nodes([point])


class TestSmallGrids:
    def test_one_grip(self, scene: Scene, taps: list[Recording]) -> None:
        found = refine_grid(with_grid(scene, scene.grid.speeds_m_s, [3.0]), taps, 0.02)
        assert not found.shortfall
        assert found.grid.grips_N == [3.0]
        assert len(found.grid.speeds_m_s) > 4
        figure = found.plot()
        assert figure.axes[0].get_xlabel() == "speed [m/s]"

    def test_one_speed(self, scene: Scene) -> None:
        soft = with_grid(soft_hand(scene), [0.2], [1.0, 5.0])
        found = refine_grid(soft, recordings(soft), 0.02)
        assert not found.shortfall
        assert found.grid.speeds_m_s == [0.2]
        assert len(found.grid.grips_N) > 2
        assert found.plot().axes[0].get_xlabel() == "grip [N]"

    def test_one_entry_has_nothing_to_refine(self, scene: Scene) -> None:
        single = with_grid(scene, [0.2], [3.0])
        taps = recordings(single)
        found = refine_grid(single, taps, 0.02)
        assert (found.entries, found.rounds, found.shortfall) == (1, 0, "")
        assert "nothing lies between the nodes" in refinement_summary(found)
        build = build_library(single, taps, refinement=found)
        assert "nothing lies between the nodes" in build_markdown(build, full=False)
        # No point lies off the nodes, so that this is what stands for nothing and no computed figure.
        assert build.library.meta["grid_refinement"]["worst_excess_after"] == 0.0


class TestRefusals:
    @pytest.mark.parametrize("tolerance", [0.0, -0.1, 1.0, float("nan")])
    def test_tolerance(self, scene: Scene, taps: list[Recording], tolerance: float) -> None:
        with pytest.raises(InputError, match=f"--grid-tolerance {tolerance:g}: must be between 0 and 1"):
            refine_grid(scene, taps, tolerance)

    def test_an_optimum_that_no_solver_can_prove(self, scene: Scene, taps: list[Recording]) -> None:
        with pytest.raises(InputError, match=r"--grid-tolerance: no proven optimum at 0\.3 m/s, 5 N"):
            refine_grid(scene, taps, 0.02, options=SolverOptions(max_iterations=2))


class TestCommandLine:
    def solve(self, terminal: Terminal, *arguments: str) -> Outcome:
        text = problems.scene_path("wood_on_foam").read_text().replace("[0.1, 0.2, 0.3, 0.4]", "[0.3, 0.4]")
        Path("quick.toml").write_text(text.replace("[1.0, 3.0, 5.0]", "[3.0]"))
        return terminal("transopt", "solve", "quick.toml", "--out", "here", *arguments)

    def test_figure_report_and_library(self, terminal: Terminal) -> None:
        outcome = self.solve(terminal, "--grid-tolerance", "0.01")
        assert outcome.code == 0
        assert "2 -> 4 entries in 2 rounds" in outcome.out
        assert Path("here/grid_error.png").read_bytes()[:4] == b"\x89PNG"
        assert "## Between the nodes" in Path("here/report.md").read_text()
        library = load_library(Path("here/library.npz"))
        np.testing.assert_array_equal(library.speeds_m_s, [0.3, 0.325, 0.35, 0.4])
        assert self.solve(terminal).code == 0
        assert not Path("here/grid_error.png").exists(), "belongs to an earlier library"

    def test_cap_writes_what_was_reached_and_exits_1(self, terminal: Terminal) -> None:
        outcome = self.solve(terminal, "--grid-tolerance", "0.001", "--grid-cap", "3")
        assert outcome.code == 1
        message = "grid tolerance 0.1 % not met with 3 entries (3 speeds x 1 grips, --grid-cap 3)"
        for words in (message, "worst remaining excess", "m/s", "raise --grid-cap"):
            assert words in outcome.out
        assert load_library(Path("here/library.npz")).speeds_m_s.size == 3
        assert "not met" in Path("here/report.md").read_text()


class TestWhatIsWritten:
    def test_library_says_what_was_recorded(self, scene: Scene, refinement: Refinement, refined: Build) -> None:
        meta = refined.library.meta
        said = meta["grid_refinement"]
        assert said["tolerance"] == 0.02
        assert said["recorded_speeds_m_s"] == scene.grid.speeds_m_s
        assert said["worst_excess_after"] <= 0.02 < said["worst_excess_before"]
        assert said["points"] == len(refinement.points)
        assert meta["scene"]["grid"]["speeds_m_s"] == refinement.grid.speeds_m_s
        assert {source["grid_speed_m_s"] for source in meta["sources"]} == set(scene.grid.speeds_m_s)

    def test_report(self, refined: Build) -> None:
        text = build_markdown(refined, full=False)
        for words in (
            "## Between the nodes",
            "| of the scene | 4 | 3 | 12 |",
            "| refined |",
            "not recorded but derived",
        ):
            assert words in text
        # References between the recorded ones are derived anew by who reads them.
        of_report = [r["speed_m_s"] for r in json.loads(build_json(refined, full=False))["references"]]
        assert sorted(of_report) == sorted(3 * [0.1, 0.2, 0.3, 0.4])

    def test_figure(self, refinement: Refinement) -> None:
        before, after, bar = refinement.plot().axes
        assert "grid of the scene, 12 entries" in before.get_title()
        assert f"refined, {refinement.entries} entries" in after.get_title()
        assert before.collections[0].get_clim() == after.collections[0].get_clim()
        assert "tap error or amplitude [%]" in bar.get_ylabel()
