"""Designs for a nonlinear plant, whole: beside the linear design, refused where they must be, and nowhere else."""

import json
import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import transopt as to
from tests.benches.actuators import NONLINEAR, nonlinear_scene
from tests.benches.commands import Terminal, assert_refused
from transopt.base.errors import InputError
from transopt.design import nonlinear
from transopt.design.build import Build
from transopt.design.solve import design_nonlinear
from transopt.problem.answer import Solution, Status
from transopt.problem.nonlinear import NonlinearProblem
from transopt.proof import nonlinear_replay
from transopt.proof.admit import NO_MOTION, admit
from transopt.proof.nonlinear_replay import replay_nonlinear
from transopt.report.nonlinear import nonlinear_markdown
from transopt.scene.builtin import load_scene
from transopt.solvers.options import SolverOptions

GIVEN = 'force_factor = "BL*(1 - 0.3*(x/0.6e-3)**2)"'
SHORT = ("stages = 80", "stages = 40"), ("cycles = 2", "cycles = 1")


@pytest.fixture(scope="module")
def design(tmp_path_factory: pytest.TempPathFactory) -> Build:
    return design_nonlinear(nonlinear_scene(tmp_path_factory.mktemp("nonlinear")))


class TestDesign:
    def test_is_proven_played_and_at_most_half_as_wrong_as_the_linear_one(self, design: Build) -> None:
        (entry,) = design.all_entries()
        assert entry.status is Status.STATIONARY
        assert not entry.shortfalls
        assert entry.certificate.is_stationary
        assert entry.figures.tap_error <= 0.5 * entry.linear_tap_error
        assert entry.linear_promised < entry.linear_tap_error
        assert entry.off_replay <= 1e-6
        assert entry.played.step_error <= 1e-6

    def test_hands_out_commands_by_target(self, design: Build) -> None:
        assert design.command("click").shape == (80,)
        assert np.abs(design.command("click")).max() <= 12
        with pytest.raises(InputError, match="clack: no target of this scene: click"):
            design.command("clack")

    def test_shows_both_designs(self, design: Build) -> None:
        assert "1 of 1 entries certified stationary" in repr(design)
        assert "of the linear design" in repr(design.entries[0][0])
        assert "linear % promised / played" in design._repr_html_()
        assert not design.entries[0][0].linear_leaves

    def test_is_replayed_as_by_one_period_after_the_other(
        self, design: Build, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        ((entry,),) = design.entries
        problem = entry.designed.nonlinear
        assert problem is not None
        monkeypatch.setattr(nonlinear_replay, "MOST_SHOTS", 0)
        (expected,) = replay_nonlinear(problem, [entry.solution.command])
        size = expected.scale_m_s2
        assert entry.made_m_s2 == pytest.approx(expected.lasting_m_s2, abs=1e-8 * size)
        assert entry.played.reached == pytest.approx(expected.reached, rel=1e-8)

    def test_starts_from_rest_where_the_linear_design_leads_nowhere(self, tmp_path: Path) -> None:
        """On a spring that stiffens steeply the linear command makes a motion from which IPOPT does not find back."""
        steep = 'stiffness = "K*(1 + 80*(x/0.3e-3)**10)"\n[limits]'
        pulse = (
            "frequency_Hz = 150\ncycles = 2\npeak_m_s2 = 12.0",
            "frequency_Hz = 247\ncycles = 3\npeak_m_s2 = 22.0",
        )
        path = nonlinear_scene(tmp_path, ("[limits]", steep), ("stroke_m = 6e-4", "stroke_m = 1.8e-4"), pulse)
        [entry] = design_nonlinear(path, options=SolverOptions(max_iterations=40)).all_entries()
        assert entry.status is Status.STATIONARY
        assert entry.solution.iterations > 40

    def test_draws_the_motion_on_the_nonlinear_plant(self, design: Build) -> None:
        ((entry,),) = design.entries
        figure = entry.plot()
        assert "nonlinear plant: certified stationary points" in figure.get_supxlabel()
        drawn = [np.asarray(line.get_ydata()) for axes in figure.axes for line in axes.lines]
        in_g = entry.predicted_m_s2 / 9.80665
        assert any(y.size >= in_g.size and np.allclose(y[: in_g.size], in_g, atol=1e-9) for y in drawn)

    def test_says_what_the_margin_of_the_stroke_costs(self, design: Build, tmp_path: Path) -> None:
        """To first order: a stroke that is longer by a tenth of the margin lowers J by a tenth of the cost."""
        [entry] = design.all_entries()
        [(part, said)] = entry.designed.left_out.items()
        stated = re.search(r"the (\S+) m that it keeps back between them cost to first order (\S+) % of J", said)
        assert stated is not None, said
        margin_m, cost = float(stated.group(1)), float(stated.group(2)) / 100
        longer = f"stroke_m = {6e-4 + 0.1 * margin_m:.9g}"
        [other] = design_nonlinear(nonlinear_scene(tmp_path, ("stroke_m = 6e-4", longer))).all_entries()
        saved = 1 - other.certificate.objective / entry.certificate.objective
        assert saved == pytest.approx(0.1 * cost, rel=0.1)
        assert f"- {part}: {said}" in nonlinear_markdown(design)


class TestRefusedAnswer:
    def designed(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, **changed: Any) -> Build:
        true = nonlinear.solve

        def wrong(
            problem: NonlinearProblem, start: np.ndarray, options: SolverOptions
        ) -> tuple[NonlinearProblem, Solution]:
            posed, found = true(problem, start, options)
            return posed, replace(found, **{name: change(found) for name, change in changed.items()})

        monkeypatch.setattr(nonlinear, "solve", wrong)
        return design_nonlinear(nonlinear_scene(tmp_path))

    def test_a_command_that_is_not_the_optimum(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        made = self.designed(tmp_path, monkeypatch, command=lambda found: 0.99 * found.command)
        assert made.entries[0][0].status is Status.NOT_CERTIFIED
        assert "no stationary point" in made.entries[0][0].shortfalls[0]
        with pytest.raises(InputError, match="click: refused: not certified"):
            made.command("click")

    def test_a_solver_that_broke_down(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            made = self.designed(
                tmp_path,
                monkeypatch,
                command=lambda found: np.full_like(found.command, np.nan),
                status=lambda _: Status.NUMERICAL_FAILURE,
                message=lambda _: "Invalid_Number_Detected",
            )
        assert made.entries[0][0].status is Status.NUMERICAL_FAILURE
        assert made.entries[0][0].shortfalls[0] == "IPOPT: Invalid_Number_Detected"

    def test_too_few_iterations(self, tmp_path: Path) -> None:
        made = design_nonlinear(nonlinear_scene(tmp_path), options=SolverOptions(max_iterations=2))
        assert made.entries[0][0].status is Status.ITERATION_LIMIT

    def test_a_motion_beyond_the_formulas_says_what_keeps_it_within(
        self, tmp_path: Path, capfd: pytest.CaptureFixture[str]
    ) -> None:
        ends = ("0.3*(x/0.6e-3)**2)", "(x/0.2e-3)**2)**0.5")
        [entry] = design_nonlinear(nonlinear_scene(tmp_path, ends)).all_entries()
        assert entry.shortfalls == ["IPOPT: Invalid_Number_Detected", NO_MOTION]
        assert capfd.readouterr() == ("", "")
        [entry] = design_nonlinear(
            nonlinear_scene(tmp_path, ends, ("stroke_m = 6e-4", "stroke_m = 1.8e-4"))
        ).all_entries()
        assert entry.status is Status.STATIONARY

    @pytest.mark.parametrize(
        ("sharp", "said", "mended"),
        [
            (("L_H = 0.0005", "L_H = 8e-6"), "leave model.L_H out", ("L_H = 0.0005", "")),
            (
                (GIVEN, 'force_factor = "BL*(1 - 0.3*abs(x)/0.6e-3)"'),
                "write sqrt(z**2 + e**2) - e",
                (GIVEN, 'force_factor = "BL*(1 - 0.3*(sqrt(x**2 + 1e-10) - 1e-5)/0.6e-3)"'),
            ),
        ],
        ids=["coil", "kink"],
    )
    def test_what_turns_too_sharply_says_what_mends_it(
        self, tmp_path: Path, sharp: tuple[str, str], said: str, mended: tuple[str, str]
    ) -> None:
        [entry] = design_nonlinear(nonlinear_scene(tmp_path, sharp, *SHORT)).all_entries()
        assert entry.status in (Status.REPLAY_VIOLATION, Status.ITERATION_LIMIT)
        assert said in entry.shortfalls[-1]
        [entry] = design_nonlinear(nonlinear_scene(tmp_path, mended, *SHORT)).all_entries()
        assert entry.status is Status.STATIONARY

    @pytest.mark.parametrize(
        ("limits", "said", "remedies"),
        [
            # The last command is zero.
            (
                "to.own_limit('least', 'V', lambda s: s.voltage, lower=0.05)",
                ["least 0.05 V below its limit 0.05 V at 7.8 ms"],
                ["no limits.own.least"],
            ),
            # At contact the mass is at rest.
            (
                "to.own_limit('away', 'm', lambda s: s.position, lower=1e-5)",
                ["away 1e-05 m below its limit 1e-05 m at 0.0 ms"],
                ["no limits.own.away"],
            ),
            # Two bounds on one variable that cross: halfway each is missed by half of their distance.
            (
                "to.own_limit('most', 'A', lambda s: s.current, upper=0.05), "
                "to.own_limit('more', 'A', lambda s: s.current - 0.2 * (s.stage > 20), lower=-0.05)",
                ["most 0.05 A over its limit 0.05 A at 4.2 ms", "more 0.05 A below its limit -0.05 A at 4.2 ms"],
                ["no limits.own.most", "no limits.own.more"],
            ),
        ],
        ids=["hand-over", "at rest", "crossing"],
    )
    def test_a_limit_that_no_command_keeps_is_named_and_left_out(
        self, tmp_path: Path, limits: str, said: list[str], remedies: list[str]
    ) -> None:
        (tmp_path / "own.py").write_text(f"import transopt as to\nLIMITS = [{limits}]\n")
        path = nonlinear_scene(tmp_path, ("[limits]", '[limits]\nown = ["own.py"]'), *SHORT)
        [entry] = design_nonlinear(path).all_entries()
        assert not entry.admitted
        for each in said:
            assert each in "; ".join(entry.shortfalls)
        assert [str(remedy) for remedy in entry.remedies if remedy.solved] == remedies
        assert entry.shortfalls[-1].endswith("would do")

    def test_too_steep_a_friction_says_how_steep_it_may_be(self, tmp_path: Path) -> None:
        def designed(v0: object, **options: int) -> Any:
            friction = ("[limits]", f'friction = "0.04*tanh(v/{v0})"\n[limits]')
            scene = nonlinear_scene(tmp_path, friction, *SHORT)
            return design_nonlinear(scene, options=SolverOptions(**options)).entries[0][0]

        # The replay differs after two iterations as it does at the optimum.
        said = "; ".join(designed(2e-4, max_iterations=2).shortfalls)
        assert "smallest mass" not in said
        most = re.search(r"model\.nonlinear\.friction rises by .* at most (\S+) N s/m, by a larger v0", said)
        assert most is not None, said
        assert designed(0.04 / float(most.group(1))).status is Status.STATIONARY

    def test_a_replay_that_does_not_converge_names_the_friction_too(self, tmp_path: Path) -> None:
        steep = ("[limits]", 'friction = "0.01*tanh(v/1e-4)"\n[limits]')
        [entry] = design_nonlinear(
            nonlinear_scene(tmp_path, steep), options=SolverOptions(max_iterations=2)
        ).all_entries()
        _, said = admit(entry.designed, replace(entry.played, step_error=1e-3))
        assert "model.nonlinear.friction rises by 1e+02 N s/m" in next(each for each in said if "converge" in each)


class TestScene:
    def test_what_takes_linear_plants_alone_is_refused_by_one_line(self, tmp_path: Path, terminal: Terminal) -> None:
        path = nonlinear_scene(tmp_path)
        with pytest.raises(InputError, match=r"this needs a linear plant; `transopt solve` and transopt\.build"):
            to.load_scene(path).posing()
        refused = terminal("transopt", "solve", path, "--out", tmp_path / "out", "--grid-tolerance", "0.02")
        assert_refused(refused, "--grid-tolerance", "model.nonlinear")
        assert not (tmp_path / "out").exists()

    def test_a_friction_that_pushes_within_the_stroke_is_refused_by_one_line(
        self, tmp_path: Path, terminal: Terminal
    ) -> None:
        spring = nonlinear_scene(tmp_path, ("[limits]", 'friction = "300*x"\n[limits]'))
        refused = terminal("transopt", "solve", spring, "--out", tmp_path / "out")
        assert_refused(refused, "model.nonlinear.friction", "take out what depends on x alone")
        assert not (tmp_path / "out").exists()

    def test_solve_writes_what_the_design_says(self, tmp_path: Path, terminal: Terminal) -> None:
        out = tmp_path / "out"
        solved = terminal("transopt", "solve", nonlinear_scene(tmp_path), "--out", out)
        assert solved.code == 0, solved.err
        assert "1 target, certified stationary and replayed." in solved.out
        [entry] = json.loads((out / "nonlinear.json").read_text())["entries"]
        assert entry["status"] == "stationary"
        assert entry["tap_error"] < 0.5 * entry["linear_tap_error"]
        assert "stationary" in (out / "nonlinear.md").read_text()
        stored = to.load_library(out / "library.npz")
        assert stored.tap_error[0, 0] == pytest.approx(entry["tap_error"], rel=1e-9)
        assert stored.tap_error_linear[0, 0] == pytest.approx(entry["linear_tap_error"], rel=1e-9)
        assert (out / "nonlinear.png").read_bytes().startswith(b"\x89PNG")
        # The command in the file, played by DOP853 on the equations of motion, has the error that the report states.
        command = np.loadtxt(out / "nonlinear.csv", delimiter=",", skiprows=1)[:, 1]
        [own] = design_nonlinear(nonlinear_scene(tmp_path)).all_entries()
        assert own.designed.nonlinear is not None
        [played] = replay_nonlinear(own.designed.nonlinear, [command])
        assert played.figures.tap_error == pytest.approx(entry["tap_error"], rel=1e-6)

    def test_solve_hands_out_no_command_that_is_not_proven(
        self, tmp_path: Path, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        out = tmp_path / "out"
        out.mkdir()
        (out / "nonlinear.csv").write_text("of an earlier design")
        (out / "library.npz").write_text("of an earlier design")
        solve = nonlinear.solve
        monkeypatch.setattr(
            nonlinear, "solve", lambda posed, start, options: solve(posed, start, replace(options, max_iterations=2))
        )
        solved = terminal("transopt", "solve", nonlinear_scene(tmp_path), "--out", out)
        assert solved.code == 1
        assert "1 of 1 target refused, so no library is written and an earlier one is kept." in solved.out
        assert "refused: click: the solver stopped" in solved.out
        assert json.loads((out / "nonlinear.json").read_text())["entries"][0]["status"] == "iteration_limit"
        assert not (out / "nonlinear.csv").exists()
        assert (out / "library.npz").read_text() == "of an earlier design"

    def test_without_the_table_it_is_the_linear_scene(self, tmp_path: Path) -> None:
        path = nonlinear_scene(tmp_path)
        at_rest = load_scene(path).at_rest()
        plain = load_scene(
            nonlinear_scene(
                tmp_path, (NONLINEAR[NONLINEAR.index("[model.nonlinear]") : NONLINEAR.index("[limits]")], "")
            )
        )
        assert at_rest == plain
        assert at_rest.at_rest() is at_rest
        assert to.build(at_rest).library is not None

    def test_a_linear_scene_has_no_nonlinear_design(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"model\.nonlinear: missing"):
            design_nonlinear(load_scene(nonlinear_scene(tmp_path)).at_rest())

    @pytest.mark.parametrize(
        ("swap", "said"),
        [
            (("BL*(1 - 0.3", "os.system(1 - 0.3"), "no part of a formula"),
            (("BL*(1", "1.0*(1"), "1 N/A at rest, the linear model has 0.8 N/A"),
            (("[weights]", '[weights]\nobjective = "intensity"'), "only with weights.objective"),
            (("[weights]", "[robust]\nquality_spread = 0.1\n[weights]"), "leave one of them out"),
            (("force_factor =", "forcefactor ="), "forcefactor"),
        ],
    )
    def test_what_it_cannot_be_is_one_line(self, tmp_path: Path, swap: tuple[str, str], said: str) -> None:
        with pytest.raises(InputError, match=said) as refused:
            load_scene(nonlinear_scene(tmp_path, swap))
        assert "\n" not in str(refused.value)

    def test_a_target_of_zero_is_refused(self, tmp_path: Path) -> None:
        rows = "\n".join(f"{1e-4 * k:g},{np.sin(k) if k > 700 else 0:g}" for k in range(1000))
        (tmp_path / "nothing.csv").write_text(f"time_s,acceleration_m_s2\n{rows}\n")
        shape = 'shape = "burst"\nfrequency_Hz = 150\ncycles = 2\npeak_m_s2 = 12.0\n'
        path = nonlinear_scene(
            tmp_path, (shape, f'file = "{(tmp_path / "nothing.csv").as_posix()}"\nlength_s = 5e-3\n')
        )
        with pytest.raises(InputError, match=r"targets\.click: is zero throughout"):
            design_nonlinear(path)

    def test_it_needs_named_targets(self, tmp_path: Path) -> None:
        taps = '[grid]\nspeeds_m_s = [0.1]\n[recordings]\nfiles = ["a.csv"]\n'
        block = NONLINEAR[NONLINEAR.index("[[targets]]") : NONLINEAR.index("[model]")]
        with pytest.raises(InputError, match=r"needs \[\[targets\]\], not speeds"):
            load_scene(nonlinear_scene(tmp_path, (block, taps)))
