"""What to record again, and where; and how well each parameter is known by what was recorded."""

from collections.abc import Sequence

import numpy as np

from transopt.base.signals import FloatArray
from transopt.identify.checks import runs_of
from transopt.identify.device.chain import RANGE, SHARED, GripResponse
from transopt.identify.device.chain_fit import ChainFit, GripFit
from transopt.identify.device.response import Instrument
from transopt.identify.device.trials import BAND_HZ, Grip, low_coherence
from transopt.identify.device.validation import Model, called, modelled
from transopt.identify.fit import around, quantile

MISFIT, MISFIT_RELATIVE = 3.0, 0.06  # mean square residual, and mean error (0.5 dB), from where the fit is lacking
SMOOTHED_BINS = 9
NOT_LINEAR_DB = 1.0  # between the hand of one grip and the functions of all, from where the user is warned


def lack_of_fit(response: GripResponse, model: Model, instrument: Instrument) -> list[tuple[float, float]]:
    """Bands [Hz] where the model is off by more than the noise explains and by more than half a decibel."""
    e = response.estimate
    error = modelled(model, response.grip_N, instrument, e.frequencies_Hz) - e.response
    window = np.ones(min(SMOOTHED_BINS, e.response.size))
    count = np.convolve(np.ones(error.size), window, "same")
    surprise = np.convolve(np.abs(error / response.deviation) ** 2 / 2, window, "same") / count
    relative = np.abs(np.convolve(error / e.response, window, "same")) / count
    inside = (e.frequencies_Hz >= BAND_HZ[0]) & (e.frequencies_Hz <= BAND_HZ[1])
    return runs_of(e.frequencies_Hz, (surprise > MISFIT) & (relative > MISFIT_RELATIVE) & inside)


def _band(low_Hz: float, high_Hz: float) -> str:
    return f"{low_Hz:.3g} Hz" if low_Hz == high_Hz else f"{low_Hz:.3g}-{high_Hz:.3g} Hz"


def advice(grips: Sequence[Grip], model: Model, instrument: Instrument, played_N: Sequence[float]) -> list[str]:
    """What to record again, and where."""
    said = []
    for grip in grips:
        for band in low_coherence(grip.response):
            said.append(
                f"coherence low at {_band(*band)} at {called(grip.grip_N)}: sweep there, with more current (record "
                "sweep --low, --high, --amplitude)"
            )
        for band in lack_of_fit(grip.response, model, instrument):
            said.append(
                f"lack of fit at {_band(*band)} at {called(grip.grip_N)}: more than noise; record this grip again, "
                "held steadily, or try --kind state_space with a higher --order"
            )
    held = [grip.grip_N for grip in grips if grip.grip_N > 0]
    if held and len(held) == len(grips):
        said.append(
            "no free device: record it too (record sweep --grips 0): it tells the drive's masses from the hand's"
        )
    if len(held) == 1:
        said.append(f"one held grip, {held[0]:.3g} N: the hand is taken to be the same at all; record at least three")
    for wanted in played_N:
        if wanted > 0 and held and not held[0] * 0.9 <= wanted <= held[-1] * 1.1:
            said.append(f"the scene plays {wanted:g} N, recorded are {held[0]:.3g} to {held[-1]:.3g} N: record there")
        if wanted == 0 and len(held) == len(grips):
            said.append("the scene plays the free device, which was not recorded: record at grip 0")
    return said


def not_the_devices(fit: ChainFit) -> list[str]:
    """Why parameters that predict well may be no masses, springs and dampers of the device all the same."""
    said = []
    if fit.scatter > MISFIT:
        said.append(
            f"residuals of {fit.scatter:.2g} times the noise: the parameters make up for what the chain lacks "
            "(further masses, samples not read together, accelerometer_Hz), so that their intervals do not hold"
        )
    if fit.at_bounds:
        said.append(f"at a bound, so without meaning by themselves: {', '.join(fit.at_bounds)}")
    return said


def about_chain(fit: ChainFit, own_hands: Sequence[GripFit]) -> list[str]:
    """What the fit itself says against its numbers."""
    said = [f"{name} ended at its bound: these records do not determine it" for name in fit.at_bounds]
    for name, sigma in fit.unidentified.items():
        if name not in fit.at_bounds:
            factor = _factor(sigma)
            known = f"is known to a factor of {factor:.2g} only" if factor < RANGE else "is open"
            said.append(f"{name} {known}: these records do not determine it")
    said += [
        f"the hand at {own.grip_N:.3g} N is not on the lines of all grips (up to {own.difference_dB:.2g} dB off): "
        "record this grip again, or more grips beside it"
        for own in own_hands
        if own.difference_dB > NOT_LINEAR_DB and own.scatter > MISFIT
    ]
    if fit.agreeing == 1 and fit.starts > 1 and fit.scatter > MISFIT:
        said.append(f"only one of {fit.starts} starts led to this device: give a --scene nearer to yours")
    return said


def _factor(sigma: float) -> float:
    """Half the 95 % interval of a positive number from the deviation of its logarithm; at most the range searched."""
    return float(np.exp(min(quantile() * sigma, np.log(RANGE))))


def intervals(names: Sequence[str], values: FloatArray, covariance: FloatArray) -> FloatArray:
    """(q, 2) 95 %: of what must be positive on a logarithmic scale, of constants and slopes on a plain one."""
    found = around(values, covariance)
    for j, (name, value) in enumerate(zip(names, values, strict=True)):
        if name in SHARED:
            factor = _factor(float(np.sqrt(covariance[j, j]) / value))
            found[j] = value / factor, value * factor
    return found
