"""Kinds of plant: what each names is what its masses do, and what a limit can be put on."""

import numpy as np
import pytest
from scipy import integrate

from transopt.base.errors import InputError
from transopt.plant.discretise import discretise
from transopt.plant.drive import Drive
from transopt.plant.fourth_order import FourthOrder
from transopt.plant.hand import HandSection
from transopt.plant.kind import PlantKind
from transopt.plant.motor import Tip
from transopt.plant.second_order import SecondOrder

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
