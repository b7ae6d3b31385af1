"""A large study by one process, by two, and through dask: entries per second, efficiency, memory over time.

    python scripts/study_scale.py [--points 50] [--workers 2] [--ways one,processes,dask] [--out DIR]

Every point has 100 entries of 600 stages (10 speeds of 0.2 to 0.4 m/s, 10 grips of 1 to 10 N) of the scene
wood_on_foam, at current limits of 1.2 to 2 A that bind at every one of them. Memory is read from /proc (Linux).

Exit codes: 0 all that was measured is within its bound, 1 not: processes reach less than 80 % of what as many single
ones would, dask takes more than 1.5 times as long as processes, memory of the parent or of a worker grows by 10 MB or
more per 1000 entries after the first 500, an entry is not certified, or rows differ between the ways; 2 bad input.
"""

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import problems
from transopt.base.console import make_folder
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.writing import table, write_text
from transopt.study.axes import Plan, parse_axis
from transopt.study.report import provenance
from transopt.study.rows import OPTIMAL, Row, number
from transopt.study.run import Pool, dask, processes
from transopt.study.session import run_plan

WAYS = ("one", "processes", "dask")
SPEEDS_M_S = tuple(float(v) for v in np.round(np.linspace(0.2, 0.4, 10), 4))
GRIPS_N = tuple(float(F) for F in range(1, 11))
LOOK_S = 1.0
STARTUP_S = 60.0
SETTLED_ENTRIES = 500  # after which caches are full and memory is expected to be flat
TOLD_ENTRIES = 1000  # a shorter run says nothing about growth
LEAST_EFFICIENCY = 0.8  # of processes: entries per second over those of one, per worker
MOST_DASK_RATIO = 1.5  # of the time that processes take
MOST_GROWTH_MB = 10.0  # per 1000 entries


