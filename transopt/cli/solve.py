"""`transopt solve`: from a scene to a certified library, a report and figures."""

import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.cli.scene import DEFAULT_SCENE

if TYPE_CHECKING:
    from rich.console import Console

    from transopt.design.build import Build
    from transopt.scene.scene import Scene
    from transopt.solvers.options import SolverOptions


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
    """

    scene: "Scene"
    options: "SolverOptions"
    folder: Path
    grid_tolerance: float | None
    grid_cap: int
    figures: bool
    full: bool


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
    report: Annotated[
        str,
        typer.Option(help="brief, or full: prices of all entries and what intensity costs, which take longer."),
    ] = "brief",
) -> None:
    """Solve a scene: certified library of current transients, report, figures; the last line sums up.

    Exit 1: an entry was refused, or --grid-cap ended the refinement before its tolerance was met. Of a scene with
    [model.nonlinear] the library holds stationary points, replayed, and the report has the linear design beside them.
    """
    terminal.if_stopped("stopped; earlier results are untouched")
    from transopt.design.refine_grid import check_tolerance
    from transopt.solvers.choose import check_name
    from transopt.solvers.options import SolverOptions, default_solver

    if report not in ("brief", "full"):
        raise InputError(f"--report {report}: must be brief or full")
    name = default_solver() if solver is None else solver
    check_name(name)
    options = SolverOptions(name, solver_tolerance)
    loaded = _load(scene, recordings, model)
    unfit = _unfit(loaded, accept_unfit_model)
    folder = Path("out") / loaded.name if out is None else out
    wanted = Wanted(loaded, options, folder, grid_tolerance, grid_cap, figures, report == "full")
    if loaded.nonlinear:
        _solve_nonlinear(wanted)
        return
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
    _print(terminal.console(), build, f"{folder}: {', '.join(names)}", unfit)
    if build.refused or (build.refinement is not None and build.refinement.shortfall):
        raise typer.Exit(1)


def _solve_nonlinear(wanted: Wanted) -> None:
    """Design for the plant of `[model.nonlinear]`, write and print.

    Raises
    ------
    InputError : a grid to be refined, which named targets do not have; a folder that cannot be written.
    """
    if wanted.grid_tolerance is not None:
        raise InputError("--grid-tolerance: refines a grid of speeds, and model.nonlinear has targets: leave it out")
    # What only a nonlinear plant needs is loaded only for one.
    from transopt.design.solve import design_nonlinear
    from transopt.report.nonlinear import nonlinear_table, refusals, write_nonlinear
    from transopt.report.tables import printed

    folder = wanted.folder
    terminal.make_folder(folder)
    design = design_nonlinear(wanted.scene, options=wanted.options)
    written = write_nonlinear(design, folder, figures=wanted.figures)
    terminal.if_stopped(f"stopped; {folder} is written")
    console = terminal.console()
    console.print(printed(nonlinear_table(design), wanted.scene.name))
    for entry in design.all_entries():
        for said in refusals(entry):
            console.print(f"refused: {entry.target}: {said}", style="red", highlight=False, soft_wrap=True)
    names = ", ".join(path.name for path in written)
    refused = len(design.refused)
    kept = "; no library written, an earlier one is kept" if refused else ""
    console.print(f"{folder}: {names}{kept}", highlight=False, soft_wrap=True)
    console.print(
        f"{len(design.proven)} of {design.scene.axes.entries} targets certified stationary and replayed on the "
        f"nonlinear plant; {design.elapsed_s:.1f} s",
        style="red" if refused else None,
        highlight=False,
        soft_wrap=True,
    )
    if refused:
        raise typer.Exit(1)


def _load(scene: str, recordings: Path | None, model: Path | None) -> "Scene":
    """A scene by built-in name or by path, with device and recordings folder replaced if one is given."""
    from transopt.scene import builtin

    loaded = builtin.load_scene(scene, model=model)
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
    """Why the scene's model file is not fit to design with, in one line; empty if it is, or there is none.

    Raises
    ------
    InputError : it is not, and that is not accepted.
    """
    said = scene.unfit_model()
    if said and not accepted:
        raise InputError(f"{said}; identify it again, or solve with it as it is by --accept-unfit-model")
    return said


def _build(wanted: Wanted) -> "tuple[Build, list[str]]":
    """Solve, with a bar on a terminal that counts, and publish; the build and the names of the files in its folder.

    Raises
    ------
    InputError : recordings that cannot serve, or a folder that cannot be written.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from transopt.design.build import build_library
    from transopt.design.refine_grid import refine_grid
    from transopt.report.write import write_report
    from transopt.scene.recordings import recordings_of

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    watched = sys.stderr.isatty()
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not watched) as bar:
        task = bar.add_task("recordings", total=None)

        def tell(text: str, done: int, total: int) -> None:
            bar.update(task, description=text, completed=done, total=total)

        scene, taps, refinement = wanted.scene, recordings_of(wanted.scene), None
        if wanted.grid_tolerance is not None:
            refinement = refine_grid(
                scene,
                taps,
                wanted.grid_tolerance,
                cap=wanted.grid_cap,
                options=wanted.options,
                progress=tell,
            )
        tell("entries", 0, scene.axes.entries if refinement is None else refinement.entries)
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


def _print(console: "Console", build: "Build", written: str, unfit: str) -> None:
    """The table, what deserves a second look, what was refused and why; the last line sums up."""
    from transopt.report.identified import model_warning, moving_target, uncovered_line
    from transopt.report.tables import (
        build_table,
        cool_summary,
        fitting,
        legend,
        refinement_summary,
        refusal,
        summary,
        warnings,
    )
    from transopt.report.taps import implausible_lines

    def line(text: str, style: str | None = None) -> None:
        console.print(text, style=style, highlight=False, soft_wrap=True)

    shown = fitting(build, console.width)
    console.print(build_table(build, shown))
    console.print(legend(shown, build.scene), style="dim", highlight=False)
    doubtful = {tap.recording.name for reference in build.references for tap in reference.taps if tap.notes}
    if doubtful:
        console.print(f"recordings with notes, see the report: {len(doubtful)}", style="yellow")
    for warning in (
        *build.recorded_remarks,
        *warnings(build),
        *filter(None, [model_warning(build), uncovered_line(build), moving_target(build.scene)]),
    ):
        line(warning, "yellow")
    for entry in build.refused:
        line(f"refused: {entry.place}: {refusal(entry)}", "red")
    if build.library is not None and (said := cool_summary(build.library)):
        line(said)
    if build.refinement is not None:
        line(refinement_summary(build.refinement), "red" if build.refinement.shortfall else None)
    line(written)
    for said in implausible_lines([tap for reference in build.references for tap in reference.taps]):
        line(f'{said} (recordings.implausible = "accept")', "red")
    if unfit:
        line(f"{unfit} (--accept-unfit-model)", "red")
    line(summary(build), "red" if build.refused else None)
