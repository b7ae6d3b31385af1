"""Parameters of the drive chain from the responses of all grips together: bounded, passive, weighted."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.identify.device.chain import HAND, SHARED, Coordinates, DriveChain, log_slopes
from transopt.identify.device.response import Instrument, sampled_response
from transopt.identify.spectrum import TransferEstimate

RANGE = 1e3  # every parameter stays within this factor of its start
RANDOM_STARTS = 6
SPREAD = 3.0  # random starts lie within this factor of the nominal device scaled to the data
LOOSE = 0.1  # relative error allowed in the first stage, so that one sharp peak does not rule the search
DECIMATION = 4
SAME = 0.05  # sums of squares of the first stage that differ by less count as the same device
UNKNOWN = 0.5  # standard deviation of a logarithm from which on a parameter counts as not identified
TOLERANCE = 1e-10


@dataclass(frozen=True)
class GripResponse:
    """What was measured at one grip, 0 for the free device."""

    grip_N: float
    estimate: TransferEstimate

    @property
    def deviation(self) -> FloatArray:
        """(m,) standard deviation of real and imaginary part, above 0."""
        return np.asarray(np.maximum(self.estimate.deviation, np.finfo(float).tiny))


@dataclass(frozen=True)
class ChainFit:
    """The drive chain that fits best.

    Attributes
    ----------
    device : the parameters.
    coordinates, unknowns : how they were sought, (size,).
    covariance : (size, size) of the unknowns by Gauss-Newton, times `scatter` where that is above 1.
    grips_N : of the responses.
    chi_square : (grips,) sums of squared residuals.
    points : (grips,) their numbers.
    at_bounds : unknowns that ended at a bound; their deviation is half the range searched.
    starts, agreeing : how many starts there were, and how many of them led to the best device.
    """

    device: DriveChain
    coordinates: Coordinates
    unknowns: FloatArray
    covariance: FloatArray
    grips_N: tuple[float, ...]
    chi_square: FloatArray
    points: NDArray[np.int_]
    at_bounds: tuple[str, ...]
    starts: int
    agreeing: int

    @property
    def scatter(self) -> float:
        """Mean square of the residuals: 1 where the model is right and the noise is known."""
        return _scatter(self.chi_square, self.points, self.unknowns.size)

    @property
    def unidentified(self) -> dict[str, float]:
        """Unknowns that these responses leave open, with the standard deviation of their logarithm."""
        sigma = np.sqrt(np.diag(self.covariance))
        return {name: float(s) for name, s in zip(self.coordinates.names, sigma, strict=True) if s > UNKNOWN}

    def stated(self) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
        """Names, values (q,) and covariance (q, q) of the parameters as a model file states them, in SI."""
        names, values, matrix = self.coordinates.stated(self.unknowns)
        return names, values, matrix @ self.covariance @ matrix.T


def _scatter(chi_square: FloatArray, points: NDArray[np.int_], unknowns: int) -> float:
    return float(chi_square.sum() / max(int(points.sum()) - unknowns, 1))


def _response_jacobian(
    coordinates: Coordinates,
    device: DriveChain,
    grip_N: float,
    instrument: Instrument,
    frequencies_Hz: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """(m,) sampled response at a grip and its derivatives by the unknowns (size, m)."""
    parameters, n, h = device.parameters(grip_N), len(SHARED), len(HAND)
    plant, slopes = log_slopes(parameters, device.force_per_current_N_A)
    value, by_log = sampled_response(plant, instrument, frequencies_Hz, slopes)
    jacobian = np.zeros((coordinates.size, value.size), dtype=complex)
    jacobian[:n] = by_log[:n]
    if grip_N > 0:
        for end, (end_N, share) in enumerate(zip(coordinates.ends_N, coordinates.shares(grip_N), strict=True)):
            part = share * device.hand_at(end_N) / parameters[n:]
            jacobian[n + end * h : n + (end + 1) * h] = part[:, None] * by_log[n:]
    return value, jacobian


class _Residuals:
    """(Model - measured) / deviation of all grips, real and imaginary parts, and its Jacobian; keeps the last point.

    `loose` adds a relative error to the deviations, `step` takes each step-th bin.
    """

    def __init__(
        self,
        responses: Sequence[GripResponse],
        coordinates: Coordinates,
        instrument: Instrument,
        force_per_current_N_A: float,
        *,
        loose: float = 0.0,
        step: int = 1,
    ) -> None:
        self._coordinates, self._instrument, self._force = coordinates, instrument, force_per_current_N_A
        self._data = []
        for one in responses:
            kept = slice(step // 2, None, step)
            response = one.estimate.response[kept]
            deviation = np.hypot(one.deviation[kept], loose * np.abs(response))
            self._data.append((one.grip_N, one.estimate.frequencies_Hz[kept], response, deviation))
        self._at, self._last = np.zeros(0), (np.zeros(0), np.zeros((0, 0)))

    @property
    def points(self) -> NDArray[np.int_]:
        """(grips,) number of residuals."""
        return np.array([2 * response.size for _, _, response, _ in self._data])

    def _evaluate(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        if not np.array_equal(self._at, unknowns):
            device = self._coordinates.device(unknowns, self._force)
            residuals, jacobians = [], []
            for grip_N, frequencies, response, deviation in self._data:
                value, jacobian = _response_jacobian(self._coordinates, device, grip_N, self._instrument, frequencies)
                error, scaled = (value - response) / deviation, (jacobian / deviation).T
                residuals += [error.real, error.imag]
                jacobians += [scaled.real, scaled.imag]
            self._at, self._last = unknowns.copy(), (np.concatenate(residuals), np.concatenate(jacobians))
        return self._last

    def value(self, unknowns: FloatArray) -> FloatArray:
        """Residuals of all grips."""
        return self._evaluate(unknowns)[0]

    def jacobian(self, unknowns: FloatArray) -> FloatArray:
        """Their derivatives by the unknowns."""
        return self._evaluate(unknowns)[1]

    def minimise(self, start: FloatArray, free: NDArray[np.bool_], most: int) -> tuple[FloatArray, float]:
        """Bounded least squares over the `free` unknowns: (size,) answer and its sum of squares."""

        low, high = start[free] - np.log(RANGE), start[free] + np.log(RANGE)

        def whole(part: FloatArray) -> FloatArray:
            full = start.copy()
            full[free] = np.clip(part, low, high)
            return full

        def value(part: FloatArray) -> FloatArray:
            return self.value(whole(part))

        def jacobian(part: FloatArray) -> FloatArray:
            outside = (part < low) | (part > high)
            return np.where(outside, 0.0, self.jacobian(whole(part))[:, free])

        # MINPACK with clipped unknowns: the factorisations of scipy's bounded methods take ten times as long when
        # their threads meet busy cores.
        found = optimize.least_squares(
            value,
            start[free],
            jac=jacobian,
            method="lm",
            ftol=TOLERANCE,
            xtol=TOLERANCE,
            gtol=TOLERANCE,
            max_nfev=most,
        )
        return whole(found.x), 2 * float(found.cost)


def scaled_to(device: DriveChain, responses: Sequence[GripResponse], instrument: Instrument) -> DriveChain:
    """A device like this one, as heavy and as fast as the measured one.

    The response falls as all masses, stiffnesses and dampings grow alike, and shifts along the frequency axis with
    the root of stiffness over mass: heights and peaks of measured and modelled response are laid over each other.
    """
    one = min(responses, key=lambda response: response.grip_N)
    frequencies, measured = one.estimate.frequencies_Hz, np.abs(one.estimate.response)

    def modelled(by: DriveChain) -> FloatArray:
        return np.abs(sampled_response(by.plant(one.grip_N), instrument, frequencies)[0])

    weight = measured / np.hypot(measured, one.deviation)
    faster = frequencies[np.argmax(measured * weight)] / frequencies[np.argmax(modelled(device))]
    speeds = np.array([1.0, 1.0, faster**2, faster])
    hand = np.array([1.0, faster**2, faster, faster**2, faster])[: device.hand.shape[0], None]
    device = DriveChain(device.force_per_current_N_A, device.shared * speeds, device.hand * hand)
    heavier = float(np.median(modelled(device) / np.maximum(measured, 1e-300)))
    return DriveChain(device.force_per_current_N_A, device.shared * heavier, device.hand * heavier)


def fit_chain(
    responses: Sequence[GripResponse],
    instrument: Instrument,
    nominal: DriveChain,
    *,
    random_starts: int = RANDOM_STARTS,
    seed: int = 0,
    tick: Callable[[], None] = lambda: None,
) -> ChainFit:
    """Least squares over all grips, weighted by the noise of each bin, from several starts.

    First every start on each fourth bin with a relative error of 10 % allowed, so that low and high frequencies
    count alike; then the best one on everything. No regularisation: what the data leave open shows in the covariance.

    Parameters
    ----------
    responses : one per grip, 0 for the free device.
    nominal : where to start, with the known force per ampere.
    random_starts : beside the nominal device, as it is and scaled to the data.
    tick : called after each start.

    Raises
    ------
    InputError : only the free device was recorded, whose response does not separate its two masses.
    """
    held = tuple(sorted(one.grip_N for one in responses if one.grip_N > 0))
    if not held:
        raise InputError(
            "device: only the free device (grip 0) was recorded, which tells neither the hand nor the motor's mass "
            "from the stylus's; record held grips too, or choose --kind state_space"
        )
    coordinates, force = Coordinates(held), nominal.force_per_current_N_A
    everything = np.ones(coordinates.size, dtype=bool)
    coarse = _Residuals(responses, coordinates, instrument, force, loose=LOOSE, step=DECIMATION)
    near = coordinates.of(scaled_to(nominal, responses, instrument))
    random = np.random.default_rng(seed)
    starts = [near, coordinates.of(nominal)]
    starts += [near + np.log(SPREAD) * random.uniform(-1, 1, near.size) for _ in range(random_starts)]
    reached = []
    for start in starts:
        reached.append(coarse.minimise(start, everything, most=60))
        tick()
    best = min(cost for _, cost in reached)
    agreeing = sum(cost <= (1 + SAME) * best + 1 for _, cost in reached)
    start = min(reached, key=lambda one: one[1])[0]

    exact = _Residuals(responses, coordinates, instrument, force)
    unknowns, _ = exact.minimise(start, everything, most=200)
    tick()
    return _result(exact, coordinates, unknowns, start, force, responses, len(starts), agreeing)


def refit(fit: ChainFit, responses: Sequence[GripResponse], instrument: Instrument) -> ChainFit:
    """The same fit to other responses, for example to one grip less, begun where `fit` ended."""
    coordinates = Coordinates(tuple(sorted(one.grip_N for one in responses if one.grip_N > 0)))
    force, start = fit.device.force_per_current_N_A, coordinates.of(fit.device)
    exact = _Residuals(responses, coordinates, instrument, force)
    unknowns, _ = exact.minimise(start, np.ones(coordinates.size, dtype=bool), most=200)
    return _result(exact, coordinates, unknowns, start, force, responses, 1, 1)


def _result(
    exact: _Residuals,
    coordinates: Coordinates,
    unknowns: FloatArray,
    start: FloatArray,
    force_per_current_N_A: float,
    responses: Sequence[GripResponse],
    starts: int,
    agreeing: int,
) -> ChainFit:
    bounded = np.abs(unknowns - start) > np.log(RANGE) * (1 - 1e-6)
    squares = np.split(exact.value(unknowns) ** 2, np.cumsum(exact.points)[:-1])
    chi_square = np.array([part.sum() for part in squares])
    jacobian = exact.jacobian(unknowns)[:, ~bounded]
    covariance = np.zeros((unknowns.size, unknowns.size))
    # A pseudo-inverse would call a direction without information certain; a floor calls it wide open.
    size, axes = np.linalg.eigh(jacobian.T @ jacobian)
    spread = 1 / np.maximum(size, np.finfo(float).eps * size.max(initial=0.0) + np.finfo(float).tiny)
    covariance[np.ix_(~bounded, ~bounded)] = (axes * spread) @ axes.T
    covariance[bounded, bounded] = (np.log(RANGE) / 2) ** 2  # all that was searched
    return ChainFit(
        device=coordinates.device(unknowns, force_per_current_N_A),
        coordinates=coordinates,
        unknowns=unknowns,
        covariance=covariance * max(_scatter(chi_square, exact.points, unknowns.size), 1.0),
        grips_N=tuple(one.grip_N for one in responses),
        chi_square=chi_square,
        points=exact.points,
        at_bounds=tuple(name for name, at in zip(coordinates.names, bounded, strict=True) if at),
        starts=starts,
        agreeing=agreeing,
    )


@dataclass(frozen=True)
class GripFit:
    """A hand fitted to one grip alone, the drive kept: against the functions linear in grip.

    Attributes
    ----------
    grip_N : of the response.
    scatter : mean square of its residuals with the functions linear in grip.
    own_scatter : the same with the hand of this grip alone.
    difference_dB : largest ratio of the two models' magnitudes where coherence is high.
    """

    grip_N: float
    scatter: float
    own_scatter: float
    difference_dB: float


def fit_per_grip(
    fit: ChainFit, responses: Sequence[GripResponse], instrument: Instrument, *, least_coherence: float
) -> list[GripFit]:
    """Lack of fit of the hand's linear functions: each held grip once more with a hand of its own."""
    force, found = fit.device.force_per_current_N_A, []
    for one in responses:
        if one.grip_N == 0:
            continue
        coordinates = Coordinates((one.grip_N,))
        start = coordinates.of(fit.device)
        exact = _Residuals([one], coordinates, instrument, force)
        hand_only = np.arange(start.size) >= len(SHARED)
        unknowns, cost = exact.minimise(start, hand_only, most=100)
        frequencies = one.estimate.frequencies_Hz
        own = sampled_response(coordinates.device(unknowns, force).plant(one.grip_N), instrument, frequencies)[0]
        smooth = sampled_response(fit.device.plant(one.grip_N), instrument, frequencies)[0]
        clear = one.estimate.coherence > least_coherence
        apart = 20 * np.abs(np.log10(np.abs(own) / np.abs(smooth)))[clear]
        points = int(exact.points[0])
        before = float(np.sum(exact.value(start) ** 2))
        found.append(GripFit(one.grip_N, before / points, cost / (points - len(HAND)), float(apart.max(initial=0.0))))
    return found
