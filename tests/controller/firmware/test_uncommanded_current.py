"""A current that nobody commanded: the hardware's own guard counts its heat, over a restart too."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.benches.compiled import DT_S
from tests.benches.device import REST, Talker
from tests.benches.probed import ProbedDevice
from tests.controller.firmware.test_attacks import COIL, HARDWARE

pytestmark = pytest.mark.usefixtures("c_compiler")

HEAT_TICKS, UPDATES = 10_000, 100

Start = Callable[..., ProbedDevice]


@pytest.fixture(params=[(), ("-DTD_REAL_FLOAT",)], ids=["double", "single"])
def start(request: pytest.FixtureRequest) -> Start:
    def started(heat_C: tuple[float, float] | None = (30.0, 30.0)) -> ProbedDevice:
        return ProbedDevice(9, HARDWARE, request.param, simulated=True, heat_C=heat_C)

    return started


def heated_C(current_A: float) -> tuple[float, float]:
    """Winding and housing after the current has flowed for `HEAT_TICKS`, from 30 C."""
    coil = replace(COIL, ambient_C=30.0, start_winding_C=30.0, start_housing_C=30.0)
    nodes = coil.simulate(np.full((1, UPDATES), (current_A + 0.02) ** 2), np.full(UPDATES, HEAT_TICKS * DT_S / UPDATES))
    winding_C, housing_C = (float(node[0, -1]) for node in nodes)
    return winding_C, housing_C


@pytest.mark.parametrize(
    ("measured_A", "flows_A"),
    [(5.9, 5.9), (6.1, 6.1), (-9.0, 9.0), (math.nan, HARDWARE.over_current_A), (math.inf, HARDWARE.over_current_A)],
)
def test_the_hardwares_guard_counts_whatever_is_measured(start: Start, measured_A: float, flows_A: float) -> None:
    talker = Talker(start())
    talker.step(HEAT_TICKS, replace(REST, current_A=measured_A))
    assert talker.device.coil_C() == pytest.approx(heated_C(flows_A), abs=0.5)


def test_a_restart_cools_no_coil(start: Start) -> None:
    assert start(heat_C=(180.0, 95.0)).coil_C() == pytest.approx((180.0, 95.0))
    # A guard never keeps more than its ceiling: beyond it nothing is known.
    assert start(heat_C=(1001.0, 1001.0)).coil_C() == pytest.approx(start(heat_C=None).coil_C())
