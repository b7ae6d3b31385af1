"""`transopt-play` on a device: what is printed, written and returned, whatever goes wrong on the way."""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from controller import messages, port_commands
from controller.cli import main
from controller.image import sha256
from controller.interface import Fault, State
from controller.limits import Capacity, Hardware
from controller.link import Trouble
from controller.payload import payload
from controller.prediction import scene_of
from controller.telemetry import read_csv
from tests.desk import Desk
from tests.test_cli import Outcome, assert_refused
from tests.test_driver import Served, served
from transopt.importers import load_recording
from transopt.library import Library
from transopt.preparation import prepare

PORT = ("--port", "desk")
__all__ = ["served"]  # a fixture


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, library: Library):
    """Run `transopt-play ARGS` in a folder that holds library.npz, with a home of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    library.save(tmp_path / "library.npz")

    def call(*arguments: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["transopt-play", *map(str, arguments)])
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        captured = capsys.readouterr()
        return Outcome(code, captured.out, captured.err)

    return call


@pytest.fixture
def desk(library: Library, monkeypatch: pytest.MonkeyPatch) -> Desk:
    return Desk(library).put(monkeypatch)


@pytest.fixture
def ready(run, desk: Desk) -> Iterator[Desk]:
    """With the library, its check taken for passed."""
    assert run("upload", "library.npz", *PORT).code == 0
    desk.firmware.checked_sha256 = desk.firmware.store.configuration_sha256
    yield desk
    # Whatever happened, nothing is left armed once the lease is over.
    for _ in range(2500):
        if desk.firmware.state in (State.IDLE, State.FAULT):
            break
        desk.step()
    assert desk.firmware.state in (State.IDLE, State.FAULT)


def tapping(desk: Desk, speed_m_s: float = 0.2) -> None:
    """The hand taps as soon as the device is armed."""

    def look() -> None:
        if desk.firmware.state is State.ARMED:
            desk.each_ms = lambda: None
            desk.hand.tap(desk.now_s + 0.05, speed_m_s)

    desk.each_ms = look


def when(desk: Desk, state: State, act) -> None:
    def look() -> None:
        if desk.firmware.state is state:
            desk.each_ms = lambda: None
            act()

    desk.each_ms = look


def test_check_then_tap_quietly_then_in_full(run, desk: Desk) -> None:
    """A device's first quarter of an hour."""
    refused = run("tap", "library.npz", *PORT, "--out", "taps")
    assert_refused(refused, "arm refused: this configuration has not passed the bring-up check", "run `check`")
    assert not list(Path("taps").iterdir())
    checked = run("check", "library.npz", *PORT)
    assert checked.code == 0, checked.out + checked.err
    assert "please press the emergency stop" not in checked.out  # the desk's ear, not the console's
    for step in ("link", "emergency-stop", "encoder", "accelerometer", "grip-zero", "current-offset", "polarity"):
        assert f"{step}: passed: " in checked.out
    assert "passed: this configuration may be armed until the device starts anew" in checked.out
    desk.hand.held_N = 3.0
    tapping(desk)
    first = run("tap", "library.npz", *PORT, "--taps", 1)
    assert first.code == 0, first.out + first.err
    assert "gain 0.1" in first.out
    assert "has this library already" in first.out
    tapping(desk)
    second = run("tap", "library.npz", *PORT, "--taps", 1, "--out", "taps")
    assert second.code == 0, second.out + second.err
    assert "gain 1\n" in second.out.replace("gain 1 ", "gain 1\n")
    # One tap at 0.2 m/s: its figures stand in the table's row.
    [row] = [line.split("│") for line in second.out.splitlines() if line.startswith("│   1 ")]
    speed, grip, latency_us, error = (float(cell) for cell in row[2:6])
    assert speed == pytest.approx(0.2, abs=0.01)
    assert grip == pytest.approx(3.0, abs=0.2)
    assert abs(latency_us) <= 20
    assert error <= 3
    assert "taps: telemetry.csv, events.csv, tap_001.csv, all whole" in second.out
    recording = load_recording(Path("taps/tap_001.csv"))
    assert recording.speed_m_s == pytest.approx(0.2, abs=0.01)
    assert recording.grip_N == pytest.approx(3.0, abs=0.2)
    assert recording.current is not None
    assert float(abs(recording.current.values).max()) > 1.0
    telemetry = read_csv(Path("taps/telemetry.csv"))
    assert set(telemetry["state"]) >= {"armed", "playing"}
    assert (telemetry["tick"][1:] - telemetry["tick"][:-1] == 1).all()
    assert "contact" in Path("taps/events.csv").read_text()
    # A device that has been off begins again from the start.
    desk.restart()
    assert_refused(run("tap", "library.npz", *PORT, "--gain", 1), "has not passed the bring-up check")