def _status(pid: str, field: str) -> int:
    """A number of /proc/PID/status, 0 where the process is gone."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith(f"{field}:")), 0)


def resident_MB(pid: int) -> float:
    return _status(str(pid), "VmRSS") / 1024


def descendants(pid: int) -> list[int]:
    """All processes that a process has started, and theirs."""
    parents = {int(path.name): _status(path.name, "PPid") for path in Path("/proc").iterdir() if path.name.isdigit()}
    found, front = [], [pid]
    while front:
        front = [child for child, parent in parents.items() if parent in front]
        found += front
    return found


def spent_s(pids: list[int]) -> float:
    """Processor time of processes that are still there."""
    ticks = 0
    for pid in pids:
        with contextlib.suppress(OSError):
            # Behind the name, which may hold blanks: state is field 3, user and system time fields 14 and 15.
            fields = (
                Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
            )
            ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


@dataclass
class Watch:
    """Memory of this process and of the largest of its descendants, once a second while a block runs."""

    rows: list[tuple[float, float, float]]
    done: int = 0

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        over = threading.Event()

        def look() -> None:
            while not over.wait(LOOK_S):
                others = max((resident_MB(pid) for pid in descendants(os.getpid())), default=0.0)
                self.rows.append((self.done, resident_MB(os.getpid()), others))

        thread = threading.Thread(target=look, daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    def settled(self) -> FloatArray:
        """(n, 3) entries done, MB of the parent, MB of the largest worker, after `SETTLED_ENTRIES`."""
        kept = [row for row in self.rows if row[0] >= SETTLED_ENTRIES]
        return np.array(kept, dtype=float).reshape(-1, 3)

    def slope(self, column: int) -> float:
        """MB per 1000 entries, by least squares; NaN for a run too short to tell."""
        rows = self.settled()
        if len(rows) < 3 or np.ptp(rows[:, 0]) == 0:
            return float("nan")
        return float(1000 * np.polyfit(rows[:, 0], rows[:, column], 1)[0])

    def most(self, column: int) -> float:
        return max((row[column] for row in self.rows), default=float("nan"))


@contextlib.contextmanager
def cluster(workers: int) -> Iterator[tuple[str, list["subprocess.Popen[bytes]"]]]:
    """A dask scheduler and workers of one thread each on this machine: address as --executor takes it, workers.

    Raises
    ------
    InputError : they do not come up.
    """
    environment = {
        **os.environ,
        **{f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")},
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
    }
    started: list[subprocess.Popen[bytes]] = []

    def start(module: str, *arguments: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", f"distributed.cli.{module}", *arguments]
        started.append(
            subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        )
        return started[-1]

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scheduler.json"
        try:
            start(
                "dask_scheduler",
                "--host",
                "127.0.0.1",
                "--port",
                "0",
                "--no-dashboard",
                "--scheduler-file",
                str(file),
            )
            deadline = time.monotonic() + STARTUP_S
            while not file.exists():
                if started[0].poll() is not None or time.monotonic() > deadline:
                    raise InputError("the dask scheduler does not start")
                time.sleep(0.05)
            from distributed import Client

            options = (
                "--nthreads",
                "1",
                "--no-nanny",
                "--no-dashboard",
                "--memory-limit",
                "0",
                "--local-directory",
                folder,
            )
            own = [start("dask_worker", "--scheduler-file", str(file), *options) for _ in range(workers)]
            with Client(scheduler_file=str(file), set_as_default=False, timeout=STARTUP_S) as client:
                client.wait_for_workers(workers, timeout=STARTUP_S)
                address = client.scheduler.address.replace("tcp://", "dask://")
            yield address, own
        finally:
            for process in reversed(started):
                process.kill()
                process.wait()


@dataclass(frozen=True)
class Measured:
    """One way of running the study."""

    way: str
    workers: int
    rows: list[Row]
    elapsed_s: float
    processor_s: float
    watch: Watch

    @property
    def per_s(self) -> float:
        return len(self.rows) / self.elapsed_s


def measure(plan: Plan, way: str, workers: int, folder: Path) -> Measured:
    """Run the plan once into an empty folder, start of the workers included, that of a cluster not."""
    watch = Watch([])

    def told(done: int) -> None:
        watch.done = done

    def run(pool: Pool, count: int) -> Measured:
        with contextlib.closing(pool), watch.running():
            start, spent = time.perf_counter(), spent_s([os.getpid()])
            rows = run_plan(plan, folder / way, pool, name=way, watch=told)
            elapsed_s = time.perf_counter() - start
            return Measured(
                way, count, rows, elapsed_s, spent_s([os.getpid(), *descendants(os.getpid())]) - spent, watch
            )

    if way == "dask":
        with cluster(workers) as (address, _):
            return run(dask(address), workers)
    count = 1 if way == "one" else workers
    return run(processes(count), count)


def differences(runs: list[Measured]) -> int:
    """Rows that are not the same, digit for digit, in all runs; times apart."""

    def plain(row: Row) -> tuple[str, ...]:
        return tuple(value for name, value in row.items() if not name.endswith("_ms"))

    return sum(len({plain(row) for row in rows}) > 1 for rows in zip(*(run.rows for run in runs), strict=True))


@dataclass(frozen=True)
class Verdict:
    """One bound and what was measured; `kept` is None where the run cannot tell."""

    kept: bool | None
    text: str

    def __str__(self) -> str:
        return f"{ {True: 'kept', False: 'MISSED', None: 'not judged'}[self.kept] }: {self.text}"


def _growth(run: Measured) -> list[Verdict]:
    found = []
    for column, whose in ((1, "the parent"), (2, "the largest worker")):
        slope, enough = run.watch.slope(column), len(run.rows) >= TOLD_ENTRIES
        # Written so that a NaN, of a run that is long enough, is a miss.
        kept = bool(slope < MOST_GROWTH_MB) if enough else None
        measured = f"{slope:+.2f} MB per 1000 entries" if enough else f"fewer than {TOLD_ENTRIES} entries"
        found.append(
            Verdict(
                kept,
                f"memory of {whose}, {run.way}: {measured} after the first {SETTLED_ENTRIES}, "
                f"allowed below {MOST_GROWTH_MB:g}",
            )
        )
    return found


def verdicts(runs: list[Measured]) -> list[Verdict]:
    """What was measured against its bounds."""
    by_way, found = {run.way: run for run in runs}, []
    one, many, cluster_run = (by_way.get(way) for way in WAYS)
    if one and many:
        efficiency = many.per_s / (many.workers * one.per_s)
        text = (
            f"efficiency of {many.workers} processes: {100 * efficiency:.0f} %, at least {100 * LEAST_EFFICIENCY:.0f}"
        )
        found.append(Verdict(efficiency >= LEAST_EFFICIENCY, text))
    if many and cluster_run:
        ratio = cluster_run.elapsed_s / many.elapsed_s
        found.append(
            Verdict(ratio <= MOST_DASK_RATIO, f"dask over processes: {ratio:.2f} times, at most {MOST_DASK_RATIO:g}")
        )
    for run in runs:
        found += _growth(run)
        certified = sum(row["status"] == OPTIMAL for row in run.rows)
        found.append(Verdict(certified == len(run.rows), f"certified, {run.way}: {certified} of {len(run.rows)}"))
    if len(runs) > 1:
        differing = differences(runs)
        text = f"rows that differ between the ways, times apart: {differing} of {len(runs[0].rows)}"
        found.append(Verdict(differing == 0, text))
    return found


def report(runs: list[Measured], command: str) -> str:
    """Tables of what was measured."""
    by_way = {run.way: run for run in runs}
    one, two = by_way.get("one"), by_way.get("processes")
    cells = []
    for run in runs:
        efficiency = "-" if one is None or run is one else f"{100 * run.per_s / (run.workers * one.per_s):.0f}"
        against = "-" if two is None or run is two else f"{run.elapsed_s / two.elapsed_s:.2f}"
        bound = sum(row["binding"] not in ("", "none") for row in run.rows)
        certified = sum(row["status"] == OPTIMAL for row in run.rows)
        cells.append(
            [
                run.way,
                run.workers,
                f"{run.elapsed_s:.1f}",
                f"{run.per_s:.1f}",
                f"{1e3 * run.processor_s / len(run.rows):.0f}",
                efficiency,
                against,
                f"{certified} / {bound} of {len(run.rows)}",
                f"{max(number(row, 'relative_gap') for row in run.rows):.0e}",
                *(f"{run.watch.most(j):.0f}, {run.watch.slope(j):+.2f}" for j in (1, 2)),
            ]
        )
    head = [
        "way",
        "workers",
        "s",
        "entries/s",
        "CPU ms per entry",
        "efficiency %",
        "time / processes",
        "certified / limit binds",
        "worst gap",
    ]
    memory = ["parent MB, MB per 1000 entries", "largest worker MB, MB per 1000 entries"]
    lines = [*provenance(command, sum(run.elapsed_s for run in runs)), *table([*head, *memory], cells)]
    lines += [f"- {run.way}: {run.per_s:.1f} entries per second" for run in runs]
    return "\n".join([*lines, *(f"- {verdict}" for verdict in verdicts(runs)), ""])


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--points", type=int, default=50, help="current limits; each has 100 entries")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--ways", default=",".join(WAYS), help="of one, processes, dask")
    parser.add_argument("--out", type=Path, default=Path("out") / "study_scale", help="folder for rows and scale.md")
    arguments = parser.parse_args(words)
    try:
        ways = arguments.ways.split(",")
        if unknown := [way for way in ways if way not in WAYS]:
            raise InputError(f"--ways {unknown[0]}: must be among {', '.join(WAYS)}")
        if arguments.points < 2 or arguments.workers < 1:
            raise InputError("--points must be at least 2, --workers at least 1")
        make_folder(arguments.out)
        scene = problems.load("wood_on_foam")
        axis = parse_axis(scene, "--points", f"limits.current_A=1.2:2:{arguments.points}")
        plan = Plan(scene, (axis,), SPEEDS_M_S, GRIPS_N)
        with tempfile.TemporaryDirectory(dir=arguments.out) as folder:
            runs = [measure(plan, way, arguments.workers, Path(folder)) for way in ways]
        text = report(
            runs,
            f"python scripts/study_scale.py --points {arguments.points} --workers {arguments.workers} "
            f"--ways {arguments.ways}",
        )
        write_text(text, arguments.out / "scale.md")
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(text)
    return 1 if any(verdict.kept is False for verdict in verdicts(runs)) else 0


if __name__ == "__main__":
    sys.exit(main())
