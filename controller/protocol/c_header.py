"""The C core's view of the protocol: `python -m controller.protocol.c_header` writes firmware/src/core/td_messages.h.

A test compares the file with `header_text()`, so the two languages cannot drift apart.
"""

import struct
import textwrap
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path

from controller.protocol import capacity, codes, configuration, image, messages, packed, wire
from controller.protocol.messages import MESSAGES
from controller.protocol.packed import OPEN_END
from controller.servo import rules, settings
from controller.servo.interface import Fault
from transopt.plant.coil import WINDING_C

HEADER_PATH = Path(__file__).parents[1] / "firmware" / "src" / "core" / "td_messages.h"
C_TYPES = {"B": "u8", "H": "u16", "I": "u32", "i": "i32", "Q": "u64", "f": "f32", "d": "f64"}
# Field of Capacity -> the macro that a port may set; the first four are those of td_limits.h.
CAPACITY = {
    "speeds": "TD_MAX_SPEEDS",
    "grips": "TD_MAX_GRIPS",
    "waveform_samples": "TD_MAX_SAMPLES",
    "approach_ticks": "TD_MAX_WINDOW_TICKS",
    "latency_ticks": "TD_MAX_LATENCY_TICKS",
    "samples": "TD_MAX_LIBRARY_SAMPLES",
    "upload_frames": "TD_UPLOAD_FRAMES",
}
# Limits of `capacity`, under the same names; what a host takes by default is not the device's business.
LIMITS = {name: value for name, value in vars(capacity).items() if name.isupper() and name != "LEASE_DEFAULT_MS"}
LIMITS |= {name: value for name, value in vars(rules).items() if isinstance(value, int | float)}
LIMITS["COLDEST_C"] = WINDING_C[0]
LIMITS |= {
    name: getattr(settings, name) for name in ("DELAY_TICKS", "PULSE_NODES", "PUSH_S", "SCALE_LEAST", "SCALE_MOST")
}


def _define(name: str, value: object, note: str = "") -> str:
    return f"#define {name} {value}" + (f" /* {note} */" if note else "")


def _type(form: str) -> str:
    return "bytes up to the end" if form == OPEN_END else C_TYPES.get(form, f"{form[:-1]} bytes")


def _offsets(title: str, prefix: str, layout: list[tuple[str, str]]) -> list[str]:
    """Offset of each field, and how many bytes all of them take; their types stand in the comment."""
    places, offset = {}, 0
    for name, form in layout:
        places[name] = offset
        offset += 0 if form == OPEN_END else struct.calcsize("<" + form)
    types = ", ".join(f"{name} {_type(form)}" for name, form in layout)
    head = textwrap.wrap(f"/* {title}: {types or 'nothing'} */", 110, subsequent_indent=" * ")
    return [f"    {line}" for line in (*head, *_members(prefix, {**places, "bytes": offset}))]


def _members(prefix: str, members: dict[str, int]) -> list[str]:
    """Members of an enumeration, several to a line."""
    words = " ".join(f"{prefix}_{name.upper()}@=@{value}," for name, value in members.items())
    return [line.replace("@", " ") for line in textwrap.wrap(words, 110)]


def _enumeration(title: str, prefix: str, members: dict[str, int]) -> list[str]:
    return [f"/* {title} */", "enum {", *(f"    {line}" for line in _members(prefix, members)), "};", ""]


def _fault_bits(faults: Iterable[Fault]) -> int:
    return sum(1 << list(Fault).index(fault) for fault in faults)


