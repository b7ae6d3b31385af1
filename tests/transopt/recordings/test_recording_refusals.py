"""Every bad recording gives one line that says what and where, whatever its bytes."""

import io
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.benches.recording_files import (
    HEADER,
    PACKERS,
    TAP_M_S2,
    TIMES_S,
    VALID,
    VARIABLES,
    csv,
    load_any,
    mat,
    npz,
    path_refusal,
    refusal,
    text,
    wav,
)
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G
from transopt.recordings.recording import load_recording

FUZZED = settings(
    max_examples=30,  # of each format; tests/campaigns/test_hostile_files.py draws more
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


# ---- bad files -------------------------------------------------------------------------------------------


def test_files_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    missing = tmp_path / "none.csv"
    assert f"{missing}: no such file" in path_refusal(missing)
    assert f"{tmp_path}: a folder, not a file; name a recording, or several as" in path_refusal(tmp_path)
    assert "is empty (0 bytes)" in refusal(tmp_path, b"")
    assert "name too long" in path_refusal(tmp_path / ("a" * 300 + ".csv"))
    assert "no\\nne.csv" in path_refusal(tmp_path / "no\nne.csv")

    def denied(self: Path, mode: str) -> None:
        raise PermissionError(13, "Permission denied")

    content = tmp_path / "mine.csv"
    content.write_text(csv())
    monkeypatch.setattr(Path, "open", denied)  # as root, the mode alone would not do it
    assert "no permission to read it" in path_refusal(content)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    assert "a pipe or a device, not a file" in path_refusal(tmp_path / "pipe.csv")


@pytest.mark.parametrize("suffix", [".docx", ""])
def test_unknown_format(tmp_path: Path, suffix: str) -> None:
    message = refusal(tmp_path, csv(), suffix)
    known = ".csv, .tsv, .txt, .dat, .log, .asc, .lvm, .xlsx, .ods, .npz, .mat, .tdms, .h5, .uff, .wav"
    assert message == f"unknown format {suffix!r}; known: {known}; export it as CSV"


def test_unnamed_columns(tmp_path: Path) -> None:
    how = "state it, for example --columns 'time [s],acc [m/s^2]' (in a scene recordings.columns = "
    assert how in refusal(tmp_path, VALID[".txt"], ".txt")
    assert how in refusal(tmp_path, VALID[".dat"], ".dat")
    message = refusal(tmp_path, "# only a remark\n" + text(TIMES_S, TAP_M_S2))
    assert message.startswith("row 2: '0,0' has no row of names above it; state it")
    assert how in message


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\x89PNG\xff\xfe\x00", "row 1: byte 0x89 is not UTF-8 text; save it as UTF-8"),
        (csv().encode() + b"\xb5\n0.1,1\n", "row 202: 1 cells, 2 columns"),
        (csv().encode() + b"\xb5\1", "row 202: byte 0xb5 is not UTF-8"),
        ("\ufeff".encode() + b"time_s\n\xb5", "row 2: byte 0xb5 is not UTF-8"),
        (HEADER.encode() + b"0,\0\n", "row 2: byte 0x00 is not UTF-8"),
        (csv().encode("utf-16")[:-1], "row 201: byte 0x0a is not UTF-8"),
        ("# nothing else\n", "no rows of numbers, at least 8 are needed"),
        (HEADER, "0 samples, at least 8 are needed"),
        ("t:0:0", "0 acceleration columns in 'time_s': must be 1; name one acceleration_m_s2 or acceleration_g"),
        (csv(TIMES_S[:7], TAP_M_S2[:7]), "7 samples, at least 8 are needed"),
        (csv() + "0.1,1,2\n", "row 202: 3 cells, 2 columns ('time_s, acceleration_m_s2'); correct"),
        (csv() + "0.1\n0.2,1\n", "row 202: 1 cells, 2 columns"),
        (csv() + "0.02,\n0.0201,\n0.0202,1\n", "after row 201 (0.0199 s): step 0.3 ms, median 0.1 ms: 2 samples"),
        (HEADER + "# a remark\n\n0,one\n", "row 4, column acceleration_m_s2: 'one' is no number; correct"),
        (HEADER + "0,1\n1e-4,nan\n", "2 samples"),
        (HEADER + "0,nan\n" * 5 + text(TIMES_S, TAP_M_S2), "row 2, column acceleration_m_s2: nan: must be"),
        (csv() + "-inf,1\n", "row 202, column time_s: -inf: must be finite"),
        (csv() + "1,1e300\n", "row 202, column acceleration_m_s2: 1e+300: must be finite and at most 1e+12"),
        ("time_s,acceleration_yd_s2\n0,0\n", "no unit stated in the column 'acceleration_yd_s2'; known: acc"),
        ("time_s,time_ms\n0,0\n", "2 time columns in 'time_s, time_ms': must be 1"),
        ("time_s,time_s\n0,0\n", "2 time columns in 'time_s, time_s': must be 1"),
        ("time,acc\n", "no unit stated in the columns 'time, acc'"),
        ("time_s,time_ms,acc\n", "2 time columns in"),
        ("time_s,load [g]\n0,0\n", "column 'load' may hold grams of a load cell, and no other is an acceleration's"),
        ("time_s,load cell in mg\n0,0\n", "column 'load cell' may hold grams of a load cell"),
        ("time_s,force_N\n0,0\n", "0 acceleration columns in 'time_s, force_N': must be 1; name one acceleration"),
        ("acceleration_g,force_N\n0,0\n", "0 time columns in 'acceleration_g, force_N': must be 1; name one time_s"),
        (csv(values=np.full(200, G)), "recording is constant at 9.80665 m/s^2 throughout: is the sensor connected?"),
        (HEADER + "," * 70_000, "row 2: 70000 characters, at most 65536; put one sample in a row"),
        ("# " + "x" * 70_000, "row 1: 70002 characters, at most 65536"),
        (csv() + "1_0,2e\n0.1,1\n", "row 202, column acceleration_m_s2: '2e' is no number"),
        ("time_s\tacceleration_g\n0,1\t1,5\n", "1 samples, at least 8 are needed"),
        (HEADER + "0,1,5\n" + text(TIMES_S, TAP_M_S2), "row 2: 3 cells, 2 columns ('time_s, acceleration_m_s2')"),
    ],
)
def test_bad_text(tmp_path: Path, content: str | bytes, words: str) -> None:
    assert refusal(tmp_path, content).startswith(words)


