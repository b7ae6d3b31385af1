"""`transopt-play doctor` with ports that are not there, and lines that are too slow for telemetry."""

import os
from pathlib import Path

import pytest

from controller.cli import doctor as module
from controller.cli import port as port_commands
from controller.firmware.build import NoCompilerError
from controller.host.rates import BAUDS, remedy
from controller.host.transport import Listed
from tests.benches.commands import Run
from tests.benches.desk import PORT, Desk
from tests.benches.own_device import OwnWorld
from tests.benches.probed import ProbedDevice
from tests.benches.slow_line import SlowLine
from transopt.base.errors import InputError

DT_S = 1e-4


@pytest.fixture
def ports(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Listed]:
    """Ports to be filled in; adapters keep their timers in `usb`."""
    found: list[Listed] = []
    monkeypatch.setattr("controller.host.transport.listed_ports", lambda: found)
    monkeypatch.setattr(module, "USB_SERIAL", tmp_path / "usb")
    return found


def lines(out: str, start: str) -> list[str]:
    return [line for line in out.splitlines() if line.startswith(start)]


def test_a_sound_desk(play: Run, ports: list[Listed], desk: Desk) -> None:
    ports.append(Listed("/dev/null", "Teensy"))
    outcome = play("doctor", *PORT)
    assert outcome.code == 0, outcome.out
    assert lines(outcome.out, "/dev/null") == ["/dev/null Teensy: may be opened"]
    assert lines(outcome.out, "device: desk: firmware")
    assert lines(outcome.out, "line") == ["line: 100 % of the records of every tick"]
    for line in outcome.out.splitlines():
        assert ": " in line


def test_no_port_at_all(play: Run, ports: list[Listed]) -> None:
    outcome = play("doctor")
    assert outcome.code == 1
    assert lines(outcome.out, "ports") == ["ports: none: plug the device in; a cable for charging has no data lines"]
    assert lines(outcome.out, "no port was asked")


def test_no_port_beside_a_socket(play: Run, ports: list[Listed], desk: Desk) -> None:
    outcome = play("doctor", *PORT)
    assert outcome.code == 0, outcome.out
    assert lines(outcome.out, "ports") == ["ports: none"]


def test_a_port_that_may_not_be_opened_says_both_ways_out(
    play: Run, ports: list[Listed], monkeypatch: pytest.MonkeyPatch
) -> None:
    ports += [Listed("/dev/null", "Teensy", 0x16C0), Listed("COM3", "USB Serial")]
    monkeypatch.setattr(os, "access", lambda *_: False)
    outcome = play("doctor")
    assert outcome.code == 1
    (line,) = lines(outcome.out, "/dev/null")
    assert line.startswith("/dev/null Teensy: may not be opened: sudo usermod -aG dialout $USER")
    assert 'ATTRS{idVendor}=="16c0", TAG+="uaccess"' in line
    # A name that is no file has no permissions.
    assert lines(outcome.out, "COM3") == ["COM3 USB Serial: may be opened"]


@pytest.mark.parametrize(("held_ms", "code"), [("16", 1), ("1", 0)])
def test_an_adapter_that_keeps_bytes_back(play: Run, ports: list[Listed], held_ms: str, code: int) -> None:
    ports.append(Listed("/dev/ttyUSB7", "FT232R"))
    timer = module.USB_SERIAL / "ttyUSB7" / "latency_timer"
    timer.parent.mkdir(parents=True)
    timer.write_text(f"{held_ms}\n")
    outcome = play("doctor")
    assert outcome.code == code
    (line,) = lines(outcome.out, "/dev/ttyUSB7 adapter")
    assert f"{held_ms} ms" in line
    assert (f"echo 1 | sudo tee {timer}" in line) == bool(code)


def test_what_is_missing_and_what_does_not_answer(
    play: Run, ports: list[Listed], monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(*_: object, **__: object) -> None:
        raise NoCompilerError("no C compiler: install gcc")

    def silent(port: object) -> None:
        raise InputError(f"{port}: no device of ours answers")

    monkeypatch.setattr("controller.firmware.core_device.CoreDevice", missing)
    monkeypatch.setattr(port_commands, "open_device", silent)
    outcome = play("doctor", "--port", "/dev/ttyACM0")
    assert outcome.code == 1
    assert lines(outcome.out, "device core") == [
        "device core: missing: no C compiler: install gcc; only --simulate needs it"
    ]
    assert lines(outcome.out, "device: ") == ["device: does not answer: /dev/ttyACM0: no device of ours answers"]


@pytest.mark.parametrize("baud", [115_200, 4_000_000])
def test_a_line_is_told_by_what_it_carries(
    play: Run, ports: list[Listed], monkeypatch: pytest.MonkeyPatch, baud: int
) -> None:
    """Behind an adapter of 16 ms; 3.7 Mbaud carry every tick of 100 us."""
    ports.append(Listed("/dev/null", ""))
    line = SlowLine(ProbedDevice(1, simulated=False), OwnWorld(DT_S), DT_S, baud)
    monkeypatch.setattr(port_commands, "open_device", line.connect)
    outcome = play("doctor", "--port", "x")
    (said,) = lines(outcome.out, "line")
    assert outcome.code == (baud < 4_000_000)
    assert ("PORT@4000000" in said) == (baud < 4_000_000)
    if outcome.code:
        carried = float(said.split()[1]) / 100
        assert carried == pytest.approx(baud / 3.6e6, rel=0.1)


@pytest.mark.parametrize(("baud", "code"), [(38_400, 1), (115_200, 0), (4_000_000, 0)])
def test_the_check_looks_at_as_many_records_as_its_line_carries(
    play: Run, monkeypatch: pytest.MonkeyPatch, baud: int, code: int
) -> None:
    world = OwnWorld(DT_S)
    line = SlowLine(ProbedDevice(1, simulated=False), world, DT_S, baud)
    monkeypatch.setattr(port_commands, "open_device", line.connect)
    monkeypatch.setattr(port_commands, "ConsolePerson", lambda: world)
    outcome = play("check", "--port", "x", "--step", "link")
    assert outcome.code == code
    assert ("every tick takes 340 kB/s, this line carried" in outcome.out) == (baud < 4_000_000)
    assert ("a tap is sent afterwards" in outcome.out) == (code == 0 and baud < 4_000_000)


def test_the_remedy_is_a_rate_that_carries_it() -> None:
    for dt_s in (1e-3, 1e-4, 5e-5):
        words = remedy(dt_s, 0.1)
        named = [baud for baud in BAUDS if f"@{baud}" in words]
        assert named
        assert named[0] > 34 * 10 / dt_s
