"""`transopt-play record`: what a device's sensors say, to files that `transopt taps` and `transopt identify` read.

Heavy imports stand inside the commands, so that help and errors come at once.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from controller import port_commands
from controller.port_commands import (
    STOPPED,
    Port,
    Reset,
    Seconds,
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

record_app = typer.Typer(no_args_is_help=True, help="Record what a device's sensors say.")
CountUm = Annotated[float, typer.Option(help="One encoder count at the tip, in um.")]


@record_app.callback()
def record() -> None:
    """Record what a device's sensors say: taps while it is idle, excitations while it plays them."""


@record_app.command("tap")
def record_tap(
    port: Port,
    out: Annotated[Path, typer.Option(help="Folder for the recordings; must hold none yet.")],
    taps: Annotated[int | None, typer.Option(help="End after so many; default: on Ctrl-C.")] = None,
    seconds: Seconds = None,
    trigger: Annotated[float, typer.Option(help="Acceleration in g that is taken for a contact.")] = 1.0,
    count_um: CountUm = 24.5,
) -> None:
    """Record taps on a real object, device idle: one file each, which `transopt taps` and scenes read."""
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


@record_app.command("sweep")
def record_sweep(
    port: Port,
    out: Annotated[Path, typer.Option(help="Folder for the trials; numbered on from those that are there.")],
    low: Annotated[float, typer.Option(help="Lowest frequency in Hz.")] = 1.0,
    high: Annotated[float, typer.Option(help="Highest frequency in Hz.")] = 2000.0,
    amplitude: Annotated[float, typer.Option(help="Of the sine, in A.")] = 0.75,
    offset: Annotated[float, typer.Option(help="Of its middle, in A.")] = 0.0,
    seconds: Annotated[float, typer.Option(help="Of one trial.")] = 2.0,
    trials: Annotated[int, typer.Option(help="How many; every other one has the other sign.")] = 4,
    gain: Annotated[
        float | None,
        typer.Option(help="Scale of what is played, 0 to 1; default 1, on a device's first run since its start 0.1."),
    ] = None,
    grip: Annotated[
        float | None, typer.Option(help="Grip in N that you are asked to hold; 0 to let go; default: any.")
    ] = None,
    library: Annotated[
        Path | None, typer.Option(help="library.npz whose limits, amplifier and coil hold; else the built-in ones.")
    ] = None,
    accelerometer_hz: Annotated[float, typer.Option(help="Bandwidth of the device's accelerometer.")] = 2500.0,
    count_um: CountUm = 24.5,
    patience: Annotated[float, typer.Option(help="How long to wait for your hand before a trial, in s.")] = 60.0,
    reset: Reset = False,
) -> None:
    """Play swept sines and record what they do: one file per trial, which `transopt identify` reads."""
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


@record_app.command("heat")
def record_heat(port: Port) -> None:
    """Say how to record a motor's heating: no device on a port measures it."""
    raise InputError(
        f"record heat: the device on {port} measures neither the coil's voltage nor its temperature: log both, "
        "every second or so, while a constant current flows and while the coil cools, as CSV with the columns "
        "time_s, current_A, voltage_V, winding_C, housing_C, ambient_C (of the temperatures those that you have)"
    )
