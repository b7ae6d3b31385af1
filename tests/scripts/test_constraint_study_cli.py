"""The command line of constraint studies: files, bad input, stopped and gone on with."""

import contextlib
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import image

from tests.benches.places import SCRIPTS
from tests.benches.study import plain, read, serial, short_scene
from transopt.design import sweep
from transopt.problem.answer import Status
from transopt.scene.scene import Scene


@pytest.fixture(scope="module")
def unstopped(study: Any, scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a run leaves that nobody stops."""
    short, out = short_scene(scene), tmp_path_factory.mktemp("unstopped")
    axis = study.axes.parse_axis(short, "--vary", "limits.current_A=1:4:32")
    study.session.run_plan(study.axes.Plan(short, (axis,), (0.3, 0.4), (1.0, 5.0)), out, serial(study))
    return out


class TestCommandLine:
    @pytest.fixture
    def scene_file(self, scene: Scene, tmp_path: Path) -> Path:
        """The scene with the short horizon as a file."""
        text = (SCRIPTS.parent / "problems" / "scenes" / "wood_on_foam.toml").read_text(encoding="utf-8")
        short = short_scene(scene)
        path = tmp_path / "short.toml"
        path.write_text(text.replace("stages = 600", f"stages = {short.time.stages}"), encoding="utf-8")
        return path

    @pytest.mark.parametrize(
        ("vary", "figure"),
        [
            (["--vary", "limits.current_A=1.5,3"], "curves"),
            (["--vary", "limits.current_A=1.5,3", "--vary", "motor=maxon_re25,faulhaber_0816k003"], "maps"),
            (["--vary", "limits.current_A=1.5:3:2", "--vary", "weights.rho=1e-3,0", "--sample", "2"], "multiples"),
        ],
    )
    def test_files(
        self,
        study: Any,
        scene_file: Path,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
        vary: list[str],
        figure: str,
    ) -> None:
        out = tmp_path / figure
        words = [str(scene_file), *vary, "--speed", "0.4", "--grip", "5", "--executor", "serial", "--out", str(out)]
        assert study.constraint_study.main(words) == 0
        assert {path.name for path in out.iterdir()} == {"rows.csv", "study.json", "nrmse.png", "report.md"}
        assert np.ptp(image.imread(out / "nrmse.png")) > 0
        report = (out / "report.md").read_text(encoding="utf-8")
        for word in ("entries certified and replayed clean", "--vary", "cores", "casadi", "what binds"):
            assert word in report
        rows = read(out / "rows.csv")
        if figure == "maps":
            refused = [row for row in rows if row["status"] == "REFUSED"]
            assert {row["motor"] for row in refused} == {"faulhaber_0816k003sr"}
            assert len(refused) == 2
            assert report.count("1 x REFUSED: ") == 2
        assert "certified" in capsys.readouterr().out

    def test_list_keys(self, study: Any, capsys: pytest.CaptureFixture[str]) -> None:
        assert study.constraint_study.main(["--list-keys"]) == 0
        shown = capsys.readouterr().out
        for words in ("limits.current_A", "thermal.tap_rate_Hz", "transmission.ratio_1_m", "g/sqrt(Hz)", "datasheet"):
            assert words in shown

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
            (["--require", "nrmse<=0.1"], "--require and --solve-for belong together"),
            (["--require", "hardness<=0.1", "--solve-for", "limits.beta=1:2"], "hardness: no such measure"),
            (["--require", "nrmse<0.1", "--solve-for", "limits.beta=1:2"], "must be MEASURE<=NUMBER"),
            (["--require", "nrmse<=0.1", "--solve-for", "limits.beta=2:1"], "LOW must be below HIGH"),
            (
                ["--require", "nrmse<=0.1", "--solve-for", "limits.beta=0:2"],
                "limits.beta = 0.0: must be greater than or",
            ),
            (["--study", "lead", "--vary", "limits.beta=1,2"], "a named study says itself what is varied"),
        ],
    )
    def test_bad_input_is_one_line(
        self, study: Any, words: list[str], error: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert study.constraint_study.main([*words, "--executor", "serial", "--out", str(tmp_path / "out")]) == 2
        said = capsys.readouterr().err
        assert said.startswith("error: ")
        assert error in said
        assert said.count("\n") == 1

    @pytest.mark.parametrize(
        ("words", "error"),
        [
            (["--study", "lead", "--sample", "3"], "a named study says itself what is varied"),
            (["--study", "lead", "--full"], "a named study says itself what is varied"),
            (["--study", "lead", "--seed", "3"], "a named study says itself what is varied"),
            (["--study", "nope"], "invalid choice: 'nope'"),
            (["--study", "grip_mismatch", "--jobs", "2"], "--study grip_mismatch: solves in this process"),
            (["--study", "grid_spacing", "--executor", "serial"], "--study grid_spacing: solves in this process"),
            (
                ["--vary", "limits.beta=2,3", "--jobs", "-2", "--executor", "serial"],
                "--jobs -2: only with --executor",
            ),
            (["--vary", "limits.beta=2,3", "--jobs", "-2"], "--jobs -2: must be at least 1"),
            (["--vary", "limits.beta=2,3", "--figures", "here"], "--figures: only with --study"),
            (["--vary", "limits.beta=2,3", "--seed", "3"], "--seed 3: only with --sample"),
            (["--vary", "limits.beta=2,3", "--sample", "three"], "argument --sample: invalid int value: 'three'"),
            (["--require", "nrmse<=0.1", "--solve-for", "limits.beta=1:2", "--full"], "not together with --full"),
            (
                ["--require", "nrmse<=0.1", "--solve-for", "limits.beta=1:2", "--seed", "2"],
                "not together with --full",
            ),
        ],
    )
    def test_options_that_would_be_ignored_are_refused(
        self, study: Any, words: list[str], error: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert study.constraint_study.main([*words, "--out", str(tmp_path / "out")]) == 2
        said = capsys.readouterr().err
        assert said.startswith("error: ")
        assert error in said
        assert said.count("\n") == 1
        assert not (tmp_path / "out").exists()

    def test_everything_refused_is_a_shortfall(self, study: Any, scene_file: Path, tmp_path: Path) -> None:
        words = [str(scene_file), "--vary", "limits.current_A=50,60", "--speed", "0.4", "--grip", "5"]
        assert study.constraint_study.main([*words, "--executor", "serial", "--out", str(tmp_path / "out")]) == 1
        assert (tmp_path / "out" / "nrmse.png").exists()

    @pytest.mark.parametrize(
        ("status", "code", "named"),
        [
            (Status.INFEASIBLE, 0, True),
            (Status.HAND_OVER, 0, False),
            (Status.NOT_CERTIFIED, 1, True),
            (Status.REPLAY_VIOLATION, 1, False),
            (None, 1, False),
        ],
    )
    def test_one_row_that_falls_short_is_told(
        self,
        study: Any,
        scene: Scene,
        scene_file: Path,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        status: Status | None,
        code: int,
        named: bool,
    ) -> None:
        """None: an exception, which becomes a DEFECT."""
        real, calls = sweep.admit, []

        def second_differs(*given: Any) -> Any:
            calls.append(1)
            if len(calls) == 2 and status is None:
                raise ZeroDivisionError
            return (status, ["said so"]) if len(calls) == 2 else real(*given)

        monkeypatch.setattr(sweep, "admit", second_differs)
        monkeypatch.setattr(study.axes, "TOGETHER", 1)
        if named:
            swept = study.named.SWEPT
            fewer = replace(
                swept["current_limit"], axis="limits.current_A=2,3", speeds_m_s=(0.4,), grips_N=(3.0, 5.0)
            )
            monkeypatch.setitem(swept, "current_limit", fewer)
            assert study.named.write("current_limit", short_scene(scene), tmp_path, serial(study), None) == code
            rows = read(tmp_path / "current_limit" / "rows.csv")
        else:
            words = [str(scene_file), "--vary", "limits.current_A=2,3", "--speed", "0.4", "--grip", "3,5"]
            assert (
                study.constraint_study.main([*words, "--executor", "serial", "--out", str(tmp_path / "out")]) == code
            )
            rows = read(tmp_path / "out" / "rows.csv")
        assert sorted(row["status"] for row in rows) == sorted(
            ["OPTIMAL"] * 3 + [status.name if status else "DEFECT"]
        )

    @pytest.mark.skipif(sys.platform == "win32", reason="signals")
    @pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGKILL])
    def test_stopped_and_gone_on_with(
        self, study: Any, scene_file: Path, unstopped: Path, tmp_path: Path, signal_number: signal.Signals
    ) -> None:
        out = tmp_path / "out"
        words = [str(scene_file), "--vary", "limits.current_A=1:4:32", "--speed", "0.3,0.4", "--grip", "1,5"]
        command = [sys.executable, str(SCRIPTS / "constraint_study.py"), *words, "--jobs", "1", "--out", str(out)]
        environment = {**os.environ, "PYTHONPATH": str(SCRIPTS.parent)}
        with subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as run:
            rows = out / "rows.csv"
            while not rows.exists() or rows.read_bytes().count(b"\n") < 3:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    run.wait(timeout=0.02)
                    pytest.fail("ended before anything was written")
            run.send_signal(signal_number)
            _, said = run.communicate(timeout=60)
        if signal_number == signal.SIGINT:
            assert run.returncode == 130
            assert "the same command goes on from there" in said
            assert "Traceback" not in said
        kept = rows.read_bytes()
        kept = kept[: kept.rfind(b"\n") + 1].splitlines()
        assert 3 <= len(kept) < 129
        assert study.constraint_study.main([*words, "--executor", "serial", "--out", str(out)]) == 0
        assert plain(rows) == plain(unstopped / "rows.csv")
        assert set(kept) <= set(rows.read_bytes().splitlines())
