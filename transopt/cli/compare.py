"""`transopt compare`: two libraries side by side."""

from pathlib import Path
from typing import Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError


def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="library.npz")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another library.npz.")],
    out: Annotated[Path | None, typer.Option(help="Also write the comparison into this Markdown file.")] = None,
) -> None:
    """Compare two libraries: entries, their figures from A to B, and what was stated differently."""
    from transopt.library.file import load_library
    from transopt.report.comparison import (
        Comparison,
        change_table,
        comparison_markdown,
        comparison_summary,
        entry_table,
    )

    if out is not None and out.suffix.lower() != ".md":
        raise InputError(f"--out {out}: a comparison is written as .md")
    found = Comparison.of(load_library(first), load_library(second))
    names = f"A: {first}, B: {second}"
    console = terminal.console()
    console.print(entry_table(found, names))
    if found.changes:
        console.print(change_table(found))
    if out is not None:
        from transopt.base.writing import write_text

        write_text(comparison_markdown(found, names), out)
        console.print(f"{out} written")
    console.print(comparison_summary(found))
