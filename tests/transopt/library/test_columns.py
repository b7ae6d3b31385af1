"""One declaration of each column: every rendering of a table of entries prints the same cells."""

import io
import re
from dataclasses import replace

import pytest
from rich.console import Console
from rich.table import Table

import transopt as to
from transopt.base.writing import percent
from transopt.library.columns import COLUMNS, FULL, NAN, EntryTable, TableRow
from transopt.report.markdown import build_markdown
from transopt.report.tables import certificate_table, entry_table, verify_table
from transopt.scene.keys import with_values

FIGURES = {"tap": 0.09996, "floor": 0.00999, "peak": 1.0, "binding": "none", "verdict": "fine"}
ROW = TableRow(("0.2", "3"), FIGURES)


@pytest.fixture(scope="module")
def build() -> to.Build:
    """One entry of a scene that does not look at what comes after the waveform."""
    scene = to.load_scene("wood_on_foam")
    values = {"weights.after_s": 0.0, "grid.speeds_m_s": [0.2], "grid.grips_N": [3.0]}
    return to.build(with_values(scene, values))


@pytest.mark.parametrize("width", [60, 80, 100])
def test_no_cell_is_cut_in_a_narrow_terminal(build: to.Build, width: int) -> None:
    assert build.library is not None
    checks = to.verify(build.library)
    for table in (
        entry_table(build.library, "file")[0],
        certificate_table(build.library, "file"),
        verify_table(checks, "file"),
        entry_table(build, "scene")[0],
    ):
        console = Console(file=io.StringIO(), width=width)
        console.print(table)
        assert isinstance(console.file, io.StringIO)
        assert "…" not in console.file.getvalue()


def printed(table: Table) -> list[str]:
    """Cells of the one row of a table in a terminal."""
    console = Console(file=io.StringIO(), width=400)
    console.print(table)
    assert isinstance(console.file, io.StringIO)
    row = next(line for line in console.file.getvalue().splitlines() if line.startswith("│ "))
    return [cell.strip() for cell in row.strip("│").split("│")]


def test_every_rendering_of_an_entry_prints_the_same_cells(build: to.Build) -> None:
    shown = build.table(FULL)
    (cells,) = shown.cells
    by_name = dict(zip(shown.names, cells[2:], strict=True))
    assert "| " + " | ".join(cells) + " |" in build_markdown(build, full=False)
    names = ("tap", "felt", "felt_dB", "speed", "bump", "heat", "peak", "binding")
    for html in (build._repr_html_(), build.library._repr_html_()):
        for name in ("tap", "felt", "felt_dB", "heat", "binding"):
            assert f"<td>{by_name[name]}</td>" in html
    of_file = printed(entry_table(build.library, "file")[0])
    assert of_file == cells
    assert printed(entry_table(build, "scene")[0]) == of_file
    (from_library,) = build.library.table(names).cells
    assert from_library[2:] == [by_name[name] for name in names]


def test_a_refused_entry_has_words_and_no_numbers() -> None:
    refused = replace(ROW, refusal="infeasible: no command meets all limits")
    shown = EntryTable(("speed m/s", "grip N"), tuple(COLUMNS), (refused,), "A", (4.0, 1.25))
    for name, cell in zip(COLUMNS, shown.figures(refused), strict=True):
        if COLUMNS[name].is_number:
            assert cell == "-", name
    assert shown.figures(refused)[list(COLUMNS).index("binding")] == refused.refusal
    assert shown.figures(refused)[list(COLUMNS).index("verdict")] == "refused"


def test_a_column_that_no_row_knows_is_neither_shown_nor_explained() -> None:
    known = replace(ROW, values={**ROW.values, "speed": 0.5})
    shown = EntryTable(("target",), ("tap", "speed", "bump", "binding"), (ROW, known), "A").known
    assert tuple(shown.names) == ("tap", "speed", "binding")
    assert "lets go" not in shown.legend("current", named=False)
    nobody = replace(known, refusal="infeasible")
    assert "speed" not in EntryTable(("target",), ("tap", "speed"), (ROW, nobody), "A").known.names


def test_an_unknown_number_is_a_dash_and_a_known_one_is_not() -> None:
    shown = EntryTable((), tuple(COLUMNS), (), "A")
    for name, cell in zip(COLUMNS, shown.figures(TableRow(("0.2", "3"))), strict=True):
        if COLUMNS[name].is_number:
            assert re.fullmatch(r"-( / -)?", cell), name
    assert EntryTable((), ("tap", "floor", "peak"), (), "A").figures(ROW) == ["10.0", "1.00", "1.000"]


@pytest.mark.parametrize(
    ("value", "said"), [(0.09994, "9.99"), (0.09996, "10.0"), (0.1, "10.0"), (float("nan"), "-")]
)
def test_a_percent_has_as_many_digits_as_what_is_printed_asks_for(value: float, said: str) -> None:
    assert percent(value) == said


def test_heads_state_unit_and_limits_and_every_meaning_stands_in_the_legend() -> None:
    shown = EntryTable(("target",), tuple(COLUMNS), (), "V", (3.0, 2.0))
    assert "seed % at 3 / 2 V" in shown.heads
    assert "peak V" in shown.heads
    said = shown.legend("voltage", named=True)
    assert "{" not in said
    assert "its voltage clipped" in said
    assert "beside the target, over the waveform" in said


@pytest.mark.parametrize(("heat_A2_s", "shown"), [(2.13e-4, "0.21"), (9.6e-3, "10"), (0.0263, "26"), (NAN, "-")])
def test_the_heat_of_a_small_coil_is_not_rounded_away(heat_A2_s: float, shown: str) -> None:
    assert COLUMNS["heat"].show(heat_A2_s) == shown
