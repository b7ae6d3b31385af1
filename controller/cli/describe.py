"""`transopt-play device new|show|circuit`: what a device is, asked for step by step and written to its file.

Also how every other command finds the device that it is about.
"""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from transopt.base import terminal
from transopt.base.asking import answer
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from controller.device.reading import Described

device_app = typer.Typer(
    no_args_is_help=True,
    help="Describe a device in a file that every command reads.",
    epilog="Example: transopt-play device new device.toml",
)
NO_ANSWERS = "device new: no answers came; type them, or take the values offered with --defaults"
# Without a sensor nothing is asked of it, with one nothing is assumed.
POINTLESS = {
    "grip": {True: ("assumed_grip_N",), False: ("scale", "zero_N")},
    "accelerometer": {True: (), False: ("scale", "rest_m_s2", "bandwidth_Hz", "range_g")},
}


@device_app.callback()
def device() -> None:
    """Describe a device in a file that every command reads."""


@device_app.command("new", epilog="Example: transopt-play device new device.toml")
def new(
    file: Annotated[Path, typer.Argument(help="The device file to write, as a rule device.toml beside a library.")],
    like: Annotated[
        str, typer.Option("--from", help="Built-in example or device file whose values are offered.")
    ] = "with_grip",
    defaults: Annotated[bool, typer.Option("--defaults", help="Ask nothing: take the values offered.")] = False,
) -> None:
    """Ask what a device is, step by step, and write it to a file; an empty answer takes what is offered."""
    from controller.device.device_file import DeviceFile
    from controller.device.reading import find, write_device

    if file.exists():
        raise InputError(f"{file}: is there already; choose another name, or change it in an editor")
    offered = find(like).device
    described = offered if defaults else DeviceFile.model_validate(_asked(offered))
    write_device(file, described, "What this device is; every command of transopt-play reads it.")
    named = shlex.quote(str(file))
    terminal.console().print(
        f"{file}: written\nnext: transopt-play zero --device {named} --port PORT, then "
        f"transopt-play check --device {named} --port PORT --sweep"
    )


@device_app.command("show", epilog="Example: transopt-play device show with_grip")
def show(
    file: Annotated[
        str | None, typer.Argument(help="Device file or built-in example; default the built-in device.")
    ] = None,
) -> None:
    """What a device file says, and what is the built-in device's because the file does not state it."""
    from controller.device.device_file import TABLES
    from controller.device.reading import all_keys, examples, find, value_of
    from transopt.base.tables import Table
    from transopt.base.units import unit_of

    found = find(file)
    heads = ("key", "value", "unit", "stated", "what it is")
    table = Table.of(f"{found.source}: {found.device.name}", heads, words=heads)
    for key in all_keys():
        section, _, name = key.partition(".")
        value = value_of(found.device, key)
        table.add_row(
            key,
            "-" if value is None else str(value),
            unit_of(key),
            "yes" if key in found.stated else "no" if value is None else "no: built-in",
            TABLES[section].model_fields[name].description or "",
        )
    console = terminal.console()
    console.print(table)
    if file is None:
        console.print(f"built-in examples: {', '.join(examples())}")


@device_app.command("circuit", epilog="Example: transopt-play device circuit circuit.toml")
def circuit(
    file: Annotated[Path | None, typer.Argument(help="Circuit file: datasheets of what is wired.")] = None,
    example: Annotated[
        str | None, typer.Option(help="Print a built-in circuit file to start from: escon_re25 or bridge_re40.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over files that are there.")] = False,
) -> None:
    """Resistors and scales of a circuit; hardware.h, scene.toml and offered.toml are written beside its file."""
    from controller.cli.options import one_of
    from controller.device.circuit_file import CIRCUITS, load_circuit, rows_of, write_files
    from transopt.base.tables import Table

    if (file is None) == (example is None):
        raise InputError("device circuit: give a circuit FILE, or --example escon_re25 > circuit.toml to start from")
    if example is not None:
        one_of("example", example, CIRCUITS)
        typer.echo(CIRCUITS[example].read_text(encoding="utf-8"), nl=False)
        return
    assert file is not None
    built, scene = load_circuit(file)
    written = write_files(built, scene, file, force=force)
    heads = ("what", "value", "remark")
    table = Table.of(built.circuit.name, heads, words=heads)
    for row in rows_of(built):
        table.add_row(*row)
    console = terminal.console()
    console.print(table)
    header, _, offered = written
    device = shlex.quote(str(file.with_name("device.toml")))
    console.print(
        f"written: {', '.join(map(str, written))}\n"
        f"next: put {header.name} beside the sketch and flash it, then "
        f"transopt-play device new {device} --from {shlex.quote(str(offered))}"
    )


def _asked(offered: Any) -> dict[str, Any]:
    """What a person answers, key by key, each checked as it is given."""
    from controller.device.device_file import TABLES

    console = terminal.console()
    answers: dict[str, Any] = {"name": answer("name", "what you call it", "", offered.name, str, without=NO_ANSWERS)}
    for table, kind in TABLES.items():
        console.print(f"\n{table}: {(kind.__doc__ or '').splitlines()[0]}")
        given: dict[str, Any] = {}
        answers[table] = given
        for key, field in kind.model_fields.items():
            if key in POINTLESS.get(table, {}).get(given.get("sensor", True), ()) and "sensor" in kind.model_fields:
                continue
            default = getattr(getattr(offered, table), key)
            value = _checked_answer(kind, table, key, field.description or "", default)
            if value is not None:
                given[key] = value
    return answers


def _checked_answer(kind: Any, table: str, key: str, why: str, default: Any) -> Any:
    from pydantic import ValidationError

    from transopt.base.toml import in_words
    from transopt.base.units import unit_of

    def parsed(text: str) -> Any:
        if isinstance(default, bool):
            words = {"yes": True, "y": True, "true": True, "no": False, "n": False, "false": False}
            if text.lower() not in words:
                raise ValueError("answer yes or no")
            return words[text.lower()]
        value: Any = int(text) if isinstance(default, int) else float(text)
        try:
            kind.model_validate({key: value})
        except ValidationError as error:
            raise ValueError(in_words(error.errors()[0]["msg"])) from None
        return value

    return answer(f"{table}.{key}", why, unit_of(key), default, parsed, without=NO_ANSWERS)


def described(named: str | None, library: Path | None = None, *, quiet: bool = False) -> "Described":
    """The device that a command is about; says in one line whose numbers are taken.

    Parameters
    ----------
    named : by --device. library : beside which device.toml is looked for.
    quiet : says nothing of the built-in device, which a simulated one is by itself.

    Raises
    ------
    InputError : the file cannot be read, or says what no device can be.
    """
    from controller.device.reading import find

    found = find(named, library)
    if found.stated or not quiet:
        terminal.console().print(found.in_words)
    return found
