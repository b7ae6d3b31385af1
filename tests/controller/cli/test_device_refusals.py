"""`transopt-play` on a device: what it says of ports, devices and options that will not do."""

from dataclasses import replace

import pytest

from controller.cli import port as port_commands
from controller.host.transport import Listed
from controller.protocol.capacity import Hardware
from controller.servo.settings import Settings
from tests.benches.commands import Run, assert_refused
from tests.benches.desk import PORT, Desk
from tests.benches.device import reframed
from transopt.library.library import Library


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
    coil = Hardware(has_coil=True, R_ohm=2.0, R_wh_K_W=3.0, R_ha_K_W=14.0, tau_w_s=12.0, tau_h_s=600.0, limit_C=90.0)
    Desk(library, hardware=coil).put(monkeypatch)
    assert_refused(
        play("upload", "library.npz", *PORT), "motor.winding_max_C = 100 C: more than the hardware allows, up to 90 C"
    )
    Desk(library, hardware=Hardware(dt_s=2e-4)).put(monkeypatch)
    assert_refused(play("upload", "library.npz", *PORT), "servo period or lead differ", "(device saw 0.0001 s)")


def test_a_coil_that_only_the_device_knows_is_told(
    play: Run, library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ends a tap by its own estimate, while the host's prediction of heat is of no coil."""
    whole = Settings.of
    coil = Hardware(
        has_coil=True, R_ohm=2.18, R_wh_K_W=3.1, R_ha_K_W=14.0, tau_w_s=12.0, tau_h_s=612.0, limit_C=100.0
    )
    for hardware, stated, told in ((coil, True, False), (coil, False, True), (Hardware(), False, False)):
        if not stated:
            monkeypatch.setattr(Settings, "of", lambda *given, **others: replace(whole(*given, **others), coil=None))
        Desk(library, hardware=hardware).put(monkeypatch)
        outcome = play("upload", "library.npz", *PORT)
        assert outcome.code == 0, outcome.err
        said = " ".join(outcome.out.split())
        assert ("the device's own estimate cuts at 100 C (OVER_TEMPERATURE): state [motor]" in said) is told


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


def test_no_such_port(play: Run) -> None:
    for command in (("monitor",), ("check",), ("upload", "library.npz"), ("tap", "library.npz")):
        assert_refused(play(*command, "--port", "/dev/no-such-port"), "/dev/no-such-port: no such port; there ")
    outcome = play("record", "tap", "--port", "/dev/no-such-port", "--out", "x")
    assert_refused(outcome, "/dev/no-such-port: no such port; there ")


def test_ports(play: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "controller.host.transport.listed_ports", lambda: [Listed("/dev/ttyACM0", "Teensy"), Listed("COM3", "")]
    )
    assert play("ports").out.splitlines() == ["/dev/ttyACM0  Teensy", "COM3"]
    monkeypatch.setattr("controller.host.transport.listed_ports", list)
    assert "no serial port" in play("ports").out
