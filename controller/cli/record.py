"""`transopt-play record`: what a device's sensors say, on a port or from the simulator, in files for `transopt`.

Heavy imports stand inside the commands, so that help and errors come at once.
"""

from pathlib import Path
from typing import Annotated

import typer

from controller.cli.options import imperfect, is_simulated, numbers, within
from controller.cli.port import Reset, Seconds
from transopt.base.errors import InputError

record_app = typer.Typer(no_args_is_help=True, help="Record what a device's sensors say.")
DEFAULT_SCENE = "wood_on_foam"

Folder = Annotated[Path, typer.Option(help="Folder for the recordings; must hold none yet.")]
Simulate = Annotated[bool, typer.Option("--simulate", help="From the simulator's truth, in virtual time.")]
SceneName = Annotated[
    str | None,
    typer.Option("--device", help="Whose device it is, before --mismatch: built-in scene, .toml or library.npz."),
]
Mismatch = Annotated[float, typer.Option(help="Every parameter is off by up to this part; 0.1: 10 %.")]
Seed = Annotated[int, typer.Option(help="Of mismatch and noise.")]
CountUm = Annotated[float, typer.Option(help="On a device: one encoder count at the tip, in um.")]
Crossover = Annotated[float, typer.Option(help="Half-width of the amplifier's dead band, in A.")]


@record_app.callback()
def record() -> None:
    """Record what a device's sensors say."""


@record_app.command("sweep")
def record_sweep(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="Folder for the trials; none is written over.")],
    simulate: Simulate = False,
    port: Annotated[str | None, typer.Option(help="On a device: a name that `ports` lists.")] = None,
    purpose: Annotated[str, typer.Option("--for", help="What it identifies: device or amplifier.")] = "device",
    grips: Annotated[
        str | None,
        typer.Option(help="Grips in N, 0 to let go; default 1,3,5, for an amplifier 3, on a port as you hold it."),
    ] = None,
    trials: Annotated[int, typer.Option(help="Of each grip and offset, of alternating polarity.")] = 4,
    low: Annotated[
        float | None, typer.Option(help="First frequency in Hz; default 1, free device 20, amplifier 10.")
    ] = None,
    high: Annotated[float | None, typer.Option(help="Last frequency in Hz; default 2000, amplifier 4000.")] = None,
    amplitude: Annotated[float | None, typer.Option(help="In A; default 0.75, amplifier 0.3.")] = None,
    offset: Annotated[
        float | None, typer.Option(help="Of the sine's middle in A; default 0, amplifier both 0 and 0.5.")
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="Of each sweep; default 2.")] = None,
    scene: SceneName = None,
    mismatch: Mismatch = 0.0,
    seed: Seed = 0,
    crossover: Crossover = 0.01,
    gain: Annotated[
        float | None,
        typer.Option(
            help="On a device: scale of what is played, 0 to 1; default 1, on its first run since start 0.1."
        ),
    ] = None,
    library: Annotated[
        Path | None, typer.Option(help="On a device: whose limits, amplifier and coil hold; else the built-in ones.")
    ] = None,
    accelerometer_hz: Annotated[float, typer.Option(help="On a device: bandwidth of its accelerometer.")] = 2500.0,
    count_um: CountUm = 24.5,
    patience: Annotated[float, typer.Option(help="On a device: how long to wait for your hand, in s.")] = 60.0,
    reset: Reset = False,
) -> None:
    """Swept sines on a stylus held still: one NPZ per trial, which `transopt identify amplifier|device` reads."""
    from controller.record.sweep_plan import Purpose, sweep_plan

    simulated = is_simulated(context, "record sweep", simulate, port)
    purposes = [choice.value for choice in Purpose]
    if purpose not in purposes:
        raise InputError(f"--for {purpose}: must be one of {', '.join(purposes)}")
    planned = sweep_plan(
        Purpose(purpose),
        numbers("grips", grips, 0.0, 50.0, " N, what a hand does"),
        trials,
        low_Hz=low,
        high_Hz=high,
        amplitude_A=amplitude,
        offset_A=offset,
        seconds=seconds,
    )
    if simulated:
        from controller.cli.record_simulated import simulate_sweeps

        simulate_sweeps(out, planned, scene or DEFAULT_SCENE, imperfect(mismatch, seed, crossover), seed)
        return
    from controller.cli.record_on_port import SweepBench, sweep_on_port

    assert port is not None
    within("accelerometer-hz", accelerometer_hz, 10.0, 1e6, " Hz")
    within("count-um", count_um, 1e-3, 1e4, " um")
    within("patience", patience, 0.1, 3600.0, " s")
    if gain is not None:
        within("gain", gain, 1e-3, 1.0)
    if grips is None:
        # One series, however the stylus is held.
        planned = [trial for trial in planned if trial.grip_N == planned[-1].grip_N]
    for grip in {trial.grip_N for trial in planned} - {0.0}:
        within("grips", grip, 0.5, 50.0, " N, or 0 to let go")
    bench = SweepBench(gain, library, accelerometer_hz, 1e-6 * count_um, patience, reset)
    sweep_on_port(port, planned, out, bench, as_held=grips is None)


