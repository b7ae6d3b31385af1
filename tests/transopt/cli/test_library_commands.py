"""`transopt verify`, `show`, `compare` and `export`: what is done with a library that is there."""

from dataclasses import replace
from pathlib import Path

from tests.benches.commands import Run, assert_refused
from tests.benches.libraries import under
from transopt.library.file import load_library


class TestVerifyShowExport:
    def test_verify(self, run: Run, solved: Path) -> None:
        outcome = run("verify", solved / "library.npz")
        assert outcome.code == 0
        assert "1 of 1 entries certified and replayed clean" in outcome.out

    def test_a_damaged_library_is_refused(self, run: Run, solved: Path) -> None:
        content = (solved / "library.npz").read_bytes()
        Path("cut.npz").write_bytes(content[: len(content) // 2])
        for command in (["verify"], ["show"], ["export"]):
            more = ["x.csv"] if command == ["export"] else []
            assert_refused(run(*command, "cut.npz", *more), "cut.npz")
            assert_refused(run(*command, "absent.npz", *more), "absent.npz: no such file")

    def test_show_with_figure(self, run: Run, solved: Path) -> None:
        outcome = run("show", solved / "library.npz", "--table", "--figure", "look.png")
        assert outcome.code == 0
        assert {"tap", "felt", "heat"} <= set(outcome.out.split("┡")[0].split())
        assert Path("look.png").read_bytes()[:4] == b"\x89PNG"
        assert_refused(
            run("show", solved / "library.npz", "--figure", "absent/look.png"), "there is no folder absent"
        )

    def test_export_refusals(self, run: Run, solved: Path) -> None:
        assert_refused(run("export", solved / "library.npz", "x.pdf"), ".mat", ".csv", ".wav", ".h")
        assert_refused(run("export", solved / "library.npz", "absent/x.csv"), "there is no folder absent")


class TestCompare:
    def test_the_same_library_twice(self, run: Run, solved: Path) -> None:
        outcome = run("compare", solved / "library.npz", solved / "library.npz")
        assert outcome.code == 0
        assert outcome.out.splitlines()[-1] == "1 entry; A and B hold the same content"
        assert "stated differently" not in outcome.out

    def test_figures_and_what_was_stated(self, run: Run, solved: Path, quick_scene: Path) -> None:
        Path("less.toml").write_text(quick_scene.read_text().replace("beta = 3.2", "beta = 1.5"))
        assert run("solve", "less.toml", "--no-figures").code == 0
        files = (solved / "library.npz", "out/less/library.npz")
        outcome = run("compare", *files, "--out", "compared.md")
        assert outcome.code == 0
        before, after = (load_library(Path(file)) for file in files)
        peaks = f"{before.peak_input[0, 0]:.3f} -> {after.peak_input[0, 0]:.3f}"
        last = outcome.out.splitlines()[-1]
        assert last.startswith("1 entry in both; tap error changes most by ")
        assert "at 0.2 m/s, 3 N" in last
        text = Path("compared.md").read_text()
        for shown in (outcome.out, text):
            assert peaks in shown
        verdicts = list(dict.fromkeys(each.verdict(0, 0) for each in (before, after)))
        assert " -> ".join(verdicts) in text
        assert "| scene.limits.beta | 3.2 | 1.5 |" in text
        assert last in text

    def test_entries_of_only_one(self, run: Run, solved: Path) -> None:
        library = load_library(solved / "library.npz")
        replace(library, grips_N=library.grips_N + 1).save(Path("other.npz"))
        outcome = run("compare", solved / "library.npz", "other.npz")
        assert outcome.code == 0
        assert "only in A" in outcome.out
        assert "only in B" in outcome.out
        assert outcome.out.splitlines()[-1] == (
            "0 entries in both; 1 only in A; 1 only in B; 0 values stated differently"
        )

    def test_commands_at_other_instants_are_not_subtracted(self, run: Run, solved: Path) -> None:
        library = load_library(solved / "library.npz")
        under(library, {"time.lead_s": 2 * library.lead_s}).save(Path("other.npz"))
        outcome = run("compare", solved / "library.npz", "other.npz", "--out", "c.md")
        assert outcome.code == 0
        (row,) = (line for line in Path("c.md").read_text().splitlines() if line.startswith("| 0.2 | 3 |"))
        assert row.split(" | ")[7] == "-"

    def test_refusals(self, run: Run, solved: Path) -> None:
        library = solved / "library.npz"
        assert_refused(run("compare", library, "absent.npz"), "absent.npz: no such file")
        assert_refused(run("compare", library, library, "--out", "c.txt"), "--out c.txt", ".md")
        assert_refused(
            run("compare", library, library, "--out", "absent/c.md"), "absent/c.md", "there is no folder absent"
        )
