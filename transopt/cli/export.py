"""`transopt export`: a library in the formats of other programs, and its drive waveforms for a driver."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.cli.library_file import Unproven, opened

RATE, BITS, FULL_SCALE, TARGET, SPEED, GRIP = "--rate-Hz", "--bits", "--full-scale", "--target", "--speed", "--grip"


def export(
    library: Annotated[Path, typer.Argument(help="library.npz")],
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
    for said in (TRADE_LEGEND, *drive_remarks(loaded, left)):
        console.print(said)
    for written in files:
        typer.echo(f"{terminal.harmless(str(written))} written")
    if any(each.limits_left for each in left):
        raise typer.Exit(1)
