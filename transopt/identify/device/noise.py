"""What the noise of the records is made of, by name: mains hum, the hand's tremor, the steps of a converter.

None of them spoils a fit, in which every line counts by its noise; each has a remedy of its own, and costs trials.
"""

from collections.abc import Sequence

import numpy as np

from transopt.base.signals import FloatArray
from transopt.identify.device.response import ACCELERATION
from transopt.identify.device.trials import Grip
from transopt.identify.findings import Fault, Finding

MAINS_HZ = (50.0, 60.0)
STANDS_OUT = 6.0  # times the variance of the neighbouring bins
TREMOR_HZ, BESIDE_HZ = (7.0, 13.0), (20.0, 45.0)
TREMBLES = 10.0  # times the variance beside
COARSE = 0.1  # of the noise that the rounding of a converter makes, from which on it is said
FEW_LEVELS = 0.2  # of the samples: a converter's values recur


def noise_findings(grips: Sequence[Grip]) -> list[Finding]:
    """One finding for each kind that stands out, with its remedy."""
    spectra = [_noise(grip) for grip in grips]
    # Each says nothing where its kind does not stand out.
    said = {
        "mains hum": _hum(spectra),
        "hand tremor": _tremor(grips, spectra),
        "converter steps": _steps(grips, spectra),
    }
    return [Finding(Fault.BESIDE, where, text, False) for where, text in said.items() if text]


def _noise(grip: Grip) -> tuple[FloatArray, FloatArray]:
    """(b,) middles of the bins [Hz] and variances of the acceleration's lines in them."""
    data = grip.response.data
    return data.frequencies_Hz.mean(axis=1), data.noise[grip.response.outputs.index(ACCELERATION)]


def _hum(spectra: Sequence[tuple[FloatArray, FloatArray]]) -> str:
    """The mains: bins that hold its frequency or the first multiples of it, and stand out of their neighbours."""
    most, which = 0.0, 0.0
    for mains in MAINS_HZ:
        ratios = []
        for f, noise in spectra:
            for line in mains * np.arange(1, 4):
                at = int(np.argmin(np.abs(f - line)))
                beside = np.r_[noise[max(at - 6, 0) : max(at - 1, 0)], noise[at + 2 : at + 7]]
                if f[0] < line < f[-1] and beside.size >= 4:
                    ratios.append(float(noise[at] / np.median(beside)))
        if ratios and max(ratios) > most:
            most, which = max(ratios), mains
    if most < STANDS_OUT:
        return ""
    return (
        f"the acceleration's noise at multiples of {which:g} Hz is {most:.2g} times that beside it, and those lines "
        "count less: keep the sensor's cable off the mains' and the amplifier's, or ground it at one end"
    )


def _tremor(grips: Sequence[Grip], spectra: Sequence[tuple[FloatArray, FloatArray]]) -> str:
    """The hand's own motion at 7 to 13 Hz, against what lies just above it."""
    most = 0.0
    for grip, (f, noise) in zip(grips, spectra, strict=True):
        inside, beside = ((f >= low) & (f <= high) for low, high in (TREMOR_HZ, BESIDE_HZ))
        if grip.grip_N > 0 and inside.any() and beside.any():
            most = max(most, float(noise[inside].max() / np.median(noise[beside])))
    if most < TREMBLES:
        return ""
    return (
        f"the acceleration's noise at {TREMOR_HZ[0]:g} to {TREMOR_HZ[1]:g} Hz is {most:.2g} times that beside it; "
        "what it leaks into other lines is taken out: rest the forearm, or add trials"
    )


def _steps(grips: Sequence[Grip], spectra: Sequence[tuple[FloatArray, FloatArray]]) -> str:
    """A converter whose rounding, step^2 / 12, makes much of the noise that a line shows."""
    worst, largest = 0.0, 0.0
    for grip, (_, noise) in zip(grips, spectra, strict=True):
        for run in grip.fitted:
            values = run.require("acceleration", "acceleration_m_s2").values
            levels = np.unique(values)
            gaps = np.diff(levels)
            gaps = gaps[gaps > 1e-6 * np.ptp(values)]
            if levels.size > FEW_LEVELS * values.size or gaps.size < 2:
                continue
            step = float(np.median(gaps))
            share = step**2 / 12 / float(np.median(noise))
            worst, largest = max(worst, share), max(largest, step)
    if worst < COARSE:
        return ""
    return (
        f"the acceleration moves in steps of {largest:.2g} m/s^2, whose rounding makes {100 * min(worst, 1):.0f} % "
        "of its noise: take a converter of more bits, or a sensor of smaller range"
    )
