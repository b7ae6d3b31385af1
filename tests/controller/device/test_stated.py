"""What a device file means for the servo, for encoders of 1 to 100 um and servos of 1 to 20 kHz."""

import numpy as np
import pytest

from controller.device.device_file import BUILT_IN, DeviceFile, Encoder, Grip, Limits, Period
from controller.device.stated import assumed_grip_N, grip_in_words, library_numbers, servo_numbers
from controller.servo.settings import Settings
from tests.benches.oracle.approach import Approach, Touch, Trigger
from transopt.base.errors import InputError
from transopt.library.library import Library

BLIND = DeviceFile(grip=Grip(sensor=False, assumed_grip_N=9.0))


def test_the_built_in_device_is_what_the_settings_say_by_themselves() -> None:
    numbers = servo_numbers(BUILT_IN, 1e-4)
    usual = Settings(1e-4, 0.0, 1.0)
    for name, value in numbers.items():
        assert value == pytest.approx(getattr(usual, name), rel=0.03), name


@pytest.mark.parametrize("count_m", [1e-6, 1e-5, 24.5e-6, 1e-4])
@pytest.mark.parametrize("dt_s", [5e-5, 1e-4, 1e-3])
def test_taps_are_met_once_by_any_encoder_on_any_servo(count_m: float, dt_s: float) -> None:
    """A steady approach at 0.2 m/s from 8 mm above is met once, at its speed, though the surface is no zero."""
    device = DeviceFile(encoder=Encoder(count_m=count_m, surface_counts=1234.0))
    s = Settings(dt_s, 3e-4 if dt_s < 3e-4 else dt_s, 4.0, **servo_numbers(device, dt_s))
    assert s.window_ticks * dt_s == pytest.approx(10e-3, rel=0.01)
    approach = Approach(
        dt_s,
        s.lead_s,
        count_m=s.count_m,
        surface_counts=s.surface_counts,
        window_ticks=s.window_ticks,
        least_speed_m_s=s.least_speed_m_s,
    )
    trigger, met = Trigger(s.count_m, s.touch_height_m, s.rearm_height_m, s.ticks(s.rearm_s)), []
    for tick in range(round(0.045 / dt_s)):
        z = 8e-3 - 0.2 * tick * dt_s
        counts = int(np.floor(z / count_m + 0.5)) + 1234
        approach.step(counts)
        if trigger.step((counts - 1234) * count_m, approach.speed_m_s, approach.phase) is Touch.CONTACT:
            met.append((tick, approach.speed_m_s))
    assert len(met) == 1
    tick, speed = met[0]
    assert speed == pytest.approx(0.2, rel=0.02 + 0.03 * count_m / 1e-5 * (dt_s >= 1e-3 or count_m > 5e-5))
    assert abs(tick * dt_s + s.lead_s - 0.04) <= 2 * dt_s + count_m / 0.2


def test_a_coarse_encoder_may_stand_still_longer_at_the_turning_point() -> None:
    fine, usual, coarse = (
        servo_numbers(DeviceFile(encoder=Encoder(count_m=count)), 1e-4)["stuck_A_s"]
        for count in (1e-6, 24.5e-6, 1e-4)
    )
    assert fine == pytest.approx(usual)
    assert coarse == pytest.approx(usual * np.sqrt(1e-4 / 24.5e-6))


def test_a_device_without_grip_sensor_plays_for_a_grip_that_the_library_has(library: Library) -> None:
    assert assumed_grip_N(BUILT_IN, library.grips_N) is None
    most = float(library.grips_N[-1])
    assert library_numbers(BLIND, library)["assumed_grip_N"] == pytest.approx(most)
    assert f"every tap is played for {most:g} N, the nearest to 9 N" in grip_in_words(BLIND, library)
    assert grip_in_words(BUILT_IN, library) == ""
    assert assumed_grip_N(BLIND, [0.0]) == pytest.approx(0.0)


def test_a_library_for_another_device_is_refused_in_one_line(library: Library) -> None:
    with pytest.raises(InputError, match=r"servo\.dt_s = 5e-05, the library is for 0.0001 s"):
        library_numbers(DeviceFile(servo=Period(dt_s=5e-5)), library)
    with pytest.raises(InputError, match=r"hardware\.current_A = 2"):
        library_numbers(DeviceFile(hardware=Limits(current_A=2.0)), library)
