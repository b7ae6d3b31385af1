"""Runs the commands whose output a page of results shows, and writes their output to the page.

    python scripts/results.py docs/results/PAGE.md [--only WORD]

The output of a script that only prints is written between two marks, the first of which contains the whole command:

    <!-- output of: python scripts/NAME.py ... -->
    <!-- end -->

Pytest's progress and summary are left out, and a stamp is added below. A campaign of the tests writes the tables for
a page to a separate file, and they are copied to the page unchanged:

    <!-- tables of: python -m pytest -m long -n 0 tests/campaigns/test_NAME.py -->
    <!-- end -->

Scripts with the option `--page` write their tables themselves.
"""

import re
import shlex
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

from common.command import run
from common.page import END, ROOT, stamp
from typer import Argument, Option

from transopt.base.errors import InputError
from transopt.base.files import read_file
from transopt.base.sizes import MOST_TEXT_BYTES
from transopt.base.writing import write_text

PART = re.compile(rf"<!-- (output|tables) of: (python [^\n]+) -->\n.*?{END}", re.DOTALL)
OF_PYTEST = re.compile(r"^\.+ +\[100%\]$|^\d+ (?:passed|failed)\b.* in [\d.]+s\b.*$", re.MULTILINE)


def printed(command: str) -> tuple[str, int]:
    """What a command prints in the checkout, without control sequences, as a block; and its exit code."""
    _, *words = shlex.split(command)
    ended = subprocess.run([sys.executable, *words], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    output = OF_PYTEST.sub("", re.sub(r"\x1b\[[0-9;]*m", "", ended.stdout)).strip("\n")
    return f"```text\n{output}\n```", ended.returncode


def tables(command: str) -> tuple[str, int]:
    """The tables that a campaign writes for a page, and the exit code of its command.

    Raises
    ------
    InputError : it has written none.
    """
    _, *words = shlex.split(command)
    with TemporaryDirectory() as folder:
        part = Path(folder) / "part.md"
        asked = f"--campaign=--part {shlex.quote(str(part))}"
        code = subprocess.run([sys.executable, *words, asked], cwd=ROOT, check=False).returncode
        if not part.exists():
            raise InputError(f"{command}: has written no tables; its exit code is {code}")
        return read_file(part, MOST_TEXT_BYTES, "a part of a page").decode().strip("\n"), code


def main(
    page: Annotated[Path, Argument(help="page of docs/results")],
    only: Annotated[str, Option(help="commands with this word in them")] = "",
) -> int:
    text = read_file(page, MOST_TEXT_BYTES, "a page of docs/results").decode()
    worst = 0
    for kind, command in PART.findall(text):
        if only not in command:
            continue
        print(command, flush=True)
        made, code = (printed if kind == "output" else tables)(command)
        part = f"\n{made}\n\n{stamp(command)}\n\n"
        # Read anew: a command may take long, and somebody may have edited the page meanwhile.
        whole = read_file(page, MOST_TEXT_BYTES, "a page of docs/results").decode()
        mark = re.compile(rf"({re.escape(f'<!-- {kind} of: {command} -->')}\n).*?({END})", re.DOTALL)
        write_text(mark.sub(lambda found, part=part: found[1] + part + found[2], whole), page)
        worst = max(worst, abs(code))
    return min(worst, 1)


if __name__ == "__main__":
    run(main)
