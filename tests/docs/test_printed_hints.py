"""Every hint that the manual's output prints is carried out: it leads to a file that is read, or to a proven entry.

Pages quote what the commands print. A line of output that says what to do next, what a reader may have meant or what
would do is collected from all pages; each stands here with what carries it out.
"""

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest

import problems
from tests.benches.brought_files import FILES
from tests.benches.commands import Outcome, assert_refused, captured
from tests.benches.tap_formats import SPEED_M_S
from tests.docs.pages import PAGES, fenced, named

HINT = re.compile(r"then: |next: |and state --|would do$|did you mean |the right one: --")
PRINTED = {
    (named(page), line)
    for page in PAGES
    for block in fenced(page)
    if block.language == "text" and not named(page).startswith("docs/results/")
    for line in block.code.splitlines()
    if HINT.search(line)
}
# Hints that the next block of their page carries out as it stands.
DONE_BY_THE_PAGE = {
    ("docs/start/everything.md", "mine.toml written; next: transopt solve mine.toml"),
    ("docs/start/everything.md", "lra.toml written; edit its targets, then: transopt solve lra.toml"),
}
WALLED = (problems.FOLDER / "scenes/walled.toml").read_text(encoding="utf-8")


def run(line: str) -> Outcome:
    return captured(*shlex.split(line))


def command_of(page: str, word: str) -> str:
    """The command of a page that has a word in it."""
    (found,) = [
        line for each in fenced(page) if each.language == "sh" for line in each.code.splitlines() if word in line
    ]
    return found


def plant_of_a_sheet(page: str, word: str) -> Callable[[str], None]:
    """State what a sheet's plant only guesses; or solve the scene that was written."""

    def carry_out(line: str) -> None:
        command = command_of(page, word)
        first = run(command)
        assert line in first.out.splitlines()
        if "then: " in line:
            assert run(line.partition("then: ")[2]).code == 0
            return
        guess, option = line.partition(": a guess: ")[0], line.rpartition("state ")[2]
        value = re.sub(r" \w+$", "", guess).rpartition(" ")[2] if guess.endswith("kg") else guess.rpartition(" ")[2]
        again = run(f"{command.replace(f'new {word}', 'new again')} {option} {value}")
        assert again.code == 0, again.err
        assert "a guess" not in again.out

    return carry_out


def walled(*changes: tuple[str, str]) -> Outcome:
    """Solve the walled scene at one speed and grip, with some of its text changed."""
    scene = WALLED
    for old, new in (("[0.1, 0.2, 0.4]", "[0.2]"), ("[1.0, 5.0]", "[5.0]"), *changes):
        assert old in scene, old
        scene = scene.replace(old, new, 1)
    Path("mine.toml").write_text(scene, encoding="utf-8")
    return run("transopt solve mine.toml --out out")


def what_would_do(line: str) -> None:
    """A refused entry is solved anew with each of the numbers that its line states."""
    stiff, weak = "stiffness_N_m = 200.0", "[limits]"
    refused = walled((stiff, "stiffness_N_m = 800.0"), (weak, f"{weak}\ncurrent_A = 0.5"))
    assert line in " ".join((refused.out + refused.err).split())
    current, stiffness = re.findall(r"= (\S+) ", line)
    assert refused.code == 1
    more = walled((stiff, "stiffness_N_m = 800.0"), (weak, f"{weak}\ncurrent_A = {current}"))
    softer = walled((stiff, f"stiffness_N_m = {stiffness}"), (weak, f"{weak}\ncurrent_A = 0.5"))
    for solved in (more, softer):
        assert solved.code == 0, solved.out + solved.err
        assert "proven optimal" in solved.out


def what_was_meant(line: str) -> None:
    """A number in a wrong unit is refused, and read in the unit that was probably meant."""
    mass = "stylus_mass_kg = 0.026"
    assert_refused(walled((mass, "stylus_mass_kg = 26.0")), line.removeprefix("error: ").removesuffix("; ..."))
    meant = re.findall(r"which is (\S+) kg", line)[0]
    assert walled((mass, f"stylus_mass_kg = {meant}")).code == 0


def what_reads_it(line: str) -> None:
    """A scope's file is read by the options that were tried on it."""
    Path("scope.csv").write_bytes(next(file.data for file in FILES if file.name == "picoscope.csv"))
    refused = run(f"transopt taps scope.csv --speed {SPEED_M_S}")
    assert_refused(refused, line.removesuffix(" ..."))
    option = line.removeprefix("the right one: ").partition(" (")[0]
    read = run(f"transopt taps scope.csv --speed {SPEED_M_S} {option}")
    assert read.code == 0, read.err


DATASHEET, SHEETS = "docs/plants/datasheet.md", "docs/plants/sheets.md"
CARRIED_OUT = {
    (
        DATASHEET,
        "moving mass 0.0155 kg: a guess: it would swing 0.057 mm at the rating, a tenth of it 0.5 mm; "
        "measure it, and state --moving-mass-kg",
    ): plant_of_a_sheet(DATASHEET, "coin"),
    (DATASHEET, "coin.toml written; edit its targets, then: transopt solve coin.toml"): plant_of_a_sheet(
        DATASHEET, "coin"
    ),
    (SHEETS, "quality Q 1.97: a guess: measure it, and state --quality"): plant_of_a_sheet(SHEETS, "sb2550"),
    (SHEETS, "sb2550.toml written; edit its targets, then: transopt solve sb2550.toml"): plant_of_a_sheet(
        SHEETS, "sb2550"
    ),
    (
        "docs/howto/limits.md",
        "limits.current_A = 3.71 A, or feedback.stiffness_N_m = 51.8 N/m would do",
    ): what_would_do,
    (
        "docs/reference/bounds.md",
        "error: mine.toml: model.stylus_mass_kg = 26 kg: devices and hands have 0.0002 to 1 kg (did you mean 26 g, "
        "which is 0.026 kg?); ...",
    ): what_was_meant,
    (
        "docs/howto/recordings.md",
        "the right one: --units 'Channel A=mV @ 100 mV/g' (10 kHz, a peak of 13.6 g, "
        "a change of speed by 1.7 times the incoming 0.2 m/s) or ...",
    ): what_reads_it,
}


def test_every_printed_hint_is_here() -> None:
    assert {*CARRIED_OUT, *DONE_BY_THE_PAGE} == PRINTED


def test_a_page_that_prints_what_comes_next_does_it() -> None:
    for page, line in DONE_BY_THE_PAGE:
        command = re.split("next: |then: ", line)[1]
        assert any(command in each.code for each in fenced(page) if each.language == "sh")


@pytest.mark.parametrize("hint", CARRIED_OUT, ids=lambda hint: f"{Path(hint[0]).stem}: {hint[1][:40]}")
def test_it_leads_where_it_says(hint: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    CARRIED_OUT[hint](hint[1])
