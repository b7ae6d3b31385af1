"""What to do with a model file next, from what it already holds."""

from pathlib import Path

from transopt.scene.model_file import load_model


def next_step(out: Path) -> str:
    """One line: the next command, and the keys that a scene no longer states once it names the file.

    Raises
    ------
    InputError : the file cannot be read.
    """
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