def test_a_failed_check_is_no_pass(run, desk: Desk) -> None:
    desk.wrong = lambda readings: replace(readings, acceleration_m_s2=-readings.acceleration_m_s2)
    outcome = run("check", "library.npz", *PORT, "--skip", "encoder", "--skip", "emergency-stop", "--patience", 0.4)
    assert outcome.code == 1
    assert "accelerometer: FAILED: -" in outcome.out
    assert "polarity: -: left out: a step before it has failed" in outcome.out
    assert "until then the device does not arm" in outcome.out
    assert desk.firmware.checked_sha256 == bytes(32)


def test_check_of_the_sensors_alone(run, desk: Desk) -> None:
    outcome = run("check", *PORT, "--skip", "encoder", "--skip", "emergency-stop")
    assert outcome.code == 0, outcome.out
    assert "give a library for the rest of the check" in outcome.out
    assert desk.firmware.servo is None


def test_upload_once(run, desk: Desk) -> None:
    assert "uploaded" in run("upload", "library.npz", *PORT).out
    assert "the device has this library already" in run("upload", "library.npz", *PORT).out
    assert desk.closed == 2


def test_monitor(run, ready: Desk) -> None:
    outcome = run("monitor", *PORT, "--for", 0.2)
    assert outcome.code == 0
    assert "firmware 1.0.0 (double), boot 000001f4, period 100 us, limits 10 A and 10 A, configuration" in outcome.out
    for words in ("state", "idle", "z", "+12.0", "grip", "emergency stop", "released", "records lost"):
        assert words in outcome.out


def test_monitor_tells_events(run, ready: Desk) -> None:
    """What comes while it looks, line by line; what was before, as the state."""
    ready.each_ms = lambda: ready.asked("press") if ready.now_s > began_s + 0.15 and not ready.hand.pressed else None
    began_s = ready.now_s
    first, second = run("monitor", *PORT, "--for", 0.3), run("monitor", *PORT, "--for", 0.1)
    assert " s  FAULT: emergency stop: release it, then reset" in first.out
    for outcome in (first, second):
        assert "fault: emergency stop: release it, then reset" in outcome.out
        assert "pressed" in outcome.out


