"""A current that nobody commanded heats the hardware's own guard, over a restart too, and is a fault."""

import math
from dataclasses import replace

import numpy as np
import pytest

from controller.protocol import messages as m
from controller.protocol.codes import EVENT_CODES, REASONS, LinkNotice, Reason
from controller.protocol.configuration import configuration_of
from controller.protocol.image import sha256
from controller.protocol.packed import Packed
from controller.servo.interface import Fault, State
from controller.servo.rules import FEWEST_TICKS, WRONG_CURRENT_S
from tests.benches.compiled import DT_S
from tests.benches.device import ARM, REST, REST_TICKS, SETTINGS, Talker
from tests.benches.probed import ProbedDevice
from tests.controller.firmware.conftest import COIL, HARDWARE, Start
from tests.controller.firmware.test_attacks import REST_PULSE_TICKS
from transopt.plant.wall import Wall

HEAT_TICKS, UPDATES = 10_000, 100


def heated_C(current_A: float) -> tuple[float, float]:
    """Winding and housing after the current has flowed for `HEAT_TICKS`, from 30 C."""
    coil = replace(COIL, ambient_C=30.0, start_winding_C=30.0, start_housing_C=30.0)
    steps_s = np.full(UPDATES, HEAT_TICKS * DT_S / UPDATES)
    nodes = coil.simulate(np.full((1, UPDATES), (current_A + 0.02) ** 2), steps_s)
    winding_C, housing_C = (float(node[0, -1]) for node in nodes)
    return winding_C, housing_C


@pytest.mark.parametrize(
    ("measured_A", "flows_A"),
    [(5.9, 5.9), (6.1, 6.1), (-9.0, 9.0), (math.nan, HARDWARE.over_current_A), (math.inf, HARDWARE.over_current_A)],
)
def test_the_hardwares_guard_counts_whatever_is_measured(single: Start, measured_A: float, flows_A: float) -> None:
    talker = Talker(single(heat_C=(30.0, 30.0)))
    talker.step(HEAT_TICKS, REST._replace(current_A=measured_A))
    assert talker.device.coil_C() == pytest.approx(heated_C(flows_A), abs=0.5)


def test_a_restart_cools_no_coil(start: Start) -> None:
    assert start(heat_C=(180.0, 95.0)).coil_C() == pytest.approx((180.0, 95.0))
    assert start(heat_C=(-40.0, -40.0)).coil_C() == pytest.approx((-40.0, -40.0))


@pytest.mark.parametrize("kept_C", [1001.0, -41.0, -math.inf, math.nan])
def test_what_no_guard_keeps_is_as_hot_as_may_be(single: Start, kept_C: float) -> None:
    assert single(heat_C=(kept_C, kept_C)).coil_C() == pytest.approx(single(heat_C=None).coil_C())


def resting(device: ProbedDevice) -> Talker:
    return Talker(device).ready()


@pytest.mark.parametrize("armed", [False, True], ids=["idle", "armed"])
@pytest.mark.parametrize("flows_A", [4.9, -4.9, 0.5])
def test_a_current_that_nobody_commanded_is_a_fault_in_every_state(
    single: Start, flows_A: float, armed: bool
) -> None:
    talker = resting(single())
    if armed:
        talker.done(ARM)
    flowing = REST._replace(current_A=flows_A)
    talker.step(round(WRONG_CURRENT_S / DT_S) - 1, flowing)
    assert talker.device.look().fault is None
    talker.step(1, flowing)
    assert talker.device.look().fault is Fault.WRONG_CURRENT
    assert not talker.device.enabled
    assert talker.refused(m.Reset()) is Reason.FAULT_REMAINS
    talker.step(1)
    talker.heard()
    talker.done(m.Reset())
    talker.step(REST_TICKS)
    talker.done(ARM)


@pytest.mark.parametrize("offset_A", [0.29, -0.29])
def test_a_monitor_with_an_honest_offset_is_no_fault(single: Start, offset_A: float) -> None:
    talker = resting(single())
    talker.done(ARM)
    talker.step(1000, REST._replace(current_A=offset_A))
    assert talker.device.state is State.ARMED


@pytest.mark.parametrize("request_", [ARM, m.Pulse(0.1, 20, 0)], ids=["arm", "pulse"])
def test_nothing_is_powered_while_a_current_flows(single: Start, request_: Packed) -> None:
    """Refused before it is a fault, with what flows, and granted once it is gone."""
    talker = resting(single())
    # One reading may be noise.
    talker.step(FEWEST_TICKS - 1, REST._replace(current_A=2.0))
    talker.step(1)
    talker.step(FEWEST_TICKS, REST._replace(current_A=2.0))
    answer = talker.ask(request_)
    assert isinstance(answer, m.Refused)
    assert (REASONS[answer.reason], answer.value) == (Reason.CURRENT_FLOWS, pytest.approx(2.0))
    talker.step(1)
    talker.done(request_)


def test_a_wall_that_pushes_is_no_uncommanded_current(start: Start) -> None:
    """The model's current is the wall's: what is measured under it is compared with that, not with zero."""
    walled = replace(SETTINGS, wall=Wall(2000.0, 1.0, 1.25, 1, 500.0))
    talker = Talker(start()).configured(configuration_of(walled)).loaded()
    talker.done(replace(ARM, configuration_sha256=sha256(configuration_of(walled)), lease_ms=1000))
    keep = math.exp(-2 * math.pi * 1050.0 * 0.9 * DT_S)  # an amplifier that is 10 % slower, a monitor 10 % high
    flows_A = most_A = 0.0
    for tick in range(3000):
        counts = 200 - min(tick // 10, 250)
        command_A = talker.step(1, REST._replace(encoder_counts=counts, current_A=1.1 * flows_A)).command_A
        flows_A = keep * flows_A + (1 - keep) * command_A
        most_A = max(most_A, flows_A)
    assert talker.device.state is State.ARMED
    assert most_A > 1.0
    # It stays on when nothing commands it any more.
    talker.tell(m.Disarm())
    talker.step(30, REST._replace(encoder_counts=-50, current_A=flows_A))
    assert talker.device.look().fault is Fault.WRONG_CURRENT


def test_a_test_pulse_of_a_wrong_amplifier_is_judged_by_its_evidence(start: Start) -> None:
    """Eight times the current of a pulse is named by the ratio that the check reports, and is no fault."""
    talker = resting(start())
    talker.done(m.Pulse(0.1, 150, 0))
    flows_A = 0.0
    for _ in range(REST_PULSE_TICKS + 200):
        flows_A = 8 * talker.step(1, REST._replace(current_A=flows_A)).command_A
    assert talker.device.state is State.IDLE
    assert EVENT_CODES[LinkNotice.PULSE_ENDED] in [x.code for x in talker.heard() if isinstance(x, m.Event)]
