"""Representation of values: a few lines in a terminal, a table and a small figure in a notebook."""

import base64
import io
import textwrap
from collections.abc import Container, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LONGEST = 360  # characters of a `repr`, four lines of a terminal
LINE = 100
LONGEST_TEXT = 60
MOST_ITEMS = 6  # items shown of a list of plain numbers or words
MOST_ROWS = 40  # rows shown of a table in a notebook
NOTEBOOK_DPI = 70


def brief(value: object) -> str:
    """`Name(field=..., ...)` in a few lines, however large the arrays are; classes use it as `__repr__ = brief`.

    An array is shown by its shape and range, a value with fields of its own by its class name. Fields that are None
    are not shown. Fields beyond the length limit are only counted.
    """
    return brief_without((), value)


def brief_without(hidden: Container[str], value: object) -> str:
    """`brief` without the fields of these names."""
    parts = [(name, part) for name, part in _parts(value) if part is not None and name not in hidden]
    shown = [f"{name}={summary(part)}" for name, part in parts]
    fitting, length = 0, len(type(value).__name__)
    while fitting < len(shown) and length + len(shown[fitting]) + 2 <= LONGEST:
        length += len(shown[fitting]) + 2
        fitting += 1
    more = [f"... {len(shown) - fitting} more"] if fitting < len(shown) else []
    return wrapped(f"{type(value).__name__}({', '.join(shown[:fitting] + more)})")


def cut(text: str, longest: int = 2 * LONGEST_TEXT) -> str:
    """Text cut to at most `longest` characters, with an ellipsis if it was cut."""
    return text if len(text) <= longest else text[: longest - 3] + "..."


def wrapped(text: str) -> str:
    """Text wrapped to the width of a terminal, all lines but the first indented."""
    return textwrap.fill(text, LINE, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)


def _parts(value: object) -> list[tuple[str, Any]]:
    """Fields of a dataclass, or of a section of a settings file."""
    if is_dataclass(value):
        return [(field.name, getattr(value, field.name)) for field in fields(value) if field.repr]
    return [(name, getattr(value, name)) for name in getattr(type(value), "model_fields", {})]


def summary(value: Any) -> str:
    """One value in a few words."""
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    if isinstance(value, Enum):
        return f"{type(value).__name__}.{value.name}"
    if isinstance(value, str):
        return repr(cut(value, LONGEST_TEXT))
    if isinstance(value, Mapping):
        return "{" + _some([str(key) for key in value], "keys") + "}"
    if isinstance(value, list | tuple):
        opening, closing = "[]" if isinstance(value, list) else "()"
        return opening + _some([summary(each) for each in value], "items") + closing
    if value is None or isinstance(value, bool | int | np.integer):
        return str(value)
    return f"{getattr(value, '__name__', type(value).__name__)}(...)"


def _some(words: list[str], what: str) -> str:
    text = ", ".join(words)
    return text if len(words) <= MOST_ITEMS and len(text) <= LONGEST_TEXT else f"{len(words)} {what}"


def _array(values: np.ndarray[Any, Any]) -> str:
    """Shape and range."""
    shape = "x".join(map(str, values.shape)) or "scalar"
    if values.dtype.kind not in "fiu" or values.size == 0:
        return f"<{shape} {values.dtype.kind if values.dtype.kind != 'U' else 'text'}>"
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return f"<{shape}, none finite>"
    low, high = float(finite.min()), float(finite.max())
    return f"<{shape}, {low:.4g}>" if low == high else f"<{shape}, {low:.4g} to {high:.4g}>"


def span(values: Sequence[float] | np.ndarray[Any, Any], unit: str, what: str) -> str:
    """Count and range as text: `4 speeds 0.1 to 0.4 m/s`."""
    count, first, last = len(values), float(values[0]), float(values[-1])
    return f"1 {what} {first:g} {unit}" if count == 1 else f"{count} {what}s {first:g} to {last:g} {unit}"


def html_table(caption: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """An HTML table for a notebook; at most `MOST_ROWS` rows, and the number of further ones."""

    def row(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    more = len(rows) - MOST_ROWS
    left = [f'<tr><td colspan="{len(columns)}">and {more} more</td></tr>'] if more > 0 else []
    body = [row(cells, "td") for cells in rows[:MOST_ROWS]]
    return f"<table><caption>{escape(caption)}</caption>{row(columns, 'th')}{''.join(body + left)}</table>"


def html_figure(figure: "Figure") -> str:
    """A figure for a notebook, as a PNG embedded in the HTML text."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=NOTEBOOK_DPI)
    return f'<img alt="figure" src="data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}">'
