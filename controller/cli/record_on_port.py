"""`transopt-play record --port`: what a device's sensors say, to files that `transopt` reads."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import typer

from controller.cli import port as port_commands
from controller.cli.port import STOPPED, StoppedError, connected, disarmed_by_ctrl_c, ends, load, no_long_pauses
from controller.cli.tables import sweep_table
from controller.host.driver import Device, LinkLostError
from controller.host.first_run import default_gain, remember
from controller.host.monitor import Monitor
from controller.host.payload import excitation, excitation_settings
from controller.host.sweeps import AbortedError, Sweeps, Trial, free_numbers
from controller.protocol.image import sha256
from controller.record.recorder import Recorder, make_room
from controller.record.sweep_plan import PlannedSweep
from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2


@dataclass(frozen=True)
class SweepBench:
    """How sweeps are played on a port.

    Attributes
    ----------
    gain : scale of what is played; None for 1, on a device's first run since its start 0.1.
    library : whose limits, amplifier and coil hold; None for the built-in ones.
    accelerometer_Hz : its bandwidth.
    count_m : one encoder count at the tip.
    patience_s : with a hand.
    reset : a latched fault first.
    """

    gain: float | None
    library: Path | None
    accelerometer_Hz: float
    count_m: float
    patience_s: float
    reset: bool


def tap_on_port(
    port: str, out: Path, *, taps: int | None, seconds: float | None, trigger: float, count_um: float
) -> None:
    """A real object's taps, the device idle: one file each, which `transopt taps` and scenes read."""
    ends(taps, seconds)
    make_room(out)
    console = terminal.console()
    with connected(port) as device:
        dt_s, count_m = device.hello.dt_s, 1e-6 * count_um
        recorder = Recorder(out, dt_s, count_m, trigger_m_s2=trigger * STANDARD_GRAVITY_M_S2)
        shown = Monitor(console, f"recording on {port}", dt_s, count_m)
        stopped = port_commands.run(
            device, recorder, shown, lambda: taps is not None and len(recorder.contacts) >= taps, seconds, None
        )
    console.print(recorder.in_words().removeprefix("; ") or "nothing came", highlight=False, soft_wrap=True)
    if stopped:
        typer.echo(STOPPED, err=True)
        raise typer.Exit(130)
    if not recorder.contacts:
        raise typer.Exit(1)


def _alike(trial: PlannedSweep) -> PlannedSweep:
    """What the device holds of a trial: the other sign is its own business."""
    return replace(trial, polarity=1, number=1)


def sweep_on_port(port: str, planned: Sequence[PlannedSweep], out: Path, bench: SweepBench, *, as_held: bool) -> None:
    """Trial after trial, one file each; the person at the device is asked for each grip, unless it is `as_held`.

    Raises
    ------
    InputError : the device will not take it. typer.Exit : not every trial was had.
    """
    paths = free_numbers(out, len(planned))
    console = terminal.console()
    written: list[tuple[Path, Trial]] = []
    why = ""

    def say(words: str) -> None:
        console.print(f"  {words}", highlight=False, soft_wrap=True)

    with connected(port, bench.reset) as device:
        hello = device.hello
        settings = excitation_settings(hello, bench.library)
        commands = {alike: alike.command(settings.dt_s) for alike in map(_alike, planned)}
        # All of them are tried before any of them is played.
        loads = {alike: excitation(settings, command, hello) for alike, command in commands.items()}
        configuration = sha256(next(iter(loads.values())).configuration)
        _need_check(device, configuration, port, bench.library)
        played_at = default_gain(hello.boot, configuration) if bench.gain is None else bench.gain
        first = planned[0]
        title = f"{first.low_Hz:g} to {first.high_Hz:g} Hz, {first.amplitude_A:g} A on {port}, gain {played_at:g}"
        shown = Monitor(console, title, hello.dt_s, bench.count_m)
        stopped = False
        names = iter(paths)
        with shown, no_long_pauses():
            device.listeners.append(shown.take)
            try:
                for alike, trials in itertools.groupby(planned, _alike):
                    load(device, loads[alike], console)
                    sweeps = Sweeps(
                        device,
                        port_commands.ConsolePerson(),
                        commands[alike].size,
                        gain=played_at,
                        grip_N=None if as_held else alike.grip_N,
                        count_m=bench.count_m,
                        patience_s=bench.patience_s,
                    )
                    with sweeps, disarmed_by_ctrl_c(device):
                        device.set_telemetry(1)
                        for trial in trials:
                            say(f"trial {len(written) + 1} of {len(planned)}")
                            taken = sweeps.trial(negative=trial.polarity < 0, tell=say)
                            path = next(names)
                            taken.write(path, bench.accelerometer_Hz)
                            written.append((path, taken))
                            remember(hello.boot, configuration)
            except StoppedError:
                stopped = True
            except AbortedError as aborted:
                why = str(aborted)
            except LinkLostError as lost:
                raise LinkLostError(f"{lost}; {out}: {len(written)} of {len(planned)} trials, all whole") from None
            finally:
                device.listeners.remove(shown.take)
    console.print(sweep_table(written, title))
    files = f"{len(written)} of {len(planned)} trials, all whole"
    console.print(f"{out}: {files}", highlight=False, soft_wrap=True)
    if bench.gain is None and played_at < 1:
        console.print(
            f"gain {played_at:g}: the first run since the device's start; the next one plays in full",
            highlight=False,
            soft_wrap=True,
        )
    if stopped:
        typer.echo(STOPPED, err=True)
        raise typer.Exit(130)
    if why:
        console.print(why, style="red", highlight=False, soft_wrap=True)
        raise typer.Exit(1)


def _need_check(device: "Device", configuration_sha256: bytes, port: str, library: Path | None) -> None:
    """
    Raises
    ------
    InputError : the device would not arm.
    """
    if device.hello.checked_sha256 != configuration_sha256:
        given = "" if library is None else f" {library}"
        raise InputError(
            f"{port}: sweeps under these limits have not passed the bring-up check since the device started: run "
            f"`transopt-play check --sweep --port {port}{given}`"
        )
