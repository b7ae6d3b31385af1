"""`transopt taps`: recordings looked at before solving."""

import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from scipy.io import wavfile

import problems
from tests.benches.commands import Run, assert_refused
from transopt.recordings.settings import Recordings
from transopt.recordings.tap import prepare, read_recordings
from transopt.scene.builtin import load_scene
from transopt.scene.recordings import recordings_of, references_of

EXAMPLES = problems.FOLDER / "recordings"


class TestTaps:
    def test_table_figure_and_section(self, run: Run) -> None:
        outcome = run("taps", *sorted(EXAMPLES.glob("*.csv")), "--out", "look")
        assert outcome.code == 0
        assert "tap_0.3_m_s.csv" in outcome.out
        assert "stated" in outcome.out
        assert Path("look/taps.png").read_bytes()[:4] == b"\x89PNG"

    def test_what_all_taps_share_is_said_once_and_one_speed_of_unequal_taps_is_doubted(self, run: Run) -> None:
        for k, size in enumerate((1.0, 0.8, 0.3), start=1):
            times_s = np.arange(-500, 1500) / 1e4
            tap = 100 * size * np.exp(-120 * times_s) * np.sin(1400 * times_s) * (times_s > 0)
            rows = np.column_stack([times_s, 9.80665 + tap + 0.01 * np.sin(np.arange(2000) ** 2)])
            np.savetxt(f"t{k}.csv", rows, delimiter=",", header="time_s,acceleration_m_s2", comments="")
        shared = "offset and incoming acceleration are not told apart without a position"
        outcome = run("taps", "t1.csv", "t2.csv", "t3.csv", "--speed", 0.3, "--grip", 3, "--accept")
        assert outcome.out.count(shared) == 1
        assert f"of all 3: {shared}" in outcome.out
        slower = re.search(r"recordings\.speed_by_file_m_s = \{ \"t3\.csv\" = ([\d.]+) \}", outcome.out)
        assert slower is not None
        assert float(slower[1]) == pytest.approx(0.3 * 0.3, rel=0.1)
        equal = run("taps", "t1.csv", "t2.csv", "--speed", 0.3, "--grip", 3, "--accept")
        assert "speed_by_file_m_s" not in equal.out
        assert f"of all 1: {shared}" not in run("taps", "t1.csv", "--speed", 0.3, "--grip", 3, "--accept").out

    def test_one_tap_of_a_long_wav_file_is_the_target_of_an_actuator(self, run: Run) -> None:
        """What is proposed, done in turn: the full scale, then which part of the file is the target."""
        times_s = np.arange(int(5.2 * 20_000)) / 20_000 - 5.0
        tap = 60 * np.exp(-120 * np.maximum(times_s, 0.0)) * np.sin(1400 * times_s) * (times_s > 0)
        wavfile.write("taps.wav", 20_000, np.round(tap / 500 * 32767).astype(np.int16))
        scene = problems.scene_path("lra_click").read_text()
        first, rest = scene.index("[[targets]]"), scene.index("[model]")
        before, after = scene[:first] + '[[targets]]\nname = "tap"\nfile = "taps.wav"\n', "\n" + scene[rest:]
        recordings = "[recordings]\nfull_scale_m_s2 = 500.0\n"
        for target, said in (
            ("", "in a scene recordings.full_scale_m_s2 = "),
            ("full_scale_m_s2 = 500.0\n", "known here: name, shape, frequency_Hz, "),
            (recordings, "raise time.stages or state length_s of the target in taps.wav"),
        ):
            Path("mine.toml").write_text(before + target + after)
            assert_refused(run("solve", "mine.toml", "--no-figures"), said)
        Path("mine.toml").write_text(f"{before}start_s = 5.0\nlength_s = 0.03\nscale = 0.1\n{recordings}{after}")
        outcome = run("solve", "mine.toml", "--no-figures")
        assert outcome.code == 0, outcome.err
        assert "1 target, proven optimal" in outcome.out

    def test_the_speeds_of_the_grid_are_found_or_stated(self, run: Run) -> None:
        header = "time_s,acceleration_m_s2"
        for number, speed in enumerate((0.181, 0.203, 0.225, 0.29, 0.3, 0.32)):
            times_s = np.arange(-500, 1500) / 1e4
            tap = 300 * speed * np.exp(-120 * times_s) * np.sin(1400 * times_s) * (times_s > 0)
            rows = np.column_stack([times_s, 9.80665 + tap + 0.01 * np.sin(np.arange(2000) ** 2)])
            remarks = f"# speed_m_s: {speed}\n# grip_N: 3\n{header}"
            np.savetxt(f"t{number}.csv", rows, delimiter=",", header=remarks, comments="")
        files = [f"t{number}.csv" for number in range(6)]
        found = run("taps", *files)
        assert found.code == 0, found.err
        assert "speeds_m_s = [0.203, 0.303]" in found.out
        assert "state others by --speeds" in found.out
        stated = run("taps", *files, "--speeds", "0.2,0.3", "--scene", "mine.toml")
        assert "speeds_m_s = [0.2, 0.3]" in Path("mine.toml").read_text()
        assert "state others by --speeds" not in stated.out
        assert_refused(
            run("taps", *files, "--speeds", "0.2"), "--speeds 0.2: t3.csv has 0.29 m/s, 31% from the nearest"
        )
        assert_refused(run("taps", *files, "--speeds", "0.2,fast"), "'fast': must be above 0 and at most 100 m/s")

    def test_a_scene_that_solves(self, run: Run) -> None:
        Path("rig").mkdir()
        for file in sorted(EXAMPLES.glob("*.csv"))[:2]:
            Path("rig", file.name).write_bytes(file.read_bytes())
        files = sorted(Path("rig").iterdir())
        outcome = run("taps", *files, "--scene", "mine.toml")
        assert "transopt solve mine.toml" in outcome.out
        text = Path("mine.toml").read_text()
        assert 'folder = "rig"' in text
        assert "speeds_m_s = [0.193, 0.3]" in text
        Path("mine.toml").write_text(text.replace("[1.0, 3.0, 5.0]", "[3.0]"))
        assert run("solve", "mine.toml", "--no-figures").code == 0
        assert_refused(run("taps", *files, "--scene", "mine.toml"), "mine.toml: exists already")
        assert_refused(run("taps", *files, "--scene", "mine.txt"), "mine.txt", ".toml")

    def test_a_pattern_and_a_name_with_brackets(self, run: Run) -> None:
        Path("a [1]").mkdir()
        Path("a [1]/tap[1].csv").write_bytes((EXAMPLES / "tap_0.2_m_s.csv").read_bytes())
        assert run("taps", "a [1]/tap[1].csv").code == 0
        assert "3 recordings, speed source: stated" in run("taps", EXAMPLES / "tap_*.csv").out
        assert_refused(run("taps", "a [1]/none*.csv"), "none*.csv", "matches no file")

    def test_help_names_every_way_to_make_one_of_three_axes(self, run: Run) -> None:
        (ways, _) = get_args(Recordings.model_fields["axis"].annotation)
        said = re.sub(r"[│\s]+", " ", run("taps", "--help").out)
        stated = said[said.index("How axes become one") :].partition(". ")[0]
        assert all(re.search(rf"\b{way}\b", stated) for way in get_args(ways))

    def test_text_files_need_columns_and_scaling_is_stated(self, run: Run) -> None:
        rows = "\n".join(f"{k * 2e-5:.6f} {100 * np.exp(-(((k - 300) / 60) ** 2)):.4f}" for k in range(1500))
        Path("impact.txt").write_text(f"# time, acceleration\n{rows}\n")
        assert_refused(run("taps", "impact.txt"), "impact.txt", "columns")
        columns = ("--columns", "time_s,acceleration_g")
        refused = run("taps", "impact.txt", *columns)
        assert (refused.code, refused.err.count("\n")) == (2, 1)
        assert "peak 99.6 g, a tap's by hand 0.3 to 60 g" in refused.err  # low-passed, as the target is
        stated = run("taps", "impact.txt", *columns, "--speed", 1.0)
        assert_refused(stated, "peak 99.6 g, a tap's by hand 0.3 to 60 g")
        outcome = run("taps", "impact.txt", *columns, "--speed", 1.0, "--time-scale", 10, "--amplitude-scale", 0.02)
        assert outcome.code == 0
        assert "similarity-scaled" in outcome.out
        assert "time_scale = 10.0" in outcome.out

    def test_a_wrong_unit_is_named_and_not_solved_unless_accepted(self, run: Run) -> None:
        for number, file in enumerate(sorted(EXAMPLES.glob("*.csv"))):
            text = file.read_text().replace("acceleration_g", "acceleration_m_s2")
            Path(f"tap_{number}.csv").write_text(text)
        files = sorted(Path().glob("tap_*.csv"))
        outcome = run("taps", *files, "--scene", "mine.toml")
        assert outcome.code == 2
        assert f"{outcome.out}{outcome.err}".count("check the unit of the acceleration (g called m/s^2?)") == 3
        refuses = "solve refuses it until that is put right or accepted (--accept)"
        assert outcome.out.endswith(f"mine.toml written; {refuses}\n")
        assert_refused(run("solve", "mine.toml"), "tap_0.csv", "of the acceleration", 'implausible = "accept"')
        text = Path("mine.toml").read_text().replace("[recordings]", '[recordings]\nimplausible = "accept"')
        Path("mine.toml").write_text(text.replace("[1.0, 3.0, 5.0]", "[3.0]"))
        outcome = run("solve", "mine.toml", "--out", "mine", "--no-figures")
        assert outcome.code == 0
        assert '(g called m/s^2?), or of the speed (recordings.implausible = "accept")' in outcome.out
        assert "**tap_0.csv: the pulse changes the speed" in Path("mine/report.md").read_text()
        accepted = run("taps", *files, "--accept", "--scene", "mine.toml", "--force")
        assert accepted.code == 0
        assert 'implausible = "accept"' in Path("mine.toml").read_text()
        assert run("taps", *files, "--units", "acceleration=g", "--scene", "mine.toml", "--force").code == 0
        assert 'units = { acceleration = "g" }' in Path("mine.toml").read_text()

    def test_many_files_of_one_fault_are_a_few_lines(self, run: Run) -> None:
        text = (EXAMPLES / "tap_0.2_m_s.csv").read_text().replace("acceleration_g", "acceleration_m_s2")
        for number in range(5):
            Path(f"tap_{number}.csv").write_text(text)
        outcome = run("taps", *sorted(Path().glob("tap_*.csv")))
        assert f"{outcome.out}{outcome.err}".count("check the unit") == 3
        assert "and 2 recordings more" in outcome.out

    def test_times_of_a_wrong_unit_are_named_before_what_follows_from_them(self, run: Run) -> None:
        """Nothing is split into ripples, and no position is asked for."""
        text = (EXAMPLES / "tap_0.2_m_s.csv").read_text().replace("time_s", "time_ms")
        Path("tap.csv").write_text(re.sub("# speed_m_s: .*\n", "", text))
        assert_refused(run("taps", "tap.csv"), "tap.csv: the pulse lasts 0.00", "unit of the time (s called ms?)")
        rows = "\n".join(f"{0.02 * k:.6f},{100 * np.exp(-(((k - 300) / 60) ** 2)):.4f}" for k in range(1500))
        Path("impact.csv").write_text(f"time_s,acceleration_g\n{rows}\n")
        outcome = run("taps", "impact.csv", "--speed", 1.0)
        assert f"{outcome.out}{outcome.err}".count("check the unit of the time (ms called s?)") == 1


