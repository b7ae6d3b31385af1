"""Actuators with a moving coil: Newton's and Kirchhoff's laws with two free masses and the coil's own current.

What is integrated here has other states than the project's: the positions of both masses in space, their velocities,
and the coil's current where an inductance keeps it. Only what the datasheet states is common to both.
"""

from typing import Any

import numpy as np
import pytest
from scipy import integrate, optimize

from transopt.plant.discretise import discretise
from transopt.plant.kind import PlantKind
from transopt.plant.matrices import Matrices
from transopt.plant.moving_coil import Inertial, VoiceCoil
from transopt.plant.state_space import StateSpace

# Invented actuators of the usual sizes: an LRA on a jig, and a voice coil on the ground or in a case.
F0_HZ, Q, MASS_KG, CASE_KG, BL_N_A, R_OHM = 150.0, 8.0, 0.003, 0.1, 0.8, 8.0
STIFFNESS_N_M, DAMPING_N_S_M = 400.0, 0.7
DT_S = 1e-4
NOBODY_N = 0.0


def inertial(**changed: Any) -> Inertial:
    stated = {
        "resonance_Hz": F0_HZ,
        "quality": Q,
        "moving_mass_kg": MASS_KG,
        "case_mass_kg": CASE_KG,
        "force_factor_N_A": BL_N_A,
        "R_ohm": R_OHM,
    }
    return Inertial(kind="inertial", **{**stated, **changed})


def voice_coil(**changed: Any) -> VoiceCoil:
    stated = {
        "stiffness_N_m": STIFFNESS_N_M,
        "damping_N_s_m": DAMPING_N_S_M,
        "moving_mass_kg": 0.02,
        "force_factor_N_A": 5.0,
        "R_ohm": R_OHM,
    }
    return VoiceCoil(kind="voice_coil", **{**stated, **changed})


def springs_of_inertial() -> tuple[float, float]:
    """Spring and damper that give f0 and Q to two free masses, searched for by the eigenvalues of these."""

    def off(logs: np.ndarray) -> np.ndarray:
        k, c = np.exp(logs)
        A = np.zeros((4, 4))
        A[:2, 2:] = np.eye(2)
        for row, mass, sign in ((2, MASS_KG, -1.0), (3, CASE_KG, 1.0)):
            A[row] = sign * np.array([k, -k, c, -c]) / mass
        pole = max(np.linalg.eigvals(A), key=lambda p: p.imag)
        return np.array([abs(pole) / (2 * np.pi * F0_HZ) - 1, -abs(pole) / (2 * pole.real) / Q - 1])

    found = optimize.root(off, np.log([2e3, 0.5]), tol=1e-13)
    assert found.success
    k, c = np.exp(found.x)
    return float(k), float(c)


K_INERTIAL, C_INERTIAL = springs_of_inertial()
# name -> the kind, its spring, its damper, its moving mass, its case or None, its force factor
MADE: dict[str, tuple[Any, float, float, float, float | None, float]] = {
    "inertial": (inertial, K_INERTIAL, C_INERTIAL, MASS_KG, CASE_KG, BL_N_A),
    "voice_coil": (voice_coil, STIFFNESS_N_M, DAMPING_N_S_M, 0.02, None, 5.0),
    "voice_coil in a case": (
        lambda **changed: voice_coil(case_mass_kg=0.08, **changed),
        STIFFNESS_N_M,
        DAMPING_N_S_M,
        0.02,
        0.08,
        5.0,
    ),
}
INPUTS = {
    "current": {"input": "current"},
    "voltage": {"input": "voltage"},
    "voltage, L": {"input": "voltage", "L_H": 1e-4},
    "voltage, large L": {"input": "voltage", "L_H": 5e-3},
}


