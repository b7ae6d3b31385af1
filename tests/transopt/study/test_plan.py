"""The points of a study, and the tasks that solve them."""

import itertools
import math

import numpy as np

import problems
from transopt.scene.scene import Scene
from transopt.study.axes import parse_axis
from transopt.study.plan import TOGETHER, Plan
from transopt.study.recordings import StudyRecordings


class TestPoints:
    def test_all_combinations_once(self, small: Plan) -> None:
        found = {tuple(small.changes(p).values()) for p in range(small.points)}
        assert found == set(itertools.product((1.5, 2.75, 4.0), (500.0, 1050.0)))
        assert small.entries == 24

    def test_tasks_share_a_device_and_cover_every_row_once(self, small: Plan) -> None:
        scene = small.scene
        texts = ("limits.current_A=1:6:25", "amplifier.pole_Hz=500,1050", "weights.rho=1e-3,1e-4")
        plan = Plan(scene, tuple(parse_axis(scene, "--vary", text) for text in texts), (0.3, 0.4), (1.0, 5.0))
        tasks = list(plan.tasks(lambda index: False, StudyRecordings(scene, plan.axes)))
        rows = [item.index for task in tasks for item in task.items]
        assert sorted(rows) == list(range(plan.entries))
        assert all(len({point["amplifier.pole_Hz"] for point in task.points}) == 1 for task in tasks)
        assert max(len(task.items) for task in tasks) == TOGETHER
        assert len(tasks) == 2 * 2 * math.ceil(25 * 2 * 2 / TOGETHER)
        for task in tasks:
            for item in task.items:
                point = plan.point_of(item.index)
                assert task.points[item.point] == plan.changes(point)
                speed, grip = np.unravel_index(item.index % plan.entries_per_point, (2, 2))
                assert (item.speed_m_s, task.grip_N) == (plan.speeds_m_s[speed], plan.grips_N[grip])

    def test_what_is_done_leaves_no_task_but_changes_none(self, small: Plan) -> None:
        takes = StudyRecordings(small.scene, small.axes)
        every = list(small.tasks(lambda index: False, takes))
        last = every[-1].items[-1].index
        assert list(small.tasks(lambda index: index != last, takes)) == every[-1:]

    def test_sample_is_a_latin_hypercube(self, scene: Scene) -> None:
        texts = (
            "limits.current_A=1:6:2",
            "amplifier.pole_Hz=100:10000:2:log",
            "time.stages=100:199:2",
            "weights.rho=0,1",
        )
        axes = tuple(parse_axis(scene, "--vary", text) for text in texts)
        plan = Plan(scene, axes, (0.4,), (5.0,), sample=20, seed=4)
        points = [plan.changes(p) for p in range(20)]
        current = np.array([point["limits.current_A"] for point in points])
        decades = np.log10([point["amplifier.pole_Hz"] for point in points])
        # One in each of twenty slices of every range, by equal factors on the logarithmic one.
        assert sorted(np.floor((current - 1) / 5 * 20)) == list(range(20))
        assert sorted(np.floor((decades - 2) / 2 * 20)) == list(range(20))
        assert all(isinstance(point["time.stages"], int) for point in points)
        assert sum(point["weights.rho"] == 0.0 for point in points) == 10
        again = Plan(scene, axes, (0.4,), (5.0,), sample=20, seed=4)
        other = Plan(scene, axes, (0.4,), (5.0,), sample=20, seed=5)
        assert [again.changes(p) for p in range(20)] == points != [other.changes(p) for p in range(20)]

    def test_recordings_are_the_same_taps_for_every_device_and_horizon(self, small: Plan) -> None:
        scene = small.scene
        axes = [
            parse_axis(scene, "--vary", text, [problems.FOLDER])
            for text in ("time.lead_s=0:1e-3:3", "motor=maxon_re40")
        ]
        _, plain_digest = StudyRecordings(scene, ()).of({})
        takes = StudyRecordings(scene, axes)
        assert takes.of({"time.lead_s": 1e-3, "motor": axes[1].values[0]})[1] == plain_digest
        assert takes.of({"recordings.simulated.seed": 2})[1] != plain_digest
        longer = parse_axis(scene, "--vary", "time.stages=80,300")
        [first, *_], _ = StudyRecordings(scene, [longer]).of({})
        assert first.acceleration.end_s > 0.03 + 0.03
