"""The parts of the reference that the code states: written anew at every build, so that no page can drift from it."""

from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from pathlib import Path

import click
import typer

from controller.protocol import codes, messages
from controller.protocol.packed import OPEN_END, Packed
from transopt.library.arrays import HASH_FIELD
from transopt.library.library import ARRAYS
from transopt.problem.answer import Status
from transopt.scene.builtin import load_scene
from transopt.scene.keys import keys

PROGRAMS = {
    "transopt": "transopt.cli.main",
    "transopt-play": "controller.cli.play",
    "transopt-device": "controller.cli.device",
}
DEFAULT_SCENE = "wood_on_foam"
TYPES = {
    "B": "u8",
    "H": "u16",
    "I": "u32",
    "i": "i32",
    "Q": "u64",
    "f": "f32",
    "d": "f64",
    "32s": "32 bytes",
    OPEN_END: "what is left",
}


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""

    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(" ".join(cell.split()).replace("|", "\\|") for cell in cells) + " |"

    return "\n".join([line(head), "|---" * len(head) + "|", *map(line, rows)])


def code(word: object) -> str:
    return f"`{word}`" if str(word) else ""


def shown(value: object) -> str:
    return "" if value is None or value == "" else f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def scene_keys() -> str:
    """Every key of a scene, a section for each of its tables."""
    sections: dict[str, list[list[str]]] = {}
    about: dict[str, str] = {}
    for key in keys(load_scene(DEFAULT_SCENE)):
        name = key.path.rpartition(".")[0] or key.path
        default = "to be stated" if key.required else shown(key.default)
        allowed = [key.bounds, ", ".join(code(word) for word in key.choices), "`none`" if key.optional else ""]
        about.setdefault(name, key.description)
        sections.setdefault(name, []).append(
            [code(key.path), key.unit, default, shown(key.value), " or ".join(filter(None, allowed))]
        )
    head = ["key", "unit", "default", f"in `{DEFAULT_SCENE}`", "allowed"]
    return "\n\n".join(f"## {code(name)}\n\n{about[name]}\n\n{table(head, rows)}" for name, rows in sections.items())


def library_arrays() -> str:
    """Every array of a library file."""
    rows = [
        [code(name), " x ".join(array.shape), array.type_word, array.unit, array.meaning, code(array.needs)]
        for name, array in ARRAYS.items()
    ]
    rows.append([code("meta"), "", "text", "", "JSON: time axis, limits, weights, scene, recordings, versions", ""])
    rows.append([code(HASH_FIELD), "", "text", "", "SHA-256 over names, types, shapes and bytes of all others", ""])
    return table(["array", "shape", "type", "unit", "meaning", "only where stated"], rows)


def statuses() -> str:
    """How an entry of a library may end."""
    return table(["status", "what it means"], [[code(status.name), status.value] for status in Status])


def refusals() -> str:
    """Why a device refuses a request."""
    rows = [[str(number), code(reason.name), reason.value] for number, reason in codes.REASONS.items()]
    return table(["number", "reason", "what it says"], rows)


def protocol_events() -> str:
    rows = [[str(number), code(what.name), str(what.value)] for number, what in codes.EVENTS.items()]
    return table(["number", "event", "what it says"], rows)


def _fields(body: type[Packed]) -> str:
    if not body.layout():
        return "No fields."
    return table(["field", "type"], [[code(name), TYPES[format_]] for name, format_ in body.layout()])


def protocol_messages() -> str:
    """Every kind of frame with its body, and the record of telemetry."""
    sections = []
    for kind, body in messages.MESSAGES.items():
        way = "host to device" if kind < 64 else "device to host"
        said = "" if not body.__doc__ or body.__doc__.startswith(f"{body.__name__}(") else _prose(body.__doc__)
        sections.append("\n\n".join(filter(None, [f"## {kind.name} ({kind.value}, {way})", said, _fields(body)])))
    sections.append(
        f"## A record in TELEMETRY_DATA\n\n{_prose(messages.Record.__doc__)}\n\n{_fields(messages.Record)}"
    )
    return "\n\n".join(sections)


def _prose(text: str | None) -> str:
    return "\n\n".join(" ".join(part.split()) for part in (text or "").split("\n\n"))


def commands() -> str:
    """The help of every command."""
    sections = []
    for program, module in PROGRAMS.items():
        sections += _command(typer.main.get_command(import_module(module).app), [program])
    return "\n\n".join(sections)


def _command(command: click.Command, words: list[str]) -> list[str]:
    inner = getattr(command, "commands", None)
    head = f"{'#' * 2} {code(' '.join(words))}\n\n{_prose((command.help or '').replace(chr(8), ''))}"
    if inner is not None:
        listed = table(
            ["command", "what it does"], [[code(name), one.get_short_help_str(200)] for name, one in inner.items()]
        )
        below = [part for name, one in inner.items() for part in _command(one, [*words, name])]
        return [f"{head}\n\n{listed}", *below]
    rows = []
    for parameter in command.params:
        if parameter.name == "help" or getattr(parameter, "hidden", False):
            continue
        argument = parameter.param_type_name == "argument"
        name = (parameter.name or "").upper() if argument else ", ".join([*parameter.opts, *parameter.secondary_opts])
        default = None if callable(parameter.default) or parameter.default is False else parameter.default
        plain = isinstance(default, str | int | float | Path)
        value = "required" if parameter.required else shown(default) if plain else ""
        rows.append([code(name), value, getattr(parameter, "help", None) or ""])
    return [head if not rows else f"{head}\n\n{table(['argument or option', 'default', 'what it is'], rows)}"]


PARTS: dict[str, Callable[[], str]] = {
    "commands": commands,
    "scene_keys": scene_keys,
    "library_arrays": library_arrays,
    "statuses": statuses,
    "messages": protocol_messages,
    "reasons": refusals,
    "events": protocol_events,
}


def write(folder: Path) -> None:
    """Write every part as a file of its name, for the pages of the reference to include."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, made in PARTS.items():
        path, content = folder / f"{name}.md", made() + "\n"
        # A file that would be the same stays untouched, so that a build after it has nothing to do.
        if not path.exists() or path.read_text(encoding="utf-8") != content:
            path.write_text(content, encoding="utf-8")
