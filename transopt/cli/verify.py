"""`transopt verify`: certificates and replays of a library, made again from its file."""

from pathlib import Path
from typing import Annotated

import typer

from transopt.base import terminal


def verify(library: Annotated[Path, typer.Argument(help="library.npz")]) -> None:
    """Certify and replay every entry again, from the file alone.

    Exit 1: an entry fails, or the file states of one what its arrays do not bear out.
    """
    import numpy as np

    from transopt.base.errors import InputError
    from transopt.design.verify import verify_library
    from transopt.library.file import BROKEN, load_library
    from transopt.library.statements import misstatements
    from transopt.report.tables import verify_table

    loaded = load_library(library)
    try:
        with terminal.progress() as bar:
            task = bar.add_task("entries", total=loaded.axes.entries * (1 if loaded.cool is None else 2))
            checks = verify_library(loaded, lambda done: bar.advance(task, done))
        with np.errstate(all="ignore"):  # what overflows is found as not finite, and said
            misstated = list(misstatements(loaded))
    except BROKEN:
        raise InputError(f"{library}: does not describe a problem; solve the scene again") from None
    console = terminal.console()
    first, cool = checks[: loaded.axes.entries], checks[loaded.axes.entries :]
    console.print(verify_table(first, str(library)))
    if cool:
        console.print(verify_table(cool, "cool commands, for a warm coil"))
    failed = sum(bool(check.shortfalls) for check in checks)
    for said in misstated:
        console.print(f"{library}: {said}", style="red")
    if loaded.claim:
        console.print(loaded.claim)
    console.print(f"{len(checks) - failed} of {len(checks)} entries certified and replayed clean")
    if failed or misstated:
        raise typer.Exit(1)
