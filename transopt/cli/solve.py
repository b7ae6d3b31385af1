"""`transopt solve`: from a scene to a certified library, a report and figures."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.cli.scene import ACCEPT_HELP, DEFAULT_SCENE

if TYPE_CHECKING:
    from rich.console import Console

    from transopt.design.build import Build
    from transopt.scene.scene import Scene
    from transopt.solvers.options import SolverOptions


LIBRARY = "library.npz"  # in the folder of the results


@dataclass(frozen=True)
class Wanted:
    """What the command line asks for.

    Attributes
    ----------
    folder : of the results.
    grid_tolerance : None for the scene's own grid.
    grid_cap : most entries of a refined grid.
    figures : whether any are drawn.
    full : whether the report has what takes further optima of every entry.
    table, report : whether figures and certificates are printed too.
    """

    scene: "Scene"
    options: "SolverOptions"
    folder: Path
    grid_tolerance: float | None
    grid_cap: int
    figures: bool
    full: bool
    table: bool
    report: bool


def solve(
    scene: Annotated[str, typer.Argument(help="Built-in name or path of a .toml file.")] = DEFAULT_SCENE,
    out: Annotated[Path | None, typer.Option(help="Folder for the results; default out/SCENE.")] = None,
    recordings: Annotated[Path | None, typer.Option(help="Folder of the scene's recordings.")] = None,
    model: Annotated[
        Path | None,
        typer.Option(help="Model file of transopt identify, in the place of the scene's own device."),
    ] = None,
    accept_unfit_model: Annotated[
        bool, typer.Option("--accept-unfit-model", help="Solve although the model file is not fit to design with.")
    ] = False,
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
    figures: Annotated[
        bool, typer.Option(help="Draw transients, methods and Bode plot into the folder, with the full report more.")
    ] = True,
    full: Annotated[
        bool,
        typer.Option("--full", help="Report with prices of all entries and what intensity costs; takes longer."),
    ] = False,
    table: Annotated[bool, typer.Option("--table", help="Also print every entry with all its figures.")] = False,
    report: Annotated[bool, typer.Option("--report", help="Also print the certificates.")] = False,
    accept: Annotated[bool, typer.Option("--accept", help=ACCEPT_HELP)] = False,
) -> None:
    """Solve a scene: library of proven current transients, report, figures; prints a first look at it.

    Exit 1: an entry was refused, or --grid-cap ended the refinement before its tolerance was met. For a
    nonlinear model the library holds stationary points, replayed, and the report has the linear design beside them.
    """
    terminal.if_stopped("stopped; earlier results are untouched")
    from transopt.design.refine_grid import check_tolerance
    from transopt.solvers.choose import check_name
    from transopt.solvers.options import SolverOptions, default_solver

    name = default_solver() if solver is None else solver
    check_name(name)
    options = SolverOptions(name, solver_tolerance)
    loaded = _load(scene, recordings, model, accept)
    unfit = _unfit(loaded, accept_unfit_model)
    folder = Path("out") / loaded.name if out is None else out
    if full:
        loaded.check_one_motor("--full")
    wanted = Wanted(loaded, options, folder, grid_tolerance, grid_cap, figures, full, table, report)
    if loaded.nonlinear:
        loaded.nonlinear_plant()  # what no nonlinear plant can have is refused before there is a folder
        if grid_tolerance is not None:
            raise InputError(
                "--grid-tolerance: refines a grid of speeds, and model.nonlinear has targets: leave it out"
            )
    if grid_tolerance is not None:
        check_tolerance(loaded, grid_tolerance, grid_cap)
    terminal.make_folder(folder)
    try:
        build, names = _build(wanted)
    except InputError:
        with suppress(OSError):  # holds earlier results: it stays
            folder.rmdir()
        raise
    terminal.if_stopped(f"stopped; {folder} is written")
    _print(terminal.console(), build, wanted, names, unfit)
    if build.refused or (build.refinement is not None and build.refinement.shortfall):
        raise typer.Exit(1)


def _load(scene: str, recordings: Path | None, model: Path | None, accept: bool) -> "Scene":
    """A scene by built-in name or by path, with device and recordings folder replaced if one is given."""
    from transopt.scene import builtin

    loaded = builtin.load_scene(scene, model=model, accept=accept)
    if model is not None and not scene.lower().endswith(".toml"):
        own = builtin.load_scene(scene).grid.grips_N
        if loaded.grid.grips_N != own:
            ours, theirs = (", ".join(f"{grip:g}" for grip in grips) for grips in (loaded.grid.grips_N, own))
            typer.echo(f"grips {ours} N: those of {model}, which does not know all of the scene's, {theirs} N")
    if recordings is None:
        return loaded
    if not recordings.is_dir():
        raise InputError(f"--recordings {recordings}: no such folder")
    settings = loaded.recordings.model_copy(update={"folder": str(recordings.resolve())})
    return loaded.model_copy(update={"recordings": settings})


def _unfit(scene: "Scene", accepted: bool) -> str:
    """Why the scene's model file is not fit to design with, in one line; empty if it is, or there is none."""
    unfit = scene.unfit_model()
    if unfit and not accepted:
        raise InputError(f"{unfit}; identify it again, or solve with it as it is by --accept-unfit-model")
    return unfit


