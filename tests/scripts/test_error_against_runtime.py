"""Error against run time: the judge, servo rates, the summary's arithmetic, the command."""

import csv
import math
import re
import signal
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib import metadata
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.benches.limits import with_numbers
from tests.benches.places import ROOT
from tests.benches.scripts import script
from tests.conftest import STAGES
from transopt.base.errors import InputError
from transopt.problem.problem import TransientProblem
from transopt.scene.scene import Scene
from transopt.solvers.choose import solve
from transopt.solvers.options import SolverOptions

error_against_runtime, command = script("error_against_runtime"), script("common.command")
cases = script("precision.cases")
methods = script("precision.methods")
periods = script("precision.periods")
report = script("precision.report")
summary = script("precision.summary")
user = script("precision.user")
wheels = script("precision.wheels")
work_precision = script("precision.figure").work_precision
measured = script("precision.run")
Effort, Row = measured.Effort, measured.Row


class TestJudge:
    def test_the_optimum_has_no_error(self, short_case: Any) -> None:
        verdict = cases.judge(short_case.problem, short_case.optimum.command_A, short_case.optimum.objective)
        assert verdict.gap == 0.0
        assert verdict.error < 1e-12

    def test_a_command_a_thousandth_too_large_violates_by_that(self, short_case: Any) -> None:
        verdict = cases.judge(short_case.problem, 1.001 * short_case.optimum.command_A, short_case.optimum.objective)
        assert verdict.violation == pytest.approx(1e-3, rel=1e-6)
        assert verdict.error >= verdict.violation

    def test_a_better_objective_outside_the_limits_is_no_better(self, short_case: Any) -> None:
        """The optimum for 4.4 A has a lower J; its distance counts by its size, and so does its violation."""
        wider = with_numbers(short_case.small, current_A=4.4, command_A=6.6)
        verdict = cases.judge(short_case.problem, solve(wider).command, short_case.optimum.objective)
        assert verdict.gap < -0.01
        assert verdict.violation == pytest.approx(0.1, rel=1e-3)
        assert verdict.error == max(-verdict.gap, verdict.violation)
        above, below = (cases.Verdict(sign * 0.5, 0.1) for sign in (1, -1))
        assert above.error == below.error == 0.5

    @pytest.mark.parametrize("broken", ["nan", "inf", "short"])
    def test_what_is_no_command_fails(self, short_case: Any, broken: str) -> None:
        command = short_case.optimum.command_A.copy()
        if broken == "short":
            command = command[:-1]
        else:
            command[3] = float(broken)
        assert math.isinf(cases.judge(short_case.problem, command, short_case.optimum.objective).error)

    def test_a_command_that_does_not_end_violates(self, short_case: Any) -> None:
        command = short_case.optimum.command_A.copy()
        command[-1] = 0.06
        verdict = cases.judge(short_case.problem, command, short_case.optimum.objective)
        assert verdict.violation == pytest.approx(0.01)

    def test_the_temperature_counts_relative_to_its_headroom(
        self, short_case: Any, hot_problem: TransientProblem
    ) -> None:
        verdict = cases.judge(hot_problem, short_case.optimum.command_A, short_case.optimum.objective)
        motion = hot_problem.stage.motion(short_case.optimum.command_A)
        hottest = hot_problem.thermal.temperatures_C(motion.plant_input, short_case.optimum.command_A).max()
        assert verdict.violation == pytest.approx((hottest - hot_problem.thermal.limit_C) / 0.02, rel=1e-3)
        assert verdict.violation > 0.1

    def test_references_that_disagree_end_the_run(
        self, short_case: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Any
    ) -> None:
        def loose(problem: TransientProblem, options: SolverOptions) -> Any:
            found = solve(problem, options)
            return replace(found, command=0.999 * found.command) if options.solver == "casadi-ipopt" else found

        def short(name: str) -> Any:
            return cases.make_case(name, short_case.scene, short_case.problem, 0.4, 5.0)

        monkeypatch.setattr(cases, "solve", loose)
        monkeypatch.setattr(error_against_runtime, "case_of_scene", short)
        assert error_against_runtime.compared(tmp_path, case=["wood_on_foam"]) == 1
        line = capsys.readouterr().err.strip()
        assert line.startswith("error: wood_on_foam: casadi-piqp at 1e-12 finds J = ")
        assert "nothing to compare with" in line
        assert "\n" not in line

    def test_the_reference_methods_are_marked_as_such(self, short_case: Any, rows_of: Any) -> None:
        """And no other: neither another tolerance of the same solver nor another solver at the same."""
        names = ("casadi-piqp", "casadi-ipopt", "riccati")
        rows = rows_of(*(m for m in methods.project_methods() if m.name in names))
        marked = {(row.method, row.tolerance) for row in rows if row.reference}
        assert marked == {("casadi-piqp", 1e-12), ("casadi-ipopt", 1e-12)}
        assert all(row.certificate < 1e-9 for row in rows if row.reference)
        (line,) = (one for one in report.summaries_of([short_case], rows) if "casadi-piqp | high" in one)
        assert line.endswith("| reference |")
        (other,) = (one for one in report.summaries_of([short_case], rows) if "casadi-piqp | def" in one)
        assert "reference" not in other


