"""The coil on a bench supply against the exact solution of its two nodes."""

import numpy as np
import pytest

from controller.sim.heating import heat_record, true_coil
from transopt.base.errors import InputError
from transopt.plant.coil import CoilModel, effective_square
from transopt.scene.scene import Scene


@pytest.fixture(scope="module")
def coil(scene: Scene) -> CoilModel:
    found = scene.coil()
    assert found is not None
    return found


def test_against_the_exact_solution(coil: CoilModel) -> None:
    truth = true_coil(coil, 0.2, 3)
    assert truth.R_ha_K_W != coil.R_ha_K_W
    assert truth.R_wh_K_W == pytest.approx(coil.R_wh_K_W, rel=0.2)
    taken = heat_record(truth, 1.1, 900.0, 600.0, 1.0, noise_K=0.0, current_noise_A=0.0, seed=0)
    square = effective_square(taken["current_A"][:-1])
    winding, housing = truth.simulate(square[None], np.ones(square.size))
    np.testing.assert_allclose(taken["winding_C"], winding[0], atol=1e-3)
    np.testing.assert_allclose(taken["housing_C"], housing[0], atol=1e-3)


def test_too_hot(coil: CoilModel) -> None:
    with pytest.raises(InputError, match=r"would pass its limit of 100 C after \d+ s at 2 A; lower --current"):
        heat_record(coil, 2.0, 3600.0, 10.0, 1.0, noise_K=0.0, seed=0)
