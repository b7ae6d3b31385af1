"""Kinds of plant: what each names is what its masses do, and what a limit can be put on."""

import numpy as np
import pytest
from scipy import integrate

from transopt.base.errors import InputError
from transopt.plant.chain import Link, chain
from transopt.plant.discretise import discretise
from transopt.plant.drive import Drive
from transopt.plant.fourth_order import FourthOrder, fourth_order
from transopt.plant.hand import HandSection, LinearParameter
from transopt.plant.kind import PlantKind
from transopt.plant.motor import Tip
from transopt.plant.second_order import SecondOrder, second_order
from transopt.scene.scene import Scene

TIP = Tip(force_per_current_N_A=1.25, moving_mass_kg=0.014, stiffness_N_m=6e4, damping_N_s_m=8.0)
HAND = HandSection(
    mass_kg=0.01, skin_stiffness_N_m=9000, skin_damping_N_s_m=15, arm_stiffness_N_m=490, arm_damping_N_s_m=15
)
KINDS: dict[str, tuple[PlantKind, tuple[str, ...]]] = {
    "second_order": (SecondOrder(kind="second_order"), ("stylus",)),
    "fourth_order": (FourthOrder(kind="fourth_order", stylus_mass_kg=0.026, hand=HAND), ("stylus", "hand")),
    "drive": (Drive(kind="drive", stylus_mass_kg=0.026, hand=HAND), ("motor", "stylus", "hand")),
}


def forces(name: str, z: np.ndarray, dz: np.ndarray, plant_input: float) -> np.ndarray:
    """Accelerations of the masses by Newton's law, written out for each kind."""
    skin = 9000 * (z[-2] - z[-1]) + 15 * (dz[-2] - dz[-1]) if z.size > 1 else 0.0
    arm = 490 * z[-1] + 15 * dz[-1]
    match name:
        case "second_order":
            mass, damping, stiffness = 0.215 - 0.00328 * 3, 6.713 + 0.369 * 3, 75.65 + 14.72 * 3
            return np.array([1.25 * plant_input - damping * dz[0] - stiffness * z[0]]) / mass
        case "fourth_order":
            return np.array([1.25 * plant_input - skin, skin - arm]) / [0.04, 0.01]
        case _:
            joint = 6e4 * (z[0] - z[1]) + 8 * (dz[0] - dz[1])
            return np.array([1.25 * plant_input - joint, joint - skin, skin - arm]) / [0.014, 0.026, 0.01]


@pytest.mark.parametrize("name", KINDS)
def test_named_outputs_are_the_motion_of_the_masses(name: str) -> None:
    kind, masses = KINDS[name]
    plant = kind.plant(3.0, TIP)
    extra = ("transmission stretch",) if name == "drive" else ()
    names = [f"{mass} {what}" for what in ("position", "velocity") for mass in masses]
    stage = discretise(plant, None, 1e-4, outputs=(*names, *extra, "position", "velocity"))
    command = np.concatenate([np.full(30, 3.0), np.full(30, -2.0)])
    found = stage.motion(command).outputs

    n, state, course = len(masses), np.zeros(2 * len(masses)), []
    for current in command:
        course.append(state)
        state = integrate.solve_ivp(
            lambda t, y, i=current: np.concatenate([y[n:], forces(name, y[:n], y[n:], i)]),
            (0, 1e-4), state, method="DOP853", rtol=1e-12, atol=1e-16,
        ).y[:, -1]  # fmt: skip
    expected = np.array(course).T
    for each, row in zip(names, expected, strict=True):
        np.testing.assert_allclose(found[each], row, atol=1e-9 * np.abs(row).max())
    np.testing.assert_allclose(found["position"], expected[0], atol=1e-9 * np.abs(expected[0]).max())
    np.testing.assert_allclose(found["velocity"], expected[n], atol=1e-9 * np.abs(expected[n]).max())
    if name == "drive":
        stretch = expected[0] - expected[1]
        np.testing.assert_allclose(found["transmission stretch"], stretch, atol=1e-7 * np.abs(stretch).max())


@pytest.mark.parametrize("name", ["fourth_order", "drive"])
def test_the_free_device_has_no_hand(name: str) -> None:
    plant = KINDS[name][0].plant(0.0, TIP)
    with pytest.raises(InputError, match="it has no output hand position; it has position, velocity"):
        plant.output("hand position")


FREQUENCIES_HZ = np.array([1.0, 4.0, 5.0, 80.0, 390.0])


@pytest.mark.parametrize("grip_N", [0.0, 1.0, 3.0, 5.0, 20.0])
def test_second_order_is_the_seeds_equations_3_to_5(grip_N: float) -> None:
    mass, damping, stiffness = 0.215 - 0.00328 * grip_N, 6.713 + 0.369 * grip_N, 75.65 + 14.72 * grip_N
    s = 2j * np.pi * FREQUENCIES_HZ
    expected = 1.25 * s**2 / (mass * s**2 + damping * s + stiffness)
    found = second_order(grip_N, force_per_current_N_A=1.25).response(FREQUENCIES_HZ)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def hand_of(*lines: tuple[float, float]) -> HandSection:
    """The hand with these constants and slopes over grip."""
    parameters = (LinearParameter(constant=constant, per_newton=slope) for constant, slope in lines)
    return HandSection(**dict(zip(HandSection.model_fields, parameters, strict=True)))


