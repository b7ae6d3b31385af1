"""`transopt taps`: what recordings hold, before anything is solved from them."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.cli.layout import COLUMNS_HELP, UNITS_HELP, RateHz, split_columns
from transopt.cli.scene import ACCEPT_HELP

FASTEST_M_S = 100.0  # of a tap, as in recordings
if TYPE_CHECKING:
    from pydantic import ValidationError

    from transopt.files.unclear import Answer
    from transopt.report.tried import Taps


def taps(
    files: Annotated[
        list[Path] | None, typer.Argument(help="Recordings: CSV, text, XLSX, ODS, MAT, NPZ, TDMS, LVM, HDF5, WAV.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the overlay figure.")] = None,
    columns: Annotated[str, typer.Option(help=COLUMNS_HELP)] = "",
    units: Annotated[str, typer.Option(help=UNITS_HELP)] = "",
    tap: Annotated[
        list[int] | None, typer.Option(help="Which tap of files with several, counted from 1; may be repeated.")
    ] = None,
    channel: Annotated[int | None, typer.Option(help="Channel of WAV files with several, counted from 1.")] = None,
    rate_Hz: RateHz = None,
    axis: Annotated[
        str,
        typer.Option(help="How axes become one: main (the tap's direction, the default), x, y, z, dft321 or all."),
    ] = "",
    speed: Annotated[float | None, typer.Option(help="Incoming speed where the files state none, in m/s.")] = None,
    speeds: Annotated[
        str, typer.Option(help="Speeds of the grid in m/s, 0.1,0.2,0.3; found in the taps if they are not stated.")
    ] = "",
    grip: Annotated[float | None, typer.Option(help="Grip force where the files state none, in N.")] = None,
    trusted_from_Hz: Annotated[
        float, typer.Option(help="Cut-off of the accelerometer in Hz, 0.5 to 5 of IEPE; 0 if it reads gravity.")
    ] = 0.0,
    full_scale: Annotated[float | None, typer.Option(help="Acceleration of WAV full scale, in m/s^2.")] = None,
    time_scale: Annotated[float, typer.Option(help="Similarity: time is stretched by this.")] = 1.0,
    amplitude_scale: Annotated[float, typer.Option(help="Similarity: acceleration is multiplied by this.")] = 1.0,
    scene: Annotated[
        Path | None,
        typer.Option(metavar="FILE.toml", help="Write a scene of these recordings and the built-in device."),
    ] = None,
    template: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Write a recording to fill in, with its remarks and an invented tap."),
    ] = None,
    accept: Annotated[bool, typer.Option("--accept", help=ACCEPT_HELP)] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Write over the file of --scene or --template if it is there.")
    ] = False,
) -> None:
    """Look at recordings before solving: rate, onset, offset, polarity, speed, grip, peak, clipping.

    Exit 2: a recording cannot be a tap in the units that are stated; the line says which to check, and --accept
    takes it as it is.
    """
    from transopt.cli.scene import write_new

    if template is not None:
        if files:
            raise InputError(f"--template {template}: writes a new file and reads none; leave {files[0]} out")
        _write_template(template, force=force)
        return
    if not files:
        raise InputError("no recording named: name files, or write one to fill in by --template tap.csv")
    from pydantic import ValidationError

    from transopt.cli.questions import answered
    from transopt.files.names import stated_units
    from transopt.files.unclear import joined
    from transopt.recordings.recording import VOCABULARY
    from transopt.recordings.settings import Recordings
    from transopt.recordings.speed import UNKNOWN
    from transopt.report import taps as report
    from transopt.report import tried
    from transopt.scene.builtin import scene_path

    stated = {
        "files": [str(file.absolute()) for file in files],
        "columns": split_columns(columns),
        "units": stated_units(units),
        "channel": channel,
        "rate_Hz": rate_Hz,
        "axis": axis or None,
        "taps_by_file": {"*": tap} if tap else {},
        "speed_m_s": speed,
        "grip_N": grip,
        "trusted_from_Hz": trusted_from_Hz,
        "full_scale_m_s2": full_scale,
        "time_scale": time_scale,
        "amplitude_scale": amplitude_scale,
        "implausible": "accept" if accept else "refuse",
    }

    def read(answer: "Answer") -> "Taps":
        try:
            settings = Recordings(**joined(stated, answer))
        except ValidationError as error:
            raise InputError(_refusal(error)) from None
        return tried.prepared(settings)

    found = answered(read, VOCABULARY, tried.summary, tried.doubt, tried.oddness, units)
    prepared, settings = found
    console = terminal.console()
    console.print(report.taps_table(prepared))
    for note in report.shared_notes(prepared):
        console.print(f"of all {len(prepared)}: {note}")
    grid = report.grid_of(prepared, settings, _speeds(speeds))
    cells = report.cells_table(prepared, grid)
    if cells is not None:
        console.print(cells)
    if len(prepared) > len(grid.speeds_m_s) > 0 and not speeds:
        console.print("speeds found in the taps: state others by --speeds, or edit speeds_m_s in [grid] of the scene")
    for hint in report.hints(prepared, settings):
        console.print(hint, style="yellow")
    if out is not None:
        from transopt.base.plotting import save_figure
        from transopt.report.figures import taps_figure

        terminal.make_folder(out)
        save_figure(taps_figure(prepared), out / "taps.png")
        console.print(f"overlay: {out / 'taps.png'}")
    refusal = tried.refusal(found, read)
    for line in report.implausible_lines(prepared):
        if line not in str(refusal):  # which is said last
            console.print(line, style="red")
    if refusal is not None and any(tap.speed_source == UNKNOWN for tap in prepared):
        raise refusal  # a scene needs a speed
    if scene is not None:
        text = scene_path("own_taps").read_text(encoding="utf-8")
        write_new(scene, report.scene_of_taps(text, grid, files, settings, scene.parent), force=force)
        after = f"next: transopt solve {shlex.quote(str(scene))}"
        if refusal is not None:
            after = "solve refuses it until that is put right or accepted (--accept)"
        typer.echo(f"{scene} written; {after}")
    else:
        console.print("\nLines for your scene, which this command begins:", style="bold")
        console.print("transopt scene new mine.toml --from own_taps\n")
        typer.echo(report.scene_lines(grid, files, settings))
    if refusal is not None:
        raise refusal


def _speeds(text: str) -> list[float]:
    """The speeds of `--speeds` [m/s]."""
    found = list[float]()
    for each in filter(None, map(str.strip, text.split(","))):
        try:
            found.append(float(each))
        except ValueError:
            found.append(0.0)
        if not 0 < found[-1] <= FASTEST_M_S:
            raise InputError(
                f"--speeds {text}: {each!r}: must be above 0 and at most {FASTEST_M_S:g} m/s, as 0.1,0.2"
            )
    return found


def _write_template(file: Path, *, force: bool) -> None:
    """Write a recording to fill in."""
    from transopt.cli.scene import write_new
    from transopt.report.taps import template

    write_new(file, template(), force=force, ending=".csv")
    typer.echo(f"{file} written; put your tap in it, then: transopt taps {shlex.quote(str(file))}")


def _refusal(error: "ValidationError") -> str:
    """One line: the option, its value, and what it must be."""
    from transopt.files.unclear import option_of

    first = error.errors()[0]
    return f"{option_of(str(first['loc'][0]))} {first['input']}: {first['msg'].replace('Input should be', 'must be')}"
