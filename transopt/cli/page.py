"""`transopt page`: limits as sliders, the optimum solved while they are dragged, in the browser."""

from pathlib import Path
from typing import Annotated

import typer

from transopt.base.errors import InputError
from transopt.cli.scene import ACCEPT_HELP, DEFAULT_SCENE

PORT_HELP = "Port to serve at; without it 8037, or any that is free where that is taken."


def page(
    source: Annotated[
        str, typer.Argument(metavar="[SCENE|LIBRARY]", help="Built-in name, .toml file or library.npz.")
    ] = DEFAULT_SCENE,
    port: Annotated[int | None, typer.Option(help=PORT_HELP, min=0, max=65535)] = None,
    recordings: Annotated[Path | None, typer.Option(help="Folder of the scene's recordings.")] = None,
    accept: Annotated[bool, typer.Option("--accept", help=ACCEPT_HELP)] = False,
    show: Annotated[bool, typer.Option("--open", help="Open the address in the browser.")] = False,
) -> None:
    """Design on a page in the browser: limits as sliders, certified optima while they are dragged.

    Serves this machine alone, at the address that it prints, until Ctrl-C.
    """
    from transopt.web.serve import Page
    from transopt.web.server import check_extra

    check_extra()
    if recordings is not None and not recordings.is_dir():
        raise InputError(f"--recordings {recordings}: no such folder")
    served = Page(source, port=port, recordings=recordings, accept=accept)
    typer.echo(f"{served.name}: {served.address}")
    typer.echo("open it in a browser on this machine; Ctrl-C ends it")
    if show:
        import webbrowser

        webbrowser.open(served.address)
    served.serve()
