"""Extreme scenes, each the default scene with other numbers."""

from collections.abc import Iterator
from typing import Any

import problems
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene

TWO_BY_TWO = {"grid.speeds_m_s": [0.1, 0.3], "grid.grips_N": [1.0, 5.0]}


def at_the_tip(force_N_A: float, moving_kg: float, stiffness_N_m: float, damping_N_s_m: float) -> dict[str, Any]:
    """Keys of a drive that is stated at the tip."""
    tip = {
        "force_per_current_N_A": force_N_A,
        "moving_mass_kg": moving_kg,
        "stiffness_N_m": stiffness_N_m,
        "damping_N_s_m": damping_N_s_m,
    }
    return {"motor": None, "transmission": None, "tip": tip}


def struck(
    mass_kg: float, spring_N_m: float, damper_N_s_m: float, contact: tuple[float, float, float]
) -> dict[str, Any]:
    """Keys of an object; the contact by stiffness, exponent and damping [s/m]."""
    keys = ("object_mass_kg", "object_stiffness_N_m", "object_damping_N_s_m")
    keys += ("contact_stiffness_N_m", "contact_exponent", "contact_damping_s_m")
    return {
        f"recordings.simulated.{key}": value
        for key, value in zip(keys, (mass_kg, spring_N_m, damper_N_s_m, *contact), strict=True)
    }


def amplifier(pole_Hz: float, delay_s: float, command_limit_A: float = 6.0) -> dict[str, Any]:
    """Keys of an amplifier."""
    return {
        "amplifier.pole_Hz": pole_Hz,
        "amplifier.delay_s": delay_s,
        "amplifier.command_limit_A": command_limit_A,
    }


def wall(stiffness_N_m: float, damping_N_s_m: float, latency_ticks: int, yields: str) -> dict[str, Any]:
    """Keys of a virtual wall and of the hand before it."""
    made = {"stiffness_N_m": stiffness_N_m, "damping_N_s_m": damping_N_s_m, "latency_ticks": latency_ticks}
    return {"feedback": made, "hand.yields": yields}


HARD: dict[str, dict[str, Any]] = {
    "1 kg moved, 0.5 kg stylus": {
        **at_the_tip(30.0, 1.0, 1e6, 200.0),
        **struck(2.0, 1e5, 100.0, (1e6, 1.1, 0.5)),
        **amplifier(500.0, 1e-4, 12.0),
        "model.stylus_mass_kg": 0.5,
        "model.hand.mass_kg": 0.3,
    },
    "0.2 g moved, 0.5 g stylus": {
        **at_the_tip(0.2, 2e-4, 5e3, 0.2),
        **struck(5e-3, 2e3, 1.0, (5e3, 1.1, 0.5)),
        "model.stylus_mass_kg": 5e-4,
        "model.hand.mass_kg": 1e-3,
        "grid.grips_N": [0.5],
    },
    "transmission of 1e8 N/m": at_the_tip(1.25, 0.014, 1e8, 50.0),
    "grips of 0.5 and 30 N": {"grid.grips_N": [0.5, 30.0]},
    "5 mm/s and 1.5 m/s": {"grid.speeds_m_s": [0.005, 1.5]},
    "object of 1e6 N/m": {
        **struck(5.0, 1e6, 200.0, (1e6, 1.0, 0.05)),
        "recordings.simulated.rate_Hz": 1e5,
        "grid.speeds_m_s": [0.02, 0.1],
    },
    "object that rings for ever": {
        **struck(0.5, 5e4, 0.0, (2e5, 1.1, 0.0)),
        "grid.speeds_m_s": [0.05, 0.1],
    },
    "ticks of 50 us": {"time.dt_s": 5e-5, "time.stages": 1600},
    "amplifier of 80 Hz, 1 ms late": amplifier(80.0, 1e-3),
    "amplifier of 200 kHz": amplifier(2e5, 0.0),
    "3.2 ms late, no lead": {**amplifier(1050.0, 3.2e-3), "time.lead_s": 0.0},
    "rail of 5 V": {"limits.supply_V": 5.0},
    "slew of 800 A/s": {"limits.slew_A_per_s": 800.0},
    "0.05 K of headroom": {
        "thermal.start_winding_C": 97.0,
        "thermal.start_housing_C": 90.0,
        "thermal.headroom_K": 0.05,
    },
    "wall of 600 N/m, two ticks late": {
        **wall(600.0, 0.2, 2, "brakes"),
        **amplifier(1050.0, 68e-6, 9.0),
        "limits.beta": 4.8,
    },
    "wall before a hand that decays": wall(200.0, 0.0, 0, "decays"),
    "hand that pulls back": {"hand.yields": "pulls"},
    "hand that brakes after 15 ms": {"hand.yields": "brakes", "hand.intention_s": 0.015},
    "least worst of three grips": {
        "robust": {"grip_spread": 0.3, "samples": 3, "minimise": "worst"},
        "grid.speeds_m_s": [0.3],
    },
    "intensity asked for": {"weights.objective": "intensity", "grid.speeds_m_s": [0.3, 0.5]},
    "price on heat": {"weights.heat_price": 1e-4},
}


def hard() -> Iterator[tuple[str, Scene]]:
    """All extreme scenes by name, with one noise-free recording at each node."""
    clean = {
        "recordings.simulated.noise_g_rtHz": 0.0,
        "recordings.simulated.speed_spread": 0.0,
        "recordings.simulated.repeats": 1,
        "recordings.simulated.range_g": 1e3,
        "implausible": "accept",
    }
    for name, values in HARD.items():
        yield name, with_values(problems.load("wood_on_foam"), {**TWO_BY_TWO, **clean, **values})
