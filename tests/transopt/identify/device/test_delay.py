"""A delay of the acceleration's channel: found to the sample, taken out, and none found where there is none."""

import numpy as np
import pytest

from tests.benches.identification import AMPLIFIER, DEFAULT, DT_S, Rig, mismatched, spoilt
from tests.transopt.identify.device.conftest import SETTINGS
from transopt.identify.device.cleaned import delay_samples, without_delay
from transopt.identify.device.identify import identify
from transopt.identify.device.trials import instrument_of
from transopt.identify.measurement import Measurement


@pytest.fixture(scope="module")
def runs() -> list[Measurement]:
    return Rig(mismatched(0.1, 5)).sweeps((1.0, 3.0))


def late(run: Measurement, samples: int) -> Measurement:
    noise = 0.03 * np.random.default_rng(samples).standard_normal(samples)
    return spoilt(run, "acceleration", lambda x: np.append(noise, x[: x.size - samples]))


@pytest.mark.parametrize("samples", [0, 3, 80, 500, 2000])
def test_found_to_a_sample_by_a_device_ten_percent_off(runs: list[Measurement], samples: int) -> None:
    shifted = [late(run, samples) for run in runs]
    found = delay_samples(shifted, AMPLIFIER, DEFAULT.plant, instrument_of(shifted, AMPLIFIER))
    # Two milliseconds and less may be the device's own.
    assert abs(found - (samples if samples * DT_S > 2e-3 else 0)) <= 1


def test_taken_out_of_every_channel(runs: list[Measurement]) -> None:
    back = without_delay([late(runs[0], 500)], 500)[0]
    kept = runs[0].require("acceleration").values.size - 500
    for name in ("command", "current", "acceleration"):
        np.testing.assert_array_equal(back.require(name).values, runs[0].require(name).values[:kept])


def test_identified_behind_fifty_milliseconds(runs: list[Measurement]) -> None:
    result = identify([late(run, 500) for run in runs], [], SETTINGS)
    assert any("50 ms (500 samples) later than any device answers" in str(found) for found in result.findings)
    assert max(result.chosen.recorded.values()) < 0.02
