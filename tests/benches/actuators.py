"""Scenes of whole actuators with invented numbers: an LRA that is linear or not, and a plant of ten states."""

import json
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy import integrate

from transopt.base.signals import FloatArray
from transopt.design.solve import solve
from transopt.library.library import Library
from transopt.plant.amplifier import Amplifier
from transopt.plant.moving_coil import Inertial, VoiceCoil
from transopt.plant.state_space import Input, Output, StateSpace
from transopt.scene.scene import Scene

LRA: dict[str, Any] = {
    "kind": "inertial",
    "resonance_Hz": 150,
    "quality": 8,
    "moving_mass_kg": 0.003,
    "case_mass_kg": 0.1,
    "force_factor_N_A": 0.8,
    "R_ohm": 8.0,
    "L_H": 1e-4,
}


def model(**changed: object) -> str:
    """Section of a scene with the LRA."""
    return "\n[model]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in {**LRA, **changed}.items())


HEAD = """
description = "clicks, numbers invented"
amplifier = "ideal"
hand_over_samples = 1
[time]
dt_s = 1e-4
stages = 300
lead_s = 0.0
[[targets]]
name = "click"
shape = "burst"
frequency_Hz = 150
cycles = 1.5
peak_m_s2 = {peak:g}
"""
LIMITS = """
[limits]
voltage_V = 3.0
"""
MATRICES_MODEL = """
[model]
kind = "state_space"
file = "{file}"
"""


def lra_scene(peak_m_s2: float = 5.0, **changed: object) -> str:
    """An LRA by its datasheet, with other numbers in its model."""
    return HEAD.format(peak=peak_m_s2) + model(**changed) + LIMITS + "stroke_m = 6e-4\n"


def file_scene(file: str, more: str = "", limits: str = "", peak_m_s2: float = 5.0) -> str:
    """A plant by a file of its matrices."""
    return HEAD.format(peak=peak_m_s2) + MATRICES_MODEL.format(file=file) + more + LIMITS + limits


def ten_states() -> StateSpace:
    """Five resonances between 60 and 900 Hz side by side, driven by a voltage.

    Each is gain s^2 / (s^2 + w / Q s + w^2), what a mass on a spring does to the case around it, in states of one
    size; "position" is the first one's displacement.
    """
    f, quality, gain = (
        np.array([60.0, 140, 310, 520, 900]),
        np.array([4.0, 8, 12, 10, 15]),
        np.array([4, 9, -3, 2, 4]),
    )
    w = 2 * np.pi * f
    A, B, C = np.zeros((10, 10)), np.zeros((10, 1)), np.zeros((1, 10))
    for j in range(5):
        at = slice(2 * j, 2 * j + 2)
        A[at, at] = [[0.0, w[j]], [-w[j], -w[j] / quality[j]]]
        B[2 * j + 1, 0] = w[j]
        # gain s^2 / (s^2 + w / Q s + w^2) = gain (1 - what the section's own states make up)
        C[0, at] = -gain[j] * np.array([1.0, 1.0 / quality[j]])
    position = np.eye(1, 10) / w[0] ** 2
    return StateSpace(
        A=A,
        B=B,
        C=C,
        D=np.array([[float(gain.sum())]]),
        outputs={
            "position": Output(position, "m", "position"),
            "velocity": Output(position @ A, "m/s", "velocity"),
            "pull": Output(np.eye(1, 10, 3), "N"),
        },
        driven_by=Input("voltage", "V"),
    )


CLICKS = """\
name = "clicks"
description = "clicks of a phone's LRA"
amplifier = "ideal"
hand_over_samples = 1

[time]
dt_s = 2.0833333333333333e-05  # 48 kHz
stages = 960
lead_s = 0.0

[[targets]]
name = "click 150 Hz"
shape = "burst"
frequency_Hz = 150
cycles = 1.5
peak_m_s2 = 10.0

[[targets]]
name = "tick, soft"
shape = "burst"
frequency_Hz = 250
cycles = 2
peak_m_s2 = 2.0
"""
CLICKS += (
    model()
    + """
[limits]
voltage_V = 3.0
stroke_m = 6e-4
"""
)


