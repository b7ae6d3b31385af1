"""`transopt-play ports|upload|monitor|check|zero`: look at a device on a port and make it ready.

Heavy imports stand inside the commands, so that help and errors come at once.
"""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from controller.cli import port as sessions
from controller.cli.options import DeviceName, LibraryFile, Port, Reset, Seconds, within
from transopt.base import terminal
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from controller.host.payload import Load


def ports() -> None:
    """List the serial ports there are."""
    from controller.host.transport import listed_ports

    found = listed_ports()
    console = terminal.console()
    for port in found:
        console.print(f"{port.name}  {port.description}".rstrip())
    if not found:
        console.print("no serial port: plug the device in, or give --port socket://HOST:PORT")


def upload(library: LibraryFile, port: Port, device: DeviceName = None, reset: Reset = False) -> None:
    """Put a library into a device, in place of the one it holds; whole or not at all, going on where it was cut."""
    from controller.cli.describe import described
    from controller.host.payload import payload

    given = payload(library, described(device, library).device)
    with sessions.connected(port, reset) as opened:
        sessions.load(opened, given, terminal.console())


def monitor(
    port: Port,
    device: DeviceName = None,
    every: Annotated[int, typer.Option(help="One record every so many ticks.")] = 100,
    seconds: Seconds = None,
) -> None:
    """Watch a device; it is neither configured nor armed."""
    from controller.cli.describe import described
    from controller.host.monitor import Monitor
    from controller.protocol.events import Changed

    within("every", every, 1, 65535, " ticks")
    within("for", seconds, 0.0, 1e9, " s")
    console = terminal.console()
    encoder = described(device).device.encoder
    with sessions.connected(port) as opened:
        hello = opened.hello
        console.print(sessions.who(port, hello))
        with Monitor(console, port, hello.dt_s, encoder.count_m, encoder.surface_counts) as shown:
            shown.take(Changed(opened.state, opened.fault))
            opened.listeners.append(shown.take)
            opened.set_telemetry(every)
            try:
                sessions.listen(opened, seconds, lambda: False, armed=None)
            finally:
                console.print(shown.table())


def check(
    port: Port,
    library: Annotated[Path | None, typer.Argument(help="library.npz; without it only the sensors.")] = None,
    device: DeviceName = None,
    skip: Annotated[list[str] | None, typer.Option(help="A step that this device cannot pass.")] = None,
    patience: Annotated[float, typer.Option(help="How long to wait for you at each step, in s.")] = 30.0,
    sweep: Annotated[
        bool, typer.Option("--sweep", help="For `record sweep`, with the library's limits or the built-in ones.")
    ] = False,
    step: Annotated[str | None, typer.Option(help="Do this step alone, once more.")] = None,
    grip_weight_g: Annotated[
        float | None, typer.Option(help="A known weight to check the grip sensor's scale with.")
    ] = None,
    reset: Reset = False,
) -> None:
    """Go through a device step by step before it is armed; it asks you to do things and sees whether you did.

    Exit 1: a step failed.
    """
    from controller.cli.describe import described
    from controller.cli.tables import VERDICTS, check_table
    from controller.device.stated import servo_numbers
    from controller.host.bringup import Result, check_skipped, check_step, drop_evidence, passed, run_steps
    from controller.host.check_state import Check
    from controller.host.kept import remember_pulse, surface_is_old
    from controller.host.payload import Payload, load_playable, payload, trial_sweep
    from controller.protocol.image import sha256
    from controller.servo.settings import Settings
    from transopt.base.signals import STANDARD_GRAVITY_M_S2

    within("grip-weight-g", grip_weight_g, 10.0, 5000.0, " g")
    within("patience", patience, 0.1, 3600.0, " s")
    skipped, only = check_skipped(skip or ()), None if step is None else check_step(step)
    found = described(device, library)
    given: Load | None = None if library is None else payload(library, found.device)
    console = terminal.console()

    def tell(result: Result) -> None:
        console.print(f"{result.name}: {VERDICTS[result.passed]}: {result.seen}")

    with sessions.connected(port, reset) as opened:
        if sweep:
            given = trial_sweep(opened.hello, library, found.device)
        if given is not None:
            sessions.load(opened, given, terminal.console())
        file, counts = found.path, found.device.encoder.surface_counts
        if not sweep and file is not None and surface_is_old(file, counts, opened.hello.boot):
            console.print(
                f"{file}: the surface was measured at another start of the device, and an encoder counts from where "
                f"it starts: transopt-play zero --port {port} --device {shlex.quote(str(file))}",
                style="red",
            )

        def take_measured(acceleration_m_s2: float) -> Settings:
            anew = trial_sweep(opened.hello, None, found.device, acceleration_m_s2)
            remember_pulse(sha256(anew.configuration), acceleration_m_s2)
            sessions.load(opened, anew, terminal.console())
            return anew.settings

        dt_s = opened.hello.dt_s
        settings = Settings(dt_s, 0.0, 1.0, **servo_numbers(found.device, dt_s)) if given is None else given.settings
        opened.set_telemetry(1)
        bench = Check(
            opened,
            settings,
            sessions.ConsolePerson(),
            loaded=given is not None,
            described=found.device,
            library=given.library
            if isinstance(given, Payload)
            else None
            if library is None
            else load_playable(library),
            grip_weight_N=None if grip_weight_g is None else 1e-3 * grip_weight_g * STANDARD_GRAVITY_M_S2,
            configuration=None if given is None else given.configuration,
            take_measured=take_measured if sweep and library is None else None,
            patience_s=patience,
        )
        results = run_steps(bench, skipped, tell, only)
        good = passed(bench, results, skipped)
        if any(result.passed is False for result in results):
            drop_evidence(bench)
    console.print(check_table(results, f"{port}: bring-up check"))
    if any(result.passed is False for result in results):
        off = "; ".join(bench.off) or "see the steps that failed"
        words = f"failed: {off}; put it right, or state it in the device file, then check again"
        console.print(words, style="red")
        raise typer.Exit(1)
    if only is not None:
        console.print(f"{only}: as it should be; the whole check goes through all steps")
        return
    without = f" without {', '.join(skipped)}" if skipped else ""
    console.print(
        f"passed{without}: this configuration may be armed until the device starts anew, or a fault says `check`"
        if good
        else "the sensors are as they should be; give a library for the rest of the check"
    )


