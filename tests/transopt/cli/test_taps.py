"""`transopt taps`: recordings looked at before solving."""

from pathlib import Path

import numpy as np

import problems
from tests.benches.commands import Run, assert_refused

EXAMPLES = problems.FOLDER / "recordings"


class TestTaps:
    def test_table_figure_and_section(self, run: Run) -> None:
        outcome = run("taps", *sorted(EXAMPLES.glob("*.csv")), "--out", "look")
        assert outcome.code == 0
        assert "tap_0.3_m_s.csv" in outcome.out
        assert "stated" in outcome.out
        assert Path("look/taps.png").read_bytes()[:4] == b"\x89PNG"

    def test_the_lines_make_a_scene_that_solves(self, run: Run) -> None:
        """Put where the user is told to put them."""
        outcome = run("taps", *sorted(EXAMPLES.glob("*.csv")))
        lines = outcome.out[outcome.out.index("# in [grid]") :]
        grid, recordings = lines.split("\n\n")
        text = problems.scene_path("own_taps").read_text()
        text = text.replace("speeds_m_s = [0.2, 0.3, 0.4]", grid).replace("[1.0, 3.0, 5.0]", "[3.0]")
        text = text.replace('folder = "../recordings"\nfiles = ["tap_*.csv"]', recordings)
        assert "# in [recordings]" in text
        Path("pasted.toml").write_text(text)
        assert run("solve", "pasted.toml").code == 0

    def test_a_scene_that_solves(self, run: Run) -> None:
        Path("rig").mkdir()
        for file in sorted(EXAMPLES.glob("*.csv"))[:2]:
            Path("rig", file.name).write_bytes(file.read_bytes())
        files = sorted(Path("rig").iterdir())
        outcome = run("taps", *files, "--scene", "mine.toml")
        assert "transopt solve mine.toml" in outcome.out
        text = Path("mine.toml").read_text()
        assert 'folder = "rig"' in text
        assert "speeds_m_s = [0.209, 0.31]" in text
        Path("mine.toml").write_text(text.replace("[1.0, 3.0, 5.0]", "[3.0]"))
        assert run("solve", "mine.toml").code == 0
        assert_refused(run("taps", *files, "--scene", "mine.toml"), "mine.toml: exists already")
        assert_refused(run("taps", *files, "--scene", "mine.txt"), "mine.txt", ".toml")

    def test_a_pattern_and_a_name_with_brackets(self, run: Run) -> None:
        Path("a [1]").mkdir()
        Path("a [1]/tap[1].csv").write_bytes((EXAMPLES / "tap_0.2_m_s.csv").read_bytes())
        assert run("taps", "a [1]/tap[1].csv").code == 0
        assert run("taps", EXAMPLES / "tap_*.csv").out.count("stated") == 3
        assert_refused(run("taps", "a [1]/none*.csv"), "none*.csv", "matches no file")

    def test_speed_is_for_files_that_state_none(self, run: Run) -> None:
        outcome = run("taps", EXAMPLES / "tap_0.3_m_s.csv", "--speed", 0.2)
        assert "0.3098" in outcome.out

    def test_text_files_need_columns_and_scaling_is_stated(self, run: Run) -> None:
        rows = "\n".join(f"{k * 2e-5:.6f} {100 * np.exp(-(((k - 300) / 60) ** 2)):.4f}" for k in range(1500))
        Path("impact.txt").write_text(f"# time, acceleration\n{rows}\n")
        assert_refused(run("taps", "impact.txt"), "impact.txt", "columns")
        columns = ("--columns", "time_s,acceleration_g")
        assert_refused(run("taps", "impact.txt", *columns), "no incoming speed")
        outcome = run("taps", "impact.txt", *columns, "--speed", 1.0, "--time-scale", 10, "--amplitude-scale", 0.02)
        assert outcome.code == 0
        assert "similarity-scaled" in outcome.out
        assert "time_scale = 10.0" in outcome.out

    def test_refusals(self, run: Run) -> None:
        assert_refused(run("taps", "absent.csv"), "absent.csv")
        Path("empty.csv").write_text("")
        assert_refused(run("taps", "empty.csv"), "empty.csv", "empty")
        assert_refused(
            run("taps", EXAMPLES / "tap_0.2_m_s.csv", "--speed", -1), "--speed -1", "greater than or equal to 0.0001"
        )


def test_a_pattern_that_matches_nothing(run: Run, tmp_path: Path) -> None:
    """As a shell hands it on where it finds no file either."""
    assert_refused(run("taps", tmp_path / "rgi" / "tap_*.csv"), "tap_*.csv: matches no file: check the names")
