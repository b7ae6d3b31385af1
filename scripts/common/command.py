"""Command-line interface of the scripts: a function's parameters are the options, and errors end in one line."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from transopt.base import terminal
from transopt.base.files import whole_file

LibraryFile = Annotated[Path, typer.Argument(help="library.npz")]
Seed = Annotated[int, typer.Option(min=0, help="another seed, other random numbers")]
JsonFile = Annotated[Path | None, typer.Option("--json", help="also write the figures here")]


def at_least(least: float, words: str = "") -> Any:
    """An option that is a number of at least `least`; `words` is its help."""
    return typer.Option(min=least, help=words)


def run(script: Callable[..., int | None]) -> None:
    """Run a script: its docstring is the help, its return value the exit code.

    An `InputError` ends in one line with exit code 2, as in every command of the project.
    """
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    # The mark keeps the line breaks of the docstring; otherwise paragraphs would be refilled.
    words = (sys.modules[script.__module__].__doc__ or "").strip().split("\n\n")
    app.command(help="\n\n".join(f"\b\n{paragraph}" for paragraph in words))(script)
    terminal.run(app)


def write_json(value: Any, path: Path) -> None:
    """Write a JSON file whole or not at all.

    Raises
    ------
    InputError : the path cannot be written.
    """
    with whole_file(path) as file:
        file.write(json.dumps(value, indent=1).encode())
