"""Cells of a workbook as the text that its program would export."""

from datetime import date, datetime
from pathlib import Path

import numpy as np
import pytest

from tests.benches.tap_formats import workbook
from transopt.files.containers import _cell, sheet_as_text
from transopt.recordings.recording import load_recording


def test_an_instant_at_midnight_is_one_of_the_others() -> None:
    """A workbook's date has no type of its own: the reader hands out a day where the time of day is zero."""
    assert _cell(date(2024, 3, 5)) == str(datetime(2024, 3, 5)) == "2024-03-05 00:00:00"
    assert _cell(datetime(2024, 3, 5, 0, 0, 0, 200)) == "2024-03-05 00:00:00.000200"


def test_a_unit_merged_over_columns_is_that_of_each_and_a_title_is_none(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    times_s = np.arange(2000) * 1e-4
    ring = np.where(times_s > 0.1, 50 * np.exp(-80 * (times_s - 0.1)) * np.sin(1e3 * (times_s - 0.1)), 0.0)
    rows = zip(times_s.tolist(), (0.1 * ring).tolist(), (0.2 * ring).tolist(), ring.tolist(), strict=True)
    head = [("Plate 3", "", "", ""), ("time", "acc x", "acc y", "acc z"), ("s", "m/s^2", "", "")]
    data = workbook([*head, *rows], merged="A1:D1 B3:D3")
    assert sheet_as_text(data, []).startswith(b"Plate 3;;;\ntime;acc x;acc y;acc z\ns;m/s^2;m/s^2;m/s^2\n")
    (tmp_path / "taps.xlsx").write_bytes(data)
    recording = load_recording(tmp_path / "taps.xlsx")
    whole = np.sqrt(0.1**2 + 0.2**2 + 1)  # the three directions are one motion
    assert np.abs(recording.acceleration.values).max() == pytest.approx(whole * np.abs(ring).max(), rel=1e-6)
