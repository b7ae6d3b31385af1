"""Measures the speed of studies, and whether their memory grows.

    python scripts/study_speed.py [--entries 5000] [--short 600] [--page PAGE.md]

Every entry has the 800 stages of the scene `wood_on_foam`, at 10 speeds of 0.2 to 0.4 m/s and 10 grips of 1 to 10 N,
with limits of the current of 1.2 to 2 A, so that the limit binds in every one. Two worker processes solve all of
them, this process and two workers of dask (where it is installed) fewer. Memory is resident memory (Linux), of this
process and of the largest worker; its growth is the slope of a straight line from the 500th entry on, when the caches
of stage models and references are full. The PIQP wheel is called in the same run on the QP of one entry: machines
compare by the ratio. Exit code 1 if the executors give different rows, apart from times, or if an entry is not
certified.
"""

import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from common.benchmark_cases import direct_piqp, entry
from common.command import at_least, run
from common.measuring import on_one_thread
from common.page import PageFile, write_part

import problems
from transopt.base.writing import table
from transopt.scene.keys import with_values
from transopt.study.axes import parse_axis
from transopt.study.executors import executor_pool
from transopt.study.plan import Plan
from transopt.study.rows import Row, is_admitted
from transopt.study.session import run_plan

SPEEDS, GRIPS, CURRENTS_A = 10, 10, (1.2, 2.0)
SAME = 1e-5  # relative, and of what is small absolute: a command is as exact as its proof needs
WARM = 500  # entries after which the caches are full
PIQP_RUNS = 9
PAGE = os.sysconf("SC_PAGE_SIZE")
CLOCK_HZ = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Run:
    """One way of solving a study.

    Attributes
    ----------
    rows : in order.
    elapsed_s, cpu_s : of all, of this process and its workers.
    done : (n,) entries at which memory was looked at.
    parent_MB, worker_MB : (n,) resident memory, of the largest worker (0 without one).
    """

    rows: list[Row]
    elapsed_s: float
    cpu_s: float
    done: list[int]
    parent_MB: list[float]
    worker_MB: list[float]

    def growth(self, memory_MB: list[float]) -> float:
        """Per 1000 entries; NaN where too few were solved to tell."""
        at, found = np.array(self.done), np.array(memory_MB)
        late = at >= WARM
        if np.count_nonzero(late) < 2 or np.ptp(at[late]) < WARM:
            return float("nan")
        return float(1e3 * np.polyfit(at[late], found[late], 1)[0])


def plan(entries: int) -> Plan:
    """A study of a number of entries."""
    scene = problems.load("wood_on_foam")
    low, high = CURRENTS_A
    axis = parse_axis(scene, "--vary", f"limits.current_A={low}:{high}:{entries // (SPEEDS * GRIPS)}")
    speeds, grips = np.linspace(0.2, 0.4, SPEEDS), np.linspace(1.0, 10.0, GRIPS)
    return Plan(scene, (axis,), tuple(speeds.tolist()), tuple(grips.tolist()))


def resident_MB(process: int | str) -> float:
    return int(Path(f"/proc/{process}/statm").read_text(encoding="utf-8").split()[1]) * PAGE / 1e6


