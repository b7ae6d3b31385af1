"""Files that no honest user makes: whatever is read ends in a result that is right, or in one line.

    python -m pytest -m long -n 0 tests/campaigns/test_hostile_files.py
        --campaign="[--flips 500] [--altered 500] [--recordings 300] [--scenes 100] [--seed N]"

Every case is a command on an input: a library with bits turned over, one that was altered and hashed again, a fuzzed
recording, a scene with absurd values, a pipe or a folder in place of a file. A command that refuses says so in one
line with exit code 2; none prints a traceback or control characters, takes 1 GB or 10 s of processor time, or uses
what it should have refused. Each runs in a process of its own under bounds; every fiftieth in an interpreter of its
own in the plain C locale. The seed is new every time and is printed. It fails if a case went wrong. POSIX only.
"""

import os
import random
import re
import secrets
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from itertools import accumulate
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated

import pytest
import typer

from tests.campaigns.harness import long_form
from tests.campaigns.hostile_cases import Case, bit_flips, recordings, rehashed
from tests.campaigns.hostile_runs import Seen, elapsed, fault, load_commands, run, run_afresh
from tests.campaigns.hostile_scenes import scenes
from transopt.library.library import Library

SAMPLED = 50  # one case of so many also runs in an interpreter of its own


@dataclass
class Tally:
    """What came of all cases of one kind."""

    cases: int = 0
    accepted: int = 0
    afresh: int = 0
    most_cpu_s: float = 0.0
    most_bytes: int = 0
    took: str = ""
    wrong: list[str] = field(default_factory=list)

    def add(self, case: Case, seen: Seen) -> None:
        self.cases += 1
        self.accepted += seen.code == 0
        self.most_cpu_s, self.most_bytes = max(self.most_cpu_s, seen.cpu_s), max(self.most_bytes, seen.peak_bytes)
        if said := fault(seen, case.codes):
            self.wrong.append(f"{case.name}: {' '.join(case.command[:2])}: {said}: {seen.said[:200]!a}")


def campaign(cases: Iterator[Case], folder: Path, first: int) -> Tally:
    """Run all cases whose files a generator puts into a folder; `first` : number of cases before them."""
    tally = Tally()
    for j, case in enumerate(cases, first):
        tally.add(case, run(case.command, folder))
        if j % SAMPLED == 0:
            tally.afresh += 1
            tally.add(case, run_afresh(case.command, folder))
    return tally


@cache
def solved() -> Library:
    """A small library to damage."""
    from transopt.design.build import build_library
    from transopt.scene.builtin import load_scene
    from transopt.scene.keys import with_values
    from transopt.scene.recordings import recordings_of

    scene = with_values(load_scene("wood_on_foam"), {"grid.speeds_m_s": [0.2, 0.4], "grid.grips_N": [1.0, 5.0]})
    library = build_library(scene, recordings_of(scene)).library
    assert library is not None
    return library


KINDS = ("bit flips", "altered and hashed again", "recordings", "scenes and special files")


def of_kind(kind: str, count: int, first: int, seed: int) -> Tally:
    """So many cases of a kind, with what their commands import loaded before."""
    load_commands()
    chance, start = random.Random(f"{seed} {kind}"), time.monotonic()
    with tempfile.TemporaryDirectory() as base:
        folder = Path(base) / "cases"
        folder.mkdir()
        if kind in KINDS[:2]:
            solved().save(Path(base) / "sound.npz")
            cases = (bit_flips, rehashed)[KINDS.index(kind)](Path(base) / "sound.npz", folder, count, chance)
        else:
            cases = (recordings, scenes)[KINDS.index(kind) - 2](folder, count, chance)
        tally = campaign(cases, folder, first)
    tally.took = elapsed(start)
    return tally


def main(
    flips: int = 500,
    altered: int = 500,
    recordings: int = 300,
    scenes: int = 100,
    seed: Annotated[int | None, typer.Option(help="of the cases; a new one every time without it")] = None,
) -> int:
    seed = secrets.randbelow(2**31) if seed is None else seed
    print(f"seed {seed}")
    wrong = 0
    # The memory of a case is that of its command only where a process forks that has loaded nothing else.
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        counts = (flips, altered, recordings, scenes)
        found = pool.map(of_kind, KINDS, counts, accumulate((0, *counts[:-1])), [seed] * len(KINDS))
        for kind, tally in zip(KINDS, found, strict=True):
            print(
                f"{kind}: {tally.cases} cases, {tally.accepted} accepted, {len(tally.wrong)} wrong, at most "
                f"{tally.most_cpu_s:.1f} s and {tally.most_bytes / 1e6:.0f} MB; {tally.took}",
                flush=True,
            )
            for said in tally.wrong:
                print(f"  {said}")
            wrong += len(tally.wrong)
    return 1 if wrong else 0


test_long_form = long_form(main)


pytestmark = pytest.mark.skipif(os.name != "posix", reason="the campaign forks, and its pipes are POSIX's")


def test_in_short(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    code = main(flips=2, altered=2, recordings=5, scenes=4)
    said = capsys.readouterr().out
    assert code == 0, said
    assert list(tmp_path.iterdir()) == [], "something was left behind"
    for kind in KINDS:
        assert re.search(rf"^{kind}: \d+ cases, \d+ accepted, 0 wrong, at most ", said, re.MULTILINE), said
