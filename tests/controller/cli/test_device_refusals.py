"""`transopt-play` on a device: what it says of ports, devices and options that will not do."""

from pathlib import Path

import pytest

from controller.cli import port as port_commands
from controller.host.payload import payload
from controller.host.transport import Listed
from controller.protocol import messages
from controller.protocol.capacity import Hardware
from controller.protocol.image import sha256
from tests.benches.commands import Run, assert_refused
from tests.benches.desk import PORT, Desk
from tests.benches.device import reframed, started
from tests.controller.host.test_driver import Served, served
from transopt.library.library import Library

__all__ = ["served"]  # a fixture
LOOKS = 50  # at a device that may be waiting for a processor


def test_a_library_that_does_not_fit(play: Run, library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    Desk(library, samples=1440).put(monkeypatch)
    assert_refused(
        play("upload", "library.npz", *PORT),
        "library: 4 speeds x 3 grips x 800 samples",
        "1440 in all",
        "a grid of 1 speeds x 1 grips or 120 samples (12 ms, or 1.5 kHz) would fit",
    )
    Desk(library, hardware=Hardware(current_A=2.0)).put(monkeypatch)
    assert_refused(
        play("upload", "library.npz", *PORT), "limits.current_A = 4 A: more than the hardware allows, up to 2 A"
    )
    Desk(library, hardware=Hardware(pole_most_Hz=900.0)).put(monkeypatch)
    assert_refused(
        play("upload", "library.npz", *PORT), "amplifier.pole_Hz = 1050 Hz: more than the hardware allows, 50 to 900"
    )
    Desk(library, hardware=Hardware(dt_s=2e-4)).put(monkeypatch)
    assert_refused(play("upload", "library.npz", *PORT), "servo period or lead differ", "(device saw 0.0001)")


def test_another_library_meanwhile(play: Run, ready: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the host believes to be in force is compared by the device itself."""
    original = port_commands.load

    def then_changed(device, given, console) -> None:
        original(device, given, console)
        hear, there = ready.end.receive, ready.end.look().library_sha256
        ready.end.receive = lambda data: hear(reframed(data, lambda sent: sent.replace(there, b"x" * 32)))

    monkeypatch.setattr(port_commands, "load", then_changed)
    assert_refused(
        play("tap", "library.npz", *PORT), "the device's library is not the one asked for: upload it again"
    )


def test_nobody_answers(play: Run, desk: Desk) -> None:
    desk.link.unplug()
    assert_refused(play("monitor", *PORT), "nothing answers on this port: is the device powered")


def test_not_our_device_and_another_version(play: Run, desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(desk.link.to_host, "arrived", lambda now_s: b"$GPGGA,1*00\r\n")
    assert_refused(play("monitor", *PORT), "not our device: it sends, but not this protocol")
    monkeypatch.undo()
    desk.put(monkeypatch)
    greeting = messages.GREETING.pack
    ours, theirs = (greeting(messages.MAGIC, messages.PROTOCOL + other) for other in (0, 1))
    say = desk.end.bytes_to_send
    monkeypatch.setattr(desk.end, "bytes_to_send", lambda: reframed(say(), lambda said: said.replace(ours, theirs)))
    assert_refused(
        play("monitor", *PORT),
        "the device speaks another version of the protocol",
        f"it speaks {messages.PROTOCOL + 1}, the host {messages.PROTOCOL}",
    )


def test_no_such_port(play: Run) -> None:
    for command in (("monitor",), ("check",), ("upload", "library.npz"), ("tap", "library.npz")):
        assert_refused(play(*command, "--port", "/dev/no-such-port"), "/dev/no-such-port: no such port; there ")
    outcome = play("record", "tap", "--port", "/dev/no-such-port", "--out", "x")
    assert_refused(outcome, "/dev/no-such-port: no such port; there ")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (PermissionError(13, "Permission denied"), "no permission: add yourself to the group dialout"),
        (BlockingIOError(11, "Resource temporarily unavailable"), "busy: another program has it open"),
    ],
)
def test_a_port_that_may_not_be_opened(
    play: Run, monkeypatch: pytest.MonkeyPatch, error: OSError, words: str
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("controller.host.transport.serial.serial_for_url", refused)
    assert_refused(play("monitor", "--port", "/dev/ttyACM0"), f"/dev/ttyACM0: {words}")


def test_ports(play: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "controller.host.transport.listed_ports", lambda: [Listed("/dev/ttyACM0", "Teensy"), Listed("COM3", "")]
    )
    assert play("ports").out.splitlines() == ["/dev/ttyACM0  Teensy", "COM3"]
    monkeypatch.setattr("controller.host.transport.listed_ports", list)
    assert "no serial port" in play("ports").out


def test_over_a_pseudo_terminal(play: Run, served: tuple[Served, str]) -> None:
    """The whole way once: pyserial, its thread, the kernel; what comes back is what went there."""
    server, name = served
    server.device = started(7, simulated=False)
    assert play("upload", "library.npz", "--port", name).code == 0
    assert server.device.look().library_sha256 == sha256(payload(Path("library.npz")).image)
    for _ in range(LOOKS):
        outcome = play("monitor", "--port", name, "--for", 0.2)
        assert outcome.code == 0
        if "+4.90 mm" in outcome.out:
            break
    else:
        pytest.fail(f"no position in any of {LOOKS} looks")
    assert_refused(play("tap", "library.npz", "--port", name), f"{name}: arm refused: no sound test pulse")
