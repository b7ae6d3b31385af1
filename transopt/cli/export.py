"""`transopt export`: a library in the formats of other programs."""

from pathlib import Path
from typing import Annotated

import typer

from transopt.base import terminal
from transopt.cli.library_file import Unproven, opened


def export(
    library: Annotated[Path, typer.Argument(help="library.npz")],
    file: Annotated[Path, typer.Argument(help="What to write: .mat, .csv, .wav or .h")],
    unproven: Unproven = False,
) -> None:
    """Write a library as MAT, CSV, WAV (to listen to) or a C header."""
    from transopt.library.export import export_library

    export_library(opened(library, unproven=unproven), file)
    typer.echo(f"{terminal.harmless(str(file))} written")
