"""`transopt-play record`: what a device's sensors say, on a port or from the simulator, in files for `transopt`.

Heavy imports stand inside the commands, so that help and errors come at once.
"""

from pathlib import Path
from typing import Annotated

import typer

from controller.options import numbers, refuse, within
from controller.port_commands import Reset, Seconds
from transopt.errors import InputError

record_app = typer.Typer(no_args_is_help=True, help="Record what a device's sensors say.")
DEFAULT_SCENE = "wood_on_foam"
SIMULATED_ONLY = ("scene", "mismatch", "seed", "crossover")
TAP_SIMULATED_ONLY = ("library", "real_object", "speeds", "grips", "repeats", "force_noise")
TAP_ON_PORT_ONLY = ("taps", "seconds", "trigger", "count_um")
SWEEP_ON_PORT_ONLY = ("gain", "grip", "library", "accelerometer_hz", "count_um", "patience", "reset")

Folder = Annotated[Path, typer.Option(help="Folder for the recordings; must hold none yet.")]
Port = Annotated[str | None, typer.Option(help="On a device: a name that `ports` lists, or socket://HOST:PORT.")]
CountUm = Annotated[float, typer.Option(help="On a device: one encoder count at the tip, in um.")]
Simulate = Annotated[bool, typer.Option("--simulate", help="From the simulator's truth, in virtual time.")]
SceneName = Annotated[str | None, typer.Option(help="Whose device it really is: built-in name or .toml file.")]
Mismatch = Annotated[float, typer.Option(help="Every parameter is off by up to this part; 0.1: 10 %.")]
Seed = Annotated[int, typer.Option(help="Of mismatch and noise.")]
Crossover = Annotated[float, typer.Option(help="Half-width of the amplifier's dead band, in A.")]


def _one_device(what: str, simulate: bool, port: str | None) -> None:
    """
    Raises
    ------
    InputError : none or both are named.
    """
    if simulate == (port is not None):
        raise InputError(
            f"record {what}: name one device: --simulate, or --port PORT (`transopt-play ports` lists them)"
        )


@record_app.callback()
def record() -> None:
    """Record what a device's sensors say: taps while it is idle, excitations while it plays them."""


@record_app.command("sweep")
def record_sweep(
    context: typer.Context,
    out: Folder,
    port: Port = None,
    simulate: Simulate = False,
    purpose: Annotated[str, typer.Option("--for", help="What it identifies: device or amplifier.")] = "device",
    trials: Annotated[int, typer.Option(help="Of each grip and offset, of alternating polarity.")] = 4,
    low: Annotated[
        float | None, typer.Option(help="First frequency in Hz; default 1, free device 20, amplifier 10.")
    ] = None,
    high: Annotated[float | None, typer.Option(help="Last frequency in Hz; default 2000, amplifier 4000.")] = None,
    amplitude: Annotated[float | None, typer.Option(help="In A; default 0.75, amplifier 0.3.")] = None,
    offset: Annotated[
        float | None, typer.Option(help="Of the sine's middle in A; default 0, amplifier simulated both 0 and 0.5.")
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="Of each sweep; default 2.")] = None,
    gain: Annotated[
        float | None,
        typer.Option(help="On a device: scale, 0 to 1; default 1, on its first run since its start 0.1."),
    ] = None,
    grip: Annotated[
        float | None,
        typer.Option(help="On a device: grip in N that you are asked to hold; 0 to let go; default any."),
    ] = None,
    library: Annotated[
        Path | None,
        typer.Option(help="On a device: library.npz whose limits, amplifier and coil hold; else the built-in ones."),
    ] = None,
    accelerometer_hz: Annotated[float, typer.Option(help="On a device: bandwidth of its accelerometer.")] = 2500.0,
    count_um: CountUm = 24.5,
    patience: Annotated[float, typer.Option(help="On a device: how long to wait for your hand, in s.")] = 60.0,
    reset: Reset = False,
    grips: Annotated[
        str | None, typer.Option(help="Simulated: grips in N, 0 the free device; default 1,3,5, for an amplifier 3.")
    ] = None,
    scene: SceneName = None,
    mismatch: Mismatch = 0.0,
    seed: Seed = 0,
    crossover: Crossover = 0.01,
) -> None:
    """Swept sines on a stylus held still: one file per trial, which `transopt identify amplifier|device` reads."""
    from controller.sweep_plan import Purpose, sweep_plan

    _one_device("sweep", simulate, port)
    purposes = [choice.value for choice in Purpose]
    if purpose not in purposes:
        raise InputError(f"--for {purpose}: must be one of {', '.join(purposes)}")
    stated = {"low_Hz": low, "high_Hz": high, "amplitude_A": amplitude, "seconds": seconds}
    if port is not None:
        refuse(context, ("grips", *SIMULATED_ONLY), "only with --simulate")
        from controller.record_on_port import record_sweep_on_port

        held = 1.0 if grip is None else grip
        [first, *_] = sweep_plan(Purpose(purpose), [held], 1, offset_A=offset or 0.0, **stated)
        record_sweep_on_port(
            port,
            out,
            low=first.low_Hz,
            high=first.high_Hz,
            amplitude=first.amplitude_A,
            offset=first.offset_A,
            seconds=first.seconds,
            trials=trials,
            gain=gain,
            grip=grip,
            library=library,
            accelerometer_hz=accelerometer_hz,
            count_um=count_um,
            patience=patience,
            reset=reset,
        )
        return
    refuse(context, SWEEP_ON_PORT_ONLY, "only with --port")
    from controller.record_simulated import simulate_sweeps
    from controller.simulated_device import imperfect

    chosen = numbers("grips", grips, 0.0, 50.0, " N, what a hand does")
    planned = sweep_plan(Purpose(purpose), chosen, trials, offset_A=offset, **stated)
    simulate_sweeps(out, planned, scene or DEFAULT_SCENE, imperfect(mismatch, seed, crossover), seed)


