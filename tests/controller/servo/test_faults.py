"""The fault table tick by tick, open loop: at once, silent, latched; in closed loop: `test_faults_playing`."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from controller.firmware.core_servo import CoreServo
from controller.protocol.image import image_of
from controller.servo.interface import Fault, Notice, Readings, State
from controller.servo.rules import FOLLOW_STILL_S
from controller.servo.settings import Settings
from controller.waveforms.bank import Bank
from tests.benches.oracle.crosscheck import Crosscheck
from tests.benches.oracle.faults import FAULTS, Watch
from tests.benches.oracle.servo import Servo
from tests.benches.servo import CONTACT, COUNT_M, DECAY, WALL, Bench, tap_m


class Injection:
    """One fault: how it is brought about on a bench, how long it takes to show, and how it goes away."""

    def __init__(self, fault: Fault, *, ticks: int = 1, playing: bool = False, **change: float) -> None:
        self.fault, self.ticks, self.playing, self.change = fault, ticks, playing, change


NAN, INF = math.nan, math.inf
INJECTIONS = [
    Injection(Fault.EMERGENCY_STOP, emergency_stop=True),
    Injection(Fault.BAD_SENSOR, encoder_counts=NAN),
    Injection(Fault.BAD_SENSOR, encoder_counts=INF),
    Injection(Fault.BAD_SENSOR, encoder_counts=2**40),
    Injection(Fault.BAD_SENSOR, current_A=NAN),
    Injection(Fault.BAD_SENSOR, current_A=-INF),
    Injection(Fault.BAD_SENSOR, current_A=1e300),
    Injection(Fault.OVER_CURRENT, current_A=5.01),
    Injection(Fault.OVER_CURRENT, current_A=-20.0),
    Injection(Fault.ENCODER_JUMP, encoder_counts=100_000),
    Injection(Fault.GRIP_OPEN, grip_N=NAN),
    Injection(Fault.GRIP_OPEN, grip_N=-5.0),
    Injection(Fault.GRIP_OPEN, grip_N=-INF),
    Injection(Fault.GRIP_SHORT, grip_N=80.0),
    Injection(Fault.GRIP_SHORT, grip_N=INF),
    Injection(Fault.GRIP_LOST, playing=True, grip_N=0.4),
    Injection(Fault.NO_CURRENT, ticks=10, playing=True, current_A=0.0),
    Injection(Fault.WRONG_CURRENT, ticks=25, current_A=4.9),
]


@pytest.mark.parametrize("injection", INJECTIONS, ids=lambda i: f"{i.fault.name}-{i.change}")
def test_every_fault_latches_at_once_and_silences(bench: Bench, injection: Injection) -> None:
    rng = np.random.default_rng(2)
    # No current can only be seen while one is wanted, within the first stroke; a wrong one best while none is.
    slow, last = injection.ticks > 1, CONTACT + 800
    span = (5, CONTACT - 40 if slow else last)
    if injection.playing:
        span = (CONTACT, CONTACT + 25 if slow else last - 10)
    instants = rng.integers(*span, size=3)
    for instant in sorted(set(instants.tolist())):
        made = Bench(bench.servo.settings, bench.servo.bank)
        made.servo.arm()
        made.run(instant)
        assert made.servo.state in (State.ARMED, State.PLAYING)
        made.change = injection.change
        for _ in range(injection.ticks):
            output = made.step()
            if output.state is State.FAULT:
                break
        assert output.state is State.FAULT
        assert made.servo.fault is injection.fault
        assert injection.fault in [event.what for event in output.events]
        assert (output.command_A, output.transient_A, output.feedback_A) == (0.0, 0.0, 0.0)
        # It holds while the cause is there, is not forgotten when it goes, and only a reset ends it.
        made.run(3)
        if injection.fault not in (Fault.ENCODER_JUMP, Fault.NO_CURRENT):
            assert not made.servo.reset()
        made.change = {}
        made.run(30)
        assert not made.servo.arm()
        assert all(o.command_A == 0.0 and o.state is State.FAULT for o in made.outputs[instant + injection.ticks :])
        assert made.servo.reset()
        assert made.servo.state is State.IDLE
        assert made.servo.fault is None
        assert made.step().command_A == 0.0


def test_stuck_encoder(stated: Settings, tables: Bank) -> None:
    """The stroke of a transient with no count, and a wall that pushes for a second with no count."""
    frozen = Bench(stated, tables, lambda k: tap_m(min(k, CONTACT - 3), 0.4))
    frozen.servo.arm()
    frozen.run(CONTACT + 800)
    assert frozen.servo.fault is Fault.ENCODER_STUCK
    stiff = replace(stated, wall=replace(WALL, stiffness_N_m=500.0))
    pressed = Bench(stiff, tables, lambda k: tap_m(min(k, CONTACT + 700)))
    pressed.servo.arm()
    pressed.run(CONTACT + 10_000)
    assert pressed.servo.fault is None
    assert pressed.current_A > 0.5
    pressed.run(800)
    assert pressed.servo.fault is Fault.ENCODER_STUCK


@pytest.mark.parametrize(
    ("every", "host_starts", "stuck"), [(10, False, True), (500, False, False), (10, True, False)]
)
def test_an_encoder_with_one_channel_is_stuck_and_a_trembling_edge_is_none(
    stated: Settings, every: int, host_starts: bool, stuck: bool
) -> None:
    """Between two counts under current: a stylus that goes 5 cm a second, a hand that trembles by 10 Hz.

    An excitation may shake a rotor that is blocked.
    """
    settings = replace(stated, host_starts=host_starts, wall=None)
    watch = Watch(settings, None)
    for k in range(30_000):
        watch.step(Readings(k, k // every % 2, 3.0, 1.0, 0.0), 1.0, 0.0, playing=False, held=False)
        if any(rule.trips(watch) for rule in FAULTS):
            break
    assert [rule.fault for rule in FAULTS if rule.trips(watch)] == ([Fault.ENCODER_STUCK] if stuck else [])
    assert k == (settings.ticks(settings.stuck_s) - 1 if stuck else 29_999)


def test_over_temperature_needs_cooling_before_the_reset(stated: Settings, tables: Bank) -> None:
    bench = Bench(stated, tables)
    bench.servo.arm()
    guard = bench.servo.guard
    bench.run(CONTACT + 20)
    for hot in (100.001, NAN):
        guard.winding_C = hot
        output = bench.step()
        assert (output.state, output.command_A) == (State.FAULT, 0.0)
        assert bench.servo.fault is Fault.OVER_TEMPERATURE
        assert not bench.servo.reset()
        guard.winding_C = 96.0
        bench.step()
        assert not bench.servo.reset()
        guard.winding_C = 94.0
        bench.step()
        assert bench.servo.reset()
        bench.servo.arm()


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
