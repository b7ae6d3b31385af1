"""What a device is given: cool commands as far as there is room, and what the model says of its test pulses."""

from dataclasses import replace

import numpy as np
import pytest

from controller.device.device_file import BUILT_IN, Accelerometer, DeviceFile, Limits
from controller.host.payload import Load, fitted
from controller.host.pulses import NO_PATH_M, pulse_numbers
from controller.protocol.capacity import Capacity
from controller.protocol.configuration import configuration_of
from controller.protocol.image import bank_of, image_of
from controller.servo.settings import Settings
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import device_of
from controller.sim.user import StillHand
from tests.benches.compiled import DT_S, SETTINGS, TAIL, cooled, smooth_bank
from transopt.library.library import Library

BANK = cooled(smooth_bank(2, 2, 61))
COUNT = 2 * 2 * 61
GIVEN = Load(SETTINGS, configuration_of(SETTINGS), image_of(BANK, DT_S, SETTINGS.lead_s, TAIL))


@pytest.mark.parametrize(
    ("samples", "bits", "words"),
    [
        (2 * COUNT, 16, ""),
        (2 * COUNT - 1, 8, "in 8 bit"),
        (3 * COUNT // 2, 8, "in 8 bit"),
        (3 * COUNT // 2 - 1, 0, "scaled down instead"),
        (COUNT, 0, "scaled down instead"),
        (COUNT - 1, 16, ""),
    ],
)
def test_second_waveforms_go_where_there_is_room(samples: int, bits: int, words: str) -> None:
    """What does not even hold the first ones is refused as ever, by the session."""
    found, said = fitted(GIVEN, Capacity(samples=samples))
    bank, head = bank_of(found.image)
    assert head["cool_bits"] == bits
    assert said.count("\n") == 0
    assert words in said
    assert bool(words) == bool(said)
    np.testing.assert_array_equal(bank.command_A, bank_of(GIVEN.image)[0].command_A)
    assert (found.settings, found.configuration) == (GIVEN.settings, GIVEN.configuration)
    assert fitted(found, Capacity(samples=samples)) == (found, "")


def test_a_library_without_second_waveforms_stays_as_it_is() -> None:
    plain = replace(GIVEN, image=image_of(smooth_bank(2, 2, 61), DT_S, SETTINGS.lead_s, TAIL))
    for samples in (COUNT, COUNT - 1):
        assert fitted(plain, Capacity(samples=samples)) == (plain, "")


SILENT = replace(
    Imperfections().sensors, accelerometer_noise_g_rtHz=0.0, current_noise_A=0.0, grip_noise_N=0.0, count_m=1e-9
)


@pytest.mark.parametrize("sensed", [True, False])
def test_the_prediction_is_what_the_simulated_device_does(library: Library, sensed: bool) -> None:
    device = DeviceFile(accelerometer=Accelerometer(sensor=sensed))
    s = Settings.of(library, **pulse_numbers(device, library))
    assert s.pulse_grip_N == pytest.approx(tuple(library.grips_N))
    for j, grip_N in enumerate(s.pulse_grip_N):
        simulator = Simulator(
            device_of(library.scene()),
            StillHand(grip_N),
            s.dt_s,
            imperfections=Imperfections(crossover_A=0.0, sensors=SILENT),
            steps=1,
        )
        readings = []
        for tick in range(s.pulse_ticks + 1):
            readings.append(simulator.readings())
            simulator.advance(s.pulse_A if tick < s.pulse_ticks else 0.0)
        pushed = readings[s.pulse_skip_ticks : s.pulse_skip_ticks + s.pulse_push_ticks]
        acceleration = np.mean([r.acceleration_m_s2 for r in pushed]) / s.pulse_A
        path_m = (readings[-1].encoder_counts - readings[0].encoder_counts) * 1e-9 / s.pulse_A
        assert s.pulse_acceleration[j] == pytest.approx(acceleration, rel=0.01)
        assert s.pulse_path_m[j] == (NO_PATH_M if sensed else pytest.approx(path_m, rel=0.01))


def test_the_pulse_is_no_larger_than_the_hardware_allows(library: Library) -> None:
    assert pulse_numbers(BUILT_IN, library)["pulse_A"] == pytest.approx(0.1)
    assert pulse_numbers(DeviceFile(hardware=Limits(pulse_A=0.05)), library)["pulse_A"] == pytest.approx(0.05)
