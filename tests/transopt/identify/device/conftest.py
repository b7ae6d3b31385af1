"""What four sweeps give: the frequencies and the noise of responses that the tests know exactly."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.benches.identification import ACCELEROMETER_HZ, AMPLIFIER, DT_S, Rig
from transopt.identify.device.chain_fit import GripResponse
from transopt.identify.device.response import Instrument, sampled_response
from transopt.identify.spectrum import TransferEstimate, Trial, estimate_transfer
from transopt.plant.state_space import StateSpace

INSTRUMENT = Instrument(DT_S, AMPLIFIER, ACCELEROMETER_HZ)
Respond = Callable[..., GripResponse]


@pytest.fixture(scope="session")
def estimate() -> TransferEstimate:
    runs = Rig().sweeps((3.0,))
    return estimate_transfer(
        [Trial(run.name, run.require("current", ""), run.require("acceleration", "")) for run in runs]
    )


@pytest.fixture(scope="session")
def respond(estimate: TransferEstimate) -> Respond:
    """Response of a plant at a grip with normal noise of the stated deviation times `noise`."""
    deviation = GripResponse(3.0, estimate).deviation

    def make(
        plant: StateSpace, grip_N: float, noise: float = 1.0, random: np.random.Generator | int = 0
    ) -> GripResponse:
        draw = np.random.default_rng(random)
        truth, _ = sampled_response(plant, INSTRUMENT, estimate.frequencies_Hz)
        error = draw.standard_normal(truth.size) + 1j * draw.standard_normal(truth.size)
        response = truth + noise * deviation * error
        known = {"deviation": deviation, "degrees": np.full(truth.size, 1e3)}
        return GripResponse(grip_N, replace(estimate, response=response, **known))

    return make
