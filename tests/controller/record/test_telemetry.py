"""Telemetry: nothing lost, nothing halved, readable at any moment."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from controller.protocol.codes import STATES
from controller.protocol.messages import Record
from controller.record.telemetry import COLUMNS, CSV_NAME, NPZ_NAME, Telemetry
from controller.servo.interface import State
from tests.benches.places import ROOT
from tests.benches.telemetry_file import read_csv
from transopt.base.errors import InputError

DT = 1e-4


def tick(k: int) -> tuple[int, Record, str]:
    grip_N = float("nan") if k == 3 else 0.1 * k
    playing = STATES.index(State.PLAYING)
    record = Record(-k, grip_N, 1 / 3, -2.5e-7 * k, 0.1 * k, 0.2, -0.3, 25.0 + k, playing, int(k == 5))
    return k, record, "contact;grip_lost" if k % 7 == 0 else ""


def write(folder: Path, ticks: int, block_ticks: int) -> Telemetry:
    telemetry = Telemetry(folder, DT, block_ticks=block_ticks)
    for k in range(ticks):
        telemetry.record(*tick(k))
    return telemetry


def same(a: dict[str, np.ndarray], b: dict[str, np.ndarray], records: int) -> None:
    assert set(a) == set(b) == set(COLUMNS)
    for name in COLUMNS:
        np.testing.assert_array_equal(a[name][:records], b[name][:records], err_msg=name)


def test_both_files_hold_what_was_recorded_bit_for_bit(tmp_path: Path) -> None:
    with write(tmp_path, 25, 10):
        pass
    csv, npz = read_csv(tmp_path / CSV_NAME), dict(np.load(tmp_path / NPZ_NAME))
    same(csv, npz, 25)
    assert csv["tick"].tolist() == list(range(25))
    assert csv["measured_current_A"][0] == 1 / 3
    assert csv["time_s"][7] == 7 * DT
    assert np.isnan(csv["grip_N"][3])
    assert csv["emergency_stop"].tolist() == [int(k == 5) for k in range(25)]
    assert csv["state"][0] == "playing"
    assert csv["events"][7] == "contact;grip_lost"
    assert csv["events"][8] == ""
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize("room", [0, 40, 1500])
def test_a_disk_that_fills_within_a_block_leaves_whole_lines_or_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    """The system writes what there is room for, and refuses the rest."""
    left, write_bytes = room, os.write

    def nearly_full(file: int, data: bytes) -> int:
        nonlocal left
        if data and not left:
            raise OSError(28, "No space left on device")
        written = write_bytes(file, data[:left])
        left -= written
        return written

    with monkeypatch.context() as patched:
        patched.setattr("controller.record.telemetry.os.write", nearly_full)
        with pytest.raises(InputError, match=r"telemetry.csv: cannot be written \(No space left on device\)"):
            write(tmp_path, 100, 10)
    assert not left
    if room < len(",".join(COLUMNS)):
        assert not list(tmp_path.iterdir())
        return
    assert (tmp_path / CSV_NAME).read_bytes().endswith(b"\n")
    whole = read_csv(tmp_path / CSV_NAME)["tick"]
    assert whole.size > 0
    assert whole.size % 10 == 0


def test_readable_while_running(tmp_path: Path) -> None:
    telemetry = Telemetry(tmp_path, DT, block_ticks=10)
    assert read_csv(tmp_path / CSV_NAME)["tick"].size == 0
    for k in range(200):
        telemetry.record(*tick(k))
        written = read_csv(tmp_path / CSV_NAME)
        assert written["tick"].size == (k + 1) // 10 * 10
        if k >= 9:
            stored = dict(np.load(tmp_path / NPZ_NAME))
            # No more than a quarter and a block behind.
            assert stored["tick"].size >= (written["tick"].size - 10) / 1.25
            same(stored, written, stored["tick"].size)
    telemetry.close()


def test_cut_anywhere_it_holds_whole_records_only(tmp_path: Path) -> None:
    with write(tmp_path, 12, 5):
        pass
    whole = (tmp_path / CSV_NAME).read_bytes()
    full = read_csv(tmp_path / CSV_NAME)
    head = whole.index(b"\n") + 1
    cut = tmp_path / "cut.csv"
    for length in range(head, len(whole) + 1):
        cut.write_bytes(whole[:length])
        found = read_csv(cut)
        assert found["tick"].size == whole[head:length].count(b"\n")
        same(found, full, 0)
        np.testing.assert_array_equal(found["command_A"], full["command_A"][: found["tick"].size])


def test_killed_without_warning(tmp_path: Path) -> None:
    """The process ends between two records without closing anything."""
    script = (
        "import os\nfrom pathlib import Path\nfrom tests.controller.record.test_telemetry import write\n"
        f"write(Path({str(tmp_path)!r}), 1234, 100)\nos._exit(9)\n"
    )
    root = ROOT
    ended = subprocess.run([sys.executable, "-c", script], cwd=root, check=False, timeout=60)
    assert ended.returncode == 9
    csv, npz = read_csv(tmp_path / CSV_NAME), dict(np.load(tmp_path / NPZ_NAME))
    assert csv["tick"].tolist() == list(range(1200))
    same(npz, csv, npz["tick"].size)
    assert npz["tick"].size >= 900


def test_an_error_in_the_run_still_closes_both_files(tmp_path: Path) -> None:
    def run() -> None:
        with Telemetry(tmp_path, DT) as telemetry:
            telemetry.record(*tick(0))
            raise RuntimeError("the run broke")

    with pytest.raises(RuntimeError, match="the run broke"):
        run()
    assert read_csv(tmp_path / CSV_NAME)["tick"].tolist() == [0]
    assert np.load(tmp_path / NPZ_NAME)["tick"].tolist() == [0]


def test_an_earlier_run_is_not_taken_for_this_one(tmp_path: Path) -> None:
    with write(tmp_path, 20, 10):
        pass
    telemetry = write(tmp_path, 3, 10)
    assert read_csv(tmp_path / CSV_NAME)["tick"].size == 0
    assert not (tmp_path / NPZ_NAME).exists()
    telemetry.close()


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        Telemetry(tmp_path / "file", DT)


@pytest.mark.parametrize("counts", [float("nan"), float("inf"), 2**70])
def test_a_broken_encoder_is_recorded_too(tmp_path: Path, counts: float) -> None:
    """The tick that shows the fault is the one that has to be in the file."""
    _, record, events = tick(0)
    with Telemetry(tmp_path, 1e-4) as telemetry:
        telemetry.record(0, dataclasses.replace(record, encoder_counts=counts), events)
    expected = float(counts)
    np.testing.assert_equal(read_csv(tmp_path / CSV_NAME)["encoder_counts"][0], expected)
    with np.load(tmp_path / NPZ_NAME) as file:
        np.testing.assert_equal(file["encoder_counts"][0], expected)
