"""Shared by the command lines: the console, checks of output folders, signals, and errors in one line."""

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
from functools import cache, partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NoReturn

import typer
from rich.console import Console
from rich.text import Text
from typer.main import get_command

from transopt.base import apart
from transopt.base.errors import InputError, did_you_mean
from transopt.base.threads import one_thread

if TYPE_CHECKING:
    from rich.progress import Progress

AGAIN_S = 0.01  # time from a signal whose exception Python ignored to its repetition
SIGNALLED = 128  # the exit code after a signal is this plus the signal's number
PIPE = 13  # number of SIGPIPE, which Windows does not know
LAST_S = 0.6  # time from a signal to the forced end of the process
WIDTH = 160  # width of tables without a terminal, so that logs and pipes keep whole lines
_IF_STOPPED: ContextVar[str] = ContextVar("what is said of a command's results when a signal ends it", default="")


def harmless(text: str, keep: str = "") -> str:
    """Escape every control character in a text, line breaks included, so that a terminal does not execute it.

    Names and descriptions come from files, which may contain anything.

    Parameters
    ----------
    keep : control characters that are not escaped.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else ascii(c)[1:-1] for c in text)


class _HarmlessConsole(Console):
    """A console that escapes control characters in all text that has no style of its own."""

    def render_str(self, text: str, **how: Any) -> Text:
        return super().render_str(harmless(text, keep="\n\t"), **how)

    def on_broken_pipe(self) -> None:
        """End as by the signal of a reader that has gone, and not with the code of a result that fell short."""
        with suppress(SystemExit):
            super().on_broken_pipe()
        raise SystemExit(SIGNALLED + PIPE)

    def print(self, *objects: Any, **how: Any) -> None:
        """Print; on a terminal sentences are wrapped between words, otherwise they stay on one line.

        A command to be typed is never wrapped, so that it can be copied.

        Raises
        ------
        InputError : the output cannot be written, as on a full disk.
        """
        sentences = all(isinstance(each, str) for each in objects)
        if sentences and self.is_terminal:
            objects = tuple(map(self._broken, objects))
        try:
            super().print(*objects, **{"soft_wrap": sentences, **how})
        except OSError as error:
            _close_off(self.file)
            raise InputError(f"standard output: cannot be written ({error.strerror}); choose another place") from None

    def _broken(self, text: str) -> str:
        fill = partial(textwrap.fill, width=self.width, break_long_words=False, break_on_hyphens=False)
        return "\n".join(line if "transopt" in line else fill(line) for line in text.split("\n"))


def _close_off(stream: IO[str]) -> None:
    """Send all that a stream still holds nowhere, which Python would try to write again at its end."""
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), stream.fileno())


def console() -> Console:
    """A console on the standard output.

    Its width is COLUMNS or, if that is not set, the terminal's width, or `WIDTH` without a terminal.
    """
    # No markup and no emoji: names and descriptions are the user's and may hold brackets and colons.
    known = sys.stdout.isatty() or os.environ.get("COLUMNS")
    return _HarmlessConsole(markup=False, emoji=False, highlight=False, width=None if known else WIDTH)


def progress() -> "Progress":
    """A progress bar on the standard error: the present step, its share done, elapsed and remaining time.

    It is shown only on a terminal, and removed when it is done.
    """
    # Imported here, since only long commands need it.
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
    """Create a folder and check that it can be written, before any work is done for it.

    Raises
    ------
    InputError : the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(f"--out {folder}: cannot be written ({error.strerror}); choose another folder") from None


# Typer bundles its own Click or uses the installed one; the base class of its exception belongs to the right one.
_ClickException: type[Exception] = typer.BadParameter.__mro__[2]


def run(
    app: Callable[..., object], name: str | None = None, programs: Mapping[str, Collection[str]] | None = None
) -> None:
    """Run a command line: errors a user can cause end in one line, never in a traceback.

    The exit code is the one that `app` returns (0 if it returns None), 2 after a user's error, 130 after Ctrl-C, and
    128 plus its number after another signal that asks the process to end.

    Parameters
    ----------
    app : a Typer application, or a function without arguments.
    name : name of the command in usage and error messages, however Python was started; None for a function.
    programs : program -> its commands; an unknown command that another program has is answered with that program.
    """
    os.environ.update(one_thread(os.environ))  # before numpy is loaded, which happens inside the commands
    # A standard stream that is closed takes what is printed without an error.
    sys.stdout, sys.stderr = (stream or Path(os.devnull).open("w") for stream in (sys.stdout, sys.stderr))  # noqa: SIM115
    # Characters that the terminal's encoding lacks (the C locale's is ASCII) are escaped instead of raising an error.
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
    """Set the line that is printed if a signal ends the command from here on."""
    _IF_STOPPED.set(text)


def takes_its_time() -> None:
    """Cancel the forced end after a signal: the command has handled it and only writes its tables and figures."""
    faulthandler.cancel_dump_traceback_later()


def _code(
    app: Callable[..., object], name: str | None, came: list[int], programs: Mapping[str, Collection[str]]
) -> int:
    """Run a command line and print its errors; the exit code."""
    try:
        code = _parser(app)(standalone_mode=False, prog_name=name) if isinstance(app, typer.Typer) else app()
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
        # After a signal the interrupted step may raise any error, such as a failed import: then report the signal.
        if not came:
            raise
        return SIGNALLED + came[0]
    return code if isinstance(code, int) else 0


@cache
def _parser(app: typer.Typer) -> Any:
    """Commands of an application as they are parsed and their help is printed, built once in a process."""
    return readable(get_command(app))


def readable(command: Any) -> Any:
    """Make the help of a command and its subcommands readable: whole paragraphs, and no type beside a flag."""
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
    """Let SIGINT, SIGTERM and SIGHUP raise an exception, so that open resources are cleaned up; yields the signals.

    If Python ignores the exception (in a destructor or the callback of a weak reference), the signal is sent again.
    If the process has not ended `LAST_S` after the first signal, because a library swallowed the exception or does
    not return, it is ended at once, unless the command `takes_its_time`.
    """
    came: list[int] = []

    def end(number: int, _: object) -> None:
        came.append(number)
        if len(came) == 1:
            # This timer is a native thread, which code that holds the GIL cannot block.
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
            # Sent from another thread, so that it arrives after Python has left this function.
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
    """Print in one line which command, option or value does not exist, or print the help."""
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
    """The message for an unknown command or option, with the nearest known one; empty for other errors."""
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
