"""`transopt verify`: certificates and replays of a library, made again from its file."""

from pathlib import Path
from typing import Annotated

import typer

from transopt.base import terminal


def verify(library: Annotated[Path, typer.Argument(help="library.npz")]) -> None:
    """Certify and replay every entry again, from the file alone; exit 1 if one fails."""
    from transopt.design.verify import verify_library
    from transopt.library.file import load_library
    from transopt.report.tables import verify_table

    checks = verify_library(load_library(library))
    console = terminal.console()
    console.print(verify_table(checks, str(library)))
    failed = sum(bool(check.shortfalls) for check in checks)
    console.print(f"{len(checks) - failed} of {len(checks)} entries certified and replayed clean", highlight=False)
    if failed:
        raise typer.Exit(1)
