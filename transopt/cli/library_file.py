"""The library that a command is given: proven before anything of it is used, unless an option says otherwise."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from transopt.library.library import Library

Unproven = Annotated[
    bool,
    typer.Option("--unproven", help="Believe the file: do not make its certificates again before it is used."),
]


def opened(path: Path, *, unproven: bool) -> "Library":
    """The library of a file.

    Raises
    ------
    InputError : it cannot be read, or is not proven.
    """
    if unproven:
        from transopt.library.file import load_library

        typer.echo("not proven: what follows is as the file states it (--unproven)", err=True)
        return load_library(path)
    from transopt.library.proven import load_proven

    return load_proven(path)
