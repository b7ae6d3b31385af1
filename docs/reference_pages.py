"""The parts of the reference that the code states: written anew at every build, so that no page can drift from it."""

from collections.abc import Callable, Iterator
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import get_args

import click
import typer
from key_pages import device_keys, scene_keys
from page_tables import code, table

from controller.protocol.codes import EVIDENCE_FAULTS
from controller.servo.interface import Fault, Notice, State
from controller.servo.rules import (
    FEWEST_TICKS,
    QUIET_BLOCK_S,
    QUIET_BLOCKS,
    QUIET_M_S2,
    QUIET_SWING_A,
    STUCK_COUNTS,
    STUCK_HELD,
    STUCK_LEAST_M,
    STUCK_TURNS,
    WRONG_CURRENT_A,
    WRONG_CURRENT_PART,
    WRONG_CURRENT_S,
)
from controller.servo.settings import Settings
from transopt.base import sizes
from transopt.base.section import Section, meanings
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.base.units import LARGEST, unit_of
from transopt.library.arrays import HASH_FIELD
from transopt.library.columns import COLUMNS
from transopt.library.meta import META
from transopt.library.multipliers import ARRAYS
from transopt.problem.answer import Status
from transopt.scene.fitted import Source
from transopt.scene.model_file import ModelFile
from transopt.scene.model_parts import ChainHand, ModelParts

PROGRAMS = {
    "transopt": "transopt.cli.main",
    "transopt-play": "controller.cli.play",
    "transopt-device": "controller.cli.device",
}
# Criterion of each fault, in the order of the checks: the first one that trips is latched. Names in
# braces are settings.
SEEN_WHEN = {
    Fault.EMERGENCY_STOP: "it is pressed",
    Fault.HOST_STOP: "a host asks for it over the link",
    Fault.LATE_TICK: "the port says that a servo period came late",
    Fault.BAD_SENSOR: (
        "encoder or current give no number, or more than {encoder_limit_counts} counts or {current_range_A} A"
    ),
    Fault.OVER_CURRENT: "the measured current is above {over_current} times the limit",
    Fault.OVER_TEMPERATURE: "the estimated winding is above its limit, or no number",
    Fault.ENCODER_JUMP: "the encoder moves faster than {fastest_m_s} m/s",
    Fault.ENCODER_STUCK: (
        "{stuck_A_s} A s of a transient pass without a count of the encoder, or {stuck_s} s above {stuck_A} A, or "
        f"as long within two neighbouring counts with {STUCK_TURNS} turns or more, as one with a single "
        "channel makes; or, by the accelerometer, a motion of "
        f"{STUCK_COUNTS:g} counts and {1e3 * STUCK_LEAST_M:g} mm while a transient plays, {STUCK_HELD:g} times that "
        "while more than {stuck_A} A flow in a wall. A hand that presses for {stuck_s} s without a count is taken "
        "for it too: one five times calmer than most, or any over 59 um a count on a wall of 2000 N/m"
    ),
    Fault.NO_CURRENT: (
        "for {no_current_s} s less than {no_current_part} of the expected current flows, where that is "
        f"{{no_current_A}} A or more; {FEWEST_TICKS} periods at least"
    ),
    Fault.WRONG_CURRENT: (
        f"the measured current is for {1e3 * WRONG_CURRENT_S:g} ms further from the expected "
        f"one than {WRONG_CURRENT_A:g} A and {100 * WRONG_CURRENT_PART:g} % of it; {FEWEST_TICKS} periods at least"
    ),
    Fault.GRIP_OPEN: "the grip reads below {grip_open_N} N, or no number",
    Fault.GRIP_SHORT: "the grip reads above {grip_short_N} N",
    Fault.GRIP_LOST: "while a transient plays the grip falls below the library's least",
    Fault.ACCELEROMETER_DEAD: (
        f"while a transient plays the current swings by {QUIET_SWING_A:g} A or more within "
        f"{1e3 * QUIET_BLOCKS * QUIET_BLOCK_S:g} ms and the accelerometer by less than "
        f"{QUIET_M_S2 / STANDARD_GRAVITY_M_S2:g} g rms"
    ),
}

TAKEN = "taken: a cable plugged in anew may be reversed"


def shown(value: object) -> str:
    return "" if value is None or value == "" else f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def library_arrays() -> str:
    """Every array of a library file."""
    rows = [
        [code(name), " x ".join(array.shape), array.type_word, array.unit, array.meaning, code(array.needs)]
        for name, array in ARRAYS.items()
    ]
    rows.append([code("meta"), "", "text", "", "JSON: scene, numbers that follow from it, recordings, versions", ""])
    rows.append([code(HASH_FIELD), "", "text", "", "SHA-256 over names, types, shapes and bytes of all others", ""])
    return table(["array", "shape", "type", "unit", "meaning", "only where stated"], rows)


def library_meta() -> str:
    """What `meta` of a library states."""
    rows = []
    for path, stated in META.items():
        kept = f"{stated.meaning} (kept whole)" if stated.whole else stated.meaning
        rows.append([code(path), unit_of(path), kept, stated.null, "always" if stated.needed else ""])
    return table(["key", "unit", "meaning", "null", "has to be there"], rows)


def _model_part(name: str, section: type[Section]) -> str:
    """A table of the fields of a part.

    Raises
    ------
    KeyError : a field of which its class does not say what it is.
    """
    said, rows = meanings(section), []
    for field_name, field in section.model_fields.items():
        label = field.alias or field_name
        needed = "" if field.is_required() else "may be missing"
        rows.append([code(label), unit_of(label), said[field_name], needed])
    return f"### {name}\n\n{table(['field', 'unit', 'meaning', ''], rows)}"


