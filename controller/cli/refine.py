"""`transopt-play refine`: play a library's taps, learn from them, solve again, under the same limits.

With `calibrate` the command of the controller that solves; `transopt.design.resolve`, and with it the optimiser, is
imported inside it.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from controller.cli import options
from controller.cli.port import STOPPED, connected, person_at
from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.cli.layout import COLUMNS_HELP, RATE_HELP, UNITS_HELP

if TYPE_CHECKING:
    from controller.refine.learner import Learner, Round
    from controller.refine.rounds import Refined
    from transopt.library.library import Library

WITH_FILES = "With --from-files"


def with_files(words: str, *names: str) -> Any:
    """An option that means something with recorded taps only."""
    return typer.Option(*names, help=words, rich_help_panel=WITH_FILES)


def only_for_files(context: typer.Context, from_files: bool, names_device: bool) -> None:
    """Whether what was given goes with the source of the taps: recorded ones, or a device.

    Raises
    ------
    InputError : it does not.
    """
    if from_files and names_device:
        raise InputError("--from-files: the taps are in files: leave --simulate and --port out")
    panels = (options.ON_A_PORT, options.ON_THE_SIMULATOR) if from_files else (WITH_FILES,)
    why = "not with --from-files" if from_files else "only with --from-files"
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        given = source is not None and source.name == "COMMANDLINE"
        if given and (
            getattr(parameter, "rich_help_panel", None) in panels or (parameter.name == "files" and not from_files)
        ):
            raise InputError(f"{'FILES' if parameter.name == 'files' else parameter.opts[0]}: {why}")


def refine(
    context: typer.Context,
    library: options.LibraryFile,
    out: Annotated[Path, typer.Option(help="Folder for the refined library.npz and refinement.png.")],
    files: Annotated[list[Path] | None, typer.Argument(help="Recorded taps; needs --from-files.")] = None,
    simulate: options.Simulate = False,
    port: options.AnyPort = None,
    from_files: Annotated[
        bool,
        typer.Option(
            "--from-files",
            help="Learn one step from recorded taps: FILES of this very library, played by a device of your own.",
        ),
    ] = False,
    columns: Annotated[str, with_files(COLUMNS_HELP)] = "",
    units: Annotated[str, with_files(UNITS_HELP)] = "",
    rate_Hz: Annotated[float | None, with_files(RATE_HELP, "--rate-Hz")] = None,
    device: options.DeviceName = None,
    rounds: Annotated[int, typer.Option(help="How often is learnt and solved again, at most.")] = 6,
    taps: Annotated[int, typer.Option(help="Taps at each speed and grip in each round; their mean counts.")] = 3,
    scene: options.TrueDeviceName = None,
    mismatch: options.Mismatch = 0.0,
    seed: options.Seed = 0,
    crossover: options.Crossover = 0.01,
    seconds: Annotated[float | None, options.with_port("End a round's taps after so many seconds.", "--for")] = None,
    reset: options.Reset = False,
) -> None:
    """Refine a library on its device: learn what stands out of repeated taps until nothing does, and confirm it.

    Exit 1: something stood out and nothing became better, or a fault or a lost lease ended it.
    """
    if not (simulate or from_files or port is not None):
        ports = "--port PORT (`transopt-play ports` lists them)"
        raise InputError(f"refine: name one device: --simulate, or {ports}; or --from-files and recorded taps")
    simulated = False if from_files else options.is_simulated(context, "refine", simulate, port)
    only_for_files(context, from_files, simulate or port is not None)
    options.within("rounds", rounds, 1, 20)
    options.within("taps", taps, 2, 100)
    options.within("for", seconds, 1.0, 1e6, " s")
    from controller.host.payload import load_playable

    loaded = load_playable(library)
    if loaded.wall() is not None:
        raise InputError(f"{library}: has a wall, whose feedback answers the hand's own motion: it is not refined")
    if (out / "library.npz").resolve() == library.resolve():
        raise InputError(f"--out {out}: holds the library that is refined; choose another folder")
    from controller.refine.learner import LEAST_DEGREES

    if not from_files and loaded.tap_error.size * (taps - 1) < LEAST_DEGREES:
        raise InputError(f"--taps {taps}: at a single node at least 3 are needed, to know how they scatter")
    from controller.cli.describe import described

    found = described(device, library, quiet=simulated)
    wrong = options.imperfect(found.device, mismatch, seed, crossover)
    terminal.make_folder(out)
    accelerometer_Hz = found.device.accelerometer.bandwidth_Hz
    if from_files:
        from controller.cli.refine_files import step
        from transopt.cli.layout import layout
        from transopt.design.resolve import resolve

        step(
            loaded,
            library,
            files or [],
            layout(columns, units, rate_Hz),
            accelerometer_Hz,
            resolve,
            rounds,
            taps,
            _stated(loaded, "files", accelerometer_Hz),
            out,
        )
        return
    from controller.cli.refine_taps import PersonsHand, Taps, simulated_at
    from controller.refine import rounds as refinement
    from controller.refine.kept import is_learning

    if is_learning(loaded):
        raise InputError(
            f"{library}: is between two steps of --from-files: go on with them, or refine what it came from"
        )
    if simulated:
        from controller.sim.simulator import device_in, scene_like

        true = device_in(loaded.scene() if scene is None else scene_like(scene), wrong, seed)
        bench, hand = simulated_at(loaded, true, wrong, seed, found.device)
        source = f"simulator, {scene or loaded.meta['scene']['name']}, mismatch {mismatch:g}, seed {seed}"
    else:
        assert port is not None
        bench, hand, source = person_at(port), PersonsHand(terminal.console()), port
    stated = {**_stated(loaded, source, accelerometer_Hz), "taps": taps}
    from transopt.design.resolve import resolve

    with connected(bench.port, reset) as opened, ended_in_words(), hand:
        play = Taps(opened, bench, hand, found.device, out, taps, seconds)
        refined = refinement.refine(loaded, play, resolve, rounds, stated, tell=tell_round)
    finish(refined, library, out)


def _stated(library: "Library", source: str, accelerometer_Hz: float) -> dict[str, Any]:
    """What `meta["refinement"]` says beside the history."""
    from controller.record.played import CUTOFF_HZ
    from transopt.plant.intention import INTENTION_S

    return {
        "library_sha256": library.content_sha256,
        "before": library.meta.get("refinement"),
        "source": source,
        "compared_until_s": INTENTION_S,
        "lowpass_Hz": CUTOFF_HZ,
        "accelerometer_Hz": accelerometer_Hz,
    }


def tell_round(learner: "Learner", results: "Round") -> None:
    """Print what the round just learnt from has shown, and what follows from it."""
    from controller.refine.tables import following_line, round_line

    for line in filter(None, (round_line(learner.number - 1, learner, results), following_line(learner))):
        terminal.console().print(line)


@contextmanager
def ended_in_words() -> Iterator[None]:
    """What ends taps on a port before they are done: exit codes 130 and 1."""
    from controller.cli.port import StoppedError
    from controller.cli.refine_taps import EndedError

    try:
        yield
    except StoppedError:
        typer.echo(STOPPED, err=True)
        raise typer.Exit(130) from None
    except EndedError as ended:
        terminal.console().print(str(ended), style="red")
        raise typer.Exit(1) from None


def finish(refined: "Refined", path: Path, out: Path) -> None:
    """Table, files, and the verdict: exit code 1 if something was left to be gained and nothing was."""
    from controller.refine.figure import refine_figure
    from controller.refine.tables import LEGEND, reasons, refine_table, summary
    from transopt.base.plotting import save_figure

    console = terminal.console()
    console.print(refine_table(refined, f"{path}, playback error in %"))
    console.print(LEGEND, style="dim")
    console.print(reasons(refined))
    words, good = summary(refined, out / "library.npz")
    refined.library.save(out / "library.npz")
    save_figure(refine_figure(refined), out / "refinement.png")
    console.print(f"{out}: library.npz, refinement.png")
    console.print(words, style=None if good else "red")
    if not good:
        raise typer.Exit(1)
