"""What may import what where no package holds it: scripts and tests know nothing of each other."""

import ast
import re
from pathlib import Path

import pytest

from tests.benches.places import ROOT

SCRIPTS, TESTS = ROOT / "scripts", ROOT / "tests"
LOADER = "tests.benches.scripts"  # loads scripts from their path, for the tests of scripts alone


def top_names(folder: Path) -> set[str]:
    """Names by which Python finds what lies in a folder: modules and folders of modules, and the folder itself."""
    modules = {path.stem for path in folder.glob("*.py")} - {"__init__"}
    return modules | {path.parent.name for path in folder.glob("*/*.py")} | {folder.name}


def mentions(source: str, names: set[str]) -> bool:
    """Whether an import may have one of these first names: found in far less time than by taking a file apart."""
    return re.search(rf"\b(from|import)\b(.|\\\n)*\b({'|'.join(map(re.escape, names))})\b", source) is not None


def imported(source: str) -> list[tuple[int, str]]:
    """Line and whole name of all that is imported, wherever in the source it is."""
    found = list[tuple[int, str]]()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found += [(node.lineno, f"{node.module}.{alias.name}") for alias in node.names]
    return found


def crossings(source: str, forbidden: set[str]) -> list[str]:
    """Imports whose first name is one of these."""
    found = imported(source) if mentions(source, forbidden) else []
    return [f"{line}: {name}" for line, name in found if name.split(".")[0] in forbidden]


def all_crossings(folder: Path, forbidden: set[str]) -> list[str]:
    return [
        f"{path.relative_to(ROOT)}:{found}"
        for path in sorted(folder.rglob("*.py"))
        for found in crossings(path.read_text(encoding="utf-8"), forbidden)
    ]


@pytest.mark.parametrize(
    "source",
    [
        "import scripts.benchmark",
        "from benchmark import main",
        "from seed import plots",
        "def f():\n    import common",
        "import math, \\\n    common",
    ],
)
def test_an_import_of_a_script_is_seen(source: str) -> None:
    assert crossings(source, top_names(SCRIPTS))


def test_other_imports_are_none() -> None:
    assert not crossings("import numpy.random\nfrom transopt.base import files", top_names(SCRIPTS))


def test_tests_import_no_script() -> None:
    assert all_crossings(TESTS, top_names(SCRIPTS)) == []


def test_scripts_import_no_test() -> None:
    assert all_crossings(SCRIPTS, {"tests", "conftest"}) == []


def test_packages_import_neither() -> None:
    packages = [ROOT / name for name in ("transopt", "problems", "controller")]
    assert [found for one in packages for found in all_crossings(one, {"tests", "scripts"})] == []


def test_scripts_are_loaded_by_their_own_tests_only() -> None:
    own = {path for path in TESTS.rglob("*.py") if path.parent == TESTS / "scripts"}
    assert [
        str(path.relative_to(ROOT))
        for path in sorted({*TESTS.rglob("*.py")} - own)
        if "scripts" in (source := path.read_text(encoding="utf-8"))
        and any(name.startswith(LOADER) for _, name in imported(source))
    ] == []
