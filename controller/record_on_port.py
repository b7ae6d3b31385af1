"""`transopt-play record --port`: what the sensors of a device on a port say.

Heavy imports stand inside the commands, so that help and errors come at once.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from controller import port_commands
from controller.port_commands import (
    STOPPED,
    StoppedError,
    connected,
    disarmed_by_ctrl_c,
    ends,
    load,
    no_long_pauses,
    number,
    run,
)
from transopt import terminal
from transopt.errors import InputError

if TYPE_CHECKING:
    from controller.driver import Device
    from controller.sweeps import Trial


def record_tap_on_port(
    port: str, out: Path, *, taps: int | None, seconds: float | None, trigger: float, count_um: float
) -> None:
    """A real object's taps, the device idle: one file each, which `transopt taps` and scenes read."""
    from controller.live import Monitor
    from controller.recorder import Recorder, make_room
    from transopt.signals import STANDARD_GRAVITY_M_S2

    number("trigger", trigger, 0.05, 100.0, " g")
    number("count-um", count_um, 1e-3, 1e4, " um")
    ends(taps, seconds)
    make_room(out)
    console = terminal.console()
    with connected(port) as device:
        dt_s, count_m = device.hello.dt_s, 1e-6 * count_um
        recorder = Recorder(out, dt_s, count_m, trigger_m_s2=trigger * STANDARD_GRAVITY_M_S2)
        shown = Monitor(console, f"recording on {port}", dt_s, count_m)
        stopped = run(
            device, recorder, shown, lambda: taps is not None and len(recorder.contacts) >= taps, seconds, None
        )
    console.print(recorder.in_words().removeprefix("; ") or "nothing came", highlight=False, soft_wrap=True)
    if stopped:
        typer.echo(STOPPED, err=True)
        raise typer.Exit(130)
    if not recorder.contacts:
        raise typer.Exit(1)


def record_sweep_on_port(
    port: str,
    out: Path,
    *,
    low: float,
    high: float,
    amplitude: float,
    offset: float,
    seconds: float,
    trials: int,
    gain: float | None,
    grip: float | None,
    library: Path | None,
    accelerometer_hz: float,
    count_um: float,
    patience: float,
    reset: bool,
) -> None:
    """Swept sines played and what they do: one file per trial."""
    from controller.device_tables import sweep_table
    from controller.driver import LinkLostError
    from controller.excitation import sweep_command
    from controller.first_run import default_gain, remember
    from controller.image import sha256
    from controller.live import Monitor
    from controller.payload import excitation, excitation_settings
    from controller.sweeps import AbortedError, Sweeps, free_numbers

    number("trials", trials, 1, 1000)
    number("accelerometer-hz", accelerometer_hz, 10.0, 1e6, " Hz")
    number("count-um", count_um, 1e-3, 1e4, " um")
    number("patience", patience, 0.1, 3600.0, " s")
    if gain is not None:
        number("gain", gain, 1e-3, 1.0)
    if grip is not None and grip != 0:
        number("grip", grip, 0.5, 50.0, " N, or 0 to let go")
    paths = free_numbers(out, trials)
    console = terminal.console()
    written: list[tuple[Path, Trial]] = []
    why = ""
    with connected(port, reset) as device:
        hello = device.hello
        settings = excitation_settings(hello, library)
        command_A = sweep_command(low, high, seconds, amplitude, settings.dt_s, offset)
        given = excitation(settings, command_A, hello)
        configuration = sha256(given.configuration)
        _need_check(device, configuration, port, library)
        load(device, given)
        played_at = default_gain(hello.boot, configuration) if gain is None else gain
        title = f"{low:g} to {high:g} Hz, {amplitude:g} A on {port}, gain {played_at:g}"
        shown = Monitor(console, title, hello.dt_s, 1e-6 * count_um)
        stopped = False
        sweeps = Sweeps(
            device,
            port_commands.ConsolePerson(),
            command_A.size,
            gain=played_at,
            grip_N=grip,
            count_m=1e-6 * count_um,
            patience_s=patience,
        )

        def told(words: str) -> None:
            console.print(f"  {words}", highlight=False, soft_wrap=True)

        with sweeps, shown, no_long_pauses():
            device.listeners.append(shown.take)
            try:
                with disarmed_by_ctrl_c(device):
                    device.set_telemetry(1)
                    for j, path in enumerate(paths):
                        told(f"trial {j + 1} of {trials}")
                        trial = sweeps.trial(negative=j % 2 == 1, told=told)
                        trial.write(path, accelerometer_hz)
                        written.append((path, trial))
                        remember(hello.boot, configuration)
            except StoppedError:
                stopped = True
            except AbortedError as aborted:
                why = str(aborted)
            except LinkLostError as lost:
                raise LinkLostError(f"{lost}; {out}: {len(written)} of {trials} trials, all whole") from None
            finally:
                device.listeners.remove(shown.take)
    console.print(sweep_table(written, title))
    files = f"{len(written)} of {trials} trials, all whole"
    console.print(f"{out}: {files}", highlight=False, soft_wrap=True)
    if gain is None and played_at < 1:
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
