"""Constraint studies: what is varied, rows that outlive a kill, executors that agree."""

import itertools
import math
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.benches.places import SCRIPTS
from tests.benches.study import plain, read, serial, short_scene
from transopt.base.errors import InputError
from transopt.scene.scene import Scene


@pytest.fixture(scope="module")
def small(study: Any, scene: Scene) -> Any:
    """24 entries: a limit, a pole, two speeds, two grips, over a short horizon."""
    return two_keys(study, short_scene(scene))


def two_keys(study: Any, scene: Scene) -> Any:
    axes = [
        study.axes.parse_axis(scene, "--vary", text)
        for text in ("limits.current_A=1.5:4:3", "amplifier.pole_Hz=500,1050")
    ]
    return study.axes.Plan(scene, tuple(axes), (0.3, 0.4), (1.0, 5.0))


@pytest.fixture(scope="module")
def finished(study: Any, small: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all rows of the small study."""
    out = tmp_path_factory.mktemp("study") / "small"
    study.session.run_plan(small, out, serial(study))
    return out


class TestAxes:
    @pytest.mark.parametrize(
        ("text", "values"),
        [
            ("limits.current_A=1.25:6:20", np.linspace(1.25, 6, 20)),
            ("amplifier.pole_Hz=100:10000:3:log", (100.0, 1000.0, 10000.0)),
            ("time.stages=100:200:3", (100, 150, 200)),
            ("limits.supply_V=9, none", (9.0, None)),
            ("weights.error_filter=none,pacinian", ("none", "pacinian")),
        ],
    )
    def test_values(self, study: Any, scene: Scene, text: str, values: Sequence[Any]) -> None:
        axis = study.axes.parse_axis(scene, "--vary", text)
        if all(isinstance(value, float) for value in values):
            assert axis.values == pytest.approx(values, rel=1e-11)
        else:
            assert axis.values == tuple(values)
        assert [type(value) for value in axis.values] == [float if isinstance(v, float) else type(v) for v in values]
        assert len(set(axis.labels)) == len(axis.values)

    def test_motors_are_swapped_whole(self, study: Any, scene: Scene, tmp_path: Path) -> None:
        own = tmp_path / "own.toml"
        own.write_text(
            (SCRIPTS.parent / "problems" / "motors" / "maxon_re40_148877.toml").read_text(encoding="utf-8")
        )
        axis = study.axes.parse_axis(scene, "--vary", f"motor=maxon_re25,{own}")
        assert axis.labels == ("maxon_re25_118743", "own")
        plan = study.axes.Plan(scene, (axis,), (0.4,), (5.0,))
        second = study.axes.with_values(scene, plan.changes(1)).motor
        assert second is not None
        assert (second.kt_Nm_A, second.rotor_kg_m2) == (60.3e-3, 13.7e-6)

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("limits.current_A", "give KEY=V1,V2"),
            ("limits.current_A=1:2", "START:STOP:COUNT"),
            ("limits.current_A=2:1:5", "START must be below STOP"),
            ("limits.current_A=1:2:1.5", "COUNT = 1.5: must be a whole number"),
            ("limits.current_A=0:2:3:log", "START must be below STOP and above 0"),
            ("limits.current_A=0:2:3", "limits.current_A = 0.0: must be greater than 0"),
            ("limits.current_A=1,1.0", "a value stands there twice"),
            ("limits.current_A=1,many", "limits.current_A = many: must be a finite number or none"),
            ("motor.kt_Nm_A=0.02", "one row of a datasheet"),
            ("motor=maxon", "several files begin so; give the path of a .toml file or one of faulhaber"),
            ("motor=escap", "no such file"),
            ("grid.grips_N=1,2", "give them with --grip"),
            ("limit.current_A=1,2", "perhaps limits.current_A"),
        ],
    )
    def test_refusals(self, study: Any, scene: Scene, text: str, words: str) -> None:
        with pytest.raises(InputError, match=words.replace("(", r"\(")) as refusal:
            study.axes.parse_axis(scene, "--vary", text)
        assert "\n" not in str(refusal.value)

    def test_speed_outside_the_recordings(self, study: Any, scene: Scene) -> None:
        with pytest.raises(InputError, match=r"--speed 0.5: must be between 0.1 and 0.4 m/s"):
            study.axes.Plan(scene, (), (0.5,), (1.0,))


class TestPoints:
    def test_all_combinations_once(self, study: Any, small: Any) -> None:
        found = {tuple(small.changes(p).values()) for p in range(small.points)}
        assert found == set(itertools.product((1.5, 2.75, 4.0), (500.0, 1050.0)))
        assert small.entries == 24

    def test_tasks_share_a_device_and_cover_every_row_once(self, study: Any, small: Any) -> None:
        scene = small.scene
        parse = study.axes.parse_axis
        texts = ("limits.current_A=1:6:25", "amplifier.pole_Hz=500,1050", "weights.rho=1e-3,1e-4")
        plan = study.axes.Plan(scene, tuple(parse(scene, "--vary", text) for text in texts), (0.3, 0.4), (1.0, 5.0))
        tasks = list(plan.tasks(lambda index: False, study.axes.Recorder(scene, plan.axes)))
        rows = [item.index for task in tasks for item in task.items]
        assert sorted(rows) == list(range(plan.entries))
        assert all(len({point["amplifier.pole_Hz"] for point in task.points}) == 1 for task in tasks)
        assert max(len(task.items) for task in tasks) == study.axes.TOGETHER
        assert len(tasks) == 2 * 2 * math.ceil(25 * 2 * 2 / study.axes.TOGETHER)
        for task in tasks:
            for item in task.items:
                point = plan.point_of(item.index)
                assert task.points[item.point] == plan.changes(point)
                speed, grip = np.unravel_index(item.index % plan.entries_per_point, (2, 2))
                assert (item.speed_m_s, task.grip_N) == (plan.speeds_m_s[speed], plan.grips_N[grip])

    def test_what_is_done_leaves_no_task_but_changes_none(self, study: Any, small: Any) -> None:
        takes = study.axes.Recorder(small.scene, small.axes)
        every = list(small.tasks(lambda index: False, takes))
        last = every[-1].items[-1].index
        assert list(small.tasks(lambda index: index != last, takes)) == every[-1:]

    def test_sample_is_a_latin_hypercube(self, study: Any, scene: Scene) -> None:
        texts = (
            "limits.current_A=1:6:2",
            "amplifier.pole_Hz=100:10000:2:log",
            "time.stages=100:199:2",
            "weights.rho=0,1",
        )
        axes = tuple(study.axes.parse_axis(scene, "--vary", text) for text in texts)
        plan = study.axes.Plan(scene, axes, (0.4,), (5.0,), sample=20, seed=4)
        points = [plan.changes(p) for p in range(20)]
        current = np.array([point["limits.current_A"] for point in points])
        decades = np.log10([point["amplifier.pole_Hz"] for point in points])
        # One in each of twenty slices of every range, by equal factors on the logarithmic one.
        assert sorted(np.floor((current - 1) / 5 * 20)) == list(range(20))
        assert sorted(np.floor((decades - 2) / 2 * 20)) == list(range(20))
        assert all(isinstance(point["time.stages"], int) for point in points)
        assert sum(point["weights.rho"] == 0.0 for point in points) == 10
        again = study.axes.Plan(scene, axes, (0.4,), (5.0,), sample=20, seed=4)
        other = study.axes.Plan(scene, axes, (0.4,), (5.0,), sample=20, seed=5)
        assert [again.changes(p) for p in range(20)] == points != [other.changes(p) for p in range(20)]

    def test_recordings_are_the_same_taps_for_every_device_and_horizon(self, study: Any, small: Any) -> None:
        recorder, scene = study.axes.Recorder, small.scene
        axes = [study.axes.parse_axis(scene, "--vary", text) for text in ("time.lead_s=0:1e-3:3", "motor=maxon_re40")]
        _, plain_digest = recorder(scene, ()).taken({})
        takes = recorder(scene, axes)
        assert takes.taken({"time.lead_s": 1e-3, "motor": axes[1].values[0]})[1] == plain_digest
        assert takes.taken({"recordings.simulated.seed": 2})[1] != plain_digest
        longer = study.axes.parse_axis(scene, "--vary", "time.stages=80,300")
        [first, *_], _ = recorder(scene, [longer]).taken({})
        assert first.acceleration.end_s > 0.03 + 0.03


class TestRows:
    def test_every_row_is_certified_and_sorted(self, finished: Path) -> None:
        rows = read(finished / "rows.csv")
        assert [int(row["index"]) for row in rows] == list(range(24))
        assert {row["status"] for row in rows} == {"OPTIMAL"}
        assert max(float(row["relative_gap"]) for row in rows) <= 1e-6
        assert {row["limits.current_A"] for row in rows} == {"1.5", "2.75", "4.0"}
        saturated = [row for row in rows if row["binding"] != "none"]
        assert saturated
        assert all(float(row["mu_current_1_A"]) > 0 for row in saturated)

    def test_a_kill_at_any_byte_loses_and_doubles_nothing(
        self, study: Any, small: Any, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        whole = (finished / "rows.csv").read_bytes()
        header = whole.index(b"\n") + 1
        random = np.random.default_rng(3)
        for place in (0, header - 1, header, len(whole) - 1, *random.integers(header, len(whole), 2)):
            out = tmp_path / str(place)
            out.mkdir()
            (out / "study.json").write_bytes((finished / "study.json").read_bytes())
            (out / "rows.csv").write_bytes(whole[:place])
            rows = study.session.run_plan(small, out, serial(study))
            assert plain(out / "rows.csv") == plain(finished / "rows.csv")
            assert len(rows) == 24
            # Rows that were whole are kept as they were, times included.
            assert (
                whole[: whole[:place].rfind(b"\n") + 1]
                == (out / "rows.csv").read_bytes()[: whole[:place].rfind(b"\n") + 1]
            )
            assert ("torn last line cut" in capsys.readouterr().err) == (place not in (0, header))

    def test_nothing_is_solved_twice(
        self, study: Any, small: Any, finished: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(study.run, "run_task", lambda task: pytest.fail("solved again"))
        assert len(study.session.run_plan(small, finished, serial(study))) == 24

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda plan, parse: replace(plan, grips_N=(1.0, 4.0)), "grips_N"),
            (
                lambda plan, parse: replace(plan, scene=plan.scene.model_copy(update={"hand_over_samples": 9})),
                "hand_over_samples 10 there, 9 now",
            ),
            (
                lambda plan, parse: replace(plan, axes=(parse(plan.scene, "", "limits.current_A=1,2"), plan.axes[1])),
                "axes.limits.current_A",
            ),
        ],
    )
    def test_another_study_in_the_same_folder(
        self, study: Any, small: Any, finished: Path, change: Callable[..., Any], words: str
    ) -> None:
        other = change(small, study.axes.parse_axis)
        before = (finished / "rows.csv").read_bytes()
        with pytest.raises(InputError, match="holds another study") as refusal:
            study.session.run_plan(other, finished, serial(study))
        assert words in str(refusal.value)
        assert "\n" not in str(refusal.value)
        assert (finished / "rows.csv").read_bytes() == before

    def test_other_versions(self, study: Any, small: Any, finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(study.rows, "versions", lambda: {"casadi": "0.1"})
        with pytest.raises(InputError, match="holds another study: versions"):
            study.session.run_plan(small, finished, serial(study))

    @pytest.mark.parametrize(
        "damage", [lambda lines: [lines[0], *lines[2:3] * 2], lambda lines: [lines[0], b"1,x\n", *lines[1:]]]
    )
    def test_damage_that_no_kill_can_do(
        self, study: Any, small: Any, finished: Path, tmp_path: Path, damage: Callable[[list[bytes]], list[bytes]]
    ) -> None:
        (tmp_path / "study.json").write_bytes((finished / "study.json").read_bytes())
        lines = (finished / "rows.csv").read_bytes().splitlines(keepends=True)
        (tmp_path / "rows.csv").write_bytes(b"".join(damage(lines)))
        with pytest.raises(InputError, match="a line in the middle is damaged"):
            study.session.run_plan(small, tmp_path, serial(study))

    @pytest.mark.skipif(sys.platform == "win32", reason="no flock")
    def test_two_runs_at_a_time(self, study: Any, small: Any, finished: Path) -> None:
        with (
            study.rows.Rows(finished, *rows_of(study, small)),
            pytest.raises(InputError, match="another run is writing there"),
        ):
            study.session.run_plan(small, finished, serial(study))


def rows_of(study: Any, plan: Any) -> tuple[Any, list[str], int]:
    takes = study.axes.Recorder(plan.scene, plan.axes)
    return study.session.definition(plan, takes), [axis.key for axis in plan.axes], plan.entries


class Dying(Executor):
    """Runs calls in place; the n-th ones end as if a worker process had died, and with it the executor."""

    def __init__(self, dies: Iterator[bool]) -> None:
        self.dies, self.dead = dies, False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        if self.dead:
            raise BrokenProcessPool("dead")
        future: Future[Any] = Future()
        self.dead = next(self.dies)
        if self.dead:
            future.set_exception(BrokenProcessPool("died"))
        else:
            future.set_result(fn(*args, **kwargs))
        return future


class TestExecutors:
    def test_all_give_the_same_rows(self, study: Any, small: Any, finished: Path, tmp_path: Path) -> None:
        pools = {"processes": study.run.processes(2)}
        with ThreadPoolExecutor(2) as threads:
            pools["threads"] = study.run.Pool.of(threads, 2)
            for name, pool in pools.items():
                study.session.run_plan(small, tmp_path / name, pool)
                pool.close()
                assert plain(tmp_path / name / "rows.csv") == plain(finished / "rows.csv"), name

    def test_dead_workers_are_replaced(self, study: Any, small: Any, finished: Path, tmp_path: Path) -> None:
        dies = itertools.cycle([False, True])
        pool = study.run.Pool("mortal", lambda: Dying(dies), lambda: 1, revived=True)
        study.session.run_plan(small, tmp_path, pool)
        assert plain(tmp_path / "rows.csv") == plain(finished / "rows.csv")

    def test_workers_that_die_again_and_again(self, study: Any, small: Any, finished: Path, tmp_path: Path) -> None:
        dies = itertools.chain([False], itertools.repeat(True))
        pool = study.run.Pool("mortal", lambda: Dying(dies), lambda: 1, revived=True)
        with pytest.raises(InputError, match=r"mortal: a worker died 4 times in a row .*the same command goes on"):
            study.session.run_plan(small, tmp_path, pool)
        assert 0 < len(read(tmp_path / "rows.csv")) < 24
        study.session.run_plan(small, tmp_path, serial(study))
        assert plain(tmp_path / "rows.csv") == plain(finished / "rows.csv")

    @pytest.mark.skipif(not Path("/proc").exists(), reason="finds the workers in /proc")
    def test_a_killed_process(self, study: Any, small: Any, finished: Path, tmp_path: Path) -> None:
        killed: list[int] = []

        def kill(done: int) -> None:
            if not killed:
                running = study.scale.descendants(os.getpid())
                killed.extend(pid for pid in running if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes())
                for pid in killed:
                    os.kill(pid, signal.SIGKILL)

        pool = study.run.processes(1)
        study.session.run_plan(small, tmp_path, pool, watch=kill)
        pool.close()
        assert killed
        assert plain(tmp_path / "rows.csv") == plain(finished / "rows.csv")

    def test_tasks_under_way_are_bounded(self, study: Any, small: Any) -> None:
        taken: list[Any] = []

        def tasks() -> Iterator[Any]:
            for number in range(50):
                taken.append(number)
                yield number

        class Idle(Executor):
            def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
                future: Future[Any] = Future()
                waiting.append(future)
                if len(waiting) == study.run.AHEAD * 2:
                    for each in waiting:
                        each.set_result([])
                    waiting.clear()
                return future

        waiting: list[Future[Any]] = []
        finished: list[int] = []
        study.run.execute(
            study.run.Pool.of(Idle(), 2), itertools.islice(tasks(), 48), lambda o: finished.append(len(taken))
        )
        assert len(finished) == 48
        assert all(count - j <= 2 * study.run.AHEAD for j, count in enumerate(finished))

    @pytest.mark.parametrize(
        ("text", "jobs", "words"),
        [
            ("mpi", 1, "--executor mpi: must be processes, serial or dask://HOST:PORT"),
            ("processes", 0, "--jobs 0: must be at least 1"),
        ],
    )
    def test_refusals(self, study: Any, text: str, jobs: int, words: str) -> None:
        with pytest.raises(InputError, match=words):
            study.run.executor_pool(text, jobs)

    def test_dask_that_is_not_installed(self, study: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "distributed", None)
        with pytest.raises(InputError, match=r"pip install 'transopt\[cluster\]'"):
            study.run.executor_pool("dask://127.0.0.1:1", 1)