@record_app.command("tap")
def record_tap(
    context: typer.Context,
    out: Folder,
    library: Annotated[
        Path | None, typer.Argument(help="Simulated: library.npz whose taps are played.", show_default=False)
    ] = None,
    port: Annotated[str | None, typer.Option(help="On a device, idle: a name that `ports` lists.")] = None,
    simulate: Simulate = False,
    taps: Annotated[int | None, typer.Option(help="On a device: end after so many; default: on Ctrl-C.")] = None,
    seconds: Seconds = None,
    trigger: Annotated[float, typer.Option(help="On a device: acceleration in g that is taken for a contact.")] = 1.0,
    count_um: CountUm = 24.5,
    real_object: Annotated[
        bool, typer.Option("--object", help="Simulated: the undriven device on the scene's object, with force_N.")
    ] = False,
    speeds: Annotated[
        str | None, typer.Option(help="Simulated: speeds in m/s, like 0.15,0.25; default the grid's.")
    ] = None,
    grips: Annotated[
        str | None,
        typer.Option(
            help="Simulated: grips in N, like 1,3,5; default the library's, or the one of the scene's taps."
        ),
    ] = None,
    repeats: Annotated[
        int,
        typer.Option(
            help="Simulated: taps at each speed and grip; `transopt identify hand` wants 12 or more in all."
        ),
    ] = 1,
    force_noise: Annotated[float, typer.Option(help="Simulated: rms of the force sensor, in N.")] = 0.02,
    scene: SceneName = None,
    mismatch: Mismatch = 0.0,
    seed: Seed = 0,
    crossover: Crossover = 0.01,
) -> None:
    """Record taps: on a port on a real object, device idle; simulated a library's, or on the scene's object."""
    if not is_simulated(context, "record tap", simulate, port):
        from controller.cli.record_on_port import tap_on_port

        assert port is not None
        within("trigger", trigger, 0.05, 100.0, " g")
        within("count-um", count_um, 1e-3, 1e4, " um")
        tap_on_port(port, out, taps=taps, seconds=seconds, trigger=trigger, count_um=count_um)
        return
    if real_object == (library is not None):
        raise InputError("record tap --simulate: name either a LIBRARY whose taps are played, or --object")
    from controller.cli.record_simulated import simulate_library_taps, simulate_object_taps

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
    out: Annotated[
        Path | None, typer.Option(help="Folder for the recording; must hold none yet. Needed with --simulate.")
    ] = None,
    simulate: Simulate = False,
    port: Annotated[str | None, typer.Option(help="Says how a device's heating is recorded.")] = None,
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
    from controller.cli.record_simulated import MOST_HEAT_S, simulate_heat

    if not simulate:
        raise InputError(
            f"record heat: name the device: --simulate; {port or 'a device on a port'} measures neither the coil's "
            "voltage nor its temperature: log both, every second or so, while a constant current flows and while the "
            "coil cools, as CSV with the columns time_s, current_A, voltage_V, winding_C, housing_C, ambient_C (of "
            "the temperatures those that you have)"
        )
    if port is not None or out is None:
        raise InputError("record heat: give --simulate and --out DIR, and no --port")
    for name, value in (("heating", heating), ("cooling", cooling)):
        within(name, value, 0.0, MOST_HEAT_S, " s")
    within("every", every, 0.01, 60.0, " s")
    within("noise", noise, 0.0, 50.0, " K")
    within("mismatch", mismatch, 0.0, 0.5, ", the part by which parameters are off")
    within("seed", seed, 0, 2**63 - 1)
    if heating + cooling < 10 * every:
        raise InputError(f"--heating {heating:g}, --cooling {cooling:g}: fewer than ten readings; record longer")
    simulate_heat(out, scene or DEFAULT_SCENE, current, heating, cooling, every, noise, mismatch, seed)
