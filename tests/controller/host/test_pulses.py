"""What a library's model says of a test pulse, against the simulator, which is not the model."""

from dataclasses import replace

import numpy as np
import pytest

from controller.device.device_file import BUILT_IN, Accelerometer, DeviceFile, Limits
from controller.host.pulses import NO_PATH_M, pulse_numbers
from controller.servo.settings import Settings
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import device_of
from controller.sim.user import StillHand
from transopt.library.library import Library

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
