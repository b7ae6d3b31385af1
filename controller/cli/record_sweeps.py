"""`transopt-play record sweep`: trials of an excitation on a device of any kind, to files that `transopt` reads."""

import itertools
import shlex
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import typer

from controller.cli.bench import Bench, holding_bench
from controller.cli.options import DEFAULT_SCENE, of_scene
from controller.cli.port import STOPPED, StoppedError, connected, disarmed_by_ctrl_c, load, no_long_pauses
from controller.cli.tables import sweep_table
from controller.device.device_file import BUILT_IN, DeviceFile
from controller.host.driver import LinkLostError
from controller.host.monitor import Monitor
from controller.host.payload import excitation
from controller.host.sweeps import AbortedError, Sweeps, Trial
from controller.protocol.image import sha256
from controller.protocol.messages import PULSE_SOUND, HelloReply
from controller.record.sweep_plan import PlannedSweep, Shape
from controller.record.trial_file import refuse_old
from controller.servo.settings import Settings
from controller.sim.simulator import Imperfections, scene_like
from transopt.base import terminal
from transopt.base.errors import InputError


@dataclass(frozen=True)
class Series:
    """Trials, and how they are played.

    Attributes
    ----------
    planned : with a file for each in `paths`.
    settings : of the device, by what it says of itself.
    remedy : options of `transopt-play check` with which these settings pass the bring-up check.
    closing : what is said once all trials are there.
    gain : scale of what is played; None for 1.
    as_held : whatever the grip is.
    device : its encoder and sensors.
    patience_s : with a hand.
    reset : a latched fault first.
    """

    planned: Sequence[PlannedSweep]
    paths: Sequence[Path]
    settings: Callable[[HelloReply], Settings]
    remedy: str = ""
    closing: str = ""
    gain: float | None = None
    as_held: bool = False
    device: DeviceFile = BUILT_IN
    patience_s: float = 60.0
    reset: bool = False


def _alike(trial: PlannedSweep) -> PlannedSweep:
    """What the device holds of a trial: the other sign is its own business."""
    return replace(trial, polarity=1, number=1)


def record_sweeps(bench: Bench, series: Series) -> None:
    """Trial after trial, one file each; whoever is at the device is asked for each grip.

    Raises
    ------
    InputError : the device will not take it. typer.Exit : not every trial was had.
    """
    console, planned, first = terminal.console(), series.planned, series.planned[0]
    out, names = series.paths[0].parent, iter(series.paths)
    written: list[tuple[Path, Trial]] = []
    stopped, why = False, ""

    def say(words: str) -> None:
        bench.console.print(f"  {words}")

    with connected(bench.port, series.reset) as device:
        hello = device.hello
        settings = series.settings(hello)
        commands = {alike: alike.command(settings.dt_s) for alike in map(_alike, planned)}
        # All of them are tried before any of them is played.
        loads = {alike: excitation(settings, command, hello) for alike, command in commands.items()}
        configuration = sha256(next(iter(loads.values())).configuration)
        # The trial is of the excitation that the device held last; each one has its own below.
        checked = hello.configuration_sha256 == configuration and hello.evidence & PULSE_SOUND
        if not (device.harmless or hello.simulated or checked):
            raise InputError(
                f"{bench.name}: sweeps under these limits have not passed the bring-up check since the device "
                f"started: run `transopt-play check --sweep {series.remedy}`"
            )
        played_at = 1.0 if series.gain is None else series.gain
        title = (
            f"{first.low_Hz:g} to {first.high_Hz:g} Hz, {first.amplitude_A:g} A on {bench.name}, gain {played_at:g}"
        )
        encoder = series.device.encoder
        shown = Monitor(bench.console, title, hello.dt_s, encoder.count_m, encoder.surface_counts)
        with shown, no_long_pauses(), device.heard_by(shown.take):
            try:
                for alike, trials in itertools.groupby(planned, _alike):
                    load(device, loads[alike], bench.console)
                    sweeps = Sweeps(
                        device,
                        bench.hold,
                        commands[alike].size,
                        gain=played_at,
                        grip_N=None if series.as_held else alike.grip_N,
                        count_m=encoder.count_m,
                        assumed_grip_N=settings.assumed_grip_N,
                        patience_s=series.patience_s,
                    )
                    with sweeps, disarmed_by_ctrl_c(device):
                        sweeps.try_out(say)
                        for trial in trials:
                            say(f"trial {len(written) + 1} of {len(planned)}")
                            taken = sweeps.trial(negative=trial.polarity < 0, tell=say)
                            path = next(names)
                            taken.write(
                                path,
                                series.device.accelerometer.bandwidth_Hz,
                                held_out=trial.shape is Shape.TAP,
                                period_s=trial.period_s(settings.dt_s),
                            )
                            written.append((path, taken))
            except StoppedError:
                stopped = True
            except AbortedError as aborted:
                why = str(aborted)
            except LinkLostError as lost:
                raise LinkLostError(f"{lost}; {out}: {len(written)} of {len(planned)} trials, all whole") from None
    console.print(sweep_table(written, title))
    whole = len(written) == len(planned) and series.closing
    files = series.closing if whole else f"{out}: {len(written)} of {len(planned)} trials, all whole"
    console.print(files)
    if stopped:
        typer.echo(STOPPED, err=True)
        raise typer.Exit(130)
    if why:
        console.print(why, style="red")
        raise typer.Exit(1)


def simulated_series(
    out: Path,
    planned: Sequence[PlannedSweep],
    scene: str | None,
    wrong: Imperfections,
    seed: int,
    gain: float | None,
    patience_s: float,
    device: DeviceFile = BUILT_IN,
) -> tuple[Bench, Series]:
    """On a scene's device in a simulated hand: files by purpose, grip and sign, which may join those of other grips.

    Raises
    ------
    InputError : no such scene, or a trial of this name is there.
    """
    truth, purpose = scene_like(scene or DEFAULT_SCENE), planned[0].purpose.value
    terminal.make_folder(out)
    names = [trial.file_name for trial in planned]
    refuse_old(out, names)
    counts = Counter(trial.shape for trial in planned)
    words = f"{counts[Shape.SWEEP]} sweeps of {planned[0].seconds:g} s"
    words += "".join(f", {counts[shape]} {shape.value}s" for shape in (Shape.TAP, Shape.MULTISINE) if counts[shape])
    files = f"{shlex.quote(str(out))}/{purpose}_*.npz"
    like, larger = of_scene(scene) if purpose == "device" else "", ""
    if purpose == "device" and not counts[Shape.TAP]:
        larger = (
            f"\nno current above {planned[0].amplitude_A:g} A was recorded: --tap-current adds taps at the current "
            "that a library plays, by which identify judges there too"
        )
    bench, settings = holding_bench(truth, wrong, seed, max(trial.seconds for trial in planned), device)
    series = Series(
        planned,
        [out / name for name in names],
        lambda _: settings,
        closing=(
            f"{out}: {words}, {names[0]} to {names[-1]}\n"
            f"next: transopt identify {purpose} {files}{like} --out MODEL.json{larger}"
        ),
        gain=gain,
        device=device,
        patience_s=patience_s,
    )
    return bench, series
