"""Every step of the bring-up check: passed by a sound device, failed by one with that fault."""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest

from controller.host.bringup import (
    SKIPPABLE,
    STEPS,
    Result,
    check_skipped,
    check_step,
    drop_evidence,
    passed,
    run_steps,
)
from controller.host.check_state import Check
from controller.host.driver import Device, DeviceError, LinkLostError
from controller.host.payload import payload_of
from controller.protocol.messages import PULSE_SOUND
from controller.servo.interface import Readings, State
from controller.servo.settings import Settings
from tests.benches.desk import Desk
from tests.benches.virtual_link import Trouble
from transopt.base.errors import InputError
from transopt.library.library import Library

Wrong = Callable[[Readings], Readings]


@pytest.fixture
def desk(library: Library) -> Desk:
    return Desk(library, simulated=False)


@pytest.fixture
def device(desk: Desk) -> Iterator[Device]:
    with desk.connect() as connected:
        yield connected


@pytest.fixture
def check(desk: Desk, device: Device, library: Library) -> Check:
    given = payload_of(library)
    device.configure(given.configuration)
    device.upload(given.image)
    device.set_telemetry(1)
    return Check(
        device,
        given.settings,
        desk,
        loaded=True,
        library=library,
        configuration=given.configuration,
        patience_s=0.5,
    )


def result(check: Check, name: str) -> Result:
    [found] = run_steps(check, only=name)
    return found


def test_a_sound_device_passes_every_step_and_may_then_be_armed(desk: Desk, check: Check) -> None:
    told: list[Result] = []
    with pytest.raises(DeviceError, match="no sound test pulse under this configuration"):
        check.device.arm(0.5)
    results = run_steps(check, tell=told.append)
    assert results == told
    assert [r.passed for r in results] == [True] * len(STEPS), results
    assert passed(check, results)
    assert check.off == []
    assert desk.requests[0] == "press the emergency stop"
    assert desk.end.state is State.IDLE
    assert check.wait(check.at_rest, 2.0)
    check.device.arm(0.5)
    check.device.disarm()
    check.close()
    assert not check.device.listeners


