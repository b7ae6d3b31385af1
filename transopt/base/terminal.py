"""What the command lines share: the console, folders that can be written, errors in one line."""

import _thread
import faulthandler
import inspect
import io
import os
import re
import signal
import sys
import tempfile
import textwrap
import threading
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import typer
from rich.console import Console
from rich.text import Text
from typer.main import get_command

from transopt.base import apart
from transopt.base.errors import InputError
from transopt.base.nearest import did_you_mean
from transopt.base.threads import one_thread

if TYPE_CHECKING:
    from rich.progress import Progress

AGAIN_S = 0.01  # between a signal that Python ignored and the next try
SIGNALLED = 128  # an exit code beyond it is this and the signal's number
LAST_S = 0.6  # between a signal and the end of the process, whatever it is doing
WIDTH = 160  # of tables without a terminal, so that logs and pipes keep whole lines
_IF_STOPPED: ContextVar[str] = ContextVar("what is said of a command's results when a signal ends it", default="")


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

    def print(self, *objects: Any, **how: Any) -> None:
        """Print; sentences stand in whole lines, and break on a terminal alone, between words.

        A command stays one line, so that it can be copied.
        """
        sentences = all(isinstance(each, str) for each in objects)
        if sentences and self.is_terminal:
            objects = tuple(map(self._broken, objects))
        super().print(*objects, **{"soft_wrap": sentences, **how})

    def _broken(self, text: str) -> str:
        fill = partial(textwrap.fill, width=self.width, break_long_words=False, break_on_hyphens=False)
        return "\n".join(line if "transopt" in line else fill(line) for line in text.split("\n"))


def console() -> Console:
    """The standard output, to print tables on.

    It is as wide as COLUMNS says or, without it, as the terminal, or `WIDTH` columns where there is none.
    """
    # No markup: names and descriptions are the user's and may hold brackets.
    known = sys.stdout.isatty() or os.environ.get("COLUMNS")
    return _HarmlessConsole(markup=False, highlight=False, width=None if known else WIDTH)


def progress() -> "Progress":
    """A bar on the standard error: what is being done, how much of it is, the time passed and the time left.

    It shows on a terminal alone, and goes when it is done.
    """
    # Only a command that takes its time needs this import.
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    bar = Console(stderr=True)
    return Progress(*columns, TimeRemainingColumn(), console=bar, transient=True, disable=not bar.is_terminal)


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


def run(
    app: Callable[..., object], name: str | None = None, programs: Mapping[str, Collection[str]] | None = None
) -> None:
    """Run a command line: errors a user can cause end in one line, never in a traceback.

    The process ends with the code that `app` returns (0 if it returns none), with 2 after an error of the user's,
    with 130 after Ctrl-C, with 128 and its number after another signal that asks it to end.

    Parameters
    ----------
    app : a Typer application, or a function without arguments.
    name : of the command, as its usage and its errors call it, however Python was started; None for a function.
    programs : name -> commands of the programs of which one is named where it has the command that this one lacks.
    """
    os.environ.update(one_thread(os.environ))  # in time: numpy is loaded inside the commands
    # What the terminal's encoding lacks (the C locale's is ASCII) is escaped: no table ends in an encoding error.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    with _signals_end_it() as came:
        if_stopped("")
        code = _code(app, name, came, programs or {})
        if came:
            if code > SIGNALLED and _IF_STOPPED.get():
                typer.echo(_IF_STOPPED.get(), err=True)
            _leave(code)
    sys.exit(code)


def if_stopped(text: str) -> None:
    """State what is said, in one line, when a signal ends the command from here on, whatever it cuts short."""
    _IF_STOPPED.set(text)


def takes_its_time() -> None:
    """A signal has been answered by what a command does at its end anyway, tables and figures: it may finish that."""
    faulthandler.cancel_dump_traceback_later()


def _code(
    app: Callable[..., object], name: str | None, came: list[int], programs: Mapping[str, Collection[str]]
) -> int:
    """The exit code of a command line, its errors said."""
    try:
        code = (
            readable(get_command(app))(standalone_mode=False, prog_name=name)
            if isinstance(app, typer.Typer)
            else app()
        )
    except InputError as error:
        typer.echo(f"error: {harmless(str(error))}", err=True)
        return 2
    except _ClickException as error:
        _refuse(error, programs)
        return 2
    except (KeyboardInterrupt, typer.Abort):
        return SIGNALLED + signal.SIGINT
    except SystemExit as stop:
        if not isinstance(stop.code, int | None):
            raise
        return stop.code or 0
    except Exception:
        # What a signal cuts short may call it by another name: an import that fails, a file that ends.
        if not came:
            raise
        return SIGNALLED + came[0]
    return code if isinstance(code, int) else 0


