"""Devices with a motor of their own, in double precision and in single."""

from collections.abc import Callable
from typing import Any

import pytest

from controller.protocol.capacity import Hardware
from tests.benches.probed import ProbedDevice
from transopt.plant.coil import CoilModel

COIL = CoilModel(2.18, 3.1, 14.0, 12.0, 612.0, 100.0)
HARDWARE = Hardware(
    current_A=4.5,
    command_A=6.0,
    pole_least_Hz=700.0,
    pole_most_Hz=1600.0,
    over_current_A=6.0,
    has_coil=True,
    R_ohm=2.18,
    R_wh_K_W=3.1,
    R_ha_K_W=14.0,
    tau_w_s=12.0,
    tau_h_s=612.0,
    limit_C=100.0,
    ambient_C=30.0,
)
Start = Callable[..., ProbedDevice]
SINGLE = ("-DTD_REAL_FLOAT",)


def starting(flags: tuple[str, ...]) -> Start:
    def started(*, hardware: Hardware = HARDWARE, simulated: bool = True, **others: Any) -> ProbedDevice:
        return ProbedDevice(9, hardware, flags, simulated=simulated, **others)

    return started


@pytest.fixture(params=[(), SINGLE], ids=["double", "single"])
def start(request: pytest.FixtureRequest, c_compiler: None) -> Start:
    return starting(request.param)


@pytest.fixture
def single(c_compiler: None) -> Start:
    """In the precision of most boards alone: for the many cases of what `start` shows in both."""
    return starting(SINGLE)
