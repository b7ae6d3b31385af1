"""Libraries that a stylus on a motor can play: currents over speeds and grips."""

from pathlib import Path

from transopt.base.errors import InputError
from transopt.library.library import Library
from transopt.library.proven import load_proven


def load_playable(path: str | Path) -> Library:
    """Read, prove and look at a library before anything of it is played.

    Raises
    ------
    InputError : what `load_proven` refuses; a library of voltages or of named targets.
    """
    library = load_proven(path)
    if library.axes.targets or library.driven_by.unit != "A":
        raise InputError(
            f"{path}: has {library.axes.said} and commands in {library.driven_by.unit}; a stylus on a motor plays "
            "currents over speeds and grips: `transopt export` writes the waveforms of this one"
        )
    return library
