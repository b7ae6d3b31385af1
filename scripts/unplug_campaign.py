"""Unplugs, resets, kills and hangs at random instants of a session with the compiled device.

    python scripts/unplug_campaign.py [--cases 1000] [--processes 12] [--seed 0]

In virtual time (`unplug_cases`), and with real processes, killed by SIGKILL, on pseudo-terminals and sockets
(`unplug_processes`). Of each case is asked: the command is zero within the lease after the last heartbeat that
arrived, by the device's own ticks; the host says so within 1 s (where it was still connecting, and nothing but
silence tells it, at the end of the time it connects for); nothing hangs; nothing arms again by itself, also not after
connecting again; each line of the recording is what the device did in that tick. Exit code 1 if anything is off.
"""

import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import numpy as np
from campaign.unplug_cases import KINDS, PHASES, Case, Outcome
from campaign.unplug_processes import KINDS as PROCESS_KINDS
from campaign.unplug_processes import Ended, play
from common.command import Seed, at_least, run


def virtual(cases: int, seed: int, folder: Path) -> list[Outcome]:
    """So many cases, each of its own seed."""
    return [Case(1_000_000 * seed + j, folder / f"virtual{j}").play() for j in range(cases)]


def real(cases: int, seed: int, folder: Path) -> list[Ended]:
    """So many with real processes: every kind in turn, every third round on a socket.

    Raises
    ------
    InputError : no compiler, no pseudo-terminal, no host.
    """
    kinds = len(PROCESS_KINDS)
    return [
        play(1_000_000 * seed + j, folder / f"real{j}", listen=j // kinds % 3 == 2, kind=PROCESS_KINDS[j % kinds])
        for j in range(cases)
    ]


def worst(values: Iterable[float]) -> str:
    """The largest of those that are numbers."""
    known = [value for value in values if not np.isnan(value)]
    return f"{np.max(known):8.3f}" if known else "       -"


def summarise(outcomes: list[Outcome] | list[Ended], phases: Iterable[str]) -> None:
    """Counts by kind and phase, and the worst times."""
    kinds: dict[str, list[Outcome | Ended]] = defaultdict(list)
    for outcome in outcomes:
        kinds[outcome.kind].append(outcome)
    phases = tuple(phases)
    print(f"{'':14s}{''.join(f'{phase:>14s}' for phase in phases)}   report s  connecting s  held/lease  lines kept")
    for kind, those in kinds.items():
        counts = Counter(outcome.phase for outcome in those)
        told = worst(o.report_s for o in those if o.phase != "connect")
        connecting = worst(o.report_s for o in those if o.phase == "connect")
        held = max(o.held_ms / o.lease_ms for o in those)
        print(
            f"{kind:14s}{''.join(f'{counts[phase]:14d}' for phase in phases)} {told:>10s} {connecting:>13s} "
            f"{held:11.4f} {sum(o.rows for o in those):11d}"
        )


def main(
    cases: Annotated[int, at_least(0, "in virtual time")] = 1000,
    processes: Annotated[int, at_least(0, "with real processes")] = 12,
    seed: Seed = 0,
) -> int:
    with tempfile.TemporaryDirectory(prefix="transopt-") as folder:
        began_s = time.monotonic()
        played = virtual(cases, seed, Path(folder))
        print(f"{cases} cases in virtual time, {time.monotonic() - began_s:.0f} s")
        summarise(played, PHASES)
        missing = sorted(set(KINDS) - {case.kind for case in played})
        if cases and missing:
            print(f"kinds that did not come: {', '.join(missing)}")
        sys.stdout.flush()
        began_s = time.monotonic()
        ended = real(processes, seed, Path(folder))
        print(f"{processes} cases with real processes, {time.monotonic() - began_s:.0f} s")
        summarise(ended, dict.fromkeys(case.phase for case in ended))
    named = {"case": played, "processes": ended}
    breaches = [
        f"{name} {j}, {outcome.phase}, {outcome.kind}: {words}"
        for name, outcomes in named.items()
        for j, outcome in enumerate(outcomes)
        for words in outcome.breaches
    ]
    for words in breaches[:20]:
        print(f"  BREACH {words}"[:300])
    print(f"{len(breaches)} breaches")
    return 1 if breaches else 0


if __name__ == "__main__":
    run(main)
