"""The runtime's command line (DESIGN 10): play a library's taps.

Exit codes: 0 done, 1 a result fell short (a fault, or nothing was played), 2 bad input. Heavy imports stand inside
the commands, so that help and errors come at once.
"""

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from controller.cli import port as port_commands
from controller.cli import record as record_commands
from controller.cli import refine as refine_command
from controller.cli.options import refuse, within
from transopt.base import console as terminal
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from transopt.library.library import Library

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Play a library of transients.",
)
app.command()(port_commands.ports)
app.command()(port_commands.upload)
app.command()(port_commands.monitor)
app.command()(port_commands.check)
app.command()(refine_command.refine)
app.add_typer(record_commands.record_app, name="record")
ONLY_SIMULATED = ("speed", "grip", "method", "seed", "mismatch", "device", "crossover", "user", "real_time")
ONLY_ON_PORT = ("taps", "seconds", "accelerometer_hz", "reset")


@app.callback()
def play() -> None:
    """Play a library of transients."""


def _middle(library: "Library", speed_m_s: float | None, grip_N: float | None) -> tuple[float, float]:
    """What was asked for, or the grid's middle node."""
    speeds, grips = library.speeds_m_s, library.grips_N
    speed = float(speeds[speeds.size // 2]) if speed_m_s is None else speed_m_s
    return speed, float(grips[grips.size // 2]) if grip_N is None else grip_N


@app.command()
def tap(
    context: typer.Context,
    library: Annotated[Path, typer.Argument(help="library.npz")],
    simulate: Annotated[bool, typer.Option("--simulate", help="On the simulator, in virtual time.")] = False,
    port: Annotated[str | None, typer.Option(help="On a device: a name that `ports` lists.")] = None,
    speed: Annotated[float | None, typer.Option(help="Incoming speed in m/s; default the grid's middle.")] = None,
    grip: Annotated[float | None, typer.Option(help="Grip in N; default the grid's middle.")] = None,
    gain: Annotated[
        float | None,
        typer.Option(help="Scale of what is played, 0 to 1; default 1, on a device's first run since its start 0.1."),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            help="How taps are rendered: bilinear, online (solved anew for each tap), nearest, blind, proportional, "
            "decaying-sinusoid, fixed-width-pulse, momentum-cancellation, seed-inversion, clipped-optimum."
        ),
    ] = "bilinear",
    seed: Annotated[int, typer.Option(help="Of phase, noise and mismatch.")] = 0,
    mismatch: Annotated[float, typer.Option(help="Every parameter is off by up to this part; 0.1: 10 %.")] = 0.0,
    device: Annotated[
        str | None,
        typer.Option(
            help="True device of the simulator, before --mismatch: built-in scene, .toml or library.npz; "
            "default the library's own model."
        ),
    ] = None,
    crossover: Annotated[float, typer.Option(help="Half-width of the amplifier's dead band, in A.")] = 0.01,
    user: Annotated[str, typer.Option(help="mild, yielding, stopping or recorded.")] = "mild",
    real_time: Annotated[bool, typer.Option("--real-time", help="Paced by the clock, to watch telemetry.")] = False,
    taps: Annotated[int | None, typer.Option(help="On a device: end after so many; default on Ctrl-C.")] = None,
    seconds: port_commands.Seconds = None,
    accelerometer_hz: Annotated[float, typer.Option(help="On a device: bandwidth of its accelerometer.")] = 2500.0,
    reset: port_commands.Reset = False,
    out: Annotated[Path | None, typer.Option(help="Folder for figure and telemetry.")] = None,
) -> None:
    """Play taps and say how well: latency, error, peak, on the simulator also spectrum, hardness, temperature."""
    if simulate == (port is not None):
        raise InputError("tap: name one device: --simulate, or --port PORT (`transopt-play ports` lists them)")
    if port is not None:
        refuse(context, ONLY_SIMULATED, "on a device that is up to its user: only with --simulate")
        port_commands.tap_on_port(
            library,
            port,
            gain=gain,
            out=out,
            taps=taps,
            seconds=seconds,
            accelerometer_Hz=accelerometer_hz,
            reset=reset,
        )
        return
    refuse(context, ONLY_ON_PORT, "only with --port")
    gain = 1.0 if gain is None else gain
    from controller.cli.simulated_tables import tap_table
    from controller.record.telemetry import Telemetry
    from controller.servo.interface import Notice
    from controller.servo.loop import WallClock
    from controller.servo.servo import Servo
    from controller.servo.settings import Settings
    from controller.sim.chosen_device import scene_like
    from controller.sim.experiment import Tap, play_tap
    from controller.sim.simulator import Imperfections
    from controller.sim.true_device import device_of
    from controller.sim.user import Habit
    from controller.waveforms.bank import Bank, Method, bank
    from controller.waveforms.prediction import scene_of
    from transopt.library.file import load_library

    methods, habits = [choice.value for choice in Method], [choice.value for choice in Habit]
    if method not in methods:
        raise InputError(f"--method {method}: must be one of {', '.join(methods)}")
    if user not in habits:
        raise InputError(f"--user {user}: must be one of {', '.join(habits)}")
    within("gain", gain, 0.0, 1.0, "")
    within("mismatch", mismatch, 0.0, 0.5, ", the part by which parameters are off")
    within("crossover", crossover, 0.0, 1.0, " A")
    within("seed", seed, 0, 2**63 - 1, "")
    loaded = load_library(library)
    speed_m_s, grip_N = _middle(loaded, speed, grip)
    settings = Settings.of(loaded, amplifier_tolerance=mismatch)
    within("speed", speed_m_s, 0.03, 0.9 * settings.fastest_m_s, " m/s, what the servo takes for a tap")
    within("grip", grip_N, 0.0, 50.0, " N, what a hand does")
    if settings.assumed_grip_N == 0 and grip_N > 0:
        raise InputError(f"--grip {grip_N:g}: this library is of the free device, which nobody holds: give --grip 0")
    if method == Method.PROPORTIONAL.value and settings.wall is None:
        raise InputError("--method proportional: plays a wall's feedback alone, and this library has no wall")
    truth = device_of(scene_of(loaded) if device is None else scene_like(device))
    if out is not None:
        terminal.make_folder(out)
    table: Bank = bank(loaded, Method(method))
    if method == Method.ONLINE.value:
        from controller.waveforms.online_bank import fresh

        table = fresh(loaded, table)
    servo = Servo(settings, table)
    servo.set_gain(gain)
    wanted = Tap(
        speed_m_s,
        grip_N,
        gain=gain,
        habit=Habit(user),
        seed=seed,
        imperfections=Imperfections(mismatch=mismatch, crossover_A=crossover),
    )
    with nullcontext() if out is None else Telemetry(out, loaded.meta["dt_s"]) as telemetry:
        played = play_tap(
            loaded,
            servo,
            wanted,
            observe=None if telemetry is None else telemetry.record,
            clock=WallClock() if real_time else None,
            device=truth,
        )
    console = terminal.console()
    title = f"{library}: {speed_m_s:g} m/s, {grip_N:g} N, {method}, {user} user"
    title += "" if device is None else f", on the device of {device}"
    console.print(tap_table(played, loaded, title))
    if real_time:
        console.print(f"fell behind the clock by {played.behind_s * 1e3:.1f} ms at most", highlight=False)
    if out is not None:
        from controller.cli.tap_figure import tap_figure
        from controller.record.telemetry import CSV_NAME, NPZ_NAME
        from transopt.base.plotting import save_figure

        save_figure(tap_figure(played), out / "tap.png")
        console.print(f"{out}: tap.png, {CSV_NAME}, {NPZ_NAME}", highlight=False, soft_wrap=True)
    if played.metrics.faults or not played.metrics.played or not played.metrics.notices.get(Notice.CONTACT):
        raise typer.Exit(1)


def main() -> None:
    """Entry point."""
    terminal.run(app)
