"""A study through a real dask scheduler with two workers on loopback, one of them killed mid-run."""

import importlib.util
from pathlib import Path

import pytest

from tests.benches.study import cluster, plain, serial
from transopt.base.errors import InputError
from transopt.scene.scene import Scene
from transopt.study import executors
from transopt.study.axes import parse_axis
from transopt.study.executors import executor_pool
from transopt.study.plan import Plan
from transopt.study.session import run_plan

pytestmark = [
    pytest.mark.skipif(
        importlib.util.find_spec("distributed") is None,
        reason="dask.distributed is not installed: pip install '.[cluster]'",
    ),
    # Sockets of a worker that was killed are closed by the garbage collector, inside distributed.
    pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"),
]


def test_a_worker_killed_mid_run_loses_and_doubles_nothing(
    short: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("transopt.study.plan.TOGETHER", 4)  # enough tasks for a middle
    axis = parse_axis(short, "--vary", "limits.current_A=1:4:10")
    plan = Plan(short, (axis,), (0.3, 0.4), (1.0, 5.0))
    left: list[int] = []
    with cluster(2) as (address, workers):

        def kill(done: int) -> None:
            if not left:
                workers[0].kill()
                left.append(plan.entries - done)

        pool = executors.dask(address)
        rows = run_plan(plan, tmp_path / "dask", pool, watch=kill)
        assert pool.workers() == 1
        pool.close()
    assert left[0] > 0
    assert [int(row["index"]) for row in rows] == list(range(plan.entries))
    run_plan(plan, tmp_path / "serial", serial())
    assert plain(tmp_path / "dask" / "rows.csv") == plain(tmp_path / "serial" / "rows.csv")


def test_nobody_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors, "ANSWERS_S", 0.5)
    with pytest.raises(InputError, match="no dask scheduler answers there") as refusal:
        executor_pool("dask://127.0.0.1:9", 1)
    assert "\n" not in str(refusal.value)
