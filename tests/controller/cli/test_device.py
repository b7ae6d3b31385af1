"""`transopt-play` on a device: what is printed, written and returned, whatever goes wrong on the way."""

from pathlib import Path

import pytest

from controller.cli.port import STOPPED, UNCONFIRMED
from controller.protocol.codes import Kind
from controller.servo.interface import Fault, State
from tests.benches.commands import Run, assert_refused
from tests.benches.desk import PORT, Desk
from tests.benches.telemetry_file import read_csv
from tests.benches.virtual_link import Trouble
from transopt.library.library import Library
from transopt.recordings.recording import load_recording
from transopt.recordings.tap import prepare

QUICK = [word for name in ("encoder", "emergency-stop", "grip-zero") for word in ("--skip", name)]
FILES = "telemetry.csv, telemetry.npz, events.csv, tap_001.csv"


def tapping(desk: Desk, speed_m_s: float = 0.2) -> None:
    """The hand taps as soon as the device is armed."""

    def look() -> None:
        if desk.end.state is State.ARMED:
            desk.each_ms = lambda: None
            desk.hand.tap(desk.now_s() + 0.05, speed_m_s)

    desk.each_ms = look


def when(desk: Desk, state: State, act) -> None:
    def look() -> None:
        if desk.end.state is state:
            desk.each_ms = lambda: None
            act()

    desk.each_ms = look