def test_a_european_spreadsheet_is_read(tmp_path: Path) -> None:
    """Semicolons, decimal commas, its note about the delimiter, and padding of short rows."""
    path = tmp_path / "tap.csv"
    rows = "\r\n".join(f"{k * 1e-4:.4f};{np.sin(k):.3f};".replace(".", ",") for k in range(20))
    path.write_text(f"sep=;\r\n# speed_m_s: 0,21;;\r\n# grip_N = 3,5\r\ntime_s;acceleration_g;\r\n{rows}\r\n")
    recording = load_recording(path)
    assert recording.speed_m_s == pytest.approx(0.21, rel=1e-15)
    assert recording.grip_N == pytest.approx(3.5, rel=1e-15)
    np.testing.assert_allclose(recording.acceleration.values / G, np.sin(np.arange(20)), atol=5e-4)


def test_rows_of_numbers_only_are_read_as_rows_with_a_remark_in_each(tmp_path: Path) -> None:
    """Nearly all files have rows of nothing but numbers, which numpy reads; others are read cell by cell."""
    chance = np.random.default_rng(81)
    values = chance.standard_normal(200) * 10.0 ** chance.integers(-12, 3, 200)
    rows = [f"{t!r} ,\t{value!r}" for t, value in zip(TIMES_S.tolist(), values.tolist(), strict=True)]
    plain, remarked = tmp_path / "plain.csv", tmp_path / "remarked.csv"
    plain.write_text(HEADER + "\n".join(rows))
    remarked.write_text(HEADER.strip() + ",-\n" + "\n".join(row + ",a remark" for row in rows))
    for path in (plain, remarked):
        np.testing.assert_allclose(load_recording(path).acceleration.values, values, rtol=1e-15, atol=0)


