"""`record sweep` over a line that does not carry every tick: kept on the device and sent afterwards, or refused."""

import re
from pathlib import Path

import numpy as np
import pytest

from controller.cli import port as port_commands
from controller.firmware.core_device import CoreDevice
from tests.benches.commands import Outcome, Run
from tests.benches.own_device import OwnWorld, Sensing
from tests.benches.slow_line import SlowLine

pytestmark = pytest.mark.usefixtures("c_compiler")
DT_S = 1e-4
BESIDE = 500 + 1000 + 1  # ticks of a trial before and after its excitation
ARDUINO = ("-DTD_MAX_LIBRARY_SAMPLES=16384", "-DTD_MAX_SPEEDS=16", "-DTD_MAX_GRIPS=8", "-DTD_MAX_RECORDS=128")
LESS = ("-DTD_MAX_LIBRARY_SAMPLES=32768", "-DTD_MAX_SPEEDS=16", "-DTD_MAX_GRIPS=8", "-DTD_MAX_RECORDS=128")


def recorded(
    play: Run, monkeypatch: pytest.MonkeyPatch, baud: int, seconds: float, flags: tuple[str, ...] = ()
) -> Outcome:
    world = OwnWorld(DT_S)
    line = SlowLine(CoreDevice(1, flags=flags, simulated=True), world, DT_S, baud)
    monkeypatch.setattr(port_commands, "open_device", line.connect)
    monkeypatch.setattr(port_commands, "ConsolePerson", lambda: world)
    options = ("--low", 50, "--high", 500, "--amplitude", 0.3, "--trials", 1, "--seconds", seconds)
    return play("record", "sweep", "--port", "x", "--out", "rec", *options)


def need_whole(name: str, seconds: float) -> None:
    with np.load(Path("rec") / name) as trial:
        assert trial["time_s"].size == round(seconds / DT_S) + BESIDE
        assert np.abs(np.diff(trial["time_s"]) - DT_S).max() < 1e-12


@pytest.mark.parametrize(("baud", "seconds"), [(115_200, 0.5), (921_600, 0.5), (2_000_000, 2.0)])
def test_what_the_line_does_not_carry_is_kept_and_comes_afterwards(
    play: Run, monkeypatch: pytest.MonkeyPatch, baud: int, seconds: float
) -> None:
    """The device has room for some 16 000 records; 115 200 baud carry 340 of 10 000 a second."""
    outcome = recorded(play, monkeypatch, baud, seconds)
    assert outcome.code == 0, outcome.out + outcome.err
    assert "not whole" not in outcome.out
    need_whole("sweep_001.npz", seconds)


@pytest.mark.parametrize(("baud", "kB_s"), [(460_800, 46), (921_600, 92)])
def test_what_is_not_kept_is_refused_with_a_rate_and_with_a_sweep_that_is(
    play: Run, monkeypatch: pytest.MonkeyPatch, baud: int, kB_s: int
) -> None:
    """A device with twice the room of the port for an Arduino board that is no Teensy."""
    refused = recorded(play, monkeypatch, baud, 0.2, LESS)
    assert refused.code == 1
    assert "3 attempts at a trial, none whole" in refused.out
    assert "as PORT@4000000" in refused.out
    said = re.search(r"this line carried (\d+) kB/s: .*; a sweep of --seconds ([\d.]+) is kept", refused.out)
    assert said is not None, refused.out
    assert float(said[1]) == pytest.approx(kB_s, rel=0.15)
    assert not list(Path("rec").iterdir())
    seconds = float(said[2])
    outcome = recorded(play, monkeypatch, baud, seconds, LESS)
    assert outcome.code == 0, outcome.out + outcome.err
    need_whole("sweep_001.npz", seconds)
    outcome = recorded(play, monkeypatch, 4_000_000, 0.2, LESS)
    assert outcome.code == 0, outcome.out + outcome.err
    need_whole("sweep_002.npz", 0.2)


@pytest.mark.parametrize("flags", [(), ARDUINO], ids=["much room", "as little as on an Arduino board"])
def test_a_check_at_115200_baud_passes_every_step(
    play: Run, monkeypatch: pytest.MonkeyPatch, flags: tuple[str, ...]
) -> None:
    world = OwnWorld(DT_S, sensing=Sensing(gravity_m_s2=0.0))
    line = SlowLine(CoreDevice(1, flags=flags, simulated=False), world, DT_S, 115_200)
    monkeypatch.setattr(port_commands, "open_device", line.connect)
    monkeypatch.setattr(port_commands, "ConsolePerson", lambda: world)
    outcome = play("check", "library.npz", "--port", "x")
    assert outcome.code == 0, outcome.out + outcome.err
    assert "times its prediction" in outcome.out
