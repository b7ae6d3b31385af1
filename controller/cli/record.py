"""`transopt-play record`: what a device's sensors say, on a port or simulated, in files for `transopt`.

Heavy imports stand inside the commands, so that help and errors come at once.
"""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from controller.cli import options
from transopt.base import terminal
from transopt.base.errors import InputError

record_app = typer.Typer(
    no_args_is_help=True,
    help="Record what a device's sensors say.",
    epilog="Example: transopt-play record sweep --simulate --out sweeps",
)
MOST_HEAT_S = 24 * 3600.0

Folder = Annotated[Path, typer.Option(help="Folder for the recordings; must hold none yet.")]


@record_app.callback()
def record() -> None:
    """Record what a device's sensors say."""


@record_app.command("sweep", epilog="Example: transopt-play record sweep --simulate --out sweeps")
def record_sweep(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="Folder for the trials; none is written over.")],
    simulate: options.Simulate = False,
    port: options.AnyPort = None,
    purpose: Annotated[str, typer.Option("--for", help="What it identifies: device or amplifier.")] = "device",
    grips: Annotated[
        str | None,
        typer.Option(help="Grips in N, 0 to let go; default 1,3,5, for an amplifier 3, on a port as you hold it."),
    ] = None,
    trials: Annotated[int, typer.Option(help="Trials of each grip and offset, of alternating polarity.")] = 4,
    low: Annotated[
        float | None, typer.Option(help="First frequency in Hz; default 1, free device 20, amplifier 10.")
    ] = None,
    high: Annotated[float | None, typer.Option(help="Last frequency in Hz; default 2000, amplifier 4000.")] = None,
    amplitude: Annotated[float | None, typer.Option(help="In A; default 0.75, amplifier 0.3.")] = None,
    offset: Annotated[
        float | None, typer.Option(help="Middle of the sine in A; default 0, amplifier both 0 and 0.5.")
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="Length of each sweep; default 2.")] = None,
    tap_current: Annotated[
        float | None,
        typer.Option(
            help="Peak in A of taps at each grip besides, and of a multisine at half of it: identify judges by them."
        ),
    ] = None,
    gain: options.Gain = None,
    patience: Annotated[float, typer.Option(help="How long to wait for the hand, in s.")] = 60.0,
    library: Annotated[
        Path | None, options.with_port("Whose limits, amplifier and coil hold; else the built-in ones.")
    ] = None,
    device: options.DeviceName = None,
    reset: options.Reset = False,
    scene: options.TrueDeviceName = None,
    mismatch: options.Mismatch = 0.0,
    seed: options.Seed = 0,
    crossover: options.Crossover = 0.01,
) -> None:
    """Swept sines on a stylus held still: one NPZ per trial, which `transopt identify amplifier|device` reads.

    Exit 1: a trial could not be recorded whole.
    """
    from controller.record.sweep_plan import Purpose, sweep_plan

    simulated = options.is_simulated(context, "record sweep", simulate, port)
    options.one_of("for", purpose, (choice.value for choice in Purpose))
    planned = sweep_plan(
        Purpose(purpose),
        options.numbers("grips", grips, 0.0, 50.0, " N, what a hand does"),
        trials,
        low_Hz=low,
        high_Hz=high,
        amplitude_A=amplitude,
        offset_A=offset,
        seconds=seconds,
        tap_A=tap_current,
    )
    if tap_current is not None:
        options.within("tap-current", tap_current, 0.01, 100.0, " A")
    options.within("patience", patience, 0.1, 3600.0, " s")
    options.within("gain", gain, 1e-3, 1.0)
    from controller.cli.describe import described
    from controller.cli.record_sweeps import Series, record_sweeps, simulated_series

    found = described(device, library, quiet=simulated)
    if simulated:
        wrong = options.imperfect(found.device, mismatch, seed, crossover)
        bench, series = simulated_series(out, planned, scene, wrong, seed, gain, patience, found.device)
        record_sweeps(bench, series)
        return
    from controller.cli.port import person_at
    from controller.host.kept import measured_pulse
    from controller.host.payload import excitation_settings
    from controller.host.sweeps import free_numbers

    assert port is not None
    if grips is None:
        # One series, however the stylus is held.
        planned = [trial for trial in planned if trial.grip_N == planned[-1].grip_N]
    for grip in {trial.grip_N for trial in planned} - {0.0}:
        options.within("grips", grip, 0.5, 50.0, " N, or 0 to let go")
    series = Series(
        planned,
        free_numbers(out, len(planned)),
        lambda hello: excitation_settings(hello, library, found.device, measured_pulse(hello.configuration_sha256)),
        remedy=f"--port {port}"
        + ("" if library is None else f" {library}")
        + ("" if device is None else f" --device {device}"),
        gain=gain,
        as_held=grips is None,
        device=found.device,
        patience_s=patience,
        reset=reset,
    )
    record_sweeps(person_at(port), series)


