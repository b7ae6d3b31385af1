"""Runs all named studies on the default scene and writes their findings.

    python scripts/findings.py --out DIR [--figures DIR] [--page PAGE.md]

It does the same as `transopt study --study all`, and writes the findings as a table of a page of results.
"""

from pathlib import Path
from typing import Annotated

from common.command import run
from common.page import PageFile, write_part
from typer import Option

import problems
from transopt.base.writing import table
from transopt.study import named
from transopt.study.executors import processes


def main(
    out: Annotated[Path, Option(help="folder for everything that is written")],
    figures: Annotated[Path | None, Option(help="folder for copies of the figures")] = None,
    page: PageFile = None,
) -> int:
    scene, found = problems.load("wood_on_foam"), []
    pool = processes(2)
    try:
        for name in named.OF_ONE_MOTOR:
            code, finding = named.write(name, scene, out, pool, search=[problems.FOLDER], figures=figures)
            print(f"{name}: {finding}", flush=True)
            found.append((name, code, finding))
    finally:
        pool.close()
    write_part(page, table(("study", "finding"), [(f"`{name}`", finding) for name, _, finding in found]))
    return max(code for _, code, _ in found)


if __name__ == "__main__":
    run(main)
