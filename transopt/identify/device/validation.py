"""Validation of identified models on held-out transients in the time domain, and their expected errors.

Measured and predicted acceleration both pass a causal 8 Hz high-pass: slower motion of a held device is mostly the
hand's own, which no model of the device predicts. The remaining error is the one that a design with this model
ignores.

The verdict on a model rests on the expected error of its response, and on the errors of the scene's taps that follow
from it. In a band of frequency the mean square of (model - estimate) is that of the noise, less the part that the fit
absorbs, plus that of the model's own error. With the noise known from the records and the parameters' covariance from
the fit, the expected square of the model's error is  misfit - 2 noise + 2 variance  (Mallows 1973, C_p), where
variance is that of the fitted response. Where the misfit does not exceed the noise significantly, only the variance
remains.
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
from transopt.scene.identified import TAP_HZ
from transopt.scene.model_error import ModelError, Predicted

HIGHPASS_HZ = 8.0
PADDING_S = 0.5  # zeros after a record, so that its ringing does not wrap around
NEAR_ZERO = 1e-3  # of the line spacing; replaces 0 Hz, where a free device has no finite state
BANDS_PER_OCTAVE = 3
CHANCE = 1e-5  # p value below which a band's misfit is attributed to the model, not to noise
EDGE = 2  # bins left out at either end of the excited band
FIT = 0.05  # largest predicted relative error of a tap for a model that is fit to design with
WORTHLESS = 0.5  # predicted relative error of a tap from which on a model supports no design


class Model(Protocol):
    """A model that gives the plant at a grip: `DriveChain` or `BlackBox`."""

    def plant(self, grip_N: float) -> StateSpace: ...


@dataclass(frozen=True)
class Transient:
    """A run, measured and predicted.

    Attributes
    ----------
    run : the record.
    nrmse : relative rms error of the prediction after the high-pass.
    measured, predicted : (n,) acceleration after the high-pass [m/s^2], the measured one less its static offset.
    """

    run: Measurement
    nrmse: float
    measured: FloatArray
    predicted: FloatArray


def modelled(model: Model, grip_N: float, instrument: Instrument, frequencies_Hz: FloatArray) -> ComplexArray:
    """(m,) response of a model at a grip: sampled acceleration over sampled current [m/s^2/A]."""
    return sampled_response(model.plant(grip_N), instrument, frequencies_Hz)[0]


def through(
    values: FloatArray, dt_s: float, ratio: Callable[[FloatArray], ComplexArray], *, zero_Hz: float | None = None
) -> FloatArray:
    """(..., n) output of frequency responses to a signal (n,) from rest; ringing after its end is cut off.

    Parameters
    ----------
    ratio : frequencies (m,) above 0 -> responses (..., m).
    zero_Hz : frequency that replaces 0 Hz, where responses may be infinite; None for `NEAR_ZERO` of the first line.
    """
    size = fft.next_fast_len(values.size + round(PADDING_S / dt_s), real=True)
    frequencies = fft.rfftfreq(size, dt_s)
    frequencies[0] = NEAR_ZERO * frequencies[1] if zero_Hz is None else zero_Hz
    return np.asarray(fft.irfft(fft.rfft(values, size) * ratio(frequencies), size)[..., : values.size])


def predict(model: Model, grip_N: float, instrument: Instrument, current_A: FloatArray) -> FloatArray:
    """(n,) predicted acceleration, sampled behind the accelerometer's pole, for a sampled current from rest [m/s^2].

    The ratio of sampled spectra implies that the current between samples is the response to a held command. Inverting
    the hold in the time domain instead would be unstable for delays above half a period.
    """
    return through(current_A, instrument.dt_s, lambda f: modelled(model, grip_N, instrument, f))


def compare(model: Model, grip_N: float, instrument: Instrument, run: Measurement) -> Transient:
    """Compare one transient with the model's prediction.

    The accelerometer's static offset (1 g if it stands upright) passes the high-pass as a step response; it is fitted
    by least squares and subtracted.
    """
    recorded = run.require("acceleration")

    def passed(values: FloatArray) -> FloatArray:
        return highpass(Signal(recorded.start_s, recorded.dt_s, values), HIGHPASS_HZ).values

    predicted = passed(predict(model, grip_N, instrument, felt_current(run, instrument.amplifier).values))
    measured, step = passed(recorded.values), passed(np.ones(recorded.values.size))
    offset = float(step @ (measured - predicted) / (step @ step))
    measured = measured - offset * step
    return Transient(run, nrmse(predicted, measured), measured, predicted)


def together(transients: Sequence[Transient]) -> float:
    """Relative error of several transients in one sum, so that loud ones weigh more than quiet ones; NaN if empty."""
    if not transients:
        return float("nan")
    measured, predicted = (
        np.concatenate([getattr(t, part) for t in transients]) for part in ("measured", "predicted")
    )
    return nrmse(predicted, measured)


def called(grip_N: float) -> str:
    """The name of a grip in messages."""
    return "free device" if grip_N == 0 else f"{grip_N:.3g} N"


@dataclass(frozen=True)
class Taps:
    """Taps of a scene, designed with a model.

    Attributes
    ----------
    speeds_m_s, grips_N : (nv,), (ng,).
    current_A : (ng, nv, N) currents.
    energy : (ng, nv) sum of squares of each tap's N samples of acceleration.
    dt_s : sampling period.
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
    """The expected square of the error of a fitted response, in bands of frequency.

    Parameters
    ----------
    variance : function that gives the variances E|.|^2 (m,) of the fitted response at the bins of an estimate,
        against the mean recorded response and against that of the next tap.
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
    """(bands,) expected square of the error at one grip."""
    # At the ends of the excited band the response is not a polynomial over the lines of a bin.
    inner = slice(EDGE, -EDGE) if one.estimate.response.size > 4 * EDGE else slice(None)
    f, noise, variance = one.estimate.frequencies_Hz[inner], 2 * one.deviation[inner] ** 2, variance[inner]
    coming = coming[inner]
    beyond = np.abs(modelled(model, one.grip_N, instrument, f) - one.estimate.response[inner]) ** 2 - noise + variance
    # The error on the device is the one behind the sensor, divided by the sensor's squared gain.
    seen = instrument.gain**2 / (1 + (f / (instrument.accelerometer_Hz or np.inf)) ** 2)
    band = np.clip(np.searchsorted(edges, f, side="right") - 1, 0, edges.size - 2)
    count = np.bincount(band, minlength=edges.size - 1)
    filled = count > 0

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(band, values, edges.size - 1)[filled] / count[filled])

    excess = mean(beyond / seen)
    # Squares of complex errors have 2 degrees of freedom each; the noise has those of its estimate.
    ratio, degrees = 1 + mean(beyond / noise), mean(one.estimate.degrees[inner])
    clear = stats.f.sf(ratio, 2 * count[filled], degrees) < CHANCE
    if stats.f.sf(np.average(ratio, weights=count[filled]), 2 * count.sum(), degrees.sum()) < CHANCE:
        clear |= excess > 0  # the misfit is significant over all bands together, if not in each one
    total = mean(coming / seen) + np.where(clear, np.maximum(excess, 0.0), 0.0)
    middles = np.log(np.sqrt(edges[:-1] * edges[1:]))
    return np.asarray(np.exp(np.interp(middles, middles[filled], np.log(np.maximum(total, 1e-300)))))


def relative(error: ModelError, measured: Sequence[GripResponse]) -> float:
    """Rms error of the model relative to the response, over all grips, for a current with a flat spectrum."""
    parts = []
    for one, row in zip(measured, error.power, strict=True):
        f = one.estimate.frequencies_Hz
        inside = (f >= TAP_HZ[0]) & (f <= TAP_HZ[1])
        width = np.gradient(f)[inside]
        off = np.interp(np.log(f[inside]), np.log(error.frequencies_Hz), row)
        square = np.abs(one.estimate.response[inside]) ** 2
        parts.append(np.average(off, weights=width) / np.average(square, weights=width))
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
    """One sentence that tells what a model is good for.

    Parameters
    ----------
    held_out : grip -> relative error of its held-out transients, noise included; NaN if it has none.
    uncovered : sentence on taps beyond the recorded currents (`not_covered`).
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
    sentence = (
        f"model error {100 * middle:.2g} % of a tap (worst {100 * worst:.2g} %, at {speed:g} m/s, "
        f"{called(grip)}): design errors below that are the model's{noise}"
    )
    return "; ".join(filter(None, [sentence, uncovered]))


def not_covered(error: ModelError, taps: Taps) -> str:
    """One sentence if taps need more current than was recorded, with the record to add; else empty."""
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
    """Shortfalls of a model by its predicted taps, each with what to record again."""
    if predicted is None:
        return []
    sentences = []
    for grip, row in zip(predicted.grips_N, predicted.nrmse, strict=True):
        if not max(row) <= FIT:
            speed = predicted.speeds_m_s[int(np.argmax(row))]
            sentences.append(
                f"{called(grip)}: predicted to miss {100 * max(row):.2g} % of the tap at {speed:g} m/s, limit "
                f"{100 * FIT:g} %; see what was found, and record this grip again"
            )
    return sentences
