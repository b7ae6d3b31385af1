"""What sampling makes of a continuous device: against the time domain, and its derivatives against differences."""

from dataclasses import replace

import numpy as np
import pytest

from tests.benches.identification import ACCELEROMETER_HZ, AMPLIFIER, DEFAULT, DT_S, sampled_run
from transopt.identify.device.chain import HAND, SHARED, Coordinates, chain_of, log_slopes
from transopt.identify.device.response import INSTRUMENT, Instrument, Slope, responses, sampled_response
from transopt.plant.amplifier import Amplifier
from transopt.plant.state_space import StateSpace

AMPLIFIERS = (
    None,
    AMPLIFIER,
    replace(AMPLIFIER, delay_s=0.0),
    replace(AMPLIFIER, delay_s=2.3e-4),
    Amplifier(300, 1e-4, 6),
)


@pytest.mark.parametrize("amplifier", AMPLIFIERS)
@pytest.mark.parametrize("grip_N", [0.0, 3.0])
def test_the_ratio_of_sampled_spectra_is_that_of_a_simulated_record(
    grip_N: float, amplifier: Amplifier | None
) -> None:
    command = np.zeros(4000)
    command[5:9] = [1.0, -0.4, 0.3, -0.9]  # no net impulse, so that the free device comes to rest too
    current, acceleration, _ = sampled_run(DEFAULT.plant(grip_N), command, amplifier)
    frequencies = np.fft.rfftfreq(command.size, DT_S)[4:1900]
    measured = np.fft.rfft(acceleration)[4:1900] / np.fft.rfft(current)[4:1900]
    modelled, _ = sampled_response(DEFAULT.plant(grip_N), Instrument(DT_S, amplifier, ACCELEROMETER_HZ), frequencies)
    np.testing.assert_allclose(modelled, measured, rtol=1e-8, atol=1e-8 * np.abs(modelled).max())


@pytest.mark.parametrize("sensed", [None, ACCELEROMETER_HZ])
@pytest.mark.parametrize("amplifier", AMPLIFIERS)
def test_derivatives_agree_with_differences(amplifier: Amplifier | None, sensed: float | None) -> None:
    instrument, frequencies = Instrument(DT_S, amplifier, sensed), np.geomspace(2, 4500, 40)
    parameters, step = DEFAULT.parameters(3.0), 1e-5
    plant, slopes = log_slopes(parameters, 1.25)
    _, derivatives = sampled_response(plant, instrument, frequencies, slopes)
    for j in range(len(SHARED) + len(HAND)):
        factor = np.ones(parameters.size)
        factor[j] = np.exp(step)
        up, down = (
            sampled_response(chain_of(parameters * side, 1.25), instrument, frequencies)[0]
            for side in (factor, 1 / factor)
        )
        difference = (up - down) / (2 * step)
        size = np.abs(up).max()
        np.testing.assert_allclose(derivatives[j], difference, rtol=1e-5, atol=1e-7 * size)


@pytest.mark.parametrize("amplifier", [None, AMPLIFIER])
def test_the_direct_feed_of_a_rigid_device_is_sampled_and_differentiated(amplifier: Amplifier | None) -> None:
    one = np.ones((1, 1))
    plant = StateSpace(-50 * one, one, -40 * one, 2 * one)
    slope = Slope(0 * one, 0 * one, 0 * one, one)
    instrument, frequencies = Instrument(DT_S, amplifier), np.geomspace(2, 4500, 20)
    value, derivatives = sampled_response(plant, instrument, frequencies, (slope,))
    more, _ = sampled_response(replace(plant, D=3 * one), instrument, frequencies)
    np.testing.assert_allclose(derivatives[0], more - value, rtol=1e-12)
    np.testing.assert_allclose(derivatives[0], 1.0, rtol=1e-12)  # the current read is the current felt


