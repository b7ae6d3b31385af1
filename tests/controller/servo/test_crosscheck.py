"""What encoder and accelerometer say of each other, by itself; `test_faults` has it in a servo."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from controller.firmware.core_servo import CoreServo
from controller.protocol.image import image_of
from controller.servo.interface import Fault, Notice, Readings
from controller.servo.rules import FOLLOW_STILL_S
from controller.servo.settings import Settings
from controller.waveforms.bank import Bank
from tests.benches.oracle.crosscheck import Crosscheck
from tests.benches.oracle.servo import Servo
from tests.benches.servo import COUNT_M, DECAY, WALL


def test_a_path_without_a_count_grows_until_the_stylus_counts_as_at_rest(stated: Settings) -> None:
    check, ticks, acceleration = Crosscheck(stated), stated.ticks(FOLLOW_STILL_S), 5.0
    for k in range(1, ticks):
        check.step(0, acceleration, 0.0, playing=False)
        assert check.path_m == pytest.approx(acceleration * stated.dt_s**2 * k * (k + 1) / 2)
    check.step(0, acceleration, 0.0, playing=False)
    assert check.path_m == pytest.approx(0.0, abs=1e-15)


def core(settings: Settings, table: Bank) -> CoreServo:
    return CoreServo(settings, image_of(table, settings.dt_s, settings.lead_s, 1))


@pytest.mark.parametrize("kind", [Servo, core], ids=["Python", "C"])
@pytest.mark.parametrize(("jerk_m_s3", "stuck"), [(80.0, False), (800.0, True)])
def test_a_tilt_is_learnt_at_rest_and_a_stylus_that_is_flung_has_a_stuck_encoder(
    stated: Settings, tables: Bank, c_compiler: None, kind: Callable[..., Servo], jerk_m_s3: float, stuck: bool
) -> None:
    """In a wall, moved by three counts every tenth of a second; gravity along the sensor comes, or a jerk."""
    settings = replace(stated, wall=replace(WALL, stiffness_N_m=1000.0))
    servo, current_A = kind(settings, tables), 0.0
    servo.arm()
    told: list[Notice | Fault] = []
    for k in range(16_000):
        pressed_m = min(max(k - 1000, 0) * 1e-6, 4e-3) + 3 * COUNT_M * (k // 1000 % 2) * (k > 5000) - 1e-3
        acceleration = jerk_m_s3 * min(max(k - 6000, 0), 10_000) * settings.dt_s + (0.3 if k % 2 else -0.3)
        output = servo.step(Readings(k, round(-pressed_m / COUNT_M), 3.0, current_A, acceleration))
        current_A = DECAY * current_A + (1 - DECAY) * output.command_A
        told += [event.what for event in output.events]
    assert [what for what in told if isinstance(what, Fault)] == ([Fault.ENCODER_STUCK] if stuck else [])