def _build(wanted: Wanted) -> "tuple[Build, list[str]]":
    """Solve with a bar on a terminal that counts, and publish; the build and the names of the files in its folder."""
    from transopt.design.build import build_library
    from transopt.design.refine_grid import refine_grid
    from transopt.files.unclear import UnclearError
    from transopt.report.write import write_report
    from transopt.scene.recordings import recordings_of

    with terminal.progress() as bar:
        task = bar.add_task("recordings", total=None)

        def tell(text: str, done: int, total: int) -> None:
            bar.update(task, description=text, completed=done, total=total)

        scene, refinement = wanted.scene, None
        try:
            taps = recordings_of(scene)
        except UnclearError as error:
            from transopt.report.tried import asked_in_scene

            raise asked_in_scene(error, scene.recordings) from None
        if wanted.grid_tolerance is not None:
            refinement = refine_grid(
                scene,
                taps,
                wanted.grid_tolerance,
                cap=wanted.grid_cap,
                options=wanted.options,
                progress=tell,
            )
        of_places = max(len(scene.axes.places), 1)
        tell("entries", 0, scene.axes.entries if refinement is None else refinement.entries * of_places)
        build = build_library(
            scene,
            taps,
            options=wanted.options,
            progress=lambda done: bar.advance(task, done),
            refinement=refinement,
        )
        bar.update(task, visible=False)
        bar.add_task("files", total=None)
        written = write_report(build, wanted.folder, figures=wanted.figures, full=wanted.full)
    return build, [path.name for path in written]


def _print(console: "Console", build: "Build", wanted: Wanted, names: "list[str]", unfit: str) -> None:
    """A first look, what deserves a second one, what was refused and why, and how to go on."""
    from transopt.report import tables
    from transopt.report.first import Look, lines, next_commands
    from transopt.report.identified import model_warning, moving_target, uncovered_line
    from transopt.report.taps import implausible_lines

    def line(text: str, style: str | None = None) -> None:
        console.print(text, style=style)

    if wanted.table:
        described = ": ".join(filter(None, (build.scene.name, build.scene.description)))
        table, meaning = tables.entry_table(build, described)
        console.print(table)
        line(meaning, "dim")
    if wanted.report:
        console.print(tables.certificate_table(build, build.scene.name))
        line(tables.summary(build))
    for text, colour in lines(build, Look.of_build(build), console.width):
        line(text, colour)
    if build.library is not None and (text := tables.cool_summary(build.library)):
        line(text)
    doubtful = {tap.recording.name for reference in build.references for tap in reference.taps if tap.notes}
    if doubtful:
        line(f"recordings with notes, see the report: {len(doubtful)}", "yellow")
    for warning in (
        *build.recorded_remarks,
        *tables.warnings(build),
        *filter(None, [model_warning(build), uncovered_line(build), moving_target(build.scene)]),
    ):
        line(warning, "yellow")
    for refused in tables.refused_lines(build):
        line(refused, "red")
    if build.refinement is not None:
        line(tables.refinement_summary(build.refinement), "red" if build.refinement.shortfall else None)
    for text in implausible_lines([tap for reference in build.references for tap in reference.taps]):
        line(f'{text} (recordings.implausible = "accept")', "red")
    if unfit:
        line(f"{unfit} (--accept-unfit-model)", "red")
    report = next(name for name in names if name.endswith(".md"))
    ready, others = build.library is not None, len(names) - 1
    line(f"{wanted.folder}: {report} and {others} other file{'' if others == 1 else 's'}.{' Next:' if ready else ''}")
    for command in next_commands(wanted.folder / LIBRARY, build.scene) if ready else ():
        line(f"  {command}")
