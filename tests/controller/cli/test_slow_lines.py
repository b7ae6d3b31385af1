"""A line that does not carry every tick: what is recorded is kept on the device and sent afterwards, or refused."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from controller.cli import port as port_commands
from controller.host.driver import Device
from controller.servo.interface import Fault, Output, Readings, State
from tests.benches.commands import Outcome, Run
from tests.benches.own_device import OwnWorld, Sensing
from tests.benches.probed import ProbedDevice
from tests.benches.slow_line import SlowLine
from tests.benches.telemetry_file import read_csv
from tests.campaigns.harness import solved

pytestmark = pytest.mark.usefixtures("c_compiler")
DT_S = 1e-4
BESIDE = 500 + 1000 + 1  # ticks of a trial before and after its excitation
ARDUINO = ("-DTD_MAX_LIBRARY_SAMPLES=16384", "-DTD_MAX_SPEEDS=16", "-DTD_MAX_GRIPS=8", "-DTD_MAX_RECORDS=128")
LESS = ("-DTD_MAX_LIBRARY_SAMPLES=32768", "-DTD_MAX_SPEEDS=16", "-DTD_MAX_GRIPS=8", "-DTD_MAX_RECORDS=128")


def recorded(
    play: Run, monkeypatch: pytest.MonkeyPatch, baud: int, seconds: float, flags: tuple[str, ...] = ()
) -> Outcome:
    world = OwnWorld(DT_S)
    line = SlowLine(ProbedDevice(1, flags=flags, simulated=True), world, DT_S, baud)
    monkeypatch.setattr(port_commands, "open_device", line.connect)
    monkeypatch.setattr(port_commands, "ConsolePerson", lambda: world)
    options = ("--low", 50, "--high", 500, "--amplitude", 0.3, "--trials", 1, "--seconds", seconds)
    return play("record", "sweep", "--port", "x", "--out", "rec", *options)


def need_whole(name: str, seconds: float) -> None:
    with np.load(Path("rec") / name) as trial:
        assert trial["time_s"].size == round(seconds / DT_S) + BESIDE
        assert np.abs(np.diff(trial["time_s"]) - DT_S).max() < 1e-12


def test_what_the_line_does_not_carry_is_kept_and_comes_afterwards(
    play: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The device has room for some 16 000 records; 115 200 baud carry 340 of 10 000 a second."""
    outcome = recorded(play, monkeypatch, 115_200, 0.2)
    assert outcome.code == 0, outcome.out + outcome.err
    assert "not whole" not in outcome.out
    need_whole("sweep_001.npz", 0.2)


