"""Identified models against transients that were not used in the fit, in the time domain.

Measured and predicted acceleration both pass a causal 8 Hz high-pass: in a record of a held device what is slower is
mostly the hand's own motion, which no model of the device predicts. The error that is left is what a design with this
model would not know of.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import fft

from transopt.base.filters import highpass
from transopt.base.signals import ComplexArray, FloatArray, Signal, nrmse
from transopt.identify.device.response import Instrument, sampled_response
from transopt.identify.device.trials import felt_current
from transopt.identify.measurement import Measurement
from transopt.plant.state_space import StateSpace

HIGHPASS_HZ = 8.0
PADDING_S = 0.5  # after a record, for the ringing that its end cuts off
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
    nrmse : relative error of the prediction, after the high-pass.
    measured, predicted : (n,) acceleration after the high-pass [m/s^2], the measured one less its static offset.
    """

    run: Measurement
    nrmse: float
    measured: FloatArray
    predicted: FloatArray


def modelled(model: Model, grip_N: float, instrument: Instrument, frequencies_Hz: FloatArray) -> ComplexArray:
    """(m,) sampled acceleration over sampled current at a grip [m/s^2/A]."""
    blended = np.zeros(frequencies_Hz.size, dtype=complex)
    for plant, weight in model.shares(grip_N):
        blended += weight * sampled_response(plant, instrument, frequencies_Hz)[0]
    return blended


def through(
    values: FloatArray, dt_s: float, ratio: Callable[[FloatArray], ComplexArray], *, zero_Hz: float | None = None
) -> FloatArray:
    """(..., n) what a signal (n,) from rest becomes behind responses; what rings on after its end is cut off.

    Parameters
    ----------
    ratio : frequencies (m,) above 0 -> responses (..., m).
    zero_Hz : the frequency that stands for 0, where responses may be infinite; without it a small part of the first.
    """
    size = fft.next_fast_len(values.size + round(PADDING_S / dt_s), real=True)
    frequencies = fft.rfftfreq(size, dt_s)
    frequencies[0] = NEAR_ZERO * frequencies[1] if zero_Hz is None else zero_Hz
    return np.asarray(fft.irfft(fft.rfft(values, size) * ratio(frequencies), size)[..., : values.size])


def predict(model: Model, grip_N: float, instrument: Instrument, current_A: FloatArray) -> FloatArray:
    """(n,) sampled acceleration behind the accelerometer's pole that a sampled current from rest comes with [m/s^2].

    Through the ratio of the sampled spectra, so that what the current does between its samples is what a held
    command makes it do; inverting the hold in the time domain is unstable where the delay exceeds half a period.
    """
    return through(current_A, instrument.dt_s, lambda f: modelled(model, grip_N, instrument, f))


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
    """Relative error of several transients as one: a quiet one counts no more than a loud one. NaN without any."""
    if not transients:
        return float("nan")
    measured, predicted = (
        np.concatenate([getattr(t, part) for t in transients]) for part in ("measured", "predicted")
    )
    return nrmse(predicted, measured)


def called(grip_N: float) -> str:
    """How messages call a grip."""
    return "free device" if grip_N == 0 else f"{grip_N:.3g} N"