def test_fourth_order_is_two_masses_by_elimination() -> None:
    hand = hand_of((0.05, 0), (900, 100), (2, 0.5), (150, 20), (5, 1))
    s = 2j * np.pi * FREQUENCIES_HZ
    skin = 900 + 3 * 100 + (2 + 3 * 0.5) * s
    arm = 150 + 3 * 20 + (5 + 3) * s
    stylus = 0.026 + 0.014
    # Force balance of the hand mass eliminated by hand.
    dynamic = stylus * s**2 + skin - skin**2 / (0.05 * s**2 + skin + arm)
    model = fourth_order(3.0, hand=hand, stylus_mass_kg=0.026, moving_mass_kg=0.014, force_per_current_N_A=1.3)
    np.testing.assert_allclose(model.response(FREQUENCIES_HZ), 1.3 * s**2 / dynamic, rtol=1e-11)


@pytest.mark.parametrize("grip_N", [1.0, 3.0, 5.0])
def test_default_device_has_the_slopes_and_the_resonance_of_design(scene: Scene, grip_N: float) -> None:
    plant = scene.plant(grip_N)
    gain = np.abs(plant.response(FREQUENCIES_HZ)) / 9.80665
    low = 20 * np.log10(gain[1] / gain[0]) / np.log10(4 / 1)
    middle = 20 * np.log10(gain[3] / gain[2]) / np.log10(80 / 5)
    assert 36 <= low <= 40
    assert 14 <= middle <= 24
    if grip_N == 3:
        assert 18 <= middle <= 22
    assert gain[3] == pytest.approx(3.1, abs=0.15)
    sweep = np.linspace(100, 1000, 1801)
    magnitude = np.abs(plant.response(sweep)) / 9.80665
    assert sweep[np.argmax(magnitude)] == pytest.approx(390, abs=8)
    assert 8 <= magnitude.max() <= 9


def test_drive_at_the_tip_is_a_datasheet_motor_through_its_ratio(scene: Scene) -> None:
    tip = scene.drive_at_tip()
    assert tip.force_per_current_N_A == pytest.approx(1.25, rel=1e-3)
    assert tip.moving_mass_kg == pytest.approx(0.014, rel=1e-3)


@pytest.mark.parametrize("grip_N", [0.0, 1.0, 5.0])
def test_chains_are_passive(scene: Scene, grip_N: float) -> None:
    """No pole in the right half plane, and a force on the motor mass never gains energy (Re of mobility >= 0)."""
    plant = scene.plant(grip_N)
    assert np.linalg.eigvals(plant.A).real.max() <= 1e-9
    s = 2j * np.pi * np.geomspace(0.1, 5e3, 200)
    states = np.linalg.solve(s[:, None, None] * np.eye(plant.order) - plant.A, plant.B)[:, :, 0]
    motor_velocity = (plant.Cv @ states.T)[0]
    assert motor_velocity.real.min() >= -1e-12


def test_encoder_sees_the_motor_mass(scene: Scene) -> None:
    plant = scene.plant(3.0)
    s = 2j * np.pi * np.array([10.0, 200.0])
    states = np.linalg.solve(s[:, None, None] * np.eye(6) - plant.A, plant.B)[:, :, 0]
    np.testing.assert_allclose((plant.Ce @ states.T)[0] * s, states[:, 3:].sum(axis=1), rtol=1e-10)


def test_free_device_moves_as_its_total_mass(scene: Scene) -> None:
    plant = scene.plant(0.0)
    slow, tip = plant.response(np.array([0.5]))[0], scene.drive_at_tip()
    assert plant.order == 4
    assert slow.real == pytest.approx(tip.force_per_current_N_A / (tip.moving_mass_kg + 0.026), rel=1e-4)


def test_struck_stylus_gets_newtons_not_amperes(scene: Scene) -> None:
    """At frequencies far above every mode only the stylus mass resists."""
    fast = scene.plant(3.0, struck=True).response(np.array([1e6]))[0]
    assert fast.real == pytest.approx(1 / 0.026, rel=1e-3)


def test_parameters_that_are_not_passive_are_named() -> None:
    with pytest.raises(InputError, match=r"mass 1 of the chain = -0.0.* kg: must be > 0"):
        second_order(70.0, force_per_current_N_A=1.0)
    with pytest.raises(InputError, match=r"damping_N_s_m of link 1 .* = -1: must be >= 0"):
        chain([1.0], [Link(1.0, -1.0)], force_per_current_N_A=1.0, stylus=0)
    one = (1.0, 0.0)
    bad = hand_of(one, (5.0, -2.0), one, one, one)
    with pytest.raises(InputError, match=r"stiffness_N_m of link 1 .* = -1"):
        fourth_order(3.0, hand=bad, stylus_mass_kg=0.1, moving_mass_kg=0.1, force_per_current_N_A=1.0)