def test_recording_a_real_object(run, library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    target = scene_of(library).recordings.simulated
    desk = Desk(library, target=target).put(monkeypatch)
    desk.asked("hold")
    begun = iter([True])

    def look() -> None:
        if desk.now_s > 0.2 and next(begun, False):
            desk.hand.tap(desk.now_s, 0.2)

    desk.each_ms = look
    outcome = run("record", "tap", *PORT, "--out", "real", "--taps", 1, "--for", 3)
    assert outcome.code == 0, outcome.out + outcome.err
    assert "real: telemetry.csv, events.csv, tap_001.csv, all whole" in outcome.out
    recording = load_recording(Path("real/tap_001.csv"))
    assert recording.speed_m_s is None
    assert recording.grip_N == pytest.approx(3.0, abs=0.2)
    tap = prepare(recording, scene_of(library).recordings)
    assert tap.speed_m_s == pytest.approx(0.2, rel=0.03)
    assert tap.offset_m_s2 == pytest.approx(9.81, abs=0.5)
    assert desk.firmware.servo is None
    # Recordings are never written over.
    assert_refused(run("record", "tap", *PORT, "--out", "real"), "--out real: holds a recording already", "choose")
    assert_refused(run("tap", "library.npz", *PORT, "--out", "real"), "--out real: holds a recording already")


def test_nothing_recorded_is_exit_code_1(run, desk: Desk) -> None:
    assert run("record", "tap", *PORT, "--out", "nothing", "--for", 0.1).code == 1


def interrupt() -> None:
    raise KeyboardInterrupt


def test_ctrl_c_while_armed_disarms_and_tells_what_came(run, ready: Desk) -> None:
    ready.hand.tap(ready.now_s + 0.4, 0.3)
    count = iter(range(10_000))
    ready.each_ms = lambda: interrupt() if next(count) == 900 else None
    outcome = run("tap", "library.npz", *PORT, "--out", "cut")
    assert outcome.code == 130, outcome.out + outcome.err
    assert outcome.err.strip() == "stopped; the device is disarmed"
    assert (ready.firmware.state, ready.firmware.fault) == (State.IDLE, None)
    assert "cut: telemetry.csv, events.csv, tap_001.csv, all whole" in outcome.out
    assert load_recording(Path("cut/tap_001.csv")).grip_N == pytest.approx(3.0, abs=0.2)
    assert read_csv(Path("cut/telemetry.csv"))["tick"].size > 5000


def test_ctrl_c_at_rest_stops_nothing(run, ready: Desk) -> None:
    count = iter(range(10_000))
    ready.each_ms = lambda: interrupt() if next(count) == 100 else None
    outcome = run("monitor", *PORT)
    assert (outcome.code, outcome.err.strip()) == (130, "stopped; nothing is left armed")
    assert (ready.firmware.state, ready.firmware.fault) == (State.IDLE, None)


def test_ctrl_c_during_the_trial_tap_disarms(run, desk: Desk) -> None:
    desk.obeys["tap"] = interrupt
    skipped = [word for name in ("encoder", "emergency-stop", "grip-zero") for word in ("--skip", name)]
    outcome = run("check", "library.npz", *PORT, *skipped)
    assert outcome.code == 130
    assert (desk.firmware.state, desk.firmware.fault) == (State.IDLE, None)
    assert desk.firmware.checked_sha256 == bytes(32)


def test_another_ctrl_c_meanwhile_is_an_emergency_stop(run, ready: Desk) -> None:
    def again() -> None:
        ready.each_ms = lambda: None
        interrupt()

    def first() -> None:
        # The answer to DISARM does not come, so that there is time for impatience.
        ready.link.to_host.trouble = Trouble(loss=1.0)
        ready.each_ms = again
        interrupt()

    when(ready, State.ARMED, first)
    outcome = run("tap", "library.npz", *PORT)
    assert outcome.code == 130, outcome.err
    assert outcome.err.strip() == "stopped; nothing is left armed"
    assert ready.firmware.fault is Fault.EMERGENCY_STOP


@pytest.mark.parametrize("how", ["unplugged", "silent", "restarted"])
def test_a_device_that_goes_away_is_one_line_and_the_files_are_whole(run, ready: Desk, how: str) -> None:
    def away() -> None:
        if how == "unplugged":
            ready.gone = True
        elif how == "silent":
            ready.link.unplug()
        else:
            ready.restart()

    ready.hand.tap(ready.now_s + 0.4, 0.2)
    count = iter(range(10_000))
    ready.each_ms = lambda: away() if next(count) == 800 else None
    outcome = run("tap", "library.npz", *PORT, "--out", "cut")
    assert_refused(outcome, "it does not arm by itself", "cut: telemetry.csv, events.csv, tap_001.csv, all whole")
    assert load_recording(Path("cut/tap_001.csv")).speed_m_s == pytest.approx(0.2, abs=0.01)
    assert read_csv(Path("cut/telemetry.csv"))["tick"].size > 4000
    ready.gone = False


def test_a_fault_ends_the_run_and_the_next_one_asks_for_its_reset(run, ready: Desk) -> None:
    when(ready, State.ARMED, lambda: ready.asked("press"))
    outcome = run("tap", "library.npz", *PORT)
    assert outcome.code == 1
    assert "fault: emergency stop: release it, then reset" in outcome.out
    for command in (("tap", "library.npz"), ("upload", "library.npz"), ("check",)):
        assert_refused(run(*command, *PORT), "a fault is latched: emergency stop: release it, then reset", "--reset")
    assert_refused(run("upload", "library.npz", *PORT, "--reset"), "the cause of the fault is still there")
    ready.asked("release")
    assert run("upload", "library.npz", *PORT, "--reset").code == 0
    assert ready.firmware.state is State.IDLE


def test_arm_refused_in_words(run, ready: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    ready.hand.go(ready.now_s, (0.02, 0.1), (5.0, 0.1), (0.02, 0.0))
    for _ in range(300):
        ready.step()
    assert_refused(run("tap", "library.npz", *PORT), "the stylus is moving: hold it still, then arm (device saw -0.")
    monkeypatch.setattr(type(ready.firmware.servo.guard), "play_limit_C", 20.0, raising=False)
    ready.firmware.servo.guard.play_limit_C = 20.0
    assert_refused(run("tap", "library.npz", *PORT), "the coil is too hot to play: let it cool (device saw 25")


def test_a_library_that_does_not_fit(run, library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    Desk(library, capacity=Capacity(samples=3000)).put(monkeypatch)
    assert_refused(
        run("upload", "library.npz", *PORT),
        "library: 4 speeds x 3 grips x 600 samples",
        "3000 in all",
        "a grid of 2 speeds x 1 grips or 250 samples (25 ms, or 4.17 kHz) would fit",
    )
    Desk(library, hardware=Hardware(current_A=2.0)).put(monkeypatch)
    assert_refused(run("upload", "library.npz", *PORT), "more than the device's hardware allows (device saw 4)")
    Desk(library, hardware=Hardware(dt_s=2e-4)).put(monkeypatch)
    assert_refused(run("upload", "library.npz", *PORT), "servo period or lead differ", "(device saw 0.0001)")


def test_another_library_meanwhile(run, ready: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the host believes to be in force is compared by the device itself."""
    original = port_commands._load

    def then_changed(device, given) -> None:
        original(device, given)
        ready.firmware.store.library_sha256 = b"x" * 32

    monkeypatch.setattr(port_commands, "_load", then_changed)
    assert_refused(run("tap", "library.npz", *PORT), "the device's library is not the one asked for: upload it again")


def test_nobody_answers(run, desk: Desk) -> None:
    desk.link.unplug()
    assert_refused(run("monitor", *PORT), "nothing answers on this port: is the device powered")


def test_not_our_device_and_another_version(run, desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(desk.link.to_host, "arrived", lambda now_s: b"$GPGGA,1*00\r\n")
    assert_refused(run("monitor", *PORT), "not our device: it sends, but not this protocol")
    monkeypatch.undo()
    desk.put(monkeypatch)
    hello_reply = desk.firmware._hello_reply
    monkeypatch.setattr(
        desk.firmware, "_hello_reply", lambda nonce: replace(hello_reply(nonce), protocol=messages.PROTOCOL + 1)
    )
    assert_refused(
        run("monitor", *PORT),
        "the device speaks another version of the protocol",
        f"it speaks {messages.PROTOCOL + 1}, the host {messages.PROTOCOL}",
    )


def test_no_such_port(run) -> None:
    for command in (("monitor",), ("check",), ("upload", "library.npz"), ("tap", "library.npz")):
        assert_refused(run(*command, "--port", "/dev/no-such-port"), "/dev/no-such-port: no such port; there ")
    outcome = run("record", "tap", "--port", "/dev/no-such-port", "--out", "x")
    assert_refused(outcome, "/dev/no-such-port: no such port; there ")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (PermissionError(13, "Permission denied"), "no permission: add yourself to the group dialout"),
        (BlockingIOError(11, "Resource temporarily unavailable"), "busy: another program has it open"),
    ],
)
def test_a_port_that_may_not_be_opened(run, monkeypatch: pytest.MonkeyPatch, error: OSError, words: str) -> None:
    def refused(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("controller.transport.serial.serial_for_url", refused)
    assert_refused(run("monitor", "--port", "/dev/ttyACM0"), f"/dev/ttyACM0: {words}")


def test_ports(run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("controller.transport.port_names", lambda: [("/dev/ttyACM0", "Teensy"), ("COM3", "")])
    assert run("ports").out.splitlines() == ["/dev/ttyACM0  Teensy", "COM3"]
    monkeypatch.setattr("controller.transport.port_names", list)
    assert "no serial port" in run("ports").out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("tap", "library.npz"), "tap: name one device: --simulate, or --port PORT"),
        (("tap", "library.npz", "--simulate", *PORT), "tap: name one device"),
        (("tap", "library.npz", *PORT, "--speed", 0.2), "--speed: on a device that is up to its user"),
        (("tap", "library.npz", *PORT, "--real-time"), "--real-time: "),
        (("tap", "library.npz", "--simulate", "--taps", 2), "--taps: only with --port"),
        (("tap", "library.npz", "--simulate", "--for", 2), "--for: only with --port"),
        (("tap", "library.npz", *PORT, "--gain", 1.5), "--gain 1.5: must be 0 to 1"),
        (("tap", "library.npz", *PORT, "--taps", 0), "--taps 0: must be 1 to "),
        (("tap", "library.npz", *PORT, "--accelerometer-hz", 0), "--accelerometer-hz 0: must be 10 to "),
        (("tap", "missing.npz", *PORT), "missing.npz"),
        (("monitor", *PORT, "--every", 0), "--every 0: must be 1 to 65535 ticks"),
        (("monitor", *PORT, "--for", -1), "--for -1: must be "),
        (("check", *PORT, "--skip", "polarity"), "--skip polarity: must be one of emergency-stop"),
        (("check", *PORT, "--rest-g", 2), "--rest-g 2: must be -1 to 1 g"),
        (("check", *PORT, "--patience", 0), "--patience 0: must be "),
        (("record", "tap", *PORT, "--out", "x", "--trigger", 0), "--trigger 0: must be "),
        (("record", "tap", *PORT, "--out", "x", "--count-um", 0), "--count-um 0: must be "),
        (("record", "tap", *PORT, "--out", "/proc/x"), "--out /proc/x: cannot be written"),
        (("tap", "library.npz", *PORT, "--out", "/proc/x"), "--out /proc/x: cannot be written"),
    ],
)
def test_bad_options_reach_no_device(run, desk: Desk, arguments: tuple[object, ...], words: str) -> None:
    assert_refused(run(*arguments), words)
    assert desk.ticks == 0


def test_over_a_pseudo_terminal(run, served: tuple[Served, str]) -> None:
    """The whole way once: pyserial, its thread, the kernel; what comes back is what went there."""
    server, name = served
    assert run("upload", "library.npz", "--port", name).code == 0
    assert server.device.store.library_sha256 == sha256(payload(Path("library.npz")).image)
    outcome = run("monitor", "--port", name, "--for", 0.2)
    assert outcome.code == 0
    assert "+4.90 mm" in outcome.out
    assert_refused(
        run("tap", "library.npz", "--port", name), f"{name}: arm refused: this configuration has not passed"
    )


def test_start_up_is_light() -> None:
    heavy = "('numpy', 'serial', 'scipy', 'matplotlib', 'casadi')"
    program = f"import sys, controller.cli; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"
