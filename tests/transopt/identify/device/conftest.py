"""What four sweeps give: the frequencies and the noise of responses that the tests know exactly."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.benches.identification import ACCELEROMETER_HZ, AMPLIFIER, DEFAULT, DT_S, Rig
from transopt.base.signals import FloatArray
from transopt.identify.device.chain import GripResponse
from transopt.identify.device.identify import Settings
from transopt.identify.device.response import Instrument, responses, sampled_response
from transopt.identify.device.result import Kind
from transopt.identify.device.trials import sort_trials
from transopt.identify.spectrum import TransferEstimate
from transopt.plant.state_space import StateSpace

INSTRUMENT = Instrument(DT_S, AMPLIFIER, ACCELEROMETER_HZ)
SETTINGS = Settings(nominal=DEFAULT, scene_plant=DEFAULT.plant, amplifier=AMPLIFIER, kind=Kind.DRIVE, random_starts=1)
Respond = Callable[..., GripResponse]


@pytest.fixture(scope="session")
def pattern() -> GripResponse:
    """Give the response of four sweeps at 3 N, from the command to current and acceleration."""
    return sort_trials(Rig().sweeps((3.0,)), [], AMPLIFIER, None).grips[0].response


@pytest.fixture(scope="session")
def estimate(pattern: GripResponse) -> TransferEstimate:
    return pattern.estimate


def _normal(random: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Complex, of unit variance."""
    draw = random.standard_normal((2, *shape)) / np.sqrt(2)
    return np.asarray(draw[0] + 1j * draw[1])


@pytest.fixture(scope="session")
def respond(pattern: GripResponse) -> Respond:
    """What the sweeps of a plant at a grip show with normal noise of the stated deviation times `noise`."""

    def make(
        plant: StateSpace,
        grip_N: float,
        noise: float = 1.0,
        random: np.random.Generator | int = 0,
        instrument: Instrument = INSTRUMENT,
    ) -> GripResponse:
        draw, data = np.random.default_rng(random), pattern.data
        truth, _ = sampled_response(plant, instrument, pattern.estimate.frequencies_Hz)
        error = np.sqrt(2) * pattern.deviation * _normal(draw, truth.shape)
        known = {"deviation": pattern.deviation, "degrees": np.full(truth.size, 1e3)}
        estimate = replace(pattern.estimate, response=truth + noise * error, **known)
        value, _ = responses(plant, instrument, data.frequencies_Hz.ravel())
        value = value.reshape(2, *data.frequencies_Hz.shape)
        # A right side N H + R^H e of each trial, where N = R^H R and e is the noise of its lines.
        roots = np.linalg.cholesky(data.normal + 1e-30 * np.eye(3) * np.abs(data.normal).max())
        size = (data.normal.shape[0], 2, *data.frequencies_Hz.shape)
        lines = np.einsum("kbij,kobj->kobi", roots, _normal(draw, size)) * np.sqrt(data.noise)[:, :, None]
        right = np.einsum("kbij,obj->kobi", data.normal, value) + noise * lines * data.used
        return replace(pattern, grip_N=grip_N, estimate=estimate, data=replace(data, right=right))

    return make
