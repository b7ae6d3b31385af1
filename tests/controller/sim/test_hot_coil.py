"""The coil of a simulated device: its heat, and its taps when it is hot, blends with the cool commands."""

from dataclasses import replace

import numpy as np
import pytest

import transopt as to
from controller.host.payload import payload_of
from controller.protocol.image import bank_of
from controller.servo.interface import Notice
from controller.sim.heating import heat_record, true_coil
from controller.sim.played_tap import play_tap
from controller.sim.simulated_tap import SimulatedTap
from controller.waveforms.bank import Method, bank
from controller.waveforms.prediction import Prediction, predict
from tests.benches.oracle.blend import blend_at
from tests.benches.oracle.servo import Servo
from transopt.base.errors import InputError
from transopt.base.signals import nrmse
from transopt.library.library import Library
from transopt.plant.coil import CoilModel, effective_square
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene

SPEED_M_S, GRIP_N = 0.3, 2.0


@pytest.fixture(scope="module")
def cooled(scene: Scene) -> Library:
    """Two speeds and two grips, over 20 ms."""
    small = {"grid.speeds_m_s": [0.2, 0.4], "grid.grips_N": [1.0, 5.0], "time.stages": 200, "weights.after_s": 0.01}
    return to.solve(with_values(scene, {**small, "grid.cool_share": 0.36}))


def servo_at(library: Library, left: float) -> Servo:
    """A servo whose coil may take this part of the first transient's norm."""
    given = payload_of(library)
    servo = Servo(given.settings, bank_of(given.image)[0])
    play = blend_at(servo.bank, SPEED_M_S, GRIP_N)
    rise_K = servo.guard.rise_K(left * play.transient_A, play.feedback_A, len(play.samples_A) + 1, 1.0)
    servo.guard.winding_C = servo.guard.housing_C = servo.guard.play_limit_C - rise_K
    return servo


@pytest.mark.parametrize("left", [2.0, 0.8, 0.4])
def test_what_is_played_is_the_prediction_of_the_blend(cooled: Library, left: float) -> None:
    servo = servo_at(cooled, left)
    played = play_tap(cooled, servo, SimulatedTap(SPEED_M_S, GRIP_N))
    assert played.played
    assert not played.faults
    assert (Notice.SCALED_FOR_HEAT in played.notices) == (left < 1)
    assert (servo.cooled > 0.0) == (left < 1)
    assert (servo.scale < 0.99) == (left < 0.5)
    meant = predict(cooled, SPEED_M_S, GRIP_N, 1.0, servo.scale, servo.cooled)

    def off(prediction: Prediction) -> float:
        truth = np.interp(meant.times_s, played.times_s, played.acceleration_m_s2)
        return float(nrmse(truth, prediction.whole_m_s2))

    assert off(meant) < 0.05
    assert left > 1 or off(meant) < off(played.prediction)


def test_methods_that_blend_the_library_carry_its_second_commands(cooled: Library) -> None:
    for method in Method:
        table = bank(cooled, method)
        assert (table.cool_command_A is not None) == (method in (Method.BILINEAR, Method.NEAREST, Method.BLIND))
        plain = bank(replace(cooled, cool=None), method)
        assert plain.cool_command_A is None
        np.testing.assert_array_equal(table.command_A, plain.command_A)
    play = blend_at(bank(cooled), SPEED_M_S, GRIP_N)
    wanted = cooled.cool.at(SPEED_M_S, GRIP_N).transient_command
    np.testing.assert_allclose(play.cool_samples_A, wanted, rtol=0, atol=1e-12)
    assert play.cool_transient_A < play.transient_A


def test_a_blend_is_predicted_only_of_a_library_that_has_one(cooled: Library) -> None:
    with pytest.raises(InputError, match="no cool commands"):
        predict(replace(cooled, cool=None), SPEED_M_S, GRIP_N, 1.0, 1.0, 0.5)


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