@record_app.command("tap")
def record_tap(
    context: typer.Context,
    out: Folder,
    library: Annotated[
        Path | None, typer.Argument(help="Simulated: library.npz whose taps are played.", show_default=False)
    ] = None,
    port: Port = None,
    simulate: Simulate = False,
    taps: Annotated[int | None, typer.Option(help="On a device: end after so many; default: on Ctrl-C.")] = None,
    seconds: Seconds = None,
    trigger: Annotated[float, typer.Option(help="On a device: acceleration in g that is taken for a contact.")] = 1.0,
    count_um: CountUm = 24.5,
    real_object: Annotated[
        bool, typer.Option("--object", help="Simulated: the undriven device on the scene's object, with force_N.")
    ] = False,
    speeds: Annotated[str | None, typer.Option(help="Simulated: speeds in m/s, like 0.15,0.25.")] = None,
    grips: Annotated[str | None, typer.Option(help="Simulated: grips in N, like 1,3,5.")] = None,
    repeats: Annotated[int, typer.Option(help="Simulated: taps at each speed and grip.")] = 1,
    force_noise: Annotated[float, typer.Option(help="Simulated: rms of the force sensor, in N.")] = 0.02,
    scene: SceneName = None,
    mismatch: Mismatch = 0.0,
    seed: Seed = 0,
    crossover: Crossover = 0.01,
) -> None:
    """Record taps: on a port on a real object, device idle; simulated a library's, or on the scene's object."""
    _one_device("tap", simulate, port)
    if port is not None:
        refuse(context, (*TAP_SIMULATED_ONLY, *SIMULATED_ONLY), "only with --simulate")
        from controller.record_on_port import record_tap_on_port

        record_tap_on_port(port, out, taps=taps, seconds=seconds, trigger=trigger, count_um=count_um)
        return
    refuse(context, TAP_ON_PORT_ONLY, "only with --port")
    if real_object == (library is not None):
        raise InputError("record tap --simulate: name either a LIBRARY whose taps are played, or --object")
    from controller.record_simulated import simulate_library_taps, simulate_object_taps
    from controller.simulated_device import imperfect

    within("repeats", repeats, 1, 1000)
    within("force-noise", force_noise, 0.0, 10.0, " N")
    chosen_grips = numbers("grips", grips, 0.0, 50.0, " N, what a hand does")
    chosen_speeds = numbers("speeds", speeds, 0.03, 4.5, " m/s, what the servo takes for a tap")
    wrong = imperfect(mismatch, seed, crossover)
    if library is None:
        name = scene or DEFAULT_SCENE
        simulate_object_taps(out, name, chosen_speeds, chosen_grips, repeats, wrong, seed, force_noise)
    else:
        simulate_library_taps(out, library, scene, chosen_speeds, chosen_grips, repeats, wrong, seed)


@record_app.command("heat")
def record_heat(
    out: Annotated[Path | None, typer.Option(help="Folder for heat.npz; must hold none yet.")] = None,
    port: Port = None,
    simulate: Simulate = False,
    current: Annotated[
        float | None, typer.Option(help="While heating, in A; default 0.9 of the continuous current.")
    ] = None,
    heating: Annotated[float, typer.Option(help="How long the current flows, in s.")] = 3600.0,
    cooling: Annotated[float, typer.Option(help="How long the coil then cools, in s.")] = 1800.0,
    every: Annotated[float, typer.Option(help="Between two readings, in s.")] = 1.0,
    noise: Annotated[float, typer.Option(help="Rms of the temperatures, in K.")] = 0.5,
    scene: SceneName = None,
    mismatch: Annotated[
        float, typer.Option(help="Thermal resistances and time constants are off by up to this part.")
    ] = 0.0,
    seed: Seed = 0,
) -> None:
    """Heating and cooling of the coil: heat.npz with current, winding and housing for `transopt identify coil`."""
    _one_device("heat", simulate, port)
    if port is not None:
        raise InputError(
            f"record heat: the device on {port} measures neither the coil's voltage nor its temperature: log both, "
            "every second or so, while a constant current flows and while the coil cools, as CSV with the columns "
            "time_s, current_A, voltage_V, winding_C, housing_C, ambient_C (of the temperatures those that you have)"
        )
    if out is None:
        raise InputError("record heat: give a folder: --out DIR")
    from controller.record_simulated import MOST_HEAT_S, simulate_heat

    for name, value in (("heating", heating), ("cooling", cooling)):
        within(name, value, 0.0, MOST_HEAT_S, " s")
    within("every", every, 0.01, 60.0, " s")
    within("noise", noise, 0.0, 50.0, " K")
    within("mismatch", mismatch, 0.0, 0.5, ", the part by which parameters are off")
    within("seed", seed, 0, 2**63 - 1)
    if heating + cooling < 10 * every:
        raise InputError(f"--heating {heating:g}, --cooling {cooling:g}: fewer than ten readings; record longer")
    simulate_heat(out, scene or DEFAULT_SCENE, current, heating, cooling, every, noise, mismatch, seed)
