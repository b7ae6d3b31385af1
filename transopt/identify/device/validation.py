"""Identified models against transients that were not used in the fit, in the time domain.

Measured and predicted acceleration both pass a causal 8 Hz high-pass: in a record of a held device what is slower is
mostly the hand's own motion, which no model of the device predicts. The error that is left is what a design with this
model would not know of.

What a model is good for is said by how far its response is off, and what that makes of the taps to be played. In a
band of frequency the mean square of (model - estimate) is the noise's, less what the fit has made up for, plus that
of the model's own error. With the noise known from the records and the parameters' covariance from the fit, the
expected square of the model's error is  misfit - 2 noise + 2 variance  (Mallows 1973, C_p), where variance is that of
the fitted response. Where the misfit is not significantly more than noise, only the variance is left.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import fft, stats

from transopt.base.filters import highpass
from transopt.base.signals import ComplexArray, FloatArray, Signal, nrmse
from transopt.identify.device.chain import GripResponse
from transopt.identify.device.response import Instrument, sampled_response
from transopt.identify.device.trials import felt_current
from transopt.identify.measurement import Measurement
from transopt.plant.state_space import StateSpace
from transopt.scene.model_error import ModelError, Predicted

HIGHPASS_HZ = 8.0
PADDING_S = 0.5  # after a record, for the ringing that its end cuts off
NEAR_ZERO = 1e-3  # of a spectrum's line: a free device has no finite state at exactly 0 Hz, but a response beside it
BANDS_PER_OCTAVE = 3
CHANCE = 1e-5  # at which noise alone makes a band's misfit as large: below it the misfit is the model's
EDGE = 2  # bins at either end of what was excited
TAP_HZ = 5.0, 600.0  # where a tap has its energy
FIT = 0.05  # predicted relative error of a tap up to which a model is fit to design with
WORTHLESS = 0.5


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


@dataclass(frozen=True)
class Taps:
    """Taps of a scene, designed with a model.

    Attributes
    ----------
    speeds_m_s, grips_N : (nv,), (ng,).
    current_A : (ng, nv, N).
    energy : (ng, nv) sum of squares of each tap's N samples of acceleration.
    dt_s : of the samples.
    """

    speeds_m_s: tuple[float, ...]
    grips_N: tuple[float, ...]
    current_A: FloatArray
    energy: FloatArray
    dt_s: float


def model_error(
    measured: Sequence[GripResponse],
    model: Model,
    instrument: Instrument,
    variance: Callable[[GripResponse], tuple[FloatArray, FloatArray]],
) -> ModelError:
    """The expected square of the error of a fitted response.

    Parameters
    ----------
    variance : (m,) of the fitted response at the bins of an estimate, E|.|^2, against the mean of what was recorded
        and against what the next tap will meet.
    """
    low = min(one.estimate.frequencies_Hz[0] for one in measured)
    high = max(one.estimate.frequencies_Hz[-1] for one in measured)
    bands = max(int(np.ceil(BANDS_PER_OCTAVE * np.log2(high / low))), 1)
    edges = np.geomspace(low, high * (1 + 1e-9), bands + 1)
    rows = [_row(one, model, instrument, *variance(one), edges) for one in measured]
    return ModelError(
        grips_N=[one.grip_N for one in measured],
        frequencies_Hz=np.sqrt(edges[:-1] * edges[1:]).tolist(),
        power=[row.tolist() for row in rows],
    )


def _row(
    one: GripResponse,
    model: Model,
    instrument: Instrument,
    variance: FloatArray,
    coming: FloatArray,
    edges: FloatArray,
) -> FloatArray:
    """(bands,) of one grip."""
    # At the ends of an excitation a response is no polynomial over the lines of a bin.
    inner = slice(EDGE, -EDGE) if one.estimate.response.size > 4 * EDGE else slice(None)
    f, noise, variance = one.estimate.frequencies_Hz[inner], 2 * one.deviation[inner] ** 2, variance[inner]
    coming = coming[inner]
    beyond = np.abs(modelled(model, one.grip_N, instrument, f) - one.estimate.response[inner]) ** 2 - noise + variance
    # What a sensor makes smaller was larger on the device.
    seen = instrument.gain**2 / (1 + (f / (instrument.accelerometer_Hz or np.inf)) ** 2)
    band = np.clip(np.searchsorted(edges, f, side="right") - 1, 0, edges.size - 2)
    count = np.bincount(band, minlength=edges.size - 1)
    filled = count > 0

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(band, values, edges.size - 1)[filled] / count[filled])

    excess = mean(beyond / seen)
    # Squares of complex errors have 2 degrees of freedom each, the noise those that it was estimated from.
    ratio, degrees = 1 + mean(beyond / noise), mean(one.estimate.degrees[inner])
    clear = stats.f.sf(ratio, 2 * count[filled], degrees) < CHANCE
    if stats.f.sf(np.average(ratio, weights=count[filled]), 2 * count.sum(), degrees.sum()) < CHANCE:
        clear |= excess > 0  # too little in any one band, but not in all together
    total = mean(coming / seen) + np.where(clear, np.maximum(excess, 0.0), 0.0)
    middles = np.log(np.sqrt(edges[:-1] * edges[1:]))
    return np.asarray(np.exp(np.interp(middles, middles[filled], np.log(np.maximum(total, 1e-300)))))


def relative(error: ModelError, measured: Sequence[GripResponse]) -> float:
    """How large a part of the answer to a current of even spectrum the model's error is, over all grips."""
    parts = []
    for one, row in zip(measured, error.power, strict=True):
        f = one.estimate.frequencies_Hz
        inside = (f >= TAP_HZ[0]) & (f <= TAP_HZ[1])
        width = np.gradient(f)[inside]
        off = np.interp(np.log(f[inside]), np.log(error.frequencies_Hz), row)
        parts.append(off @ width / (np.abs(one.estimate.response[inside]) ** 2 @ width))
    return float(np.sqrt(np.mean(parts)))