def test_what_is_not_kept_is_refused_with_a_rate_and_with_a_sweep_that_is(
    play: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A device with twice the room of the port for an Arduino board that is no Teensy."""
    refused = recorded(play, monkeypatch, 921_600, 0.2, LESS)
    assert refused.code == 1
    assert "3 attempts at a trial, none whole" in refused.out
    assert "as PORT@4000000" in refused.out
    said = re.search(r"this line carried (\d+) kB/s: .*; a sweep of --seconds ([\d.]+) is kept", refused.out)
    assert said is not None, refused.out
    assert float(said[1]) == pytest.approx(92, rel=0.15)
    assert not list(Path("rec").iterdir())
    seconds = float(said[2])
    outcome = recorded(play, monkeypatch, 921_600, seconds, LESS)
    assert outcome.code == 0, outcome.out + outcome.err
    need_whole("sweep_001.npz", seconds)
    outcome = recorded(play, monkeypatch, 4_000_000, 0.2, LESS)
    assert outcome.code == 0, outcome.out + outcome.err
    need_whole("sweep_002.npz", 0.2)


def test_a_check_at_115200_baud_passes_every_step(play: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """The device has as little room as an Arduino board."""
    world = OwnWorld(DT_S, sensing=Sensing(gravity_m_s2=0.0))
    line = SlowLine(ProbedDevice(1, flags=ARDUINO, simulated=False), world, DT_S, 115_200)
    monkeypatch.setattr(port_commands, "open_device", line.connect)
    monkeypatch.setattr(port_commands, "ConsolePerson", lambda: world)
    outcome = play("check", "library.npz", "--port", "x")
    assert outcome.code == 0, outcome.out + outcome.err
    assert "times its prediction" in outcome.out


class Tapping(OwnWorld):
    """Taps again and again while the device is armed.

    Attributes
    ----------
    seen : tick -> what the sensors read in it. free_s : when the next tap may begin. fault_after_s : the emergency
        stop is pressed so long after a tap's beginning.
    """

    def __init__(self, fault_after_s: float = float("inf")) -> None:
        super().__init__(DT_S, sensing=Sensing(gravity_m_s2=0.0))
        self.seen: dict[int, Readings] = {}
        self.free_s, self.fault_after_s = 0.0, fault_after_s

    def readings(self, tick: int) -> Readings:
        self.seen[tick] = super().readings(tick)
        return self.seen[tick]

    def advance(self, output: Output) -> None:
        if output.state is State.ARMED and self.now_s >= self.free_s:
            self.person.tap(0.2)
            self.free_s = self.now_s + 1.8
            self.person.later(self.fault_after_s, lambda: setattr(self, "pressed", True))
        super().advance(output)


def at_line(monkeypatch: pytest.MonkeyPatch, world: OwnWorld, baud: int, flags: tuple[str, ...] = ()) -> None:
    line = SlowLine(ProbedDevice(1, flags=flags, simulated=True), world, DT_S, baud)
    monkeypatch.setattr(port_commands, "open_device", line.connect)
    monkeypatch.setattr(port_commands, "ConsolePerson", lambda: world)


TAP = ("tap", "library.npz", "--port", "x", "--out", "taps", "--taps")


def test_taps_at_115200_baud_are_recorded_whole(play: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every tick around each tap, as the sensors have read it; a device with little room keeps less around it."""
    count, before, after = 2, 345, 575  # in place of 600 and 1000 ticks
    world, awaited, catch_up = Tapping(), [], Device.catch_up

    def wait(device: Device, newest: Callable[[], int], tick: int) -> None:
        awaited.append(tick)
        catch_up(device, newest, tick)

    monkeypatch.setattr(Device, "catch_up", wait)
    at_line(monkeypatch, world, 115_200, ARDUINO)
    outcome = play(*TAP, count)
    assert outcome.code == 0, outcome.out + outcome.err
    assert outcome.out.count("armed: tap once") == count
    table = read_csv(Path("taps") / "telemetry.csv")
    assert len(awaited) == count
    for name, last in zip(("tap_001.csv", "tap_002.csv"), awaited, strict=False):
        head, *_ = (Path("taps") / name).read_text().splitlines()
        contact = int(head.rpartition(" ")[2])
        assert last == contact + after, "another telemetry is asked for before the last record has come"
        times_s, _, position_m, _ = np.loadtxt(Path("taps") / name, delimiter=",", skiprows=4).T
        assert np.round(times_s / DT_S).tolist() == list(range(-before, after + 1))
        ticks = contact + np.arange(-before, after + 1)
        counts = [world.seen[tick].encoder_counts for tick in ticks]
        assert position_m == pytest.approx(np.array(counts) * world.sensing.count_m, abs=1e-7)
        felt = table["measured_acceleration_m_s2"][np.isin(table["tick"], ticks)]
        assert felt == pytest.approx([world.seen[tick].acceleration_m_s2 for tick in ticks], rel=1e-6)


@pytest.mark.parametrize("after_s", [0.3, 0.65, 2.0], ids=["before", "while playing", "while sending"])
def test_a_stop_ends_the_run(play: Run, monkeypatch: pytest.MonkeyPatch, after_s: float) -> None:
    at_line(monkeypatch, Tapping(fault_after_s=after_s), 230_400)
    outcome = play(*TAP, 2)
    assert outcome.code == 1
    assert f"fault: {Fault.EMERGENCY_STOP.value}" in " ".join(outcome.out.split())
    assert outcome.out.count("armed: tap once") == 1


def test_a_hand_that_does_not_rest_is_asked_to(play: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    world = Tapping()
    at_line(monkeypatch, world, 921_600)
    world.path_m = lambda t: 20e-3 + (5e-3 * np.sin(30 * t) if t < 3.0 else 0.0)
    outcome = play(*TAP, 1)
    assert outcome.code == 0, outcome.out + outcome.err
    assert outcome.out.count("hold the stylus above the surface, still") == 1


def test_a_line_too_slow_for_taps_is_refused_before_anything_is_armed(
    play: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = Tapping()
    at_line(monkeypatch, world, 19_200)
    outcome = play(*TAP, 1)
    assert outcome.code == 2
    assert "slow line: too slow to tap over it: every tick takes 340 kB/s" in outcome.err
    assert "PORT@4000000" in outcome.err
    assert world.free_s == 0.0


def test_a_library_is_refined_over_a_slow_line(play: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    solved("wood_on_foam", {"grid.speeds_m_s": [0.2], "grid.grips_N": [3.0]}).save(Path("one.npz"))
    at_line(monkeypatch, Tapping(), 921_600)
    outcome = play("refine", "one.npz", "--port", "x", "--taps", 3, "--rounds", 1, "--out", "refined")
    assert "of the records: the device keeps each tap" in " ".join(outcome.out.split())
    assert "records were lost" not in outcome.out, outcome.out
    assert outcome.out.count("counts for 0.2 m/s at 3 N") >= 3
    assert (Path("refined") / "library.npz").exists(), outcome.out + outcome.err
