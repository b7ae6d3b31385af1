"""The solve-library command line: scene, taps, identify, solve, verify, show, export (DESIGN 10).

Exit codes: 0 done, 1 a result fell short, 2 bad input. Heavy imports stand inside the commands, so that help and
errors come at once.
"""

import shlex
import sys
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from transopt.base import console as terminal
from transopt.base.errors import InputError
from transopt.cli.identify import app as identify

if TYPE_CHECKING:
    from transopt.recordings.recording import Recording
    from transopt.scene.scene import Scene

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Motor-current transients that make a virtual surface feel as hard as the real one.",
)
scenes = typer.Typer(no_args_is_help=True, help="Built-in scenes: list, show, copy.")
app.add_typer(scenes, name="scene")
app.add_typer(identify, name="identify")

DEFAULT_SCENE = "wood_on_foam"


def _load(scene: str, recordings: Path | None) -> "Scene":
    """A scene by built-in name or by path, with the recordings folder replaced if one is given."""
    import problems

    loaded = problems.load(scene)
    if recordings is None:
        return loaded
    if not recordings.is_dir():
        raise InputError(f"--recordings {recordings}: no such folder")
    settings = loaded.recordings.model_copy(update={"folder": str(recordings.resolve())})
    return loaded.model_copy(update={"recordings": settings})


def _recordings(scene: "Scene") -> "list[Recording]":
    if scene.recordings.simulated is not None:
        from transopt.scene.strikes import recordings

        return recordings(scene)
    from transopt.recordings.tap import read_recordings

    return read_recordings(scene.recordings)


@scenes.command("list")
def scene_list() -> None:
    """Name the built-in scenes and what each shows."""
    import tomllib

    import problems

    for name in problems.scene_names():
        text = problems.scene_path(name).read_text(encoding="utf-8")
        typer.echo(f"{name:20} {tomllib.loads(text)['description']}")


@scenes.command("show")
def scene_show(name: str) -> None:
    """Print a built-in scene, comments included."""
    import problems

    typer.echo(problems.scene_path(name).read_text(encoding="utf-8"), nl=False)


@scenes.command("new")
def scene_new(
    file: Path, source: Annotated[str, typer.Option("--from", help="Built-in scene to copy.")] = DEFAULT_SCENE
) -> None:
    """Copy a built-in scene to a file of your own, to be changed and solved by its path."""
    import problems

    if file.suffix != ".toml":
        raise InputError(f"{file}: a scene file ends in .toml")
    # Relative paths of a scene count from its own folder, those of a copy from that of the copy.
    text = problems.scene_path(source).read_text(encoding="utf-8").replace('"../', '"')
    try:
        with file.open("x", encoding="utf-8") as new:
            new.write(text)
    except FileExistsError:
        raise InputError(f"{file}: exists already; choose another name") from None
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror}); choose another place") from None
    typer.echo(f"{file} written; edit it, then: transopt solve {shlex.quote(str(file))}")


