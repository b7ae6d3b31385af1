"""`transopt-play refine`: play a library's taps, learn from them, solve again, under the same limits.

The one command of the controller that solves; `transopt.design.resolve`, and with it the optimiser, is
imported inside it.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from controller.cli.options import refuse, within
from controller.cli.port import STOPPED, Reset
from controller.cli.record import Crossover, Mismatch, SceneName, Seed, Simulate
from transopt.base import console as terminal
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from controller.refine.rounds import Refined, Round
    from transopt.library.library import Library

ONLY_SIMULATED = ("scene", "mismatch", "seed", "crossover")
ONLY_ON_PORT = ("seconds", "accelerometer_hz", "reset")


def refine(
    context: typer.Context,
    library: Annotated[Path, typer.Argument(help="library.npz")],
    out: Annotated[Path, typer.Option(help="Folder for the refined library.npz and refinement.png.")],
    simulate: Simulate = False,
    port: Annotated[str | None, typer.Option(help="On a device: a name that `ports` lists.")] = None,
    rounds: Annotated[int, typer.Option(help="How often is learnt and solved again.")] = 3,
    taps: Annotated[int, typer.Option(help="Taps at each speed and grip in each round; their mean counts.")] = 3,
    scene: SceneName = None,
    mismatch: Mismatch = 0.0,
    seed: Seed = 0,
    crossover: Crossover = 0.01,
    seconds: Annotated[
        float | None, typer.Option("--for", help="On a device: end a round's taps after so many seconds.")
    ] = None,
    accelerometer_hz: Annotated[float, typer.Option(help="On a device: bandwidth of its accelerometer.")] = 2500.0,
    reset: Reset = False,
) -> None:
    """Refine a library on its device: taps are repeated, measured, learnt from; the result is certified as before."""
    if simulate == (port is not None):
        raise InputError("refine: name one device: --simulate, or --port PORT (`transopt-play ports` lists them)")
    within("rounds", rounds, 1, 20)
    within("taps", taps, 2, 100)
    if port is None:
        refuse(context, ONLY_ON_PORT, "only with --port")
    else:
        refuse(context, ONLY_SIMULATED, "only with --simulate")
        within("accelerometer-hz", accelerometer_hz, 10.0, 1e6, " Hz")
        if seconds is not None:
            within("for", seconds, 1.0, 1e6, " s")
    from transopt.library.file import load_library

    loaded = load_library(library)
    if loaded.meta["feedback"] is not None:
        raise InputError(f"{library}: has a wall, whose feedback answers the hand's own motion: it is not refined")
    if (out / "library.npz").resolve() == library.resolve():
        raise InputError(f"--out {out}: holds the library that is refined; choose another folder")
    terminal.make_folder(out)
    if port is None:
        refined = _simulated(loaded, rounds, taps, scene, mismatch, seed, crossover)
    else:
        refined = _on_port(loaded, port, out, rounds, taps, seconds, accelerometer_hz, reset)
    _finish(loaded, refined, library, out)


def _stated(library: "Library", source: str, taps: int, accelerometer_Hz: float) -> dict[str, Any]:
    """What `meta["refinement"]` says beside the rounds."""
    from controller.record.judge import CUTOFF_HZ
    from controller.waveforms.prediction import REACTION_S

    return {
        "library_sha256": library.content_sha256,
        "before": library.meta.get("refinement"),
        "source": source,
        "taps": taps,
        "compared_until_s": REACTION_S,
        "lowpass_Hz": CUTOFF_HZ,
        "accelerometer_Hz": accelerometer_Hz,
    }


def _tell(number: int, results: "Round") -> None:
    from controller.refine.tables import round_line

    terminal.console().print(round_line(number, results), highlight=False, soft_wrap=True)


def _simulated(
    library: "Library", rounds: int, taps: int, scene: str | None, mismatch: float, seed: int, crossover: float
) -> "Refined":
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from controller.cli.options import imperfect
    from controller.cli.refine_simulated import SimulatedTaps
    from controller.refine import rounds as refinement
    from controller.sim.chosen_device import device_in, scene_like
    from controller.waveforms.prediction import scene_of
    from transopt.design.resolve import resolve

    wrong = imperfect(mismatch, seed, crossover)
    device = device_in(scene_of(library) if scene is None else scene_like(scene), wrong, seed)
    total = (rounds + 1) * taps * len(refinement.nodes_of(library))
    bar = (TextColumn("taps"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    words = f"simulator, {scene or library.meta['scene']['name']}, mismatch {mismatch:g}, seed {seed}"
    with Progress(*bar, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("taps", total=total)
        play = SimulatedTaps(device, taps, imperfections=wrong, seed=seed, done=lambda: progress.advance(task))
        stated = _stated(library, words, taps, wrong.sensors.accelerometer_bandwidth_Hz)
        return refinement.refine(library, play, resolve, rounds, stated, tell=_tell)


@contextmanager
def _ended_in_words() -> Iterator[None]:
    """What ends a refinement on a port: exit codes 130 and 1."""
    from controller.cli.port import StoppedError
    from controller.cli.refine_on_port import EndedError

    try:
        yield
    except StoppedError:
        typer.echo(STOPPED, err=True)
        raise typer.Exit(130) from None
    except EndedError as ended:
        terminal.console().print(str(ended), style="red", highlight=False, soft_wrap=True)
        raise typer.Exit(1) from None


def _on_port(
    library: "Library",
    port: str,
    out: Path,
    rounds: int,
    taps: int,
    seconds: float | None,
    accelerometer_Hz: float,
    reset: bool,
) -> "Refined":
    from controller.cli import port as port_commands
    from controller.cli.refine_on_port import PortTaps
    from controller.refine import rounds as refinement
    from transopt.design.resolve import resolve

    stated = _stated(library, port, taps, accelerometer_Hz)
    with port_commands.connected(port, reset) as device, _ended_in_words():
        play = PortTaps(device, terminal.console(), out, taps, seconds, accelerometer_Hz)
        return refinement.refine(library, play, resolve, rounds, stated, tell=_tell)


def _finish(before: "Library", refined: "Refined", path: Path, out: Path) -> None:
    """Table, files, and the verdict: exit code 1 if nothing became better, or a limit was left."""
    from controller.refine.figure import refine_figure
    from controller.refine.tables import LEGEND, refine_table, summary
    from transopt.base.plotting import save_figure

    console = terminal.console()
    console.print(refine_table(before, refined, f"{path}, NRMSE against the recorded tap in %"))
    console.print(LEGEND, style="dim", highlight=False)
    for (iv, ig), why in refined.kept.items():
        console.print(
            f"kept as it was: {before.speeds_m_s[iv]:g} m/s, {before.grips_N[ig]:g} N: {why}",
            style="yellow",
            highlight=False,
            soft_wrap=True,
        )
    words, good = summary(before, refined, out / "library.npz")
    if refined.better:
        refined.library.save(out / "library.npz")
        save_figure(refine_figure(before, refined), out / "refinement.png")
        console.print(f"{out}: library.npz, refinement.png", highlight=False, soft_wrap=True)
    console.print(words, style=None if good else "red", highlight=False, soft_wrap=True)
    if not good:
        raise typer.Exit(1)
