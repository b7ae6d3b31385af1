"""What the commands of `transopt-play` and `transopt-device` ask of their options."""

from typing import TYPE_CHECKING

import typer

from transopt.base.errors import InputError

if TYPE_CHECKING:
    from controller.sim.simulator import Imperfections

SIMULATED = "sim:"  # the name of the port, as `controller.sim.port` has it


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


WITH_PORT, WITH_SIMULATE = "only with --port", "only with --simulate"
AT_HAND = f"on a device that is up to its user: {WITH_SIMULATE}"
# Parameters that mean nothing on one kind of port, by command: those of a serial port, those of a simulated device.
ONLY_ON_PORT = {
    "tap": ("taps", "seconds", "accelerometer_hz", "reset"),
    "refine": ("seconds", "accelerometer_hz", "reset"),
    "record tap": ("taps", "seconds", "trigger", "count_um"),
    "record sweep": ("gain", "library", "accelerometer_hz", "count_um", "patience", "reset"),
}
MADE_UP = ("mismatch", "seed", "crossover")  # of the simulated device
ONLY_SIMULATED = {
    "tap": ("speed", "grip", "method", "device", "user", "real_time", *MADE_UP),
    "refine": ("scene", *MADE_UP),
    "record tap": ("library", "real_object", "speeds", "grips", "repeats", "force_noise", "scene", *MADE_UP),
    "record sweep": ("scene", *MADE_UP),
}


def is_simulated(context: typer.Context, command: str, simulate: bool, port: str | None) -> bool:
    """Whether the command means the port `sim:`, for which `--simulate` is short, or one that `ports` lists.

    An option that means nothing there is an error, not a wish.

    Raises
    ------
    InputError : no device was named, or two, or an option that means nothing on this one.
    """
    if simulate == (port is not None):
        raise InputError(f"{command}: name one device: --simulate, or --port PORT (`transopt-play ports` lists them)")
    simulated = simulate or port == SIMULATED
    meaningless, why = (
        (ONLY_ON_PORT, WITH_PORT) if simulated else (ONLY_SIMULATED, AT_HAND if command == "tap" else WITH_SIMULATE)
    )
    options = {parameter.name: parameter.opts[0] for parameter in context.command.params}
    for name in meaningless[command]:
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            raise InputError(f"{options[name]}: {why}")
    return simulated


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