@app.callback(invoke_without_command=True)
def version(show: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    """Motor-current transients that make a virtual surface feel as hard as the real one."""
    if show:
        from importlib import metadata

        typer.echo(metadata.version("transopt"))
        raise typer.Exit


@app.command()
def taps(
    files: Annotated[list[Path], typer.Argument(help="Recordings: CSV, TXT, MAT, NPZ, WAV.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the overlay figure.")] = None,
    columns: Annotated[str, typer.Option(help="Column names of TXT files: time_s,acceleration_g")] = "",
    speed: Annotated[float | None, typer.Option(help="Incoming speed where the files state none, in m/s.")] = None,
    full_scale: Annotated[float | None, typer.Option(help="Acceleration of WAV full scale, in m/s^2.")] = None,
    time_scale: Annotated[float, typer.Option(help="Similarity: time is stretched by this.")] = 1.0,
    amplitude_scale: Annotated[float, typer.Option(help="Similarity: acceleration is multiplied by this.")] = 1.0,
) -> None:
    """Look at recordings before solving: rate, onset, offset, polarity, speed, peak, clipping."""
    from pydantic import ValidationError

    from transopt.recordings.settings import Recordings
    from transopt.recordings.tap import prepare, read_recordings
    from transopt.report.taps import scene_lines, taps_table

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
        first = error.errors()[0]
        option = {"speed_m_s": "speed", "full_scale_m_s2": "full-scale"}.get(
            str(first["loc"][0]), str(first["loc"][0])
        )
        message = first["msg"].replace("Input should be", "must be")
        raise InputError(f"--{option.replace('_', '-')} {first['input']}: {message}") from None
    prepared = [prepare(recording, settings) for recording in read_recordings(settings)]
    console = terminal.console()
    console.print(taps_table(prepared))
    if out is not None:
        from transopt.base.plotting import save_figure
        from transopt.report.figures import taps_figure

        terminal.make_folder(out)
        save_figure(taps_figure(prepared), out / "taps.png")
        console.print(f"overlay: {out / 'taps.png'}")
    console.print("\nLines for your scene (transopt scene new mine.toml --from own_taps):\n", style="bold")
    typer.echo(scene_lines(prepared, files, settings))


@app.command()
def solve(
    scene: Annotated[str, typer.Argument(help="Built-in name or path of a .toml file.")] = DEFAULT_SCENE,
    out: Annotated[Path | None, typer.Option(help="Folder for the results; default out/SCENE.")] = None,
    recordings: Annotated[Path | None, typer.Option(help="Folder of the scene's recordings.")] = None,
    jobs: Annotated[int, typer.Option(help="Processes; the grips are shared among them.")] = 1,
    solver: Annotated[
        str | None,
        typer.Option(help="riccati, the default where it is built, casadi-piqp or casadi-ipopt."),
    ] = None,
    solver_tolerance: Annotated[float, typer.Option(help="On residuals and gap, scaled; 1e-10 is usual.")] = 1e-10,
    grid_tolerance: Annotated[
        float | None,
        typer.Option(help="Add nodes until a blend between them is this close to the optimum; 0.02: 2 %."),
    ] = None,
    grid_cap: Annotated[int, typer.Option(help="Most entries that --grid-tolerance may lead to.")] = 400,
    figures: Annotated[bool, typer.Option(help="Draw transients, methods and Bode plots into the folder.")] = True,
) -> None:
    """Solve a scene: certified library of current transients, report, figures; the last line sums up."""
    from transopt.base import workers

    if jobs > 1:
        drawing = ("transopt.report.publish", "transopt.report.figures") if figures else ()
        workers.context((*workers.DESIGNING, "transopt.cli.main", *drawing))
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from transopt.design.build import build_library
    from transopt.design.refine_grid import check_tolerance, refine_grid
    from transopt.report.identified import model_warning
    from transopt.report.publish import LEFTOVERS, files_of, publishing
    from transopt.report.tables import LEGEND, aftermath, build_table, refinement_summary, refusal, summary
    from transopt.solvers.choose import check_name
    from transopt.solvers.options import SolverOptions, default_solver

    wanted = default_solver() if solver is None else solver
    check_name(wanted)
    options = SolverOptions(wanted, solver_tolerance)
    loaded = _load(scene, recordings)
    if grid_tolerance is not None:
        check_tolerance(loaded, grid_tolerance, grid_cap)
    folder = Path("out") / loaded.name if out is None else out
    terminal.make_folder(folder)
    bar = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    watched, console = sys.stderr.isatty(), terminal.console()
    try:
        with ExitStack() as running:
            pool = running.enter_context(workers.pool(jobs)) if jobs > 1 else None
            progress = running.enter_context(
                Progress(*bar, console=Console(stderr=True), transient=True, disable=not watched)
            )
            task = progress.add_task("recordings", total=None)
            taps_of_scene = _recordings(loaded)
            refinement = None
            if grid_tolerance is not None:
                refinement = refine_grid(
                    loaded,
                    taps_of_scene,
                    grid_tolerance,
                    cap=grid_cap,
                    options=options,
                    progress=lambda text, done, total: progress.update(
                        task, description=text, completed=done, total=total
                    ),
                )
            grid = loaded.grid if refinement is None else refinement.grid
            count = len(grid.speeds_m_s) * len(grid.grips_N)
            progress.update(task, description="entries", completed=0, total=count)
            build = build_library(
                loaded,
                taps_of_scene,
                options=options,
                jobs=jobs,
                pool=pool,
                progress=lambda done: progress.advance(task, done),
                refinement=refinement,
            )
            progress.update(task, visible=False)
            progress.add_task("files", total=None)
            files = files_of(build, figures=figures)
            stale = [name for name in LEFTOVERS if name not in files.names] if build.library is not None else []
            with publishing(folder, files, stale, pool), console.capture() as table:
                # Takes a moment of this process while the others draw.
                console.print(build_table(build, console.width))
    except InputError:
        with suppress(OSError):  # holds earlier results: it stays
            folder.rmdir()
        raise
    except KeyboardInterrupt:
        typer.echo("stopped; earlier results are untouched", err=True)
        raise typer.Exit(130) from None
    typer.echo(table.get(), nl=False)
    console.print(LEGEND, style="dim", highlight=False)
    doubtful = {tap.recording.name for reference in build.references for tap in reference.taps if tap.notes}
    if doubtful:
        console.print(f"recordings with notes, see the report: {len(doubtful)}", style="yellow")
    if aftermath(build):
        console.print(aftermath(build), style="yellow", highlight=False, soft_wrap=True)
    if model_warning(build):
        console.print(model_warning(build), style="yellow", highlight=False, soft_wrap=True)
    for entry in build.refused:
        message = f"refused: {entry.speed_m_s:g} m/s, {entry.grip_N:g} N: {refusal(entry)}"
        console.print(message, style="red", highlight=False, soft_wrap=True)
    missed = refinement is not None and bool(refinement.shortfall)
    if refinement is not None:
        text = refinement_summary(refinement)
        console.print(text, style="red" if missed else None, highlight=False, soft_wrap=True)
    console.print(f"{folder}: {', '.join(files.names)}", highlight=False, soft_wrap=True)
    console.print(summary(build), style="red" if build.refused else None, highlight=False, soft_wrap=True)
    if build.refused or missed:
        raise typer.Exit(1)


@app.command()
def verify(library: Annotated[Path, typer.Argument(help="library.npz")]) -> None:
    """Certify and replay every entry again, from the file alone; exit 1 if one fails."""
    from transopt.design.verify import verify_library
    from transopt.library.file import load_library
    from transopt.report.tables import verify_table

    checks = verify_library(load_library(library))
    console = terminal.console()
    console.print(verify_table(checks, str(library)))
    failed = sum(bool(check.shortfalls) for check in checks)
    console.print(f"{len(checks) - failed} of {len(checks)} entries certified and replayed clean", highlight=False)
    if failed:
        raise typer.Exit(1)


@app.command()
def show(
    library: Annotated[Path, typer.Argument(help="library.npz")],
    figure: Annotated[Path | None, typer.Option(help="Also draw the transients into this PNG.")] = None,
) -> None:
    """Print a library's table; optionally draw its transients."""
    from transopt.library.file import load_library
    from transopt.report.tables import library_table

    loaded = load_library(library)
    if figure is not None and figure.suffix.lower() != ".png":
        raise InputError(f"--figure {figure}: figures are written as .png")
    console = terminal.console()
    console.print(library_table(loaded, f"{library}: {loaded.meta['scene']['description']}"))
    if figure is not None:
        from transopt.base.plotting import save_figure
        from transopt.report.figures import library_figure

        save_figure(library_figure(loaded), figure)
        console.print(f"figure: {figure}", highlight=False)


@app.command()
def export(
    library: Annotated[Path, typer.Argument(help="library.npz")],
    file: Annotated[Path, typer.Argument(help="What to write: .mat, .csv, .wav or .h")],
) -> None:
    """Write a library as MAT, CSV, WAV (to listen to) or a C header."""
    from transopt.library.export import export_library
    from transopt.library.file import load_library

    export_library(load_library(library), file)
    typer.echo(f"{file} written")


def main() -> None:
    """Entry point."""
    terminal.run(app)
