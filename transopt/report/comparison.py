"""Comparison of two libraries: entries of both, entries of only one, and values stated differently."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from transopt.base import writing
from transopt.base.errors import InputError
from transopt.base.tables import Table
from transopt.library.columns import NAN, UNKNOWN, EntryTable, TableRow
from transopt.library.library import Library

LONGEST_VALUE = 60  # characters shown of a value; a longer list or text is shown by its size
CHANGE_COLUMNS = ("stated", "A", "B")
LEGEND = "One figure where both libraries print the same, A -> B where they differ."
ABSENT = "not stated"

# Speed [m/s] and grip [N], to nine digits since refined nodes differ in the last ones; or the name of a target.
Node = tuple[str, ...]


FIGURES = ("tap", "floor", "after_peak", "peak", "winding", "verdict")


@dataclass(frozen=True)
class Comparison:
    """Two libraries, A and B.

    Attributes
    ----------
    both : node -> its row in the tables of A and of B.
    places : node -> the entry in words.
    apart : node -> largest difference of the two commands; NaN if they are issued at different instants.
    only_first, only_second : nodes of only one of them.
    changes : (dotted path in `meta`, value in A, value in B) of all differences.
    same_content : whether both files have identical content.
    columns : heads of the columns that identify a node.
    unit : unit of the commands.
    claims : what is proven of A and of B if not that each command is an optimum; else empty.
    """

    both: dict[Node, tuple[TableRow, TableRow]]
    places: dict[Node, str]
    apart: dict[Node, float]
    only_first: list[Node]
    only_second: list[Node]
    changes: list[tuple[str, str, str]]
    same_content: bool
    columns: list[str]
    unit: str
    claims: tuple[str, str] = ("", "")

    @classmethod
    def of(cls, first: Library, second: Library) -> "Comparison":
        """Compare by nodes; entries whose nodes agree to nine digits are the same entry.

        Raises
        ------
        InputError : one has speeds and the other targets, or one has commands in A and the other in V.
        """
        for what, (one, other) in (
            ("entries", tuple(" and ".join(each.axes.columns) for each in (first, second))),
            ("commands", (first.driven_by.name, second.driven_by.name)),
        ):
            if one != other:
                raise InputError(f"compare: the {what} of A are by {one}, those of B by {other}: nothing to compare")
        ours, theirs = _entries(first), _entries(second)
        there = {node: (ours[node], theirs[node]) for node in ours if node in theirs}
        comparable = _instants(first) == _instants(second)
        return cls(
            both={node: (first.row(*a), second.row(*b)) for node, (a, b) in there.items()},
            places={node: first.axes.place(*a) for node, (a, _) in there.items()},
            apart={
                node: float(np.abs(first.command[a] - second.command[b]).max()) if comparable else NAN
                for node, (a, b) in there.items()
            },
            only_first=[node for node in ours if node not in theirs],
            only_second=[node for node in theirs if node not in ours],
            changes=_changes(first.meta, second.meta),
            same_content=first.content_sha256 == second.content_sha256,
            columns=first.axes.columns,
            unit=first.driven_by.unit,
            claims=(first.claim, second.claim),
        )

    @property
    def table(self) -> EntryTable:
        """The columns compared, without rows."""
        return EntryTable(self.columns, FIGURES, (), self.unit)

    @property
    def heads(self) -> list[str]:
        """Heads of the table of entries."""
        *before, verdict = self.table.heads
        return [*before, f"command apart {self.unit}", verdict]


def _instants(library: Library) -> tuple[float, float, int]:
    """Servo period [s], time from the first command to contact [s], and number of commands."""
    return library.dt_s, library.lead_s, library.command.shape[-1]


def _entries(library: Library) -> dict[Node, tuple[int, int]]:
    """Node -> indices (iv, ig) of its entry."""
    axes, (nv, ng) = library.axes, library.command.shape[:2]

    def node(iv: int, ig: int) -> Node:
        if axes.targets:
            return (axes.targets[iv],)
        at = axes.places[ig] if axes.places else ()
        return (f"{library.speeds_m_s[iv]:.9g}", f"{library.grips_N[ig]:.9g}", *map(str, at))

    return {node(iv, ig): (iv, ig) for iv in range(nv) for ig in range(ng)}


def _flat(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted path and value of each leaf of nested tables; a list is one value."""
    if isinstance(value, dict) and value:
        for name, inner in value.items():
            yield from _flat(inner, f"{path}.{name}" if path else name)
    else:
        yield path, value


def _changes(first: dict[str, Any], second: dict[str, Any]) -> list[tuple[str, str, str]]:
    ours, theirs = dict(_flat(first)), dict(_flat(second))
    # A table that only one library has is compared key by key; a null at its path in the other one is not shown.
    paths = [path for path in dict.fromkeys([*ours, *theirs]) if ours.get(path) != theirs.get(path)]
    return [(path, *_shown(ours.get(path), theirs.get(path))) for path in paths]


