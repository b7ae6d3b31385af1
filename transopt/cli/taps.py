"""`transopt taps`: what recordings hold, before anything is solved from them."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from pydantic import ValidationError

OPTIONS = {"speed_m_s": "speed", "full_scale_m_s2": "full-scale"}  # where the option's name is not the setting's


def taps(
    files: Annotated[list[Path], typer.Argument(help="Recordings: CSV, TXT, MAT, NPZ, WAV.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the overlay figure.")] = None,
    columns: Annotated[str, typer.Option(help="Column names of TXT files: time_s,acceleration_g")] = "",
    speed: Annotated[float | None, typer.Option(help="Incoming speed where the files state none, in m/s.")] = None,
    full_scale: Annotated[float | None, typer.Option(help="Acceleration of WAV full scale, in m/s^2.")] = None,
    time_scale: Annotated[float, typer.Option(help="Similarity: time is stretched by this.")] = 1.0,
    amplitude_scale: Annotated[float, typer.Option(help="Similarity: acceleration is multiplied by this.")] = 1.0,
    scene: Annotated[
        Path | None,
        typer.Option(metavar="FILE.toml", help="Write a scene of these recordings and the built-in device."),
    ] = None,
) -> None:
    """Look at recordings before solving: rate, onset, offset, polarity, speed, peak, clipping."""
    from pydantic import ValidationError

    from transopt.cli.scene import write_new
    from transopt.recordings.settings import Recordings
    from transopt.recordings.tap import prepare, read_recordings
    from transopt.report.taps import scene_lines, scene_of_taps, taps_table
    from transopt.scene.builtin import scene_path

    try:
        settings = Recordings(
            files=[str(file.absolute()) for file in files],
            columns=[name.strip() for name in columns.split(",") if name.strip()],
            speed_m_s=speed,
            full_scale_m_s2=full_scale,
            time_scale=time_scale,
            amplitude_scale=amplitude_scale,
        )
    except ValidationError as error:
        raise InputError(_refusal(error)) from None
    prepared = [prepare(recording, settings) for recording in read_recordings(settings)]
    console = terminal.console()
    console.print(taps_table(prepared))
    if out is not None:
        from transopt.base.plotting import save_figure
        from transopt.report.figures import taps_figure

        terminal.make_folder(out)
        save_figure(taps_figure(prepared), out / "taps.png")
        console.print(f"overlay: {out / 'taps.png'}")
    if scene is not None:
        template = scene_path("own_taps").read_text(encoding="utf-8")
        write_new(scene, scene_of_taps(template, prepared, files, settings, scene.parent))
        typer.echo(f"{scene} written; next: transopt solve {shlex.quote(str(scene))}")
        return
    console.print("\nLines for your scene (transopt scene new mine.toml --from own_taps):\n", style="bold")
    typer.echo(scene_lines(prepared, files, settings))


def _refusal(error: "ValidationError") -> str:
    """One line: the option, its value, and what it must be."""
    first = error.errors()[0]
    setting = str(first["loc"][0])
    option = OPTIONS.get(setting, setting).replace("_", "-")
    return f"--{option} {first['input']}: {first['msg'].replace('Input should be', 'must be')}"
