"""The model file that every `transopt identify` writes its part into."""

from pathlib import Path

from transopt.base import terminal
from transopt.base.errors import InputError


def check_place(out: Path) -> None:
    """Refuse a place where no model file can be written, before any work is done for it.

    Raises
    ------
    InputError : another ending, or a folder that cannot be written.
    """
    if out.suffix.lower() != ".json":
        raise InputError(f"--out {out}: a model file ends in .json")
    terminal.make_folder(out.parent)


def next_step(out: Path) -> str:
    """One line: the next command, and the keys that a scene leaves out once it names the file.

    Raises
    ------
    InputError : the file cannot be read.
    """
    from transopt.scene.model_file import load_model

    model = load_model(out)
    if model.device is None and model.hand is None:
        return f"next: transopt identify device SWEEPS --out {out} (a scene needs a device or a hand)"
    given = ["[model] with its tables"]
    if model.amplifier is not None:
        given.append("pole_Hz and delay_s of [amplifier]")
    return (
        f'next: transopt scene new mine.toml; in it the line model = "{out}" above the first [table] takes the '
        f"place of {' and of '.join(given)}"
    )
