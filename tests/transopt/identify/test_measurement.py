"""Records for identification: read in SI, with what their files state, or refused in one line."""

from pathlib import Path

import numpy as np
import pytest

from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.identify.measurement import load_measurement, load_measurements

TIMES_S = np.arange(20) * 1e-4
RAMP = np.linspace(-1.0, 1.0, 20)


def test_npz_and_csv_hold_the_same(tmp_path: Path) -> None:
    np.savez(
        tmp_path / "run.npz",
        time_s=TIMES_S,
        command_A=RAMP,
        acceleration_g=2 * RAMP,
        grip_N=3.0,
        accelerometer_Hz=2500,
    )
    rows = "\n".join(f"{t:.4f},{c!r},{2 * c!r}" for t, c in zip(TIMES_S, RAMP.tolist(), strict=True))
    head = "# grip_N: 3\n# accelerometer_Hz: 2500\ntime_s,command_A,acceleration_g\n"
    (tmp_path / "run.csv").write_text(head + rows + "\n")
    for name in ("run.npz", "run.csv"):
        run = load_measurement(tmp_path / name)
        assert run.name == name
        assert (run.grip_N, run.accelerometer_Hz, run.speed_m_s) == (3.0, 2500.0, None)
        assert run.current is None
        np.testing.assert_allclose(run.require("command").values, RAMP, rtol=1e-15)
        np.testing.assert_allclose(run.require("acceleration").values, 2 * RAMP * STANDARD_GRAVITY_M_S2, rtol=1e-12)
        assert run.require("command").dt_s == pytest.approx(1e-4, rel=1e-12)
        assert run.off_grid < 1e-6


def test_a_grip_that_no_hand_has_is_noted(tmp_path: Path) -> None:
    np.savez(tmp_path / "gf.npz", time_s=TIMES_S, command_A=RAMP, grip_N=300.0)
    (note,) = load_measurement(tmp_path / "gf.npz").notes
    assert note == "the grip is 300 N, a hand's 0.05 to 60 N: check the unit of the grip (a factor of 102: N and gf?)"
    np.savez(tmp_path / "N.npz", time_s=TIMES_S, command_A=RAMP, grip_N=3.0)
    assert load_measurement(tmp_path / "N.npz").notes == ()


def test_what_is_missing_or_misspelt_is_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "time.npz", time_s=TIMES_S)
    with pytest.raises(InputError, match=r"time\.npz: no column but time; known: time_s, .*command_A"):
        load_measurement(tmp_path / "time.npz")
    np.savez(tmp_path / "odd.npz", time_s=TIMES_S, winding_temp_C=RAMP)
    with pytest.raises(InputError, match=r"unknown column 'winding_temp_C'; known: .*winding_C"):
        load_measurement(tmp_path / "odd.npz")
    np.savez(tmp_path / "some.npz", time_s=TIMES_S, command_A=RAMP)
    with pytest.raises(InputError, match=r"some\.npz: no column current_A; record it too"):
        load_measurement(tmp_path / "some.npz").require("current")
    with pytest.raises(InputError, match="holds one signal"):
        load_measurement(tmp_path / "a.wav")


def test_a_record_given_twice_counts_once_or_not_at_all(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("a.npz", "b.npz", "copy_of_a.npz")]
    for path, factor in zip(paths, (1.0, 2.0, 1.0), strict=True):
        np.savez(path, time_s=TIMES_S, current_A=factor * RAMP)
    assert [run.name for run in load_measurements(paths[:2])] == ["a.npz", "b.npz"]
    with pytest.raises(InputError, match=r"a.npz: given twice; give every record once"):
        load_measurements([paths[0], paths[1], paths[0]])
    paths[2].write_bytes(paths[0].read_bytes())
    with pytest.raises(InputError, match=r"copy_of_a.npz: the same record as .*a.npz; give every record once"):
        load_measurements(paths)
