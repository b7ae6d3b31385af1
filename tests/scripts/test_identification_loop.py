"""The parts of the loop script that no command does: scene files, the known truth, what counts as fallen short."""

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import identification_loop as loop
import numpy as np
import pytest

import problems
from controller.sim.chosen_device import device_in
from controller.sim.simulator import Imperfections
from transopt.design.build import build_library
from transopt.library.library import Library
from transopt.recordings.tap import read_recordings
from transopt.scene.scene import Scene


def test_recorded_files_give_the_library_of_the_simulated_object(library: Library, tmp_path: Path) -> None:
    path = loop.recorded_scene("wood_on_foam", tmp_path)
    scene = problems.load(path)
    assert scene.recordings.simulated is None
    again = build_library(scene, read_recordings(scene.recordings)).library
    assert again is not None
    # The files round accelerations to 1e-4 g and speeds to 1e-4 m/s.
    np.testing.assert_allclose(again.reference_m_s2, library.reference_m_s2, atol=0.2)
    np.testing.assert_allclose(again.nrmse, library.nrmse, atol=2e-3)


def test_a_scene_on_its_model(tmp_path: Path) -> None:
    path, model = loop.recorded_scene("wood_on_foam", tmp_path), tmp_path / "m.json"
    before = tomllib.loads(path.read_text())
    after = tomllib.loads(loop.with_model(path, model).read_text())
    assert after.pop("model_file") == "m.json"
    assert after == before


def test_without_mismatch_the_known_truth_is_the_library(scene: Scene, library: Library) -> None:
    device = device_in(scene, Imperfections(), 0)
    f = np.geomspace(5, 2000, 30)
    for grip in (1.0, 5.0):
        np.testing.assert_allclose(loop.plant_of(device, grip).response(f), scene.plant(grip).response(f), rtol=1e-9)
    truth = loop.without_servo(loop.TRUTH, library, device, loop.known_optimum)
    np.testing.assert_allclose(truth.nrmse, library.nrmse.ravel(), atol=1e-6)
    assert truth.peak_current_A == pytest.approx(4.0, abs=1e-6)
    other = device_in(scene, Imperfections(mismatch=0.2), 4)
    best = loop.without_servo(loop.TRUTH, library, other, loop.known_optimum)
    own = loop.without_servo(loop.IDENTIFIED, library, other, lambda node, _: library.command[node])
    assert best.worst > truth.worst
    assert own.mean > best.mean + 0.01


def test_rounds_keep_the_best_so_far(library: Library) -> None:
    rounds = [
        {"nrmse": [[0.2, 0.3]], "better": [[True, True]], "peak_current_A": [[1.0, 2.0]]},
        {"nrmse": [[0.1, 0.4]], "better": [[True, False]], "peak_current_A": [[1.0, 3.0]]},
        {"nrmse": [[None, 0.2]], "better": [[None, True]], "peak_current_A": [[None, 1.0]]},
    ]
    found = loop.rounds_of(replace(library, meta={**library.meta, "refinement": {"rounds": rounds}}), 3)
    assert [stage.nrmse for stage in found] == [[0.1, 0.3], [0.1, 0.2], [0.1, 0.2]]
    assert [stage.peak_current_A for stage in found] == [3.0, 1.0, 1.0]


def test_what_falls_short(library: Library) -> None:
    def stages(nominal: float, model: float, refined: float, own: float = 0.0104, peak: float = 4.0) -> list[Any]:
        named = {
            "nominal model": nominal,
            "identified model": model,
            "refined, kept": refined,
            loop.IDENTIFIED: own,
            loop.TRUTH: 0.01,
        }
        return [loop.Stage(name, [value] * 12, peak) for name, value in named.items()]

    def short(*values: float, unstated: bool = False, **more: float) -> list[str]:
        return list(loop.shortfalls(0.1, stages(*values, **more), library, unstated))

    assert short(0.09, 0.04, 0.03) == []
    [worse] = short(0.09, 0.10, 0.03)
    assert "identified 10.00%, worse than nominal 9.00%" in worse
    [far] = short(0.09, 0.04, 0.03, own=0.0106)
    assert "up to 0.3 m/s identified 1.060%, known truth 1.000%" in far
    assert short(0.09, 0.04, 0.03, own=0.0106, unstated=True) == []
    [refined] = short(0.09, 0.04, 0.05)
    assert "refined, kept 5.00%, identified model 4.00%" in refined
    assert len(short(0.09, 0.04, 0.03, peak=4.01)) == 4


def test_a_record_without_one_of_its_numbers(tmp_path: Path) -> None:
    np.savez(tmp_path / "one.npz", time_s=np.arange(3.0), accelerometer_Hz=2500.0)
    loop.leave_out(tmp_path / "one.npz", "accelerometer_Hz")
    with np.load(tmp_path / "one.npz") as record:
        assert record.files == ["time_s"]