def tap_file(path: Path, speed_m_s: float, grip_N: float | None, *, gravity_g: float = 1.0) -> None:
    """One of the built-in taps under another name, of a stated speed and grip."""
    text = (EXAMPLES / "tap_0.2_m_s.csv").read_text()
    rows = text.split("time_s,acceleration_g,position_m\n")[1]
    a = np.array([[float(cell) for cell in row.split(",")] for row in rows.splitlines()])
    a[:, 1] = (a[:, 1] - 1.0) * speed_m_s / 0.209 + gravity_g
    grip = "" if grip_N is None else f"# grip_N: {grip_N:g}\n"
    body = "\n".join(f"{t:.4f},{g:.5f},{z * speed_m_s / 0.209:.7f}" for t, g, z in a)
    path.write_text(f"# speed_m_s: {speed_m_s:g}\n{grip}time_s,acceleration_g,position_m\n{body}\n")


class TestGrips:
    def test_cells_are_counted_and_missing_ones_named(self, run: Run) -> None:
        for speed, grips in ((0.1, (1, 5)), (0.2, (1, 3, 5)), (0.3, (1, 3))):
            for grip in grips:
                tap_file(Path(f"tap_{speed}_{grip}.csv"), speed, grip)
        outcome = run("taps", *sorted(Path().glob("tap_*.csv")), "--scene", "mine.toml")
        assert outcome.code == 0
        table = outcome.out[outcome.out.index("taps by speed and grip") :]
        cells = [line.replace("│", " ").split() for line in table.splitlines() if line.strip().startswith("│")]
        assert cells[:3] == [
            ["0.1", "1", "interpolated", "1"],
            ["0.2", "1", "1", "1"],
            ["0.3", "1", "1", "clamped"],
        ]
        text = Path("mine.toml").read_text()
        assert "speeds_m_s = [0.1, 0.2, 0.3]\ngrips_N = [1.0, 3.0, 5.0]\n" in text
        scene = load_scene("mine.toml")
        found = references_of(scene, recordings_of(scene))
        assert found.remarks(scene.grid.grips_N) == [
            "0.1 m/s, 3 N: blended from the taps of 1 and 5 N",
            "0.3 m/s, 5 N: taps of 1 and 3 N only, that of the nearest grip serves",
        ]

    def test_taps_without_a_grip(self, run: Run) -> None:
        tap_file(Path("tap_1.csv"), 0.2, None)
        tap_file(Path("tap_2.csv"), 0.3, None)
        outcome = run("taps", "tap_1.csv", "tap_2.csv")
        assert "no tap states its grip, so each serves every grip" in outcome.out
        assert "taps by speed and grip" not in outcome.out
        stated = run("taps", "tap_1.csv", "tap_2.csv", "--grip", 3)
        assert "serves every grip" not in stated.out
        assert "grip_N = 3.0" in stated.out
        assert_refused(run("taps", "tap_1.csv", "--grip", -1), "--grip -1", "greater than or equal to 0")

    def test_a_mixture_is_said_and_refused_by_solve(self, run: Run) -> None:
        tap_file(Path("tap_1.csv"), 0.2, None)
        tap_file(Path("tap_2.csv"), 0.3, 3.0)
        outcome = run("taps", "tap_1.csv", "tap_2.csv", "--scene", "mine.toml")
        assert "1 of 2 taps state no grip, and solve refuses such a mixture" in outcome.out
        assert_refused(run("solve", "mine.toml"), "tap_1.csv: states no grip", "# grip_N: 3")


