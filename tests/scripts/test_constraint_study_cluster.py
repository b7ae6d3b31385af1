"""A study through a real dask scheduler with two workers on loopback, one of them killed mid-run."""

import importlib.util
from pathlib import Path
from typing import Any

import pytest

from tests.benches.study import plain, short_scene
from transopt.base.errors import InputError
from transopt.scene.scene import Scene

pytestmark = [
    pytest.mark.skipif(
        importlib.util.find_spec("distributed") is None,
        reason="dask.distributed is not installed: pip install '.[cluster]'",
    ),
    # Sockets of a worker that was killed are closed by the garbage collector, inside distributed.
    pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"),
]


def test_a_worker_killed_mid_run_loses_and_doubles_nothing(
    study: Any, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study.axes, "TOGETHER", 4)  # enough tasks for a middle
    short = short_scene(scene)
    axis = study.axes.parse_axis(short, "--vary", "limits.current_A=1:4:10")
    plan = study.axes.Plan(short, (axis,), (0.3, 0.4), (1.0, 5.0))
    left: list[int] = []
    with study.scale.cluster(2) as (address, workers):

        def kill(done: int) -> None:
            if not left:
                workers[0].kill()
                left.append(plan.entries - done)

        pool = study.run.dask(address)
        rows = study.session.run_plan(plan, tmp_path / "dask", pool, watch=kill)
        assert pool.workers() == 1
        pool.close()
    assert left[0] > 0
    assert [int(row["index"]) for row in rows] == list(range(plan.entries))
    study.session.run_plan(plan, tmp_path / "serial", study.run.executor_pool("serial", 1))
    assert plain(tmp_path / "dask" / "rows.csv") == plain(tmp_path / "serial" / "rows.csv")


def test_nobody_there(study: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study.run.dask, "__defaults__", (0.5,))
    with pytest.raises(InputError, match="no dask scheduler answers there") as refusal:
        study.run.executor_pool("dask://127.0.0.1:9", 1)
    assert "\n" not in str(refusal.value)
