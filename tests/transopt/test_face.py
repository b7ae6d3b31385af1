"""The public interface: `import transopt as to`."""

import ast
import base64
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import transopt as to
from tests.benches.libraries import resized

FITS = 400  # characters of a `repr`
LARGEST_HTML = 200_000
HEAVY = ("casadi", "scipy", "matplotlib", "pydantic", "numpy", "rich", "typer")


def python(program: str, folder: Path) -> str:
    """What a program prints that runs as a script in a folder of its own."""
    script = folder / "script.py"
    script.write_text(program, encoding="utf-8")
    words = [sys.executable, str(script)]
    done = subprocess.run(words, check=False, capture_output=True, text=True, timeout=60, cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


class TestNames:
    def test_importing_loads_nothing_else(self, tmp_path: Path) -> None:
        said = python(f"import sys, transopt; dir(transopt); print({set(HEAVY)!r} & set(sys.modules))", tmp_path)
        assert said.strip() == "set()"

    def test_scene_names_need_no_solver(self, tmp_path: Path) -> None:
        program = "import sys, transopt as to; print(to.scene_names()[0], 'casadi' in sys.modules)"
        assert python(program, tmp_path).split() == [to.scene_names()[0], "False"]

    def test_reading_a_library_loads_no_optimiser_and_no_figures(self, library: to.Library, tmp_path: Path) -> None:
        library.save(tmp_path / "library.npz")
        program = (
            "import sys, controller, transopt as to\n"
            "print(to.load_library('library.npz').at(0.33, 2.0).command.size)\n"
            "print({'casadi', 'matplotlib', 'serial'} & set(sys.modules))\n"
        )
        assert python(program, tmp_path).split() == ["800", "set()"]

    def test_every_name_is_there_listed_and_typed(self) -> None:
        assert dir(to) == sorted(to.__all__)
        source = ast.parse(Path(to.__file__).read_text(encoding="utf-8"))
        [typed] = [node for node in source.body if isinstance(node, ast.If)]
        imports = [alias for node in typed.body if isinstance(node, ast.ImportFrom) for alias in node.names]
        assert sorted(alias.asname or alias.name for alias in imports) == sorted(to.__all__)
        for node in typed.body:
            assert isinstance(node, ast.ImportFrom)
            assert node.module is not None
            home = __import__(node.module, fromlist=["it"])
            for alias in node.names:
                assert getattr(to, alias.asname or alias.name) is getattr(home, alias.name)

    def test_every_name_says_what_it_is(self) -> None:
        for name in to.__all__:
            assert getattr(to, name).__doc__, name

    def test_an_unknown_name_is_an_attribute_error(self) -> None:
        with pytest.raises(AttributeError, match="module 'transopt' has no attribute 'solv'"):
            _ = to.solv  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ["problems.py", "controller.py"])
