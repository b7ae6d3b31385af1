"""`transopt-play record`: what a device's sensors say, on a port or from the simulator, in files for `transopt`.

Heavy imports stand inside the commands, so that help and errors come at once.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from controller import port_commands
from controller.options import numbers, refuse, within
from transopt import terminal
from transopt.errors import InputError

if TYPE_CHECKING:
    from controller.simulator import Imperfections
    from controller.truth import Device
    from transopt.scene import Scene

record_app = typer.Typer(no_args_is_help=True, help="Record what a device's sensors say.")
DEFAULT_SCENE = "wood_on_foam"
ON_PORT_ONLY = ("taps", "seconds", "trigger", "count_um")
SIMULATED_ONLY = (
    "library",
    "real_object",
    "speeds",
    "grips",
    "repeats",
    "force_noise",
    "scene",
    "mismatch",
    "seed",
    "crossover",
)

Folder = Annotated[Path, typer.Option(help="Folder for the recordings; must hold none yet.")]
Simulate = Annotated[bool, typer.Option("--simulate", help="From the simulator's truth, in virtual time.")]
SceneName = Annotated[str | None, typer.Option(help="Whose device it really is: built-in name or .toml file.")]
Mismatch = Annotated[float, typer.Option(help="Every parameter is off by up to this part; 0.1: 10 %.")]
Seed = Annotated[int, typer.Option(help="Of mismatch and noise.")]
Crossover = Annotated[float, typer.Option(help="Half-width of the amplifier's dead band, in A.")]


def find_scene(scene: str) -> "Scene":
    """A scene by built-in name or by path.

    Raises
    ------
    InputError : there is none, or it cannot be used.
    """
    import problems
    from transopt.scene_file import load_scene

    path = Path(scene) if scene.lower().endswith(".toml") else problems.scene_path(scene)
    return load_scene(path, search=[problems.FOLDER])


def imperfections(mismatch: float, seed: int, crossover: float) -> "Imperfections":
    """What is wrong with the simulated device.

    Raises
    ------
    InputError : a number out of its range.
    """
    from controller.simulator import Imperfections

    within("mismatch", mismatch, 0.0, 0.5, ", the part by which parameters are off")
    within("crossover", crossover, 0.0, 1.0, " A")
    within("seed", seed, 0, 2**63 - 1)
    return Imperfections(mismatch=mismatch, crossover_A=crossover)


def _true_device(scene: "Scene", wrong: "Imperfections", seed: int) -> "Device":
    from controller.open_loop import true_device
    from controller.truth import device_of

    return true_device(device_of(scene), wrong, seed)


def _empty_folder(out: Path, pattern: str) -> None:
    """Recordings are never written over."""
    terminal.make_folder(out)
    old = next(iter(sorted(path.name for path in out.glob(pattern))), None)
    if old is not None:
        raise InputError(f"--out {out}: holds a recording already ({old}); choose another folder")


def _held(grips_N: list[float] | None) -> None:
    for grip in grips_N or ():
        if grip == 0:
            raise InputError("--grips 0: only a sweep is played on the free device: name grips above 0")


@record_app.callback()
def record() -> None:
    """Record what a device's sensors say."""


