"""`transopt-play refine`: play a library's taps, learn from them, solve again, under the same limits.

The one command of the controller that solves; `transopt.design.resolve`, and with it the optimiser, is
imported inside it.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from controller.cli.options import (
    AnyPort,
    Crossover,
    DeviceName,
    LibraryFile,
    Mismatch,
    Reset,
    Seed,
    Simulate,
    TrueDeviceName,
    imperfect,
    is_simulated,
    with_port,
    within,
)
from controller.cli.port import STOPPED, connected, person_at
from transopt.base import terminal
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from controller.cli.bench import Bench
    from controller.cli.refine_taps import Hand
    from controller.device.device_file import DeviceFile
    from controller.refine.rounds import Refined, Round
    from transopt.library.library import Library


def refine(
    context: typer.Context,
    library: LibraryFile,
    out: Annotated[Path, typer.Option(help="Folder for the refined library.npz and refinement.png.")],
    simulate: Simulate = False,
    port: AnyPort = None,
    device: DeviceName = None,
    rounds: Annotated[int, typer.Option(help="How often is learnt and solved again.")] = 3,
    taps: Annotated[int, typer.Option(help="Taps at each speed and grip in each round; their mean counts.")] = 3,
    scene: TrueDeviceName = None,
    mismatch: Mismatch = 0.0,
    seed: Seed = 0,
    crossover: Crossover = 0.01,
    seconds: Annotated[float | None, with_port("End a round's taps after so many seconds.", "--for")] = None,
    reset: Reset = False,
) -> None:
    """Refine a library on its device: taps are repeated, measured, learnt from; the result is certified again.

    Exit 1: nothing became better, a limit was left, or a fault or a lost lease ended it.
    """
    simulated = is_simulated(context, "refine", simulate, port)
    within("rounds", rounds, 1, 20)
    within("taps", taps, 2, 100)
    within("for", seconds, 1.0, 1e6, " s")
    wrong = imperfect(mismatch, seed, crossover)
    from transopt.library.proven import load_proven

    loaded = load_proven(library)
    if loaded.meta["feedback"] is not None:
        raise InputError(f"{library}: has a wall, whose feedback answers the hand's own motion: it is not refined")
    if (out / "library.npz").resolve() == library.resolve():
        raise InputError(f"--out {out}: holds the library that is refined; choose another folder")
    terminal.make_folder(out)
    from controller.cli.describe import described, sensing

    found = described(device, library, quiet=simulated)
    if simulated:
        from controller.cli.refine_taps import simulated_at
        from controller.sim.chosen_device import device_in, scene_like
        from controller.waveforms.prediction import scene_of

        wrong = sensing(found, wrong)
        true = device_in(scene_of(loaded) if scene is None else scene_like(scene), wrong, seed)
        bench, hand = simulated_at(loaded, true, wrong, rounds, taps, seed, found.device)
        source = f"simulator, {scene or loaded.meta['scene']['name']}, mismatch {mismatch:g}, seed {seed}"
    else:
        from controller.cli.refine_taps import PersonsHand

        assert port is not None
        bench, hand, source = person_at(port), PersonsHand(terminal.console()), port
    stated = _stated(loaded, source, taps, found.device.accelerometer.bandwidth_Hz)
    refined = _refined(loaded, bench, hand, found.device, out, rounds, taps, seconds, stated, reset)
    _finish(loaded, refined, library, out)


def _stated(library: "Library", source: str, taps: int, accelerometer_Hz: float) -> dict[str, Any]:
    """What `meta["refinement"]` says beside the rounds."""
    from controller.record.played import CUTOFF_HZ
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


@contextmanager
def _ended_in_words() -> Iterator[None]:
    """What ends a refinement on a port: exit codes 130 and 1."""
    from controller.cli.port import StoppedError
    from controller.cli.refine_taps import EndedError

    try:
        yield
    except StoppedError:
        typer.echo(STOPPED, err=True)
        raise typer.Exit(130) from None
    except EndedError as ended:
        terminal.console().print(str(ended), style="red", highlight=False, soft_wrap=True)
        raise typer.Exit(1) from None


def _refined(
    library: "Library",
    bench: "Bench",
    hand: "Hand",
    described: "DeviceFile",
    out: Path,
    rounds: int,
    taps: int,
    seconds: float | None,
    stated: dict[str, Any],
    reset: bool,
) -> "Refined":
    from controller.cli.refine_taps import Taps
    from controller.refine import rounds as refinement
    from transopt.design.resolve import resolve

    with connected(bench.port, reset) as device, _ended_in_words(), hand:
        play = Taps(device, bench, hand, described, out, taps, seconds)
        return refinement.refine(library, play, resolve, rounds, stated, tell=_tell)


def _finish(before: "Library", refined: "Refined", path: Path, out: Path) -> None:
    """Table, files, and the verdict: exit code 1 if nothing became better, or a limit was left."""
    from controller.refine.figure import refine_figure
    from controller.refine.tables import LEGEND, refine_table, summary
    from transopt.base.plotting import save_figure

    console = terminal.console()
    console.print(refine_table(before, refined, f"{path}, NRMSE against the reference in %"))
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