def test_a_file_beside_a_script_is_not_taken_for_one_of_the_packages(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("raise RuntimeError('the wrong file')\n", encoding="utf-8")
    program = "import transopt as to; print(to.load_scene('wood_on_foam').name, len(to.scene_names()))"
    assert python(program, tmp_path).split() == ["wood_on_foam", str(len(to.scene_names()))]


class TestSolving:
    def test_a_scene_by_name_by_path_and_by_value_is_the_same_library(
        self, library: to.Library, tmp_path: Path
    ) -> None:
        scene = to.load_scene("wood_on_foam")
        file = tmp_path / "mine.toml"
        text = (Path(to.__file__).parents[1] / "problems/scenes/wood_on_foam.toml").read_text(encoding="utf-8")
        file.write_text(text, encoding="utf-8")
        by_value = to.solve(scene, to.recordings_of(scene))
        for made in (to.solve("wood_on_foam"), to.solve(file), by_value):
            np.testing.assert_allclose(made.command, library.command, rtol=0, atol=1e-9)

    def test_refused_entries_are_said_in_one_line_and_kept_in_the_build(self) -> None:
        """The housing warms the winding beyond its limit with the motor at rest."""
        scene = to.load_scene("wood_on_foam")
        hot = scene.thermal.model_copy(update={"start_winding_C": 99.9, "start_housing_C": 300.0})
        grid = scene.grid.model_copy(update={"speeds_m_s": [0.2], "grips_N": [1.0, 3.0]})
        impossible = scene.model_copy(update={"thermal": hot, "grid": grid})
        taps = [tap for tap in to.recordings_of(scene) if "_0.2_m_s_" in tap.name]
        made = to.build(impossible, taps)
        assert made.library is None
        assert made.refused
        with pytest.raises(
            to.InputError, match=r"wood_on_foam: 2 of 2 entries refused, the first at 0\.2 m/s, 1 N: coil"
        ) as caught:
            to.solve(impossible, taps)
        assert "\n" not in str(caught.value)
        assert len(repr(made)) <= FITS
        assert len(repr(made.refused[0])) <= FITS
        assert isinstance(made.plot(), Figure)
        assert isinstance(made.refused[0].plot(), Figure)
        assert "refused" in made._repr_html_()

    def test_an_unknown_solver_and_scene_are_refused(self) -> None:
        with pytest.raises(to.InputError, match="unknown; choose one of"):
            to.solve("wood_on_foam", options=to.SolverOptions("magic"))
        with pytest.raises(to.InputError, match="no built-in scene of that name"):
            to.solve("wood")

    def test_a_grid_tolerance_adds_nodes(self) -> None:
        made = to.build("second_order", grid_tolerance=0.2)
        assert made.refinement.tolerance == 0.2

    def test_one_entry_by_hand(self, build: to.Build) -> None:
        entry = build.entries[3][2]
        solution = to.solve_problem(entry.problem)
        proof = to.certify(entry.problem, solution.command, solution.multipliers)
        assert proof.accepted
        assert proof.objective == pytest.approx(entry.certificate.objective, rel=1e-6)


def reached(value: Any, seen: set[int]) -> Iterator[Any]:
    """Everything with fields of its own that hangs on a value."""
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, list | tuple):
        for each in value:
            yield from reached(each, seen)
        return
    names = [f.name for f in fields(value)] if is_dataclass(value) else list(getattr(type(value), "model_fields", []))
    if names:
        yield value
    for name in names:
        yield from reached(getattr(value, name), seen)


class TestShown:
    def test_every_object_fits_a_terminal(self, build: to.Build, taps: list[to.Recording]) -> None:
        library = build.library
        replays = [entry.played for entry in build.all_entries()]
        shown = list(reached([build, taps, library.at(0.33, 2.0), to.verify(library), replays], set()))
        shown += [replace(build, library=None), library.problem(3, 2), library.stage(0), library.posing()]
        names = {type(each).__name__ for each in shown}
        assert names >= {
            "Build",
            "Entry",
            "Library",
            "Scene",
            "Reference",
            "TransientProblem",
            "StageModel",
            "Solution",
        }
        assert names >= {"Solution", "Multipliers", "Certificate", "Replay", "Recording", "Signal", "Waveform"}
        for each in shown:
            assert len(repr(each)) <= FITS, f"{type(each).__name__}: {len(repr(each))} characters"
            assert repr(each).startswith(f"{type(each).__name__}("), type(each)

    def test_equality_and_hash_are_those_of_the_fields(self, build: to.Build) -> None:
        amplifier = build.entries[0][0].problem.stage.amplifier
        assert amplifier is not None
        assert replace(amplifier) == amplifier
        assert hash(replace(amplifier)) == hash(amplifier)
        assert build.scene == to.load_scene("wood_on_foam")


