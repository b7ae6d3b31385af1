"""What the commands of `transopt-play` and `transopt-device` ask of their options."""

from typing import TYPE_CHECKING

import typer

from transopt.base.errors import InputError

if TYPE_CHECKING:
    from controller.sim.simulator import Imperfections


def within(option: str, value: float, low: float, high: float, unit: str = "") -> float:
    """The value of an option, if it lies within its limits.

    Raises
    ------
    InputError : it does not, or is no number.
    """
    if not low <= value <= high:
        raise InputError(f"--{option} {value:g}: must be {low:g} to {high:g}{unit}")
    return value


def numbers(option: str, text: str | None, low: float, high: float, unit: str) -> list[float] | None:
    """An option of several numbers like 1,3,5; None if it was not given.

    Raises
    ------
    InputError : a word that is no number within its limits.
    """
    if text is None:
        return None
    found = []
    for word in text.split(","):
        try:
            found.append(float(word))
        except ValueError:
            raise InputError(f"--{option} {text}: must be numbers with commas between, like 1,3,5") from None
        within(option, found[-1], low, high, unit)
    return found


def refuse(context: typer.Context, names: tuple[str, ...], why: str) -> None:
    """An option that means nothing here is an error, not a wish.

    Parameters
    ----------
    names : of the command's parameters.

    Raises
    ------
    InputError : one of them was given.
    """
    options = {parameter.name: parameter.opts[0] for parameter in context.command.params}
    for name in names:
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            raise InputError(f"{options[name]}: {why}")


def imperfect(mismatch: float, seed: int, crossover: float) -> "Imperfections":
    """From the options --mismatch, --seed and --crossover.

    Raises
    ------
    InputError : a number out of its range.
    """
    from controller.sim.simulator import Imperfections

    within("mismatch", mismatch, 0.0, 0.5, ", the part by which parameters are off")
    within("crossover", crossover, 0.0, 1.0, " A")
    within("seed", seed, 0, 2**63 - 1)
    return Imperfections(mismatch=mismatch, crossover_A=crossover)
