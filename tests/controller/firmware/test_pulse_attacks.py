"""Test pulses as a host would misuse them: too large for the hardware, without rest or lease, of nothing."""

from dataclasses import replace

import numpy as np
import pytest

from controller.protocol import messages as m
from controller.protocol.capacity import PULSE_LEASE_MS, PULSE_LEAST_PART, REST_BETWEEN_PULSES_S
from controller.protocol.codes import EVENTS, REASONS, LinkNotice, Reason
from controller.protocol.configuration import configuration_of
from controller.servo.settings import Settings
from tests.benches.compiled import DT_S
from tests.benches.device import IMAGE, Talker
from tests.benches.probed import ProbedDevice
from tests.benches.servo import AMPLIFIER
from tests.controller.firmware.conftest import HARDWARE, Start
from tests.controller.firmware.test_attacks import PULSE_TICKS, WATCHED, Plant, evidence

REST_TICKS = round(REST_BETWEEN_PULSES_S / DT_S)
PAIR_TICKS = 2 * (REST_TICKS + PULSE_TICKS + 1)


def ready(start: Start, settings: Settings = WATCHED, **wrong: float) -> Plant:
    talker = Talker(start(simulated=False))
    talker.configured(configuration_of(settings))
    return Plant(talker, **wrong).step(200)


@pytest.mark.parametrize("pairs", [0, 1])
def test_a_host_that_asks_for_pulses_in_every_tick_gets_rests_between_them(single: Start, pairs: int) -> None:
    plant = ready(single)
    flowing = []
    for tick in range(4 * PAIR_TICKS):
        if tick % 50 == 0:
            plant.talker.tell(m.Pulse(WATCHED.pulse_A, PULSE_TICKS, pairs), plant.talker.lease())
        plant.step(1)
        flowing.append(plant.output.command_A != 0)
    edges = np.flatnonzero(np.diff(np.array(flowing, dtype=int)))
    rises, falls = edges[::2], edges[1::2]
    assert rises.size >= 3
    # The command is counted from the tick that first has it.
    assert np.all(falls - rises[: falls.size] <= PULSE_TICKS)
    assert np.all(rises[1:] - falls[: rises.size - 1] >= REST_TICKS)
    assert np.mean(flowing) <= 1.2 * PULSE_TICKS / (REST_TICKS + PULSE_TICKS)


@pytest.mark.parametrize("pairs", [0, 3])
def test_pulses_end_with_the_lease_though_the_host_goes_on_talking(single: Start, pairs: int) -> None:
    """Other frames keep the line, not the lease."""
    plant = ready(single)
    talker, lease_ticks = plant.talker, round(1e-3 * PULSE_LEASE_MS / DT_S)
    plant.leases = False
    commands, told = [], []
    for tick in range(2 * lease_ticks):
        if tick % 100 == 0:
            # A single one after the other, or one row of pairs that takes longer than the lease.
            asked = m.Pulse(WATCHED.pulse_A, PULSE_TICKS, pairs) if pairs == 0 or tick == 0 else m.Evidence()
            told += [EVENTS[x.code] for x in talker.tell(asked) if isinstance(x, m.Event)]
        plant.step(1)
        commands.append(plant.output.command_A)
    if pairs:
        assert np.flatnonzero(commands)[-1] <= lease_ticks
        assert LinkNotice.PULSE_CUT in told
        assert not talker.device.enabled
        assert evidence(talker).bits == 0
    else:
        # Each begins a lease of its own, which outlasts it.
        assert set(told) == {LinkNotice.PULSE_ENDED}


def test_a_single_pulse_of_a_host_that_has_gone_ends_with_its_lease(start: Start) -> None:
    """However long a port lets pulses be, they do not outlive the lease."""
    long_ticks = round(2e-3 * PULSE_LEASE_MS / DT_S)
    talker = Talker(ProbedDevice(9, replace(HARDWARE, pulse_s=long_ticks * DT_S), (), simulated=False))
    talker.configured(configuration_of(WATCHED))
    talker.done(m.Pulse(0.05, long_ticks, 0))
    commands = [talker.step(1).command_A for _ in range(long_ticks)]
    assert np.count_nonzero(commands) > 0
    assert np.flatnonzero(commands)[-1] < round(1e-3 * PULSE_LEASE_MS / DT_S)


