"""The runtime's command line, one file per command: play a library's taps on a device, real or simulated.

Exit codes: 0 done, 1 a result fell short (a fault, or nothing was played), 2 bad input. Heavy imports stand inside
the commands, so that help and errors come at once.
"""

import typer

from controller.cli import port as port_commands
from controller.cli import record as record_commands
from controller.cli.refine import refine
from controller.cli.tap import tap
from transopt.base import terminal

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
app.command()(refine)
app.command()(tap)
app.add_typer(record_commands.record_app, name="record")


@app.callback()
def play() -> None:
    """Play a library of transients."""


def main() -> None:
    """Entry point."""
    terminal.run(app)
