"""Pages that scripts write: six published sheets, of which what is left out is found from the rest; schematics."""

import tomllib

import pytest

import problems
from tests.benches.places import ROOT
from tests.benches.scripts import script

sheets = script("sheets")
FILES = sorted((problems.FOLDER / "sheets").glob("*.toml"))


def test_there_are_six_and_each_names_its_source() -> None:
    found = list(sheets.sheets())
    assert len(found) == len(FILES) >= 6
    assert all(sheet["source"].startswith("https://") for sheet in found)
    assert len({sheet["source"] for sheet in found}) == len(found)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_each_number_is_within_a_quarter_of_what_the_others_make_of_it(file) -> None:  # type: ignore[no-untyped-def]
    sheet = tomllib.loads(file.read_text())
    found = list(sheets.left_out(sheet))
    assert [each.key for each in found] == [key for key in sheets.TOLERANCE if key in sheet]
    assert len(found) >= 8
    for each in found:
        assert abs(each.off) < 0.25 or each.note, each.key


def test_the_page_has_what_the_script_finds(capsys: pytest.CaptureFixture[str]) -> None:
    assert sheets.main() == 0
    page = (ROOT / "docs/plants/sheets.md").read_text().splitlines()
    lines = [line for line in capsys.readouterr().out.splitlines() if line]
    assert len(lines) >= 14
    assert [line for line in lines if line not in page] == []


@pytest.mark.parametrize("wrong", ["resonance_Hz", "moving_mass_kg", "quality_electrical", "stiffness_N_m"])
def test_a_wrong_unit_in_a_sheet_is_named(wrong: str) -> None:
    sheet = next(sheets.sheets())
    told = {**sheet, wrong: 9.81 * sheet[wrong]}
    note = sheets.completed(told, sheets.Rating(L_H=0.0)).note
    assert note.startswith("the numbers contradict each other; one of these is wrong: ")
    assert sheets.WORDS[wrong] in note


def test_the_drawings_of_the_manual_have_the_values_of_today() -> None:
    for name, text in script("circuit_drawings").drawings().items():
        assert (ROOT / "docs/howto" / name).read_text(encoding="utf-8") == text, "run scripts/circuit_drawings.py"
