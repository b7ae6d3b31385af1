"""`transopt-play tap`: arm a device, let whoever holds it tap, and say how well its library was played.

Heavy imports stand inside the command, so that help and errors come at once.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from controller.cli import options
from controller.cli import port as sessions
from transopt.base import terminal
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from controller.cli.bench import Bench
    from controller.cli.tables import Yardstick
    from controller.device.reading import Described
    from controller.host.payload import Payload
    from controller.record.played import PlayedTap
    from controller.sim.simulator import Imperfections
    from transopt.library.library import Library
    from transopt.plant.intention import Yielding

RECORDED = "recorded"  # the simulated user whose hand does what that of the recordings did


def tap(
    context: typer.Context,
    library: options.LibraryFile,
    simulate: options.Simulate = False,
    port: options.AnyPort = None,
    gain: options.Gain = None,
    out: Annotated[Path | None, typer.Option(help="Folder for figure and telemetry.")] = None,
    speed: Annotated[float | None, options.with_simulate("Incoming speed in m/s; default the grid's middle.")] = None,
    grip: Annotated[float | None, options.with_simulate("Grip in N; default the grid's middle.")] = None,
    method: Annotated[
        str,
        options.with_simulate(
            "How taps are rendered: bilinear, online (solved anew for each tap), nearest, blind, proportional, "
            "decaying-sinusoid, fixed-width-pulse, momentum-cancellation, seed-inversion, clipped-optimum."
        ),
    ] = "bilinear",
    user: Annotated[str, options.with_simulate("recorded, straight, brakes, stops, decays or pulls.")] = RECORDED,
    real_time: Annotated[
        bool, options.with_simulate("Paced by the clock, to watch telemetry.", "--real-time")
    ] = False,
    device: options.DeviceName = None,
    true_device: options.TrueDeviceName = None,
    mismatch: options.Mismatch = 0.0,
    seed: options.Seed = 0,
    crossover: options.Crossover = 0.01,
    taps: options.TapCount = None,
    seconds: options.Seconds = None,
    reset: options.Reset = False,
) -> None:
    """Play taps and say how well: latency, error, peak, spectrum, hardness, current, temperature.

    Exit 1: a fault, a lost lease, or no tap that was played to its end.
    """
    simulated = options.is_simulated(context, "tap", simulate, port)
    options.within("gain", gain, 0.0, 1.0)
    options.within("taps", taps, 1, 1_000_000)
    options.within("for", seconds, 0.0, 1e9, " s")
    from controller.cli.describe import described
    from controller.host.payload import payload
    from controller.record.recorder import make_room

    found = described(device, library, quiet=simulated)
    if simulated:
        wrong, full = options.imperfect(found.device, mismatch, seed, crossover), 1.0 if gain is None else gain
        given, bench, title = _simulated(
            library, found, speed, grip, full, method, seed, wrong, true_device, user, real_time
        )
    else:
        assert port is not None
        given, bench, title = payload(library, found.device), sessions.person_at(port), f"{library} on {port}"
    if out is not None:
        make_room(out, over=simulated)
    _play(given, bench, title, gain, taps, seconds, found, reset, out)


def _middle(library: "Library", speed_m_s: float | None, grip_N: float | None) -> tuple[float, float]:
    """What was asked for, or the grid's middle node."""
    speeds, grips = library.speeds_m_s, library.grips_N
    speed = float(speeds[speeds.size // 2]) if speed_m_s is None else speed_m_s
    return speed, float(grips[grips.size // 2]) if grip_N is None else grip_N


def _simulated(
    path: Path,
    found: "Described",
    speed: float | None,
    grip: float | None,
    gain: float,
    method: str,
    seed: int,
    wrong: "Imperfections",
    true_device: str | None,
    user: str,
    real_time: bool,
) -> "tuple[Payload, Bench, str]":
    """What the simulated device shall play, the bench it is on, and both in words."""
    from controller.cli.bench import simulated_bench
    from controller.host.payload import load_playable, payload_of
    from controller.sim.port import WallClock
    from controller.sim.simulated_tap import SimulatedTap
    from controller.sim.simulator import scene_like
    from controller.sim.true_device import device_of
    from controller.waveforms.bank import Method, bank, solved_for
    from transopt.plant.intention import YIELDINGS

    options.one_of("method", method, (choice.value for choice in Method))
    options.one_of("user", user, (RECORDED, *YIELDINGS))
    library = load_playable(path)
    speed_m_s, grip_N = _middle(library, speed, grip)
    table = bank(library, Method(method))
    if method == Method.ONLINE.value:
        table = solved_for(library, table, speed_m_s, grip_N)
    given = payload_of(
        library,
        None if method == Method.BILINEAR.value else table,
        device=found.device,
        amplifier_tolerance=wrong.mismatch,
    )
    settings = given.settings
    options.within("speed", speed_m_s, 0.03, 0.9 * settings.fastest_m_s, " m/s, what the servo takes for a tap")
    options.within("grip", grip_N, 0.0, 50.0, " N, what a hand does")
    if settings.assumed_grip_N == 0 and grip_N > 0:
        raise InputError(f"--grip {grip_N:g}: this library is of the free device, which nobody holds: give --grip 0")
    if method == Method.PROPORTIONAL.value and settings.wall is None:
        raise InputError("--method proportional: plays a wall's feedback alone, and this library has no wall")
    wanted = SimulatedTap(
        speed_m_s, grip_N, gain, None if user == RECORDED else cast("Yielding", user), seed=seed, imperfections=wrong
    )
    true = device_of(library.scene() if true_device is None else scene_like(true_device))
    clock = WallClock() if real_time else None
    bench, _ = simulated_bench(given, true, [wanted], described=found.device, clock=clock)
    title = f"{path}: {speed_m_s:g} m/s, {grip_N:g} N, {method}, {user} user"
    return given, bench, title + ("" if true_device is None else f", on the device of {true_device}")


def _play(
    given: "Payload",
    bench: "Bench",
    title: str,
    gain: float | None,
    taps: int | None,
    seconds: float | None,
    found: "Described",
    reset: bool,
    out: Path | None,
) -> None:
    """Arm, let the user tap, record, and say of each tap how well it was played."""
    from controller.cli.tables import figures_table, taps_table
    from controller.protocol.codes import LinkNotice
    from controller.record.played import played_tap
    from controller.record.recorder import Recorder
    from controller.servo.interface import Notice

    settings = given.settings
    console = terminal.console()
    with sessions.connected(bench.port, reset) as device:
        sessions.load(device, given, bench.console)
        hello = device.hello
        played_at = 1.0 if gain is None else gain
        title = f"{title}, gain {played_at:g}"
        recorder = Recorder(out, hello.dt_s, settings.count_m, settings.surface_counts, over=device.harmless)
        enough = lambda: taps is not None and len(recorder.contacts) >= taps  # noqa: E731
        file = None if device.harmless else found.path
        shown, stopped = sessions.run(
            bench, device, recorder, title, enough=enough, seconds=seconds, gain=played_at, file=file
        )
    accelerometer = found.device.accelerometer
    played = [played_tap(contact, given.library, settings, played_at, accelerometer) for contact in recorder.contacts]
    console.print(taps_table(played, shown.events, title))
    console.print(figures_table(played, given.library, shown.events, _yardstick(given.library, played)))
    remark = bench.remark()
    if remark:
        console.print(remark)
    if out is not None:
        drawn = _draw(played, title, out, walled=settings.wall is not None)
        console.print(recorder.in_words().removeprefix("; ") + drawn)
    finished = shown.events[Notice.FINISHED] > 0 and played_at > 0
    if shown.faults:
        console.print(f"fault: {shown.faults[0].value}", style="red")
    if stopped:
        typer.echo(sessions.STOPPED, err=True)
        raise typer.Exit(130)
    lost = shown.events[LinkNotice.LEASE_LOST]
    if lost:
        console.print(LinkNotice.LEASE_LOST.value, style="red")
    if shown.faults or lost or not finished:
        raise typer.Exit(1)


def _yardstick(library: "Library", played: "list[PlayedTap]") -> "Yardstick":
    """What the library's own scene knows beside the telemetry."""
    from controller.cli.tables import Yardstick
    from controller.sim.simulated_tap import strike_real
    from controller.sim.true_device import device_of

    scene = library.scene()
    try:
        device = device_of(scene)
    except InputError:  # a black box
        return Yardstick(float("nan"), float("nan"), "unknown, the device is a black box")
    target, real, why = scene.recordings.simulated, float("nan"), ""
    if target is None:
        why = "unknown, as no recorded tap tells the force"
    if target is not None and played:
        contact = played[0].contact
        grip_N = contact.grip_N if target.grip_N is None else target.grip_N
        real = strike_real(device, target, contact.speed_m_s, grip_N, 10e-3, scene.time.dt_s).rate_hardness_N_m
    return Yardstick(device.force_per_current_N_A, real, why)


def _draw(played: "list[PlayedTap]", title: str, out: Path, *, walled: bool) -> str:
    """The first tap that could be compared, else the first; the figure's name, to be put behind others."""
    from controller.cli.tap_figure import tap_figure
    from transopt.base.plotting import save_figure

    shown = next((tap for tap in played if not tap.why), played[0] if played else None)
    if shown is None:
        return ""
    save_figure(tap_figure(shown, title, walled=walled), out / "tap.png")
    return "; tap.png"
