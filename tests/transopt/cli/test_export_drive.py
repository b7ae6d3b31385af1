"""`transopt export --drive`: files for a driver, and what they do printed beside the design."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from tests.benches.actuators import clicks
from tests.benches.commands import Run, assert_refused
from transopt.library.trade import trade_figures


@pytest.fixture
def lra(run: Run) -> Path:
    """A library of named targets in the folder of the command line."""
    path = Path("clicks.npz")
    clicks().save(path)
    return path


def cells(text: str, name: str) -> list[str]:
    """Cells of the row of an entry in a printed table."""
    (row,) = [line for line in text.splitlines() if line.startswith(f"│ {name}")]
    return [cell.strip() for cell in row.strip("│").split("│")]


def test_what_leaves_stands_beside_the_design(run: Run, lra: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    outcome = run("export", lra, "d.wav", "--drive", "--rate-Hz", 96000, "--bits", 16)
    assert outcome.code == 0
    assert "as it leaves: 96000 Hz, 16 bit, full scale 3 V" in outcome.out
    library = clicks()
    for iv, name in enumerate(("click 150 Hz", "tick, soft")):
        _, designed, leaves, _, saturated, peak_V, *_ = cells(outcome.out, name)
        assert designed == f"{100 * library.tap_error[iv, 0]:.3f}"
        assert float(leaves) == pytest.approx(float(designed), abs=2e-3)
        assert saturated == "0"
        assert float(peak_V) == pytest.approx(np.abs(library.command[iv]).max(), abs=1e-3)
    rate, samples = wavfile.read("d_click_150_Hz.wav")
    assert (rate, samples.size) == (96000, 2 * 960)
    assert outcome.out.splitlines()[-2:] == ["d_click_150_Hz.wav written", "d_tick_soft.wav written"]
    assert "multiple" not in outcome.out


def test_sounds_say_what_they_are_and_name_the_drive_which_is_one(run: Run, lra: Path, solved: Path) -> None:
    outcome = run("export", lra, "d.wav")
    assert outcome.code == 0
    wrote, said, drive = outcome.out.splitlines()
    assert wrote == "d.wav written"
    rate, samples = wavfile.read("d.wav")
    assert float(said.split()[2]) == pytest.approx(samples.size / rate, abs=0.06)
    assert "of 2 targets what was asked for" in said
    # The command that is named writes volts.
    words = drive.split("for the volts, ")[1].split()
    assert words[:2] == ["transopt", "export"]
    assert run(*words[1:]).code == 0
    library = clicks()
    _, volts = wavfile.read("d_drive_click_150_Hz.wav")
    assert np.corrcoef(volts, library.command[0, 0])[0, 1] > 0.9999
    # A library of currents says what it wrote, and has no driver's waveforms to name.
    outcome = run("export", solved / "library.npz", "s.wav")
    assert "to listen to" in outcome.out
    assert "--drive" not in outcome.out


def test_saturation_is_counted_and_said(run: Run, lra: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    outcome = run("export", lra, "d.bin", "--drive", "--full-scale", 1.5, "--target", "click 150 Hz")
    assert outcome.code == 0
    _, designed, leaves, _, saturated, peak_V, *_ = cells(outcome.out, "click 150 Hz")
    assert float(leaves) > float(designed) + 1
    assert int(saturated) > 100
    assert float(peak_V) == pytest.approx(1.5, abs=1e-3)
    assert f"{saturated} samples are beyond full scale" in outcome.out
    assert Path("d.bin").stat().st_size == 2 * 960


def test_a_rate_that_is_no_multiple_is_said_with_the_period_that_would_be(run: Run, lra: Path) -> None:
    outcome = run("export", lra, "d.npz", "--drive", "--rate-Hz", 44100)
    assert outcome.code == 0
    assert "44100 Hz is no multiple of the design's 48000 Hz" in outcome.out
    assert f"time.dt_s = {1 / 44100:.17g}" in " ".join(outcome.out.split())


def test_a_limit_that_is_left_ends_with_1(run: Run, lra: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("transopt.library.drive_replay.limits_left", lambda library, drive: ("stroke 7 mm",))
    outcome = run("export", lra, "d.csv", "--drive")
    assert outcome.code == 1
    assert "click 150 Hz: stroke 7 mm as it leaves" in outcome.out
    assert Path("d.csv").is_file()


def test_show_prints_the_figures_of_the_trade(run: Run, lra: Path) -> None:
    outcome = run("show", lra, "--table")
    assert outcome.code == 0
    _, shown = outcome.out.split("pulse and ring", 1)
    found = trade_figures(clicks(), 0, 0)
    name, _, peak, ratio, rise, duration, brake, share = cells(shown, "click 150 Hz")
    assert name == "click 150 Hz"
    wanted = [found.peak_m_s2, found.pulse_to_ring, 1e3 * found.rise_s, 1e3 * found.duration_s, 1e3 * found.brake_s]
    for text, value in zip((peak, ratio, rise, duration, brake), wanted, strict=True):
        assert float(text) == pytest.approx(value, rel=0.01, abs=0.006)
    assert float(share) == pytest.approx(100 * found.ring_share, abs=0.006)
    assert "pulse / ring: peak to peak" in " ".join(shown.split())


def test_refusals(run: Run, solved: Path, lra: Path) -> None:
    library = solved / "library.npz"
    assert_refused(run("export", library, "d.wav", "--rate-Hz", 48000), "--rate-Hz", "add --drive")
    assert_refused(run("export", library, "d.wav", "--target", "x"), "--target", "add --drive")
    assert_refused(run("export", library, "d.h", "--drive"), "leave --drive out")
    assert_refused(run("export", lra, "d.ahap"), "AHAP", "--drive")
    assert_refused(run("export", lra, "d.pwle", "--drive"), "PWLE", ".wav")
    assert_refused(run("export", lra, "d.wav", "--drive", "--bits", "12"), "'12'", "8, 16, 24, 32, float")
    assert_refused(run("export", lra, "d.wav", "--drive", "--rate-Hz", 1), "rate 1 Hz", "100 to 1e+06 Hz")
    assert_refused(run("export", lra, "d.wav", "--drive", "--full-scale", 0), "full scale 0 V", "it is 3 V")
    assert_refused(run("export", lra, "d.wav", "--drive", "--target", "clack"), "clack", "click 150 Hz, tick, soft")
    assert_refused(run("export", lra, "absent/d.wav", "--drive"), "there is no folder absent")
