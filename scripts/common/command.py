"""How the scripts are called: a function's parameters are the options, and errors end in one line."""

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
    """An option that is a number from `least` on; `words` say what it is."""
    return typer.Option(min=least, help=words)


def run(script: Callable[..., int | None]) -> None:
    """Run a script: its docstring is the help, what it returns the exit code.

    An `InputError` is told in one line with exit code 2, as by every command of the project.
    """
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    # Lines stay as they are written: without the mark, paragraphs would be filled anew.
    words = (sys.modules[script.__module__].__doc__ or "").strip().split("\n\n")
    app.command(help="\n\n".join(f"\b\n{paragraph}" for paragraph in words))(script)
    terminal.run(app)


def write_json(value: Any, path: Path) -> None:
    """Write a JSON file whole or not at all.

    Raises
    ------
    InputError : the place cannot be written.
    """
    with whole_file(path) as file:
        file.write(json.dumps(value, indent=1).encode())
