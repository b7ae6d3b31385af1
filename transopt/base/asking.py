"""Questions on a terminal, one after the other, each repeated until its answer can be used."""

import sys
from collections.abc import Callable
from typing import Any

import typer

from transopt.base.errors import InputError


def on_a_terminal() -> bool:
    """Whether input and output are a terminal, so that a person can be asked."""
    return sys.stdin.isatty() and sys.stdout.isatty()


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
        text = sys.stdin.readline()
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
