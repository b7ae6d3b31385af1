"""Changes values in the text of a TOML file, line by line, so that the owner's comments and order stay."""

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from transopt.base.toml import toml_value


def edited(text: str, changes: Mapping[str, Any], *, noted: bool = True) -> str | None:
    """The text of a TOML file with some values changed and all comments kept.

    A removed line becomes a comment, and a key that only a comment states takes that comment's place.

    Parameters
    ----------
    changes : dotted path -> value; None removes the key. A whole table replaces the one of the same name.
    noted : whether a changed line notes the old value in a comment.

    Returns
    -------
    The text; None if there is no text, or if it does not state the changed keys line by line.
    """
    if not text:
        return None
    try:
        expected, lines = tomllib.loads(text), text.splitlines()
        for path, value in changes.items():
            _put(expected, path, value)
            lines = _table(lines, path, value) if isinstance(value, dict) else _line(lines, path, value, noted)
        found = "\n".join(lines) + "\n"
        return found if tomllib.loads(found) == expected else None
    except (tomllib.TOMLDecodeError, AttributeError, TypeError):
        return None


def _put(content: dict[str, Any], path: str, value: Any) -> None:
    *tables, key = path.split(".")
    for name in tables:
        content = content.get(name, {}) if value is None else content.setdefault(name, {})
    if value is None:
        content.pop(key, None)
    else:
        content[key] = value


@dataclass(frozen=True)
class _Statement:
    """A statement in the lines [start, stop) of a file: the table it belongs to, and its key (empty for a header)."""

    start: int
    stop: int
    table: str
    key: str


def _statements(lines: list[str]) -> Iterator[_Statement]:
    table, start = "", 0
    while start < len(lines):
        stop = start + 1
        if header := re.match(r"\s*\[+([^\[\]]+)\]+\s*(#.*)?$", lines[start]):
            table = header[1].strip()
            yield _Statement(start, stop, table, "")
        elif "=" in lines[start].partition("#")[0]:
            while _value_of("\n".join(lines[start:stop])) is None and stop < len(lines):
                stop += 1  # an array or a string over several lines
            yield _Statement(start, stop, table, lines[start].partition("=")[0].strip())
        start = stop


def _value_of(statement: str) -> list[Any] | None:
    """The value of a statement, in a list; None if it is not a complete statement."""
    try:
        return list(tomllib.loads(statement).values())
    except tomllib.TOMLDecodeError:
        return None


def _line(lines: list[str], path: str, value: Any, noted: bool) -> list[str]:
    """The lines with one key changed, added at the end of its table, or turned into a comment."""
    table, _, key = path.rpartition(".")
    all_of_them = list(_statements(lines))
    old = next((each for each in all_of_them if (each.table, each.key) == (table, key)), None)
    if old is None and value is not None:
        old = _commented_out(lines, all_of_them, table, key)
    if old is not None:
        kept = lines[old.start : old.stop]
        if value is None:
            new = [f"# {line}" for line in kept]
        elif _value_of("\n".join(kept)) == [value]:
            new = kept
        else:
            comment, was = _comment(kept)
            said = f"{comment or '#'} (was {was})" if noted and not kept[0].startswith("#") else comment
            new = [f"{key} = {toml_value(value)}" + (f"  {said}" if said else "")]
        return [*lines[: old.start], *new, *lines[old.stop :]]
    if value is None:
        return lines
    new = [f"{key} = {toml_value(value)}"]
    after = [each.stop for each in all_of_them if each.table == table]
    if after:
        return [*lines[: after[-1]], *new, *lines[after[-1] :]]
    if table:
        return [*lines, "", f"[{table}]", *new]
    first = next((each.start for each in all_of_them), len(lines))
    return [*lines[:first], *new, *lines[first:]]


def _commented_out(lines: list[str], statements: list[_Statement], table: str, key: str) -> _Statement | None:
    """The last line of a table that states a key in a comment; None without one."""
    headers = [each for each in statements if not each.key]
    begins = next((each.stop for each in headers if each.table == table), None)
    if begins is None:
        return None
    ends = next((each.start for each in headers if each.start >= begins), len(lines))
    stated = re.compile(rf"\s*#\s*{re.escape(key)}\s*=")
    at = next((j for j in reversed(range(begins, ends)) if stated.match(lines[j])), None)
    return None if at is None else _Statement(at, at + 1, table, key)


def _comment(lines: list[str]) -> tuple[str, str]:
    """The comment at the end of a statement, and its value as text."""
    text = " ".join(line.strip() for line in lines)
    value = text.partition("=")[2].strip()
    if value.startswith("#"):  # a key in a comment, without a value
        return value, ""
    for at in (match.start() for match in re.finditer("#", value)) if len(lines) == 1 else ():
        if _value_of(f"x = {value[:at]}") is not None:
            return value[at:], value[:at].strip()
    return "", value


def _table(lines: list[str], name: str, value: Mapping[str, Any]) -> list[str]:
    """The lines with the keys of a table, and its subtables, replaced by these; comments stay."""
    new = [f"{key} = {toml_value(each)}" for key, each in value.items()]
    found, begun = list(lines), False
    for each in reversed(list(_statements(lines))):
        if each.table != name and not each.table.startswith(f"{name}."):
            continue
        begun = begun or (each.table, each.key) == (name, "")
        found[each.start : each.stop] = [lines[each.start], *new] if (each.table, each.key) == (name, "") else []
    return found if begun else [*found, "", f"[{name}]", *new]
