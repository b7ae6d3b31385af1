"""Writes the generated part of a page of results, between two marks, with a stamp below it.

    <!-- written by scripts/NAME.py -->
    ...
    <!-- end -->

The text around the marks is written by hand. The stamp states date, machine and command of the figures. Scripts whose
figures change with every run also write their answer into the row of index.md that links to the page.
"""

import platform
import re
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from transopt.base.errors import InputError
from transopt.base.files import read_file
from transopt.base.machine import machine
from transopt.base.sizes import MOST_TEXT_BYTES
from transopt.base.writing import write_text

ROOT = Path(__file__).parents[2]
MEASURED = (
    "transopt",
    "controller",
    "problems",
    "scripts",
    "tests",
)  # whose changes since the commit the stamp tells
END = "<!-- end -->"
PageFile = Annotated[
    Path | None, typer.Option("--page", metavar="PAGE.md", help="page of results whose marked part is written anew")
]


def begin(script: str) -> str:
    """The mark before the part of a script."""
    return f"<!-- written by scripts/{script} -->"


def _git(*words: str) -> str:
    try:
        ended = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return ended.stdout.strip()


def commit() -> str:
    """The checked-out commit, and whether measured code has uncommitted changes; without git the version."""
    found = _git("rev-parse", "--short", "HEAD")
    changed = _git("status", "--porcelain", "--", *MEASURED)
    return f"commit {found}{', with changes' if changed else ''}" if found else "of no commit"


COMMIT = commit()  # determined at the start, when the measured code is imported


def stamp(command: str) -> str:
    """One line: command, date, processor, cores, Python, commit."""
    here = machine()
    return (
        f"*`{command}`, {datetime.now(UTC):%Y-%m-%d}, {here['cpu']}, "
        f"{here['cores']} cores, Python {platform.python_version()}, {COMMIT}.*"
    )


def called() -> str:
    """The command line of the running script, without the paths of page and results."""
    said = sys.argv[1:]
    words = [word for word, before in zip(said, ["", *said], strict=False) if "--page" not in (word, before)]
    words = ["DIR" if Path(word).is_absolute() else word for word in words]
    return " ".join(["python", f"scripts/{Path(sys.argv[0]).name}", *words])


def write_part(page: Path | None, lines: Sequence[str]) -> None:
    """Write lines and a stamp between the marks of the running script; nothing without a page.

    Raises
    ------
    InputError : the page cannot be read or written, or has no marks of this script.
    """
    if page is None:
        return
    script = Path(sys.argv[0]).name
    text = read_file(page, MOST_TEXT_BYTES, "a page of docs/results").decode()
    marks = re.compile(f"({re.escape(begin(script))}\n).*?({END})", re.DOTALL)
    if not marks.search(text):
        raise InputError(f"{page}: no part of this script; mark one by two lines: {begin(script)} and {END}")
    part = "\n" + "\n".join(lines).strip() + f"\n\n{stamp(called())}\n\n"
    write_text(marks.sub(lambda found: found[1] + part + found[2], text), page)


def write_answer(page: Path | None, answer: str) -> None:
    """Write the answer into the row of index.md, beside the page, that links to the page; nothing without a page.

    Raises
    ------
    InputError : index.md cannot be read or written, or has no such row.
    """
    if page is None:
        return
    index = page.parent / "index.md"
    text = read_file(index, MOST_TEXT_BYTES, "write to a page of docs/results").decode()
    link = rf"\[{re.escape(page.stem)}\]\({re.escape(page.name)}\)"
    row = re.compile(rf"^(\|[^|\n]*\| )[^|\n]*( \| {link} \|)$", re.MULTILINE)
    if not row.search(text):
        raise InputError(f"{index}: no row for {page.name}: add | question | answer | [{page.stem}]({page.name}) |")
    write_text(row.sub(lambda found: found[1] + answer + found[2], text), index)
