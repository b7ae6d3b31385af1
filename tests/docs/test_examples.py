"""The Python of README and of the manual runs as it stands there."""

import re
from pathlib import Path
from typing import Any

import pytest

import transopt as to
from tests.docs.pages import blocks, fenced, text
from transopt.library.library import Library
from transopt.solvers import choose
from transopt.solvers.native import extension

[README] = blocks("README.md", "python")
[ONLINE] = blocks("docs/howto/online.md", "python")
[API] = blocks("docs/reference/python.md", "python")
[NUMPY] = blocks("docs/howto/verify_with_numpy.md", "python")


def test_numpy_alone_needs_nothing_of_this_project() -> None:
    assert "transopt" not in re.sub("#.*", "", NUMPY)


def test_readme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    exec(README, {})
    assert "peak command" in capsys.readouterr().out
    assert all((tmp_path / name).exists() for name in ("library.npz", "transients.png"))


@pytest.mark.skipif(not extension.available, reason="the extension is not built")
def test_online(
    library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out/wood_on_foam").mkdir(parents=True)
    library.save(tmp_path / "out/wood_on_foam/library.npz")
    exec(ONLINE, {})
    assert re.search(r"J = 0\.\d+, gap \de-\d+, ", capsys.readouterr().out)


def test_a_solver_from_outside_the_package_designs_a_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's own file, entered by its steps."""
    method, use = fenced("docs/develop/add_solver.md")
    assert method.file == "my_solver.py"
    (tmp_path / method.file).write_text(method.code, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(choose, "SOLVERS", dict(choose.SOLVERS))
    names: dict[str, Any] = {}
    exec(use.code, names)
    [own] = to.build(names["scene"]).all_entries()
    assert names["entry"].certificate.objective == pytest.approx(own.certificate.objective, rel=1e-7)


def test_python_api(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    exec(API, {})  # the block is this repository's own text
    assert "0.4 m/s, 5 N: tap error 36.2 %, felt error 15.5 %" in capsys.readouterr().out
    assert all((tmp_path / name).exists() for name in ("library.npz", "transients.png", "out/report.md"))


def test_the_page_on_python_names_the_whole_interface() -> None:
    page = text("docs/reference/python.md")
    table = page[page.index("| for |") : page.index("These names")]
    assert set(re.findall(r"`(\w+)", table)) == set(to.__all__)


class TestNumpyAlone:
    @pytest.mark.parametrize("entry", ["3, 2", "3, 0", "0, 1"])
    def test_certifies_a_real_library(
        self,
        library: Library,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
        entry: str,
    ) -> None:
        monkeypatch.chdir(tmp_path)
        library.save(tmp_path / "library.npz")
        assert "iv, ig = 3, 2" in NUMPY
        names: dict[str, float] = {}
        exec(NUMPY.replace("iv, ig = 3, 2", f"iv, ig = {entry}"), names)
        iv, ig = (int(part) for part in entry.split(","))
        assert names["J"] == pytest.approx(library.objective[iv, ig], rel=1e-9)
        assert "above the optimum" in capsys.readouterr().out

    def test_rejects_a_changed_command(
        self, library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        from dataclasses import replace

        monkeypatch.chdir(tmp_path)
        command = library.command.copy()
        command[3, 2, 100] += 0.01
        replace(library, command=command).save(tmp_path / "library.npz")
        with pytest.raises(AssertionError):
            exec(NUMPY, {})
