"""What the tests of constraint studies share."""

import csv
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.study.axes import parse_axis
from transopt.study.executors import Pool, executor_pool
from transopt.study.plan import Plan

STARTUP_S = 60.0


def short_scene(scene: Scene) -> Scene:
    """8 ms: the pulse of a tap without its ringing, and nothing of what would come after it."""
    return with_values(scene, {"time.stages": 80, "weights.after_s": 0.0})


def two_keys(scene: Scene) -> Plan:
    """24 entries: a limit, a pole, two speeds, two grips."""
    texts = ("limits.current_A=1.5:4:3", "amplifier.pole_Hz=500,1050")
    return Plan(scene, tuple(parse_axis(scene, "--vary", text) for text in texts), (0.3, 0.4), (1.0, 5.0))


def serial() -> Pool:
    """A pool that solves in this process."""
    return executor_pool("serial", 1)


def read(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV file."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def plain(path: Path) -> list[dict[str, str]]:
    """Rows of a study without its times."""
    return [{name: cell for name, cell in row.items() if not name.endswith("_ms")} for row in read(path)]


def assert_same_rows(one: Path, other: Path) -> None:
    """Equal text, and numbers to what is left of an answer by the problems that were solved beside it."""
    for row, its in zip(plain(one), plain(other), strict=True):
        assert row.keys() == its.keys()
        for name, cell in row.items():
            number, its_number = _number(cell), _number(its[name])
            if math.isnan(number) or math.isnan(its_number):
                assert cell == its[name], name
            else:
                assert number == pytest.approx(its_number, rel=1e-6, abs=1e-8), name


def _number(cell: str) -> float:
    """NaN of what is none."""
    try:
        return float(cell)
    except ValueError:
        return math.nan


@contextmanager
def cluster(workers: int) -> Iterator[tuple[str, list["subprocess.Popen[bytes]"]]]:
    """A dask scheduler and workers of one thread each on this machine: address as --executor takes it, workers."""
    from distributed import Client

    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    started: list[subprocess.Popen[bytes]] = []

    def start(module: str, *arguments: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", f"distributed.cli.{module}", *arguments]
        started.append(
            subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        )
        return started[-1]

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scheduler.json"
        local = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
        few = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--memory-limit", "0", "--local-directory", folder)
        try:
            start("dask_scheduler", *local)
            deadline = time.monotonic() + STARTUP_S
            while not file.exists() and started[0].poll() is None and time.monotonic() < deadline:
                time.sleep(0.01)  # polls for the scheduler to have begun; nothing is measured
            own = [start("dask_worker", "--scheduler-file", str(file), *few) for _ in range(workers)]
            with Client(scheduler_file=str(file), set_as_default=False, timeout=STARTUP_S) as client:
                client.wait_for_workers(workers, timeout=STARTUP_S)
                address = client.scheduler.address.replace("tcp://", "dask://")
            yield address, own
        finally:
            for process in reversed(started):
                process.kill()
                process.wait()