class Bench:
    """The actuator by itself in space: states z_m, z_c, their velocities, and the coil's current where it is one."""

    def __init__(self, name: str, by: str) -> None:
        _, self.k, self.c, self.m, self.M, self.BL = MADE[name]
        self.by, self.L_H = INPUTS[by]["input"], float(INPUTS[by].get("L_H", 0.0))

    def current_A(self, y: np.ndarray, u: float) -> float:
        """Through the coil: given, or what the voltage less the back-EMF drives, or a state."""
        if self.by == "current":
            return u
        return float(y[4]) if self.L_H > 0 else (u - self.BL * (y[2] - y[3])) / R_OHM

    def force_N(self, y: np.ndarray, u: float) -> float:
        """On the moving part; the case or the ground feels its opposite."""
        return self.BL * self.current_A(y, u) - self.k * (y[0] - y[1]) - self.c * (y[2] - y[3])

    def slope(self, y: np.ndarray, u: float) -> np.ndarray:
        force = self.force_N(y, u)
        case = 0.0 if self.M is None else -force / self.M
        electric = (u - R_OHM * y[4] - self.BL * (y[2] - y[3])) / self.L_H if self.L_H > 0 else 0.0
        return np.array([y[2], y[3], force / self.m, case, electric])

    def acceleration_m_s2(self, y: np.ndarray, u: float) -> float:
        """Take the moving part where the ground holds the other, else the case, away from the moving part."""
        slope = self.slope(y, u)
        return float(slope[2] if self.M is None else -slope[3])

    def run(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, 5) states and (N,) accelerations at the instants at which each input begins to be held."""
        state, course, felt = np.zeros(5), [], []
        for u in inputs:
            course.append(state)
            felt.append(self.acceleration_m_s2(state, u))
            state = integrate.solve_ivp(
                lambda t, y, u=u: self.slope(y, u), (0, DT_S), state, method="DOP853", rtol=1e-12, atol=1e-17
            ).y[:, -1]
        return np.array(course), np.array(felt)


COMMAND = np.concatenate([np.full(40, 1.0), np.full(30, -0.6), np.zeros(30)])


@pytest.mark.parametrize("by", INPUTS)
@pytest.mark.parametrize("name", MADE)
def test_outputs_are_those_of_two_masses_and_a_coil(name: str, by: str) -> None:
    kind: PlantKind = MADE[name][0](**INPUTS[by])
    plant = kind.plant(NOBODY_N, None)
    assert plant.driven_by == kind.driven_by
    assert kind.driven_by.name == INPUTS[by]["input"]
    stage = discretise(plant, None, DT_S, outputs=tuple(plant.outputs))
    found = stage.motion(COMMAND)
    states, acceleration = Bench(name, by).run(COMMAND)
    expected = {"position": states[:, 0] - states[:, 1], "velocity": states[:, 2] - states[:, 3]}
    if "L_H" in INPUTS[by]:
        expected["current"] = states[:, 4]
    assert set(plant.outputs) == set(expected)
    for output, course in expected.items():
        np.testing.assert_allclose(found.outputs[output], course, atol=1e-9 * np.abs(course).max(), err_msg=output)
    np.testing.assert_allclose(found.acceleration_m_s2, acceleration, atol=1e-9 * np.abs(acceleration).max())


@pytest.mark.parametrize("by", INPUTS)
@pytest.mark.parametrize("name", MADE)
def test_it_is_stable_and_its_terminals_are_passive(name: str, by: str) -> None:
    plant = MADE[name][0](**INPUTS[by]).plant(NOBODY_N, None)
    bench = Bench(name, by)
    assert np.linalg.eigvals(plant.A).real.max() < 0
    f = np.geomspace(0.1, 2e4, 300)
    velocity = of_output(plant, "velocity", f)
    if bench.by == "current":
        terminals = R_OHM + bench.BL * velocity  # impedance
    elif "current" in plant.outputs:
        terminals = of_output(plant, "current", f)  # admittance
    else:
        terminals = (1 - bench.BL * velocity) / R_OHM
    assert terminals.real.min() > 0


def of_output(plant: StateSpace, name: str, frequencies_Hz: np.ndarray) -> np.ndarray:
    """(m,) response of a named output."""
    return StateSpace(plant.A, plant.B, plant.outputs[name].row, np.zeros((1, 1))).response(frequencies_Hz)


class TestOfTheDatasheet:
    def test_f0_and_Q_are_read_off_the_response(self) -> None:
        plant = inertial(input="current").plant(0.0, None)
        f = np.linspace(0.7, 1.4, 140_001) * F0_HZ
        position = of_output(plant, "position", f)
        # The displacement lags by 90 degrees at f0, where it is Q times that at rest; the velocity falls by 3 dB at
        # two frequencies f0 / Q apart.
        at = int(np.argmin(np.abs(np.angle(position) + np.pi / 2)))
        assert f[at] == pytest.approx(F0_HZ, rel=1e-5)
        rest = abs(of_output(plant, "position", np.array([1e-3]))[0])
        assert abs(position[at]) / rest == pytest.approx(Q, rel=1e-6)
        velocity = np.abs(of_output(plant, "velocity", f))
        above = f[velocity >= velocity.max() / np.sqrt(2)]
        assert F0_HZ / (above[-1] - above[0]) == pytest.approx(Q, rel=1e-3)


class TestStruck:
    @pytest.mark.parametrize("by", INPUTS)
    @pytest.mark.parametrize("name", MADE)
    def test_a_blow_from_outside_accelerates_what_it_meets(self, name: str, by: str) -> None:
        """The other mass feels it through spring and damper only; the terminals are open, so no coil has a part."""
        make, k, c, m, M, _ = MADE[name]
        plant = make(**INPUTS[by]).plant(0.0, None, struck=True)
        f = np.geomspace(1, 1e3, 60)
        s = 2j * np.pi * f
        joint = k + c * s
        if M is None:
            expected = s**2 / (m * s**2 + joint)
        else:  # M z'' = 1 - joint (z - z_m), m z_m'' = joint (z - z_m)
            expected = s**2 / (M * s**2 + joint - joint**2 / (m * s**2 + joint))
        np.testing.assert_allclose(plant.response(f), expected, rtol=1e-8)


class TestInACase:
    def test_the_stylus_takes_the_mass_along(self) -> None:
        """z_nom is no part of the position of a mass against its case; a library keeps that."""
        held, floating = voice_coil().plant(0.0, None), voice_coil(case_mass_kg=0.08).plant(0.0, None)
        assert not held.moves_in_a_case
        assert floating.moves_in_a_case
        assert held.stored(("position", "velocity")) == {}
        stored = {name: each["follows"] for name, each in floating.stored(()).items()}
        assert stored == {"position": "", "velocity": ""}


class TestMatrices:
    def test_the_matrices_of_a_coil_are_that_coil(self) -> None:
        plant = inertial(L_H=1e-4).plant(0.0, None)
        outputs = {name: {"row": o.row[0].tolist(), "unit": o.unit} for name, o in plant.outputs.items()}
        again = Matrices(
            kind="state_space",
            input="voltage",
            A=plant.A.tolist(),
            B=plant.B[:, 0].tolist(),
            C=plant.C[0].tolist(),
            D=float(plant.D[0, 0]),
            outputs=outputs,
        ).plant(0.0, None)
        assert again.driven_by == plant.driven_by
        names = ("position", "velocity", "current")
        found, expected = (discretise(p, None, DT_S, outputs=names).motion(COMMAND) for p in (again, plant))
        np.testing.assert_array_equal(found.acceleration_m_s2, expected.acceleration_m_s2)
        for name in names:
            np.testing.assert_array_equal(found.outputs[name], expected.outputs[name])
            assert again.outputs[name].unit == plant.outputs[name].unit
