"""What campaigns share: their options, their processes, their tables and the test that runs them.

    python -m pytest -m long -n 0 tests/campaigns/test_verdicts.py [--campaign="--effects pole --seeds 0,1"]

A campaign tests the product at length. Its module holds a function `main`, whose parameters are the campaign's
options (`--campaign=--help` tells them, below the docstring of the module), tests of its short form, which the suite
runs, and `test_long_form = long_form(main)`. Without `-n 0` nothing is seen before the end.
"""

import json
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any, TypeVar

import pytest
import typer

import problems
from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.base.writing import table, write_text
from transopt.design.build import build_library
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.scene.keys import with_values
from transopt.scene.recordings import recordings_of

CommandLineError: type[Exception] = typer.BadParameter.__mro__[2]  # of the Click that Typer uses
Work, Result = TypeVar("Work"), TypeVar("Result")

PartFile = Annotated[Path | None, typer.Option("--part", help="file for the tables that belong on a page of results")]
JsonFile = Annotated[Path | None, typer.Option("--json", help="also write the figures here")]
LibraryFile = Annotated[Path | None, typer.Argument(help="library.npz; without it wood_on_foam is solved")]
Seed = Annotated[int, typer.Option(min=0, help="another seed, other random numbers")]
Jobs = Annotated[int, typer.Option(min=1, help="processes")]


def at_least(least: float, words: str = "") -> Any:
    """An option that is a number from `least` on; `words` say what it is."""
    return typer.Option(min=least, help=words)


def words_of(said: str, known: Iterable[str]) -> list[str]:
    """The words of a list with commas, each of which has to be known.

    Raises
    ------
    InputError : one is not.
    """
    words, names = said.split(","), list(known)
    for word in words:
        if word not in names:
            raise InputError(f"{word}: not one of {', '.join(names)}")
    return words


def numbers_of(said: str) -> list[float]:
    """The numbers of a list with commas.

    Raises
    ------
    InputError : one is none.
    """
    try:
        return [float(word) for word in said.split(",")]
    except ValueError:
        raise InputError(f"{said}: must be numbers with commas between") from None


def solved(scene: str = "wood_on_foam", values: Mapping[str, object] | None = None) -> Library:
    """The library of a built-in scene, with other values at dotted keys, solved here."""
    said = with_values(problems.load(scene), values or {})
    library = build_library(said, recordings_of(said)).library
    assert library is not None
    return library


def library_of(path: Path | None) -> Library:
    return solved() if path is None else load_library(path)


def each(function: Callable[[Work], Result], work: Sequence[Work], jobs: int) -> Iterator[Result]:
    """The results in the order of the work, each as soon as it and those before it are there."""
    if jobs == 1:
        yield from map(function, work)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(function, work)


def show(head: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    """Print a table, whose lines are returned for the page of results."""
    lines = table(head, rows)
    print("\n".join(lines), flush=True)
    return lines


def write_part(part: Path | None, lines: Sequence[str]) -> None:
    """Write the lines that belong on a page of results; nothing without a file."""
    if part is not None:
        write_text("\n".join(lines), part)


def write_json(value: Any, path: Path | None) -> None:
    """Write a JSON file whole or not at all; nothing without a file."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as file:
            file.write(json.dumps(value, indent=1).encode())


def run(main: Callable[..., int | None], words: Sequence[str]) -> int:
    """Run a campaign with these words as its command line.

    Returns
    -------
    0 where everything is as it has to be.

    Raises
    ------
    Failed : an option is wrong, or the campaign got input that it cannot take.
    """
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    paragraphs = (sys.modules[main.__module__].__doc__ or "").strip().split("\n\n")
    # The mark keeps lines as they are written.
    app.command(help="\n\n".join(f"\b\n{paragraph}" for paragraph in paragraphs))(main)
    name = main.__module__.rpartition(".")[2]
    try:
        return int(app(list(words), standalone_mode=False, prog_name=name) or 0)
    except (InputError, CommandLineError) as error:
        said = str(error)
    pytest.fail(said, pytrace=False)


def long_form(main: Callable[..., int | None]) -> Callable[..., None]:
    """The test that runs a campaign whole, with the options of `--campaign`."""

    @pytest.mark.long
    @pytest.mark.timeout(0)
    def test_long_form(request: pytest.FixtureRequest, capsys: pytest.CaptureFixture[str]) -> None:
        words = [word for said in request.config.getoption("--campaign") for word in shlex.split(said)]
        # A worker of pytest-xdist has no terminal: what it prints is shown if it fails.
        shown = nullcontext() if hasattr(request.config, "workerinput") else capsys.disabled()
        with shown:
            print(flush=True)
            code = run(main, words)
        assert code == 0, "something is not as asked: the campaign says what"

    return test_long_form
