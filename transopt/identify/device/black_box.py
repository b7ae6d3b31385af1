"""State spaces by grip: their poles and outputs by least squares on the exact sampled response.

The model is a sum of second-order sections with the denominator s^2 + a s + w^2, a and w above 0: any such numbers
give a stable real model, and a pair of poles may pass from complex to real during the search. A held device rests
under a constant current; a free one accelerates.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import ComplexArray, FloatArray
from transopt.identify.checks import within
from transopt.identify.device.chain import GripResponse
from transopt.identify.device.response import Instrument, Slope, sampled_response
from transopt.identify.response_fit import at_rest, least_width, vector_fit
from transopt.identify.squares import Squares
from transopt.plant.state_space import StateSpace, blended_at

ORDERS = (2, 4, 6, 8, 10)  # tried in turn if the user states none, as long as the criterion falls
HIGHEST_ORDER = 20
ENOUGH = 1.2  # mean square of the residuals over the noise below which no other start is tried
MORE = (
    (0.05, 0.2),
    (0.2, 0.6),
    (0.005, 0.05),
)  # pairs of real poles, over the highest frequency, that other starts add to the poles of two orders less
REACH = 1e3  # poles stay within this factor of their start
MOST_STEPS = 60  # largest number of evaluations of a search
TOLERANCE = 1e-6
RANK = 1e-12  # singular values below this share of the largest count as zero
NUDGE = 1e-3  # least damping ratio that a relocated pole starts with


@dataclass(frozen=True)
class BlackBox:
    """State spaces by grip.

    Attributes
    ----------
    grips_N : recorded grips, increasing.
    plants : one per grip, all of one order; the encoder's row is zero, since its signal was not fitted.
    scatter : (grips,) mean square of the residuals over the noise.
    criterion : Bayesian information criterion over all grips.
    """

    grips_N: tuple[float, ...]
    plants: tuple[StateSpace, ...]
    scatter: FloatArray
    criterion: float

    @property
    def order(self) -> int:
        """Number of states of each plant."""
        return self.plants[0].order

    def plant(self, grip_N: float) -> StateSpace:
        """The plant at a grip, blended between recorded ones; held and free devices are never blended.

        Raises
        ------
        InputError : the grip lies outside the recorded ones.
        """
        if grip_N in self.grips_N:
            return self.plants[self.grips_N.index(grip_N)]
        if not within(grip_N, self.grips_N):
            raise InputError(f"grip {grip_N:g} N: outside the recorded grips {list(self.grips_N)} N; record it")
        return blended_at(self.grips_N, self.plants, grip_N)

    def variance(self, one: GripResponse) -> FloatArray:
        """(m,) variance E|.|^2 of the fitted response, which 2 x order unknowns are taken to spread over all bins."""
        return np.asarray(2 * one.deviation**2 * self.order / one.deviation.size)

    def without(self, grip_N: float) -> "BlackBox":
        """A copy without the model of one grip, which blends the neighbours' models there instead."""
        kept = [j for j, grip in enumerate(self.grips_N) if grip != grip_N]
        grips, plants = tuple(self.grips_N[j] for j in kept), tuple(self.plants[j] for j in kept)
        return BlackBox(grips, plants, self.scatter[kept], self.criterion)


def _start(poles: ComplexArray) -> FloatArray:
    """(order,) log w and log a of the sections with these poles; real poles are paired by size."""
    upper = poles[poles.imag > 0]
    real = np.sort(-poles[poles.imag == 0].real)
    w = np.concatenate([np.abs(upper), np.sqrt(real[::2] * real[1::2])])
    a = np.concatenate([-2 * upper.real, real[::2] + real[1::2]])
    floor = np.finfo(float).tiny
    w = np.maximum(w, floor)
    return np.asarray(np.log(np.stack([w, np.maximum(a, 2 * NUDGE * w)], axis=1)).ravel())


