"""Ties between packages that no import shows: a module or a folder of another package, named in a string."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("transopt", "controller", "problems")
# The firmware is C: nothing can import it, and whoever reads it does so by its path.
NAMED = (*PACKAGES, "firmware")
BEGUN = re.compile(rf"""["'}}]({"|".join(NAMED)})\b""")  # a string, or what goes on behind a value in one
TIES = {
    # Entry points stand outside the package that they start, so that a file of its name is found and refused.
    ("transopt/cli/start.py", "controller.cli.play"),
    ("transopt/cli/start.py", "controller.cli.device"),
    # The built-in scenes are data, found by their place beside this package.
    ("transopt/scene/builtin.py", "problems"),
    # The C header is written from the messages of the protocol, and a test compares the two.
    ("controller/protocol/c_header.py", "firmware"),
}
# Folders of a user's own, in which the programs keep what they have compiled and measured.
FOLDERS = {
    ("controller/firmware/build.py", "firmware"),
    ("controller/firmware/build.py", "transopt"),
    ("controller/host/kept.py", "transopt"),
}


def strings(program: str, package: str) -> Iterator[str]:
    """The strings in a package's program that begin with the name of another one; docstrings do not count."""
    if not BEGUN.search(program):  # which takes far less time than to take it apart
        return
    tree = ast.parse(program)
    said = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in said:
            first = node.value.replace("/", ".").partition(".")[0]
            if first in NAMED and first != package:
                yield node.value


def test_every_tie_by_a_string_is_stated() -> None:
    found = {
        (path.relative_to(ROOT).as_posix(), text)
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        for text in strings(path.read_text(encoding="utf-8"), package)
    }
    assert found == TIES | FOLDERS


@pytest.mark.parametrize("line", ["load('problems.stress')", "Path('firmware') / 'src'", "open(f'controller/{x}')"])
def test_another_tie_would_be_found(line: str) -> None:
    assert list(strings(f"'''problems'''\n{line}\n", "transopt")) != []
    assert list(strings("'''controller'''\nname, own = 'controllers', 'transopt.cli'\n", "transopt")) == []
