"""Finds implausible numbers, mostly due to a wrong unit: key, value, usual range, and the unit probably meant.

A mass in grams, a speed in cm/s or a stroke in millimetres is a valid number, and the optimum for it is proven like
any other. The bounds here are those of hand-held devices, small actuators and shakers, clearly wider than what is on
sale; a mistaken unit is off by a factor of a hundred or more. `transopt.recordings.plausible` checks recordings.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.units import unit_of
from transopt.plant.coil import HOUSING_C, WINDING_C
from transopt.plant.state_space import StateSpace
from transopt.recordings.plausible import HAND_M_S, HAND_N
from transopt.scene.plausible_response import implausible_response

ACCEPT = 'correct it; if it is right, --accept takes it, or implausible = "accept" above the first table of the scene'
KELVIN_0_C = -273.15
FREQUENCIES_HZ = np.geomspace(2.0, 3e3, 150)  # at which the response of a plant stated by matrices is checked
# Unit of a key -> units entered by mistake, each with its size in the key's unit.
MISTAKEN = {
    "kg": {"g": 1e-3, "mg": 1e-6},
    "m": {"mm": 1e-3, "um": 1e-6, "cm": 1e-2},
    "m/s": {"cm/s": 1e-2, "mm/s": 1e-3},
    "m/s^2": {"mm/s^2": 1e-3},
    "g": {"m/s^2": 1 / 9.80665, "mg": 1e-3},
    "N": {"gf": 9.80665e-3, "mN": 1e-3},
    "A": {"mA": 1e-3},
    "V": {"mV": 1e-3},
    "A/s": {"A/ms": 1e3},
    "s": {"ms": 1e-3, "us": 1e-6},
    "Hz": {"kHz": 1e3},
    "ohm": {"mohm": 1e-3, "kohm": 1e3},
    "H": {"mH": 1e-3, "uH": 1e-6},
    "N m/A": {"mN m/A": 1e-3},
    "kg m^2": {"g cm^2": 1e-7},
    "N/m": {"N/mm": 1e3, "mN/m": 1e-3},
    "N s/m": {"N s/mm": 1e3, "mN s/m": 1e-3},
    "N/A": {"mN/A": 1e-3},
    "K/W": {"K/mW": 1e3, "mK/W": 1e-3},
    "1/m": {"1/mm": 1e3},
    "g/sqrt(Hz)": {"ug/sqrt(Hz)": 1e-6},
}
# Ending of a dotted key, or of one with a kind in place of its table -> smallest and largest plausible number.
PLAUSIBLE = {
    "grid.speeds_m_s": HAND_M_S,
    "grid.grips_N": HAND_N,
    "grip_min_N": (0.01, 20.0),
    "dt_s": (1e-6, 0.02),
    "lead_s": (1e-6, 0.25),
    "stylus_mass_kg": (2e-4, 1.0),
    "link_mass_kg": (1e-5, 1.0),
    "moving_mass_kg": (1e-5, 5.0),
    "inertial.moving_mass_kg": (1e-5, 0.5),
    "tip.moving_mass_kg": (1e-5, 1.0),
    "payload_kg": (1e-4, 50.0),
    "case_mass_kg": (1e-3, 20.0),
    "hand.mass_kg": (2e-4, 2.0),
    "second_order.mass_kg": (1e-3, 2.0),
    "skin_stiffness_N_m": (20.0, 1e6),
    "skin_damping_N_s_m": (0.02, 1e3),
    "arm_stiffness_N_m": (2.0, 1e5),
    "arm_damping_N_s_m": (0.02, 1e3),
    "transmission.stiffness_N_m": (200.0, 1e9),
    "transmission.damping_N_s_m": (0.01, 1e4),
    "tip.stiffness_N_m": (200.0, 1e9),
    "tip.damping_N_s_m": (0.01, 1e4),
    "ratio_1_m": (0.5, 1e5),
    "force_per_current_N_A": (0.01, 500.0),
    "force_factor_N_A": (0.01, 500.0),
    "resonance_Hz": (2.0, 3e3),
    "R_ohm": (0.02, 1e3),
    "L_H": (1e-7, 0.1),
    "kt_Nm_A": (1e-4, 2.0),
    "rotor_kg_m2": (1e-11, 1e-3),
    "i_continuous_A": (5e-3, 60.0),
    "i_peak_A": (0.01, 150.0),
    "R_wh_K_W": (0.05, 500.0),
    "R_ha_K_W": (0.1, 1e3),
    "tau_w_s": (0.1, 1e3),
    "tau_h_s": (5.0, 2e4),
    "winding_max_C": (50.0, 300.0),
    "ambient_C": (-40.0, 90.0),
    "start_winding_C": WINDING_C,
    "start_housing_C": HOUSING_C,
    "headroom_K": (1e-4, 200.0),
    "pole_Hz": (20.0, 2e6),
    "delay_s": (1e-8, 1.0),
    "command_limit_A": (0.01, 150.0),
    "command_limit_V": (0.1, 500.0),
    "limits.current_A": (5e-3, 150.0),
    "steady_current_A": (5e-3, 60.0),
    "supply_V": (0.5, 500.0),
    "voltage_V": (0.05, 500.0),
    "slew_A_per_s": (20.0, 1e9),
    "stroke_m": (1e-6, 0.2),
    "velocity_m_s": (5e-3, 20.0),
    "feedback.stiffness_N_m": (1.0, 1e6),
    "feedback.damping_N_s_m": (1e-3, 1e4),
    "derivative_filter_Hz": (5.0, 1e5),
    "intention_s": (1e-4, 10.0),
    "after_s": (1e-4, 10.0),
    "object_mass_kg": (1e-3, 100.0),
    "object_stiffness_N_m": (10.0, 1e10),
    "contact_stiffness_N_m": (10.0, 1e13),
    "noise_g_rtHz": (1e-7, 0.05),
    "range_g": (0.5, 1e5),
    "lowpass_Hz": (50.0, 1e5),
    "recordings.grip_N": HAND_N,
    "rate_Hz": (200.0, 1e8),
    "start_s": (1e-6, 1e4),  # of a target in a recording, which may be of hours
    "length_s": (1e-5, 1.0),
    "decay_s": (1e-5, 1.0),
    "frequency_Hz": (1.0, 2e4),
    "peak_V": (0.05, 500.0),
    "rated_V": (0.02, 500.0),
    "peak_A": (5e-3, 150.0),
    "rated_A": (2e-3, 60.0),
    "rms_V": (0.02, 300.0),
    "rms_A": (1e-3, 50.0),
    "rms_g": (0.02, 200.0),
    "rise_s": (2e-4, 2.0),
    "brake_s": (2e-4, 2.0),
    "stiffness_N_m": (5.0, 1e7),
}


def implausible(content: Mapping[str, Any]) -> list[str]:
    """Sentences about the implausible numbers of a scene or a datasheet, one each.

    Parameters
    ----------
    content : its tables as read; entries that are not numbers, or whose key has no bounds here, are skipped.
    """
    found = [wrong for each in _numbers(content) if (wrong := _wrong(*each))]
    if wrong := _wrong_matrices(content.get("model")):
        found.append(f"model: {wrong}")
    return list(dict.fromkeys(found))


def _wrong_matrices(model: Any) -> str:
    """Why a plant stated by matrices cannot be an actuator; empty if it can be, or if the matrices are invalid."""
    if not isinstance(model, Mapping) or model.get("kind") != "state_space" or not {*"ABC"} <= set(model):
        return ""
    try:
        A, B, C, D = (np.array(model.get(name, 0.0), dtype=float) for name in "ABCD")
        B, C = B.reshape(A.shape[0], -1), C.reshape(-1, A.shape[0])
        sizes = C.shape[0], B.shape[1]
        plant = StateSpace(A, B, C, D.reshape(sizes) if D.any() else np.zeros(sizes))
        found = [abs(pole) / (2 * math.pi) for pole in np.linalg.eigvals(A) if pole.imag > 0]
        with np.errstate(all="ignore"):
            response = plant.response(FREQUENCIES_HZ)
            if response.ndim > 1:  # of several drives and accelerations, the largest together
                response = np.linalg.norm(response, 2, axis=(1, 2))
    except (InputError, ValueError, IndexError, TypeError, np.linalg.LinAlgError):
        return ""  # invalid matrices are refused when the scene is validated
    if not np.all(np.isfinite(response)):
        return ""
    return implausible_response(FREQUENCIES_HZ, response, found, "V" if model.get("input") == "voltage" else "A")


def _wrong(path: str, names: str, value: float) -> str:
    """Why a value is implausible; empty if it is plausible, or if the key has no bounds.

    Parameters
    ----------
    names : the path with kinds in place of tables, by which the bounds are found.
    """
    bounds, unit = _bounds(names), unit_of(path)
    if bounds is None or bounds[0] <= value <= bounds[1] or (value <= 0 and unit != "C"):
        return ""  # no wrong unit makes a number <= 0; it is checked with the scene
    low, high = bounds
    likely = _likely(value, unit, bounds)
    meant = "; check its unit"
    if likely:
        meant = f" (did you mean {value:g} {likely[0]}, which is {likely[1]:.6g} {unit}?)"
    return f"{path} = {value:g} {unit}: devices and hands have {low:g} to {high:g} {unit}{meant}"


def check_plausible(source: object, content: Mapping[str, Any]) -> None:
    """Refuse implausible numbers.

    Parameters
    ----------
    source : where the numbers come from; the message begins with it.
    """
    found = implausible(content)
    if found:
        more = f" (and {len(found) - 1} more such numbers)" if len(found) > 1 else ""
        raise InputError(f"{source}: {found[0]}{more}; {ACCEPT}")


def _bounds(names: str) -> tuple[float, float] | None:
    parts = names.split(".")
    endings = (".".join(parts[start:]) for start in range(len(parts)))
    return next((PLAUSIBLE[ending] for ending in endings if ending in PLAUSIBLE), None)


def _likely(value: float, unit: str, bounds: tuple[float, float]) -> tuple[str, float] | None:
    """The unit that was probably meant, and the value converted from it to the key's unit."""
    low, high = bounds
    if unit == "C":
        return ("K", value + KELVIN_0_C) if low <= value + KELVIN_0_C <= high else None
    found = {other: value * by for other, by in MISTAKEN.get(unit, {}).items() if low <= value * by <= high}
    middle = math.sqrt(low * high)
    return min(found.items(), key=lambda each: abs(math.log(each[1] / middle)), default=None)


def _numbers(table: Any, path: str = "", names: str = "") -> Iterator[tuple[str, str, float]]:
    """Every number with its dotted path, and with the same path where kinds replace the names of tables."""
    if isinstance(table, Mapping):
        kind = table.get("kind")
        inside = f"{kind}." if isinstance(kind, str) else names and f"{names}."
        for key, value in table.items():
            if key == "intervals":  # how well an identified parameter is known, not what it is
                continue
            if key == "constant":  # the value at zero grip of a parameter that is linear in grip
                yield from _numbers(value, path, names)
            else:
                yield from _numbers(value, f"{path}.{key}" if path else str(key), f"{inside}{key}")
    elif isinstance(table, Sequence) and not isinstance(table, str | bytes):
        for value in table:
            yield from _numbers(value, path, names)
    elif isinstance(table, int | float) and not isinstance(table, bool) and math.isfinite(table):
        yield path, names, float(table)