def _shown(first: Any, second: Any) -> tuple[str, str]:
    """Two different values as text, shortened if long; for long lists the number of values that differ."""
    texts = [_text(value) for value in (first, second)]
    if not (isinstance(first, list) and isinstance(second, list) and max(map(len, texts)) > LONGEST_VALUE):
        ours, theirs = (text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 4]} ..." for text in texts)
        return ours, theirs
    ours, theirs = (_counted(len(value), "value", "values") for value in (first, second))
    if len(first) != len(second):
        return ours, theirs
    pairs = [(ours, theirs) for ours, theirs in zip(first, second, strict=True) if ours != theirs]
    tables = [(ours, theirs) for ours, theirs in pairs if isinstance(ours, dict) and isinstance(theirs, dict)]
    named = dict.fromkeys(name for ours, theirs in tables for name in ours if ours[name] != theirs.get(name))
    inside = f" in {', '.join(named)}" if named else ""
    return ours, f"{theirs}, {len(pairs)} of them others{inside}"


def _counted(count: int, one: str, several: str) -> str:
    return f"{count} {one if count == 1 else several}"


def _text(value: Any) -> str:
    if value is None:
        return ABSENT
    return value if isinstance(value, str) else json.dumps(value)


def _from_to(first: str, second: str) -> str:
    return first if first == second else f"{first} -> {second}"


def _rows(found: Comparison) -> Iterator[tuple[list[str], bool]]:
    """Cells of the entry table, and whether the row is highlighted (`entry_table`)."""
    for node, rows in found.both.items():
        pairs = zip(*(found.table.figures(row) for row in rows), strict=True)
        *figures, verdict = [_from_to(ours, theirs) for ours, theirs in pairs]
        command = UNKNOWN if np.isnan(found.apart[node]) else f"{found.apart[node]:.2g}"
        yield [*node, *figures, command, verdict], rows[0].value("verdict") != rows[1].value("verdict")
    for name, nodes in (("A", found.only_first), ("B", found.only_second)):
        for node in nodes:
            yield [*node, *[UNKNOWN] * len(FIGURES), f"only in {name}"], True


def entry_table(found: Comparison, title: str) -> Table:
    """One row per entry, yellow if the verdict changed or only one library has the entry."""
    table = Table.of(title, found.heads, words=("verdict",), caption=LEGEND, keys=len(found.columns))
    for cells, striking in _rows(found):
        table.add_row(*cells, style="yellow" if striking else None)
    return table


def change_table(found: Comparison) -> Table:
    """The values that the two libraries state differently, by dotted path."""
    table = Table.of("stated differently", CHANGE_COLUMNS, words=CHANGE_COLUMNS, whole=CHANGE_COLUMNS[:1])
    for row in found.changes:
        table.add_row(*row)
    return table


def comparison_summary(found: Comparison) -> str:
    """One line: number of entries, largest change of the error, number of values stated differently."""
    of: dict[str, list[str]] = {}
    for name, claim in zip("AB", found.claims, strict=True):
        of.setdefault(claim, []).append(name)
    claims = [f"{' and '.join(names)}: {claim}" for claim, names in of.items() if claim]
    entries = _counted(len(found.both), "entry", "entries")
    if found.same_content:
        return "; ".join([f"{entries}; A and B hold the same content", *claims])
    sentences = [f"{entries} in both"]
    sentences += [
        f"{len(nodes)} only in {name}" for name, nodes in (("A", found.only_first), ("B", found.only_second)) if nodes
    ]
    change = {node: theirs.value("tap") - ours.value("tap") for node, (ours, theirs) in found.both.items()}
    if change:
        worst = max(change, key=lambda node: abs(change[node]))
        points = f"{100 * change[worst]:+.2g} points" if change[worst] else "nothing"
        sentences.append(f"tap error changes most by {points}, at {found.places[worst]}")
    sentences.append(f"{_counted(len(found.changes), 'value', 'values')} stated differently")
    return "; ".join([*sentences, *claims])


def comparison_markdown(found: Comparison, names: str) -> str:
    """Render a comparison as a Markdown document."""
    lines = ["# Two libraries", "", names, "", comparison_summary(found), "", "## Entries", "", LEGEND, ""]
    lines += writing.table(found.heads, [cells for cells, _ in _rows(found)])
    if found.changes:
        escaped = [[cell.replace("|", "\\|") for cell in row] for row in found.changes]
        lines += ["## Stated differently", "", *writing.table(CHANGE_COLUMNS, escaped)]
    return "\n".join(lines)
