"""What a spectrum of errors makes of a tap: against the error of a simulated tap, and what such a file refuses."""

import numpy as np
import pytest
from pydantic import ValidationError

from transopt.scene.model_error import AtUse, ModelError, Predicted

DT_S = 1e-4


def pulse(peak_A: float = 2.0) -> np.ndarray:
    times = DT_S * np.arange(600)
    return peak_A * np.exp(-times / 5e-3) * np.sin(2 * np.pi * 100 * times)


def test_the_error_of_a_resonance_that_the_model_lacks_is_that_of_the_missing_answer() -> None:
    """Against the time domain: the answer of the missing part to the pulse, by its convolution."""
    frequencies = np.geomspace(1, 4999, 200)
    s, w = 2j * np.pi * frequencies, 2 * np.pi * 250.0
    missing = 0.5 * s**2 / (s**2 + 0.2 * w * s + w**2)  # m/s^2/A
    error = ModelError(grips_N=[3.0], frequencies_Hz=frequencies.tolist(), power=[(np.abs(missing) ** 2).tolist()])
    given, energy, size = pulse(), 5000.0, 6000
    lines = 2j * np.pi * np.fft.rfftfreq(size, DT_S)
    answer = np.fft.irfft(np.fft.rfft(given, size) * 0.5 * lines**2 / (lines**2 + 0.2 * w * lines + w**2), size)
    expected = np.sqrt(np.sum(answer**2) / energy)
    assert error.nrmse(3.0, given, DT_S, energy) == pytest.approx(expected, rel=0.02)


def test_between_recorded_grips_the_power_is_linear_and_the_free_device_apart() -> None:
    error = ModelError(grips_N=[0.0, 1.0, 3.0], frequencies_Hz=[10.0], power=[[100.0], [1.0], [3.0]])
    found = [error.nrmse(grip, pulse(), DT_S, 1.0) ** 2 for grip in (0.0, 0.5, 1.0, 2.0, 3.0)]
    np.testing.assert_allclose(np.array(found) / found[2], [100.0, 1.0, 1.0, 2.0, 3.0], rtol=1e-9)


def test_what_taps_missed_at_full_current_is_added_by_grip_and_peak() -> None:
    taps = [AtUse(grip_N=grip, peak_A=peak, excess=0.01 * grip * peak) for grip in (1.0, 3.0) for peak in (1.0, 4.0)]
    error = ModelError(grips_N=[3.0], frequencies_Hz=[10.0], power=[[0.0]], at_use=taps)
    for grip, peak, expected in ((1.0, 4.0, 0.04), (3.0, 2.0, 0.06), (2.0, 4.0, 0.08), (3.0, 9.0, 0.12)):
        given = pulse()
        given *= peak / np.abs(given).max()
        assert error.nrmse(grip, given, DT_S, 1.0) == pytest.approx(expected)


@pytest.mark.parametrize(
    "spoilt",
    [
        {"frequencies_Hz": [20.0, 10.0]},
        {"power": [[1.0]]},
        {"power": [[1.0, -1.0]]},
        {"frequencies_Hz": [0.0, 10.0]},
        {"power": [[1.0, float("nan")]]},
    ],
)
def test_what_is_no_spectrum_is_refused(spoilt: dict[str, object]) -> None:
    whole = {"grips_N": [3.0], "frequencies_Hz": [10.0, 20.0], "power": [[1.0, 1.0]]}
    ModelError.model_validate(whole)
    with pytest.raises(ValidationError):
        ModelError.model_validate({**whole, **spoilt})


def test_the_worst_tap_is_named() -> None:
    predicted = Predicted(speeds_m_s=[0.1, 0.2], grips_N=[1.0, 3.0], nrmse=[[0.01, 0.02], [0.05, 0.03]])
    assert predicted.worst == (0.05, 0.1, 3.0)
