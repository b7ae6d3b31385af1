"""What `transopt solve`, `show`, `verify` and `export` do with an arm that has several motors."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from transopt.base import terminal
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from transopt.scene.scene import Scene
    from transopt.solvers.options import SolverOptions


def solve_arm_scene(scene: "Scene", options: "SolverOptions", folder: Path, *, figures: bool, table: bool) -> None:
    """Solve, publish and print; exit 1 if an entry was refused."""
    from transopt.design.arm import build_arm
    from transopt.report.arm import LEGEND, LIBRARY, entries_table, first_look, refusals, write_arm

    terminal.make_folder(folder)
    arm = scene.arm()
    with terminal.progress() as bar:
        task = bar.add_task("entries", total=scene.axes.entries * len(arm.normals) * len(arm.postures_deg))
        build = build_arm(scene, options=options, progress=lambda done: bar.advance(task, done))
        names = write_arm(build, folder, figures=figures)
    console = terminal.console()
    if build.library is None:
        console.print(str(build))
        for said in refusals(build):
            console.print(said, style="red")
        console.print(f"{folder}: {', '.join(names)}")
        raise typer.Exit(1)
    if table:
        console.print(entries_table(build.library, scene.name))
        console.print(LEGEND, style="dim")
    for said in first_look(build.library, "proven optimal and replayed"):
        console.print(said)
    console.print(f"{folder}: {', '.join(names)}")
    _next(console, folder / LIBRARY)


def _next(console: "Console", library: Path) -> None:
    """Three commands that go on from a library: detail, the proof again, what a device plays."""
    file = shlex.quote(str(library))
    console.print("Next:")
    for command in (f"show {file} --table", f"verify {file}", f"export {file} arm.h"):
        console.print(f"  transopt {command}")


def show_arm_library(path: Path, figure: Path | None, *, table: bool) -> None:
    """Print a first look, with `table` every entry; with `figure`, draw the fastest taps."""
    from transopt.library.arm import load_arm_library
    from transopt.report.arm import LEGEND, arm_figure, entries_table, first_look

    if figure is not None and figure.suffix.lower() != ".png":
        raise InputError(f"--figure {figure}: figures are written as .png")
    library, console = load_arm_library(path), terminal.console()
    if table:
        console.print(entries_table(library, str(path)))
        console.print(LEGEND, style="dim")
    for said in first_look(library, "said to be optimal, which was not checked here"):
        console.print(said)
    _next(console, path)
    if figure is not None:
        from transopt.base.plotting import save_figure

        save_figure(arm_figure(library), figure)
        console.print(f"figure: {figure}")


def verify_arm_library(path: Path) -> None:
    """Certify and replay every entry again; exit 1 if one fails."""
    from transopt.design.arm import verify_arm
    from transopt.library.arm import load_arm_library
    from transopt.report.arm import checks_table

    library = load_arm_library(path)
    with terminal.progress() as bar:
        task = bar.add_task("entries", total=len(library.nodes))
        checks = verify_arm(library, lambda done: bar.advance(task, done))
    console = terminal.console()
    console.print(checks_table(checks, str(path)))
    failed = sum(bool(check.shortfalls) for check in checks)
    console.print(f"{len(checks) - failed} of {len(checks)} entries certified and replayed clean")
    if failed:
        raise typer.Exit(1)


def export_arm_library(path: Path, file: Path) -> None:
    """Write the C header with the blend, or the arrays as NPZ; every entry is certified before.

    Raises
    ------
    InputError : an entry that is not proven, or a format that is none.
    """
    from transopt.base.writing import write_text
    from transopt.design.arm import verify_arm
    from transopt.library.arm import load_arm_library
    from transopt.library.arm_header import arm_header

    kind = file.suffix.lower()
    if kind not in (".h", ".npz"):
        raise InputError(f"{file}: a library of an arm is written as .h or .npz")
    library = load_arm_library(path)
    for check in verify_arm(library):
        if check.shortfalls:
            raise InputError(f"{path}: {check.place}: {check.shortfalls[0]}; solve the scene again")
    if kind == ".h":
        write_text(arm_header(library), file)
    else:
        library.save(file)
    typer.echo(f"{terminal.harmless(str(file))} written")