def model_file() -> str:
    """Every field of a model file, a section for each of its parts."""
    sections = [_model_part("The file", ModelFile)]
    for name, field in ModelParts.model_fields.items():
        for part in get_args(field.annotation):
            for kind in get_args(part) or [part]:
                for section in get_args(kind) or [kind]:
                    if isinstance(section, type) and issubclass(section, Section):
                        sections.append(_model_part(f"`{name}`, {section.__name__}", section))
    sections.append(_model_part("`hand` of a `drive` device", ChainHand))
    return "\n\n".join([*sections, _model_part("One of `sources`", Source)])


def faults() -> str:
    """What makes a device give up, in the order in which it is looked for."""
    numbers = {field.name: field.default for field in fields(Settings)}
    rows = [
        [code(fault.name), seen.format_map(numbers), fault.value, TAKEN if fault in EVIDENCE_FAULTS else "kept"]
        for fault, seen in SEEN_WHEN.items()
    ]
    return table(["fault", "seen when", "what it says", "evidence"], rows)


def states() -> str:
    return ", ".join(state.name for state in State)


def notices() -> str:
    """What a device tells and counts, and goes on."""
    return table(["notice", "what it says"], [[code(notice.name), notice.value] for notice in Notice])


def bounds() -> str:
    """How large inputs may be: of each unit, and in all."""
    by_unit = table(["unit", "largest size of a number"], [[unit, f"{most:g}"] for unit, most in LARGEST.items()])
    inputs = [
        ["servo period", f"{sizes.SHORTEST_DT_S:g} to {sizes.LONGEST_DT_S:g} s"],
        ["waveform", f"{sizes.MOST_STAGES} commands and {sizes.LONGEST_HORIZON_S:g} s"],
        ["delay of an amplifier", f"{sizes.LONGEST_DELAY_S:g} s"],
        ["lead", f"{sizes.LONGEST_LEAD_S:g} s"],
        ["what is looked at after the waveform", f"{sizes.MOST_AFTER} samples and {sizes.LONGEST_AFTER_S:g} s"],
        ["speeds, and grips, of a library", f"{sizes.MOST_NODES} each"],
        ["commands of a library", f"{sizes.MOST_COMMANDS}"],
        ["states of a device", f"{sizes.MOST_STATES}"],
        ["devices that a robust entry serves besides its own", f"{sizes.MOST_DEVICES}"],
        ["recordings of a scene", f"{sizes.MOST_FILES}"],
        ["a recording", f"{sizes.MOST_SAMPLES} samples, {sizes.MOST_COLUMNS} columns"],
        ["file of a scene, a motor or a device", sizes.megabytes(sizes.MOST_TEXT_BYTES)],
        ["model file", sizes.megabytes(sizes.MOST_MODEL_BYTES)],
        ["file of a recording or a library", sizes.megabytes(sizes.MOST_FILE_BYTES)],
        ["the same, unpacked", sizes.megabytes(sizes.MOST_UNPACKED_BYTES)],
        ["tables in tables, of TOML and JSON", f"{sizes.DEEPEST} deep"],
    ]
    return f"{table(['input', 'at most'], inputs)}\n\n{by_unit}"


def exit_codes() -> str:
    """What exit code 1 of every command means, as its help says it."""
    rows = []
    for words, command in leaves():
        _, said, meaning = _prose(command.help).partition("Exit 1: ")
        if said:
            rows.append([code(words), meaning.rstrip(".")])
    return table(["command", "exit code 1"], rows)


def leaves() -> Iterator[tuple[str, click.Command]]:
    """Every command that does something, by the words that call it."""
    for program, module in PROGRAMS.items():
        yield from _leaves(typer.main.get_command(import_module(module).app), program)


def _leaves(command: click.Command, words: str) -> Iterator[tuple[str, click.Command]]:
    inner = getattr(command, "commands", None)
    if inner is None:
        yield words, command
    for name, one in (inner or {}).items():
        yield from _leaves(one, f"{words} {name}")


def statuses() -> str:
    """How an entry of a library may end."""
    return table(["status", "what it means"], [[code(status.name), status.value] for status in Status])


def columns() -> str:
    """Columns of the tables of entries, as terminal, report, `show` and `compare` print them."""
    words = {"target": "the recorded tap", "over": "over the intention", "ends": "", "input": "current", "unit": "A"}
    heads = [column.head.split(" {at}")[0].format(**words) for column in COLUMNS.values()]
    return table(
        ["column", "what it means"],
        [
            [head, column.meaning.format(**words)]
            for head, column in zip(heads, COLUMNS.values(), strict=True)
            if column.meaning
        ],
    )


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
    "device_keys": device_keys,
    "scene_keys": scene_keys,
    "library_arrays": library_arrays,
    "library_meta": library_meta,
    "model_file": model_file,
    "bounds": bounds,
    "exit_codes": exit_codes,
    "faults": faults,
    "notices": notices,
    "states": states,
    "statuses": statuses,
    "columns": columns,
}


def write(folder: Path) -> None:
    """Write every part as a file of its name, for the pages of the reference to include."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, made in PARTS.items():
        path, content = folder / f"{name}.md", made() + "\n"
        # A file that would be the same stays untouched, so that a build after it has nothing to do.
        if not path.exists() or path.read_text(encoding="utf-8") != content:
            path.write_text(content, encoding="utf-8")