def zero(
    port: Port,
    library: Annotated[Path | None, typer.Argument(help="library.npz beside which device.toml lies.")] = None,
    device: DeviceName = None,
    patience: Annotated[float, typer.Option(help="How long to wait for you, in s.")] = 60.0,
    reset: Reset = False,
) -> None:
    """Find the surface: touch it three times; its counts go into the device file, and to the device at once."""
    from controller.cli.describe import described
    from controller.device.reading import restate
    from controller.host.kept import remember_surface
    from controller.host.surface import IN_A_ROW, REST_S, TOUCH_LOOK_S, Touches
    from controller.servo.interface import State

    within("patience", patience, 0.1, 3600.0, " s")
    found, console = described(device, library), terminal.console()
    if found.path is None:
        raise InputError("zero: no device file to store the surface in: `transopt-play device new device.toml` first")
    encoder = found.device.encoder
    with sessions.connected(port, reset) as opened:
        # A device without a configuration tells raw counts.
        configured = any(opened.hello.configuration_sha256)
        touches = Touches(opened.hello.dt_s, encoder.count_m, 1 if configured else encoder.direction)
        opened.listeners.append(touches.take)
        opened.set_telemetry(max(round(TOUCH_LOOK_S / opened.hello.dt_s), 1))
        sessions.ConsolePerson().asked(
            f"touch the surface with the stylus {IN_A_ROW} times, from outside, and rest on it each time"
        )
        if not opened.listen(patience, until=lambda _: touches.agree):
            seen = ", ".join(f"{counts:g}" for counts in touches.counts) or "none"
            raise InputError(
                f"zero: no {IN_A_ROW} touches at one place within {patience:g} s (rests of {REST_S:g} s at counts: "
                f"{seen}): touch a stop that does not give way, or state encoder.surface_counts by hand"
            )
        surface = touches.surface
        if configured and opened.state is not State.FAULT:
            opened.surface(surface)
    restate(found.path, "encoder.surface_counts", surface)
    remember_surface(found.path, surface, opened.hello.boot)
    moved = 1e3 * (surface - encoder.surface_counts) * encoder.count_m
    console.print(f"{found.path}: encoder.surface_counts = {surface:g}, {moved:+.3f} mm from before")
