"""Identified models against transients that were not used in the fit, in the time domain.

Measured and predicted acceleration both pass the causal 8 Hz high-pass of the design
(`transopt.recordings.reference`), since what is slower is the user's own motion. The error that is left is what a
design with this model would not know of.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import fft

from transopt.base.signals import FloatArray, Signal, highpass, nrmse
from transopt.identify.device.response import Instrument, sampled_response
from transopt.identify.device.trials import felt_current
from transopt.identify.measurement import Measurement
from transopt.plant.state_space import StateSpace

HIGHPASS_HZ = 8.0
PADDING_S = 0.5  # after a record, for the ringing that its end cuts off
RECORDED_LIMIT, BETWEEN_LIMIT = 0.05, 0.08  # NRMSE that a model is to keep at recorded grips, and between them
WORTHLESS = 0.5  # NRMSE from which on a model says nothing of use
NEAR_ZERO = 1e-3  # of a spectrum's line: a free device has no finite state at exactly 0 Hz, but a response beside it


class Model(Protocol):
    """Plants and their weights in the output at a grip; see `BlackBox.shares`."""

    def shares(self, grip_N: float) -> list[tuple[StateSpace, float]]: ...


@dataclass(frozen=True)
class Transient:
    """A run, measured and predicted.

    Attributes
    ----------
    run : what was recorded.
    nrmse : of the prediction, after the high-pass.
    measured, predicted : (n,) acceleration after the high-pass [m/s^2], the measured one less its static offset.
    """

    run: Measurement
    nrmse: float
    measured: FloatArray
    predicted: FloatArray


def predict(model: Model, grip_N: float, instrument: Instrument, current_A: FloatArray) -> FloatArray:
    """(n,) sampled acceleration behind the accelerometer's pole that a sampled current from rest comes with [m/s^2].

    Through the ratio of the sampled spectra, so that what the current does between its samples is what a held
    command makes it do; inverting the hold in the time domain is unstable where the delay exceeds half a period.
    """
    size = fft.next_fast_len(current_A.size + round(PADDING_S / instrument.dt_s), real=True)
    frequencies = fft.rfftfreq(size, instrument.dt_s)
    frequencies[0] = NEAR_ZERO * frequencies[1]
    ratio = np.zeros(frequencies.size, dtype=complex)
    for plant, weight in model.shares(grip_N):
        ratio += weight * sampled_response(plant, instrument, frequencies)[0]
    return np.asarray(fft.irfft(fft.rfft(current_A, size) * ratio, size)[: current_A.size])


def compare(model: Model, grip_N: float, instrument: Instrument, run: Measurement) -> Transient:
    """One transient through the model.

    The accelerometer's static offset (1 g, if it stands upright) is the constant that suits best: it comes through
    the high-pass as its step response.
    """
    recorded = run.require("acceleration", "acceleration_m_s2")

    def passed(values: FloatArray) -> FloatArray:
        return highpass(Signal(recorded.start_s, recorded.dt_s, values), HIGHPASS_HZ).values

    predicted = passed(predict(model, grip_N, instrument, felt_current(run, instrument.amplifier).values))
    measured, step = passed(recorded.values), passed(np.ones(recorded.values.size))
    offset = float(step @ (measured - predicted) / (step @ step))
    measured = measured - offset * step
    return Transient(run, nrmse(predicted, measured), measured, predicted)


def together(transients: Sequence[Transient]) -> float:
    """NRMSE of several transients as one: a quiet one counts no more than a loud one. NaN without any."""
    if not transients:
        return float("nan")
    measured, predicted = (
        np.concatenate([getattr(t, part) for t in transients]) for part in ("measured", "predicted")
    )
    return nrmse(predicted, measured)


def verdict(recorded: Mapping[float, float], between: Mapping[float, float]) -> str:
    """In plain words, from NRMSE by grip: which design error such a model supports.

    Parameters
    ----------
    recorded : at recorded grips, NaN where nothing was kept for validation.
    between : at grips that the model does not know.
    """
    known = {grip: error for grip, error in recorded.items() if np.isfinite(error)}
    if not known:
        return (
            "not validated: no transient was kept out of the fit; record three trials per grip or give --validate "
            "FILES before trusting a design"
        )
    worst = max(known, key=lambda grip: known[grip])
    if known[worst] >= WORTHLESS:
        missed = f"{100 * known[worst]:.0f} % of what was kept out of the fit"
        return f"supports no design: at {called(worst)} it misses {missed}"
    text = (
        f"supports design errors down to {100 * known[worst]:.2g} % (worst held-out NRMSE, {called(worst)}); "
        "below that you design the model's error"
    )
    missing = [called(grip) for grip in recorded if grip not in known]
    if missing:
        text += f"; not validated: {', '.join(missing)}"
    if between:
        gap = max(between, key=lambda grip: between[grip])
        text += (
            f"; between recorded grips down to {100 * between[gap]:.2g} % (at {called(gap)}, unknown to the model)"
        )
    return text


def called(grip_N: float) -> str:
    """How messages call a grip."""
    return "free device" if grip_N == 0 else f"{grip_N:.3g} N"


def short_of(recorded: Mapping[float, float], between: Mapping[float, float]) -> list[str]:
    """What keeps a model from being good enough, with what to record again."""
    said = []
    for grip, error in recorded.items():
        if not error <= RECORDED_LIMIT:
            if np.isfinite(error):
                said.append(
                    f"{called(grip)}: held-out NRMSE {100 * error:.2g} %, limit {100 * RECORDED_LIMIT:g} %; record "
                    "this grip again, held steadily, or choose another kind or a higher order"
                )
            else:
                said.append(
                    f"{called(grip)}: nothing kept for validation; record a third trial or give --validate FILES"
                )
    for grip, error in between.items():
        if not error <= BETWEEN_LIMIT:
            said.append(
                f"{called(grip)}: NRMSE {100 * error:.2g} % by a model that does not know this grip, limit "
                f"{100 * BETWEEN_LIMIT:g} %; record further grips to either side of it"
            )
    return said
