"""`transopt study`: files, bad input, stopped and gone on with."""

import contextlib
import os
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import image

import problems
from tests.benches.actuators import nonlinear_scene
from tests.benches.commands import Run, Terminal, assert_refused
from tests.benches.places import ROOT
from tests.benches.study import assert_same_rows, read, serial, short_scene
from transopt.design import entry as entries
from transopt.problem.answer import Status
from transopt.scene.scene import Scene
from transopt.study import named
from transopt.study.axes import parse_axis
from transopt.study.executors import Pool
from transopt.study.plan import TOGETHER, Plan
from transopt.study.session import run_plan


@pytest.fixture
def run(terminal: Terminal) -> Run:
    """Run `transopt study ARGS` in an empty folder."""
    return partial(terminal, "transopt", "study")


@pytest.fixture(scope="module")
def unstopped(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a run leaves that nobody stops."""
    short, out = short_scene(scene), tmp_path_factory.mktemp("unstopped")
    axis = parse_axis(short, "--vary", "limits.current_A=1:4:64")
    run_plan(Plan(short, (axis,), (0.3, 0.4), (1.0, 5.0)), out, serial())
    return out


class TestCommandLine:
    @pytest.fixture
    def scene_file(self, scene: Scene, tmp_path: Path) -> Path:
        """The scene with the short horizon as a file."""
        text = problems.scene_path("wood_on_foam").read_text(encoding="utf-8")
        short = short_scene(scene)
        path = tmp_path / "short.toml"
        path.write_text(
            text.replace("stages = 800", f"stages = {short.time.stages}") + "after_s = 0.0\n", encoding="utf-8"
        )
        return path

    @pytest.mark.parametrize(
        ("vary", "figure"),
        [
            (["--vary", "limits.current_A=1.5,3"], "curves"),
            (["--vary", "limits.current_A=1.5,3", "--vary", "motor=maxon_re25,faulhaber_0816k003"], "maps"),
            (["--vary", "limits.current_A=1.5:3:2", "--vary", "weights.rho=1e-3,0", "--sample", "2"], "multiples"),
        ],
    )
    def test_files(self, run: Run, scene_file: Path, vary: list[str], figure: str) -> None:
        out = Path(figure)
        ran = run(scene_file, *vary, "--speed", 0.4, "--grip", 5, "--executor", "serial", "--out", out)
        assert ran.code == 0
        assert {path.name for path in out.iterdir()} == {"rows.csv", "study.sqlite", "tap_error.png", "report.md"}
        assert np.ptp(image.imread(out / "tap_error.png")) > 0
        report = (out / "report.md").read_text(encoding="utf-8")
        for word in ("transopt study ", "entries certified and replayed clean", "--vary", "cores", "casadi", "binds"):
            assert word in report
        rows = read(out / "rows.csv")
        if figure == "maps":
            refused = [row for row in rows if row["status"] == "REFUSED"]
            assert {row["motor"] for row in refused} == {"faulhaber_0816k003sr"}
            assert len(refused) == 2
            assert report.count("1 x REFUSED: ") == 2
        assert "certified" in ran.out

    def test_an_answer(self, run: Run) -> None:
        words = [
            "--set",
            "time.stages=80",
            "--set",
            "weights.after_s=0",
            "--speed",
            0.4,
            "--grip",
            5,
            "--executor",
            "serial",
        ]
        ran = run("--require", "tap_error<=0.5", "--solve-for", "limits.current_A=2:6:0.2", *words, "--out", "least")
        assert ran.code == 0
        assert "The least limits.current_A from 2 to 6 A with tap_error <= 50 % at every entry: " in ran.out
        assert {path.name for path in Path("least").iterdir()} == {
            "rows.csv",
            "study.sqlite",
            "answer.png",
            "report.md",
        }
        assert "Evidence where it is missed" in Path("least/report.md").read_text(encoding="utf-8")
        never = run("--require", "tap_error<=1e-6", "--solve-for", "limits.current_A=2:6:4", *words, "--out", "never")
        assert never.code == 1

    def test_all_named_studies_are_run_and_the_worst_code_is_the_exit_code(
        self, run: Run, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        asked = []

        def write(
            name: str, scene: Scene, out: Path, pool: Pool, command: str, *, search: object, figures: Path
        ) -> tuple[int, str]:
            asked.append((name, scene.name, out, figures))
            return int(name == "lead"), f"the finding of {name}"

        monkeypatch.setattr(named, "write", write)
        ended = run("--study", "all", "--executor", "serial", "--out", "out", "--figures", "figures")
        assert ended.code == 1
        assert asked == [(name, "wood_on_foam", Path("out"), Path("figures")) for name in named.OF_ONE_MOTOR]
        assert ended.out.splitlines() == [f"{name}: the finding of {name}" for name in named.OF_ONE_MOTOR]

    def test_list_keys(self, run: Run) -> None:
        ran = run("--list-keys")
        assert ran.code == 0
        for words in ("limits.current_A", "thermal.tap_rate_Hz", "transmission.ratio_1_m", "g/sqrt(Hz)", "datasheet"):
            assert words in ran.out

    @pytest.mark.parametrize(
        ("words", "error"),
        [
            ([], "--vary: nothing is varied"),
            (["--vary", "amplifier.pole_Hz=-3"], "amplifier.pole_Hz = -3.0: must be greater than 0"),
            (["--vary", "limits.beta=2,3", "--vary", "limits.current_A=1,2"], "vary one of the two"),
            (["--vary", "limits.beta=2,3", "--vary", "limits.beta=4"], "--vary limits.beta: stands there twice"),
            (["--vary", "limits.beta=2,3", "--sample", "0"], "--sample 0: must be at least 1"),
            (["--vary", "limits.beta=2,3", "--grip", "firm"], "--grip firm: must be numbers"),
            (["--vary", "limits.beta=2,3", "--grip", "0,1"], "the free device"),
            (["--set", "limits.beta=2,3", "--vary", "weights.rho=0,1"], "one value; --vary takes several"),
            (["--require", "tap_error<=0.1"], "--require and --solve-for belong together"),
            (["--require", "hardness<=0.1", "--solve-for", "limits.beta=1:2"], "hardness: no such measure"),
            (["--require", "tap_error<0.1", "--solve-for", "limits.beta=1:2"], "must be MEASURE<=NUMBER"),
            (["--require", "tap_error<=30", "--solve-for", "limits.beta=1:2"], "30 is 3000 %, at most 1 without %"),
            (["--require", "peak_input<=30%", "--solve-for", "limits.beta=1:2"], "peak_input is no share"),
            (["--require", "tap_error<=0.1", "--solve-for", "limits.beta=2:1"], "LOW must be below HIGH"),
            (
                ["--require", "tap_error<=0.1", "--solve-for", "limits.beta=0:2"],
                "limits.beta = 0.0: must be greater than or",
            ),
            (["--study", "lead", "--vary", "limits.beta=1,2"], "a named study says itself what is varied"),
        ],
    )
    def test_bad_input_is_one_line(self, run: Run, words: list[str], error: str) -> None:
        assert_refused(run(*words, "--executor", "serial", "--out", "out"), error)

    @pytest.mark.parametrize(
        ("words", "error"),
        [
            (["--study", "lead", "--sample", "3"], "a named study says itself what is varied"),
            (["--study", "lead", "--full"], "a named study says itself what is varied"),
            (["--study", "lead", "--seed", "3"], "a named study says itself what is varied"),
            (["--study", "nope"], "--study nope: no such study; choose one of current_limit"),
            (["--study", "direction", "--jobs", "2"], "--study direction: solves in this process"),
            (["--study", "grip_mismatch", "--jobs", "2"], "--study grip_mismatch: solves in this process"),
            (["--study", "grid_spacing", "--executor", "serial"], "--study grid_spacing: solves in this process"),
            (
                ["--vary", "limits.beta=2,3", "--jobs", "-2", "--executor", "serial"],
                "--jobs -2: only with --executor",
            ),
            (["--vary", "limits.beta=2,3", "--jobs", "-2"], "--jobs -2: must be at least 1"),
            (["--vary", "limits.beta=2,3", "--figures", "here"], "--figures: only with --study"),
            (["--vary", "limits.beta=2,3", "--seed", "3"], "--seed 3: only with --sample"),
            (["--vary", "limits.beta=2,3", "--sample", "three"], "'--sample': ... valid int"),
            (["--require", "tap_error<=0.1", "--solve-for", "limits.beta=1:2", "--full"], "not together with --full"),
            (
                ["--require", "tap_error<=0.1", "--solve-for", "limits.beta=1:2", "--seed", "2"],
                "not together with --full",
            ),
        ],
    )
    def test_options_that_would_be_ignored_are_refused(self, run: Run, words: list[str], error: str) -> None:
        # The words between are typer's, another version's are others.
        assert_refused(run(*words, "--out", "out"), *error.split(" ... "))
        assert not Path("out").exists()

    def test_nowhere_to_write(self, run: Run) -> None:
        Path("taken").write_text("here already", encoding="utf-8")
        assert_refused(run("--vary", "limits.beta=2,3"), "--out: give a folder")
        assert_refused(run("--vary", "limits.beta=2,3", "--out", "taken"), "--out taken: cannot be written")

    def test_everything_refused_is_a_shortfall(self, run: Run, scene_file: Path) -> None:
        few = ("--speed", 0.4, "--grip", 5, "--executor", "serial", "--out", "out")
        assert run(scene_file, "--vary", "limits.current_A=50,60", *few).code == 1
        assert Path("out/tap_error.png").exists()

    @pytest.mark.parametrize(("status", "code"), [(Status.INFEASIBLE, 0), (Status.NOT_CERTIFIED, 1), (None, 1)])
    def test_one_row_that_falls_short_is_told(
        self, run: Run, scene_file: Path, monkeypatch: pytest.MonkeyPatch, status: Status | None, code: int
    ) -> None:
        """A status of None stands for an exception, which becomes a DEFECT."""
        real, calls = entries.admit, []

        def second_differs(*given: Any) -> Any:
            calls.append(1)
            if len(calls) == 2 and status is None:
                raise ZeroDivisionError
            return (status, ["said so"]) if len(calls) == 2 else real(*given)

        monkeypatch.setattr(entries, "admit", second_differs)
        monkeypatch.setattr("transopt.study.plan.TOGETHER", 1)
        few = ("--vary", "limits.current_A=2,3", "--speed", 0.4, "--grip", "3,5", "--executor", "serial")
        assert run(scene_file, *few, "--out", "out").code == code
        rows = read(Path("out/rows.csv"))
        wanted = ["OPTIMAL"] * 3 + [status.name if status else "DEFECT"]
        assert sorted(row["status"] for row in rows) == sorted(wanted)

    @pytest.mark.skipif(sys.platform == "win32", reason="signals")
    @pytest.mark.parametrize(
        ("sent", "how"),
        [
            pytest.param(signal.SIGINT, ["--jobs", "1"], marks=pytest.mark.long),
            pytest.param(signal.SIGTERM, ["--executor", "serial"], marks=pytest.mark.long),
            (signal.SIGINT, ["--jobs", "2"]),
            (signal.SIGKILL, ["--jobs", "1"]),
        ],
    )
    def test_stopped_and_gone_on_with(
        self, run: Run, scene_file: Path, unstopped: Path, sent: signal.Signals, how: list[str]
    ) -> None:
        out = Path("out")
        words = [str(scene_file), "--vary", "limits.current_A=1:4:64", "--speed", "0.3,0.4", "--grip", "1,5"]
        command = [sys.executable, str(ROOT / "scripts" / "constraint_study.py"), *words, *how, "--out", str(out)]
        file, log = out / "study.sqlite", out / "study.sqlite-wal"  # rows stand in the log first
        with subprocess.Popen(
            command,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as running:
            while not log.exists() or log.read_bytes().count(b"OPTIMAL") <= TOGETHER:  # one task is kept
                with contextlib.suppress(subprocess.TimeoutExpired):
                    running.wait(timeout=0.02)
                    pytest.fail("ended before anything was written")
            running.send_signal(sent)
            _, said = running.communicate(timeout=60)
        if sent == signal.SIGKILL:  # which no command can answer; a process that it was starting may say so
            assert not (out / "rows.csv").exists()
        else:
            assert "Traceback" not in said
            assert running.returncode == 128 + sent
            kept = len(read(out / "rows.csv"))
            assert f"stopped: {kept} of 256 entries are in {file}; the same command goes on from there" in said
        with closing(sqlite3.connect(file)) as there:
            before = there.execute('SELECT "index", total_ms FROM rows').fetchall()
        assert TOGETHER <= len(before) < 256
        assert run(*words, "--executor", "serial", "--out", out).code == 0
        assert_same_rows(out / "rows.csv", unstopped / "rows.csv")
        rows = read(out / "rows.csv")
        assert all(rows[number]["total_ms"] == total_ms for number, total_ms in before)


def test_a_study_of_a_nonlinear_plant_has_its_answers(run: Run, tmp_path: Path) -> None:
    scene = nonlinear_scene(tmp_path)
    found = run(str(scene), "--vary", "limits.voltage_V=2,12", "--executor", "serial", "--out", str(tmp_path / "out"))
    assert found.code == 0
    assert "2 of 2 entries certified and replayed clean" in " ".join(found.out.split())
    tight, wide = read(tmp_path / "out" / "rows.csv")
    assert tight["status"] == wide["status"] == "STATIONARY"
    assert float(wide["tap_error"]) < float(tight["tap_error"])
    report = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    assert "Not certified" not in report
    assert "floor is of the plant as it is at rest" in report
