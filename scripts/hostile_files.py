"""Files that no honest user makes: whatever is read ends in a result that is right, or in one line.

    python scripts/hostile_files.py [--flips 500] [--altered 500] [--recordings 300] [--scenes 100] [--seed N]

Every case is a command on an input: a library with bits turned over, one that was altered and hashed again, a fuzzed
recording, a scene with absurd values, a pipe or a folder in place of a file. A command that refuses says so in one
line with exit code 2; none prints a traceback or control characters, takes 1 GB or 10 s of processor time, or uses
what it should have refused. Each runs in a process of its own under bounds; every fiftieth in an interpreter of its
own in the plain C locale. The seed is new every time and is printed. Exit code 1 if a case went wrong. POSIX only.
"""

import argparse
import random
import secrets
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from campaign.hostile_cases import Case, bit_flips, recordings, rehashed
from campaign.hostile_runs import Seen, elapsed, fault, load_commands, run, run_afresh
from campaign.hostile_scenes import scenes

SAMPLED = 50  # one case of so many also runs in an interpreter of its own


@dataclass
class Tally:
    """What came of all cases of one kind."""

    cases: int = 0
    accepted: int = 0
    afresh: int = 0
    most_cpu_s: float = 0.0
    most_bytes: int = 0
    wrong: list[str] = field(default_factory=list)

    def add(self, case: Case, seen: Seen) -> None:
        self.cases += 1
        self.accepted += seen.code == 0
        self.most_cpu_s, self.most_bytes = max(self.most_cpu_s, seen.cpu_s), max(self.most_bytes, seen.peak_bytes)
        if said := fault(seen, case.codes):
            self.wrong.append(f"{case.name}: {' '.join(case.command[:2])}: {said}: {seen.said[:200]!a}")


def campaign(cases: Iterator[Case], folder: Path, sampled: int = SAMPLED) -> Tally:
    """Run all cases whose files a generator puts into a folder."""
    tally = Tally()
    for j, case in enumerate(cases):
        tally.add(case, run(case.command, folder))
        if j % sampled == 0:
            tally.afresh += 1
            tally.add(case, run_afresh(case.command, folder))
    return tally


def solved(folder: Path) -> Path:
    """A small library to damage."""
    from transopt.design.build import build_library
    from transopt.scene.builtin import load_scene
    from transopt.scene.keys import with_values
    from transopt.scene.recordings import recordings_of

    scene = with_values(load_scene("wood_on_foam"), {"grid.speeds_m_s": [0.2, 0.4], "grid.grips_N": [1.0, 5.0]})
    library = build_library(scene, recordings_of(scene)).library
    assert library is not None
    library.save(folder / "sound.npz")
    return folder / "sound.npz"


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, count in (("flips", 500), ("altered", 500), ("recordings", 300), ("scenes", 100)):
        parser.add_argument(f"--{name}", type=int, default=count)
    parser.add_argument("--seed", type=int, default=None)
    wanted = parser.parse_args(arguments)
    seed = secrets.randbelow(2**31) if wanted.seed is None else wanted.seed
    print(f"seed {seed}")
    load_commands()
    wrong = 0
    with tempfile.TemporaryDirectory() as base:
        sound = solved(Path(base))
        chance = random.Random(seed)
        kinds = {
            "bit flips": lambda at: bit_flips(sound, at, wanted.flips, chance),
            "altered and hashed again": lambda at: rehashed(sound, at, wanted.altered, chance),
            "recordings": lambda at: recordings(at, wanted.recordings, chance),
            "scenes and special files": lambda at: scenes(at, wanted.scenes, chance),
        }
        for kind, cases in kinds.items():
            folder = Path(base) / kind.replace(" ", "_")
            folder.mkdir()
            start = time.monotonic()
            tally = campaign(cases(folder), folder)
            print(
                f"{kind}: {tally.cases} cases, {tally.accepted} accepted, {len(tally.wrong)} wrong, at most "
                f"{tally.most_cpu_s:.1f} s and {tally.most_bytes / 1e6:.0f} MB; {elapsed(start)}",
                flush=True,
            )
            for said in tally.wrong:
                print(f"  {said}")
            wrong += len(tally.wrong)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
