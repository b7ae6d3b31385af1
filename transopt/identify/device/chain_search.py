"""The drive chain and its instrument as a parameterisation of the likelihood: unknowns, responses, slopes, bounds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from transopt.base.signals import ComplexArray, FloatArray
from transopt.identify.condensed import Condensed
from transopt.identify.device.chain import HAND, SHARED, Coordinates, log_slopes
from transopt.identify.device.response import ACCELERATION, CURRENT, INSTRUMENT, Instrument, responses
from transopt.identify.likelihood import Likelihood, Maximum
from transopt.identify.spectrum import TransferEstimate

RANGE = 1e3  # every parameter of the chain stays within this factor of its start


@dataclass(frozen=True)
class GripResponse:
    """What was measured at one grip, 0 for the free device.

    Attributes
    ----------
    grip_N : of the trials, their mean.
    estimate : acceleration over current, by itself.
    data : what all lines say, from command to current, acceleration and position, or from current to the latter.
    outputs : which rows of `responses` the outputs of `data` are.
    commanded : whether the input of `data` is the command.
    """

    grip_N: float
    estimate: TransferEstimate
    data: Condensed
    outputs: tuple[int, ...]
    commanded: bool

    @property
    def deviation(self) -> FloatArray:
        """(m,) standard deviation of real and imaginary part of `estimate`, above 0."""
        return np.asarray(np.maximum(self.estimate.deviation, np.finfo(float).tiny))


class ChainModel:
    """Responses of all grips and their slopes by theta: the chain's unknowns, then those of `INSTRUMENT`.

    A group is a grip, its outputs and whether the command goes in (see `GripResponse`).
    """

    def __init__(
        self,
        groups: Sequence[tuple[float, tuple[int, ...], bool]],
        coordinates: Coordinates,
        instrument: Instrument,
        force_per_current_N_A: float,
        free: NDArray[np.bool_],
    ) -> None:
        self._groups, self._coordinates = groups, coordinates
        self._instrument, self._force = instrument, force_per_current_N_A
        self._moved = tuple(name for name, moves in zip(INSTRUMENT, free[coordinates.size :], strict=True) if moves)

    def __call__(self, theta: FloatArray, j: int, frequencies_Hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        (grip_N, outputs, commanded), coordinates, n, h = self._groups[j], self._coordinates, len(SHARED), len(HAND)
        device = coordinates.device(theta[: coordinates.size], self._force)
        instrument = instrument_at(theta[coordinates.size :], self._instrument)
        parameters = device.parameters(grip_N)
        plant, by_log = log_slopes(parameters, self._force)
        position = max(outputs) > ACCELERATION
        value, moved = responses(plant, instrument, frequencies_Hz, by_log, position=position, moved=self._moved)
        slope = np.zeros((theta.size, *value.shape), dtype=complex)
        slope[:n] = moved[:n]
        if grip_N > 0:
            for end, (end_N, share) in enumerate(zip(coordinates.ends_N, coordinates.shares(grip_N), strict=True)):
                part = share * device.hand_at(end_N) / parameters[n:]
                slope[n + end * h : n + (end + 1) * h] = part[:, None, None] * moved[n : n + h]
        for name, by in zip(self._moved, moved[parameters.size :], strict=True):
            slope[coordinates.size + INSTRUMENT.index(name)] = (
                instrument.dt_s * by if name == "amplifier_delay" else by
            )
        if not commanded:
            slope = (slope - value / value[CURRENT] * slope[:, CURRENT, None]) / value[CURRENT]
            value = value / value[CURRENT]
        wanted = list(outputs)
        return value[wanted], slope[:, wanted]


def instrument_at(values: FloatArray, known: Instrument) -> Instrument:
    """The instrument of (6,) unknowns; parts that it does not have stay absent."""
    pole, ticks, gain, sensor, late, factor = values.tolist()
    amplifier = known.amplifier
    if amplifier is not None:
        amplifier = replace(amplifier, pole_Hz=float(np.exp(pole)), delay_s=max(ticks, 0.0) * known.dt_s)
    return replace(
        known,
        amplifier=amplifier,
        accelerometer_Hz=None if known.accelerometer_Hz is None else float(np.exp(sensor)),
        gain=float(np.exp(factor)),
        late=late,
        amplifier_gain=float(np.exp(gain)),
    )


def unknowns_of(instrument: Instrument) -> FloatArray:
    """(6,) unknowns of an instrument."""
    amplifier, sensor = instrument.amplifier, instrument.accelerometer_Hz
    return np.array(
        [
            0.0 if amplifier is None else np.log(amplifier.pole_Hz),
            0.0 if amplifier is None else amplifier.delay_s / instrument.dt_s,
            np.log(instrument.amplifier_gain),
            0.0 if sensor is None else np.log(sensor),
            instrument.late,
            np.log(instrument.gain),
        ]
    )


class ChainSearch:
    """One likelihood, where to begin, and how far each unknown may go."""

    def __init__(
        self,
        measured: Sequence[GripResponse],
        coordinates: Coordinates,
        instrument: Instrument,
        force_per_current_N_A: float,
        free: NDArray[np.bool_],
        *,
        loose: float = 0.0,
        step: int = 1,
    ) -> None:
        groups = [(one.grip_N, one.outputs, one.commanded) for one in measured]
        model = ChainModel(groups, coordinates, instrument, force_per_current_N_A, free)
        self.likelihood = Likelihood([one.data for one in measured], model, loose=loose, step=step)
        self._coordinates, self._free, self._rate = coordinates, free, 1 / instrument.dt_s

    def bounds(self, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(p,) lowest and highest."""
        size, rate = self._coordinates.size, self._rate
        low, high = start - np.log(RANGE), start + np.log(RANGE)
        low[size:] = [np.log(1e-3 * rate), 0.0, -np.log(20.0), np.log(0.01 * rate), -20.0, -np.log(20.0)]
        high[size:] = [np.log(2 * rate), 20.0, np.log(20.0), np.log(2 * rate), 20.0, np.log(20.0)]
        return low, high

    def coarse(self, start: FloatArray) -> tuple[FloatArray, float]:
        """Point that the search from a start leads to, and its sum of squares."""
        return self.likelihood.search(start, *self.bounds(start), self._free, most=60)

    def maximum(self, start: FloatArray) -> Maximum:
        """The best unknowns near a start."""
        return self.likelihood.maximum(start, *self.bounds(start), self._free)