def test_decimal_commas_are_suspected(tmp_path: Path) -> None:
    assert "decimal commas? write points" in refusal(tmp_path, HEADER + "0,1,1,5\n")


@pytest.mark.parametrize(
    ("comments", "words"),
    [
        ("# speed_m_s: 0\n", "speed_m_s = 0 m/s: must be > 0 and finite; correct it"),
        ("# speed_mm_s: -210\n", "speed_mm_s = -210 mm/s: must be > 0"),
        ("# speed_m_s = nan\n", "speed_m_s = nan m/s: must be > 0"),
        ("# grip_N: -3\n", "grip_N = -3 N: must be >= 0 and finite"),
        ("# grip_N: inf\n", "grip_N = inf N: must be >= 0 and finite"),
        ("# speed_m_s: fast\n", "speed_m_s is 'fast': must be one number, without a unit"),
        ("# speed_m_s: 0.2 m/s\n", "speed_m_s is '0.2 m/s': must be one number"),
        ("# grip_N:\n", "grip_N is '': must be one number"),
        ("# speed_m_s: 0.2\n# speed_m_s: 0.3\n", "row 2: speed_m_s is stated a second time"),
        ("# speed_m_s: 0.2\n# speed_mm_s: 200\n", "the speed is stated twice, by speed_m_s and speed_mm_s"),
        ("#\n# sped_m_s: 0.2\n", "row 2: unknown header key 'sped_m_s'; known: speed_m_s, speed_mm_s, grip_N"),
        ("# speed_cm_s: 20\n", "row 1: unknown header key 'speed_cm_s'"),
        ("# grip_n: 3\n", "row 1: unknown header key 'grip_n'"),
        ("# grip: 3\n", "row 1: unknown header key 'grip'; known: speed_m_s, speed_mm_s, grip_N"),
        ("# grip_kg: 0.3\n", "row 1: unknown header key 'grip_kg'"),
        ("# Speed: 0.2\n", "row 1: unknown header key 'Speed'"),
        ("# speed = 0,2 m/s\n", "row 1: unknown header key 'speed'"),
        ("# Speed_m_s: 0.2\n", "row 1: unknown header key 'Speed_m_s'"),
    ],
)
def test_bad_header_values(tmp_path: Path, comments: str, words: str) -> None:
    assert refusal(tmp_path, csv(comments=comments)).startswith(words)


def test_a_column_that_the_caller_misspells(tmp_path: Path) -> None:
    message = refusal(tmp_path, VALID[".csv"], columns=["time_s", "acceleratoin"])
    assert message.startswith("unknown column 'acceleratoin'; known: time_s")


@pytest.mark.parametrize("suffix", PACKERS)
@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"acceleration_m_s2": TAP_M_S2[:99]}, "(time_s 200, acceleration_m_s2 99 samples)"),
        ({"acceleration_m_s2": np.ones((9, 9))}, "variable acceleration_m_s2 is 'float64' of shape (9, 9): must"),
        ({"acceleration_m_s2": 1j * TAP_M_S2}, "variable acceleration_m_s2 is"),
        ({"acceleration_m_s2": "text"}, "must be one row or column of real numbers"),
        ({"acceleration_m_s2": 1.0, "time_s": 1.0}, "1 samples, at least 8"),
        ({"acceleration_m_s2": np.where(TIMES_S > 0.005, np.nan, 1.0)}, "column acceleration_m_s2: nan: must be"),
        ({"speed_m_s": TAP_M_S2}, "must be one number"),
        ({"speed_m_s": -1.0}, "speed_m_s = -1 m/s: must be > 0"),
        ({"grip_N": "firm"}, "variable grip_N is"),
        ({"posn_mm": TAP_M_S2}, "unknown column 'posn_mm'; known: time_s"),
    ],
)
def test_bad_variables(tmp_path: Path, suffix: str, changed: dict[str, Any], words: str) -> None:
    assert words in refusal(tmp_path, PACKERS[suffix](**{**VARIABLES, **changed}), suffix)


