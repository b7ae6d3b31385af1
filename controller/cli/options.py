"""What the commands of `transopt-play` and `transopt-device` ask of their options, and the options several share."""

import shlex
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from transopt.base.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from controller.device.device_file import DeviceFile
    from controller.sim.simulator import Imperfections

SIMULATED = "sim:"  # the name of the port, as `controller.sim.port` has it
# Headings in the help under which stand the parameters that mean nothing on the other kind of port.
ON_A_PORT, ON_THE_SIMULATOR = "With --port", "With --simulate"


def with_port(words: str, *names: str) -> Any:
    """An option that means something on a port only."""
    return typer.Option(*names, help=words, rich_help_panel=ON_A_PORT)


def with_simulate(words: str, *names: str) -> Any:
    """An option that means something on the simulated device only."""
    return typer.Option(*names, help=words, rich_help_panel=ON_THE_SIMULATOR)


LibraryFile = Annotated[Path, typer.Argument(help="library.npz")]
Simulate = Annotated[bool, typer.Option("--simulate", help="On the simulated device, in virtual time.")]
Port = Annotated[str, typer.Option(help="A name that `ports` lists, or socket://HOST:PORT.")]
AnyPort = Annotated[str | None, typer.Option(help="On a device: a name that `ports` lists, or socket://HOST:PORT.")]
Gain = Annotated[
    float | None,
    typer.Option(help="Scale of what is played, 0 to 1; default 1."),
]
Reset = Annotated[bool, with_port("Leave a latched fault first; its cause must be gone.", "--reset")]
Seconds = Annotated[float | None, with_port("End after so many seconds; default: on Ctrl-C.", "--for")]
TapCount = Annotated[int | None, with_port("End after so many; default: on Ctrl-C.")]
DeviceName = Annotated[
    str | None,
    typer.Option(
        "--device",
        help="What the device is: a device file or a built-in example; default device.toml beside the library, else "
        "the built-in device.",
    ),
]
DEFAULT_SCENE = "wood_on_foam"  # of a true device that is not named
TrueDeviceName = Annotated[
    str | None,
    with_simulate(
        "Whose device it is, before --mismatch: built-in scene, .toml or library.npz; default the library's own, "
        "without one wood_on_foam.",
        "--true-device",
    ),
]
Mismatch = Annotated[float, with_simulate("Every parameter is off by up to this part; 0.1: 10 %.")]
Seed = Annotated[int, with_simulate("Of phase, noise and mismatch.")]
Crossover = Annotated[float, with_simulate("Half-width of the amplifier's dead band, in A.")]


def within(option: str, value: float | None, low: float, high: float, unit: str = "") -> None:
    """Whether the value of an option lies within its limits; one that was not given does.

    Raises
    ------
    InputError : it does not, or is no number.
    """
    if value is not None and not low <= value <= high:
        raise InputError(f"--{option} {value:g}: must be {low:g} to {high:g}{unit}")


def one_of(option: str, value: str, choices: Iterable[str]) -> None:
    """Whether the value of an option is one of its words.

    Raises
    ------
    InputError : it is not.
    """
    words = list(choices)
    if value not in words:
        raise InputError(f"--{option} {value}: must be one of {', '.join(words)}{did_you_mean(value, words)}")


def numbers(option: str, text: str | None, low: float, high: float, unit: str) -> list[float] | None:
    """An option of several numbers like 1,3,5; None if it was not given.

    Raises
    ------
    InputError : a word that is no number within its limits.
    """
    if text is None:
        return None
    try:
        found = [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(f"--{option} {text}: must be numbers with commas between, like 1,3,5") from None
    for value in found:
        within(option, value, low, high, unit)
    return found


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
    meaningless = ON_A_PORT if simulated else ON_THE_SIMULATOR
    why = "only with --port" if simulated else "only with --simulate"
    if command == "tap" and not simulated:
        why = f"on a device that is up to its user: {why}"
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        given = source is not None and source.name == "COMMANDLINE"
        if given and getattr(parameter, "rich_help_panel", None) == meaningless:
            raise InputError(f"{parameter.opts[0]}: {why}")
    return simulated


def imperfect(device: "DeviceFile", mismatch: float, seed: int, crossover: float) -> "Imperfections":
    """From the options --mismatch, --seed and --crossover, with the sensors as a device file describes them.

    Raises
    ------
    InputError : a number out of its range.
    """
    from controller.sim.sensors import Sensors
    from controller.sim.simulator import Imperfections

    within("mismatch", mismatch, 0.0, 0.5, ", the part by which parameters are off")
    within("crossover", crossover, 0.0, 1.0, " A")
    within("seed", seed, 0, 2**63 - 1)
    stated = device.accelerometer
    sensors = Sensors(count_m=device.encoder.count_m, accelerometer_bandwidth_Hz=stated.bandwidth_Hz)
    if stated.range_g is not None:
        sensors = replace(sensors, accelerometer_range_g=stated.range_g)
    return Imperfections(mismatch=mismatch, crossover_A=crossover, sensors=sensors)


def of_scene(named: str | None) -> str:
    """The option by which `transopt identify` takes motor and amplifier of the scene whose device was recorded.

    Empty for the default scene, and for a library, which is no scene.
    """
    if named in (None, DEFAULT_SCENE) or Path(named).suffix.lower() == ".npz":
        return ""
    return f" --scene {shlex.quote(named)}"
