"""Tables for a terminal of any width: no number in them is ever cut or split."""

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from typing import Any

from rich import table
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult

WORDS = 24  # least width of a cell of words, unless its text is shorter
SHARE = 3  # a word takes at most the terminal's width over this; longer ones, such as file names, are folded
LEAST = 0.25  # share of that width to which words are folded if there is still not enough room
SHORTEST = 8  # characters to which a name is shortened at most: an ending as .csv, and as much before it
BETWEEN, EDGE = 3, 1  # width of the frame of each column, and of the frame around all


class Table(table.Table):
    """A table that is printed in blocks, one below the other, if its columns do not fit side by side.

    Right-aligned columns contain numbers and are never broken, nor are columns set not to wrap. In other columns
    lines break between words; only a word that is too long is folded.

    Parameters
    ----------
    keys : number of leading columns that identify a row; they are repeated in every block.
    middle : heads of columns of names that are shortened in the middle if the table then fits in one block and the
        names stay distinct.
    """

    def __init__(self, *heads: Any, keys: int = 1, middle: Collection[str] = (), **how: Any) -> None:
        super().__init__(*heads, **how)
        self._keys, self._middle = keys, middle

    @classmethod
    def of(
        cls,
        title: str | None,
        heads: Iterable[str],
        *,
        words: Collection[str] = (),
        whole: Collection[str] = (),
        **how: Any,
    ) -> "Table":
        """A table with these columns, of numbers but for those of words.

        Parameters
        ----------
        words : heads of the columns of words. whole : those of them whose cells are copied, and so never broken.
        """
        table = cls(title=title, **how)
        for head in heads:
            table.add_column(head, justify="left" if head in words else "right", no_wrap=head in whole)
        return table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        blocks = list(self._shortened(options.max_width)._blocks(options.max_width))
        for number, block in enumerate(blocks):
            if number > 0:
                block.title = None
            if number < len(blocks) - 1:
                block.caption = None
            yield from super(Table, block).__rich_console__(console, options)

    def _shortened(self, width: int) -> "Table":
        """This table, its names shortened in the middle if that alone makes it fit."""
        excess = _framed([_widths(column, width)[0] for column in self.columns]) - width
        for at, column in enumerate(self.columns):
            names = [str(cell) for cell in column.cells]
            room = _widths(column, width)[0] - excess
            if excess <= 0 or column.header not in self._middle or room < SHORTEST:
                continue
            short: list[RenderableType] = [_without_middle(name, room) for name in names]
            if len(set(map(str, short))) == len(set(names)):
                table = copy(self)
                table.columns = [*self.columns[:at], replace(column, _cells=short), *self.columns[at + 1 :]]
                return table
        return self

    def _blocks(self, width: int) -> Iterator["Table"]:
        """This table, or the blocks into which it is split so that they fit."""
        least, most = zip(*(_widths(column, width) for column in self.columns), strict=True)
        keys = [*range(min(self._keys, len(self.columns) - 1))]
        others = [*range(len(keys), len(self.columns))]
        if _framed([*least]) > width:  # empty columns do not get a block of their own
            others = [index for index in others if any(map(str, self.columns[index].cells))]
        block, has = list(keys), False
        for index in others:
            if has and _framed([least[each] for each in (*block, index)]) > width:
                yield self._part(block, least, most, width)
                block = list(keys)
            block.append(index)
            has = True
        yield self._part(block, least, most, width)

    def _part(self, indices: list[int], least: tuple[int, ...], most: tuple[int, ...], width: int) -> "Table":
        """A table of some columns, each as wide as its cells; without enough room, reduced in proportion."""
        part = copy(self)
        room = width - _framed([least[index] for index in indices])
        lacking = {index: most[index] - least[index] for index in indices}
        if sum(lacking.values()) > room:  # numbers then get their least width, and words the rest
            lacking = {index: by for index, by in lacking.items() if self.columns[index].justify != "right"}
        # If even the key columns and one other do not fit, words are folded further.
        share = min(1.0, room / max(sum(lacking.values()), 1))
        if room < 0:
            lacking = {index: least[index] for index in lacking}
            share = max(room / max(sum(lacking.values()), 1), LEAST - 1.0)
        part.columns = [
            replace(
                self.columns[index],
                _index=place,
                width=least[index] + math.floor(share * lacking.get(index, 0)),
                no_wrap=False,
                overflow="fold",
            )
            for place, index in enumerate(indices)
        ]
        return part


def _without_middle(name: str, width: int) -> str:
    """A name of at most `width` characters, an ellipsis in place of its middle if it is longer."""
    ending = 2 * (width - 1) // 3  # numbers that tell files apart mostly stand at the end
    return name if len(name) <= width else f"{name[: width - 1 - ending]}…{name[len(name) - ending :]}"


def _framed(widths: list[int]) -> int:
    return sum(widths) + BETWEEN * len(widths) + EDGE


def _widths(column: table.Column, width: int) -> tuple[int, int]:
    """The least and the largest useful width of a column, in a terminal of `width` columns."""
    head, cells = str(column.header), [str(cell) for cell in column.cells]
    heads = _longest(head.split())
    most = _longest([line for text in (head, *cells) for line in text.split("\n")])
    if column.justify == "right" or column.no_wrap:
        return max(heads, _longest(cells)), most
    whole = [word for cell in cells for word in cell.split() if any(map(str.isdigit, word))]
    return max(heads, min(_longest(whole), width // SHARE), min(most, WORDS)), most


def _longest(texts: Sequence[str]) -> int:
    return max(map(cell_len, texts), default=1)
