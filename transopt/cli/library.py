"""Commands on the file of a library: `transopt verify`, `show`, `compare` and `export`."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from transopt.library.library import Library

LibraryFile = Annotated[Path, typer.Argument(help="library.npz")]
Unproven = Annotated[
    bool,
    typer.Option("--unproven", help="Believe the file: do not make its certificates again before it is used."),
]
RATE, BITS, FULL_SCALE, TARGET, SPEED, GRIP = "--rate-Hz", "--bits", "--full-scale", "--target", "--speed", "--grip"


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


def verify(library: LibraryFile) -> None:
    """Certify and replay every entry again, from the file alone.

    Exit 1: an entry fails, or the file states of one what its arrays do not bear out.
    """
    import numpy as np

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
    for misstatement in misstated:
        console.print(f"{library}: {misstatement}", style="red")
    if loaded.claim:
        console.print(loaded.claim)
    console.print(f"{len(checks) - failed} of {len(checks)} entries certified and replayed clean")
    if failed or misstated:
        raise typer.Exit(1)


def show(
    library: LibraryFile,
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
    for text, colour in lines(
        None if unproven else loaded, Look.of_library(loaded, proven=not unproven), console.width
    ):
        line(text, colour)
    if text := cool_summary(loaded):
        line(text)
    line("Next:")
    for command in next_commands(library, loaded.scene())[table:]:  # the first is this one
        line(f"  {command}")
    if figure is not None:
        from transopt.base.plotting import save_figure

        save_figure(loaded.plot(), figure, loaded.scene().name)
        console.print(f"figure: {figure}")


def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="library.npz")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another library.npz.")],
    out: Annotated[Path | None, typer.Option(help="Also write the comparison into this Markdown file.")] = None,
) -> None:
    """Compare two libraries: entries, their figures from A to B, and what was stated differently."""
    from transopt.library.file import load_library
    from transopt.report import comparison

    if out is not None and out.suffix.lower() != ".md":
        raise InputError(f"--out {out}: a comparison is written as .md")
    found = comparison.Comparison.of(load_library(first), load_library(second))
    names = f"A: {first}, B: {second}"
    console = terminal.console()
    console.print(comparison.entry_table(found, names))
    if found.changes:
        console.print(comparison.change_table(found))
    if out is not None:
        from transopt.base.writing import write_text

        write_text(comparison.comparison_markdown(found, names), out)
        console.print(f"{out} written")
    console.print(comparison.comparison_summary(found))


def export(
    library: LibraryFile,
    file: Annotated[
        Path, typer.Argument(help="What to write: .mat, .csv, .wav or .h; with --drive also .npz or .bin")
    ],
    drive: Annotated[
        bool, typer.Option("--drive", help="Write the commands for a driver, and play them as they leave.")
    ] = False,
    rate_Hz: Annotated[
        float | None, typer.Option(RATE, help="Samples per second of the driver; without it those of the design.")
    ] = None,
    bits: Annotated[
        str | None, typer.Option(BITS, help="8, 16 (without it), 24, 32 or float; .h has 8 and 16.")
    ] = None,
    full_scale: Annotated[
        float | None,
        typer.Option(FULL_SCALE, help="Output at the largest count, in V or A; without it the range of the command."),
    ] = None,
    target: Annotated[str | None, typer.Option(TARGET, help="Only the target of this name.")] = None,
    speed: Annotated[float | None, typer.Option(SPEED, help="Only this speed of the grid, in m/s.")] = None,
    grip: Annotated[float | None, typer.Option(GRIP, help="Only this grip of the grid, in N.")] = None,
    unproven: Unproven = False,
) -> None:
    """Write a library as MAT, CSV, WAV (to listen to) or a C header; or its commands for a driver (--drive).

    Exit 1: as an entry leaves, it is beyond a limit of its scene by over 0.1 %; the files are written all the same.
    """
    asked = {RATE: rate_Hz, BITS: bits, FULL_SCALE: full_scale, TARGET: target, SPEED: speed, GRIP: grip}
    if not drive:
        from transopt.library.export import export_library, sounds

        for option, value in asked.items():
            if value is not None:
                raise InputError(f"{option}: only for the commands of a driver; add --drive")
        loaded = opened(library, unproven=unproven)
        export_library(loaded, file)
        typer.echo(f"{terminal.harmless(str(file))} written")
        if file.suffix.lower() == ".wav":
            terminal.console().print(sounds(loaded))
            if loaded.driven_by.unit == "V":
                command = shlex.join(["transopt", "export", str(library), f"{file.stem}_drive.wav", "--drive"])
                typer.echo(f"no driver plays these sounds: for the volts, {terminal.harmless(command)}")
        return
    from transopt.library.drive_files import export_drive
    from transopt.report.trade import TRADE_LEGEND, drive_remarks, drive_table

    loaded = opened(library, unproven=unproven)
    files, left = export_drive(
        loaded,
        file,
        rate_Hz=rate_Hz,
        bits="16" if bits is None else bits,
        full_scale=full_scale,
        target=target,
        speed_m_s=speed,
        grip_N=grip,
    )
    console = terminal.console()
    console.print(drive_table(loaded, left))
    for remark in (TRADE_LEGEND, *drive_remarks(loaded, left)):
        console.print(remark)
    for written in files:
        typer.echo(f"{terminal.harmless(str(written))} written")
    if any(each.limits_left for each in left):
        raise typer.Exit(1)
