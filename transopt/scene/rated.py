"""Estimates the numbers that a datasheet of an LRA, a voice coil or a shaker omits from those that it states.

Datasheets of LRAs rarely state moving mass, force factor BL and quality Q. They state the response to a sine at the
resonance f0 on a jig of mass M. Those of voice coils and exciters state the qualities of the open and the driven
coil. The equations of a moving-coil transducer relate these numbers, with w0 = 2 pi f0, the reduced mass
mu = m M / (m + M), or m on the ground, the damper c = mu w0 / Q and the motional resistance BL^2 / c:

    V = I |R + BL^2 / c + j w0 L|,    t_rise = t_brake = 2 ln(10) mu / (c + BL^2 / R),    k = mu w0^2
    a = w0 BL I / c,  and for a jig m / (m + M) times that
    Qes = mu w0 R / BL^2,    1 / Qts = 1 / Q + 1 / Qes   (Thiele and Small)

The five unknowns m, BL, Q, R and f0 are fitted to all stated numbers by least squares, each weighted by an assumed
tolerance.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray

UNKNOWN = ("moving_mass_kg", "force_factor_N_A", "quality", "R_ohm", "resonance_Hz")
START = (1.5e-3, 1.0, 10.0, 20.0, 150.0)  # start values of `UNKNOWN`: an LRA of a phone
# Number of a datasheet -> its name in messages, and its relative tolerance, assumed as datasheets do not state it.
STATED: Mapping[str, tuple[str, float]] = {
    "moving_mass_kg": ("moving mass", 0.05),
    "force_factor_N_A": ("force factor BL", 0.05),
    "quality": ("quality Q", 0.2),
    "R_ohm": ("resistance", 0.05),
    "resonance_Hz": ("resonance f0", 0.02),
    "rms_A": ("rated current", 0.05),
    "rms_g": ("rated acceleration", 0.1),
    "rise_s": ("rise time", 0.2),
    "brake_s": ("brake time", 0.2),
    "quality_electrical": ("electrical quality Qes", 0.1),
    "quality_total": ("total quality Qts", 0.1),
    "stiffness_N_m": ("stiffness", 0.1),
}
WORDS = {key: words for key, (words, _) in STATED.items()}
TOLERANCE = {key: tolerance for key, (_, tolerance) in STATED.items()}
CONTRADICTS = 3.0  # largest residual of a number that agrees with the others, in tolerances
DETERMINED = 1e-3  # least singular value over the largest one for which all unknowns are determined
UNSURE = 0.5  # relative standard deviation above which a number is reported as a guess
PRIOR_DEVIATION = 30.0  # of the logarithms, of a weak prior at START that keeps the fit finite


@dataclass(frozen=True)
class Completed:
    """The five numbers of an actuator and their uncertainty.

    Attributes
    ----------
    values : name in `UNKNOWN` -> value in SI.
    deviations : name in `UNKNOWN` -> relative standard deviation.
    note : which of the stated numbers contradicts the others, in one sentence; empty if they agree.
    """

    values: Mapping[str, float]
    deviations: Mapping[str, float]
    note: str


@dataclass(frozen=True)
class Rating:
    """The known conditions under which a datasheet rates its actuator.

    Attributes
    ----------
    jig_kg : mass that the actuator shakes, its case included; None on the ground.
    L_H : inductance of the coil.
    rms_V : rated voltage of the sine; None if the datasheet states none.
    rms_A : rated current, at which the acceleration is stated; None if the datasheet states none.
    """

    jig_kg: float | None = None
    L_H: float = 0.0
    rms_V: float | None = None
    rms_A: float | None = None


def predicted(unknown: FloatArray, test: Rating) -> dict[str, float]:
    """The numbers that a datasheet would state of an actuator with these unknowns, in the order of `UNKNOWN`."""
    m, BL, Q, R, f = map(float, unknown)
    w = 2 * math.pi * f
    share = 1.0 if test.jig_kg is None else m / (m + test.jig_kg)  # motion of the jig over the relative motion
    mu = m if test.jig_kg is None else share * test.jig_kg
    c = mu * w / Q
    electrical = mu * w * R / BL**2
    found = dict(zip(UNKNOWN, (m, BL, Q, R, f), strict=True))
    current = test.rms_A
    if test.rms_V is not None:
        current = found["rms_A"] = test.rms_V / math.hypot(R + BL**2 / c, w * test.L_H)
    if current is not None:
        # The stated acceleration belongs to the stated current, if there is one.
        found["rms_g"] = share * w * BL * (test.rms_A or current) / c / STANDARD_GRAVITY_M_S2
    found["rise_s"] = found["brake_s"] = 2 * math.log(10) * mu / (c + BL**2 / R)
    found["quality_electrical"], found["quality_total"] = electrical, 1 / (1 / Q + 1 / electrical)
    found["stiffness_N_m"] = mu * w**2
    return found


def rated_swing_m(jig_kg: float, resonance_Hz: float, rms_g: float, moving_mass_kg: float) -> float:
    """Amplitude of a moving mass against its jig at the rated acceleration of the jig.

    The momenta of the two cancel, m x = M X with X = sqrt(2) a / w0^2, so the rating determines the product of mass
    and swing but neither of them; the motion against the jig is x + X.
    """
    jig_swing_m = math.sqrt(2) * rms_g * STANDARD_GRAVITY_M_S2 / (2 * math.pi * resonance_Hz) ** 2
    return jig_swing_m * (1 + jig_kg / moving_mass_kg)


def completed(stated: Mapping[str, float], test: Rating) -> Completed:
    """Fit the numbers of an actuator to those that its datasheet states.

    Parameters
    ----------
    stated : key of `TOLERANCE` -> number, in SI except for the rated acceleration [g]; those of a sine are rms.

    Raises
    ------
    InputError : too few numbers; the message says which further ones would suffice.
    """
    start = np.log(START)
    given = {key: float(stated[key]) for key in predicted(np.exp(start), test) if key in stated}

    def misses(x: FloatArray, keys: list[str]) -> FloatArray:
        made = predicted(np.exp(x), test)
        return np.array([math.log(made[key] / given[key]) / TOLERANCE[key] for key in keys])

    def fitted(keys: list[str]) -> tuple[FloatArray, FloatArray]:
        def all_misses(x: FloatArray) -> FloatArray:
            return np.append(misses(x, keys), (x - start) / PRIOR_DEVIATION)

        own = start + [
            math.log(given[key]) - at if key in keys else 0.0 for key, at in zip(UNKNOWN, start, strict=True)
        ]
        found = scipy.optimize.least_squares(all_misses, own, xtol=1e-14, ftol=1e-14, gtol=1e-14)
        return np.asarray(found.x), np.asarray(found.jac)

    def contradiction() -> str:
        """The numbers without any one of which the others agree, as suspects of an error; empty if there are none."""
        suspects = []
        for key in keys:
            rest = [each for each in keys if each != key]
            others, slopes = fitted(rest)
            if _is_determined(slopes[: len(rest)]) and np.abs(misses(others, rest)).max() <= CONTRADICTS:
                by_others = predicted(np.exp(others), test)[key]
                suspects.append(f"{WORDS[key]} {given[key]:.3g}, by the others {by_others:.3g}")
        return "; ".join(suspects)

    keys, problem = list(given), "the numbers contradict each other; one of these is wrong:"
    x, slopes = fitted(keys)
    note = _too_much_current(given, test)
    if not _is_determined(slopes[: len(keys)]):
        if not note and len(keys) > len(UNKNOWN) and (wrong := contradiction()):
            note = f"{problem} {wrong}; correct it, or leave it out"
        raise InputError(note or _insufficient(x, keys, test))
    covariance = np.linalg.inv(slopes.T @ slopes)
    values = dict(zip(UNKNOWN, map(float, np.exp(x)), strict=True))
    deviations = dict(zip(UNKNOWN, map(float, np.sqrt(np.diag(covariance))), strict=True))
    if not note and np.abs(misses(x, keys)).max() > CONTRADICTS and len(keys) > len(UNKNOWN):
        note = f"{problem} {contradiction() or 'more than one'}; correct it, or leave it out"
    return Completed(values, deviations, note)


def _too_much_current(given: Mapping[str, float], test: Rating) -> str:
    """Message if the rated current exceeds the rated voltage over R, its largest value; empty otherwise."""
    rms_V, R, rms_A = test.rms_V, given.get("R_ohm"), given.get("rms_A")
    if rms_V is None or R is None or rms_A is None or rms_A <= rms_V / R:
        return ""
    return (
        f"the numbers contradict each other: {rms_V:g} V through {R:g} ohm are {rms_V / R:.3g} A at standstill and "
        f"less in motion, the rated current is {rms_A:g} A: one of them is a maximum, or for another temperature; "
        "leave that one out"
    )


def _is_determined(slopes: FloatArray) -> bool:
    """Whether the stated numbers determine all unknowns, by the singular values of the Jacobian."""
    sizes = np.linalg.svd(slopes, compute_uv=False)
    return len(sizes) == len(UNKNOWN) and bool(sizes[-1] > DETERMINED * sizes[0])


def _insufficient(x: FloatArray, keys: list[str], test: Rating) -> str:
    """Message that names the further numbers which would make a datasheet sufficient."""

    def slopes(of: list[str]) -> FloatArray:
        def logs(at: FloatArray) -> FloatArray:
            made = predicted(np.exp(at), test)
            return np.array([math.log(made[key]) / TOLERANCE[key] for key in of])

        steps = 1e-5 * np.eye(len(x))
        return np.transpose([(logs(x + step) - logs(x - step)) / 2e-5 for step in steps])

    able = predicted(np.exp(x), test)
    would = [key for key in TOLERANCE if key in able and key not in keys and _is_determined(slopes([*keys, key]))]
    options = " or ".join(f"--{key.replace('_', '-')}" for key in would)
    stated = ", ".join(WORDS[key] for key in keys) or "nothing"
    remedy = (
        f"state {options} as well" if would else "state the rated voltage and current, their acceleration and rise"
    )
    return f"{stated}: too little to know moving mass, BL, Q, resistance and f0; {remedy}"
