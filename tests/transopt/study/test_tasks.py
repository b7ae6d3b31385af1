"""Entries of varied scenes."""

from dataclasses import replace
from itertools import pairwise

import pytest

from transopt.design import design as the_one_way
from transopt.design.build import Build
from transopt.recordings.recording import Recording
from transopt.scene.keys import Changes
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions
from transopt.study.rows import COLUMNS, DEFECT, REFUSED
from transopt.study.tasks import Item, Task, run_task


def task(
    scene: Scene, taps: list[Recording], points: list[Changes], speeds: list[float], grip_N: float = 5.0
) -> Task:
    pairs = [(p, speed) for p in range(len(points)) for speed in speeds]
    items = tuple(Item(j, p, speed) for j, (p, speed) in enumerate(pairs))
    return Task(scene, tuple(taps), "of the session", grip_N, tuple(points), items, SolverOptions())


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


def test_larger_current_limit_is_never_worse(scene: Scene, taps: list[Recording]) -> None:
    limits = [1.25, 2.0, 2.9, 3.0, 4.0, 5.5]
    found = run_task(task(scene, taps, [{"limits.current_A": A} for A in limits], [0.4]))
    J = [outcome["objective"] for outcome in found]
    # The optimum itself is monotone, each answer is within its own gap of it.
    assert all(b <= a + 1e-6 * max(a, 1e-3) for a, b in pairwise(J))
    assert J[0] > 30 * J[-1]
    assert all(o["peak_input"] <= A + 1e-6 for o, A in zip(found, limits, strict=True))


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


def test_infeasible_entry_is_told(scene: Scene, taps: list[Recording]) -> None:
    [outcome] = run_task(task(scene, taps, [{"limits.supply_V": 0.2}], [0.4]))
    assert outcome["status"] == "INFEASIBLE"
    assert "back-EMF" in outcome["reason"]


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
