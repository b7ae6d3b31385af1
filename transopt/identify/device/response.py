"""Exact sampled response of a continuous device behind its instrument, with derivatives.

A command is held over a servo period; the amplifier's current follows with a pole and a delay; the accelerometer has
a pole; all signals are read at the ticks. The ratio of the sampled acceleration's spectrum to the sampled current's
is therefore not G(j w): at 10 kHz the images of the hold change it by 1 % at 800 Hz and by 7 % at 2 kHz.
"""

from dataclasses import dataclass
from math import factorial

import numpy as np
from scipy import linalg

from transopt.base.recursions import LinearSystem
from transopt.base.signals import ComplexArray, FloatArray
from transopt.identify.amplifier_response import sampled
from transopt.plant.amplifier import Amplifier
from transopt.plant.discretise import acting_states, split_delay
from transopt.plant.state_space import StateSpace

TAYLOR_DEGREE = 12  # a multiple of 3; for a matrix of norm 1/4 the remainder is below 1e-17
CURRENT, ACCELERATION, POSITION = range(3)  # rows of the result of `responses`
INSTRUMENT = ("amplifier_pole", "amplifier_delay", "amplifier_gain", "accelerometer_pole", "late", "gain")


@dataclass(frozen=True)
class Instrument:
    """Amplifier, sensors and sampling between a device and its records.

    Attributes
    ----------
    dt_s : period of the servo and of the samples, which are read at t_k, before the command of t_k acts.
    amplifier : None if ideal.
    accelerometer_Hz : pole of the accelerometer; None if ideal.
    gain : recorded acceleration over the true one.
    late : delay [samples] of the acceleration's reading against the current's; may be fractional.
    amplifier_gain : current over command at low frequency.
    """

    dt_s: float
    amplifier: Amplifier | None = None
    accelerometer_Hz: float | None = None
    gain: float = 1.0
    late: float = 0.0
    amplifier_gain: float = 1.0