class TestSensors:
    def test_one_that_shows_no_gravity_is_asked_after(self, run: Run) -> None:
        tap_file(Path("tap.csv"), 0.2, 3.0, gravity_g=0.0)
        hint = "if the sensor is of the IEPE type"
        asked = run("taps", "tap.csv").out
        assert hint in asked
        assert "1 recording, " in asked
        assert hint not in run("taps", EXAMPLES / "tap_0.2_m_s.csv").out
        stated = run("taps", "tap.csv", "--trusted-from-Hz", 2)
        assert hint not in stated.out
        assert "trusted_from_Hz = 2.0" in stated.out
        assert_refused(run("taps", "tap.csv", "--trusted-from-Hz", 50), "--trusted-from-Hz 50", "less than or equal")


def test_the_template_is_a_recording_that_is_read_and_solved(run: Run) -> None:
    outcome = run("taps", "--template", "tap.csv")
    assert (outcome.code, outcome.out) == (0, "tap.csv written; put your tap in it, then: transopt taps tap.csv\n")
    text = Path("tap.csv").read_text()
    assert run("taps", "tap.csv", "--scene", "mine.toml").code == 0
    # The remarks say what may be left out: the speed, which the position tells as well.
    Path("fitted.csv").write_text(text.replace("# speed_m_s: 0.2\n", ""))
    (stated, fitted) = (
        prepare(each, Recordings(files=["unused"]))
        for file in ("tap.csv", "fitted.csv")
        for each in read_recordings(Recordings(files=[str(Path(file).absolute())]))
    )
    assert fitted.speed_m_s == pytest.approx(stated.speed_m_s, rel=1e-3)
    for found in (stated, fitted):
        assert not found.implausible
        assert not found.notes
        assert found.offset_m_s2 == pytest.approx(9.80665, rel=1e-3)
        assert found.onset_s == pytest.approx(0.0, abs=1e-4)


def test_a_template_overwrites_nothing_and_reads_nothing(run: Run) -> None:
    Path("tap.csv").write_text("precious")
    assert_refused(run("taps", "--template", "tap.csv"), "exists already", "--force")
    assert Path("tap.csv").read_text() == "precious"
    assert run("taps", "--template", "tap.csv", "--force").code == 0
    assert_refused(run("taps", "tap.csv", "--template", "other.csv"), "reads none; leave tap.csv out")
    assert_refused(run("taps", "--template", "tap.txt"), "ends in .csv")
    assert_refused(run("taps"), "no recording named", "--template tap.csv")
