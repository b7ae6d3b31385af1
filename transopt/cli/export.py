"""`transopt export`: a library in the formats of other programs."""

from pathlib import Path
from typing import Annotated

import typer


def export(
    library: Annotated[Path, typer.Argument(help="library.npz")],
    file: Annotated[Path, typer.Argument(help="What to write: .mat, .csv, .wav or .h")],
) -> None:
    """Write a library as MAT, CSV, WAV (to listen to) or a C header."""
    from transopt.library.export import export_library
    from transopt.library.file import load_library

    export_library(load_library(library), file)
    typer.echo(f"{file} written")
