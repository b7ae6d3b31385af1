"""Questions on a terminal, one after the other, each repeated until its answer can be used."""

import sys
from collections.abc import Callable
from typing import Any

import typer

from transopt.base.errors import InputError


def on_a_terminal() -> bool:
    """Whether a person can be asked, and reads the question."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def offered(default: object) -> str:
    """How a value is offered for an empty answer."""
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
    """One question, repeated until the answer is one; an empty answer takes what is offered.

    Parameters
    ----------
    name, why, unit : of what is asked for.
    default : what is offered.
    parsed : makes a value of a text that is not empty, or raises ValueError.
    without : the message where no answers come, as at the end of a file.
    needed : nothing is offered, and an empty answer is none.

    Raises
    ------
    InputError : no answers come.
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
