"""The black box: stable, real, with the zeros that physics asks for, and exact where the device has its order."""

import numpy as np
import pytest

from tests.benches.identification import DEFAULT
from tests.transopt.identify.device.conftest import INSTRUMENT, Respond
from transopt.base.errors import InputError
from transopt.identify.device.black_box import BlackBox, fit_black_box
from transopt.identify.device.chain import GripResponse
from transopt.identify.response_fit import RESOLVED
from transopt.identify.spectrum import TransferEstimate
from transopt.plant.chain import Link, chain
from transopt.plant.state_space import StateSpace


def four_masses() -> StateSpace:
    """A second resonance at 150 Hz that no drive chain has: order 8."""
    links = [Link(6e4, 8.0), Link(9e3, 0.5), Link(9e3, 15.0), Link(490.0, 15.0)]
    return chain([0.014, 0.02, 0.012, 0.010], links, force_per_current_N_A=1.25, stylus=1)


@pytest.mark.parametrize(
    ("plant", "grip_N", "order"),
    [
        (DEFAULT.plant(0.0), 0.0, 2),
        (DEFAULT.plant(1.0), 1.0, 6),
        (DEFAULT.plant(5.0), 5.0, 6),
        (four_masses(), 3.0, 8),
    ],
)
def test_a_device_of_its_order_is_found(plant: StateSpace, grip_N: float, order: int, respond: Respond) -> None:
    box = fit_black_box([respond(plant, grip_N)], INSTRUMENT, order)
    assert box.order == order
    assert 0.8 < box.scatter[0] < 1.25
    frequencies = np.geomspace(2, 800, 200)
    ratio = box.plants[0].response(frequencies) / plant.response(frequencies)
    assert np.all(np.abs(20 * np.log10(np.abs(ratio))) < 0.5)
    assert np.all(np.abs(np.degrees(np.angle(ratio))) < 2.5)


def test_the_order_is_found_where_none_is_stated(respond: Respond) -> None:
    box = fit_black_box([respond(DEFAULT.plant(3.0), 3.0)], INSTRUMENT)
    assert box.order == 6


@pytest.mark.parametrize("order", [2, 4, 8])
def test_whatever_the_order_the_model_is_stable_real_and_stands_still_under_a_constant_current(
    order: int, respond: Respond
) -> None:
    # In this noise no pole to spare is put so far below the band that a double cannot show the zeros.
    plant = fit_black_box([respond(DEFAULT.plant(3.0), 3.0, random=1)], INSTRUMENT, order).plants[0]
    assert plant.A.dtype == float
    assert np.all(np.linalg.eigvals(plant.A).real < 0)
    # Two zeros at s = 0: the acceleration falls with the square of the frequency, far below the slowest pole.
    slowest = np.abs(np.linalg.eigvals(plant.A)).min() / (2 * np.pi)
    high, low = np.abs(plant.response(np.array([1e-2, 1e-3]) * slowest))
    assert high / low == pytest.approx(100, rel=1e-2)


def test_between_grips_the_neighbours_blend_and_free_never_mixes_with_held() -> None:
    plants = tuple(DEFAULT.plant(grip) for grip in (1.0, 3.0, 5.0))
    box = BlackBox((1.0, 3.0, 5.0), plants, np.ones(3), 0.0)
    assert box.plant(3.0) is plants[1]
    frequencies = np.geomspace(2, 800, 50)
    low, middle, high = (plant.response(frequencies) for plant in plants)
    np.testing.assert_allclose(box.plant(3.5).response(frequencies), 0.75 * middle + 0.25 * high, rtol=1e-9)
    np.testing.assert_allclose(box.without(3.0).plant(3.0).response(frequencies), (low + high) / 2, rtol=1e-9)
    with pytest.raises(InputError, match="grip 0 N: outside the recorded grips"):
        box.plant(0.0)
    with pytest.raises(InputError, match="grip 6 N"):
        box.plant(6.0)


@pytest.mark.parametrize("order", [3, 0, 22])
def test_an_order_that_cannot_be_is_refused(order: int, pattern: GripResponse) -> None:
    with pytest.raises(InputError, match=f"--order {order}: must be even, 2 to 20"):
        fit_black_box([pattern], INSTRUMENT, order)


@pytest.mark.parametrize("seed", range(2))
def test_no_resonance_is_narrower_than_what_was_measured_between(
    seed: int, estimate: TransferEstimate, respond: Respond
) -> None:
    """A pole pair to spare hides between two bins, where noise alone would put it: 24 dB off at 6.4 Hz were seen."""
    plant = DEFAULT.plant(5.0)
    box = fit_black_box([respond(plant, 5.0, random=seed)], INSTRUMENT, 10)
    poles = np.linalg.eigvals(box.plants[0].A)
    resonant = poles[poles.imag > 0]
    f = estimate.frequencies_Hz
    spacing_Hz = np.exp(np.interp(np.log(np.abs(resonant) / (2 * np.pi)), np.log(f), np.log(np.gradient(f))))
    assert np.all(-2 * resonant.real >= 2 * np.pi * RESOLVED * spacing_Hz * (1 - 1e-6))
    fine = np.geomspace(2, 800, 4000)
    ratio = box.plants[0].response(fine) / plant.response(fine)
    assert np.all(np.abs(20 * np.log10(np.abs(ratio))) < 1)
