"""Parts of pages that scripts write, and the stamps below them."""

import re
import sys
from pathlib import Path

import pytest

from tests.benches.places import ROOT
from tests.benches.scripts import script
from transopt.base.errors import InputError

page_parts = script("common.page")
END, begin, write_part, write_answer = (
    page_parts.END,
    page_parts.begin,
    page_parts.write_part,
    page_parts.write_answer,
)

STAMP = re.compile(
    r"^\*`python ([^`]+)`, \d{4}-\d\d-\d\d, .+, \d+ cores, Python 3\.[\d.]+, "
    r"commit \w+(, with changes)?\.\*$",
    re.MULTILINE,
)
PART = re.compile(
    r"^<!-- (?:written by|(?:output|tables) of: python) ([^\n]+) -->$(.*?)^<!-- end -->$",
    re.DOTALL | re.MULTILINE,
)


def named_by(command: str) -> str:
    """The file that a command runs, or its module."""
    words = command.split()
    return next((word for word in words if word.endswith(".py")), words[1 if words[0] == "-m" else 0])


RESULTS = ROOT / "docs/results"
PARTS = [
    (path, named_by(found[1]), found[2])
    for path in sorted(RESULTS.glob("*.md"))
    for found in PART.finditer(path.read_text())
]
TIMED = (
    "scripts/benchmark.py",
    "scripts/error_against_runtime.py",
)  # worth a run on a machine that does nothing else


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(sys, "argv", ["scripts/after_window.py", "wood", "--page", "p.md", "--out", "/tmp/x"])
    path = tmp_path / "p.md"
    path.write_text(f"before\n\n{begin('after_window.py')}\nold\n{END}\n\nafter\n")
    return path


def test_the_part_is_replaced_and_stamped_and_the_rest_stays(page: Path) -> None:
    write_part(page, ["| a |", "|---|", "| \\1 |"])
    text = page.read_text()
    assert text.startswith("before\n\n<!-- written")
    assert text.endswith("<!-- end -->\n\nafter\n")
    assert "old" not in text
    assert "| \\1 |\n\n*`python scripts/after_window.py wood --out DIR`, " in text
    [found] = STAMP.findall(text)
    assert named_by(found[0]) == "scripts/after_window.py"
    write_part(page, ["| a |", "|---|", "| \\1 |"])
    assert page.read_text() == text


def test_without_a_page_nothing_is_written(page: Path) -> None:
    before = page.read_text()
    write_part(None, ["| a |"])
    assert page.read_text() == before


def test_a_page_of_another_script_is_refused(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["scripts/soak.py"])
    with pytest.raises(InputError, match=r"no part of this script; mark one by two lines: <!-- written by"):
        write_part(page, [])


def test_the_answer_replaces_the_one_in_the_row_that_links_to_the_page_and_no_other(page: Path) -> None:
    index = page.parent / "index.md"
    index.write_text(
        "| q | a | detail |\n|---|---|---|\n| One? | 1 ms | [o](o.md) |\n| Two? | old 2.0 | [p](p.md) |\n"
    )
    write_answer(page, "3.0 times, \\1")
    expected = (
        "| q | a | detail |\n|---|---|---|\n| One? | 1 ms | [o](o.md) |\n| Two? | 3.0 times, \\1 | [p](p.md) |\n"
    )
    assert index.read_text() == expected
    write_answer(None, "lost")
    assert index.read_text() == expected
    with pytest.raises(InputError, match=r"no row for x.md: add \| question \| answer \| \[x\]\(x.md\) \|"):
        write_answer(page.parent / "x.md", "lost")


@pytest.mark.parametrize("name", ["speed.md", "error_against_runtime.md"])
def test_the_results_have_a_row_for_each_answer_that_a_script_writes(tmp_path: Path, name: str) -> None:
    index = tmp_path / "index.md"
    index.write_text((RESULTS / "index.md").read_text(encoding="utf-8"), encoding="utf-8")
    write_answer(tmp_path / name, "measured anew")
    assert index.read_text(encoding="utf-8").count(f"| measured anew | [{Path(name).stem}]({name}) |") == 1


CAMPAIGN = """
import pathlib, shlex, sys
option, part = shlex.split(sys.argv[-1].removeprefix("--campaign="))
assert option == "--part"
pathlib.Path(part).write_text("| reached |")
"""


def test_tables_that_a_campaign_writes_are_put_on_the_page_as_they_are(tmp_path: Path) -> None:
    campaign, page = tmp_path / "campaign.py", tmp_path / "p.md"
    campaign.write_text(CAMPAIGN)
    page.write_text(f"before\n\n<!-- tables of: python {campaign} -->\nold\n{END}\n\nafter\n")
    assert script("results").main(page) == 0
    text = page.read_text()
    assert f"-->\n\n| reached |\n\n*`python {campaign}`, " in text
    assert "old" not in text
    assert text.endswith("<!-- end -->\n\nafter\n")


def test_what_a_campaign_prints_is_put_on_the_page_without_the_words_of_pytest(tmp_path: Path) -> None:
    campaign, page = tmp_path / "campaign.py", tmp_path / "p.md"
    words = "." + 30 * " " + "[100%]\\n1 passed, 16 deselected in 51.67s (0:00:51)"
    campaign.write_text(f"print('\\n2 taps, 1 passed by\\n{words}')")
    page.write_text(f"before\n\n<!-- output of: python {campaign} -->\nold\n{END}\n\nafter\n")
    assert script("results").main(page) == 0
    assert f"```text\n2 taps, 1 passed by\n```\n\n*`python {campaign}`, " in page.read_text()


def test_a_campaign_that_writes_no_tables_leaves_the_page_alone(tmp_path: Path) -> None:
    campaign, page = tmp_path / "campaign.py", tmp_path / "p.md"
    campaign.write_text("raise SystemExit(1)")
    before = f"<!-- tables of: python {campaign} -->\nold\n{END}\n"
    page.write_text(before)
    with pytest.raises(InputError, match="has written no tables; its exit code is 1"):
        script("results").main(page)
    assert page.read_text() == before


@pytest.mark.parametrize(("path", "script", "part"), PARTS, ids=[f"{p.stem}-{Path(s).stem}" for p, s, _ in PARTS])
def test_every_part_says_when_where_and_by_what(path: Path, script: str, part: str) -> None:
    assert (ROOT / script).exists() or (ROOT / script.replace(".", "/")).exists()
    found = STAMP.findall(part)
    # A campaign may have been a script at the commit that its stamp names.
    by = [Path(named_by(command)).stem.removeprefix("test_") for command, _ in found]
    assert by == [Path(script).stem.removeprefix("test_")] or (script in TIMED and not found)
