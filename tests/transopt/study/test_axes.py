"""What a study varies, its points and tasks, and rows as text."""

import csv
import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import problems
from tests.benches.actuators import nonlinear_scene
from transopt.base.errors import InputError
from transopt.base.writing import csv_text
from transopt.design import design as the_one_way
from transopt.design.build import Build
from transopt.recordings.recording import Recording
from transopt.scene.file import read_scene
from transopt.scene.keys import Changes, with_values
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions
from transopt.study.axes import apply_settings, parse_axis
from transopt.study.figures import PercentLocator, axis_label
from transopt.study.plan import TOGETHER, Plan
from transopt.study.recordings import StudyRecordings
from transopt.study.report import study_answer
from transopt.study.rows import COLUMNS, DEFECT, REFUSED, exit_code, row_of
from transopt.study.tasks import Item, Task, run_task

FILES = [problems.FOLDER]


class TestAxes:
    @pytest.mark.parametrize(
        ("text", "values"),
        [
            ("limits.current_A=1.25:6:20", np.linspace(1.25, 6, 20)),
            ("amplifier.pole_Hz=100:10000:3:log", (100.0, 1000.0, 10000.0)),
            ("time.stages=100:200:3", (100, 150, 200)),
            ("limits.supply_V=9, none", (9.0, None)),
            ("weights.rapid=highpass,pacinian", ("highpass", "pacinian")),
        ],
    )
    def test_values(self, scene: Scene, text: str, values: Sequence[Any]) -> None:
        axis = parse_axis(scene, "--vary", text)
        if all(isinstance(value, float) for value in values):
            assert axis.values == pytest.approx(values, rel=1e-11)
        else:
            assert axis.values == tuple(values)
        assert [type(value) for value in axis.values] == [float if isinstance(v, float) else type(v) for v in values]
        assert len(set(axis.labels)) == len(axis.values)

    def test_motors_are_swapped_whole(self, scene: Scene, tmp_path: Path) -> None:
        own = tmp_path / "own.toml"
        own.write_text((problems.FOLDER / "motors" / "maxon_re40_148877.toml").read_text(encoding="utf-8"))
        axis = parse_axis(scene, "--vary", f"motor=maxon_re25,{own}", FILES)
        assert axis.labels == ("maxon_re25_118743", "own")
        plan = Plan(scene, (axis,), (0.4,), (5.0,))
        second = with_values(scene, plan.changes(1)).motor
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
            ("limit.current_A=1,2", "did you mean limits.current_A"),
        ],
    )
    def test_refusals(self, scene: Scene, text: str, words: str) -> None:
        with pytest.raises(InputError, match=words.replace("(", r"\(")) as refusal:
            parse_axis(scene, "--vary", text, FILES)
        assert "\n" not in str(refusal.value)

    def test_speed_outside_the_recordings(self, scene: Scene) -> None:
        with pytest.raises(InputError, match=r"--speed 0.5: must be between 0.1 and 0.4 m/s"):
            Plan(scene, (), (0.5,), (1.0,))

    def test_without_a_folder_of_motors_a_path_is_asked_for(self, scene: Scene) -> None:
        with pytest.raises(InputError, match=r"motor = maxon_re25: no such file; give the path of a .toml file$"):
            parse_axis(scene, "--vary", "motor=maxon_re25")

    def test_settings_hold_for_all_points(self, scene: Scene) -> None:
        changed = apply_settings(scene, ["limits.current_A=2"], FILES)
        assert changed.limits.transient_input == pytest.approx(2.0)
        with pytest.raises(InputError, match="one value; --vary takes several"):
            apply_settings(scene, ["limits.current_A=2,3"])


def test_a_figure_labels_a_key_by_its_words_and_unit() -> None:
    assert axis_label("limits.current_A") == "limits: current [A]"
    assert axis_label("time.lead_s", "ms") == "time: lead [ms]"
    assert axis_label("weights.rho") == "weights: rho"
    assert axis_label("motor") == "motor"


@pytest.mark.parametrize(("low", "high", "least"), [(16.0, 34.0, 3), (0.02, 20.0, 9), (24.0, 36.0, 2)])
def test_an_axis_of_percentages_has_ticks_inside(low: float, high: float, least: int) -> None:
    ticks = [tick for tick in PercentLocator().tick_values(low, high) if low <= tick <= high]
    assert len(ticks) >= least


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

    def test_on_a_nonlinear_plant_an_entry_is_a_task(self, tmp_path: Path) -> None:
        scene = read_scene(nonlinear_scene(tmp_path))
        axis = parse_axis(scene, "--vary", "limits.voltage_V=2,12")
        tasks = list(Plan(scene, (axis,), (0.0,), (0.0,)).tasks(lambda _: False, StudyRecordings(scene, (axis,))))
        assert [len(task.items) for task in tasks] == [1, 1]

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


