"""Plausibility of a frequency response as that of an actuator's acceleration, to detect wrong units.

The response is an acceleration over a current or a voltage. Its maximum, its resonance and the
displacement per constant input have bounds that a wrong unit exceeds. Below and above the resonance it follows powers
of the frequency, which differ between acceleration, velocity and displacement. A data sheet reveals the rest: a
factor of 9.81, 1000 or 2 pi is a unit and not a tolerance.
"""

import math
from collections.abc import Sequence

import numpy as np

from transopt.base.signals import STANDARD_GRAVITY_M_S2, ComplexArray, FloatArray
from transopt.recordings.plausible import likely_slip, slip

GAIN = (0.02, 2e4)  # m/s^2 per A or V, maximum of a response: an LRA's case has 1 to 50, a tweeter's dome 2000
RESONANCE_HZ = (2.0, 3e3)
STILL_M = (1e-10, 0.02)  # m per A or V below the resonance: a phone's case moves 1e-6, a soft shaker 2e-3
SLOPE, SLOPE_POINTS = 0.35, 4  # tolerance on a power of the frequency; fewest points that one is fitted to
SHEET = 1.4  # ratio by which specimens and mountings may differ from the data sheet
THIRD = 2 ** (1 / 3)  # one third of an octave, as a frequency ratio
TINY = 1e-300


def implausible_response(
    frequencies_Hz: FloatArray, response: ComplexArray | FloatArray, resonances_Hz: Sequence[float], unit: str
) -> str:
    """Why a frequency response cannot be that of an actuator's acceleration; empty if it can be.

    Parameters
    ----------
    frequencies_Hz : (m,) increasing, above 0. response : (m,) [m/s^2 per A or V].
    resonances_Hz : resonances of a fit to the response.
    unit : unit of its input, "A" or "V".
    """
    f, size = frequencies_Hz, np.abs(response)
    peak = float(size.max())
    if not GAIN[0] <= peak <= GAIN[1]:
        likely = likely_slip(peak, GAIN, {"g": STANDARD_GRAVITY_M_S2, "mm/s^2, mg or mV": 1e3})
        return (
            f"the largest response is {peak:.3g} m/s^2 per {unit}, an actuator's {GAIN[0]:g} to {GAIN[1]:g}: check "
            f"its unit{likely}"
        )
    first = f <= THIRD * f[0]
    nearby = any(f[0] / 2 <= each <= 2 * f[0] for each in resonances_Hz)
    if first.sum() >= SLOPE_POINTS and not nearby and _power(f[first], size[first]) < -1:
        inverse = f"{'volts' if unit == 'V' else 'amperes'} over acceleration"
        return f"it grows towards low frequencies, as {inverse}: are the columns exchanged?"
    inside = [each for each in resonances_Hz if f[0] <= each <= f[-1]]  # a fit is arbitrary outside its band
    if not inside:
        return ""
    at = max(inside, key=lambda each: float(np.interp(each, f, size)))
    if not RESONANCE_HZ[0] <= at <= RESONANCE_HZ[1]:
        likely = likely_slip(at, RESONANCE_HZ, {"rad/s called Hz": 2 * math.pi, "kHz": 1e3})
        return (
            f"its resonance is at {at:.4g} Hz, an actuator's at {RESONANCE_HZ[0]:g} to {RESONANCE_HZ[1]:g}: check "
            f"the unit of the frequency{likely}"
        )
    low, high = f < at / 2, f > 2 * at
    if min(low.sum(), high.sum()) < SLOPE_POINTS:
        return ""
    rise, fall = (_power(f[part], size[part]) for part in (low, high))
    for slopes, name, by in ((1, "a velocity", "2 pi f"), (2, "a displacement", "(2 pi f)^2")):
        if max(abs(rise - (2 - slopes)), abs(fall + slopes)) < SLOPE:
            return (
                f"below and above {at:.4g} Hz it goes with the frequency as {name}, no acceleration: state its unit, "
                f"or multiply it by {by}"
            )
    still_m = float(np.median((size / (2 * math.pi * f) ** 2)[low]))
    if not STILL_M[0] <= still_m <= STILL_M[1]:
        slips = {"mm/s^2, mg or mV": 1e3, "rad/s called Hz": (2 * math.pi) ** 2, "kHz": 1e6}
        likely = likely_slip(still_m, STILL_M, slips)
        return (
            f"below its resonance it moves by {still_m:.2g} m per {unit}, an actuator by {STILL_M[0]:g} to "
            f"{STILL_M[1]:g}: check the units{likely}"
        )
    return ""


def against_sheet(found: float, stated: float, what: str, unit: str) -> str:
    """Why a figure contradicts the data sheet, with the unit that explains the ratio; empty if it agrees.

    Parameters
    ----------
    found, stated : in the same unit. what : name of the figure.
    """
    ratio = found / stated
    if 1 / SHEET < ratio < SHEET:
        return ""
    causes = {"g and m/s^2": STANDARD_GRAVITY_M_S2, "milli": 1e3, "rad/s and Hz": 2 * math.pi, "rms and peak": 2**0.5}
    nearest = min(causes, key=lambda each: abs(abs(math.log(ratio)) - math.log(causes[each])))
    return (
        f"its {what} is {found:.4g} {unit}, by the sheet {stated:.4g} {unit}, {ratio:.3g} times as much"
        f"{slip(nearest, causes)}"
    )


def _power(f: FloatArray, size: FloatArray) -> float:
    """Exponent of the frequency with which a magnitude grows, by a fit in logarithms."""
    return float(np.polyfit(np.log(f), np.log(size + TINY), 1)[0])
