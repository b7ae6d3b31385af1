"""`transopt show`: the table of a library, and its transients as a figure."""

from pathlib import Path
from typing import Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.cli.library_file import Unproven, opened


def show(
    library: Annotated[Path, typer.Argument(help="library.npz")],
    figure: Annotated[Path | None, typer.Option(help="Also draw the transients into this PNG.")] = None,
    unproven: Unproven = False,
) -> None:
    """Print a library's table; optionally draw its transients."""
    from transopt.report.tables import cool_summary, library_table

    loaded = opened(library, unproven=unproven)
    if figure is not None and figure.suffix.lower() != ".png":
        raise InputError(f"--figure {figure}: figures are written as .png")
    console = terminal.console()
    described = loaded.meta["scene"]["description"]
    console.print(library_table(loaded, f"{library}: {described}" if described else str(library)))
    if said := cool_summary(loaded):
        console.print(said, highlight=False, soft_wrap=True)
    if loaded.axes.targets:
        from transopt.report.trade import TRADE_LEGEND, trade_table

        console.print(trade_table(loaded, "pulse and ring"))
        console.print(TRADE_LEGEND, highlight=False)
    if figure is not None:
        from transopt.base.plotting import save_figure

        save_figure(loaded.plot(), figure)
        console.print(f"figure: {figure}", highlight=False)
