"""The inverse question and the named studies, in short forms."""

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import image

from tests.benches.study import plain, read, serial, short_scene
from transopt.base.errors import InputError
from transopt.scene.scene import Scene


@pytest.fixture(scope="module")
def short(scene: Scene) -> Scene:
    return short_scene(scene)


class TestSearch:
    """Against made-up errors, two entries at every value."""

    def ask(
        self,
        study: Any,
        scene: Scene,
        error: Callable[[float], float],
        span: str,
        require: str = "nrmse<=0.1",
        **options: Any,
    ) -> Any:
        inverse = study.inverse
        question = inverse.parse_question(
            scene, f"limits.current_A={span}", [require], **{"greatest": False, **options}
        )

        def rows(value: float) -> list[dict[str, str]]:
            common = {"speed_m_s": "0.4", "reason": "", "status": "OPTIMAL"}
            worse = {**common, "grip_N": "5.0", "nrmse": repr(error(value))}
            if np.isnan(error(value)):
                worse.update(status="INFEASIBLE", nrmse="", reason="no way")
            return [{**common, "grip_N": "1.0", "nrmse": "0.01"}, worse]

        return inverse.answer(question, lambda values: [rows(value) for value in values])

    def test_least_with_evidence_on_both_sides(self, study: Any, scene: Scene) -> None:
        found = self.ask(study, scene, lambda A: 1 / (5 * A), "1:6:0.001")
        assert found.met.value == pytest.approx(2.0, abs=1e-3)
        assert found.met.value >= 2.0 > found.missed.value
        assert found.met.value - found.missed.value <= 1e-3
        assert found.worst(found.missed)["grip_N"] == "5.0"
        assert found.crossings == 1
        assert "2.00" in found.sentences[0]
        assert len(found.tried) < 25

    def test_greatest(self, study: Any, scene: Scene) -> None:
        found = self.ask(study, scene, lambda A: A / 40, "1:6:0.001", greatest=True)
        assert found.met.value == pytest.approx(4.0, abs=1e-3)
        assert found.met.value <= 4.0 < found.missed.value

    def test_error_that_is_not_monotone(self, study: Any, scene: Scene) -> None:
        def error(A: float) -> float:
            return 0.05 if 2 <= A <= 3 or A >= 5 else 0.5

        least = self.ask(study, scene, error, "1:6:0.001")
        greatest = self.ask(study, scene, error, "1:6:0.001", greatest=True)
        assert least.met.value == pytest.approx(2.0, abs=1e-3)
        assert least.crossings == 3
        assert any("3 times: the error is not monotone" in sentence for sentence in least.sentences)
        assert (greatest.met.value, greatest.missed) == (6.0, None)

    def test_none_and_the_end_of_the_range(self, study: Any, scene: Scene) -> None:
        none = self.ask(study, scene, lambda A: 0.2 + abs(A - 3.5), "1:6")
        assert none.met is None
        assert "No limits.current_A of 9 tried from 1 to 6 A meets nrmse <= 0.1" in none.sentences[0]
        assert "nearest is 3.5 A" in none.sentences[0]
        every = self.ask(study, scene, lambda A: 0.05, "1:6")
        assert (every.met.value, every.missed, len(every.tried)) == (1.0, None, 9)
        assert "the end of the range itself" in " ".join(every.sentences)

    def test_a_refusal_is_a_miss_that_tells_its_reason(self, study: Any, scene: Scene) -> None:
        found = self.ask(study, scene, lambda A: np.nan if A < 2.5 else 0.05, "1:6:0.01")
        assert found.met.value == pytest.approx(2.5, abs=0.01)
        assert "INFEASIBLE: no way" in " ".join(found.sentences)

    def test_whole_numbers(self, study: Any, scene: Scene) -> None:
        inverse = study.inverse
        question = inverse.parse_question(scene, "time.stages=100:600", ["nrmse>=0.3"], greatest=False)
        asked: list[float] = []

        def rows(value: float) -> list[dict[str, str]]:
            asked.append(value)
            return [{"speed_m_s": "1", "grip_N": "1", "status": "OPTIMAL", "nrmse": repr(value / 1000), "reason": ""}]

        found = inverse.answer(question, lambda values: [rows(value) for value in values])
        assert (found.met.value, found.missed.value) == (300, 299)
        assert all(isinstance(value, int) for value in asked)


