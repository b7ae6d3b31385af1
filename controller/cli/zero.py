"""`transopt-play zero`: where the surface is, by touching it, stored in the device file."""

from pathlib import Path
from typing import Annotated

import typer

from controller.cli.options import DeviceName, Port, Reset, within
from transopt.base import terminal
from transopt.base.errors import InputError


def zero(
    port: Port,
    library: Annotated[Path | None, typer.Argument(help="library.npz beside which device.toml lies.")] = None,
    device: DeviceName = None,
    patience: Annotated[float, typer.Option(help="How long to wait for you, in s.")] = 60.0,
    reset: Reset = False,
) -> None:
    """Find the surface: touch it three times; its counts go into the device file, and to the device at once."""
    from controller.cli import port as sessions
    from controller.cli.describe import described
    from controller.device.reading import restate
    from controller.host.surface import IN_A_ROW, REST_S, Touches
    from controller.servo.interface import State

    within("patience", patience, 0.1, 3600.0, " s")
    found, console = described(device, library), terminal.console()
    if found.path is None:
        raise InputError("zero: no device file to store the surface in: `transopt-play device new device.toml` first")
    encoder = found.device.encoder
    with sessions.connected(port, reset) as opened:
        touches = Touches(opened.hello.dt_s, encoder.count_m)
        opened.listeners.append(touches.take)
        opened.set_telemetry(1)
        sessions.ConsolePerson().asked(
            f"touch the surface with the stylus {IN_A_ROW} times, from outside, and rest on it each time"
        )
        if not opened.listen(patience, until=lambda _: touches.agree):
            seen = ", ".join(f"{counts:g}" for counts in touches.counts) or "none"
            raise InputError(
                f"zero: no {IN_A_ROW} touches at one place within {patience:g} s (rests of {REST_S:g} s at counts: "
                f"{seen}): touch a stop that does not give way, or state encoder.surface_counts by hand"
            )
        # A device without a configuration tells raw counts.
        configured = any(opened.hello.configuration_sha256)
        surface = touches.surface * (1 if configured else encoder.direction)
        if configured and opened.state is not State.FAULT:
            opened.surface(surface)
    restate(found.path, "encoder.surface_counts", surface)
    moved = 1e3 * (surface - encoder.surface_counts) * encoder.count_m
    console.print(f"{found.path}: encoder.surface_counts = {surface:g}, {moved:+.3f} mm from before")