@pytest.mark.parametrize(
    "wrong", [{"amplifier": 8.0}, {"amplifier": -1.0}, {"monitor": 0.0}, {"accelerometer": -1.0}], ids=str
)
def test_after_the_first_wrong_pulse_no_other_follows(single: Start, wrong: dict[str, float]) -> None:
    plant = ready(single, **wrong)
    plant.talker.done(m.Pulse(WATCHED.pulse_A, PULSE_TICKS, 8))
    pulsed = 0
    for _ in range(3 * PAIR_TICKS):
        plant.step(1)
        pulsed += plant.output.command_A != 0
    assert pulsed == PULSE_TICKS
    found = evidence(plant.talker)
    assert (found.bits, found.pulses) == (0, 1)
    # What was wrong can still be named.
    ((part, k),) = wrong.items()
    ratio = found.acceleration_ratio if part == "accelerometer" else found.current_ratio
    assert ratio == pytest.approx(k, abs=0.1 * max(abs(k), 1))


def test_a_sound_device_ends_all_its_pulses(start: Start) -> None:
    plant = ready(start)
    plant.talker.done(m.Pulse(WATCHED.pulse_A, PULSE_TICKS, 2))
    plant.step(2 * PAIR_TICKS + 100)
    assert (evidence(plant.talker).bits, evidence(plant.talker).pulses) == (m.PULSE_SOUND, 4)


@pytest.mark.parametrize("size_A", [1e-12, 1e-6, 0.9 * PULSE_LEAST_PART * 0.1])
def test_pulses_of_next_to_nothing_prove_nothing(single: Start, size_A: float) -> None:
    plant = ready(single, replace(WATCHED, pulse_A=size_A))
    assert plant.talker.refused(m.Pulse(size_A, PULSE_TICKS, 3)) is Reason.BAD_VALUE
    assert evidence(plant.talker).bits == 0


@pytest.mark.parametrize("scale", ["amplifier_scale", "monitor_scale"])
def test_a_scale_makes_no_large_pulse_of_a_small_one(single: Start, scale: str) -> None:
    """A stated scale of five says that 0.03 A flow where 6 mA are asked for or read: less than what proves."""
    weak = {"amplifier": 0.2} if scale == "amplifier_scale" else {"monitor": 0.2}
    settings = replace(WATCHED, pulse_A=0.03, **{scale: 5.0})
    plant = ready(single, settings, **weak)
    assert plant.talker.refused(m.Pulse(0.03, PULSE_TICKS, 3)) is Reason.BAD_VALUE


LIMITS = {
    "current": ({"current_limit_A": 4.0}, "amplifier_scale", 4.0 / 4.5),
    "command": (
        {"amplifier": replace(AMPLIFIER, command_limit=4.0), "current_limit_A": 1.0},
        "amplifier_scale",
        4 / 6,
    ),
    "over-current": ({"current_limit_A": 2.0, "over_current": 1.5}, "monitor_scale", 3.0 / 6.0),
}


@pytest.mark.parametrize("kind", LIMITS)
@pytest.mark.parametrize("sign", [1, -1])
def test_limits_are_asked_in_the_hardwares_units(single: Start, kind: str, sign: int) -> None:
    """What is stated is within the hardware's limit; what the stated scale makes of it is or is not."""
    change, scale, least = LIMITS[kind]
    tight = {"amplifier": replace(AMPLIFIER, command_limit=0.5), **change}
    if kind == "current":
        tight["amplifier"] = replace(AMPLIFIER, command_limit=4.0)
    for part, wanted in ((1.02, m.Done), (0.98, m.Refused), (5.0, m.Done)):
        talker = Talker(single(simulated=False))
        stated = replace(WATCHED, **tight, **{scale: sign * min(least * part, 5.0)})  # type: ignore[arg-type]
        answer = talker.configure(configuration_of(stated))
        assert isinstance(answer, wanted), (part, answer)
        if isinstance(answer, m.Refused):
            assert answer.reason == list(Reason).index(Reason.BEYOND_HARDWARE) + 1


def test_no_library_is_checked_while_a_pulse_runs(start: Start) -> None:
    """A check takes longer than a pulse, and a stop over the link would wait behind it."""
    plant = ready(start)
    talker = plant.talker
    talker.done(m.Pulse(WATCHED.pulse_A, PULSE_TICKS, 0))
    answer = talker.upload(IMAGE)
    assert isinstance(answer, m.Refused)
    assert REASONS[answer.reason] is Reason.PULSING
    plant.step(PAIR_TICKS)
    talker.heard()
    talker.done(m.Commit())
