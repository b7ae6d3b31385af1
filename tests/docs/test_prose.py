"""Docstrings, comments and help texts stand alone: none begins with a word that leans on the name above it."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("transopt", "problems", "controller", "scripts", "tests")
OPENER = re.compile(r"(Of|That|Those|With|Where|By|As|None|Its|The same)\b")
# A look that takes a fiftieth of the time of taking a file apart, and leaves few files to be taken apart.
OPENING = re.compile(rf"""(["'][\\n\s]*|#[#: ]*){OPENER.pattern}""")
TEXT_KEYWORDS = ("help", "description")

Place = tuple[int, str]


def docstrings(nodes: list[ast.AST]) -> Iterator[Place]:
    for node in nodes:
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                yield node.body[0].lineno, text


def attribute_docstrings(nodes: list[ast.AST]) -> Iterator[Place]:
    """Strings below an assignment, which document the name that it binds."""
    for node in nodes:
        body = getattr(node, "body", None)
        for before, after in pairwise(body) if isinstance(body, list) else ():
            if (
                isinstance(before, ast.Assign | ast.AnnAssign)
                and isinstance(after, ast.Expr)
                and isinstance(after.value, ast.Constant)
                and isinstance(after.value.value, str)
            ):
                yield after.lineno, after.value.value.strip()


def opening(node: ast.expr) -> str:
    """The literal text that a help text begins with; empty where it begins with a computed value."""
    if isinstance(node, ast.JoinedStr) and node.values:
        return opening(node.values[0])
    if isinstance(node, ast.BinOp):
        return opening(node.left)
    return node.value.strip() if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def help_texts(nodes: list[ast.AST]) -> Iterator[Place]:
    for node in nodes:
        if isinstance(node, ast.Call):
            for keyword in node.keywords:
                if keyword.arg in TEXT_KEYWORDS:
                    yield keyword.value.lineno, opening(keyword.value)


def comments(source: str) -> Iterator[Place]:
    """The first line of every comment block; a comment after code is a block of its own."""
    last = -1
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT:
            continue
        row, column = token.start
        alone = not token.line[:column].strip()
        if not alone or row != last + 1:
            yield row, token.string.lstrip("#: ")
        last = row if alone else -1


def openers(source: str) -> list[Place]:
    if not OPENING.search(source):
        return []
    nodes = list(ast.walk(ast.parse(source)))
    found = (*docstrings(nodes), *attribute_docstrings(nodes), *help_texts(nodes), *comments(source))
    return sorted((line, text.splitlines()[0]) for line, text in found if OPENER.match(text))


def all_openers() -> list[str]:
    return [
        f"{path.relative_to(ROOT)}:{line}: {text}"
        for room in ROOMS
        for path in sorted((ROOT / room).rglob("*.py"))
        for line, text in openers(path.read_text(encoding="utf-8"))
    ]


def test_every_kind_of_text_is_seen():
    source = '"""Of x."""\nA = 1\n"""Its unit."""\n# The same again\n# As before\nf(help="By " + b)  # Where\n'
    source += 'g(description=f"None {b}")\n'
    assert [line for line, _ in openers(source)] == [1, 3, 4, 6, 6, 7]


def test_words_that_only_begin_alike_are_no_openers():
    assert openers('"""Offset of x."""\n# Asked, within bounds\n# A block\n# of lines. That goes on\n') == []


def test_no_text_leans_on_the_name_above_it():
    found = all_openers()
    assert found == [], "\n".join((f"{len(found)} texts lean on the name above them:", *found))


if __name__ == "__main__":
    print("\n".join(all_openers()))
