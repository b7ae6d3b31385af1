"""Binary messages: a head in JSON and arrays in float32, which a browser reads without parsing.

A frame is the length of the head in bytes (uint32, little-endian), the head, padded by spaces to a multiple of four,
and then the arrays one after the other in the order in which the head names them.
"""

import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.web.shown import Shown, plain

CURVES = (
    *("recorded_m_s2", "optimum_m_s2", "clipped_m_s2", "input", "clipped_input", "temperature_C"),
    *("warm_m_s2", "warm_input"),
)
LENGTH = struct.Struct("<I")


def frame(head: dict[str, Any], body: bytes) -> bytes:
    """A frame with this head and body."""
    text = json.dumps(head).encode()
    text += b" " * (-len(text) % 4)
    return LENGTH.pack(len(text)) + text + body


def arrays(head: dict[str, Any], named: Sequence[tuple[str, FloatArray]]) -> bytes:
    """A frame of arrays, which the head lists with their lengths."""
    listed = {"arrays": [[name, int(values.size)] for name, values in named]}
    return frame({**head, **listed}, b"".join(np.asarray(values, dtype="<f4").tobytes() for _, values in named))


def curves(head: dict[str, Any], taps: Sequence[Shown], view_s: tuple[float, float] | None = None) -> bytes:
    """A frame of taps: their times [s] once, then the curves of each, as `CURVES` names them.

    Parameters
    ----------
    view_s : time that is looked at; the frame has the samples within it and one more on each side. None for all.
    """
    named: list[tuple[str, FloatArray]] = []
    shown, seen = [], slice(None)
    for tap in taps:
        if tap.curves is None:
            continue
        if not named:
            times_s = tap.curves.times_s
            seen = slice(None) if view_s is None else _seen(times_s, view_s)
            named.append(("times_s", times_s[seen]))
            head = {**head, "whole_s": [float(np.float32(end)) for end in (times_s[0], times_s[-1])]}
        named += [(f"{tap.index}.{name}", getattr(tap.curves, name)[seen]) for name in CURVES]
        limit_C = tap.curves.temperature_limit_C
        shown.append(
            {
                **plain(tap),
                "input_limit": tap.curves.input_limit,
                "recorded_peak_m_s2": float(np.abs(tap.curves.recorded_m_s2).max()),
                "temperature_limit_C": limit_C if np.isfinite(limit_C) else None,
            }
        )
    return arrays({**head, "taps": shown}, named)


def _seen(times_s: FloatArray, view_s: tuple[float, float]) -> slice:
    """The samples within a time, at least two, and one more on each side where there is one."""
    first = int(np.searchsorted(times_s, view_s[0])) - 1
    after = int(np.searchsorted(times_s, view_s[1], side="right")) + 1
    first = min(max(first, 0), times_s.size - 2)
    return slice(first, max(after, first + 2))


def parted(message: bytes) -> tuple[dict[str, Any], bytes]:
    """Head and body of a frame from the browser.

    Raises
    ------
    InputError : the message is not a frame.
    """
    try:
        (length,) = LENGTH.unpack_from(message)
        head = json.loads(message[LENGTH.size : LENGTH.size + length])
    except (struct.error, ValueError):
        head = None
    if not isinstance(head, dict):
        raise InputError("a message of the page cannot be read: load the page again")
    return head, message[LENGTH.size + length :]