class TestInANotebook:
    @pytest.mark.parametrize("what", ["library", "build", "entry"])
    def test_a_table_and_a_figure(self, build: to.Build, what: str) -> None:
        shown = {"library": build.library, "build": build, "entry": build.entries[3][2]}[what]
        html = shown._repr_html_()
        assert len(html) < LARGEST_HTML
        assert html.startswith("<table>")
        assert f"{100 * build.entries[3][2].figures.tap_error:.1f}" in html
        [picture] = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
        assert base64.b64decode(picture).startswith(b"\x89PNG")

    def test_a_large_library_stays_small(self, library: to.Library) -> None:
        """20 speeds and 10 grips: the first rows, and some of the waveforms."""
        large = resized(library, 20, 12)
        html = large._repr_html_()
        assert len(html) < LARGEST_HTML
        assert "and 200 more" in html


class TestFigures:
    def test_a_notebook_shows_what_plot_returns(self, library: to.Library) -> None:
        assert library.plot()._repr_png_()[:4] == b"\x89PNG"

    def test_an_entry_draws_its_own(self, build: to.Build) -> None:
        entry = build.entries[3][2]
        above, below, *_ = entry.plot().axes
        curves = [np.asarray(line.get_ydata()) for line in below.get_lines()]
        N = entry.plant_input.size
        assert any(curve.size == N + 300 and np.allclose(curve[:N], entry.plant_input) for curve in curves)
        assert above.get_title() == "grip 5 N"
        assert below.get_ylabel() == "current [A]"


class TestFilesByPath:
    """Recordings given by the paths of files and folders, as the command line takes them."""

    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        taps = to.recordings_of(to.load_scene("single_grip"))
        there = tmp_path / "taps"
        there.mkdir()
        for tap in taps[:2]:
            lines = [f"# speed_m_s: {tap.speed_m_s}", f"# grip_N: {tap.grip_N}", "time_s,acceleration_m_s2"]
            signal = tap.acceleration
            lines += [f"{signal.start_s + k * signal.dt_s:.7f},{a:.6f}" for k, a in enumerate(signal.values)]
            (there / f"{len(list(there.iterdir()))}.csv").write_text("\n".join(lines), encoding="utf-8")
        return there

    def test_reading(self, folder: Path) -> None:
        files = sorted(folder.iterdir())
        names = [each.name for each in files]
        for given in (folder, str(folder), files, [str(each) for each in files], tuple(files)):
            assert [tap.name for tap in to.read_recordings(given)] == names
        assert [tap.name for tap in to.read_recordings(files[0])] == names[:1]

    def test_solving(self, folder: Path) -> None:
        scene = to.with_values(to.load_scene("single_grip"), {"grid.speeds_m_s": [0.1]})
        by_path = to.solve(scene, sorted(folder.iterdir()))
        by_value = to.solve(scene, to.read_recordings(folder))
        assert by_path.tap_error == pytest.approx(by_value.tap_error)

    @pytest.mark.parametrize("given", [7, [7], [None], {"a.csv": 1}, ["a.csv", 7]])
    def test_what_is_neither_is_refused_in_a_line(self, given: Any) -> None:
        for call in (to.read_recordings, lambda each: to.solve("single_grip", each)):
            with pytest.raises(to.InputError, match="neither a Recording nor the path"):
                call(given)

    def test_a_file_that_is_not_there(self) -> None:
        with pytest.raises(to.InputError, match=r"a\.csv"):
            to.solve("single_grip", ["a.csv"])

    def test_a_library_is_an_npz_file(self, library: to.Library, tmp_path: Path) -> None:
        with pytest.raises(to.InputError, match=r"name it .*x\.npz; transopt\.export_library"):
            library.save(tmp_path / "x.csv")
        assert list(tmp_path.iterdir()) == []
        library.save(tmp_path / "x.npz")

    def test_the_reason_of_a_refusal_is_whole(self) -> None:
        scene = to.with_values(to.load_scene("single_grip"), {"limits.stroke_m": 3e-4})
        with pytest.raises(to.InputError) as refused:
            to.solve(scene)
        assert "..." not in str(refused.value)
        assert re.search(r"limits\.stroke_m = [\d.e-]+ m", str(refused.value))
