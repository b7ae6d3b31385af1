"""The runtime's command line, one file per command: play a library's taps on a device, real or simulated.

Exit codes: 0 done, 1 a result fell short (a fault, or nothing was played), 2 bad input. Heavy imports stand inside
the commands, so that help and errors come at once.
"""

import typer

from controller.cli import record as record_commands
from controller.cli.calibrate import calibrate
from controller.cli.describe import device_app
from controller.cli.doctor import doctor
from controller.cli.look import check, monitor, ports, upload, zero
from controller.cli.refine import refine
from controller.cli.tap import tap
from transopt.base import terminal
from transopt.cli.start import COMMANDS

LIBRARY = "out/wood_on_foam/library.npz"  # of the examples: where `transopt solve` writes
PORT = "/dev/ttyACM0"
FIRST = f"""\
transopt-play tap {LIBRARY} --simulate
    plays a tap of the library that `transopt solve` makes on a simulated device
transopt-play doctor --port PORT
    says what is installed, which ports there are, and what answers
transopt-play --help
    lists all commands; each has a --help of its own with an example"""

app = typer.Typer(
    epilog=f"Example: transopt-play tap {LIBRARY} --simulate",
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Play a library of transients.",
)
app.command(epilog="Example: transopt-play ports")(ports)
app.command(epilog=f"Example: transopt-play doctor --port {PORT}")(doctor)
app.command(epilog=f"Example: transopt-play upload {LIBRARY} --port {PORT}")(upload)
app.command(epilog=f"Example: transopt-play monitor --port {PORT} --for 10")(monitor)
app.command(epilog=f"Example: transopt-play check {LIBRARY} --port {PORT}")(check)
app.command(epilog=f"Example: transopt-play zero --device device.toml --port {PORT}")(zero)
app.command(epilog=f"Example: transopt-play refine {LIBRARY} --simulate --out refined")(refine)
app.command(epilog=f"Example: transopt-play calibrate {LIBRARY} --simulate --out my_hand")(calibrate)
app.command(epilog=f"Example: transopt-play tap {LIBRARY} --simulate --speed 0.2 --out played")(tap)
app.add_typer(record_commands.record_app, name="record")
app.add_typer(device_app, name="device")


@app.callback(invoke_without_command=True)
def play(context: typer.Context) -> None:
    """Play a library of transients."""
    if context.invoked_subcommand is None:
        typer.echo(FIRST)


def main() -> None:
    """Entry point."""
    terminal.run(app, "transopt-play", COMMANDS)