@pytest.mark.parametrize("head", ["Frequency (Hz),Magnitude (mm/s/V),Phase (deg)", "freq,re,im"])
def test_a_frequency_response_is_called_one_whatever_its_columns_could_be_read_as(tmp_path: Path, head: str) -> None:
    rows = "".join(f"{20 + j},{0.5 + 0.01 * j},{89 - j}\n" for j in range(40))
    message = refusal(tmp_path, f"{head}\n{rows}")
    assert message.endswith("by `transopt plant fit FILE --order 2 --out plant.npz`")
    assert "--units" not in message


@pytest.mark.parametrize("suffix", PACKERS)
def test_missing_variables(tmp_path: Path, suffix: str) -> None:
    message = refusal(tmp_path, PACKERS[suffix](a=TIMES_S, b=TAP_M_S2), suffix)
    assert message.startswith("unknown column 'a'; known: time_s")  # one letter means no acceleration by itself
    assert "for example --units 'a=s,b=m/s^2'" in message
    message = refusal(tmp_path, PACKERS[suffix](acc=TAP_M_S2, b=TAP_M_S2), suffix)
    assert message.startswith(
        "0 time columns in 'acc, b': must be 1; name one time_s or time_ms, or state the sample rate"
    )
    assert "for example --rate-Hz 10000 (in a scene recordings.rate_Hz = 10000.0)" in message
    message = refusal(tmp_path, VALID[suffix], suffix, columns=["time_ms", "acceleration_g"])
    assert message.startswith("no variable time_ms; found: 'time_s, acceleration_m_s2, speed_m_s, grip_N'")


class Exploit:
    """Unpickling it fails the test."""

    def __reduce__(self) -> tuple[Any, ...]:
        return pytest.fail, ("the file's pickle was run",)


def test_pickles_are_refused_unopened(tmp_path: Path) -> None:
    objects = npz(time_s=TIMES_S, acceleration_g=np.array([Exploit()] * 200, dtype=object))
    message = refusal(tmp_path, objects, ".npz")
    assert message.startswith(
        "variable acceleration_g is not readable ('acceleration_g holds pickled objects, which are"
    )
    assert message.endswith("numpy.savez (no objects, no pickles)")
    assert refusal(tmp_path, pickle.dumps(Exploit()), ".npz").startswith("not a readable NPZ file")
    stream = io.BytesIO()
    np.save(stream, TAP_M_S2)
    assert refusal(tmp_path, stream.getvalue(), ".npz").startswith("not a readable NPZ file ('a single array, not an")


def test_mat_versions_and_damage(tmp_path: Path) -> None:
    hdf5 = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(384) + b"\x89HDF\r\n\x1a\n" + bytes(99)
    assert refusal(tmp_path, hdf5, ".mat").startswith("not a readable HDF5 file (")
    for content in (mat(version="4", **VARIABLES), b"\x00"):
        message = refusal(tmp_path, content, ".mat")
        assert message == "not a readable MAT file ('not of -v6 or -v7; -v7.3 is HDF5'); save it in MATLAB with -v7"
    assert "it is cut short" in refusal(tmp_path, VALID[".mat"][:-100], ".mat")
    # A type tag beyond the format's table; it takes the process down with scipy's reader.
    damaged = bytearray(mat(**VARIABLES))
    damaged[damaged.index(b"acceleration_m_s2") + 24] = 99
    assert refusal(tmp_path, bytes(damaged), ".mat").startswith("not a readable MAT file ('99'); save")
    damaged = bytearray(mat(do_compression=True, **VARIABLES))
    damaged[-1] ^= 1
    assert "incorrect data check" in refusal(tmp_path, bytes(damaged), ".mat")