def header_text() -> str:
    """td_messages.h."""
    lines = [
        "/* Generated from controller/protocol/messages.py by `python -m controller.protocol.c_header`: do not edit.",
        " *",
        " * Offsets into a frame's body, little-endian, TD_<message>_<field>; TD_<message>_BYTES is its length",
        " * without an open end. See controller/protocol/messages.py for what each message means.",
        " */",
        "#ifndef TD_MESSAGES_H",
        "#define TD_MESSAGES_H",
        "",
        '#include "td_port.h"',
        "",
        _define("TD_PROTOCOL", messages.PROTOCOL),
        _define("TD_MAGIC", f"0x{messages.MAGIC:08X}u"),
        _define("TD_HEADER_KIND", 0, "u8"),
        _define("TD_HEADER_FLAGS", 1, "u8, 0"),
        _define("TD_HEADER_SEQUENCE", 2, "u16"),
        _define("TD_HEADER_SESSION", 4, "u32"),
        _define("TD_HEADER_BYTES", messages.HEADER.size),
        _define("TD_BODY_LIMIT", messages.BODY_LIMIT),
        _define("TD_PAYLOAD_LIMIT", wire.PAYLOAD_LIMIT),
        _define("TD_FRAME_LIMIT", wire.ENCODED_LIMIT + 1, "encoded, delimiter included"),
        _define("TD_HASH_BYTES", packed.HASH_BYTES),
        _define("TD_DATA_LIMIT", messages.DATA_LIMIT, "bytes of an image in one DATA"),
        _define("TD_RECORDS_LIMIT", messages.RECORDS_LIMIT, "records in one TELEMETRY_DATA"),
        _define("TD_PULSE_SOUND", messages.PULSE_SOUND, "bit of evidence"),
        _define("TD_TRIAL_FINISHED", messages.TRIAL_FINISHED, "bit of evidence"),
        _define("TD_EVIDENCE_FAULTS", f"0x{_fault_bits(codes.EVIDENCE_FAULTS):X}u", "bits, see td_fault_bit"),
        _define("TD_RECORD_NO_COUNTS", "INT32_MIN", "of an encoder that gave no number"),
        "",
    ]
    lines += _enumeration("Kind of a frame", "TD_KIND", {kind.name: kind.value for kind in codes.Kind})
    lines += _enumeration("State", "TD_STATE", {state.name: j for j, state in enumerate(codes.STATES)})
    lines += _enumeration("Reason of REFUSED", "TD_REASON", {r.name: code for code, r in codes.REASONS.items()})
    lines += _enumeration(
        "What an event tells, 0 for nothing", "TD_WHAT", {w.name: code for code, w in codes.EVENTS.items()}
    )
    lines += _enumeration("How far the evidence has come", "TD_STAGE", {s.name: s.value for s in codes.Stage})
    lines += ["/* Bodies of the messages: where each field begins. */", "enum {"]
    for kind, message in MESSAGES.items():
        lines += _offsets(kind.name, f"TD_{kind.name}", message.layout())
    lines += _offsets("One record of TELEMETRY_DATA", "TD_RECORD", messages.Record.layout())
    lines += [*_offsets("Header of an image", "TD_IMAGE", list(image.IMAGE_FIELDS)), "};", ""]
    lines += ["/* Image of a library: header; speeds, grips, feedback norms, scales of cool commands f64; counts. */"]
    lines += [
        _define("TD_IMAGE_MAGIC_VALUE", f"0x{image.IMAGE_MAGIC:08X}u"),
        _define("TD_IMAGE_VERSION_VALUE", image.IMAGE_VERSION),
        _define("TD_IMAGE_BY_GRIP", image.BY_GRIP, "flag"),
        _define("TD_IMAGE_NEAREST", image.NEAREST, "flag"),
        _define(
            "TD_IMAGE_WALLED_COMMAND", image.WALLED_COMMAND, "of the command limit, for a transient beside a wall"
        ),
        "",
        "/* Configuration: magic u32, version u16, count u16, then float64 by these places. */",
        _define("TD_CONFIGURATION_MAGIC", f"0x{configuration.CONFIGURATION_MAGIC:08X}u"),
        _define("TD_CONFIGURATION_VERSION", configuration.CONFIGURATION_VERSION),
        _define("TD_CONFIGURATION_VALUES", configuration.HEADER.size, "offset of the first"),
        _define("TD_CONFIGURATION_BYTES", configuration.CONFIGURATION_BYTES),
        "",
    ]
    places = {name: place for place, name in enumerate(configuration.NAMES)}
    lines += _enumeration("Place in the configuration", "TD_CFG", {**places, "count": len(places)})
    lines += ["/* What a device holds; a port may set less with -D, HELLO_REPLY tells. */"]
    for field in fields(capacity.Capacity):
        macro = CAPACITY[field.name]
        lines += [f"#ifndef {macro}", _define(macro, field.default), "#endif"]
    lines += [
        "",
        _define("TD_MAX_IMAGE_BYTES", _largest_image()),
        "",
        *(_define(f"TD_{name}", value) for name, value in LIMITS.items()),
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def _largest_image() -> str:
    """`image.image_bytes` of the largest library with cool commands, by the port's own sizes."""
    nodes = "TD_MAX_SPEEDS * TD_MAX_GRIPS"
    return f"({image.HEADER.size} + 8 * (TD_MAX_SPEEDS + TD_MAX_GRIPS + 2 * {nodes}) + 2 * TD_MAX_LIBRARY_SAMPLES)"


if __name__ == "__main__":
    HEADER_PATH.parent.mkdir(parents=True, exist_ok=True)
    HEADER_PATH.write_text(header_text(), encoding="ascii", newline="\n")