@dataclass(frozen=True)
class Slope:
    """Derivative of a plant by one parameter: dA (n, n), dB (n, 1), dC (1, n), dD (1, 1)."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray


def flow(matrices: FloatArray) -> FloatArray:
    """(..., 1 + p, n, n): exp(M) of the first matrix of each stack and its derivatives along the other p.

    Taylor series with scaling and squaring, since scipy.linalg.expm and expm_frechet take milliseconds each when
    their threads meet busy cores. Summation in powers of M^3 halves the number of products (Paterson & Stockmeyer
    1973).
    """
    norm = float(np.abs(matrices[..., 0, :, :]).sum(axis=-2).max())
    squarings = max(int(np.ceil(np.log2(max(4 * norm, 1e-300)))), 0)
    M, dM = matrices[..., :1, :, :] / 2.0**squarings, matrices[..., 1:, :, :] / 2.0**squarings
    square, d_square = M @ M, dM @ M + M @ dM
    cube, d_cube = square @ M, d_square @ M + square @ dM
    one = np.eye(M.shape[-1])
    value, d_value = one / factorial(TAYLOR_DEGREE), np.zeros_like(dM)
    for degree in range(TAYLOR_DEGREE - 3, -1, -3):
        first, second, third = (1 / factorial(degree + more) for more in range(3))
        d_value = d_value @ cube + value @ d_cube + second * dM + third * d_square
        value = value @ cube + first * one + second * M + third * square
    for _ in range(squarings):
        d_value = value @ d_value + d_value @ value
        value = value @ value
    return np.concatenate([value, d_value], axis=-3)


def _generator(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, pole: bool, sensor_Hz: float | None
) -> FloatArray:
    """(1 + p, N + 1, N + 1) generator of plant, current, accelerometer and acting command; ideal parts have no state.

    A, B, C, D : (1 + p, ...) of the plant and its derivatives, in which the generator is linear.
    """
    n = A.shape[1]
    size = n + pole + (sensor_Hz is not None) + 1
    flow = np.zeros((len(A), size, size))
    current = n if pole else size - 1  # an ideal amplifier's current is the acting command itself
    flow[:, :n, :n], flow[:, :n, current] = A, B[:, :, 0]
    if sensor_Hz is not None:
        rate, row = 2 * np.pi * sensor_Hz, n + pole
        flow[:, row, :n], flow[:, row, current] = rate * C[:, 0], rate * D[:, 0, 0]
    return flow


@dataclass(frozen=True)
class _Sampled:
    """x+ = phi x + now c_k + before c_(k-1) with its outputs at the ticks: the model, then its p derivatives.

    Attributes
    ----------
    phi : (1 + p, n, n).
    now, before : (1 + p, n).
    rows, direct : (1 + p, o, n) and (1 + p, o), outputs `CURRENT`, `ACCELERATION` and, on request, `POSITION`.
    """

    phi: FloatArray
    now: FloatArray
    before: FloatArray
    rows: FloatArray
    direct: FloatArray


def _sampled(
    plant: StateSpace,
    instrument: Instrument,
    slopes: tuple[Slope, ...],
    position: bool,
    moved: tuple[str, ...],
    ramped: bool = False,
) -> _Sampled:
    A, B, C, D = (np.array([getattr(part, name) for part in (plant, *slopes)]) for name in "ABCD")
    # A state acts if an entry of the plant or of a derivative is not zero: a zero entry may have a derivative.
    entries = StateSpace(np.abs(A).sum(axis=0), plant.B, np.abs(C).sum(axis=0), plant.D, plant.outputs)
    keep = acting_states(entries, position=position)
    A, B, C, n = A[:, keep][:, :, keep], B[:, keep], C[:, :, keep], int(keep.sum())
    amplifier, sensor = instrument.amplifier, instrument.accelerometer_Hz
    pole, sensed = ramped or amplifier is not None, sensor is not None
    M, parts = _generator(A, B, C, D, pole, sensor), len(A)
    size = M.shape[1]
    M = np.concatenate([M, np.zeros((len(moved), size, size))])
    if ramped:
        M[0, n, -1] = 1 / instrument.dt_s
    elif amplifier is not None:
        M[0, n, n], M[0, n, -1] = -amplifier.rate_rad_s, amplifier.rate_rad_s
    if sensor is not None:
        M[0, n + pole, n + pole] = -2 * np.pi * sensor
    for j, name in enumerate(moved, parts):
        if name == "amplifier_pole":
            M[j, n] = M[0, n]
        elif name == "accelerometer_pole":
            M[j, n + pole] = M[0, n + pole]
    # Elongations and velocities in SI differ by orders of magnitude: balance them by exact powers of two.
    _, (scale, _) = linalg.matrix_balance(M[0], permute=False, separate=True)
    M = M * scale / scale[:, None]

    dt = instrument.dt_s
    _, late = split_delay(0.0 if amplifier is None else amplifier.delay_s, dt)
    whole = flow(M * dt)
    rest = flow(M * (dt - late)) if late else whole.copy()
    for j, name in enumerate(moved, parts):
        if name == "amplifier_delay":
            rest[j] = -M[0] @ rest[0]

    rows, direct = np.zeros((len(M), 2 + position, size)), np.zeros((len(M), 2 + position))
    if pole:
        rows[0, CURRENT, n] = 1.0
    else:
        direct[0, CURRENT] = 1.0
    if sensed:
        rows[0, ACCELERATION, size - 2] = 1.0
    else:
        rows[:parts, ACCELERATION, :n] = C[:, 0]
        if pole:
            rows[:parts, ACCELERATION, n] = D[:, 0, 0]
        else:
            direct[:parts, ACCELERATION] = D[:, 0, 0]
    if position:
        rows[0, POSITION, :n] = plant.Ce[0, keep]
    return _Sampled(
        phi=whole[:, :-1, :-1],
        now=rest[:, :-1, -1],
        before=(whole - rest)[:, :-1, -1],
        rows=(rows * scale)[..., :-1],
        direct=direct,
    )


def _resolved(T: ComplexArray, z: ComplexArray, right: ComplexArray) -> ComplexArray:
    """(n, m) solutions of (z I - T) x = right (n, m) for an upper triangular T.

    It sums with einsum, since matrix products would start the threads of BLAS for a few additions each.
    """
    x = np.empty_like(right)
    for j in range(T.shape[0] - 1, -1, -1):
        x[j] = (right[j] + np.einsum("k,km->m", T[j, j + 1 :], x[j + 1 :])) / (z - T[j, j])
    return x


def _observed(T: ComplexArray, z: ComplexArray, rows: ComplexArray) -> ComplexArray:
    """(o, n, m) solutions of y (z I - T) = row for each of the rows (o, n)."""
    y = np.empty((*rows.shape, z.size), dtype=complex)
    for j in range(T.shape[0]):
        y[:, j] = (rows[:, j, None] + np.einsum("okm,k->om", y[:, :j], T[:j, j])) / (z - T[j, j])
    return y


def responses(
    plant: StateSpace,
    instrument: Instrument,
    frequencies_Hz: FloatArray,
    slopes: tuple[Slope, ...] = (),
    *,
    position: bool = False,
    moved: tuple[str, ...] = (),
) -> tuple[ComplexArray, ComplexArray]:
    """Sampled current, acceleration and position over the command at the given frequencies, and their derivatives.

    With x+ = Phi x + G0 c_k + G1 c_(k-1) between ticks (G0, G1: after and before the delayed switch) and w whole
    periods of delay, H = z^-w (C (z - Phi)^-1 (G0 + G1 / z) + D / z). With a Schur form of Phi each frequency takes
    one back-substitution.

    Parameters
    ----------
    frequencies_Hz : (m,) above 0, up to half the rate.
    slopes : p derivatives of the plant.
    position : whether to include the encoder's position.
    moved : q names of `INSTRUMENT` to differentiate by: poles and gains by their logarithms, the delay in seconds,
        `late` in samples.

    Returns
    -------
    (o, m) complex [A/A, m/s^2/A, m/A] and (p + q, o, m) complex; o is 3 with `position`, else 2.
    """
    model = _sampled(plant, instrument, slopes, position, moved)
    back: ComplexArray = np.exp(-2j * np.pi * np.asarray(frequencies_Hz, dtype=float) * instrument.dt_s)
    z: ComplexArray = 1 / back
    T, Z = linalg.schur(model.phi[0].astype(complex), output="complex")
    whole = 0 if instrument.amplifier is None else split_delay(instrument.amplifier.delay_s, instrument.dt_s)[0]
    # In the Schur basis: n state equations and o output rows, with columns for the state, for c_k and for c_(k-1).
    Zh, driven = Z.conj().T, np.stack([model.now, model.before], axis=2)
    equations = np.concatenate([Zh @ model.phi @ Z, Zh @ driven], axis=2)
    outputs = np.concatenate([model.rows @ Z, np.zeros((*model.direct.shape, 1)), model.direct[..., None]], axis=2)
    now, before = equations[0, :, -2, None], equations[0, :, -1, None]
    state = np.concatenate([_resolved(T, z, now + before * back), np.ones((1, z.size)), back[None]])
    scale = np.full((2 + position, back.size), instrument.amplifier_gain * back**whole)
    scale[ACCELERATION] *= instrument.gain * back**instrument.late
    value = np.einsum("on,nm->om", outputs[0], state) * scale
    if not slopes and not moved:
        return np.asarray(value), np.zeros((0, *value.shape), dtype=complex)
    # Derivative of the output: adjoint rows times the derivative of the state equation, plus that of the output row.
    observed, moves = _observed(T, z, outputs[0, :, :-2]), equations[1:] @ state
    slope = (observed.transpose(2, 0, 1) @ moves.transpose(2, 1, 0)).transpose(2, 1, 0)
    slope = (slope + outputs[1:] @ state) * scale
    for j, name in enumerate(moved, len(slopes)):
        if name == "amplifier_gain":
            slope[j] = value
        elif name == "gain":
            slope[j, ACCELERATION] = value[ACCELERATION]
        elif name == "late":
            slope[j, ACCELERATION] = np.log(back) * value[ACCELERATION]
    return np.asarray(value), slope


def courses(
    plant: StateSpace,
    instrument: Instrument,
    input_A: FloatArray,
    slopes: tuple[Slope, ...] = (),
    *,
    ramped: bool = False,
) -> FloatArray:
    """Current, acceleration and position at the ticks under commands, from rest, and their derivatives.

    It is the sampled model of `responses` in the time domain, without gain and lateness of the instrument.

    Parameters
    ----------
    input_A : (K,) commands, issued at the ticks and held. slopes : p derivatives of the plant.
    ramped : whether the input is instead the current at the ticks, linear between them, and no amplifier acts.

    Returns
    -------
    (1 + p, 3, K) [A, m/s^2, m].
    """
    model = _sampled(plant, instrument, slopes, position=True, moved=(), ramped=ramped)
    amplifier = instrument.amplifier
    whole = 0 if amplifier is None or ramped else split_delay(amplifier.delay_s, instrument.dt_s)[0]
    # A current that is linear between ticks integrates its differences, each held over the tick before.
    command = np.append(np.diff(input_A, prepend=0.0), 0.0) if ramped else input_A
    felt = np.concatenate([np.zeros(whole + 1), command])[: command.size + 1]
    felt = np.stack([felt[1:], felt[:-1]])  # acting commands of this tick and of the previous one
    phi, n = model.phi[0], model.phi.shape[1]
    driven, one = np.stack([model.now, model.before], axis=2), np.eye(n)
    states = LinearSystem(phi, driven[0], one, np.zeros((n, 2))).outputs(felt)
    found = model.rows @ states + model.direct[..., None] * felt[1]
    follow = LinearSystem(phi, one, model.rows[0], np.zeros((len(model.rows[0]), n)))
    found[1:] += follow.outputs(model.phi[1:] @ states + driven[1:] @ felt)
    return np.asarray(found[..., 1:] if ramped else found)


def current_response(instrument: Instrument, frequencies_Hz: FloatArray) -> ComplexArray:
    """(m,) sampled current over command."""
    amplifier, dt_s = instrument.amplifier, instrument.dt_s
    if amplifier is None:
        return np.asarray(np.exp(-2j * np.pi * frequencies_Hz * dt_s))
    return sampled(frequencies_Hz, amplifier.pole_Hz, amplifier.delay_s, dt_s)[0]


def sampled_response(
    plant: StateSpace,
    instrument: Instrument,
    frequencies_Hz: FloatArray,
    slopes: tuple[Slope, ...] = (),
) -> tuple[ComplexArray, ComplexArray]:
    """Sampled acceleration over sampled current at the given frequencies, and its derivatives: see `responses`.

    Parameters
    ----------
    frequencies_Hz : (m,) above 0, up to half the rate.
    slopes : p derivatives of the plant; the current does not depend on the plant.

    Returns
    -------
    (m,) complex [m/s^2/A] and (p, m) complex.
    """
    value, slope = responses(plant, instrument, frequencies_Hz, slopes)
    return value[ACCELERATION] / value[CURRENT], slope[:, ACCELERATION] / value[CURRENT]