@cache
def clicks() -> Library:
    """Library of two named targets, solved once in a process: the click needs all of the 3 V, the tick less."""
    return solve(Scene.model_validate(tomllib.loads(CLICKS)))


NONLINEAR = """
amplifier = "ideal"
hand_over_samples = 1

[time]
dt_s = 2e-4
stages = 80
lead_s = 0.0

[[targets]]
name = "click"
shape = "burst"
frequency_Hz = 150
cycles = 2
peak_m_s2 = 12.0
"""
NONLINEAR += (
    model(L_H=5e-4)
    + """
[model.nonlinear]
force_factor = "BL*(1 - 0.3*(x/0.6e-3)**2)"

[limits]
voltage_V = 12.0
stroke_m = 6e-4

[weights]
after_s = 6e-3
"""
)


def nonlinear_scene(folder: Path, *swaps: tuple[str, str]) -> Path:
    """Write a scene with an LRA whose force factor falls by 30 % at full stroke; swaps of its text come first."""
    text = NONLINEAR
    for old, new in swaps:
        assert old in text
        text = text.replace(old, new)
    path = folder / "lra.toml"
    path.write_text(text)
    return path


def by_newton(
    kind: Inertial | VoiceCoil, state: FloatArray, u: float, stiffening: float, friction_N: float
) -> tuple[list[float], float]:
    """dx/dt and the acceleration of a nonlinear coil, by the equations written out with the laws' numbers.

    The force factor is BL (1 - 0.3 (x / 0.6 mm)^2), the stiffness K (1 + stiffening (x / 1 mm)^2), the friction
    friction_N tanh(v / 0.05 m/s).
    """
    x, v, *more = state
    m, case, BL0 = kind.moving_mass_kg, kind.case_mass_kg, kind.force_factor_N_A
    mu = m if case is None else m * case / (m + case)
    if isinstance(kind, Inertial):
        w = 2 * np.pi * kind.resonance_Hz
        K0, c = mu * w**2, mu * w / kind.quality
    else:
        K0, c = kind.stiffness_N_m, kind.damping_N_s_m
    BL, K = BL0 * (1 - 0.3 * (x / 0.6e-3) ** 2), K0 * (1 + stiffening * (x / 1e-3) ** 2)
    if kind.input == "current":
        i = u
    else:
        assert kind.R_ohm is not None
        i = more[0] if kind.L_H else (u - BL * v) / kind.R_ohm
    force = BL * i - K * x - c * v - friction_N * np.tanh(v / 0.05)
    rates = [v, force / mu]
    if kind.input == "voltage" and kind.L_H:
        rates.append((u - kind.R_ohm * i - BL * v) / kind.L_H)
    return rates, force / (m if case is None else case)


def integrated(
    kind: Inertial | VoiceCoil,
    amplifier: Amplifier | None,
    commands: FloatArray,
    dt_s: float,
    stiffening: float = 0.0,
    friction_N: float = 0.0,
) -> FloatArray:
    """(N,) acceleration at the switching instants, by DOP853 from rest."""
    order = 3 if kind.input == "voltage" and kind.L_H else 2
    state, found = np.zeros(order + (amplifier is not None)), []

    def moved(z: FloatArray, c: float) -> tuple[list[float], float]:
        own, u = (z, c) if amplifier is None else (z[:-1], z[-1])
        return by_newton(kind, own, u, stiffening, friction_N)

    def rate(_: float, z: FloatArray, c: float) -> list[float]:
        return moved(z, c)[0] + ([] if amplifier is None else [amplifier.rate_rad_s * (c - z[-1])])

    for c in commands:
        found.append(moved(state, c)[1])
        state = integrate.solve_ivp(rate, (0, dt_s), state, "DOP853", rtol=1e-12, atol=1e-14, args=(c,)).y[:, -1]
    return np.array(found)
