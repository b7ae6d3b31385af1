"""A scene whose plant is nonlinear: an LRA whose force factor falls by 30 % at full stroke."""

from pathlib import Path

SCENE = """
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

[model]
kind = "inertial"
resonance_Hz = 150
quality = 8
moving_mass_kg = 0.003
case_mass_kg = 0.1
force_factor_N_A = 0.8
R_ohm = 8.0
L_H = 5e-4

[model.nonlinear]
force_factor = "BL*(1 - 0.3*(x/0.6e-3)**2)"

[limits]
voltage_V = 12.0
stroke_m = 6e-4

[weights]
after_s = 6e-3
"""


def stated(tmp_path: Path, *swaps: tuple[str, str]) -> Path:
    text = SCENE
    for old, new in swaps:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "lra.toml"
    path.write_text(text)
    return path
