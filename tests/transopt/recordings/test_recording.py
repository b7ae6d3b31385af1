"""Every format gives the same recording, on a uniform time grid, in SI."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from tests.benches.recording_files import (
    DT_S,
    PACKERS,
    TAP_M_S2,
    TIMES_S,
    VALID,
    VARIABLES,
    csv,
    load,
    load_any,
    mat,
    npz,
    refusal,
    text,
    wav,
)
from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G
from transopt.base.signals import FloatArray
from transopt.recordings.recording import Recording

# ---- what is read ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [*VALID, ".CSV", ".Wav"])
def test_every_format_gives_the_same_tap(tmp_path: Path, suffix: str) -> None:
    content = VALID[suffix.lower()]
    recording = load_any(tmp_path, content, suffix)
    assert recording.acceleration.dt_s == pytest.approx(DT_S, rel=1e-9)
    assert recording.acceleration.start_s == 0.0
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)
    assert recording.name == f"tap{suffix}"
    assert recording.source == str(tmp_path / f"tap{suffix}")
    assert recording.sha256 == hashlib.sha256(content).hexdigest()
    stated = (0.21, 3.0) if suffix.lower() in (".csv", ".npz", ".mat") else (None, None)
    assert (recording.speed_m_s, recording.grip_N) == stated


def test_units_become_si(tmp_path: Path) -> None:
    rows = text(1e3 * TIMES_S, TAP_M_S2 / G, 1e3 * TAP_M_S2, TAP_M_S2 + 1, TAP_M_S2 + 2)
    header = "# speed_mm_s: 210\ntime_ms,acceleration_g,position_mm,force_N,current_A\n"
    recording = load(tmp_path, header + rows)
    assert recording.speed_m_s == pytest.approx(0.21)
    signals = (recording.acceleration, recording.position, recording.force, recording.current)
    for signal, offset in zip(signals, (0, 0, 1, 2), strict=True):
        assert signal.dt_s == pytest.approx(DT_S, rel=1e-9)
        np.testing.assert_allclose(signal.values, TAP_M_S2 + offset, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "content",
    [
        "\ufeff" + csv(),
        csv().replace("\n", "\r\n"),
        csv().replace("\n", "\r"),
        csv().replace(",", " , ").replace("\n", "\n\n"),
        csv().replace(",", ";"),
        csv().replace(",", "\t"),
        csv().replace(",", "   "),
        csv().replace("time_s,acceleration_m_s2", '"time_s","acceleration_m_s2"'),
        "# at 10:15: by hand\n# material: wood\n# mean 3 g, by: A. B.\n" + csv() + "# the end\n",
        csv().rstrip("\n"),
    ],
)
def test_csv_dialects(tmp_path: Path, content: str) -> None:
    np.testing.assert_allclose(load(tmp_path, content).acceleration.values, TAP_M_S2, atol=1e-9)


@pytest.mark.parametrize(
    "footer",
    [
        "End of data\n",
        "\n\nEOF,,\n",
        "Mean,0.12\nMax,8.2\n",
        "\nStatistics\nmin,-3.1\nrms,0.3\nStop time,2026-11-01 10:00:03\n",
        "-----\n200 rows\n",
        "\x1a",
        "0.02",
        "0.02,",
    ],
)
@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_what_stands_below_the_numbers_is_left_out_and_named(tmp_path: Path, footer: str, mark: str) -> None:
    recording = load(tmp_path, (csv() + footer).replace(",", mark))
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)
    first = footer.strip().splitlines()[0].replace(",", mark)
    assert [note for note in recording.notes if "below the numbers" in note and "is left out" in note]
    assert repr(" ".join(first.split()))[1:5] in recording.notes[0]


@pytest.mark.parametrize("rows", ["1,2\nx\n1,2\n", "x\n" * 60, "0.02,1,2\n"])
def test_what_stands_among_the_numbers_or_is_long_is_refused(tmp_path: Path, rows: str) -> None:
    assert "row 20" in refusal(tmp_path, csv() + rows)


def test_a_slow_channel_that_ends_in_a_blank_keeps_its_rows(tmp_path: Path) -> None:
    forces = ["1" if k % 2 == 0 else "" for k in range(TIMES_S.size)]
    slow = "".join(f"{t:.4f},{a:.12g},{f}\n" for t, a, f in zip(TIMES_S, TAP_M_S2, forces, strict=True))
    recording = load(tmp_path, "time_s,acceleration_m_s2,force_N\n" + slow)
    assert not any("below the numbers" in note for note in recording.notes)
    assert recording.acceleration.values.size == TIMES_S.size - 1


def test_a_rate_below_the_numbers_counts(tmp_path: Path) -> None:
    recording = load(tmp_path, "acc [m/s^2]\n" + text(TAP_M_S2) + "Sample rate: 5 kHz\n")
    assert recording.acceleration.rate_Hz == pytest.approx(5000.0)


def test_columns_replace_the_csv_header_and_skip(tmp_path: Path) -> None:
    pairs = zip(TIMES_S, TAP_M_S2, strict=True)
    rows = "".join(f"{a:.12g},10:15:{t:.4f},{t:.12g}\n" for t, a in pairs)
    for content in (rows, "a,clock,t\n" + rows):
        recording = load(tmp_path, content, columns=["acceleration_m_s2", "-", "time_s"])
        np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)


@pytest.mark.parametrize("suffix", PACKERS)
def test_columns_choose_the_variables(tmp_path: Path, suffix: str) -> None:
    content = PACKERS[suffix](**VARIABLES, acceleration_g=TAP_M_S2, misc_s=TIMES_S)
    recording = load(tmp_path, content, suffix, columns=["time_s", "acceleration_m_s2"])
    np.testing.assert_array_equal(recording.acceleration.values, TAP_M_S2)


@pytest.mark.parametrize(("kind", "half"), [("u1", 192), ("i2", 2**14), ("i4", 2**30), ("f4", 0.5), ("f8", 0.5)])
def test_wav_full_scale(tmp_path: Path, kind: str, half: float) -> None:
    samples = np.array([128 if kind == "u1" else 0, half] * 5).astype(kind)
    recording = load(tmp_path, wav(samples, 8000), ".wav", full_scale_m_s2=490.0)
    np.testing.assert_allclose(recording.acceleration.values, [0.0, 245.0] * 5, rtol=1e-12)
    assert recording.acceleration.dt_s == pytest.approx(1 / 8000)


@pytest.mark.parametrize("do_compression", [False, True])
@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8", ">f8"])
def test_mat_reader_agrees_with_scipy(tmp_path: Path, kind: str, do_compression: bool) -> None:
    """For every storage type, among variables of every other class."""
    values = np.array([[1], [0], [2], [100], [3], [4], [5], [6], [7]]).astype(kind)
    content = mat(
        do_compression=do_compression,
        note="text",
        nested={"a": 1.0, "b": [1.0, 2.0]},
        cells=np.array(["x", 2.0, [3.0]], dtype=object),
        complex_values=1j * values,
        empty=np.zeros((0, 0)),
        time_ms=np.arange(9.0),
        acceleration_m_s2=values,
        grip_N=np.float32(2.5),
    )
    recording = load(tmp_path, content, ".mat")
    expected = loadmat(tmp_path / "tap.mat")["acceleration_m_s2"].ravel()
    np.testing.assert_array_equal(recording.acceleration.values, expected)
    assert recording.grip_N == 2.5


# ---- the time grid ---------------------------------------------------------------------------------------


def smooth(times_s: FloatArray) -> FloatArray:
    return np.sin(2 * np.pi * 100 * times_s)


def load_smooth(folder: Path, times_s: FloatArray) -> Recording:
    values = smooth(times_s)
    return load(folder, npz(time_s=times_s, acceleration_m_s2=values, position_m=values), ".npz")


def test_jitter_below_a_percent_leaves_the_values(tmp_path: Path) -> None:
    times_s = TIMES_S + 9e-3 * DT_S * np.random.default_rng(1).uniform(-1, 1, TIMES_S.size)
    times_s[[0, -1]] = TIMES_S[[0, -1]]
    recording = load_smooth(tmp_path, times_s)
    np.testing.assert_array_equal(recording.acceleration.values, smooth(times_s))
    assert recording.acceleration.dt_s == pytest.approx(DT_S, rel=1e-12)


def test_jitter_is_resampled_with_a_splines_order(tmp_path: Path) -> None:
    """The error of a cubic spline falls with the fourth power of the step."""
    errors = []
    for dt_s in (4e-4, 2e-4, 1e-4):
        count = round(0.04 / dt_s)
        times_s = dt_s * (np.arange(count) + np.random.default_rng(2).uniform(-0.15, 0.15, count))
        recording = load_smooth(tmp_path, times_s)
        error = recording.acceleration.values - smooth(recording.acceleration.times_s)
        errors.append(np.max(np.abs(error[10:-10])))  # the spline's end conditions are of lower order
    assert np.all(np.log2(np.array(errors[:-1]) / errors[1:]) > 3.4)
    assert errors[-1] < 1e-5


def test_samples_on_the_grid_are_left_whatever_their_stamps_say(tmp_path: Path) -> None:
    late_s = 0.1 * DT_S * np.random.default_rng(3).standard_normal(TIMES_S.size)
    recording = load(tmp_path, csv(TIMES_S + late_s, smooth(TIMES_S)))
    np.testing.assert_allclose(recording.acceleration.values, smooth(TIMES_S), atol=1e-6)
    # No worse for a bad first stamp, and nearer than the first and the last stamp tell.
    assert recording.acceleration.dt_s == pytest.approx(DT_S, rel=5e-4)
    assert recording.acceleration.start_s == pytest.approx(TIMES_S[0], abs=0.05 * DT_S)


def test_drift_within_a_percent_of_each_step_is_resampled(tmp_path: Path) -> None:
    """A clock 0.9 % fast, then 0.9 % slow: every step passes, the samples lie four steps off the grid."""
    steps_s = DT_S * np.where(np.arange(999) < 500, 0.991, 1.009)
    acceleration = load_smooth(tmp_path, np.append(0.0, np.cumsum(steps_s))).acceleration
    np.testing.assert_allclose(acceleration.values, smooth(acceleration.times_s), atol=1e-5)


def test_dropped_sample(tmp_path: Path) -> None:
    lost = [101, 102, 103]
    message = refusal(tmp_path, csv(np.delete(TIMES_S, lost), np.delete(TAP_M_S2, lost)))
    # Sample 100 stands in row 102: below the header row, and rows count from 1.
    assert message.startswith(
        "after row 102 (0.01 s): step 0.4 ms, median 0.1 ms: 3 samples dropped; at most 1 in a row"
    )


def test_single_lost_rows_are_interpolated_and_said_so(tmp_path: Path) -> None:
    lost = [40, 101]
    recording = load(tmp_path, csv(np.delete(TIMES_S, lost), np.delete(smooth(TIMES_S), lost)))
    np.testing.assert_allclose(recording.acceleration.values, smooth(TIMES_S), atol=1e-5)
    found = "2 of 200 samples lost or without a time, first after row 41 (0.0039 s): interpolated"
    assert recording.notes == (found,)
    many = list(range(40, 60, 2))
    message = refusal(tmp_path, csv(np.delete(TIMES_S, many), np.delete(TAP_M_S2, many)))
    assert message.startswith("10 of 200 samples lost or without a time, first after row 41 (0.0039 s): at most 1 %")


def test_a_stamp_far_off_its_place_is_none(tmp_path: Path) -> None:
    times_s = TIMES_S.copy()
    times_s[51] = times_s[50] + 5e-6
    recording = load(tmp_path, csv(times_s, smooth(TIMES_S)))
    assert "1 of 200 samples lost or without a time" in recording.notes[0]
    np.testing.assert_allclose(recording.acceleration.values, smooth(TIMES_S), atol=1e-5)


def test_stamps_are_judged_by_their_rms(tmp_path: Path) -> None:
    """One of 2000 stamps is late by most of a step; the others shake by 3 % of one."""
    times_s = DT_S * (np.arange(2000) + 0.03 * np.random.default_rng(4).standard_normal(2000))
    times_s[700] += 0.85 * DT_S
    recording = load_smooth(tmp_path, times_s)
    np.testing.assert_allclose(
        recording.acceleration.values[9:-9], smooth(recording.acceleration.times_s)[9:-9], atol=1e-4
    )
    shaken = DT_S * (np.arange(2000) + 0.49 * np.random.default_rng(4).uniform(-1, 1, 2000))
    message = refusal(tmp_path, npz(time_s=shaken, acceleration_m_s2=smooth(shaken)), ".npz")
    assert "steps (rms) off a uniform grid" in message or "without a time" in message


def test_time_that_does_not_increase(tmp_path: Path) -> None:
    times_s = TIMES_S.copy()
    times_s[20] = times_s[19]
    message = refusal(tmp_path, csv(times_s, comments="# a remark\n\n"))
    assert message.startswith("row 24: time 0.0019 s does not increase, before it 0.0019 s; sort")
    variables = {**VARIABLES, "time_s": times_s}
    assert refusal(tmp_path, npz(**variables), ".npz").startswith("element [20]: time 0.0019 s")
    assert refusal(tmp_path, mat(**variables), ".mat").startswith("element (21): time 0.0019 s")


@pytest.mark.parametrize(("bits", "unit_s"), [(32, 1e-6), (32, 1e-3), (16, 1e-6)])
def test_the_times_of_a_counter_go_on_where_it_begins_anew(tmp_path: Path, bits: int, unit_s: float) -> None:
    """`micros()` begins anew after 72 minutes, a counter of 16 bit that counts microseconds after each 65.536 ms."""
    step = max(round(DT_S / unit_s), 1)
    counts = (2**bits - 100 * step + step * np.arange(2000)) % 2**bits
    values = smooth(DT_S * np.arange(2000))
    recording = load(tmp_path, csv(unit_s * counts, values))
    np.testing.assert_allclose(recording.acceleration.values, values, atol=1e-4)
    assert recording.acceleration.dt_s == pytest.approx(step * unit_s, rel=1e-6)
    (note,) = (each for each in recording.notes if "begin anew" in each)
    assert f"a counter of {bits} bit" in note
    counts[1500] -= 40 * step  # a time that is out of order is none
    assert "does not increase" in refusal(tmp_path, csv(unit_s * counts, values))


@pytest.mark.parametrize("factor", [1e4, 1e-7])
def test_time_in_the_wrong_unit(tmp_path: Path, factor: float) -> None:
    message = refusal(tmp_path, csv(factor * TIMES_S))
    assert f"median time step {factor * DT_S:g} s: must be 1e-09 to 0.05 s: check the unit of the time" in message


@pytest.mark.parametrize("row", [1, 60, 150])
def test_a_row_without_a_number_counts_as_a_lost_one(tmp_path: Path, row: int) -> None:
    """One rule for a row that a recorder left out and one that it filled with NaN."""
    gone = np.where(np.arange(TIMES_S.size) == row, np.nan, TAP_M_S2)
    filled = load(tmp_path, csv(values=gone))
    left_out = load(tmp_path, csv(np.delete(TIMES_S, row), np.delete(TAP_M_S2, row)))
    np.testing.assert_allclose(filled.acceleration.values, left_out.acceleration.values, rtol=1e-12, atol=1e-12)
    assert "1 of 200 samples lost" in filled.notes[0]
    assert "interpolated" in filled.notes[0]


def test_two_rows_in_a_row_without_a_number_are_refused(tmp_path: Path) -> None:
    gone = np.where(np.isin(np.arange(TIMES_S.size), [60, 61]), np.nan, TAP_M_S2)
    assert "2 samples dropped; at most 1 in a row is interpolated" in refusal(tmp_path, csv(values=gone))
    gone[::20] = np.nan
    assert "column acceleration_m_s2: nan: must be finite" in refusal(tmp_path, csv(values=gone))
