"""Scenes of whole actuators with invented numbers, and a plant of ten states that no kind describes."""

import numpy as np

from transopt.plant.state_space import Input, Output, StateSpace

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
LRA_MODEL = """
[model]
kind = "inertial"
resonance_Hz = 150
quality = 8
moving_mass_kg = 0.003
case_mass_kg = 0.1
force_factor_N_A = 0.8
R_ohm = 8.0
L_H = 1e-4
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


def lra_scene(peak_m_s2: float = 5.0) -> str:
    """An LRA by its datasheet."""
    return HEAD.format(peak=peak_m_s2) + LRA_MODEL + LIMITS + "stroke_m = 6e-4\n"


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