@record_app.command("sweep")
def record_sweep(
    out: Folder,
    simulate: Simulate = False,
    purpose: Annotated[str, typer.Option("--for", help="What it identifies: device or amplifier.")] = "device",
    grips: Annotated[
        str | None, typer.Option(help="Grips in N, 0 the free device; default 1,3,5, for an amplifier 3.")
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
) -> None:
    """Swept sines on a stylus held still: one NPZ per trial, which `transopt identify amplifier|device` reads."""
    from controller.measurement_file import write_measurement
    from controller.simulated_records import sweep_records
    from controller.sweep_plan import Purpose, check_plan, sweep_plan

    if not simulate:
        raise InputError("record sweep: name the device: --simulate")
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
    wrong = imperfections(mismatch, seed, crossover)
    truth = find_scene(DEFAULT_SCENE if scene is None else scene)
    check_plan(planned, truth.time.dt_s, truth.limits.transient_current_A)
    _empty_folder(out, f"{purpose}_*.npz")
    device = _true_device(truth, wrong, seed)
    for trial, taken in sweep_records(device, planned, truth.time.dt_s, imperfections=wrong, seed=seed):
        write_measurement(out / trial.file_name, taken.columns, taken.scalars)
    first = planned[0]
    console = terminal.console()
    console.print(
        f"{out}: {len(planned)} sweeps of {first.seconds:g} s, {first.file_name} to {planned[-1].file_name}\n"
        f"next: transopt identify {purpose} {out}/{purpose}_*.npz --out MODEL.json",
        highlight=False,
        soft_wrap=True,
    )


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
    seconds: port_commands.Seconds = None,
    trigger: Annotated[float, typer.Option(help="On a device: acceleration in g that is taken for a contact.")] = 1.0,
    count_um: Annotated[float, typer.Option(help="On a device: one encoder count at the tip, in um.")] = 24.5,
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
    if simulate == (port is not None):
        raise InputError("record tap: name one device: --simulate, or --port PORT (`transopt-play ports` lists them)")
    if port is not None:
        refuse(context, SIMULATED_ONLY, "only with --simulate")
        port_commands.record_tap_on_port(port, out, taps=taps, seconds=seconds, trigger=trigger, count_um=count_um)
        return
    refuse(context, ON_PORT_ONLY, "only with --port")
    if real_object == (library is not None):
        raise InputError("record tap --simulate: name either a LIBRARY whose taps are played, or --object")
    within("repeats", repeats, 1, 1000)
    within("force-noise", force_noise, 0.0, 10.0, " N")
    chosen_grips = numbers("grips", grips, 0.0, 50.0, " N, what a hand does")
    chosen_speeds = numbers("speeds", speeds, 0.03, 4.5, " m/s, what the servo takes for a tap")
    wrong = imperfections(mismatch, seed, crossover)
    if library is None:
        _held(chosen_grips)
        files = _object_taps(
            out, scene or DEFAULT_SCENE, chosen_speeds, chosen_grips, repeats, wrong, seed, force_noise
        )
    else:
        files = _library_taps(out, library, scene, chosen_speeds, chosen_grips, repeats, wrong, seed)
    terminal.console().print(f"{out}: {len(files)} taps, {files[0]} to {files[-1]}", highlight=False, soft_wrap=True)


def _object_taps(
    out: Path,
    scene: str,
    speeds: list[float] | None,
    grips: list[float] | None,
    repeats: int,
    wrong: "Imperfections",
    seed: int,
    force_noise_N: float,
) -> list[str]:
    from controller.measurement_file import write_measurement
    from controller.simulated_records import noise_seed, object_record

    truth = find_scene(scene)
    target = truth.recordings.simulated
    if target is None:
        raise InputError(
            f"--object: {truth.name} states no simulated object: give --scene with one, like wood_on_foam"
        )
    _empty_folder(out, "tap_*.npz")
    device, names = _true_device(truth, wrong, seed), []
    for i, speed in enumerate(speeds or truth.grid.speeds_m_s):
        for j, grip in enumerate(grips or [target.grip_N]):
            for n in range(repeats):
                taken = object_record(
                    device,
                    target,
                    speed,
                    grip,
                    truth.time.dt_s,
                    imperfections=wrong,
                    seed=noise_seed(seed, i, j, n),
                    force_noise_N=force_noise_N,
                )
                names.append(f"tap_{speed:g}m_s_{grip:g}N_{n + 1}.npz")
                write_measurement(out / names[-1], taken.columns, taken.scalars)
    return names


def _library_taps(
    out: Path,
    library: Path,
    scene: str | None,
    speeds: list[float] | None,
    grips: list[float] | None,
    repeats: int,
    wrong: "Imperfections",
    seed: int,
) -> list[str]:
    from controller.measurement_file import write_measurement
    from controller.prediction import scene_of
    from controller.settings import Settings
    from controller.simulated_records import noise_seed, played_record
    from transopt.library_file import load_library

    loaded = load_library(library)
    settings = Settings.of(loaded, amplifier_tolerance=wrong.mismatch)
    if settings.assumed_grip_N == 0 and any(grips or ()):
        raise InputError(f"--grips: {library} is of the free device, which nobody holds: give --grips 0")
    _empty_folder(out, "tap_*.npz")
    device = _true_device(scene_of(loaded) if scene is None else find_scene(scene), wrong, seed)
    names, silent = [], []
    for i, speed in enumerate(speeds or loaded.speeds_m_s.tolist()):
        for j, grip in enumerate(grips or loaded.grips_N.tolist()):
            for n in range(repeats):
                played, taken = played_record(
                    loaded, device, settings, speed, grip, imperfections=wrong, seed=noise_seed(seed, i, j, n)
                )
                names.append(f"tap_{speed:g}m_s_{grip:g}N_{n + 1}.npz")
                write_measurement(out / names[-1], taken.columns, taken.scalars)
                if not played.metrics.played:
                    silent.append(names[-1])
    if silent:
        typer.echo(f"nothing was played in {', '.join(silent)}", err=True)
        raise typer.Exit(1)
    return names


@record_app.command("heat")
def record_heat(
    out: Folder,
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
    from controller.measurement_file import write_measurement
    from controller.sensors import SEED_SENSORS
    from controller.simulated_records import MOST_HEAT_S, heat_record, true_coil

    if not simulate:
        raise InputError(
            "record heat: name the device: --simulate (a device on a port has no thermometer: log its current and "
            "its winding's resistance with a multimeter)"
        )
    for name, value in (("heating", heating), ("cooling", cooling)):
        within(name, value, 0.0, MOST_HEAT_S, " s")
    within("every", every, 0.01, 60.0, " s")
    within("noise", noise, 0.0, 50.0, " K")
    if heating + cooling < 10 * every:
        raise InputError(f"--heating {heating:g}, --cooling {cooling:g}: fewer than ten readings; record longer")
    imperfections(mismatch, seed, 0.0)
    truth = find_scene(DEFAULT_SCENE if scene is None else scene)
    coil = truth.coil()
    if coil is None:
        raise InputError(f"record heat: {truth.name} states no motor, so no coil; give another --scene")
    amount = 0.9 * truth.limits.steady_current_A if current is None else current
    within("current", amount, 0.0, truth.limits.transient_current_A, " A")
    _empty_folder(out, "heat.npz")
    taken = heat_record(
        true_coil(coil, mismatch, seed),
        amount,
        heating,
        cooling,
        every,
        noise_K=noise,
        current_noise_A=SEED_SENSORS.current_noise_A,
        seed=seed,
    )
    write_measurement(out / "heat.npz", taken.columns, taken.scalars)
    terminal.console().print(
        f"{out}: heat.npz, {heating:g} s at {amount:g} A and {cooling:g} s of cooling, winding at most "
        f"{float(taken.columns['winding_C'].max()):.1f} °C\n"
        f"next: transopt identify coil {out}/heat.npz --out MODEL.json",
        highlight=False,
        soft_wrap=True,
    )
