"""One question instead of a refusal: asked on a terminal, else answered by options that were tried.

An answer is tried on the very file before it is proposed; what makes a plausible tap comes first. Which of several
answers is right only the user knows, so none is taken without being asked.
"""

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
import typer

from transopt.base import asking, terminal
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.cli.layout import layout
from transopt.files.formats import columns_of
from transopt.files.names import Vocabulary, stated_units
from transopt.files.unclear import Answer, UnclearError, joined, option_of, options, shown_path
from transopt.identify.measurement import WORDS, Measurement, load_measurements
from transopt.report.tried import Trials, in_a_line, trials

Found = TypeVar("Found")
ROWS, COLUMNS = 8, 64  # characters of a plot


def answered(
    read: Callable[[Answer], Found],
    words: Vocabulary,
    describe: Callable[[Found], str],
    doubt: Callable[[Found], UnclearError | None] = lambda _: None,
    odd: Callable[[Found], float] = lambda _: 0.0,
    units: str = "",
) -> Found:
    """What a command reads, with what a person answers to what its files leave open.

    Parameters
    ----------
    read : reads the files with an answer beside what the command line states.
    words : of the files.
    describe : what was found, in a few words.
    doubt : what is implausible of it, as a question whose answers put it right; on a terminal it is asked.
    odd : how unusual it is; the least unusual is proposed first.
    units : that the command line states, which what is proposed repeats.

    Raises
    ------
    InputError : a file that cannot be read; without a terminal, one that leaves something open, with the options that
        read it.
    """
    start: Answer = {"units": stated_units(units)} if units else {}
    answer = start
    while True:
        try:
            found = read(answer)
            unclear = doubt(found) if asking.on_a_terminal() else None
        except UnclearError as error:
            unclear = error
        if unclear is None:
            if answer is not start:
                typer.echo(f"the same without being asked: {options(answer)}")
            return found
        tried = trials(read, describe, doubt, odd, unclear, answer)
        if not asking.on_a_terminal():
            raise InputError(in_a_line(unclear, tried)) from None
        answer = joined(answer, _asked(unclear, tried, words))


def measurements(files: Sequence[Path], columns: str, units: str, rate_Hz: float | None) -> list[Measurement]:
    """Runs of a device, read as the command line and a person say; what their files have beside it is noted."""

    def describe(runs: Sequence[Measurement]) -> str:
        recorded = [of for of in WORDS.quantities if getattr(runs[0], of, None) is not None]
        size = max(getattr(runs[0], of).values.size for of in recorded)
        return f"{size} samples of {', '.join(recorded)}"

    def read(answer: Answer) -> list[Measurement]:
        return load_measurements(files, layout(columns, units, rate_Hz, answer))

    runs = answered(read, WORDS, describe, units=units)
    for note, first in {note: run.name for run in reversed(runs) for note in run.notes}.items():
        terminal.console().print(f"{first}: {note}", style="yellow")
    return runs


def _asked(unclear: UnclearError, tried: Trials, words: Vocabulary) -> Answer:
    """The answer of a person who sees what the file holds."""
    console = terminal.console()
    if unclear.file is not None:
        for line in sketched(columns_of(unclear.file, words)):
            console.print(line)
    console.print(f"{shown_path(unclear.file)}{unclear.problem}")
    for number, (answer, found) in enumerate(tried.good, 1):
        console.print(f"  {number}  {options(answer)}: {found}")

    def parsed(text: str) -> Answer:
        if text.isdecimal() and 1 <= int(text) <= len(tried.good):
            return tried.good[int(text) - 1][0]
        if (same := next((each for each in unclear.answers if options(each) == text), None)) is not None:
            return same
        return typed(text, unclear.answers[0])

    given: Answer = asking.answer(
        "answer",
        f"a number{' of the list' if tried.good else ''}, or what else it is, as {options(unclear.answers[0])}",
        "",
        None,
        parsed,
        without=f"{in_a_line(unclear, tried)}; no answer came",
        needed=True,
    )
    return given


def typed(text: str, example: Answer) -> Answer:
    """What a person types: a value of the only fact that is asked for, or an option as a command line has it.

    Raises
    ------
    ValueError : text that is neither.
    """
    key, value = next(iter(example.items()))
    option = option_of(key)
    text = text.removeprefix(option).strip().strip("'\"")
    if text.startswith("-") and key != "columns":
        raise ValueError(f"answer by {option}")
    match value:
        case dict() if "=" in text:
            try:
                return {key: stated_units(text)}
            except InputError as error:
                raise ValueError(str(error)) from None
        case dict():
            name, unit = next(iter(value.items()))
            if len(value) > 1:
                raise ValueError(f"write {option} {','.join(f'{name}={unit}' for name, unit in value.items())}")
            signal = unit.partition("@")[0].strip()
            return {key: {name: f"{signal} @ {text}" if "@" in unit and "@" not in text and "/" in text else text}}
        case list() | tuple():
            return {key: [name.strip() for name in text.split(",")]}
        case int() | float() if not isinstance(value, bool):
            return {key: type(value)(text)}
    raise ValueError(f"answer by {option}")


def sketched(columns: dict[str, FloatArray]) -> list[str]:
    """Lines that show columns of numbers: name, range, steps, and the one with the highest peak as a plot."""
    lines = list[str]()
    width = max(map(len, columns), default=0)
    shown, crest = "", 0.0
    for name, values in columns.items():
        known = values[np.isfinite(values)]
        if known.size == 0:
            lines.append(f"  {name:{width}}  no numbers")
            continue
        steps = np.diff(known)
        even = f", in steps of {np.median(steps):.4g}" if known.size > 1 and (steps > 0).all() else ""
        lines.append(f"  {name:{width}}  {values.size} values, {known.min():.4g} to {known.max():.4g}{even}")
        away = np.abs(known - np.median(known)).max() / (known.std() or np.inf)
        if not even and away > crest:
            shown, crest = name, away
    return [*lines, *([f"  {shown}:", *plotted(columns[shown])] if shown else [])]


def plotted(values: FloatArray) -> list[str]:
    """A curve in characters: what it reaches in each of so many stretches."""
    values = values[np.isfinite(values)]
    pieces = [piece for piece in np.array_split(values, min(COLUMNS, values.size)) if piece.size]
    low, high = np.array([piece.min() for piece in pieces]), np.array([piece.max() for piece in pieces])
    edges = np.linspace(values.max(), values.min(), ROWS + 1)
    return [
        "  " + "".join("#" if a <= top and b >= bottom else " " for a, b in zip(low, high, strict=True)).rstrip()
        for top, bottom in itertools.pairwise(edges)
    ]
