"""Whole taps at the ends of what a device may be: a servo of 1 and 20 kHz, an encoder of 1 and 100 um."""

import re
from pathlib import Path

import pytest

import problems
from tests.benches.commands import Terminal

pytestmark = pytest.mark.usefixtures("c_compiler")

LATENCY = re.compile(r"latency +│ +(-?[\d.]+) µs")
ERROR = re.compile(r"playback error +│ +([\d.]+) %")


def library(terminal: Terminal, folder: Path, rate_Hz: int) -> Path:
    """The default scene, 60 ms, for a servo of that rate, at one speed and grip."""
    text = problems.scene_path("wood_on_foam").read_text(encoding="utf-8")
    for key, value in {
        "dt_s": f"{1 / rate_Hz:g}",
        "stages": f"{round(0.06 * rate_Hz)}",
        "speeds_m_s": "[0.2]",
        "grips_N": "[3.0]",
    }.items():
        text, changed = re.subn(rf"(?m)^{key} *=.*$", f"{key} = {value}", text, count=1)
        assert changed == 1, key
    scene = folder / "scene.toml"
    scene.write_text(text, encoding="utf-8")
    outcome = terminal("transopt", "solve", scene, "--out", folder / "solved", "--no-figures")
    assert outcome.code == 0, outcome.err
    return folder / "solved" / "library.npz"


# At 1 kHz a contact falls anywhere within a tick of a millisecond: what the blend of neighbouring samples makes of it
# is most of the error.
@pytest.mark.parametrize(("rate_Hz", "most_us", "most_percent"), [(1000, 150.0, 20.0), (20_000, 15.0, 1.2)])
def test_a_tap_is_played_whatever_servo_and_encoder_are(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    rate_Hz: int,
    most_us: float,
    most_percent: float,
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    terminal = Terminal(monkeypatch, capsys)
    solved = library(terminal, tmp_path, rate_Hz)
    for count_um in (1, 100):
        device = tmp_path / f"{count_um}.toml"
        assert terminal("transopt-play", "device", "new", device, "--defaults").code == 0
        text = device.read_text(encoding="utf-8")
        device.write_text(re.sub(r"(?m)^count_m *=.*$", f"count_m = {count_um}e-6", text), encoding="utf-8")
        asked = ("--simulate", "--device", device, "--speed", 0.2, "--grip", 3)
        outcome = terminal("transopt-play", "tap", solved, *asked)
        assert outcome.code == 0, outcome.err
        latency, error = LATENCY.search(outcome.out), ERROR.search(outcome.out)
        assert latency is not None
        assert error is not None
        assert abs(float(latency.group(1))) < most_us
        assert float(error.group(1)) < most_percent
