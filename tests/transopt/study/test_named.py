"""The named studies, in short forms."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import image

import problems
import transopt
from tests.benches.study import read, serial
from transopt.base.errors import InputError
from transopt.base.writing import percent
from transopt.scene.builtin import load_scene
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.study import motor_selection
from transopt.study.axes import parse_axis
from transopt.study.figures import entry_grid
from transopt.study.grid_spacing import spacing, spacing_study
from transopt.study.grip_mismatch import mismatch, mismatch_sentence
from transopt.study.key_studies import KEY_STUDIES
from transopt.study.named import IN_PROCESS, write
from transopt.study.optima import proven_sentence
from transopt.study.plan import Plan, two_speeds
from transopt.study.rows import Row, row_of
from transopt.study.session import run_plan


def at(scene: Scene, speeds_m_s: list[float], grips_N: list[float]) -> Scene:
    """The scene at other speeds and grips."""
    return with_values(scene, {"grid.speeds_m_s": speeds_m_s, "grid.grips_N": grips_N})


def made_up(plan: Plan, refused: Callable[[str, float], bool] = lambda value, grip_N: False) -> list[Row]:
    """Rows of a study of one key: errors that fall with the value, and rise with speed and grip."""
    places = [(v, g) for v in plan.speeds_m_s for g in plan.grips_N]
    rows = []
    for k in range(plan.points * len(places)):
        point, (speed_m_s, grip_N) = k // len(places), places[k % len(places)]
        labels = plan.labels(point)
        (value,) = labels.values()
        error, dB = 0.3 / (1 + point) + 0.1 * speed_m_s + 0.01 * grip_N, -2.0 / (1 + point) - speed_m_s
        figures = {"tap_error": error, "floor": 0.1, "free_peak": 3.0, "felt_dB": dB, "energy_dB": dB}
        figures |= {"waveform_dB": dB, "peak_input": 4.0 - point - 0.1 * grip_N}
        place = {"index": k, "speed_m_s": speed_m_s, "grip_N": grip_N, "target": ""}
        answer = {"status": "INFEASIBLE"} if refused(value, grip_N) else {"status": "OPTIMAL", **figures}
        rows.append(row_of({**place, **answer}, point, labels))
    return rows


class TestNamed:
    def test_swept_study_leaves_figure_and_finding(
        self,
        short: Scene,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        fewer = replace(KEY_STUDIES["current_limit"], axis="limits.current_A=1.25,4,6")
        monkeypatch.setitem(KEY_STUDIES, "current_limit", fewer)
        scene = at(short, [0.1, 0.4], [1.0, 5.0])
        command = "transopt study 'my scene.toml' --study current_limit"
        code, finding = write(
            "current_limit", scene, tmp_path / "out", serial(), command, figures=tmp_path / "figures"
        )
        assert code == 0
        assert "At 1.25 A the limit cuts" in finding
        assert np.ptp(image.imread(tmp_path / "figures" / "current_limit.png")) > 0
        assert f"`{command}`: " in (tmp_path / "out" / "current_limit" / "report.md").read_text()

    @pytest.mark.parametrize(
        ("name", "axis"),
        [("amplifier_bandwidth", "amplifier.pole_Hz=30,1050,5000"), ("lead", "time.lead_s=0,0.0003")],
    )
    def test_findings_follow_from_rows(self, short: Scene, tmp_path: Path, name: str, axis: str) -> None:
        fewer = replace(KEY_STUDIES[name], axis=axis)
        plan = fewer.plan(at(short, [0.1, 0.4], [5.0]))
        rows = run_plan(plan, tmp_path, serial())
        said = fewer.finding(plan, rows)
        worst = entry_grid(plan, rows, "tap_error")
        assert percent(float(worst[0].max())) in said or f"{100 * worst[0, 0].max():.2f}" in said

    def test_what_intensity_needs_stands_beside_what_the_waveform_needs(self, short: Scene, tmp_path: Path) -> None:
        fewer = replace(KEY_STUDIES["intensity"], axis="limits.current_A=2,3,4")
        plan = fewer.plan(at(short, [0.4], [5.0]))
        rows = run_plan(plan, tmp_path, serial())
        energy, wave, needed = (entry_grid(plan, rows, name) for name in ("energy_dB", "waveform_dB", "free_peak"))
        np.testing.assert_allclose(energy, 0.0, atol=0.011)
        assert np.all(np.diff(wave[:, 0, 0]) > 0)
        said = fewer.finding(plan, rows)
        assert "takes 2 A at every entry" in said
        assert f"waveform takes {needed.max():.2f} A" in said
        assert len(fewer.figure(plan, rows).axes) == 2

    def test_a_tap_rate_that_leaves_no_time_for_a_waveform_is_left_out(self, short: Scene, tmp_path: Path) -> None:
        fewer = replace(KEY_STUDIES["tap_rate"], axis="thermal.tap_rate_Hz=2,10,500")
        plan = fewer.plan(at(short, [0.4], [5.0]))
        rows = run_plan(plan, tmp_path, serial())
        assert [row["status"] for row in rows] == ["OPTIMAL", "OPTIMAL", "REFUSED"]
        assert "at 10 taps/s" in fewer.finding(plan, rows)

    def test_a_study_without_an_answer_says_why(self, short: Scene, tmp_path: Path) -> None:
        ideal = at(short, [0.4], [5.0]).model_copy(update={"amplifier": "ideal"})
        code, finding = write("amplifier_bandwidth", ideal, tmp_path, serial(), "")
        assert code == 1
        assert finding.startswith("0 of 13 entries certified")
        assert "the first: wood_on_foam: amplifier.delay_s: missing" in finding

    def test_a_smaller_motor_is_asked_for_no_more_than_its_peak(self) -> None:
        small = load_scene("small_coil")
        assert small.motor is not None
        limit_A = KEY_STUDIES["tap_rate"].plan(small).scene.limits.current_A
        assert limit_A == pytest.approx(small.motor.i_peak_A)

    def test_an_amplifier_that_costs_nothing_at_all_is_blamed_for_nothing(self, scene: Scene) -> None:
        own = KEY_STUDIES["amplifier_bandwidth"]
        plan = own.plan(scene)
        rows = [{**row, "tap_error": "0.3"} for row in made_up(plan)]
        assert own.finding(plan, rows).endswith("the scene's 1050 Hz costs nothing.")

    @pytest.mark.parametrize("name", KEY_STUDIES)
    def test_a_refused_entry_or_value_leaves_the_finding_of_the_others(self, scene: Scene, name: str) -> None:
        """The finding is that of a study of neither the refused grip nor the refused value."""
        own = KEY_STUDIES[name]
        key, unit = own.axis.split("=")[0], {"lead": 1e-4, "amplifier_bandwidth": 1e3}.get(name, 1.0)
        study = replace(own, axis=f"{key}={2 * unit:g},{4 * unit:g},{6 * unit:g}")
        fewer = replace(own, axis=f"{key}={2 * unit:g},{4 * unit:g}")
        plan, less = study.plan(scene), fewer.plan(at(scene, [0.1, 0.2, 0.3, 0.4], [1.0, 5.0]))
        whole, entries = fewer.finding(less, made_up(less)), 3 * len(plan.speeds_m_s)
        assert ("the scene's 1050 Hz costs more than that" in whole) == (name == "amplifier_bandwidth")
        refused = made_up(plan, lambda value, grip_N: value == plan.axes[0].labels[2] or grip_N == 3)
        assert study.finding(plan, refused) == (
            f"{whole} At 1 of 3 values every entry is without a certified optimum. Left out: {entries // 3} of "
            f"{entries} entries, without a certified optimum at some other value."
        )
        figure = study.figure(plan, refused)
        lines = [line for axes in figure.axes for line in axes.get_lines()]
        drawn = {(*line.get_color(), line.get_linestyle(), line.get_marker()) for line in figure.axes[0].get_lines()}
        assert len(lines) == 2 * entries
        assert len(drawn) == len(figure.axes[0].get_lines())  # no two look the same
        assert not study.finding(plan, made_up(plan, lambda value, grip_N: True))

    def test_a_least_lead_that_is_some_is_not_called_none(self, scene: Scene) -> None:
        own = KEY_STUDIES["lead"]
        plan = own.plan(scene)
        finding = own.finding(plan, made_up(plan))
        assert finding.startswith("Without a lead the slowest taps err by")
        assert "no current acts before 0.068 ms" in finding
        finding = own.finding(plan, made_up(plan, lambda value, grip_N: float(value) == 0))
        assert finding.startswith("With a lead of 0.1 ms the slowest")
        assert "ithout a lead" not in finding
        assert "no current acts before" not in finding  # the lead is longer than the delay of the amplifier

    def test_asks_about_the_speeds_and_grips_of_the_scene(self, scene: Scene) -> None:
        other = at(scene, [0.15, 0.2], [2.0, 4.0])
        plan = KEY_STUDIES["lead"].plan(other)
        assert (plan.speeds_m_s, plan.grips_N) == ((0.15, 0.2), (2.0, 4.0))
        assert KEY_STUDIES["tap_rate"].plan(scene).speeds_m_s == (0.3, 0.4)
        assert two_speeds(scene) == (0.2, 0.4)
        assert two_speeds(other) == (0.15, 0.2)
        assert two_speeds(at(scene, [0.2], [2.0])) == (0.2,)
        one_grip = at(scene, [0.1, 0.2], [2.0])
        for measure in (mismatch, spacing_study):
            with pytest.raises(InputError, match=r"has one: state two or more in grid\.grips_N"):
                measure(one_grip)
        with pytest.raises(InputError, match=r"has one speed: state two or more in grid\.speeds_m_s"):
            spacing_study(at(scene, [0.2], [2.0, 4.0]))

    def test_blind_grip(self, short: Scene) -> None:
        found, optima = mismatch(short, (0.2,), (1.0, 3.0))
        assert [(one.speed_m_s, one.grip_N, one.status) for one in optima] == [
            (0.2, 1.0, "OPTIMAL"),
            (0.2, 3.0, "OPTIMAL"),
        ]
        assert all(0 <= one.relative_gap < 1e-6 for one in optima)
        own = {(p.made_for_N, p.played_at_N): p for p in found}
        assert len(own) == 4
        assert all(own[F, F].excess == 0 for F in (1.0, 3.0))
        assert own[3.0, 1.0].excess > 0.005
        assert "made for 3 N" not in mismatch_sentence(found)
        assert "at 1 N" in mismatch_sentence(found)

    def test_a_blind_grip_over_a_wall_has_the_feedback_of_the_hand_there(self) -> None:
        """The total command is the one whose transient, by the stage model at that grip, is the one that was made."""
        scene = at(problems.load("walled"), [0.2], [1.0, 3.0])
        found, _ = mismatch(scene)
        made, own = transopt.build(scene).entries[0]
        transient, there = made.problem.transient_command(made.solution.command), own.problem
        command = transient
        for _ in range(20):  # the feedback is small and late: each pass takes off most of what is missing
            command = command + transient - there.transient_command(command)
        (blind,) = (p for p in found if (p.made_for_N, p.played_at_N) == (1.0, 3.0))
        moved = there.stage.motion(command).acceleration_m_s2
        assert blind.tap_error == pytest.approx(there.yardstick.tap_error(there.target, moved), rel=1e-6)

    def test_finer_grids_err_less(self, short: Scene) -> None:
        found, optima = spacing(
            "default",
            short,
            grip_parts=(1, 2),
            speed_parts=(1, 3),
            held_speeds_m_s=(0.4,),
            held_grips_N=(5.0,),
            fine=2,
        )
        for axis, nodes in (("grip", [2, 3]), ("speed", [2, 4])):
            wide, fine = (s for s in found if s.axis == axis)
            assert [wide.nodes, fine.nodes] == nodes
            assert wide.worst > fine.worst > 0
        assert len({(one.speed_m_s, one.grip_N) for one in optima}) == len(optima) > 10
        assert proven_sentence(optima).startswith(f"{len(optima)} of {len(optima)} optima")

    def test_off_node_study_counts_its_certificates(
        self, short: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """One optimum of two loses its certificate: rows, report and exit code say so."""

        def measure(scene: Scene) -> Any:
            found, optima = mismatch(scene, (0.2,), (1.0, 3.0, 5.0))
            return found, [replace(optima[0], status="NOT_CERTIFIED"), *optima[1:]]

        monkeypatch.setitem(IN_PROCESS, "grip_mismatch", replace(IN_PROCESS["grip_mismatch"], measure=measure))
        code, _ = write("grip_mismatch", short, tmp_path, serial(), "")
        assert code == 1
        rows = read(tmp_path / "grip_mismatch" / "rows.csv")
        assert [row["status"] for row in rows] == ["NOT_CERTIFIED", "OPTIMAL", "OPTIMAL"]
        assert float(rows[1]["relative_gap"]) < 1e-6
        assert len(read(tmp_path / "grip_mismatch" / "grip_mismatch.csv")) == 9
        assert "2 of 3 optima certified" in (tmp_path / "grip_mismatch" / "report.md").read_text(encoding="utf-8")

    def test_motors_differ_in_bandwidth_and_ripple(self, scene: Scene) -> None:
        """One amplifier before all of them, that of the scene before its own motor."""
        axis = parse_axis(scene, "--study", f"motor={motor_selection.MOTORS}", [problems.FOLDER])
        posed = {
            stem: motor_selection.motor_scene(scene, m) for stem, m in zip(axis.labels, axis.values, strict=True)
        }
        own = posed["maxon_re25_118743"].amplifier_model()
        assert own.pole_Hz == pytest.approx(1050.0)
        assert own.delay_s == 68e-6
        by_inductance = sorted(posed.values(), key=lambda each: each.motor.L_H)  # type: ignore[union-attr]
        poles = [each.amplifier_model().pole_Hz for each in by_inductance]  # type: ignore[union-attr]
        assert poles == sorted(poles, reverse=True)
        assert len({each.amplifier.gain_V_A for each in posed.values()}) == 1  # type: ignore[union-attr]
        shares = [each.coil().R_ohm / each.motor.R_ohm for each in by_inductance]  # type: ignore[union-attr]
        assert max(shares) > 1.02
        assert min(shares) < 1.0001

    def test_a_scene_with_a_bridge_of_its_own_keeps_it(self, scene: Scene) -> None:
        stated = {"amplifier.pole_Hz": None, "amplifier.switching_Hz": 60e3, "amplifier.gain_V_A": 1.25}
        own = with_values(scene, {**stated, "limits.supply_V": 20.0})
        found = motor_selection.shared_amplifier(own)
        assert found["switching_Hz"] == 60e3
        assert found["gain_V_A"] == pytest.approx(1.25)

    def test_a_motor_beyond_the_bridge_is_told_and_the_others_are_solved(
        self, short: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(motor_selection, "SWITCHING_HZ", 50e3)
        chosen = {"motors": "maxon_re25,faulhaber_0816k003", "ratios": "transmission.ratio_1_m=150"}
        found = motor_selection.motor_selection(short, tmp_path, serial(), [problems.FOLDER], **chosen)
        assert list(found.studies) == ["maxon_re25_118743"]
        assert "switching_Hz = 50000 Hz: half its period" in found.refused["faulhaber_0816k003sr"]
        assert "not posed: faulhaber 0816k003sr" in "\n".join(found.report("motors.png", []))
        assert " of 2 motors" in found.sentence()
        chosen["motors"] = "faulhaber_0816k003"
        with pytest.raises(InputError, match="half its period"):
            motor_selection.motor_selection(short, tmp_path, serial(), [problems.FOLDER], **chosen)

    def test_motors(self, short: Scene, tmp_path: Path) -> None:
        found = motor_selection.motor_selection(
            short,
            tmp_path,
            serial(),
            [problems.FOLDER],
            motors="maxon_re25,faulhaber_0816k003",
            ratios="transmission.ratio_1_m=30,150",
        )
        best, worst = found.ranked()
        assert (best.stem, worst.stem) == ("maxon_re25_118743", "faulhaber_0816k003sr")
        assert best.ratio_1_m == 150.0
        assert best.worst < 0.2
        assert worst.worst > 0.5
        plan, rows = found.studies["faulhaber_0816k003sr"]
        assert plan.scene.limits.transient_input == 0.55
        assert max(float(row["peak_input"]) for row in rows) <= 0.55 + 1e-6
        assert max(float(row["peak_voltage_V"]) for row in rows) <= motor_selection.RAIL_V * 1.001
        text = "\n".join(found.report("motors.png", []))
        for words in ("## Maxon RE 25, 118743", "## Faulhaber 0816K003SR", "motors.png", "Ranked by"):
            assert words in text
        assert set(found.pages()) == set(found.studies)