class TestAnswers:
    def test_against_a_fine_scan_and_again_after_a_kill(self, study: Any, short: Scene, tmp_path: Path) -> None:
        session, plan = study.session, study.axes.Plan(short, (), (0.4,), (1.0, 5.0))
        question = study.inverse.parse_question(short, "limits.current_A=2:6:0.01", ["nrmse<=0.3"], greatest=False)
        found = session.run_question(plan, question, tmp_path / "ask", serial(study))

        axis = study.axes.parse_axis(short, "--vary", "limits.current_A=2:6:161")
        near = [A for A in axis.values if abs(A - found.met.value) < 0.3]
        axis = replace(axis, values=tuple(near), labels=tuple(map(repr, near)))
        scanned = replace(plan, axes=(axis,))
        rows = session.run_plan(scanned, tmp_path / "scan", serial(study))
        error = study.figures.entry_grid(scanned, rows, "nrmse").max(axis=(1, 2))
        least = min(A for A, e in zip(near, error, strict=True) if e <= 0.3)
        assert found.missed.value < least <= found.met.value + 0.025
        assert {row["status"] for row in found.met.rows + found.missed.rows} == {"OPTIMAL"}

        path = tmp_path / "ask" / "rows.csv"
        before, whole = plain(path), path.read_bytes()
        path.write_bytes(whole[: 2 * len(whole) // 3])
        again = session.run_question(plan, question, tmp_path / "ask", serial(study))
        assert (again.met.value, again.missed.value) == (found.met.value, found.missed.value)
        assert plain(path) == before

    def test_command_line(self, study: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        words = [
            "--set",
            "time.stages=80",
            "--speed",
            "0.4",
            "--grip",
            "5",
            "--executor",
            "serial",
            "--out",
            str(tmp_path),
        ]
        ask = ["--require", "nrmse<=0.3", "--solve-for", "limits.current_A=2:6:0.2"]
        assert study.constraint_study.main([*ask, *words]) == 0
        assert (
            "The least limits.current_A from 2 to 6 A with nrmse <= 0.3 at every entry: " in capsys.readouterr().out
        )
        assert {path.name for path in tmp_path.iterdir()} == {"rows.csv", "study.json", "answer.png", "report.md"}
        assert "Evidence where it is missed" in (tmp_path / "report.md").read_text(encoding="utf-8")
        never = ["--require", "nrmse<=1e-6", "--solve-for", "limits.current_A=2:6:4"]
        assert study.constraint_study.main([*never, *words[:-1], str(tmp_path / "never")]) == 1


class TestNamed:
    def test_swept_study_leaves_figure_and_finding(
        self,
        study: Any,
        short: Scene,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        named = study.named
        fewer = replace(named.SWEPT["current_limit"], axis="limits.current_A=1.25,4,6", speeds_m_s=(0.1, 0.4))
        monkeypatch.setitem(named.SWEPT, "current_limit", fewer)
        assert named.write("current_limit", short, tmp_path / "out", serial(study), tmp_path / "figures") == 0
        assert "At 1.25 A the limit cuts" in capsys.readouterr().out
        assert np.ptp(image.imread(tmp_path / "figures" / "current_limit.png")) > 0
        assert (tmp_path / "out" / "current_limit" / "report.md").exists()

    @pytest.mark.parametrize(
        ("name", "axis"),
        [("amplifier_bandwidth", "amplifier.pole_Hz=100,1050,5000"), ("lead", "time.lead_s=0,0.0003")],
    )
    def test_findings_follow_from_rows(self, study: Any, short: Scene, tmp_path: Path, name: str, axis: str) -> None:
        fewer = replace(study.named.SWEPT[name], axis=axis, speeds_m_s=(0.1, 0.4), grips_N=(5.0,))
        plan = fewer.plan(short)
        rows = study.session.run_plan(plan, tmp_path, serial(study))
        said = fewer.finding(plan, rows)
        worst = study.figures.entry_grid(plan, rows, "nrmse")
        assert study.report.percent(float(worst[0].max())) in said or f"{100 * worst[0, 0].max():.2f}" in said

    def test_blind_grip(self, study: Any, short: Scene) -> None:
        found, optima = study.offnode.mismatch(short, (0.2,), (1.0, 3.0))
        assert [(one.speed_m_s, one.grip_N, one.status) for one in optima] == [
            (0.2, 1.0, "OPTIMAL"),
            (0.2, 3.0, "OPTIMAL"),
        ]
        assert all(0 <= one.relative_gap < 1e-6 for one in optima)
        own = {(p.made_for_N, p.played_at_N): p for p in found}
        assert len(own) == 4
        assert all(own[F, F].excess == 0 for F in (1.0, 3.0))
        assert own[3.0, 1.0].excess > 0.05
        assert "made for 3 N" not in study.offnode.mismatch_sentence(found)
        assert "at 1 N" in study.offnode.mismatch_sentence(found)

    def test_finer_grids_err_less(self, study: Any, short: Scene) -> None:
        found, optima = study.offnode.spacing(
            "default",
            short,
            grip_spacings_N=(4.0, 2.0),
            speed_spacings_m_s=(0.3, 0.1),
            held_speeds_m_s=(0.4,),
            held_grips_N=(5.0,),
            fine=2,
        )
        for axis, nodes in (("grip", [2, 3]), ("speed", [2, 4])):
            wide, fine = (s for s in found if s.axis == axis)
            assert [wide.nodes, fine.nodes] == nodes
            assert wide.worst > fine.worst > 0
        assert len({(one.speed_m_s, one.grip_N) for one in optima}) == len(optima) > 10
        assert study.offnode.proven_sentence(optima).startswith(f"{len(optima)} of {len(optima)} optima")

    def test_off_node_study_counts_its_certificates(
        self, study: Any, short: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """One optimum of two loses its certificate: rows, report and exit code say so."""
        named, offnode = study.named, study.offnode

        def measure(scene: Scene) -> Any:
            found, optima = offnode.mismatch(scene, (0.2,), (1.0, 3.0, 5.0))
            return found, [replace(optima[0], status="NOT_CERTIFIED"), *optima[1:]]

        monkeypatch.setitem(named.OFF_NODE, "grip_mismatch", (measure, *named.OFF_NODE["grip_mismatch"][1:]))
        assert named.write("grip_mismatch", short, tmp_path, serial(study), None) == 1
        rows = read(tmp_path / "grip_mismatch" / "rows.csv")
        assert [row["status"] for row in rows] == ["NOT_CERTIFIED", "OPTIMAL", "OPTIMAL"]
        assert float(rows[1]["relative_gap"]) < 1e-6
        assert len(read(tmp_path / "grip_mismatch" / "grip_mismatch.csv")) == 9
        assert "2 of 3 optima certified" in (tmp_path / "grip_mismatch" / "report.md").read_text(encoding="utf-8")

    def test_motors(self, study: Any, short: Scene, tmp_path: Path) -> None:
        motors = study.motors
        found = motors.motor_selection(
            short,
            tmp_path,
            serial(study),
            motors="maxon_re25,faulhaber_0816k003",
            ratios="transmission.ratio_1_m=30,150",
        )
        best, worst = found.ranked()
        assert (best.stem, worst.stem) == ("maxon_re25_118743", "faulhaber_0816k003sr")
        assert best.ratio_1_m == 150.0
        assert best.worst < 0.2
        assert worst.worst > 0.5
        plan, rows = found.studies["faulhaber_0816k003sr"]
        assert plan.scene.limits.transient_current_A == 0.55
        assert max(float(row["peak_current_A"]) for row in rows) <= 0.55 + 1e-6
        assert max(float(row["peak_voltage_V"]) for row in rows) <= motors.RAIL_V * 1.001
        text = "\n".join(found.report("motors.png", []))
        for words in ("## Maxon RE 25, 118743", "## Faulhaber 0816K003SR", "motors.png", "Ranked by"):
            assert words in text
        assert set(found.pages()) == set(found.studies)


def test_scale_in_short(
    study: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scale = study.scale
    monkeypatch.setattr(scale, "SPEEDS_M_S", (0.4,))
    monkeypatch.setattr(scale, "GRIPS_N", (3.0, 5.0))
    # Starting the second process takes longer than four entries: whether efficiency is kept is up to the machine.
    assert scale.main(["--points", "2", "--ways", "one,processes", "--out", str(tmp_path)]) in (0, 1)
    shown = capsys.readouterr().out
    assert "| one | 1 |" in shown
    assert len({line.count("|") for line in shown.splitlines() if line.startswith("|")}) == 1
    assert "4 / 4 of 4" in shown
    assert "kept: rows that differ between the ways, times apart: 0 of 4" in shown
    assert "not judged: memory of the parent, one: fewer than 1000 entries" in shown
    assert "- one: " in shown
    assert "entries per second" in shown
    assert scale.main(["--ways", "mpi", "--out", str(tmp_path)]) == 2


class TestScaleBounds:
    @staticmethod
    def run(study: Any, way: str, elapsed_s: float, growth_MB: float = 0.0, status: str = "OPTIMAL") -> Any:
        """5000 rows in the time, memory that grows by so much per 1000 entries after a steep start."""
        scale = study.scale
        entries = np.linspace(0, 5000, 51)
        resident = np.where(entries < 500, entries, 200 + growth_MB * entries / 1000)
        watch = scale.Watch([(n, 150.0, MB) for n, MB in zip(entries, resident, strict=True)], 5000)
        rows = [{"status": status, "relative_gap": "1e-9", "binding": "current", "solve_ms": way}] * 5000
        return scale.Measured(way, 1 if way == "one" else 2, rows, elapsed_s, 0.0, watch)

    @pytest.mark.parametrize(
        ("changed", "missed"),
        [
            ({}, ""),
            ({"processes": {"elapsed_s": 63.0}, "dask": {"elapsed_s": 63.0}}, "efficiency of 2 processes: 79 %"),
            ({"dask": {"elapsed_s": 90.6}}, "dask over processes: 1.51 times"),
            ({"processes": {"growth_MB": 10.1}}, "memory of the largest worker, processes: +10.10 MB per 1000"),
            ({"one": {"status": "NOT_CERTIFIED"}}, "certified, one: 0 of 5000"),
        ],
    )
    def test_each_is_judged(self, study: Any, changed: dict[str, dict[str, Any]], missed: str) -> None:
        plain_s = {"one": 100.0, "processes": 60.0, "dask": 70.0}
        runs = [self.run(study, way, **{"elapsed_s": s, **changed.get(way, {})}) for way, s in plain_s.items()]
        said = [str(v) for v in study.scale.verdicts(runs) if v.kept is False]
        assert not any(v.kept is None for v in study.scale.verdicts(runs))
        if not missed:
            assert said == []
        else:
            assert missed in said[0]

    def test_memory_that_was_not_seen_is_not_flat(self, study: Any) -> None:
        run = self.run(study, "one", 100.0)
        run.watch.rows.clear()
        assert [v.kept for v in study.scale.verdicts([run])] == [False, False, True]


def test_rejected_question(study: Any, scene: Scene) -> None:
    with pytest.raises(InputError, match="not a number that can be solved for"):
        study.inverse.parse_question(scene, "weights.error_filter=1:2", ["nrmse<=0.1"], greatest=False)
    with pytest.raises(InputError, match="one row of a datasheet"):
        study.inverse.parse_question(scene, "motor.R_ohm=1:2", ["nrmse<=0.1"], greatest=False)


def test_rows_of_an_answer_are_csv(study: Any) -> None:
    cells = ["plain", "with, comma", 'with "quotes"', "with\nnew line"]
    [row] = csv.reader([study.rows.line(cells).decode()])
    assert row == [*cells[:3], "with new line"]
