"""A state space from one recorded sweep of an actuator: its voltage or current, and the acceleration.

The spectra give the response in bands of neighbouring lines, each with its uncertainty
(`transopt.identify.spectrum`), and a state space is fitted to the coherent bands. The number of its states is the
least whose misfit beyond noise is at most one percent, else the one with the least Bayesian information criterion
(Schwarz 1978, "Estimating the dimension of a model", Annals of Statistics 6 (2)).
"""

from dataclasses import dataclass

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.identify.checks import check_measurement
from transopt.identify.findings import COHERENT, refuse
from transopt.identify.measurement import Measurement
from transopt.identify.response_fit import CERTAIN, ResponseFit, fit_response
from transopt.identify.spectrum import Trial, estimate_transfer
from transopt.plant.state_space import CURRENT_INPUT, VOLTAGE_INPUT

ORDERS = (2, 3, 4, 5, 6, 8)  # tried when the user states no order
OF_NYQUIST = 0.9  # share of the Nyquist frequency above which anti-alias filter and converter distort the response
EXACT = 3e-3  # of the largest response: error of the estimate by the record's ends and by curvature within a band
ENOUGH = 0.01  # misfit beyond that of the noise at which no more states are tried
LEAST_BINS = 12  # twice what two states need: with fewer bands a plant cannot be told from noise
MOST_UNSURE = 0.05  # largest relative error of the fitted response due to noise
LONGER = 1.5  # factor on the proposed length of a sweep, since a band holds a whole number of lines
WIDE = 0.5  # largest distance of bands over the width of a resonance to resolve its shape


@dataclass(frozen=True)
class SweptFit:
    """A plant from a sweep, with its uncertainty.

    Attributes
    ----------
    fit : fit to the response in bands of frequency.
    unsure : relative rms error of the fitted response due to the noise of the record.
    answered, bands : number of coherent bands, and of all excited bands.
    notes : warnings, one sentence each.
    """

    fit: ResponseFit
    unsure: float
    answered: int
    bands: int
    notes: tuple[str, ...]

    __repr__ = brief


def fit_sweep(
    run: Measurement,
    order: int | None = None,
    driven_by: str = "",
    band_Hz: tuple[float, float] | None = None,
    delay_s: float = 0.0,
) -> SweptFit:
    """Fit a state space from voltage or current to acceleration to a recorded sweep.

    Parameters
    ----------
    run : one record of any broad excitation, from rest.
    order : number of states; None chooses one of `ORDERS`.
    driven_by : "voltage" or "current"; empty takes the one in the file, and the voltage if it has both.
    band_Hz : lowest and highest frequency that count; None for all.
    delay_s : pure delay of the acceleration, which is taken out.

    Raises
    ------
    InputError : a column is missing, a signal is clipped or constant, or too few bands are coherent.
    """
    inputs = {each.name: each for each in (VOLTAGE_INPUT, CURRENT_INPUT)}
    name = driven_by or next((each for each in inputs if getattr(run, each) is not None), VOLTAGE_INPUT.name)
    given, answer = run.require(name), run.require("acceleration")
    notes = [str(finding) for finding in refuse(check_measurement(run, [name, "acceleration"]))]
    seen = estimate_transfer([Trial.of(run, name, "acceleration")])
    low, high = band_Hz or (0.0, np.inf)
    f = seen.frequencies_Hz
    inside = (f >= low) & (f <= min(high, OF_NYQUIST / 2 / given.dt_s))
    answered = inside & (seen.coherence >= COHERENT)
    if (count := int(answered.sum())) < LEAST_BINS:
        raise InputError(
            f"{run.name}: the acceleration answers the {name} in {count} of {inside.sum()} bands of frequency, at "
            f"least {LEAST_BINS} are needed: play the sweep louder or longer, and over a wider range"
        )
    f, G = f[answered], (seen.response * np.exp(2j * np.pi * f * delay_s))[answered]
    deviations = np.hypot(seen.deviation[answered], EXACT * np.abs(G).max())
    orders = [order] if order is not None else [each for each in ORDERS if 2 * each + 2 <= count]
    fits, noise = list[ResponseFit](), 1 + CERTAIN / float(np.sqrt(count))
    for each in orders:
        fits.append(fit_response(f, G, each, inputs[name], deviations=deviations))
        if fits[-1].misfit ** 2 - noise * fits[-1].noise ** 2 <= ENOUGH**2:
            fit = fits[-1]
            break
    else:
        fit = min(fits, key=lambda each: _criterion(each, count))
    unsure = fit.noise * float(np.sqrt((2 * fit.plant.order + 1) / (2 * count)))
    if unsure > MOST_UNSURE:
        raise InputError(
            f"{run.name}: the noise leaves the response uncertain by {100 * unsure:.2g} %, at most "
            f"{100 * MOST_UNSURE:g} %: play the sweep louder or {_times(unsure)} times as long"
        )
    duration_s = answer.dt_s * answer.values.size
    for at_Hz, quality in fit.resonances():
        apart = float(np.interp(at_Hz, f[:-1], np.diff(f)))
        width = at_Hz / quality
        if f[0] <= at_Hz <= f[-1] and apart > WIDE * width:
            wanted_s = LONGER * duration_s * apart / (WIDE * width)
            notes.append(
                f"the resonance at {at_Hz:.4g} Hz is {width:.2g} Hz wide, and {duration_s:.2g} s tell bands "
                f"{apart:.2g} Hz apart: its quality is rough; sweep for {wanted_s:.2g} s"
            )
    return SweptFit(fit, unsure, count, int(inside.sum()), tuple(notes))


def _criterion(fit: ResponseFit, count: int) -> float:
    """Bayesian information criterion of a fit to `count` complex points with unknown scale of the noise."""
    misfit = max(fit.misfit, np.finfo(float).eps)
    return 2 * count * 2 * float(np.log(misfit)) + (2 * fit.plant.order + 1) * float(np.log(2 * count))


def _times(unsure: float) -> int:
    """Factor by which the sweep must be longer for the noise to be small enough: variance falls with time."""
    return int(np.ceil((unsure / MOST_UNSURE) ** 2))