def changed(**by: Callable[[Readings], float]) -> Wrong:
    return lambda readings: readings._replace(**{name: value(readings) for name, value in by.items()})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "wrong", "seen"),
    [
        ("encoder", changed(encoder_counts=lambda r: -r.encoder_counts), r"^-4\d\d counts, -(9|10)\.\d+ mm of 10"),
        ("encoder", changed(encoder_counts=lambda r: 2 * r.encoder_counts), r"^\+8\d\d counts, \+(19|20)"),
        ("accelerometer", changed(acceleration_m_s2=lambda r: -r.acceleration_m_s2), "correlation -"),
        ("accelerometer", changed(acceleration_m_s2=lambda r: 0.6 * r.acceleration_m_s2), "correlation [+]1.00"),
        (
            "accelerometer",
            changed(acceleration_m_s2=lambda r: r.acceleration_m_s2 + 9.81),
            r"^\+9\.\d\d m/s² at rest",
        ),
        ("grip-zero", changed(grip_N=lambda r: r.grip_N + 0.5), r"^\+0\.5\d\d N"),
        ("grip-zero", changed(grip_N=lambda r: float("nan")), "nan"),
        ("grip-hold", changed(grip_N=lambda r: -r.grip_N), "reversed"),
        ("grip-hold", changed(grip_N=lambda r: 0.0), "dead or stuck"),
        ("current-offset", changed(current_A=lambda r: r.current_A + 0.1), r"^\+0\.1\d\d\d A"),
        ("current-offset", changed(encoder_counts=lambda r: r.tick // 10), r"^no rest: \d+ counts in 0.3 s"),
        ("emergency-stop", changed(emergency_stop=lambda r: False), "not pressed within 0.5 s"),
    ],
)
def test_a_wrong_sensor_fails_its_step(
    desk: Desk, request: pytest.FixtureRequest, name: str, wrong: Wrong, seen: str
) -> None:
    desk.wrong = wrong
    check: Check = request.getfixturevalue("check")
    found = result(check, name)
    assert not found.passed
    assert re.search(seen, found.seen), found.seen


def test_the_emergency_stop_has_to_come_out_again(desk: Desk, check: Check) -> None:
    desk.obeys["release"] = lambda: None
    found = result(check, "emergency-stop")
    assert (found.passed, found.seen) == (False, "not released within 0.5 s")
    assert desk.end.state is State.FAULT


@pytest.mark.parametrize("motor", [-1.0, 0.0])
def test_polarity(desk: Desk, request: pytest.FixtureRequest, motor: float) -> None:
    """Motor leads that are reversed behind the current monitor; a motor cable that is out."""
    desk.motor = motor
    desk.wrong = lambda readings: readings._replace(current_A=readings.current_A * (motor or 1.0))
    found = result(request.getfixturevalue("check"), "polarity")
    assert found.passed is False, found.seen
    if motor == -1.0:
        assert "acceleration -" in found.seen


def test_the_grips_scale_is_found_with_a_known_weight_or_said_not_to_be_checked(desk: Desk, check: Check) -> None:
    assert "its scale is not checked (--grip-weight-g)" in result(check, "grip-hold").seen
    check.grip_weight_N = 3.0
    assert result(check, "grip-hold").passed
    desk.wrong = changed(grip_N=lambda r: 2 * r.grip_N)
    assert not result(check, "grip-hold").passed
    [words] = check.off
    assert words.startswith("the grip sensor reads 2 times the force")


@pytest.mark.parametrize(
    ("instead", "seen"),
    [
        (lambda desk: None, "no contact within 0.5 s"),
        (lambda desk: (desk.hand.tap(desk.now_s(), 0.2), setattr(desk.hand, "held_N", 0.3)), "no contact.*not held"),
    ],
)
def test_a_trial_without_a_tap_fails_and_leaves_nothing_armed(
    desk: Desk, check: Check, instead: Callable[[Desk], None], seen: str
) -> None:
    assert result(check, "polarity").passed
    desk.obeys["tap"] = lambda: instead(desk)
    found = result(check, "trial-tap")
    assert not found.passed
    assert re.search(seen, found.seen), found.seen
    assert desk.end.state in (State.IDLE, State.FAULT)


def test_a_stop_meanwhile_fails_what_drives(desk: Desk, check: Check) -> None:
    """Pressed while the check asks for something else."""
    desk.asked("press")
    check.device.listen(0.05)
    desk.asked("release")
    for name in ("polarity", "trial-tap"):
        found = result(check, name)
        assert not found.passed
        assert "a fault is latched: emergency stop" in found.seen


def test_a_lossy_link_and_a_slow_clock_fail(desk: Desk, check: Check) -> None:
    desk.link.set_trouble(Trouble(loss=0.1))
    assert not result(check, "link").passed
    desk.link.set_trouble(Trouble())
    check.device.now_s = lambda: 1.1 * desk.now_s()
    check.device.listen(4.0)  # until the round trips of the sound clock are forgotten
    found = result(check, "link")
    assert not found.passed, found.seen


def test_after_a_failure_no_current_flows(desk: Desk, check: Check) -> None:
    desk.wrong = changed(acceleration_m_s2=lambda r: 3 * r.acceleration_m_s2)
    commands: list[float] = []
    desk.each_ms = lambda: commands.append(abs(desk.plant._commands[0]))
    results = run_steps(check, ("emergency-stop", "encoder"))
    assert [r.name for r in results if r.passed is False] == ["accelerometer"]
    assert [r.name for r in results if r.passed is None] == ["emergency-stop", "encoder", "polarity", "trial-tap"]
    assert not passed(check, results, ("emergency-stop", "encoder"))
    assert [words.split(" the accel")[0] for words in check.off] == ["the accelerometer reads 3 times"]
    assert max(commands) == 0.0


def test_without_a_library_the_sensors_alone(desk: Desk, device: Device) -> None:
    device.set_telemetry(1)
    check = Check(device, Settings(1e-4, 0.0, 1.0), desk, loaded=False)
    results = run_steps(check, ("encoder",))
    assert [r.passed for r in results] == [True, True, None, True, True, True, True, None, None]
    assert not passed(check, results, ("encoder",))


def test_a_device_without_grip_sensor(check: Check) -> None:
    check.settings = replace(check.settings, assumed_grip_N=0.0, grip_min_N=0.0)
    results = run_steps(check, SKIPPABLE[:3])
    assert "has no grip sensor" in results[4].seen
    assert passed(check, results, SKIPPABLE[:3]), results


def test_a_lost_link_ends_the_check(desk: Desk, check: Check) -> None:
    def unplug() -> None:
        desk.gone = True

    desk.obeys["press"] = unplug
    with pytest.raises(LinkLostError, match="does not arm by itself"):
        run_steps(check)


def test_what_drives_may_not_be_left_out() -> None:
    assert check_skipped(list(SKIPPABLE)) == SKIPPABLE
    assert check_step("polarity") == "polarity"
    with pytest.raises(InputError, match=r"--step polarty: must be one of link, .* [(]did you mean polarity"):
        check_step("polarty")
    for name in ("polarity", "trial-tap", "link", "nonsense"):
        with pytest.raises(InputError, match=f"--skip {name}: must be one of emergency-stop, "):
            check_skipped([name])


def test_what_the_host_alone_finds_wrong_takes_the_devices_evidence(desk: Desk, check: Check) -> None:
    assert result(check, "polarity").passed
    assert check.device.evidence().bits == PULSE_SOUND
    drop_evidence(check)
    assert check.device.evidence().bits == 0
    with pytest.raises(DeviceError, match="no sound test pulse"):
        check.device.arm(0.1, trial=True)