class TestServoRates:
    def test_a_held_command_is_the_same_at_any_rate(self, whole_case: Any) -> None:
        command = whole_case.optimum.command_A
        tap_error, violation = periods.played(whole_case, {10e3: command, 20e3: np.repeat(command, 2)})
        assert tap_error[10e3] == pytest.approx(tap_error[20e3], rel=1e-12)
        # On eight times as many instants; the ramps between them are the rest.
        assert tap_error[10e3] == pytest.approx(whole_case.optimum.tap_error, rel=0.05)
        assert abs(violation[10e3]) < 1e-9

    def test_faster_servos_come_nearer(self, whole_case: Any) -> None:
        rows = periods.measure_periods(whole_case, Effort(0.0, least=1), (5e3, 10e3))
        slow, fast = rows
        assert (slow.method, fast.method) == ("5 kHz", "10 kHz")
        assert abs(slow.tap_error_excess) > abs(fast.tap_error_excess) > 0
        assert math.isnan(slow.error)
        assert slow.options == f"{STAGES // 2} stages, {SolverOptions().solver}"


class TestSummary:
    def row(self, case: str, method: str, ms: float, error: float, level: str = "default") -> Any:
        numbers = dict.fromkeys(("tolerance", "gap", "violation", "tap_error_excess", "certificate", "setup_ms"), 0.0)
        return Row(
            case=case,
            method=method,
            kind="solver",
            level=level,
            version="1",
            options="",
            iterations=1,
            status="",
            solve_ms=ms,
            q25_ms=ms,
            q75_ms=ms,
            runs=3,
            threads=1,
            error=error,
            **numbers,
        )

    def test_by_hand(self) -> None:
        """Shift 10 ms: (20 + 10)(50 + 10)... ; a failure is charged 10000 ms."""
        rows = [
            self.row("a", "fast", 20.0, 1e-7),
            self.row("b", "fast", 50.0, 1e-9),
            self.row("a", "loose", 10.0, 1e-4),
            self.row("b", "loose", 10.0, 1e-7),
            self.row("a", "lost", 1.0, math.inf),
            self.row("b", "lost", 1.0, math.nan),
            self.row("a", "partial", 1.0, 0.0),
            self.row("a", "fast", 1.0, 0.0, level="sweep"),
            self.row("c", "fast", 1.0, 1.0),
        ]
        fast, loose, lost = summary.summarise(rows, ["a", "b"])
        assert [s.method for s in (fast, loose, lost)] == ["fast", "loose", "lost"]
        assert (fast.cases, fast.scores[1e-6].success, fast.scores[1e-3].success) == (2, 1.0, 1.0)
        assert fast.scores[1e-6].mean_ms == pytest.approx(math.sqrt(30 * 60) - 10)
        assert fast.scores[1e-6].relative == 1.0
        assert loose.scores[1e-6].success == 0.5
        assert loose.scores[1e-6].mean_ms == pytest.approx(math.sqrt(10010 * 20) - 10)
        assert loose.scores[1e-3].mean_ms == pytest.approx(10.0)
        assert loose.scores[1e-3].relative == 1.0
        assert fast.scores[1e-3].relative == pytest.approx((math.sqrt(1800) - 10) / 10)
        assert lost.scores[1e-3].success == 0.0
        assert lost.scores[1e-3].mean_ms == pytest.approx(10000.0)
        assert lost.worst == math.inf

    def test_the_answer_tells_of_the_best_method_and_of_the_next_other_one(self) -> None:
        found = [
            ("own", 1.0, "high accuracy"),
            ("own", 1.2, "default"),
            ("slow", 400.0, "default"),
            ("peer", 34.0, "default"),
        ]
        rows = [self.row("a", name, ms, 2e-13, level) for name, ms, level in found]
        rows.append(self.row("hot", "own", 9.0, 1e-9))
        given = [SimpleNamespace(name="a", qp=object()), SimpleNamespace(name="hot", qp=None)]
        told = "1.0 ms at an error of 2e-13, 34.0 times as fast as `peer`, the next of those compared."
        assert report.answer(given, rows) == told


