"""How values and tables show themselves: briefly, and without loss of what matters."""

import io
import re
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from transopt.base.shown import LINE, LONGEST, MOST_ROWS, brief, cut, html_figure, html_table, span, summary
from transopt.base.tables import Table


class Colour(Enum):
    RED = "a value that would be long"


@dataclass(frozen=True)
class Inner:
    values: Any


@dataclass(frozen=True)
class Holder:
    """Whatever it is given."""

    first: Any = None
    second: Any = None
    hidden: Any = field(default=1, repr=False)

    __repr__ = brief


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (np.linspace(-1.5, 2.0, 600), "<600, -1.5 to 2>"),
        (np.zeros((4, 3, 600)), "<4x3x600, 0>"),
        (np.array([np.nan, 1.0, 3.0]), "<3, 1 to 3>"),
        (np.array([np.nan]), "<1, none finite>"),
        (np.zeros((0, 3)), "<0x3 f>"),
        (np.array(["optimal"]), "<1 text>"),
        (np.array([True, False]), "<2 b>"),
        (1 / 3, "0.333333"),
        (np.float64(2.0), "2"),
        (float("nan"), "nan"),
        (7, "7"),
        (True, "True"),
        ("a" * 100, repr("a" * 57 + "...")),
        (Colour.RED, "Colour.RED"),
        ([0.1, 0.2], "[0.1, 0.2]"),
        ((), "()"),
        (list(range(1000)), "[1000 items]"),
        ({"a": np.zeros(9), "b": 1}, "{a, b}"),
        ({str(j): j for j in range(50)}, "{50 keys}"),
        (Inner(np.zeros(9)), "Inner(...)"),
        (len, "len(...)"),
    ],
)
def test_one_value_in_a_few_words(value: Any, said: str) -> None:
    assert summary(value) == said


def test_fields_that_are_none_or_not_for_show_are_left_out() -> None:
    assert repr(Holder(1.0)) == "Holder(first=1)"


def test_it_never_gets_long_and_says_what_is_missing() -> None:
    long = {f"field_{j}": "x" * 50 for j in range(30)}
    many = type("Many", (), {"model_fields": long, **long, "__repr__": brief})()
    text = repr(many)
    assert len(text) <= LONGEST + 40
    assert text.endswith("more)")
    assert max(map(len, text.splitlines())) <= LINE


def test_spans_and_cut_text() -> None:
    assert span([0.1, 0.2, 0.4], "m/s", "speed") == "3 speeds 0.1 to 0.4 m/s"
    assert span(np.array([0.0]), "N", "grip") == "1 grip 0 N"
    assert cut("abcdef", 5) == "ab..."
    assert cut("abcde", 5) == "abcde"


def test_a_table_is_escaped_and_cut() -> None:
    html = html_table("a < b", ["x", "y"], [[str(j), "<i>"] for j in range(MOST_ROWS + 7)])
    assert "a &lt; b" in html
    assert "<i>" not in html
    assert html.count("<tr>") == MOST_ROWS + 2
    assert "and 7 more" in html


def test_a_figure_stands_in_the_text() -> None:
    figure = Figure(figsize=(2, 1))
    figure.subplots().plot([0, 1])
    assert html_figure(figure).startswith('<img alt="figure" src="data:image/png;base64,iVBOR')


NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]\d+)?")
WIDTHS = (60, 80, 100, 120, 160)


def printed(table: Table, width: int) -> str:
    console = Console(file=io.StringIO(), width=width)
    console.print(table)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def made(seed: int) -> tuple[Table, list[str]]:
    """A table of numbers and sentences with numbers in them, and all its cells."""
    rng = np.random.default_rng(seed)
    table = Table(title="of some length, 1.25 A", keys=int(rng.integers(1, 3)))
    columns = int(rng.integers(3, 18))
    is_number = rng.random(columns) < 0.75
    for column, right in enumerate(is_number):
        table.add_column(f"head {column} m/s", justify="right" if right else "left")
    cells = []
    for _ in range(4):
        values = 10.0 ** rng.uniform(-9, 5, columns) * rng.choice([-1, 1], columns)
        row = [
            f"{value:.4g}" if right else f"current {value:+.3g} A at {abs(value):.2f} ms"
            for value, right in zip(values, is_number, strict=True)
        ]
        table.add_row(*row)
        cells += row
    return table, cells


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("width", WIDTHS)
def test_no_number_is_cut_or_split(seed: int, width: int) -> None:
    table, cells = made(seed)
    out = printed(table, width)
    there = set(NUMBER.findall(out))
    assert {number for cell in cells for number in NUMBER.findall(cell)} <= there
    assert "…" not in out
    assert max(map(len, out.splitlines())) <= width


@pytest.mark.parametrize("width", WIDTHS)
def test_a_column_that_is_not_to_wrap_is_whole(width: int) -> None:
    table, key = Table(), "recordings.simulated.object_mass_kg"
    table.add_column("key", no_wrap=True)
    for head in ("default", "about"):
        table.add_column(head)
    table.add_row(
        key, "to be stated", "of what is struck, by the stylus that nothing drives, as it stands in the scene"
    )
    out = printed(table, width)
    assert key in out
    assert max(map(len, out.splitlines())) <= width


def test_what_has_room_is_one_table_and_what_has_none_repeats_what_a_row_is() -> None:
    table = Table(keys=2)
    for head in ("speed m/s", "grip N", *(f"figure {k}" for k in range(9))):
        table.add_column(head, justify="right")
    table.add_row("0.125", "7", *(f"{k}.00{k}" for k in range(9)))
    assert printed(table, 160).count("0.125") == 1
    narrow = printed(table, 60)
    assert narrow.count("0.125") == narrow.count("┡") == 3


def test_a_column_that_says_nothing_takes_no_block() -> None:
    table = Table()
    for head in ("tap", *(f"figure of some length {k}" for k in range(9)), "note"):
        table.add_column(head, justify="left" if head == "note" else "right")
    table.add_row("1", *["12.345678"] * 9, "")
    assert "note" in printed(table, 400)
    assert "note" not in printed(table, 60)


def test_a_word_without_room_is_folded() -> None:
    table = Table()
    for head in ("file", "peak g"):
        table.add_column(head, justify="left" if head == "file" else "right")
    table.add_row("x" * 200, "1.234")
    out = printed(table, 60)
    assert out.count("x") == 200
    assert "1.234" in out
    assert max(map(len, out.splitlines())) <= 60


class TestNamesInTheMiddle:
    NAMES = ("a_long_name_of_a_tap_1.csv", "a_long_name_of_a_tap_2.csv")

    def of(self, names: tuple[str, ...], width: int) -> str:
        table = Table.of(None, ("file", "peak g", "offset g", "speed m/s"), words=("file",), middle=("file",))
        for name in names:
            table.add_row(name, "12.125", "0.0013", "0.20625")
        return printed(table, width)

    def test_are_shortened_where_the_table_then_is_one(self) -> None:
        assert self.NAMES[0] in self.of(self.NAMES, 80)
        narrow = self.of(self.NAMES, 42)
        assert narrow.count("12.125") == narrow.count("0.20625") == 2
        assert narrow.count("…") == 2
        assert "1.csv" in narrow
        assert "2.csv" in narrow
        assert narrow.count("┡") == 1

    def test_stay_whole_where_they_would_be_alike_or_hardly_a_name(self) -> None:
        alike = ("2026_taps_at_1_newton_of_wood.csv", "2026_taps_at_3_newton_of_wood.csv")
        assert "…" not in self.of(alike, 42)
        assert "…" not in self.of(self.NAMES, 34)
