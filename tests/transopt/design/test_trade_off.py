"""The path from the nearest waveform to nearly all energy, and how a report shows it."""

import json
from pathlib import Path

import numpy as np
import pytest

from transopt.design.build import Build, build_library
from transopt.recordings.recording import Recording
from transopt.report.figures import trade_off_figure
from transopt.report.markdown import build_markdown
from transopt.report.report_json import build_json
from transopt.report.write import write_report
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene


@pytest.fixture(scope="module")
def cut(scene: Scene, taps: list[Recording]) -> Build:
    return build_library(with_values(scene, {"limits.current_A": 2.5}), taps)


@pytest.fixture(scope="module")
def louder(scene: Scene, taps: list[Recording]) -> Build:
    return build_library(with_values(scene, {"limits.current_A": 1.6, "weights.objective": "intensity"}), taps)


def test_only_entries_that_a_limit_cuts_have_one(cut: Build) -> None:
    over = {(e.speed_m_s, e.grip_N) for e in cut.all_entries() if e.figures.tap_error > e.floor + 1e-3}
    assert {(t.speed_m_s, t.grip_N) for t in cut.trade_offs} == over


def test_a_path_rises_in_energy_and_in_error(cut: Build) -> None:
    for each in cut.trade_offs:
        dB, error = ([getattr(point, name) for point in each.path] for name in ("energy_dB", "tap_error"))
        assert len(dB) >= 8
        assert dB == sorted(dB)
        assert error[0] == min(error)
        assert each.path[0] == each.waveform
        assert each.path[-1].price == pytest.approx(0.99)
        assert each.intensity.energy_dB == pytest.approx(0.0, abs=0.01)


def test_the_waveform_of_both_objectives_is_the_same(cut: Build, scene: Scene, taps: list[Recording]) -> None:
    changed = with_values(scene, {"limits.current_A": 2.5, "weights.objective": "intensity"})
    there = {(each.speed_m_s, each.grip_N): each for each in build_library(changed, taps).trade_offs}
    for one in cut.trade_offs:
        other = there[one.speed_m_s, one.grip_N]
        assert one.waveform.tap_error == pytest.approx(other.waveform.tap_error, rel=1e-6)
        assert one.intensity.energy_dB == pytest.approx(other.intensity.energy_dB, abs=0.02)


def test_a_library_of_the_objective_has_the_energy(louder: Build) -> None:
    np.testing.assert_allclose(louder.library.energy_dB, 0.0, atol=0.011)
    prices = np.array([[entry.problem.intensity for entry in row] for row in louder.entries])
    np.testing.assert_array_equal(louder.library.intensity, prices)


def test_the_report_has_both_figures_and_says_what_they_are(cut: Build, louder: Build) -> None:
    text = build_markdown(cut)
    assert "## Waveform and intensity" in text
    assert text.count("| waveform | 0 |") == text.count("| intensity |") == len(cut.trade_offs)
    rows = json.loads(build_json(cut))["entries"]
    with_path = [row for row in rows if row["trade_off"] is not None]
    assert len(with_path) == len(cut.trade_offs)
    assert set(with_path[0]["trade_off"]) == {"waveform", "intensity", "missing_dB", "path"}
    assert "250" in with_path[0]["trade_off"]["waveform"]["levels"]["thirds_dB"]
    assert "## Intensity" not in text
    assert "asked for at lam" in build_markdown(louder)


def test_nothing_is_drawn_or_written_where_nothing_binds(scene: Scene, taps: list[Recording], tmp_path: Path) -> None:
    slow = with_values(scene, {"limits.current_A": 6.0, "grid.grips_N": [1.0]})
    built = build_library(slow, taps)
    assert built.trade_offs == []
    assert "## Waveform and intensity" not in build_markdown(built)
    assert "trade_off.png" not in {path.name for path in write_report(built, tmp_path, full=True)}


def test_the_figure_has_a_line_for_every_entry(cut: Build, tmp_path: Path) -> None:
    axes = trade_off_figure(cut).axes[0]
    labels = [line.get_label() for line in axes.lines if not str(line.get_label()).startswith("_")]
    assert labels == [f"{t.speed_m_s:g} m/s, {t.grip_N:g} N" for t in cut.trade_offs]
    assert "trade_off.png" in {path.name for path in write_report(cut, tmp_path, full=True)}