def test_bad_wav(tmp_path: Path) -> None:
    def wav_refusal(content: bytes, full_scale_m_s2: float | None = 10.0) -> str:
        return refusal(tmp_path, content, ".wav", full_scale_m_s2=full_scale_m_s2)

    for scale in (0.0, -1.0, float("nan")):
        message = wav_refusal(VALID[".wav"], scale)
        assert message == f"recordings.full_scale_m_s2 = {scale:g}: must be above 0 m/s^2 and finite"
    assert wav_refusal(VALID[".wav"], None).startswith("the acceleration of a WAV file's full scale is not stated")
    stereo = np.stack([TAP_M_S2, TAP_M_S2], axis=1)
    assert "for example --channel 1 (in a scene recordings.channel = 1)" in wav_refusal(wav(stereo))
    options = {"full_scale_m_s2": 10.0, "channel": 3}
    assert refusal(tmp_path, wav(stereo), ".wav", **options).startswith("--channel 3: the file has 2 channels")
    assert wav_refusal(b"not a wave file").startswith("not a readable WAV file (")
    assert "Reached EOF prematurely" in wav_refusal(VALID[".wav"][:-80])
    assert "column time_s: nan: must be finite" in wav_refusal(wav(TAP_M_S2, rate_Hz=0))
    assert "constant at 0 m/s^2" in wav_refusal(wav(np.zeros(100, dtype=np.int16)))
    spoilt = np.where(np.isin(np.arange(200), range(3, 9)), np.nan, TAP_M_S2)
    assert wav_refusal(wav(spoilt)).startswith("sample 3, column acceleration_m_s2: nan: must be finite")


# ---- fuzzed bytes ----------------------------------------------------------------------------------------

PATCHES = [b"\xff" * 4, b"\0" * 4, b"\0\0\0\x80", b"nan", b"1e308", b",", b"\n", b"#", b"grip_N:"]


def mutated(valid: bytes) -> st.SearchStrategy[bytes]:
    """Valid bytes with a few stretches replaced, inserted or cut out."""
    patch = st.one_of(st.binary(max_size=8), st.sampled_from(PATCHES))
    edit = st.tuples(st.integers(0, len(valid)), st.integers(0, 40), patch)

    def apply(edits: list[tuple[int, int, bytes]]) -> bytes:
        content = valid
        for at, length, replacement in edits:
            content = content[:at] + replacement + content[at + length :]
        return content

    return st.lists(edit, min_size=1, max_size=6).map(apply)


def check_outcome(folder: Path, content: bytes, suffix: str) -> None:
    """A finite recording or one line; any other exception, and any warning, fails the test."""
    try:
        recording = load_any(folder, content, suffix)
    except InputError:
        assert len(refusal(folder, content, suffix)) < 500
    else:
        assert np.all(np.isfinite(recording.acceleration.values))
        assert recording.acceleration.values.size >= 8


@pytest.mark.parametrize("suffix", VALID)
@FUZZED
@given(data=st.data())
def test_no_bytes_give_anything_else(tmp_path: Path, suffix: str, data: st.DataObject) -> None:
    check_outcome(tmp_path, data.draw(st.one_of(st.binary(max_size=300), mutated(VALID[suffix]))), suffix)


@FUZZED
@given(content=mutated(mat(do_compression=True, **VARIABLES)))
def test_no_compressed_mat_gives_anything_else(tmp_path: Path, content: bytes) -> None:
    check_outcome(tmp_path, content, ".mat")


@FUZZED
@given(content=st.text(alphabet='0123456789.,;-+eE \t\n#:_nagimfrpNtcols"', max_size=300))
def test_no_text_gives_anything_else(tmp_path: Path, content: str) -> None:
    for suffix, header in ((".csv", HEADER), (".csv", ""), (".txt", "")):
        check_outcome(tmp_path, (header + content).encode(), suffix)
