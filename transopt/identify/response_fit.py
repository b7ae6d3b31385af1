"""A stable real state space fitted to one frequency response, by vector fitting.

Poles come from vector fitting (Gustavsen and Semlyen 1999, "Rational approximation of frequency domain responses by
vector fitting", IEEE Transactions on Power Delivery 14 (3)), the output row from linear least squares.

A sum of partial fractions with given poles is linear in its coefficients; in the real basis used here a pair of poles
p, p* has the two functions 1/(s - p) + 1/(s - p*) and j/(s - p) - j/(s - p*), which are the states of

    A = [[Re p, Im p], [-Im p, Re p]],  b = (2, 0),

so that the coefficients of the sum are the row C of a real state space.

A device held by a spring rests under a constant input, so its acceleration has two zeros at s = 0. No fitted
resonance is narrower than the points resolve: between two points a nearly undamped pole with a zero beside it would
cost nothing and explain a little noise, and a design would excite it.

A response measured by an analyser is that of the continuous device. The verdict on its fit is

    misfit = sqrt(sum |G_fit - G|^2 / sum |G|^2)  over the points of the band.

Where the variance of the points is known, as with a recorded sweep, each point is weighted by its inverse, in the
misfit too, and the misfit due to noise alone is stated beside it. Nothing was measured below the band, and a fit may
have a constant acceleration there under a constant input: so the two zeros at s = 0 are imposed wherever that hardly
raises the misfit.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import ComplexArray, FloatArray
from transopt.plant.state_space import Input, StateSpace

RELOCATIONS = 20
RESOLVED = 0.5  # of the distance between points: the least width of a resonance, since nothing was measured between
HIGHEST_ORDER = 40
MOST_MISFIT = 0.05  # a fit with more is not fit to design with
COSTS_NOTHING = 1.1  # the zeros at s = 0 are imposed if the misfit stays below this times that without them
CERTAIN = 3.0  # standard deviations allowed for noise
EXACT = 1e-6  # a misfit below this is rounding: the zeros are imposed without comparing


def fractions(s: ComplexArray, poles: ComplexArray) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """The real basis (m, n) of partial fractions at the points s, and the A (n, n) and b (n,) whose states they are.

    Parameters
    ----------
    poles : (n,) conjugate pairs adjacent.
    """
    order = poles.size
    basis = np.empty((s.size, order), dtype=complex)
    A, b = np.zeros((order, order)), np.empty(order)
    j = 0
    while j < order:
        p = poles[j]
        if p.imag != 0:
            one, other = 1 / (s - p), 1 / (s - p.conjugate())
            basis[:, j], basis[:, j + 1] = one + other, 1j * (one - other)
            A[j : j + 2, j : j + 2] = [[p.real, p.imag], [-p.imag, p.real]]
            b[j : j + 2] = 2.0, 0.0
            j += 2
        else:
            basis[:, j], A[j, j], b[j] = 1 / (s - p), p.real, 1.0
            j += 1
    return basis, A, b


def vector_fit(
    s: ComplexArray,
    target: ComplexArray,
    weight: FloatArray,
    order: int,
    direct: bool,
    relocations: int = RELOCATIONS,
) -> ComplexArray:
    """(order,) stable poles of a rational function that fits `target` at the points s, conjugate pairs adjacent.

    Each iteration solves least squares for a numerator and a denominator with common poles; the zeros of the
    denominator are the next poles, those in the right half plane reflected. An odd order starts with a real pole in
    the middle of the band.

    Parameters
    ----------
    s : (m,) points, scaled to at most about 1. target : (m,) values there. weight : (m,) weights of their errors.
    direct : whether a constant (direct feedthrough) is added to the fractions.
    relocations : number of iterations.
    """
    size = np.abs(s)
    imaginary = np.geomspace(size.min(), size.max(), order // 2)
    poles = np.stack([-0.1 * imaginary + 1j * imaginary, -0.1 * imaginary - 1j * imaginary], axis=1).ravel()
    if order % 2:
        poles = np.append(poles, -np.sqrt(size.min() * size.max()))
    for _ in range(relocations):
        basis, A, b = fractions(s, poles)
        columns = [basis] + ([np.ones((s.size, 1))] if direct else []) + [-target[:, None] * basis]
        system = np.hstack(columns) * weight[:, None]
        right = target * weight
        stacked, wanted = np.vstack([system.real, system.imag]), np.concatenate([right.real, right.imag])
        norm = np.linalg.norm(stacked, axis=0)
        solution = np.linalg.lstsq(stacked / norm, wanted, rcond=None)[0] / norm
        moved = np.linalg.eigvals(A - np.outer(b, solution[-order:]))
        moved = -np.abs(moved.real) + 1j * moved.imag
        upper = moved[moved.imag > 0]
        real = np.sort(moved[moved.imag == 0].real)
        poles = np.concatenate([np.stack([upper, upper.conj()], axis=1).ravel(), real.astype(complex)])
    return poles


def at_rest(A: FloatArray, b: FloatArray) -> FloatArray:
    """(n + 1, n + 1) projector of coefficient rows (C, D) onto those whose response has two zeros at s = 0.

    Value and slope at s = 0 are linear in the coefficients: (s I - A)^-1 b = -A^-1 b - s A^-2 b - ...
    """
    inverse = np.linalg.inv(A)
    value = -inverse @ b
    kept = np.eye(b.size + 1)
    for row in (np.append(value, 1.0), np.append(inverse @ value, 0.0)):
        asked = kept @ row
        kept = kept - np.outer(asked, asked) / (asked @ asked)
    return kept


def least_width(frequencies_Hz: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """The least damping a of s^2 + a s + w^2 that the distance between points resolves: a function log w -> log a."""
    log_w, log_a = np.log(2 * np.pi * frequencies_Hz), np.log(2 * np.pi * RESOLVED * np.gradient(frequencies_Hz))
    return lambda at: np.asarray(np.interp(at, log_w, log_a))


@dataclass(frozen=True)
class ResponseFit:
    """A fitted plant and its error against the measured response.

    Attributes
    ----------
    plant : with the acceleration as its only output, since nothing else was measured.
    frequencies_Hz : (m,) points within the band. measured : (m,) response there [m/s^2 per A or V].
    misfit : relative rms error over the band.
    worst_Hz : frequency of the largest error. worst : that error over the largest magnitude of the response. Of
        points whose noise is known only what exceeds `CERTAIN` standard deviations counts.
    at_rest : whether the fit has the two zeros at s = 0.
    noise : misfit that a perfect fit would show because of the points' noise; 0 where it is not known.
    deviations : (m,) standard deviations of the points' real and imaginary parts; None where not known.
    """

    plant: StateSpace
    frequencies_Hz: FloatArray
    measured: ComplexArray
    misfit: float
    worst_Hz: float
    worst: float
    at_rest: bool
    noise: float = 0.0
    deviations: FloatArray | None = None

    __repr__ = brief

    @property
    def fit_to_design_with(self) -> bool:
        """Whether the misfit beyond noise is at most `MOST_MISFIT`; false for NaN."""
        return self.misfit**2 - self.noise**2 <= MOST_MISFIT**2

    def resonances(self) -> list[tuple[float, float]]:
        """Frequency [Hz] and quality factor of every complex pair of poles, by increasing frequency."""
        poles = np.linalg.eigvals(self.plant.A)
        pairs = sorted((p for p in poles if p.imag > 0), key=abs)
        return [(float(abs(p)) / (2 * np.pi), float(abs(p) / (-2 * p.real))) for p in pairs]


def fit_response(
    frequencies_Hz: FloatArray,
    response: ComplexArray,
    order: int,
    driven_by: Input,
    band_Hz: tuple[float, float] | None = None,
    deviations: FloatArray | None = None,
    relocations: int = RELOCATIONS,
) -> ResponseFit:
    """Fit a state space of a given order to a response over a band.

    Parameters
    ----------
    frequencies_Hz : (m,) increasing, above 0.
    response : (m,) acceleration over input [m/s^2 per A or V].
    order : number of states.
    band_Hz : lowest and highest frequency that count; None for all.
    deviations : (m,) standard deviations of real and imaginary part of each point; None if unknown.
    relocations : iterations for the poles; with few of them a fit is rough and takes less time.

    Raises
    ------
    InputError : an order or a band out of range, too few points for the order, or a response of zero.
    """
    if not 1 <= order <= HIGHEST_ORDER:
        raise InputError(f"--order {order}: must be 1 to {HIGHEST_ORDER}; two for each resonance")
    low, high = (frequencies_Hz[0], frequencies_Hz[-1]) if band_Hz is None else band_Hz
    if not 0 < low < high:
        raise InputError(f"--band-Hz {low:g} {high:g}: must be two frequencies above 0, the lower one first")
    inside = (frequencies_Hz >= low) & (frequencies_Hz <= high)
    f, G = frequencies_Hz[inside], response[inside]
    needed = 2 * order + 2
    if f.size < needed:
        band = f"{low:g} to {high:g} Hz"
        raise InputError(
            f"--order {order}: needs {needed} points, {f.size} from {band}: lower it, or widen --band-Hz"
        )
    largest = float(np.abs(G).max())
    if largest == 0:
        raise InputError("the response is zero at every frequency of the band: check its columns")
    top = 2 * np.pi * float(f[-1])
    s = np.asarray(2j * np.pi * f / top, dtype=np.complex128)
    weight, noise = np.ones(f.size), 0.0
    if deviations is not None:
        deviations = deviations[inside]
        weight = 1 / deviations
        noise = float(np.sqrt(2 * f.size) / np.linalg.norm(weight * G))
        weight = weight / weight.max()
    poles = _resolved(vector_fit(s, G / largest, weight, order, direct=True, relocations=relocations), f, top)
    free, held = (_nearest(s, G / largest, poles, weight, rests=zeros and order > 1) for zeros in (False, True))
    misfits = [_misfit(s, G / largest, poles, row, weight) for row in (free, held)]
    rests = order > 1 and bool(misfits[1] <= max(COSTS_NOTHING * misfits[0], EXACT))
    row = held if rests else free
    _, A, b = fractions(s, poles)
    plant = StateSpace(
        A=top * A,
        B=top * b[:, None],
        C=largest * row[None, :-1],
        D=np.array([[largest * row[-1]]]),
        driven_by=driven_by,
    )
    off = np.abs(plant.response(f) - G)
    beyond = off if deviations is None else np.maximum(off - CERTAIN * deviations, 0.0)
    return ResponseFit(
        plant=plant,
        frequencies_Hz=f,
        measured=G,
        misfit=float(np.linalg.norm(weight * off) / np.linalg.norm(weight * G)),
        worst_Hz=float(f[beyond.argmax()]),
        worst=float(beyond.max()) / largest,
        at_rest=rests,
        noise=noise,
        deviations=deviations,
    )


def _resolved(poles: ComplexArray, frequencies_Hz: FloatArray, top: float) -> ComplexArray:
    """The poles, each resonance widened to what the points resolve; its width is -2 Re p [rad/s]."""
    least = np.exp(least_width(frequencies_Hz)(np.log(np.abs(poles) * top))) / (2 * top)
    return np.asarray(np.where(poles.imag == 0, poles.real, np.minimum(poles.real, -least)) + 1j * poles.imag)


def _nearest(
    s: ComplexArray, target: ComplexArray, poles: ComplexArray, weight: FloatArray, *, rests: bool
) -> FloatArray:
    """(n + 1,) least squares coefficients of the fractions, then the constant.

    `rests` imposes that value and slope of the response are zero at s = 0.
    """
    basis, A, b = fractions(s, poles)
    columns, target = weight[:, None] * np.hstack([basis, np.ones((s.size, 1))]), weight * target
    system, wanted = np.vstack([columns.real, columns.imag]), np.concatenate([target.real, target.imag])
    kept = at_rest(A, b) if rests else np.eye(poles.size + 1)
    reduced = system @ kept
    norm = np.maximum(np.linalg.norm(reduced, axis=0), np.finfo(float).tiny)
    return np.asarray(kept @ (np.linalg.lstsq(reduced / norm, wanted, rcond=None)[0] / norm))


def _misfit(s: ComplexArray, target: ComplexArray, poles: ComplexArray, row: FloatArray, weight: FloatArray) -> float:
    basis, _, _ = fractions(s, poles)
    off = basis @ row[:-1] + row[-1] - target
    return float(np.linalg.norm(weight * off) / np.linalg.norm(weight * target))