def test_readme_and_report_ask_for_one_citation_of_this_version() -> None:
    citation = report.CITATION
    assert citation in (ROOT / "README.md").read_text(encoding="utf-8")
    assert f"version = {{{metadata.version('transopt')}}}" in citation


class TestCommand:
    @pytest.fixture
    def run(
        self, short_case: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Any
    ) -> Callable[..., tuple[int, str, str]]:
        """The command with the short case in place of every scene's."""
        monkeypatch.setattr(
            error_against_runtime,
            "case_of_scene",
            lambda name: replace(
                short_case, name=name, qp=None if short_case.qp is None else replace(short_case.qp, name=name)
            ),
        )
        monkeypatch.chdir(tmp_path)

        def call(*arguments: str) -> tuple[int, str, str]:
            monkeypatch.setattr(sys, "argv", ["error_against_runtime.py", *arguments])
            with pytest.raises(SystemExit) as end:
                command.run(error_against_runtime.compared)
            told = capsys.readouterr()
            return int(end.value.code or 0), told.out, told.err

        return call

    def test_everything_with_a_users_method(self, run: Any, user_file: Any, monkeypatch: Any) -> None:
        user_file(
            "calls = 0\n"
            "def solve(qp, tolerance=1e-6):\n"
            "    return qp.solution, qp.multipliers, {'iterations': 7, 'status': f'at {tolerance:g}'}\n"
        )
        real = wheels.util.find_spec
        monkeypatch.setattr(
            wheels.util, "find_spec", lambda name, *more: None if name == "osqp" else real(name, *more)
        )
        code, out, err = run(
            "--out", "out", "--dump", "qps", "--quick", "--case", "wood_on_foam", "--method", "mine.py"
        )
        assert code == 0, err
        assert re.search(r"not installed: .*osqp.*; to add them: pip install '\.\[bench\]'", out)
        assert sorted(path.name for path in Path("out").iterdir()) == [
            "error_against_runtime.md",
            "rows.csv",
            "work_precision.png",
        ]
        assert Path("qps/wood_on_foam.npz").stat().st_size > 1000
        with Path("out/rows.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert set(rows[0]) >= {
            *("case", "method", "version", "options", "tolerance", "iterations", "status", "setup_ms", "solve_ms"),
            *("q25_ms", "q75_ms", "runs", "threads", "gap", "violation", "tap_error_excess", "error"),
        }
        (own,) = (row for row in rows if row["method"] == "mine" and row["level"] == "high accuracy")
        assert float(own["error"]) < 1e-9
        assert float(own["certificate"]) < 1e-9
        assert (own["iterations"], own["status"], own["tolerance"]) == ("7", "at 1e-10", "1e-10")
        text = Path("out/error_against_runtime.md").read_text()
        for words in (
            "| mine | high accuracy",
            "osqp",
            "`pip install '.[bench]'`",
            "opti-ipopt",
            "How to cite",
            "RK4",
        ):
            assert words in text
        assert Path("out/work_precision.png").read_bytes()[:4] == b"\x89PNG"

    def test_an_nlp_is_not_dumped_and_said_so(
        self, short_scene: Scene, hot_problem: TransientProblem, tmp_path: Path
    ) -> None:
        hot = cases.make_case("hot_coil", short_scene, hot_problem, 0.4, 5.0)
        (line,) = error_against_runtime.dump_all([hot], tmp_path)
        assert "not dumped" in line
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            (None, "mine.py: no such file"),
            ("def solve(qp:\n", "mine.py: does not run (SyntaxError"),
            ("raise SystemExit(3)", "mine.py: does not run (SystemExit"),
            ("import nothing_of_this_name", "No module named 'nothing_of_this_name'"),
            ("solve = 3", "mine.py: defines no function solve(qp)"),
            ("def solve():\n    pass", "mine.py: solve takes no argument"),
        ],
    )
    def test_a_broken_method_file_is_refused_in_one_line(
        self, run: Any, user_file: Any, text: str | None, words: str
    ) -> None:
        if text is not None:
            user_file(text)
        code, _, err = run("--out", "out", "--method", "mine.py")
        assert code == 2
        assert err.startswith("error: --method mine.py: ")
        assert words in err
        assert err.count("\n") == 1
        assert not Path("out").exists()

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (["--out", "file"], "--out file: cannot be written"),
            ([], "nothing to do: state --out DIR, --dump DIR or both"),
            (["--out", "out", "--figure", "e5.xyz"], "--figure e5.xyz: a PNG is written"),
            (["--out", "out", "--case", "hot_coil", "--case", "wood"], "--case wood: unknown; choose one of wood_on"),
        ],
    )
    def test_refusals(self, run: Any, arguments: list[str], words: str) -> None:
        Path("file").write_text("in the way")
        code, _, err = run(*arguments)
        assert (code, err.count("\n")) == (2, 1)
        assert words in err

    @pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no alarm")
    @pytest.mark.parametrize(
        "hang",
        [
            "    while True:\n        pass\n",
            "    while True:\n        try:\n            sum(range(9))\n        except Exception:\n            pass\n",
        ],
    )
    def test_a_method_that_hangs_is_cut_and_has_failed(
        self, rows_of: Any, user_file: Any, monkeypatch: pytest.MonkeyPatch, hang: str
    ) -> None:
        before = signal.getsignal(signal.SIGALRM)
        method = user.user_method(user_file(f"def solve(qp):\n{hang}"))
        monkeypatch.setattr(user, "TIME_LIMIT_S", 0.01)
        (row,) = rows_of(method)
        assert row.status == "TimeoutError: time limit of 0.01 s"
        assert math.isinf(row.error)
        assert signal.getsignal(signal.SIGALRM) is before
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)

    @pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no alarm")
    def test_a_file_that_hangs_is_refused(self, user_file: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(user, "TIME_LIMIT_S", 0.01)
        with pytest.raises(InputError, match=r"mine.py: does not run \(TimeoutError: time limit of 0.01 s\)"):
            user.user_method(user_file("while True:\n    pass\n"))

    def test_what_failed_is_named_in_the_figure(self, short_case: Any, rows_of: Any, user_file: Any) -> None:
        bad = user.user_method(user_file("def solve(qp):\n    raise ValueError('lost')\n"))
        figure = work_precision([short_case], rows_of(bad, *methods.baselines()))
        upper, lower = figure.axes
        assert upper.get_xlabel() == "failed: mine (ValueError)"
        names = {text.get_text(): text.get_window_extent() for text in lower.texts}
        assert names.keys() == {"clipped optimum", "seed inversion"}
        assert not names["clipped optimum"].overlaps(names["seed inversion"])

    def test_the_names_of_close_points_cover_neither_each_other_nor_a_point_nor_the_axis(
        self, short_case: Any, rows_of: Any
    ) -> None:
        times_ms, errors = (0.9, 1.35, 0.4, 0.54, 0.8, 1.5), (0.13, 0.06, 0.02, 6e-3, 1.2e-3, 6e-4)
        baselines, period = rows_of(*methods.baselines()), methods.Kind.PERIOD.value
        rates = [replace(baselines[0], method=f"{rate:g} kHz", kind=period) for rate in (2.5, 5, 10, 20)]
        given = zip([*baselines, *rates], times_ms, errors, strict=True)
        shown = [replace(row, solve_ms=time_ms, tap_error_excess=error) for row, time_ms, error in given]
        lower = work_precision([short_case] * 4, shown).axes[4]
        boxes = [text.get_window_extent() for text in lower.texts]
        assert len(boxes) == 6
        assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
        points = lower.transData.transform([text.xy for text in lower.texts])
        assert not any(box.contains(*point) for box in boxes for point in points)
        assert min(box.x0 for box in boxes) > lower.bbox.x0