def predict_taps(error: ModelError, taps: Taps) -> Predicted:
    """Predicted relative error of each tap."""
    return Predicted(
        speeds_m_s=list(taps.speeds_m_s),
        grips_N=list(taps.grips_N),
        nrmse=[
            [
                error.nrmse(grip, taps.current_A[j, i], taps.dt_s, float(taps.energy[j, i]))
                for i in range(len(taps.speeds_m_s))
            ]
            for j, grip in enumerate(taps.grips_N)
        ],
    )


def verdict(predicted: Predicted | None, held_out: Mapping[float, float], uncovered: str = "") -> str:
    """In plain words what a model is good for.

    Parameters
    ----------
    held_out : grip -> relative error on what was kept out of the fit, noise included; NaN where nothing was.
    uncovered : what of the taps was not recorded (`not_covered`).
    """
    known = [error for error in held_out.values() if np.isfinite(error)]
    noise = f"; one recorded trial misses {100 * max(known):.2g} %, its noise included" if known else ""
    if predicted is None:
        return f"no taps to predict: name the scene that is to be played (--scene){noise}"
    worst, speed, grip = predicted.worst
    middle = float(np.median(predicted.nrmse))
    if worst >= WORTHLESS:
        return (
            f"supports no design: predicted to miss {100 * worst:.0f} % of the tap at {speed:g} m/s, {called(grip)}"
        )
    said = (
        f"model error {100 * middle:.2g} % of a tap (worst {100 * worst:.2g} %, at {speed:g} m/s, "
        f"{called(grip)}): design errors below that are the model's{noise}"
    )
    return "; ".join(filter(None, [said, uncovered]))


def not_covered(error: ModelError, taps: Taps) -> str:
    """One sentence where taps ask for more current than was recorded, and with what to record it; else empty."""
    peaks = np.abs(taps.current_A).max(axis=-1)
    beyond = [
        (float(row.max()), error.recorded_at(grip), grip)
        for grip, row in zip(taps.grips_N, peaks, strict=True)
        if not error.covers(grip, float(row.max()))
    ]
    if not beyond:
        return ""
    most, recorded, grip = max(beyond, key=lambda each: each[0] / each[1])
    return (
        f"not covered: taps reach {most:.3g} A at {called(grip)}, {recorded:.2g} A were recorded; an amplifier that "
        f"gives way or a skin that stiffens beyond that is not seen: add taps (record sweep --tap-current {most:.2g})"
    )


def short_of(predicted: Predicted | None) -> list[str]:
    """What keeps a model from being good enough, with what to record again."""
    if predicted is None:
        return []
    said = []
    for grip, row in zip(predicted.grips_N, predicted.nrmse, strict=True):
        if not max(row) <= FIT:
            speed = predicted.speeds_m_s[int(np.argmax(row))]
            said.append(
                f"{called(grip)}: predicted to miss {100 * max(row):.2g} % of the tap at {speed:g} m/s, limit "
                f"{100 * FIT:g} %; see what was found, and record this grip again"
            )
    return said