class _Projected(Squares):
    """Residuals of one grip as a function of the poles alone; the output row is always the least squares one.

    The unknowns are log w and log a of the sections. A section has the states of [[0, w], [-w, -a]] with input w at
    the second one, so both states are of similar size at any w. The method is variable projection with Kaufman's
    Jacobian (1975): the Jacobian at fixed output, less its projection on the responses that the output can produce. A
    joint search for poles and output would crawl along a valley in which one compensates for the other. No resonance
    is narrower than the measured points resolve.
    """

    def __init__(self, one: GripResponse, instrument: Instrument) -> None:
        super().__init__(self._over_poles)
        self._one, self._instrument = one, instrument
        self._least = least_width(one.estimate.frequencies_Hz)

    def widened(self, poles: FloatArray) -> FloatArray:
        """(order,) log w and log a of the sections, with log a at least what the distance between bins resolves."""
        found = poles.copy()
        found[1::2] = np.maximum(poles[1::2], self._least(poles[::2]))
        return found

    def _by_output(self, poles: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A and B of the sections, and (order + 1, order + 1): the row (C, D) that each output coefficient scales."""
        A, B = np.zeros((poles.size, poles.size)), np.zeros((poles.size, 1))
        for j, (w, a) in enumerate(np.exp(poles.reshape(-1, 2))):
            A[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] = [[0.0, w], [-w, -a]]
            B[2 * j + 1, 0] = w
        return A, B, at_rest(A, B[:, 0]) if self._one.grip_N > 0 else np.eye(poles.size + 1)

    def _plant(self, poles: FloatArray, output: FloatArray) -> StateSpace:
        A, B, rows = self._by_output(poles)
        row = output @ rows
        return StateSpace(A, B, row[None, :-1], row[None, -1:])

    def _stacked(self, plant: StateSpace, slopes: tuple[Slope, ...]) -> tuple[FloatArray, FloatArray]:
        """Weighted response (2 m,) and its derivatives (2 m, p), real parts first."""
        value, by_unknown = sampled_response(plant, self._instrument, self._one.estimate.frequencies_Hz, slopes)
        value, by_unknown = value / self._one.deviation, (by_unknown / self._one.deviation).T
        return np.concatenate([value.real, value.imag]), np.vstack([by_unknown.real, by_unknown.imag])

    def _best(self, poles: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Least squares output (order + 1,), measured response (2 m,), orthonormal basis (2 m, r) of the outputs."""
        wanted = self._one.estimate.response / self._one.deviation
        measured = np.concatenate([wanted.real, wanted.imag])
        A, B, rows = self._by_output(poles)
        # The response is linear in the output coefficients.
        slopes = tuple(Slope(0 * A, 0 * B, row[None, :-1], row[None, -1:]) for row in rows)
        _, basis = self._stacked(StateSpace(A, B, np.zeros((1, poles.size)), np.zeros((1, 1))), slopes)
        norm = np.maximum(np.linalg.norm(basis, axis=0), np.finfo(float).tiny)
        axes, size, along = np.linalg.svd(basis / norm, full_matrices=False)
        resolved = size > RANK * size[0]
        axes, size, along = axes[:, resolved], size[resolved], along[resolved]
        return along.T @ (axes.T @ measured / size) / norm, measured, axes

    def _over_poles(self, poles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (2 m,) and Jacobian (2 m, order)."""
        wide = self.widened(poles)
        output, measured, axes = self._best(wide)
        by_poles, step = [], 1e-5  # central differences of these small matrices
        for move in step * np.eye(poles.size):
            up, down = self._plant(wide + move, output), self._plant(wide - move, output)
            by_poles.append(Slope(*((getattr(up, part) - getattr(down, part)) / (2 * step) for part in "ABCD")))
        value, slopes = self._stacked(self._plant(wide, output), tuple(by_poles))
        jacobian = slopes - axes @ (axes.T @ slopes)
        # A width held at its lower bound depends on the frequency of its section only.
        held, step = poles[1::2] < self._least(poles[::2]), 1e-6
        along = (self._least(poles[::2] + step) - self._least(poles[::2] - step)) / (2 * step)
        jacobian[:, ::2] += np.where(held, along, 0.0) * jacobian[:, 1::2]
        jacobian[:, 1::2] = np.where(held, 0.0, jacobian[:, 1::2])
        return value - measured, jacobian

    def polished(self, poles: ComplexArray) -> tuple[StateSpace, float]:
        """Plant and sum of squares at the end of the search from these poles (order,)."""
        start, reach = self.widened(_start(poles)), np.log(REACH)
        found, cost = self.search(start, start - reach, start + reach, most=MOST_STEPS, tolerance=TOLERANCE)
        wide = self.widened(found)
        return self._plant(wide, self._best(wide)[0]), cost


def _fit(one: GripResponse, instrument: Instrument, order: int) -> tuple[StateSpace, float]:
    """Fit one grip: the plant and its sum of squared residuals.

    Vector fitting minimises an equation error, which noise biases: a weakly visible pole may end below the band,
    where nothing was measured, and stay there. So other starts follow as long as the residuals exceed the noise.
    """
    held = one.grip_N > 0
    frequencies, target = one.estimate.frequencies_Hz, one.estimate.response.copy()
    s: ComplexArray = np.asarray(2j * np.pi * frequencies, dtype=np.complex128)
    high = float(np.abs(s).max())
    if instrument.accelerometer_Hz is not None:
        target *= 1 + 1j * frequencies / instrument.accelerometer_Hz
    weight = 1 / one.deviation
    if held:
        target, weight = target / s**2, weight * np.abs(s) ** 2

    def fitted(poles: int) -> ComplexArray:
        return np.asarray(high * vector_fit(s / high, target, weight / weight.max(), poles, direct=not held))

    projected = _Projected(one, instrument)
    best = projected.polished(fitted(order))
    enough = ENOUGH * (2 * frequencies.size - 2 * order)
    for pair in MORE:
        if best[1] < enough or order == 2:
            break
        poles = np.concatenate([fitted(order - 2), -high * np.array(pair)])
        best = min(best, projected.polished(poles), key=lambda found: found[1])
    return best


def fit_black_box(
    responses: Sequence[GripResponse],
    instrument: Instrument,
    order: int | None = None,
    *,
    tick: Callable[[], None] = lambda: None,
) -> BlackBox:
    """Fit a stable real state space of the same order at every grip.

    Parameters
    ----------
    order : even; None takes the one of `ORDERS` with the least Bayesian information criterion.
    tick : called after each grip of each order.

    Raises
    ------
    InputError : the order is odd or out of range.
    """
    if order is not None and (order % 2 or not 2 <= order <= HIGHEST_ORDER):
        raise InputError(f"--order {order}: must be even, 2 to {HIGHEST_ORDER}; masses come with two states each")
    responses = sorted(responses, key=lambda one: one.grip_N)
    best: BlackBox | None = None
    for tried in (order,) if order is not None else ORDERS:
        plants, scatter, criterion = [], [], 0.0
        for one in responses:
            plant, cost = _fit(one, instrument, tried)
            points, unknowns = 2 * one.estimate.frequencies_Hz.size, 2 * tried
            plants.append(plant)
            scatter.append(cost / max(points - unknowns, 1))
            criterion += cost + unknowns * np.log(points)
            tick()
        found = BlackBox(tuple(one.grip_N for one in responses), tuple(plants), np.array(scatter), float(criterion))
        if best is not None and found.criterion >= best.criterion:
            break
        best = found
    assert best is not None
    return best