def workers() -> dict[str, tuple[float, float]]:
    """Resident memory [MB] and processor time [s] of each child of this process."""
    found = {}
    for thread in Path("/proc/self/task").iterdir():
        for child in (thread / "children").read_text(encoding="utf-8").split():
            with suppress(OSError):  # it has ended meanwhile
                # The fields behind the name, which may hold anything: the 12th and 13th are user and system time.
                fields = Path(f"/proc/{child}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
                found[child] = resident_MB(child), (int(fields[11]) + int(fields[12])) / CLOCK_HZ
    return found


def solved(entries: int, way: str) -> Run:
    """Solve a study in a way that `--executor` names, start-up of the workers included."""
    done: list[int] = []
    parent: list[float] = []
    worker: list[float] = []
    theirs: dict[str, float] = {}

    def watch(count: int) -> None:
        at_work = workers()
        done.append(count)
        parent.append(resident_MB("self"))
        worker.append(max((memory for memory, _ in at_work.values()), default=0.0))
        theirs.update((child, used - before.get(child, (0.0, 0.0))[1]) for child, (_, used) in at_work.items())

    with tempfile.TemporaryDirectory() as folder:
        started, own, before = time.perf_counter(), time.process_time(), workers()
        with closing(executor_pool(way, 2)) as pool:
            rows = run_plan(plan(entries), Path(folder), pool, name=way, watch=watch)
            elapsed = time.perf_counter() - started
        cpu_s = time.process_time() - own + sum(theirs.values())
        return Run(rows, elapsed, cpu_s, done, parent, worker)


@contextmanager
def cluster() -> Iterator[str]:
    """Address of two dask workers, processes of one thread each; empty where dask is not installed."""
    try:
        import distributed
    except ImportError:
        yield ""
        return
    settings = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with distributed.LocalCluster(**settings) as workers:
        yield workers.scheduler_address.replace("tcp://", "dask://")


def alike(rows: list[Row], others: list[Row]) -> bool:
    """Whether rows are the same but for times: numbers to 1e-5, as sums depend on where an array lies in memory."""

    def same(cell: str, other: str) -> bool:
        try:
            return cell == other or bool(np.isclose(float(cell), float(other), rtol=SAME, atol=SAME))
        except ValueError:
            return False

    return len(rows) == len(others) and all(
        row.keys() == other.keys() and all(same(row[name], other[name]) for name in row if not name.endswith("_ms"))
        for row, other in zip(rows, others, strict=True)
    )


def piqp_ms() -> float:
    """Median processor time of the PIQP wheel, called directly on ready data, on an entry amid the study [ms]."""
    middle = with_values(problems.load("wood_on_foam"), {"limits.current_A": sum(CURRENTS_A) / 2})
    solve = direct_piqp(entry(middle, speed_m_s=0.3, grip_N=5.0)).run
    used_s = []
    for _ in range(PIQP_RUNS):
        start = time.process_time()
        solve()
        used_s.append(time.process_time() - start)
    return 1e3 * float(np.median(used_s))


def row(name: str, found: Run) -> tuple[str, ...]:
    """Row of the page's table."""
    count = len(found.rows)
    grown = [found.growth(memory) for memory in (found.parent_MB, found.worker_MB)]
    memory = "" if np.isnan(grown).any() else " / ".join(f"{slope:+.2g}" for slope in grown)
    most = f", of {max(found.parent_MB):.0f} / {max(found.worker_MB):.0f} MB" if memory else ""
    rate = f"{count / found.elapsed_s:.1f} ({found.elapsed_s:.0f} s)"
    return name, f"{count}", rate, f"{1e3 * found.cpu_s / count:.2g}", memory + most


def main(
    entries: Annotated[int, at_least(2 * SPEEDS * GRIPS, "of the long study")] = 5000,
    short: Annotated[int, at_least(2 * SPEEDS * GRIPS, "of the others")] = 600,
    page: PageFile = None,
) -> int:
    rows = [row("processes, 2", solved(entries, "processes"))]
    found = {"processes, 2": solved(short, "processes"), "one process": solved(short, "serial")}
    with cluster() as address:
        if address:
            found["dask, 2 workers that run already"] = solved(short, address)
    rows += [row(name, one) for name, one in found.items()]
    same = all(alike(one.rows, found["one process"].rows) for one in found.values())
    certified = all(is_admitted(line) for one in found.values() for line in one.rows)
    head = (
        "way",
        "entries",
        "entries per second",
        "CPU ms per entry",
        "growth of this process / largest worker, MB per 1000 entries",
    )
    piqp, alone = piqp_ms(), found["one process"]
    said = (
        f"Start-up of the processes included. The rows of all ways are {'' if same else 'NOT '}the same to {SAME:g}, "
        f"times apart; {'every entry is' if certified else 'NOT every entry is'} certified. "
        f"The PIQP wheel, called directly on ready data, takes {piqp:.0f} ms of a processor for the QP of one entry, "
        f"{piqp * len(alone.rows) / (1e3 * alone.cpu_s):.1f} times as long as an entry in one process takes, posed, "
        "solved, certified, replayed and stored."
    )
    lines = [*table(head, rows), "", said]
    print("\n".join(lines))
    write_part(page, lines)
    return 0 if same and certified else 1


if __name__ == "__main__":
    on_one_thread()
    run(main)
