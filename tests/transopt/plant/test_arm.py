"""The arm: kinematics by differences, inertia by energy, and its linear plant by the defining properties."""

import numpy as np
import pytest
from pydantic import ValidationError

from tests.benches.arms import drawn_place, phantom
from transopt.base.errors import InputError
from transopt.plant.arm import Arm, Place
from transopt.plant.matrices import Matrices

Q = np.array([0.3, 0.5, 0.4])
STEP = 1e-6


def test_jacobian_is_the_derivative_of_the_tip() -> None:
    linkage = phantom().linkage
    by_angle = [(linkage.tip_m(Q + STEP * e) - linkage.tip_m(Q - STEP * e)) / (2 * STEP) for e in np.eye(3)]
    np.testing.assert_allclose(linkage.jacobian(Q), np.transpose(by_angle), atol=1e-9)


def test_inertia_is_that_of_rods_cut_into_pieces() -> None:
    linkage, rate, pieces = phantom().linkage, np.array([1.0, -2.0, 3.0]), 4000

    def point(q: np.ndarray, along: float, fore: bool) -> np.ndarray:
        """A point of one of the rods."""
        upper = linkage.upper_arm_m if fore else along
        beyond = along if fore else 0.0
        reach = upper * np.cos(q[1]) + beyond * np.sin(q[2])
        height = upper * np.sin(q[1]) - beyond * np.cos(q[2])
        return np.array([reach * np.cos(q[0]), reach * np.sin(q[0]), height])

    energy = 0.5 * linkage.base_kg_m2 * rate[0] ** 2
    for fore, length, mass in (
        (False, linkage.upper_arm_m, linkage.upper_arm_kg),
        (True, linkage.forearm_m, linkage.forearm_kg),
    ):
        places = (np.arange(pieces) + 0.5) / pieces * length
        ends = [np.array([point(Q + sign * STEP * rate, s, fore) for s in places]) for sign in (1, -1)]
        speeds = (ends[0] - ends[1]) / (2 * STEP)
        energy += 0.5 * mass / pieces * float(np.sum(speeds**2))
    assert 0.5 * rate @ linkage.inertia(Q) @ rate == pytest.approx(energy, rel=1e-6)


def test_centrifugal_torques_keep_the_energy() -> None:
    linkage, rate = phantom().linkage, np.array([1.0, -2.0, 3.0])
    slope = (linkage.inertia(Q + STEP * rate) - linkage.inertia(Q - STEP * rate)) / (2 * STEP)
    # q' (dI/dt q' + I q'') = d/dt of twice the energy less q' I q'': without torque the energy stays.
    assert rate @ linkage.centrifugal(Q, rate) == pytest.approx(rate @ slope @ rate / 2, rel=1e-7)


@pytest.mark.parametrize("seed", range(6))
def test_linear_plant_is_passive(seed: int) -> None:
    arm, lot = phantom(), np.random.default_rng(seed)
    plant = arm.plant_at(2.0, drawn_place(arm, lot))
    assert (plant.order, plant.motors, plant.tracked) == (18, 3, 3)
    assert np.linalg.eigvals(plant.A).real.max() < 0


def test_slow_force_moves_stylus_and_tip_alike() -> None:
    arm = phantom()
    place = arm.place()
    plant = arm.plant(2.0)
    # At rest under a constant current the arm of the hand carries the force of the motors.
    rest = np.linalg.solve(plant.A, -plant.B)
    _, force = arm.at_tip(place)
    K, _ = arm.links(2.0)
    np.testing.assert_allclose(place.frame @ K[2] @ place.frame.T @ rest[6:9], force, atol=1e-9 * np.abs(force).max())


def test_frame_is_right_handed_with_the_normal_first() -> None:
    for normal in ([0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.6, -0.64, 0.48]):
        frame = Place(Q, np.array(normal)).frame
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(frame) == pytest.approx(1.0)
        np.testing.assert_allclose(frame[0], normal)


def test_accelerations_turn_with_the_surface() -> None:
    arm, one, other = phantom(), Place(Q, np.array([0.0, 0.0, 1.0])), Place(Q, np.array([0.6, 0.0, 0.8]))
    responses = [place.frame.T @ arm.plant_at(2.0, place).response(np.array([80.0]))[0] for place in (one, other)]
    np.testing.assert_allclose(responses[0], responses[1], rtol=1e-9)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"postures_deg": [[0.0, 0.0, -90.0]]}, "postures_deg 1: singular"),
        ({"postures_deg": [[0.0, 25.0, 35.0], [0.0, 30.0, 120.0]]}, "postures_deg 2: singular"),
        ({"normals": [[0.0, 0.0, 0.0]]}, "a normal of length zero"),
        ({"stylus": [0.0, 0.0, 0.0]}, "stylus: a direction of length zero"),
        ({"ratios": [11.0, 0.0, 11.0]}, "greater than 0"),
        ({"motor_shares": [1.0, 1.0, 1.2]}, "less than or equal to 1"),
        ({"normals": [[np.nan, 0.0, 1.0]]}, "finite number"),
    ],
)
def test_refuses_what_is_no_arm(changed: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        phantom(**changed)


def test_refuses_a_hand_that_does_not_hold() -> None:
    with pytest.raises(InputError, match=r"grid\.grips_N: model\.kind = arm is held by a hand"):
        phantom().plant(0.0)


def test_refuses_a_hand_that_is_not_passive() -> None:
    arm: Arm = phantom()
    hand = arm.hand.model_copy(update={"skin_stiffness_N_m": -1.0})
    with pytest.raises(InputError, match=r"model\.hand: stiffness -1: must be >= 0"):
        arm.model_copy(update={"hand": hand}).plant(2.0)


def test_a_scene_of_matrices_states_a_plant_with_several_motors() -> None:
    plant = phantom().plant(2.0)
    stated = Matrices.of(plant)
    again = stated.plant(0.0, None)
    assert stated.shares == [1.0] * 3
    assert stated.directions == 3
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(again, name), getattr(plant, name))
