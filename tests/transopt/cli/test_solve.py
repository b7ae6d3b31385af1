"""`transopt solve` as a user meets it: files, messages, exit codes, nothing lost."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import problems
from tests.benches.commands import Run, assert_refused
from tests.benches.places import IMPACTS, ROOT
from transopt.problem.answer import Status

UNTOUCHED = "stopped; earlier results are untouched\n"
WOOD = problems.scene_path("wood_on_foam").read_text()


class TestSolve:
    def test_files_table_and_last_line(self, run: Run, solved: Path) -> None:
        names = {"library.npz", "report.md", "report.json", "transients.png", "methods.png", "bode.png"}
        assert {path.name for path in solved.iterdir()} == names
        report = json.loads((solved / "report.json").read_text())
        (entry,) = report["entries"]
        assert entry["status"] == Status.OPTIMAL.value
        assert entry["certificate"]["relative_gap"] <= 1e-6
        assert entry["repeatability"] is None
        assert "temperature" in entry["left_out"]
        markdown = (solved / "report.md").read_text()
        for word in ("tap %", "floor %", "felt dB", "what binds", "Left out", "25.73 C"):
            assert word in markdown

    def test_certificates_and_time_are_printed_when_asked_for(self, run: Run, quick_scene: Path) -> None:
        outcome = run("solve", quick_scene, "--out", "here", "--report", "--no-figures")
        assert outcome.code == 0
        found = re.search(
            r"1 of 1 entries certified and replayed: tap error (\S+) to (\S+) % \(worst at 0\.2 m/s, 3 N\), "
            r"felt error (\S+) to \S+ %, gap <= (\S+), violation <= (\S+) A, V or K; "
            r"(\S+) ms per entry \(median\), (\S+) s in all",
            outcome.out,
        )
        assert found is not None, outcome.out
        (entry,) = json.loads(Path("here/report.json").read_text())["entries"]
        assert found[1] == found[2] == f"{100 * entry['tap_error']:.1f}"
        assert found[3] == f"{100 * entry['felt_error']:.2f}"
        assert float(found[4]) == pytest.approx(entry["certificate"]["relative_gap"], rel=0.5)
        assert float(found[7]) > 0
        assert "gap" in outcome.out.split("┡")[0].split()

    def test_recordings_folder_is_named_by_the_user(self, run: Run) -> None:
        assert_refused(run("solve", "measured_impacts"), "acc_base_a*.txt", "--recordings FOLDER", "github.com")
        assert not Path("out/measured_impacts").exists()  # no empty folder is left behind
        assert_refused(
            run("solve", "measured_impacts", "--recordings", "absent"), "--recordings absent", "no such folder"
        )
        if not IMPACTS.is_dir():
            pytest.skip(f"the measured impacts are not at {IMPACTS}")
        assert run("solve", "measured_impacts", "--recordings", IMPACTS, "--no-figures").code == 0
        assert "Similarity-scaled: time x 10" in Path("out/measured_impacts/report.md").read_text()

    def test_refused_entries_exit_1_and_keep_the_earlier_library(
        self, run: Run, quick_scene: Path, solved: Path
    ) -> None:
        before = (solved / "library.npz").read_bytes()
        stiff = Path("stiff.toml")
        weak = quick_scene.read_text().replace("steady_current_A = 1.25", "steady_current_A = 1.25\ncurrent_A = 0.3")
        assert "current_A = 0.3" in weak
        stiff.write_text(weak.replace("beta = 3.2", "") + "\n[feedback]\nstiffness_N_m = 2000.0\n")
        outcome = run("solve", stiff, "--out", solved)
        assert outcome.code == 1
        reason = re.search(
            r"refused: 0\.2 m/s, 3 N: .*(hand-over: K_p z / k_f = .* A at .* mm .*, limit 0.3 A)", outcome.out
        )
        assert reason is not None, outcome.out
        assert ": 1 of 1 tap refused, so no library is written and an earlier one is kept." in outcome.out
        assert outcome.out.splitlines()[-1] == "solved: refused.md and 1 other file."
        assert (solved / "library.npz").read_bytes() == before
        assert reason[1] in (solved / "refused.md").read_text()
        assert run("solve", quick_scene, "--out", solved, "--no-figures").code == 0
        assert not (solved / "refused.md").exists()

    def test_without_figures_an_earlier_builds_figures_go(self, run: Run, quick_scene: Path, solved: Path) -> None:
        drawn = {file.name for file in solved.glob("*.png")}
        assert drawn == {"transients.png", "methods.png", "bode.png"}
        assert run("solve", quick_scene, "--out", solved, "--no-figures").code == 0
        assert {file.name for file in solved.iterdir()} == {"library.npz", "report.md", "report.json"}

    def test_the_full_report_says_what_intensity_costs(self, run: Run) -> None:
        one = WOOD.replace("[0.1, 0.2, 0.3, 0.4]", "[0.4]").replace("[1.0, 3.0, 5.0]", "[5.0]")
        Path("one.toml").write_text(one)
        for options, there in (([], False), (["--full"], True)):
            out = Path("full" if there else "brief")
            assert run("solve", "one.toml", *options, "--no-figures", "--out", out).code == 0
            (entry,) = json.loads((out / "report.json").read_text())["entries"]
            assert entry["prices"]
            assert (entry["trade_off"] is not None) is there
            for rival in ("seed % at 4 / 1.25 A", "clipped % at 4 / 1.25 A"):
                assert (rival in (out / "report.md").read_text()) is there

    def test_brackets_and_colons_in_names_are_only_brackets_and_colons(self, run: Run, quick_scene: Path) -> None:
        text = quick_scene.read_text()
        line = next(line for line in text.splitlines() if line.startswith("description"))
        Path("b.toml").write_text(text.replace(line, 'description = "tap in [g] and [/x] :drum:"'))
        outcome = run("solve", "b.toml", "--out", "run [1]/[/b]", "--table", "--no-figures")
        assert outcome.code == 0
        assert "tap in [g] and [/x] :drum:" in outcome.out
        assert run("show", "run [1]/[/b]/library.npz").code == 0

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (["wood_on_foam", "--solver-tolerance", "0"], ["--solver-tolerance 0", "between 0 and 1"]),
            (["wood_on_foam", "--grid-tolerance", "0"], ["--grid-tolerance 0", "between 0 and 1"]),
            (["wood_on_foam", "--grid-tolerance", "0.02", "--grid-cap", "11"], ["--grid-cap 11", "12 entries"]),
        ],
    )
    def test_bad_arguments(self, run: Run, arguments: list[str], words: list[str]) -> None:
        assert_refused(run("solve", *arguments), *words)
        assert not list(Path.cwd().glob("out/*/*"))

    def test_an_output_folder_that_cannot_be_written(self, run: Run, quick_scene: Path) -> None:
        Path("file").write_text("in the way")
        assert_refused(run("solve", quick_scene, "--out", "file"), "--out file", "cannot be written")
        assert_refused(run("solve", quick_scene, "--out", "file/below"), "--out file/below", "cannot be written")
        assert Path("file").read_text() == "in the way"

    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            ("speeds_m_s = [0.2]", "speeds_m_s = [0.3]", ["tap_0.2_m_s.csv", "0.1932 m/s", "limit 15%"]),
            ("stages = 800", "stages = 8000", ["tap_0.2_m_s.csv", "the window needs 799.7", "record longer"]),
            (
                "mass_kg = 0.010",
                "mass_kg = { constant = 0.01, per_newton = -0.01 }",
                ["mass 3 of the chain", "-0.02 kg"],
            ),
        ],
    )
    def test_a_bad_scene_leaves_earlier_output_untouched(
        self, run: Run, quick_scene: Path, solved: Path, old: str, new: str, words: list[str]
    ) -> None:
        before = {path.name: path.read_bytes() for path in solved.iterdir()}
        text = quick_scene.read_text()
        assert old in text
        Path("bad.toml").write_text(text.replace(old, new))
        assert_refused(run("solve", "bad.toml", "--out", solved), *words)
        assert {path.name: path.read_bytes() for path in solved.iterdir()} == before

    @pytest.mark.parametrize("instant", ["recordings", "entries", "writing"])
    def test_interrupted_solve_loses_nothing(
        self, run: Run, quick_scene: Path, solved: Path, monkeypatch: pytest.MonkeyPatch, instant: str
    ) -> None:
        before = {path.name: path.read_bytes() for path in solved.iterdir()}

        def interrupt(*_: object, **__: object) -> None:
            raise KeyboardInterrupt

        target = {
            "recordings": "transopt.scene.recordings.recordings_of",
            "entries": "transopt.design.batch.replayed",
            "writing": "transopt.report.figures.bode_figure",
        }[instant]
        monkeypatch.setattr(target, interrupt)
        outcome = run("solve", quick_scene, "--out", solved)
        assert outcome.code == 130
        assert "Traceback" not in outcome.err
        assert {path.name: path.read_bytes() for path in solved.iterdir()} == before


class TestLostStart:
    """What is over before the first command can act is error, and a scene with much of it is warned of."""

    def late(self, delay_s: str, lead_s: str, after_s: str = "0.0") -> Path:
        text = WOOD.replace("delay_s = 68e-6", f"delay_s = {delay_s}").replace("[1.0, 3.0, 5.0]", "[3.0]")
        text = text.replace("stages = 800 ", f"lead_s = {lead_s}\nstages = 600 ") + f"after_s = {after_s}\n"
        path = Path("late.toml")
        path.write_text(text)
        return path

    def test_a_delay_beyond_the_lead(self, run: Run) -> None:
        """An independent program finds the same 34.3 and 50.7 % beside the whole tap."""
        outcome = run("solve", self.late("1e-3", "3e-4"), "--out", "late", "--no-figures")
        assert outcome.code == 0
        report = json.loads(Path("late/report.json").read_text())
        by_speed = {entry["speed_m_s"]: 100 * entry["tap_error"] for entry in report["entries"]}
        assert by_speed[0.1] == pytest.approx(34.3, abs=0.2)
        assert by_speed[0.4] == pytest.approx(50.7, abs=0.2)
        shares = [100 * reference["lost_share"] for reference in report["references"]]
        assert all(4 < share < 9 for share in shares)
        said = f"{max(shares):.2g} % of the energy of the tap at 0.4 m/s is over before the first command can act"
        assert said in outcome.out
        assert "time.lead_s = 0.0012 would do" in outcome.out
        assert said in Path("late/report.md").read_text()
        assert any(warning.startswith(said) for warning in report["warnings"])
        # A floor that is as high is none of the limits' making.
        assert all(entry["floor"] > 0.25 for entry in report["entries"])

    def test_a_whole_pulse_is_over(self, run: Run) -> None:
        outcome = run("solve", self.late("9e-3", "0.0"), "--out", "late", "--no-figures")
        assert outcome.code == 0
        report = json.loads(Path("late/report.json").read_text())
        assert all(0.9 <= entry["felt_error"] <= 1.0 for entry in report["entries"])
        assert "time.lead_s = 0.0092 would do" in outcome.out

    def test_no_lead_covers_such_a_delay(self, run: Run) -> None:
        outcome = run("solve", self.late("25e-3", "0.02", "0.03"), "--out", "late", "--no-figures")
        assert "no lead up to 20 ms covers that delay" in outcome.out

    def test_nothing_is_said_where_the_lead_covers_it(self, run: Run) -> None:
        outcome = run("solve", self.late("1e-3", "1.2e-3", "0.03"), "--out", "late", "--no-figures")
        assert outcome.code == 0
        assert "is over before" not in outcome.out
        report = json.loads(Path("late/report.json").read_text())
        assert all(entry["felt_error"] < 0.17 for entry in report["entries"])
        assert [reference["lost_share"] for reference in report["references"]] == [0.0] * 4


class TestAfterTheWaveform:
    def test_it_is_calm_where_it_counts_and_said_where_it_does_not(self, run: Run, quick_scene: Path) -> None:
        """The tap of the default scene that rings on most: 1.9 g without, a fifth with its tail counted."""
        text = WOOD.replace("[0.1, 0.2, 0.3, 0.4]", "[0.3]").replace("[1.0, 3.0, 5.0]", "[1.0]")
        peaks = {}
        for after_s in (0.0, 0.03):
            Path("one.toml").write_text(text + f"after_s = {after_s}\n")
            outcome = run("solve", "one.toml", "--out", "one", "--no-figures")
            (entry,) = json.loads(Path("one/report.json").read_text())["entries"]
            peaks[after_s] = (entry["after_peak_m_s2"] / 9.80665, entry["peak_after_m_s2"] / 9.80665)
            assert ("weights.after_s is 0, by default it is 0.03" in outcome.out) == (after_s == 0)
        assert peaks[0.0][0] > 1.8
        assert peaks[0.0][1] == 0
        assert 0 < peaks[0.03][1] <= 0.4
        markdown = Path("one/report.md").read_text()
        assert "| after % | after g |" in markdown
        assert f"| {peaks[0.03][1]:.3f} |" in markdown


STANDS = {
    "solving": "",
    "importing": """
def fails(*_, **__):
    try:
        Path('there').touch()
        time.sleep(60)
    except KeyboardInterrupt:
        raise ImportError('initialization failed')
build.build_library = fails
""",
    "telling": """
def told(*_):
    Path('there').touch()
    time.sleep(60)
command._print = told
""",
}


@pytest.mark.parametrize("where", STANDS)
def test_ctrl_c_in_a_real_process(tmp_path: Path, where: str) -> None:
    """The signal itself, in the solve or in the table: one line, code 130, all files or none, no child left."""
    program = f"""
import time, transopt.cli.solve as command, transopt.design.build as build
from pathlib import Path
{STANDS[where]}
# A background job of a shell starts with SIGINT ignored; a user's terminal does not.
import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)
sys.argv = ['transopt', 'solve', '--no-figures']
from transopt.cli.main import main; main()"""
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    folder, written = tmp_path / "out" / "wood_on_foam", where == "telling"
    while not (folder if where == "solving" else tmp_path / "there").exists():
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)  # polls for the process to have come there; nothing is measured
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert err == (f"stopped; {Path('out', 'wood_on_foam')} is written\n" if written else UNTOUCHED)
    assert [*folder.glob("*.npz")] == ([folder / "library.npz"] if written else [])