def test_an_output_that_happens_to_be_zero_has_slopes_all_the_same() -> None:
    one = np.ones((1, 1))
    plant = StateSpace(-50 * one, one, 0 * one, 0 * one)
    slope = Slope(0 * one, 0 * one, one, 0 * one)
    _, derivatives = sampled_response(plant, Instrument(DT_S, AMPLIFIER, 2500.0), np.array([10.0]), (slope,))
    assert np.abs(derivatives[0, 0]) > 1e-3


@pytest.mark.parametrize("held_N", [(), (3.0,), (1.0, 2.0, 5.0)])
def test_unknowns_and_stated_parameters_tell_of_one_device(held_N: tuple[float, ...]) -> None:
    coordinates = Coordinates(held_N)
    unknowns = coordinates.of(DEFAULT)
    device = coordinates.device(unknowns, 1.25)
    np.testing.assert_allclose(device.shared, DEFAULT.shared, rtol=1e-12)
    for grip in held_N:
        np.testing.assert_allclose(device.hand_at(grip), DEFAULT.hand_at(grip), rtol=1e-12)
    names, values, matrix = coordinates.stated(unknowns)
    assert len(names) == values.size == matrix.shape[0]
    random = np.random.default_rng(0).uniform(-1, 1, unknowns.size)
    up, down = (coordinates.stated(unknowns + side * 1e-6 * random)[1] for side in (1, -1))
    np.testing.assert_allclose(matrix @ random, (up - down) / 2e-6, rtol=1e-6, atol=1e-7 * np.abs(values).max())


@pytest.mark.parametrize("amplifier", [AMPLIFIER, replace(AMPLIFIER, delay_s=2.3e-4)])
def test_each_signal_over_the_command_is_that_of_a_simulated_record(amplifier: Amplifier) -> None:
    command = np.zeros(40000)
    command[5:9] = [1.0, -0.4, 0.3, -0.9]
    recorded = sampled_run(DEFAULT.plant(3.0), command, amplifier)
    frequencies = np.fft.rfftfreq(command.size, DT_S)[40:19000:7]
    instrument = Instrument(DT_S, amplifier, ACCELEROMETER_HZ)
    modelled, _ = responses(DEFAULT.plant(3.0), instrument, frequencies, position=True)
    for one, values in zip(modelled, recorded, strict=True):
        measured = np.fft.rfft(values)[40:19000:7] / np.fft.rfft(command)[40:19000:7]
        np.testing.assert_allclose(one, measured, rtol=1e-7, atol=1e-7 * np.abs(one).max())


def test_slopes_by_the_instrument_agree_with_differences() -> None:
    frequencies, plant = np.geomspace(2, 4500, 40), DEFAULT.plant(3.0)
    instrument = Instrument(DT_S, AMPLIFIER, 1500.0, gain=1.2, late=0.7, amplifier_gain=0.9)
    _, slopes = responses(plant, instrument, frequencies, position=True, moved=INSTRUMENT)
    step = 1e-6

    def moved(name: str, by: float) -> Instrument:
        amplifier = instrument.amplifier
        assert amplifier is not None
        return {
            "amplifier_pole": replace(instrument, amplifier=replace(amplifier, pole_Hz=1050.0 * np.exp(by))),
            "amplifier_delay": replace(instrument, amplifier=replace(amplifier, delay_s=68e-6 + 1e-4 * by)),
            "amplifier_gain": replace(instrument, amplifier_gain=0.9 * np.exp(by)),
            "accelerometer_pole": replace(instrument, accelerometer_Hz=1500.0 * np.exp(by)),
            "late": replace(instrument, late=0.7 + by),
            "gain": replace(instrument, gain=1.2 * np.exp(by)),
        }[name]

    for name, slope in zip(INSTRUMENT, slopes, strict=True):
        up, down = (responses(plant, moved(name, by), frequencies, position=True)[0] for by in (step, -step))
        difference = (up - down) / (2 * step) / (1e-4 if name == "amplifier_delay" else 1.0)
        for one, by_difference, size in zip(slope, difference, np.abs(up).max(axis=1), strict=True):
            np.testing.assert_allclose(one, by_difference, rtol=1e-5, atol=1e-6 * max(size, np.abs(one).max()))
