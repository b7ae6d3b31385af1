"""Files as people bring them: read at the first try, or asked about once with options that then read them.

    python -m pytest -m long -n 0 tests/campaigns/test_brought_files.py
        --campaign="[--kinds tektronix,phyphox] [--part FILE]"

Every file of tests/benches/brought_files.py is given to `transopt taps --speed 0.2`. One that says enough has to be
read as it is: the same peak within 5 % and contact within 0.3 ms. One that lacks a fact has to be refused in a single
line, exit code 2, whose options are carried out one after the other: each has to read the file, and one of them has
to be right. Nothing may be read wrong by a factor in silence. It fails if a file is not as asked.
"""

import os
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import pytest

from tests.benches.brought_files import FILES
from tests.benches.commands import Outcome, Run, captured
from tests.benches.tap_formats import ONSET_S, SPEED_M_S, Brought
from tests.campaigns.harness import PartFile, long_form, write_part
from transopt.base.writing import table
from transopt.files.unclear import UnclearError, joined
from transopt.recordings.settings import Recordings
from transopt.recordings.tap import PreparedTap, prepare, read_recordings

PEAK, ONSET = 0.05, 3e-4  # relative; s
OPTION = re.compile(r"(--[a-zA-Z-]+(?: (?:'[^']*'|[^\s(]+))?(?: --[a-zA-Z-]+ (?:'[^']*'|[^\s(]+))*) \(")


@dataclass(frozen=True)
class Found:
    """What came of a file: `read`, `asked` or what is wrong; how many options were named, and which was right."""

    file: Brought
    how: str
    named: int = 0
    right: int = 0


def prepared(path: Path, **stated: object) -> tuple[list[PreparedTap], Recordings]:
    settings = Recordings(**joined({"files": [str(path)], "speed_m_s": SPEED_M_S}, stated))
    return [prepare(recording, settings) for recording in read_recordings(settings)], settings


def is_right(taps: Sequence[PreparedTap], file: Brought) -> bool:
    """Whether a file gave the tap that it holds."""
    return (
        len(taps) == 1
        and not taps[0].implausible
        and abs(taps[0].peak_m_s2 / (9.80665 * file.peak_g) - 1) < PEAK
        and abs(taps[0].onset_s - taps[0].recording.acceleration.start_s - ONSET_S) < ONSET
    )


def options_in(line: str) -> list[str]:
    """The options that a refusal names, each before what they make of the file."""
    return [found[1] for found in OPTION.finditer(line.partition("the right one: ")[2])]


def peak_in(outcome: Outcome) -> float:
    """The peak [g] in the table of `taps`, of one tap."""
    lines = outcome.out.splitlines()
    names = next(line for line in lines if line.startswith("┃") and "peak" in line).split("┃")
    row = next(line for line in lines if line.startswith("│")).split("│")
    return float(next(cell for name, cell in zip(names, row, strict=True) if name.strip().startswith("peak")))


@mock.patch.dict(os.environ, COLUMNS="200")  # a row of the table stands on one line
def looked_at(file: Brought, run: Run, folder: Path) -> Found:
    """Give a file to `taps`, and carry out what it proposes."""
    path = folder / file.name
    path.write_bytes(file.data)
    outcome = run("taps", path, "--speed", SPEED_M_S)
    if outcome.code == 0:
        if not is_right(prepared(path)[0], file):
            return Found(file, "read, and wrong")
        return Found(file, "read" if not file.lacks else "read, though a fact lacks")
    lines = outcome.err.splitlines()
    if outcome.code != 2 or len(lines) != 1:
        return Found(file, f"refused with code {outcome.code} in {len(lines)} lines")
    named = options_in(lines[0])
    peaks = list[float]()
    for options in named:
        again = run("taps", path, "--speed", SPEED_M_S, *shlex.split(options))
        if again.code != 0:
            return Found(file, f"{options} does not read it: {again.err}", len(named))
        peaks.append(peak_in(again))
    right = next((k for k, peak in enumerate(peaks, 1) if abs(peak / file.peak_g - 1) < PEAK), 0)
    if not file.lacks:
        return Found(file, f"asked, though it says enough: {lines[0]}", len(named), right)
    if not is_right(prepared(path, **file.right)[0], file):
        return Found(file, "the right answer does not read it", len(named), right)
    return Found(file, "asked" if right else "asked, and nothing named is right", len(named), right)


def main(kinds: str = "", part: PartFile = None) -> int:
    with TemporaryDirectory() as folder:
        run = partial(captured, "transopt")
        chosen = [f for f in FILES if not kinds or any(kind in f.name for kind in kinds.split(","))]
        found = [looked_at(file, run, Path(folder)) for file in chosen]
    rows = [[each.file.name, each.how, str(each.named or "-"), str(each.right or "-")] for each in found]
    lines = table(["file", "first try", "options named", "the right one"], rows)
    count = {how: sum(each.how == how for each in found) for how in ("read", "asked")}
    lines.append(f"{len(found)} files: {count['read']} read, {count['asked']} asked once and then read")
    print("\n".join(lines))
    write_part(part, lines)
    return int(sum(count.values()) != len(found))


test_long_form = long_form(main)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_a_file_is_read_right_and_not_before_a_fact_that_lacks_is_stated(file: Brought, tmp_path: Path) -> None:
    path = tmp_path / file.name
    path.write_bytes(file.data)
    if file.lacks:
        with pytest.raises(UnclearError):
            prepared(path)
    assert is_right(prepared(path, **file.right)[0], file)


@pytest.mark.parametrize("name", ["tektronix_tbs", "arduino_bare.csv", "fifo", "two_responses", "audacity_24"])
def test_the_command_asks_for_each_fact_that_may_lack(name: str, tmp_path: Path) -> None:
    file = next(each for each in FILES if each.name.startswith(name))
    found = looked_at(file, partial(captured, "transopt"), tmp_path)
    assert found.how == "asked"
    assert found.right
