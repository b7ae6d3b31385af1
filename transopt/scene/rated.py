"""What an LRA's datasheet leaves out, from the rated sine and the rise time that it states.

Sheets of LRAs rarely state moving mass, force factor BL and quality Q. They state what a sine at the resonance f0
makes on a jig of mass M. The circuit of every moving-coil transducer says what that is at resonance, with the reduced
mass mu = m M / (m + M), the damper c = mu w0 / Q and the motional resistance R_m = BL^2 / c:

    V = I |R + R_m + j w0 L|,    a = m / (m + M) w0 BL I / c,    t_rise = 2 ln(10) mu / (c + BL^2 / R)

Four unknown numbers, m, BL, Q and R, are fitted to all that is stated, each within a tolerance that is assumed.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray

UNKNOWN = ("moving_mass_kg", "force_factor_N_A", "quality", "R_ohm")
START = (1.5e-3, 1.0, 10.0, 20.0)  # in their order: an LRA of a phone
# Relative tolerance of what a sheet states; assumed, no sheet tells it.
TOLERANCE: Mapping[str, float] = {
    "moving_mass_kg": 0.05,
    "force_factor_N_A": 0.05,
    "quality": 0.2,
    "R_ohm": 0.05,
    "rms_A": 0.05,
    "rms_g": 0.1,
    "rise_s": 0.2,
}
SAID = {
    "moving_mass_kg": "moving mass",
    "force_factor_N_A": "force factor BL",
    "quality": "quality Q",
    "R_ohm": "resistance",
    "rms_A": "rated current",
    "rms_g": "rated acceleration",
    "rise_s": "rise time",
}
CONTRADICTS = 3.0  # tolerances, by which a number may miss what the others say
DETERMINED = 1e-3  # of the largest singular value, below which a combination of unknowns is not told
UNSURE = 0.5  # relative deviation, from which on a number is called a guess
OPEN = 30.0  # nats, of a prior about START that decides nothing but keeps the fit at finite numbers


@dataclass(frozen=True)
class Completed:
    """The four numbers of an actuator, and how far the sheet determines them.

    Attributes
    ----------
    values : of `UNKNOWN`, in SI.
    deviations : relative standard deviations of them.
    note : which of the stated numbers contradicts the others, in one sentence; empty where they agree.
    """

    values: Mapping[str, float]
    deviations: Mapping[str, float]
    note: str


def predicted(
    unknown: FloatArray, resonance_Hz: float, jig_kg: float, L_H: float, rms_V: float | None, rms_A: float | None
) -> dict[str, float]:
    """What a sheet would state of an actuator with these four numbers, in the order of `UNKNOWN`."""
    m, BL, Q, R = map(float, unknown)
    w = 2 * math.pi * resonance_Hz
    mu = m * jig_kg / (m + jig_kg)
    c = mu * w / Q
    impedance = math.hypot(R + BL**2 / c, w * L_H)
    found = dict(zip(UNKNOWN, (m, BL, Q, R), strict=True))
    current = rms_A if rms_V is None else rms_V / impedance
    if current is not None:
        found["rms_A"] = current
        # The sheet's acceleration is that at its current, where it states one.
        found["rms_g"] = m / (m + jig_kg) * w * BL * (rms_A or current) / c / STANDARD_GRAVITY_M_S2
    found["rise_s"] = 2 * math.log(10) * mu / (c + BL**2 / R)
    return found


def completed(
    stated: Mapping[str, float], resonance_Hz: float, jig_kg: float, L_H: float = 0.0, rms_V: float | None = None
) -> Completed:
    """The four numbers of an actuator from what its sheet states.

    Parameters
    ----------
    stated : some of `TOLERANCE`, in SI but for the rated acceleration [g]; those of a sine are rms.
    jig_kg : what the actuator shakes in the sheet's test, its case included.
    rms_V : rated voltage of the sine; None where the sheet states none.

    Raises
    ------
    InputError : too few numbers; the line says which of the others would do.
    """
    told = {key: float(value) for key, value in stated.items() if key in TOLERANCE}
    if rms_V is None or set(UNKNOWN) <= set(told):
        told = {key: value for key, value in told.items() if key != "rms_A"}
    given = (resonance_Hz, jig_kg, L_H, rms_V, stated.get("rms_A"))

    def misses(x: FloatArray, keys: list[str]) -> FloatArray:
        made = predicted(np.exp(x), *given)
        return np.array([math.log(made[key] / told[key]) / TOLERANCE[key] for key in keys])

    start = np.log(START)

    def fitted(keys: list[str]) -> tuple[FloatArray, FloatArray]:
        def all_misses(x: FloatArray) -> FloatArray:
            return np.append(misses(x, keys), (x - start) / OPEN)

        own = start + [
            math.log(told[key]) - at if key in keys else 0.0 for key, at in zip(UNKNOWN, start, strict=True)
        ]
        found = scipy.optimize.least_squares(all_misses, own, xtol=1e-14, ftol=1e-14, gtol=1e-14)
        return np.asarray(found.x), np.asarray(found.jac)

    keys = [key for key in told if key in predicted(np.exp(start), *given)]
    x, slopes = fitted(keys)
    if not _is_determined(slopes[: len(keys)]):
        raise InputError(_insufficient(x, keys, given))
    covariance = np.linalg.inv(slopes.T @ slopes)
    values = dict(zip(UNKNOWN, map(float, np.exp(x)), strict=True))
    deviations = dict(zip(UNKNOWN, map(float, np.sqrt(np.diag(covariance))), strict=True))
    note = ""
    if np.abs(misses(x, keys)).max() > CONTRADICTS and len(keys) > len(UNKNOWN):
        suspects = []
        for key in keys:
            rest = [each for each in keys if each != key]
            others, _ = fitted(rest)
            if np.abs(misses(others, rest)).max() <= CONTRADICTS:
                suspects.append(
                    f"{SAID[key]} {told[key]:.3g}, by the others {predicted(np.exp(others), *given)[key]:.3g}"
                )
        note = f"the numbers contradict each other; one of these is wrong: {'; '.join(suspects) or 'more than one'}"
    return Completed(values, deviations, note)


def _is_determined(slopes: FloatArray) -> bool:
    """Whether a sheet's equations tell all four numbers."""
    sizes = np.linalg.svd(slopes, compute_uv=False)
    return len(sizes) == len(UNKNOWN) and bool(sizes[-1] > DETERMINED * sizes[0])


def _insufficient(
    x: FloatArray, keys: list[str], given: tuple[float, float, float, float | None, float | None]
) -> str:
    """Which further number would make a sheet sufficient."""

    def slopes(of: list[str]) -> FloatArray:
        def logs(at: FloatArray) -> FloatArray:
            made = predicted(np.exp(at), *given)
            return np.array([math.log(made[key]) / TOLERANCE[key] for key in of])

        steps = 1e-5 * np.eye(len(x))
        return np.transpose([(logs(x + step) - logs(x - step)) / 2e-5 for step in steps])

    able = predicted(np.exp(x), *given)
    would = [key for key in TOLERANCE if key in able and key not in keys and _is_determined(slopes([*keys, key]))]
    options = " or ".join(f"--{key.replace('_', '-')}" for key in would)
    stated = ", ".join(SAID[key] for key in keys) or "nothing"
    remedy = (
        f"state {options} as well" if would else "state the rated voltage and current, their acceleration and rise"
    )
    return f"{stated}: too little to know moving mass, BL, Q and resistance; {remedy}"
