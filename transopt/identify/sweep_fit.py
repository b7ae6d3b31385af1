"""A state space from one recorded sweep: what drove an actuator, and the acceleration that it made.

The spectra of both tell the response in bands of neighbouring lines, each with its uncertainty
(`transopt.identify.spectrum`), and a state space is fitted to the bands that the acceleration answers. The number of
its states is the least that leaves no more than the noise and one percent, else the one with the least Bayesian
information criterion (Schwarz 1978, "Estimating the dimension of a model", Annals of Statistics 6 (2)).
"""

from dataclasses import dataclass

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.identify.black_box import ResponseFit, fit_response
from transopt.identify.checks import check_measurement
from transopt.identify.findings import COHERENT, refuse
from transopt.identify.measurement import Measurement
from transopt.identify.spectrum import Trial, estimate_transfer
from transopt.plant.state_space import CURRENT_INPUT, VOLTAGE_INPUT

ORDERS = (2, 3, 4, 5, 6, 8)  # of a plant that nobody states the order of
OF_NYQUIST = 0.9  # above it an anti-alias filter and the converter have their say
EXACT = 3e-3  # of the largest response: the ends of a record and its course within a band are not followed nearer
ENOUGH = 0.01  # misfit beside that of the noise, with which no more states are asked for
CERTAIN = 3.0  # standard deviations that the noise's own misfit is given
LEAST_BINS = 12  # twice what two states need: fewer tell no noise from a plant
MOST_UNSURE = 0.05  # relative error of the fitted response that noise alone may make
LONGER = 1.5  # times as long as the width of the bands alone asks for: their number of lines is whole
WIDE = 0.5  # of the width of a resonance: bands no wider follow its course


@dataclass(frozen=True)
class SweptFit:
    """A plant from a sweep, and how far the record tells it.

    Attributes
    ----------
    fit : to the response in bands of frequency.
    unsure : relative error of the fitted response that the noise of the record leaves, rms.
    answered, bands : number of bands that the acceleration answers, and of all that were excited.
    notes : what to mind, one sentence each.
    """

    fit: ResponseFit
    unsure: float
    answered: int
    bands: int
    notes: tuple[str, ...]

    __repr__ = brief


def fit_sweep(
    run: Measurement, order: int | None = None, driven_by: str = "", band_Hz: tuple[float, float] | None = None
) -> SweptFit:
    """The state space from voltage or current to acceleration that a recorded sweep tells.

    Parameters
    ----------
    run : one record of any broad excitation, from rest.
    order : number of states; None chooses one of `ORDERS`.
    driven_by : "voltage" or "current"; empty takes the one that the file has, the voltage of both.
    band_Hz : lowest and highest frequency that count; None for all.

    Raises
    ------
    InputError : a column is missing, a signal is clipped or still, or too little of it tells a plant.
    """
    inputs = {each.name: each for each in (VOLTAGE_INPUT, CURRENT_INPUT)}
    name = driven_by or next((each for each in inputs if getattr(run, each) is not None), VOLTAGE_INPUT.name)
    given = run.require(name, f"{name}_{inputs[name].unit}")
    answer = run.require("acceleration", "acceleration_m_s2")
    notes = [str(finding) for finding in refuse(check_measurement(run, [name, "acceleration"]))]
    seen = estimate_transfer([Trial(run.name, given, answer)])
    low, high = band_Hz or (0.0, np.inf)
    f = seen.frequencies_Hz
    inside = (f >= low) & (f <= min(high, OF_NYQUIST / 2 / given.dt_s))
    answered = inside & (seen.coherence >= COHERENT)
    if (count := int(answered.sum())) < LEAST_BINS:
        raise InputError(
            f"{run.name}: the acceleration answers the {name} in {count} of {inside.sum()} bands of frequency, at "
            f"least {LEAST_BINS} are needed: play the sweep louder or longer, and over a wider range"
        )
    f, G = f[answered], seen.response[answered]
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
    """Bayesian information criterion of a fit to so many complex points whose scale of noise is not known."""
    misfit = max(fit.misfit, np.finfo(float).eps)
    return 2 * count * 2 * float(np.log(misfit)) + (2 * fit.plant.order + 1) * float(np.log(2 * count))


def _times(unsure: float) -> int:
    """How much longer a sweep has to last until its noise is small enough: variance falls with time."""
    return int(np.ceil((unsure / MOST_UNSURE) ** 2))
