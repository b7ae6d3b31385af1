"""Whether what scripts and campaigns name of this repository is there: mypy reads neither, and both run seldom."""

import ast
import symtable
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.benches.places import ROOT

FOLDERS = (ROOT, ROOT / "scripts")  # from which Python finds modules: a script's own folder is one
OURS = {"transopt", "controller", "problems", "tests"} | {path.stem for path in (ROOT / "scripts").iterdir()}


def place(module: str) -> Path | None:
    """The file of a module, or the folder of a package without one; None if there is neither."""
    for folder in FOLDERS:
        path = folder.joinpath(*module.split("."))
        for found in (path.with_suffix(".py"), path / "__init__.py", path):
            if found.exists():
                return found
    return None


@cache
def bound(path: Path) -> set[str]:
    """Names that a module binds at its top level."""
    if path.is_dir():
        return set()
    table = symtable.symtable(path.read_text(encoding="utf-8"), str(path), "exec")
    own = {s.get_name() for s in table.get_symbols() if s.is_assigned() or s.is_imported() or s.is_namespace()}
    return own | {"__name__", "__file__", "__doc__", "__dict__"}


def has(module: str, name: str) -> bool:
    """Whether a module of this repository has such a name, or such a module below it."""
    path = place(module)
    return path is not None and (name in bound(path) or place(f"{module}.{name}") is not None)


def missing(source: str) -> Iterator[str]:
    """What a source imports from this repository, or asks of a module that it has imported, and is not there."""
    modules, others, asked = dict[str, str](), set[str](), list[tuple[ast.Attribute, str]]()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in (alias for alias in node.names if alias.name.split(".")[0] in OURS):
                if place(alias.name) is None:
                    yield f"{node.lineno}: {alias.name}"
                elif alias.asname or "." not in alias.name:
                    modules[alias.asname or alias.name] = alias.name
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in OURS:
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                if not has(node.module, alias.name):
                    yield f"{node.lineno}: {name}"
                elif place(name) is not None:
                    modules[alias.asname or alias.name] = name
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            asked.append((node, node.value.id))
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            others.add(node.id)  # a variable that may hide a module
        elif isinstance(node, ast.arg):
            others.add(node.arg)
    for node, name in asked:
        if name in modules and name not in others and not has(modules[name], node.attr):
            yield f"{node.lineno}: {modules[name]}.{node.attr}"


@pytest.mark.parametrize("folder", ["scripts", "tests/campaigns"])
def test_what_is_imported_is_there(folder: str) -> None:
    assert [
        f"{path.relative_to(ROOT)}:{found}"
        for path in sorted((ROOT / folder).rglob("*.py"))
        for found in missing(path.read_text(encoding="utf-8"))
    ] == []


@pytest.mark.parametrize(
    "source",
    [
        "from transopt.base.errors import InputErrors",
        "from transopt.base.error import InputError",
        "import transopt.base.nothing",
        "def f():\n    from common.command import nothing",
        "from transopt.base import errors\nerrors.InputErrors()",
        "import problems\nproblems.loads('walled')",
    ],
)
def test_what_is_not_there_is_seen(source: str) -> None:
    assert list(missing(source))


def test_what_is_there_or_of_others_is_not() -> None:
    source = "import numpy.nothing\nfrom transopt import base, solve\nfrom common import command\n"
    source += "import problems as p\np.load\nfrom transopt.base import errors\ndef f(errors): errors.nothing"
    assert list(missing(source)) == []
