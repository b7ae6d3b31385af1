"""Tables keep every number whole at any width of the terminal."""

import io
import re

import numpy as np
import pytest
from rich.console import Console

from transopt.base.tables import Table

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