def test_cells_are_read_back_exactly_and_stay_on_one_line() -> None:
    place = {"index": 7, "speed_m_s": 0.1 + 0.2, "grip_N": 1.0, "target": ""}
    said = 'with "quotes", a comma\nand a new line'
    outcome = {**place, "status": "OPTIMAL", "tap_error": 1e-7 / 3, "reason": said}
    row = row_of(outcome, 3, {"limits.current_A": "1.5", "motor": "two\nlines"})
    text = csv_text(list(row), [row.values()])
    assert text.count("\n") == 2
    [again] = csv.DictReader(text.splitlines())
    assert again == row
    assert (float(again["speed_m_s"]), float(again["tap_error"])) == (outcome["speed_m_s"], outcome["tap_error"])
    assert (again["index"], again["point"], again["motor"]) == ("7", "3", "two lines")
    assert again["floor"] == ""  # nothing to say
    assert again["reason"] == 'with "quotes", a comma and a new line'


def test_exit_code() -> None:
    def code(*statuses: str) -> int:
        return exit_code([{"status": status} for status in statuses])

    assert code("OPTIMAL", "REFUSED", "INFEASIBLE") == code("STATIONARY") == 0
    assert code("REFUSED") == code("OPTIMAL", "NOT_CERTIFIED") == code() == 1


def task(
    scene: Scene, taps: list[Recording], points: list[Changes], speeds: list[float], grip_N: float = 5.0
) -> Task:
    pairs = [(p, speed) for p in range(len(points)) for speed in speeds]
    items = tuple(Item(j, p, speed) for j, (p, speed) in enumerate(pairs))
    source = f"of the session {scene.model_dump_json()}"
    return Task(scene, tuple(taps), source, grip_N, tuple(points), items, SolverOptions())


def test_same_as_the_library(scene: Scene, taps: list[Recording], build: Build) -> None:
    found = run_task(task(scene, taps, [{}], scene.grid.speeds_m_s))
    own = [row[2] for row in build.entries]
    assert [outcome["status"] for outcome in found] == ["OPTIMAL"] * 4
    for outcome, entry in zip(found, own, strict=True):
        assert outcome["tap_error"] == pytest.approx(entry.figures.tap_error, rel=1e-9)
        assert outcome["floor"] == pytest.approx(entry.floor, rel=1e-9)
        assert outcome["peak_input"] == pytest.approx(entry.played.peak_input, rel=1e-9)
        assert outcome["peak_temperature_C"] == pytest.approx(entry.played.winding_C, rel=1e-9)
        assert outcome["binding"] == entry.binding
        assert outcome["relative_gap"] <= 1e-6
    mu = own[3].solution.multipliers
    assert found[3]["mu_current_1_A"] == pytest.approx(
        max(mu.lower("current").max(), mu.upper("current").max()), rel=1e-6
    )


def test_an_own_limit_that_binds_hardest_is_named(taps: list[Recording], tmp_path: Path) -> None:
    """A joint at 2 N costs most of the tap, a current of 3.9 A hardly anything."""
    law = "lambda s: 6e4 * s.output('transmission stretch')"
    (tmp_path / "joint.py").write_text(
        f"import transopt as to\nLIMITS = [to.own_limit('joint', 'N', {law}, upper=2)]\n"
    )
    text = problems.scene_path("wood_on_foam").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("[limits]", '[limits]\nown = ["joint.py"]'), encoding="utf-8")
    (outcome,) = run_task(task(problems.load(path), taps, [{}], [0.4]))
    assert {"joint 2 N", "current +4 A"} <= {part.split(" at ")[0] for part in outcome["binding"].split("; ")}
    assert outcome["largest_multiplier"].startswith("joint ")
    assert 0 <= outcome["violation"] <= 2e-6


def test_points_of_other_devices_in_one_task_come_out_as_alone(scene: Scene, taps: list[Recording]) -> None:
    points: list[Changes] = [{}, {"amplifier.pole_Hz": 300.0}, {"limits.supply_V": 9.0}, {"thermal.ambient_C": 30.0}]
    together = run_task(task(scene, taps, points, [0.4]))
    for outcome, point in zip(together, points, strict=True):
        [alone] = run_task(task(scene, taps, [point], [0.4]))
        assert alone["tap_error"] == pytest.approx(outcome["tap_error"], rel=1e-8)
        assert alone["status"] == outcome["status"] == "OPTIMAL"
    assert together[2]["peak_voltage_V"] <= 9.0 * 1.001
    assert together[0]["peak_voltage_V"] != together[0]["peak_voltage_V"]  # NaN: no rail, no voltage


def test_what_cannot_be_is_a_row_with_its_reason(scene: Scene, taps: list[Recording]) -> None:
    points: list[Changes] = [{"limits.current_A": 50.0}, {}]
    refused, fine = run_task(task(scene, taps, points, [0.4]))
    assert refused["status"] == REFUSED
    assert "above the motor's i_peak_A" in refused["reason"]
    assert (fine["status"], fine["reason"]) == ("OPTIMAL", "")


