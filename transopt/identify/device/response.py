"""What a sweep of sampled current and acceleration shows of a continuous device, exactly, with derivatives.

A command is held over a servo period; the amplifier's current follows with a pole and a delay; the accelerometer has
a pole of its own; everything is read at the ticks. The ratio of the sampled acceleration's spectrum to the sampled
current's is therefore not G(j w): at 10 kHz the images of the hold change it by 1 % at 800 Hz and by 7 % at 2 kHz.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from transopt.base.signals import FloatArray
from transopt.identify.amplifier import sampled_response as amplifier_response
from transopt.plant.amplifier import Amplifier
from transopt.plant.discretise import acting_states, split_delay
from transopt.plant.state_space import StateSpace

TAYLOR_DEGREE = 12  # of a matrix of norm 1/4: the rest is below 1e-17


@dataclass(frozen=True)
class Instrument:
    """What stands between a device and the recorded numbers.

    Attributes
    ----------
    dt_s : period of the servo and of the samples, which are read at t_k, before the command of t_k acts.
    amplifier : None is ideal.
    accelerometer_Hz : its one pole; None is ideal.
    """

    dt_s: float
    amplifier: Amplifier | None = None
    accelerometer_Hz: float | None = None


@dataclass(frozen=True)
class Slope:
    """Derivative of a plant by one parameter: dA (n, n), dB (n, 1), dC (1, n), dD (1, 1)."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray


def _flow(matrix: FloatArray, slopes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """exp(M) (n, n) and its derivatives along `slopes` (p, n, n), by Taylor's series, scaled and squared.

    scipy.linalg.expm and expm_frechet take milliseconds each when their threads meet busy cores.
    """
    norm = float(np.abs(matrix).sum(axis=0).max())
    squarings = max(int(np.ceil(np.log2(max(4 * norm, 1e-300)))), 0)
    M, dM = matrix / 2.0**squarings, slopes / 2.0**squarings
    term, value = np.eye(matrix.shape[0]), np.eye(matrix.shape[0])
    d_term, d_value = np.zeros_like(dM), np.zeros_like(dM)
    for degree in range(1, TAYLOR_DEGREE + 1):
        d_term = (dM @ term + M @ d_term) / degree
        term = M @ term / degree
        value, d_value = value + term, d_value + d_term
    for _ in range(squarings):
        d_value = value @ d_value + d_value @ value
        value = value @ value
    return value, d_value


def _generator(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, instrument: Instrument) -> FloatArray:
    """(N + 1, N + 1) flow of plant, current and accelerometer, the felt command last; ideal parts are absent."""
    n = A.shape[0]
    pole, sensed = instrument.amplifier is not None, instrument.accelerometer_Hz is not None
    size = n + pole + sensed + 1
    flow = np.zeros((size, size))
    current = n if pole else size - 1  # an ideal amplifier's current is the felt command itself
    flow[:n, :n], flow[:n, current] = A, B[:, 0]
    if instrument.accelerometer_Hz is not None:
        rate, row = 2 * np.pi * instrument.accelerometer_Hz, n + pole
        flow[row, :n], flow[row, current] = rate * C[0], rate * D[0, 0]
    return flow


@dataclass(frozen=True)
class _Sampled:
    """x+ = phi x + now c_k + before c_(k-1) with its outputs at the ticks, and the slopes (p, ...) of all of it."""

    phi: FloatArray
    now: FloatArray
    before: FloatArray
    d_phi: FloatArray
    d_now: FloatArray
    d_before: FloatArray
    row: FloatArray
    direct: float
    d_row: FloatArray
    d_direct: FloatArray


def _structure(plant: StateSpace, slopes: tuple[Slope, ...]) -> StateSpace:
    """Where plant or slopes have entries: a state whose output happens to be zero has a slope all the same."""
    A, C = (np.abs(getattr(plant, part)) + sum(np.abs(getattr(slope, part)) for slope in slopes) for part in "AC")
    return StateSpace(A, plant.B, C, plant.D, plant.outputs)


def _sampled(plant: StateSpace, instrument: Instrument, slopes: tuple[Slope, ...]) -> _Sampled:
    keep = acting_states(_structure(plant, slopes))
    n, some = int(keep.sum()), np.ix_(keep, keep)
    pole, sensed = instrument.amplifier is not None, instrument.accelerometer_Hz is not None
    M = _generator(plant.A[some], plant.B[keep], plant.C[:, keep], plant.D, instrument)
    size = M.shape[0]
    dM = np.zeros((len(slopes), size, size))
    for j, slope in enumerate(slopes):
        dM[j] = _generator(slope.A[some], slope.B[keep], slope.C[:, keep], slope.D, instrument)
    if instrument.amplifier is not None:
        rate = instrument.amplifier.rate_rad_s
        M[n, n], M[n, -1] = -rate, rate
    if instrument.accelerometer_Hz is not None:
        M[n + pole, n + pole] = -2 * np.pi * instrument.accelerometer_Hz
    # Elongations and velocities in SI differ by orders of magnitude: exact powers of two bring them together.
    _, (scale, _) = linalg.matrix_balance(M, permute=False, separate=True)
    M, dM = M * scale / scale[:, None], dM * scale / scale[:, None]

    dt = instrument.dt_s
    _, late = split_delay(0.0 if instrument.amplifier is None else instrument.amplifier.delay_s, dt)
    whole, d_whole = _flow(M * dt, dM * dt)
    rest, d_rest = _flow(M * (dt - late), dM * (dt - late))

    row, d_row = np.zeros(size), np.zeros((len(slopes), size))
    direct, d_direct = 0.0, np.zeros(len(slopes))
    if sensed:
        row[size - 2] = 1.0
    else:
        row[:n] = plant.C[0, keep]
        d_row[:, :n] = np.array([slope.C[0, keep] for slope in slopes]).reshape(-1, n)
        if pole:
            row[n], d_row[:, n] = plant.D[0, 0], [slope.D[0, 0] for slope in slopes]
        else:
            direct, d_direct = float(plant.D[0, 0]), np.array([slope.D[0, 0] for slope in slopes])
    row, d_row = row * scale, d_row * scale
    return _Sampled(
        phi=whole[:-1, :-1],
        now=rest[:-1, -1],
        before=whole[:-1, -1] - rest[:-1, -1],
        d_phi=d_whole[:, :-1, :-1],
        d_now=d_rest[:, :-1, -1],
        d_before=d_whole[:, :-1, -1] - d_rest[:, :-1, -1],
        row=row[:-1],
        direct=direct,
        d_row=d_row[:, :-1],
        d_direct=d_direct,
    )


def current_response(instrument: Instrument, frequencies_Hz: FloatArray) -> FloatArray:
    """(m,) sampled current over command, whole periods of the delay left out: what cancels in a ratio."""
    amplifier, dt_s = instrument.amplifier, instrument.dt_s
    if amplifier is None:
        return np.asarray(np.exp(-2j * np.pi * np.asarray(frequencies_Hz) * dt_s))
    late_s = split_delay(amplifier.delay_s, dt_s)[1]
    return np.asarray(amplifier_response(frequencies_Hz, amplifier.pole_Hz, late_s, dt_s))


def sampled_response(
    plant: StateSpace,
    instrument: Instrument,
    frequencies_Hz: FloatArray,
    slopes: tuple[Slope, ...] = (),
) -> tuple[FloatArray, FloatArray]:
    """Sampled acceleration over sampled current at the given frequencies, and its derivatives.

    With x+ = Phi x + G0 c_k + G1 c_(k-1) between ticks (G0, G1: after and before the delayed switch),
    H_a = (C (z - Phi)^-1 (G0 + G1 / z) + D / z), the ratio is H_a / H_i, H_i likewise of the current.

    Parameters
    ----------
    frequencies_Hz : (m,) above 0, up to half the rate.
    slopes : p derivatives of the plant.

    Returns
    -------
    (m,) complex [m/s^2/A] and (p, m) complex.
    """
    model = _sampled(plant, instrument, slopes)
    back = np.exp(-2j * np.pi * np.asarray(frequencies_Hz, dtype=float) * instrument.dt_s)
    resolvent = (1 / back)[:, None, None] * np.eye(model.phi.shape[0]) - model.phi
    driven = model.now + model.before * back[:, None]
    state = np.linalg.solve(resolvent, driven[:, :, None])[:, :, 0]
    by_current = 1 / current_response(instrument, frequencies_Hz)
    value = (state @ model.row + model.direct * back) * by_current
    if not slopes:
        return np.asarray(value), np.zeros((0, back.size), dtype=complex)
    observed = np.linalg.solve(np.swapaxes(resolvent, 1, 2), np.broadcast_to(model.row[:, None], (*driven.shape, 1)))[
        :, :, 0
    ]
    # (p, m): the observer's row times what moves in the equation of the state.
    moved = np.einsum("mi,pij,mj->pm", observed, model.d_phi, state, optimize=True)
    moved += model.d_now @ observed.T + (model.d_before @ observed.T) * back
    moved += model.d_row @ state.T + model.d_direct[:, None] * back
    return np.asarray(value), np.asarray(moved * by_current)
