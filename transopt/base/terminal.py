"""What the command lines share: the console, folders that can be written, errors in one line."""

import io
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import typer
from rich.console import Console
from rich.text import Text

from transopt.base.errors import InputError

WIDTH = 160  # of tables without a terminal, so that logs and pipes keep whole lines


def harmless(text: str, keep: str = "") -> str:
    """The text with an escape in place of every character that a terminal might obey, line breaks among them.

    Names and descriptions come from files, which may hold anything.

    Parameters
    ----------
    keep : control characters that may stay.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else ascii(c)[1:-1] for c in text)


class _HarmlessConsole(Console):
    """A console that prints no control characters of others: all text without a style of its own comes by here."""

    def render_str(self, text: str, **how: Any) -> Text:
        return super().render_str(harmless(text, keep="\n\t"), **how)


def console() -> Console:
    """The standard output, to print tables on: as wide as the terminal, or `WIDTH` columns without one."""
    # No markup: names and descriptions are the user's and may hold brackets.
    return _HarmlessConsole(markup=False, width=None if sys.stdout.isatty() else WIDTH)


def make_folder(folder: Path) -> None:
    """Make sure that a folder can be written before any work is done for it.

    Raises
    ------
    InputError : it cannot.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(f"--out {folder}: cannot be written ({error.strerror}); choose another folder") from None


# Typer carries a Click of its own or uses the installed one; its public exception knows which.
_ClickException: type[Exception] = typer.BadParameter.__mro__[2]


def run(app: Callable[..., object]) -> None:
    """Run a command line: errors a user can cause end in one line, never in a traceback.

    The process ends with the code that `app` returns (0 if it returns none), with 2 after an error of the user's,
    with 130 after Ctrl-C.

    Parameters
    ----------
    app : a Typer application, or a function without arguments.
    """
    # Matrices are small here: threads of the linear algebra, waiting for each other, take a quarter more of the
    # processor and gain nothing. The variable is read when numpy is loaded, which happens inside the commands.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # What the terminal's encoding lacks (the C locale's is ASCII) is escaped: no table ends in an encoding error.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    # SIGTERM is answered like Ctrl-C: no process is left behind, and nothing half written.
    ours = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM)) if ours else None
    try:
        code = app(standalone_mode=False) if isinstance(app, typer.Typer) else app()
    except InputError as error:
        typer.echo(f"error: {harmless(str(error))}", err=True)
        sys.exit(2)
    except _ClickException as error:
        _refuse(error)
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(130)
    else:
        sys.exit(code if isinstance(code, int) else 0)
    finally:
        if before is not None:
            signal.signal(signal.SIGTERM, before)


def _refuse(error: Any) -> NoReturn:
    """End with one line about a command, option or value that does not exist, or with the help it needs."""
    said: str = error.format_message()
    if type(error).__name__ == "NoArgsIsHelpError":
        # Its message is the help, which Rich has printed already.
        typer.echo(said, err=True, nl=bool(said))
        sys.exit(2)
    context = getattr(error, "ctx", None)
    asking = f"; `{context.command_path} --help` lists what there is" if context is not None else ""
    words = " ".join(said.split()).rstrip(".").replace("Input should be", "must be")
    typer.echo(f"error: {harmless(words)}{asking}", err=True)
    sys.exit(2)