def test_an_infeasible_entry_is_told_and_has_no_figures_of_an_answer(scene: Scene, taps: list[Recording]) -> None:
    outcomes = run_task(task(scene, taps, [{"limits.supply_V": 0.2}, {}], [0.4]))
    refused, fine = ({name for name, value in each.items() if str(value) != "nan"} for each in outcomes)
    assert outcomes[0]["status"] == "INFEASIBLE"
    assert "back-EMF" in outcomes[0]["reason"]
    assert {"floor", "free_peak"} <= refused & fine
    assert {"tap_error", "felt_error", "heat_A2_s", "peak_input", "objective", "binding"} <= fine - refused


@pytest.mark.parametrize(("refused", "where"), [(False, "whatever is varied"), (True, "wherever each entry has a")])
def test_where_nothing_changes_refused_points_are_no_part_of_it(scene: Scene, refused: bool, where: str) -> None:
    plan = Plan(scene, (parse_axis(scene, "--vary", "limits.current_A=2,3"),), (0.4,), (5.0,))
    place = {"speed_m_s": 0.4, "grip_N": 5.0, "target": "", "status": "OPTIMAL", "tap_error": 0.3}
    second = {**place, "status": "INFEASIBLE", "tap_error": np.nan, "reason": "no"} if refused else place
    rows = [row_of({"index": k, **each}, k, plan.labels(k)) for k, each in enumerate((place, second))]
    assert f"has an error of 30.0 % {where}" in study_answer(plan, rows)[0]


def test_a_defect_takes_nobody_with_it(scene: Scene, taps: list[Recording], monkeypatch: pytest.MonkeyPatch) -> None:
    best = the_one_way.best

    def breaks(problem: object, options: SolverOptions, *, objective: str) -> object:
        if problem.limits.input_limit == 3.0:  # type: ignore[attr-defined]
            raise RuntimeError("two\nlines")
        return best(problem, options, objective=objective)  # type: ignore[arg-type]

    monkeypatch.setattr(the_one_way, "best", breaks)
    one, other = run_task(task(scene, taps, [{"limits.current_A": 3.0}, {"limits.current_A": 3.5}], [0.4]))
    assert (one["status"], one["reason"]) == (DEFECT, "RuntimeError: two lines")
    assert other["status"] == "OPTIMAL"


def test_baselines_and_prices_only_where_wanted(scene: Scene, taps: list[Recording], build: Build) -> None:
    plain = task(scene, taps, [{}], [0.4])
    [without], [full] = run_task(plain), run_task(replace(plain, rivals=True))
    entry = build.entries[3][2]
    assert "price" not in without
    assert full["price"] == "; ".join(price.sentence for price in entry.prices)
    assert full["tap_error_clipped"] == pytest.approx(entry.baselines.clipped.tap_error, rel=1e-9)
    assert full["tap_error_seed"] == pytest.approx(entry.baselines.seed.tap_error, rel=1e-9)
    same = {"price", "tap_error_seed", "tap_error_clipped", "solve_ms", "total_ms"}
    for name in COLUMNS.keys() - same:
        value, alone = full[name], without[name]
        if isinstance(value, float):
            # Played together with the baselines, so that the last bits may be other ones.
            assert alone == pytest.approx(value, rel=1e-9, nan_ok=True)
        else:
            assert alone == value


def test_other_methods_are_told_at_the_limit_of_their_own_point(scene: Scene, taps: list[Recording]) -> None:
    points: list[Changes] = [{"limits.current_A": A} for A in (2.0, 3.5)]
    together = run_task(replace(task(scene, taps, points, [0.4]), rivals=True))
    for outcome, point in zip(together, points, strict=True):
        [alone] = run_task(replace(task(scene, taps, [point], [0.4]), rivals=True))
        assert outcome["tap_error_clipped"] == pytest.approx(alone["tap_error_clipped"], rel=1e-9)
        assert outcome["tap_error_seed"] == pytest.approx(alone["tap_error_seed"], rel=1e-9)
    assert together[0]["tap_error_clipped"] > 1.2 * together[1]["tap_error_clipped"]


@pytest.mark.parametrize("rivals", [False, True])
def test_a_replay_that_breaks_is_told_in_its_rows(
    scene: Scene, taps: list[Recording], monkeypatch: pytest.MonkeyPatch, rivals: bool
) -> None:
    def breaks(*_: object, **__: object) -> None:
        raise ZeroDivisionError("no step")

    for name in ("accurate", "replayed"):
        monkeypatch.setattr(f"transopt.design.batch.{name}", breaks)
    found = run_task(replace(task(scene, taps, [{}], [0.3, 0.4]), rivals=rivals))
    assert [(each["status"], each["reason"]) for each in found] == [(DEFECT, "ZeroDivisionError: no step")] * 2