def test_check_then_tap_quietly_then_in_full(play: Run, library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    """A device's first quarter of an hour."""
    desk = Desk(library, simulated=False).put(monkeypatch)
    refused = play("tap", "library.npz", *PORT, "--out", "taps")
    assert_refused(refused, "arm refused: no sound test pulse under this configuration", "run `check`")
    assert not list(Path("taps").iterdir())
    checked = play("check", "library.npz", *PORT)
    assert checked.code == 0, checked.out + checked.err
    assert "please press the emergency stop" not in checked.out  # the desk's ear, not the console's
    for step in ("link", "emergency-stop", "encoder", "accelerometer", "grip-zero", "current-offset", "polarity"):
        assert f"{step}: passed: " in checked.out
    assert "passed: this configuration may be armed until the device starts anew" in checked.out
    desk.hand.held_N = 3.0
    tapping(desk)
    first = play("tap", "library.npz", *PORT, "--taps", 1, "--gain", 0.1)
    assert first.code == 0, first.out + first.err
    assert "gain 0.1" in first.out
    assert "has this library already" in first.out
    tapping(desk)
    second = play("tap", "library.npz", *PORT, "--taps", 1, "--out", "taps")
    assert second.code == 0, second.out + second.err
    assert "gain 1\n" in second.out.replace("gain 1 ", "gain 1\n")
    # One tap at 0.2 m/s: its figures stand in the table's row.
    [row] = [line.split("│") for line in second.out.splitlines() if line.startswith("│   1 ")]
    speed, grip, latency_us, tap_error, error = (float(cell) for cell in row[2:7])
    assert speed == pytest.approx(0.2, abs=0.01)
    assert grip == pytest.approx(3.0, abs=0.2)
    assert abs(latency_us) <= 20
    assert tap_error == pytest.approx(20, abs=2)
    assert error <= 3
    assert f"taps: {FILES}, all whole" in second.out
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
    assert_refused(play("tap", "library.npz", *PORT, "--gain", 1), "no sound test pulse")


def test_a_failed_check_is_no_pass(play: Run, desk: Desk) -> None:
    desk.wrong = lambda readings: readings._replace(acceleration_m_s2=-readings.acceleration_m_s2)
    outcome = play("check", "library.npz", *PORT, "--skip", "encoder", "--skip", "emergency-stop", "--patience", 2)
    assert outcome.code == 1
    assert "accelerometer: FAILED: " in outcome.out
    assert "failed: the accelerometer reads the opposite of the acceleration that there is" in outcome.out
    assert "polarity: -: left out: a step before it has failed" in outcome.out


def test_check_of_the_sensors_alone(play: Run, desk: Desk) -> None:
    outcome = play("check", *PORT, *QUICK)
    assert outcome.code == 0, outcome.out
    assert "give a library for the rest of the check" in outcome.out
    assert desk.end.look().configuration_sha256 == bytes(32)


def test_a_device_holds_one_library_and_what_replaces_which_is_said_by_name(play: Run, desk: Desk) -> None:
    excitation = play("check", "--sweep", *PORT, *QUICK)
    assert excitation.code == 0, excitation.out + excitation.err
    before = desk.end.look().library_sha256.hex()[:8]
    said = play("upload", "library.npz", *PORT).out
    name = f"wood_on_foam ({desk.end.look().library_sha256.hex()[:8]})"
    assert f": {name}, in place of library {before}" in said
    assert f"the device has this library already: {name}" in play("upload", "library.npz", *PORT).out
    assert name in play("monitor", *PORT, "--for", 0.1).out


def test_monitor(play: Run, ready: Desk) -> None:
    outcome = play("monitor", *PORT, "--for", 0.2)
    assert outcome.code == 0
    assert "firmware 2.0.0 (double), boot 000001f4, period 100 us, limits 10 A and 10 A, configuration" in outcome.out
    for words in ("state", "idle", "z", "+12.0", "grip", "emergency stop", "released", "records lost"):
        assert words in outcome.out


def test_monitor_tells_events(play: Run, ready: Desk) -> None:
    """What comes while it looks, line by line; what was before, as the state."""
    ready.each_ms = lambda: (
        ready.asked("press") if ready.now_s() > began_s + 0.15 and not ready.hand.pressed else None
    )
    began_s = ready.now_s()
    first, second = play("monitor", *PORT, "--for", 0.3), play("monitor", *PORT, "--for", 0.1)
    assert " s  FAULT: emergency stop: release it, then reset" in first.out
    for outcome in (first, second):
        assert "fault: emergency stop: release it, then reset" in outcome.out
        assert "pressed" in outcome.out


def test_recording_a_real_object(play: Run, library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    target = library.scene().recordings.simulated
    desk = Desk(library, target=target, gravity_m_s2=9.81).put(monkeypatch)
    desk.asked("hold")
    begun = iter([True])

    def look() -> None:
        if desk.now_s() > 0.2 and next(begun, False):
            desk.hand.tap(desk.now_s(), 0.2)

    desk.each_ms = look
    outcome = play("record", "tap", *PORT, "--out", "real", "--taps", 1, "--for", 3)
    assert outcome.code == 0, outcome.out + outcome.err
    assert f"real: {FILES}, all whole" in outcome.out
    recording = load_recording(Path("real/tap_001.csv"))
    assert recording.speed_m_s is None
    assert recording.grip_N == pytest.approx(3.0, abs=0.2)
    tap = prepare(recording, library.scene().recordings)
    assert tap.speed_m_s == pytest.approx(0.2, rel=0.03)
    assert tap.offset_m_s2 == pytest.approx(9.81, abs=0.5)
    assert desk.end.look().configuration_sha256 == bytes(32)
    # Recordings are never written over.
    assert_refused(play("record", "tap", *PORT, "--out", "real"), "--out real: holds a recording already", "choose")
    assert_refused(play("tap", "library.npz", *PORT, "--out", "real"), "--out real: holds a recording already")


def test_a_fault_ends_a_recording_of_a_real_object(
    play: Run, library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What came before it is kept; one that is latched already is told in place of a recording of nothing."""
    desk = Desk(library, target=library.scene().recordings.simulated, gravity_m_s2=9.81).put(monkeypatch)
    desk.asked("hold")
    begun = iter([True])

    def look() -> None:
        if desk.now_s() > 0.2 and next(begun, False):
            desk.hand.tap(desk.now_s(), 0.2)
        desk.hand.pressed = desk.now_s() > 1.2

    desk.each_ms = look
    first = play("record", "tap", *PORT, "--out", "real", "--taps", 2, "--for", 3)
    again = play("record", "tap", *PORT, "--out", "again", "--for", 1)
    assert f"real: {FILES}, all whole" in first.out
    for outcome in (first, again):
        assert outcome.code == 1, outcome.out + outcome.err
        assert "\nfault: emergency stop: release it, then reset" in outcome.out


def test_nothing_recorded_is_exit_code_1(play: Run, desk: Desk) -> None:
    assert play("record", "tap", *PORT, "--out", "nothing", "--for", 0.1).code == 1


def interrupt() -> None:
    raise KeyboardInterrupt


def test_ctrl_c_while_armed_disarms_and_tells_what_came(play: Run, ready: Desk) -> None:
    ready.hand.tap(ready.now_s() + 1.0, 0.3)
    count = iter(range(10_000))
    ready.each_ms = lambda: interrupt() if next(count) == 1500 else None
    outcome = play("tap", "library.npz", *PORT, "--out", "cut")
    assert outcome.code == 130, outcome.out + outcome.err
    assert outcome.err.strip() == STOPPED
    assert (ready.end.state, ready.end.look().fault) == (State.IDLE, None)
    assert f"cut: {FILES}, all whole" in outcome.out
    assert load_recording(Path("cut/tap_001.csv")).grip_N == pytest.approx(3.0, abs=0.2)
    assert read_csv(Path("cut/telemetry.csv"))["tick"].size > 5000


def test_another_ctrl_c_meanwhile_is_an_emergency_stop(play: Run, ready: Desk) -> None:
    def again() -> None:
        ready.each_ms = lambda: None
        interrupt()

    def first() -> None:
        # The answer to DISARM does not come, so that there is time for impatience.
        ready.link.to_host.trouble = Trouble(loss=1.0)
        ready.each_ms = again
        interrupt()

    when(ready, State.ARMED, first)
    outcome = play("tap", "library.npz", *PORT)
    assert outcome.code == 130, outcome.err
    assert outcome.err.strip() == UNCONFIRMED  # whose answer has been lost
    assert ready.end.look().fault is Fault.HOST_STOP


# Instants lie behind the 0.6 s for which the line is measured before the device is armed.


def test_a_device_that_goes_away_is_one_line_and_the_files_are_whole(play: Run, ready: Desk) -> None:
    """How it goes is the driver's concern: `test_driver.py`."""
    ready.hand.tap(ready.now_s() + 1.0, 0.2)
    count = iter(range(10_000))
    ready.each_ms = lambda: setattr(ready, "gone", next(count) >= 1400)
    outcome = play("tap", "library.npz", *PORT, "--out", "cut")
    assert_refused(outcome, "it does not arm by itself", f"cut: {FILES}, all whole")
    assert load_recording(Path("cut/tap_001.csv")).speed_m_s == pytest.approx(0.2, abs=0.01)
    assert read_csv(Path("cut/telemetry.csv"))["tick"].size > 4000
    ready.each_ms, ready.gone = lambda: None, False


def test_a_lost_lease_ends_the_run_and_nothing_is_armed_again(play: Run, ready: Desk) -> None:
    """The cable comes loose for less than what counts as a lost link."""
    count = iter(range(100_000))

    def look() -> None:
        now_ms = next(count)
        if now_ms == 1100:
            ready.link.unplug()
        elif now_ms == 1400:
            ready.link.plug()

    ready.each_ms = look
    armed_before = ready.link.to_device.kinds[Kind.ARM]
    outcome = play("tap", "library.npz", *PORT)
    assert outcome.code == 1, outcome.out + outcome.err
    assert "the host was silent for longer than its lease: disarmed, no command" in outcome.out
    assert ready.end.state is State.IDLE
    assert ready.link.to_device.kinds[Kind.ARM] == armed_before + 1
    assert next(count) < 2100


def test_a_tap_that_a_fault_cut_is_named_and_not_compared(play: Run, ready: Desk) -> None:
    def tapped() -> None:
        ready.asked("tap")
        when(ready, State.PLAYING, lambda: ready.asked("press"))

    when(ready, State.ARMED, tapped)
    outcome = play("tap", "library.npz", *PORT, "--out", "out")
    assert outcome.code == 1
    assert "cut short: emergency stop: release it" in " ".join(outcome.out.split())
    assert "tap error" not in outcome.out
    assert not list(Path("out").glob("tap_*.csv"))


def test_a_fault_ends_the_run_and_the_next_one_asks_for_its_reset(play: Run, ready: Desk) -> None:
    when(ready, State.ARMED, lambda: ready.asked("press"))
    outcome = play("tap", "library.npz", *PORT)
    assert outcome.code == 1
    assert "fault: emergency stop: release it, then reset" in outcome.out
    for command in (("tap", "library.npz"), ("upload", "library.npz"), ("check",)):
        assert_refused(play(*command, *PORT), "a fault is latched: emergency stop: release it, then reset", "--reset")
    assert_refused(play("upload", "library.npz", *PORT, "--reset"), "the cause of the fault is still there")
    ready.asked("release")
    assert play("upload", "library.npz", *PORT, "--reset").code == 0
    assert ready.end.state is State.IDLE
