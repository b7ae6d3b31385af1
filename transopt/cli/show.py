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
    table: Annotated[bool, typer.Option("--table", help="Also print every entry with all its figures.")] = False,
    report: Annotated[bool, typer.Option("--report", help="Also print the certificates.")] = False,
    unproven: Unproven = False,
) -> None:
    """Print a first look at a library, in detail with --table; optionally draw its transients."""
    from transopt.report.first import Look, lines, next_commands
    from transopt.report.tables import certificate_table, cool_summary, entry_table

    loaded = opened(library, unproven=unproven)
    if figure is not None and figure.suffix.lower() != ".png":
        raise InputError(f"--figure {figure}: figures are written as .png")
    console = terminal.console()

    def line(text: str, style: str | None = None) -> None:
        console.print(text, style=style)

    if table:
        described = loaded.meta["scene"]["description"]
        shown, meaning = entry_table(loaded, f"{library}: {described}" if described else str(library))
        console.print(shown)
        line(meaning, "dim")
        if loaded.axes.targets:
            from transopt.report.trade import TRADE_LEGEND, trade_table

            console.print(trade_table(loaded, "pulse and ring"))
            line(TRADE_LEGEND)
    if report:
        console.print(certificate_table(loaded, str(library)))
    for said, colour in lines(
        None if unproven else loaded, Look.of_library(loaded, proven=not unproven), console.width
    ):
        line(said, colour)
    if said := cool_summary(loaded):
        line(said)
    line("Next:")
    for command in next_commands(library, loaded.scene())[table:]:  # the first is this one
        line(f"  {command}")
    if figure is not None:
        from transopt.base.plotting import save_figure

        save_figure(loaded.plot(), figure, loaded.scene().name)
        console.print(f"figure: {figure}")
