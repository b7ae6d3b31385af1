"""A phone's linear resonant actuator that a voltage drives, with named targets: a library of schema 3."""

import tomllib
from functools import cache

from transopt.design.solve import solve
from transopt.library.library import Library
from transopt.scene.scene import Scene

SCENE = """\
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

[model]
kind = "inertial"
resonance_Hz = 150
quality = 8
moving_mass_kg = 0.003
case_mass_kg = 0.1
force_factor_N_A = 0.8
R_ohm = 8.0
L_H = 1e-4

[limits]
voltage_V = 3.0
stroke_m = 6e-4
"""


@cache
def clicks() -> Library:
    """Solved once in a process; the click needs all of the 3 V, the tick less."""
    return solve(Scene.model_validate(tomllib.loads(SCENE)))
