"""What every `transopt identify` shares: its options, its progress, and the end in a model file with a verdict."""

import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.cli.layout import COLUMNS_HELP, UNITS_HELP

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from transopt.base.tables import Table
    from transopt.scene.model_parts import AnyModelPart, ModelPartName

Out = Annotated[Path, typer.Option(help="Model file; its other parts stay. A PNG is written beside it.")]
Columns = Annotated[str, typer.Option(help=COLUMNS_HELP)]
Units = Annotated[str, typer.Option(help=UNITS_HELP)]


def check_place(out: Path) -> None:
    """Refuse a place where no model file can be written, before any work is done for it."""
    if out.suffix.lower() != ".json":
        raise InputError(f"--out {out}: a model file ends in .json")
    terminal.make_folder(out.parent)


@contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """A bar that names what was done last; the function that it gives counts one of a name."""
    from rich.progress import TaskID

    with terminal.progress() as bar:
        tasks: dict[str, TaskID] = {}

        def step(name: str) -> None:
            if name not in tasks:
                for other in tasks.values():
                    bar.update(other, visible=False)
                tasks[name] = bar.add_task(name, total=None)
            bar.advance(tasks[name])

        yield step


def tell(*lines: "str | Table", style: str | None = None) -> None:
    """Print lines in a style, and tables."""
    for line in lines:
        terminal.console().print(line, style=style if isinstance(line, str) else None)


def draw(out: Path, name: "ModelPartName", figure: "Figure") -> Path:
    """Write the figure of a part beside its model file."""
    from transopt.base.plotting import save_figure

    picture = out.with_name(f"{out.stem}_{name}.png")
    save_figure(figure, picture)
    return picture


def finish(
    out: Path, name: "ModelPartName", part: "AnyModelPart", figure: "Figure", note: str = "", scene: str | None = None
) -> None:
    """Write part and figure, say the verdict, and what comes next.

    Parameters
    ----------
    note : what to know of the values, in a sentence; empty if nothing.
    scene : see `next_step`.

    Raises
    ------
    InputError : a file cannot be written.
    typer.Exit : the part falls short of what a design needs.
    """
    from transopt.scene.model_file import load_model, save_part

    save_part(out, name, part)
    uncounted = load_model(out).uncounted
    tell(*filter(None, (f"{out}, {draw(out, name, figure).name}", note)))
    # The file has one sentence, in which the shortfalls come last; here each has a line of its own.
    verdict = part.verdict.removesuffix("; ".join(part.shortfalls)).rstrip(":; ")
    tell(
        f"verdict: {'; '.join(filter(None, [verdict, uncounted if name == 'device' else '']))}",
        *(f"short: {each}" for each in part.shortfalls),
        style="red" if part.shortfalls else None,
    )
    if part.shortfalls:
        raise typer.Exit(1)
    tell(next_step(out, scene))


def next_step(out: Path, scene: str | None = None) -> str:
    """The next command, and the line by which a scene of the user's own names the file.

    Parameters
    ----------
    scene : that the model was identified for; None for the default one.

    Raises
    ------
    InputError : the file cannot be read.
    """
    from transopt.scene.model_file import load_model, model_line

    model = load_model(out)
    if model.device is None and model.hand is None:
        return (
            f"next: transopt identify device SWEEPS --out {shlex.quote(str(out))} (a scene needs a device or a hand)"
        )
    words = ["transopt", "solve", *([] if scene is None else [scene]), "--model", str(out)]
    return (
        f"next: {shlex.join(words)}\n"
        "or in a scene of your own, above its first [table] (all that it states may stay):\n"
        f"{model_line(out, Path())}"
    )
