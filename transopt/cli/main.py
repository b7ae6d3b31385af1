"""`transopt`: scene, taps, identify, solve, verify, show, compare, export.

Every command is a file of its own beside this one. Exit codes: 0 done, 1 a result fell short, 2 bad input. A command
imports what it computes with only when it runs, so that help and errors come at once.
"""

from typing import Annotated

import typer

from transopt.base import terminal
from transopt.cli.compare import compare
from transopt.cli.export import export
from transopt.cli.identify import app as identify
from transopt.cli.scene import app as scene
from transopt.cli.show import show
from transopt.cli.solve import solve
from transopt.cli.study import study
from transopt.cli.taps import taps
from transopt.cli.verify import verify

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Motor-current transients that make a virtual surface feel as hard as the real one.",
)
for command in (taps, solve, verify, show, compare, export, study):
    app.command()(command)
app.add_typer(scene, name="scene")
app.add_typer(identify, name="identify")


@app.callback(invoke_without_command=True)
def version(show: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    """Motor-current transients that make a virtual surface feel as hard as the real one."""
    if show:
        from importlib import metadata

        typer.echo(metadata.version("transopt"))
        raise typer.Exit


def main() -> None:
    """Entry point."""
    terminal.run(app)
