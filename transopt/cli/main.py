"""`transopt`: scene, plant, taps, identify, solve, verify, show, compare, export, study, page.

Commands are beside this file, those on the file of a library together. Exit codes: 0 done, 1 a result fell short, 2
bad input. A command imports what it computes with only when it runs, so that help and errors come at once.
"""

from typing import Annotated

import typer

from transopt.base import terminal
from transopt.cli.identify import app as identify
from transopt.cli.library import compare, export, show, verify
from transopt.cli.page import page
from transopt.cli.plant_new import app as plant
from transopt.cli.scene import app as scene
from transopt.cli.solve import solve
from transopt.cli.start import COMMANDS
from transopt.cli.study import study
from transopt.cli.taps import taps

FIRST = """\
transopt solve
    makes a first library: currents for taps on wood, into out/wood_on_foam
transopt-play tap out/wood_on_foam/library.npz --simulate
    plays a tap of it on a simulated device, and says how well
transopt --help
    lists all commands; each has a --help of its own with an example"""

app = typer.Typer(
    epilog="Example: transopt solve wood_on_foam",
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Motor-current transients that make a virtual surface feel as hard as the real one.",
)
LIBRARY = "out/wood_on_foam/library.npz"  # of the examples: where `transopt solve` writes
app.command(epilog="Example: transopt taps recordings/*.csv --speed 0.2 --out look")(taps)
app.command(epilog="Example: transopt solve wood_on_foam --grid-tolerance 0.02 --out fine")(solve)
app.command(epilog=f"Example: transopt verify {LIBRARY}")(verify)
app.command(epilog=f"Example: transopt show {LIBRARY} --figure transients.png")(show)
app.command(epilog=f"Example: transopt compare {LIBRARY} fine/library.npz --out changes.md")(compare)
app.command(epilog=f"Example: transopt export {LIBRARY} wood.csv")(export)
app.command(epilog="Example: transopt study wood_on_foam --vary limits.current_A=4,5,6 --out cost")(study)
app.command(epilog="Example: transopt page wood_on_foam")(page)
app.add_typer(scene, name="scene")
app.add_typer(plant, name="plant")
app.add_typer(identify, name="identify")


@app.callback(invoke_without_command=True)
def first(
    context: typer.Context, show: Annotated[bool, typer.Option("--version", help="Print the version.")] = False
) -> None:
    """Motor-current transients that make a virtual surface feel as hard as the real one."""
    if show:
        from importlib import metadata

        typer.echo(metadata.version("transopt"))
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(FIRST)


def main() -> None:
    """Entry point."""
    terminal.run(app, "transopt", COMMANDS)