def readable(command: Any) -> Any:
    """A command and those below it with help as a person reads it: whole paragraphs, and no type beside a flag."""
    if command.help:
        command.help = "\n\n".join(" ".join(each.split()) for each in inspect.cleandoc(command.help).split("\n\n"))
    for option in command.get_params(command.context_class(command)):
        if getattr(option, "is_flag", False):
            option.metavar = ""  # `--force <bool>` asks for a word behind it, which there is not
    for below in getattr(command, "commands", {}).values():
        readable(below)
    return command


def _leave(code: int) -> NoReturn:
    """End the process at once: all is tidied up, and what Python does at its own end can take a second."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    apart.end()
    os._exit(code)


def _signal_again(number: int) -> None:
    """To the main thread, out of its sleep where the platform can."""
    if sys.platform == "win32":
        _thread.interrupt_main(number)
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, number)


@contextmanager
def _signals_end_it() -> Iterator[list[int]]:
    """SIGINT, SIGTERM and SIGHUP raise an exception, so that all that is open is tidied up on the way out.

    Where Python ignores exceptions, in a destructor or the callback of a weak reference, the signal comes once more.
    If the process has not ended `LAST_S` after the first of them, because a library has swallowed the exception or
    does not come back, it ends at once, unless the command `takes_its_time`. Yields the signals that came.
    """
    came: list[int] = []

    def end(number: int, _: object) -> None:
        came.append(number)
        if len(came) == 1:
            # A thread without Python in it, which native code cannot hold up.
            faulthandler.dump_traceback_later(LAST_S, exit=True, file=nothing)
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        sys.exit(SIGNALLED + number)

    if threading.current_thread() is not threading.main_thread():
        yield came
        return
    said_before = sys.unraisablehook

    def ignored(what: "sys.UnraisableHookArgs") -> None:
        if came and issubclass(what.exc_type, KeyboardInterrupt | SystemExit):
            # From a thread of its own, so that it comes when this place is left.
            threading.Timer(AGAIN_S, _signal_again, (came[0],)).start()
        else:
            said_before(what)

    asked = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in asked}
    with Path(os.devnull).open("w") as nothing:
        try:
            sys.unraisablehook = ignored
            for number, answer in before.items():
                if answer is not signal.SIG_IGN:  # as in the background of a shell
                    signal.signal(number, end)
            yield came
        finally:
            for number, answer in before.items():
                signal.signal(number, answer)
            sys.unraisablehook = said_before
            if came:
                faulthandler.cancel_dump_traceback_later()


MISSING = {
    "Missing option '--port'": ": `transopt-play ports` lists the ports",
    "Missing argument 'library'": ": give a library.npz written by `transopt solve`",
}


def _refuse(error: Any, programs: Mapping[str, Collection[str]]) -> None:
    """Say in one line which command, option or value does not exist, or print the help that it needs."""
    said: str = error.format_message()
    if type(error).__name__ == "NoArgsIsHelpError":
        # The message of this error is the help, which Rich has printed already.
        typer.echo(said, err=True, nl=bool(said))
        return
    context = getattr(error, "ctx", None)
    asking = f"; `{context.command_path} --help` lists what there is" if context is not None else ""
    words = _unknown(error, said, programs) or " ".join(said.split()).rstrip(".").replace(
        "Input should be", "must be"
    )
    words += MISSING.get(words, "")
    if re.search(r"extra argument.*\([-\d. ]+\)", words):
        words += ": several values of one option take commas and no spaces, as 1,3,5"
    typer.echo(f"error: {harmless(words)}{asking}", err=True)


def _unknown(error: Any, said: str, programs: Mapping[str, Collection[str]]) -> str:
    """For a command or an option that there is not: that, and the nearest that there is; empty for other errors."""
    command = getattr(getattr(error, "ctx", None), "command", None)
    if type(error).__name__ == "NoSuchOption":
        options = [name for parameter in getattr(command, "params", ()) for name in parameter.opts]
        return f"{error.option_name}: no such option" + did_you_mean(error.option_name, options)
    found = re.match(r"No such command (['\"])(.*?)\1", said)
    if found is None:
        return ""
    owner = next((program for program, has in programs.items() if found[2] in has), "")
    if owner and error.ctx.parent is None:
        return f"{found[2]}: a command of {owner}: type {owner} {found[2]}"
    known = list(getattr(command, "commands", ()))
    return f"{found[2]}: no such command" + (did_you_mean(found[2], known) or f"; choose one of {', '.join(known)}")
