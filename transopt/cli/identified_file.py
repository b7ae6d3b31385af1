"""The model file that every `transopt identify` writes its part into."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from transopt.base import terminal
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from transopt.base.tables import Table
    from transopt.scene.fitted import ModelPart


def check_place(out: Path) -> None:
    """Refuse a place where no model file can be written, before any work is done for it.

    Raises
    ------
    InputError : another ending, or a folder that cannot be written.
    """
    if out.suffix.lower() != ".json":
        raise InputError(f"--out {out}: a model file ends in .json")
    terminal.make_folder(out.parent)


def tell(*lines: "str | Table", style: str | None = None) -> None:
    """Print lines and tables as they are, however narrow the terminal."""
    console = terminal.console()
    for line in lines:
        if isinstance(line, str):
            console.print(line, style=style)
        else:
            console.print(line)


def finish(out: Path, figure: Path, name: str, part: "ModelPart", scene: str | None = None) -> None:
    """Say what was written, the verdict on it, and what comes next.

    Parameters
    ----------
    name, part : of the model file.
    scene : see `next_step`.

    Raises
    ------
    typer.Exit : the part falls short of what a design needs.
    """
    tell(f"{out}, {figure.name}")
    tell(f"{name}: {part.verdict}", style="red" if part.shortfalls else None)
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
    from transopt.scene.model_file import load_model
    from transopt.scene.model_place import model_line

    model = load_model(out)
    if model.device is None and model.hand is None:
        return f"next: transopt identify device SWEEPS --out {out} (a scene needs a device or a hand)"
    words = ["transopt", "solve", *([] if scene is None else [scene]), "--model", str(out)]
    return (
        f"next: {shlex.join(words)}\n"
        "or in a scene of your own, above its first [table] (all that it states may stay):\n"
        f"{model_line(out, Path())}"
    )
