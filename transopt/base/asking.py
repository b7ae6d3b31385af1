"""Questions on a terminal, one after the other, each repeated until its answer can be used."""

import os
import select
import signal
import sys
import threading
from collections.abc import Callable
from typing import Any

import typer

from transopt.base.errors import InputError


def on_a_terminal() -> bool:
    """Whether input and output are a terminal, so that a person can be asked."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def _typed_line() -> str:
    """The next line of standard input, with its end; empty at the end of the input.

    A signal that comes just before the system call that reads would be answered only after the next line. The wait is
    therefore a `select` on the terminal and on a pipe into which Python writes a byte for every signal.
    """
    if sys.platform == "win32" or not sys.stdin.isatty() or threading.current_thread() is not threading.main_thread():
        return sys.stdin.readline()
    signalled, written = os.pipe()
    os.set_blocking(written, False)
    before = signal.set_wakeup_fd(written, warn_on_full_buffer=False)
    try:
        while sys.stdin not in select.select([sys.stdin, signalled], [], [])[0]:
            os.read(signalled, 1)
    finally:
        signal.set_wakeup_fd(before)
        os.close(signalled)
        os.close(written)
    return sys.stdin.readline()


def offered(default: object) -> str:
    """The default value as the question shows it."""
    if default is None:
        return "not stated"
    return ("yes" if default else "no") if isinstance(default, bool) else str(default)


def answer(
    name: str,
    why: str,
    unit: str,
    default: Any,
    parsed: Callable[[str], Any],
    *,
    without: str,
    needed: bool = False,
) -> Any:
    """Ask one question, repeated until the answer is valid; an empty answer takes the default.

    Parameters
    ----------
    name, why, unit : name, purpose and unit of the value asked for.
    default : value of an empty answer.
    parsed : converts a text that is not empty to a value, or raises ValueError.
    without : the error's message if the input ends without an answer.
    needed : whether there is no default, so that an empty answer is invalid.

    Raises
    ------
    InputError : the input ends without an answer.
    """
    while True:
        suggestion = "needed" if needed else offered(default)
        typer.echo(f"  {name}{f' [{unit}]' if unit else ''}: {why}\n    ({suggestion}) ", nl=False)
        text = _typed_line()
        if text == "":
            raise InputError(without)
        if not text.strip():
            if needed:
                continue
            return default
        try:
            return parsed(text.strip())
        except ValueError as error:
            typer.echo(f"    {text.strip()}: {error}")