@record_app.command("tap", epilog="Example: transopt-play record tap --simulate --object --out taps")
def record_tap(
    context: typer.Context,
    out: Folder,
    library: Annotated[
        Path | None,
        typer.Argument(
            help="library.npz whose taps are played.", show_default=False, rich_help_panel=options.ON_THE_SIMULATOR
        ),
    ] = None,
    port: options.AnyPort = None,
    simulate: options.Simulate = False,
    trigger: Annotated[
        float, typer.Option(help="Acceleration in g that is taken for a contact with a real object.")
    ] = 1.0,
    taps: options.TapCount = None,
    seconds: options.Seconds = None,
    device: options.DeviceName = None,
    real_object: Annotated[
        bool, options.with_simulate("The undriven device on the scene's object, with force_N.", "--object")
    ] = False,
    speeds: Annotated[str | None, options.with_simulate("Speeds in m/s, like 0.15,0.25; default the grid's.")] = None,
    grips: Annotated[
        str | None,
        options.with_simulate("Grips in N, like 1,3,5; default the library's or that of the scene's taps."),
    ] = None,
    repeats: Annotated[
        int, options.with_simulate("Taps at each speed and grip; `transopt identify hand` wants 12 or more in all.")
    ] = 1,
    force_noise: Annotated[float, options.with_simulate("Rms of the force sensor, in N.")] = 0.02,
    scene: options.TrueDeviceName = None,
    mismatch: options.Mismatch = 0.0,
    seed: options.Seed = 0,
    crossover: options.Crossover = 0.01,
) -> None:
    """Record taps: on a real object, device idle, or simulated those of a library.

    Exit 1: a fault or a lost lease, or no tap was heard.
    """
    options.within("trigger", trigger, 0.05, 100.0, " g")
    options.within("taps", taps, 1, 1_000_000)
    options.within("for", seconds, 0.0, 1e9, " s")
    if not options.is_simulated(context, "record tap", simulate, port):
        from controller.cli.describe import described
        from controller.cli.port import person_at
        from controller.cli.record_taps import taps_by_a_person
        from transopt.base.signals import STANDARD_GRAVITY_M_S2

        assert port is not None
        trigger_m_s2 = trigger * STANDARD_GRAVITY_M_S2
        taps_by_a_person(person_at(port), out, trigger_m_s2, described(device).device, taps, seconds)
        return
    if real_object == (library is not None):
        raise InputError("record tap --simulate: name either a LIBRARY whose taps are played, or --object")
    from controller.cli.describe import described
    from controller.cli.record_taps import Wanted, taps_of_library, taps_on_object

    options.within("repeats", repeats, 1, 1000)
    options.within("force-noise", force_noise, 0.0, 10.0, " N")
    chosen_grips = options.numbers("grips", grips, 0.0, 50.0, " N, what a hand does")
    chosen_speeds = options.numbers("speeds", speeds, 0.03, 4.5, " m/s, what the servo takes for a tap")
    found = described(device, library, quiet=True)
    wrong = options.imperfect(found.device, mismatch, seed, crossover)
    wanted = Wanted(out, chosen_speeds, chosen_grips, repeats, wrong, seed, found.device)
    if library is None:
        taps_on_object(wanted, scene or options.DEFAULT_SCENE, trigger, force_noise)
    else:
        taps_of_library(wanted, library, scene)


@record_app.command("heat", epilog="Example: transopt-play record heat --simulate --out heat")
def record_heat(
    out: Annotated[
        Path | None, typer.Option(help="Folder for the recording; must hold none yet. Needed with --simulate.")
    ] = None,
    simulate: options.Simulate = False,
    port: Annotated[str | None, typer.Option(help="Says how a device's heating is recorded.")] = None,
    current: Annotated[
        float | None, typer.Option(help="While heating, in A; default 0.9 of the continuous current.")
    ] = None,
    heating: Annotated[float, typer.Option(help="How long the current flows, in s.")] = 3600.0,
    cooling: Annotated[float, typer.Option(help="How long the coil then cools, in s.")] = 1800.0,
    every: Annotated[float, typer.Option(help="Between two readings, in s.")] = 1.0,
    noise: Annotated[float, typer.Option(help="Rms of the temperatures, in K.")] = 0.5,
    scene: options.TrueDeviceName = None,
    mismatch: Annotated[
        float, typer.Option(help="Thermal resistances and time constants are off by up to this part.")
    ] = 0.0,
    seed: options.Seed = 0,
) -> None:
    """Heating and cooling of the coil: heat.npz with current, winding and housing for `transopt identify coil`."""
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
        options.within(name, value, 0.0, MOST_HEAT_S, " s")
    options.within("every", every, 0.01, 60.0, " s")
    options.within("noise", noise, 0.0, 50.0, " K")
    options.within("mismatch", mismatch, 0.0, 0.5, ", the part by which parameters are off")
    options.within("seed", seed, 0, 2**63 - 1)
    if heating + cooling < 10 * every:
        raise InputError(f"--heating {heating:g}, --cooling {cooling:g}: fewer than ten readings; record longer")
    from controller.record.trial_file import refuse_old, write_measurement
    from controller.sim.heating import heat_record, true_coil
    from controller.sim.simulator import scene_like

    truth = scene_like(scene or options.DEFAULT_SCENE)
    coil, limits = truth.coil(), truth.limits
    if coil is None:
        raise InputError(
            f"record heat: {truth.name}: a current drives no winding with thermal data; give another --true-device"
        )
    continuous = min(limits.steady_input, coil.continuous_current_A() - coil.ripple_A)  # the ripple heats beside it
    amount = 0.9 * continuous if current is None else current
    options.within("current", amount, 0.0, limits.transient_input, " A")
    terminal.make_folder(out)
    refuse_old(out, ["heat.npz"])
    coil = true_coil(coil, mismatch, seed)
    columns = heat_record(coil, amount, heating, cooling, every, noise_K=noise, seed=seed)
    write_measurement(out / "heat.npz", columns, {})
    terminal.console().print(
        f"{out}: heat.npz, {heating:g} s at {amount:g} A and {cooling:g} s of cooling, winding at most "
        f"{columns['winding_C'].max():.1f} °C\n"
        f"next: transopt identify coil {shlex.quote(f'{out}/heat.npz')}{options.of_scene(scene)} --out MODEL.json"
    )
