"""The drive chain and its instrument, fitted by one likelihood over all trials and grips.

The input is the command, which has no noise, or the measured current if the amplifier is not one pole and a delay.
The outputs are the measured current, the acceleration and, where the encoder moves by enough counts, the position.
The unknowns are the chain, the amplifier, and three nuisances of the accelerometer that the files may not state: its
pole, its gain, and the delay of its reading against the current. A nuisance is kept, and named, only where the
records contradict its nominal value.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import BoolArray, ComplexArray, FloatArray
from transopt.identify.amplifier import fit_pole
from transopt.identify.device.chain import (
    RANGE,
    SHARED,
    ChainModel,
    ChainSearch,
    Coordinates,
    DriveChain,
    GripResponse,
    instrument_at,
    unknowns_of,
)
from transopt.identify.device.response import (
    ACCELERATION,
    CURRENT,
    INSTRUMENT,
    POSITION,
    Instrument,
    sampled_response,
)
from transopt.identify.fit import intervals_around, quantile
from transopt.identify.likelihood import Maximum

RANDOM_STARTS = 6
SPREAD = 3.0  # random starts lie within this factor of the nominal device scaled to the data
LOOSE = 0.1  # relative error allowed in the first stage, so that one sharp peak does not dominate the search
DECIMATION = 4  # the first stage takes every fourth bin
SAME = 0.05  # relative difference of sums of squares below which two starts count as having found the same device
EXPLAINED = 2.0  # mean square of the residuals above which a black box is tried too
UNKNOWN = 0.5  # standard deviation of its logarithm above which a parameter counts as not identified
VARIES = 4.0  # variance between trials over that of the noise above which a hand counts as varying
SIGNIFICANT = 5.0  # standard deviations from its nominal value at which a nuisance is kept
MISFIT = 3.0  # mean square of the residuals above which the model lacks something
WHOLLY = 1.3  # mean square of the residuals up to which a fit explains the records
BETTER = 4.0  # factor by which nuisances must reduce the misfit to be kept if they do not explain the records
SUSPECTED_HZ = 3000.0  # start of the search for an accelerometer pole that no file states
SLOW_HZ = 300.0  # another start of it, since from far above it the search ends in another device's masses
NUISANCES = ("accelerometer_pole", "late", "gain")


@dataclass(frozen=True)
class Nuisance:
    """A property of the accelerometer that differs from what the files state, estimated from the records.

    Attributes
    ----------
    name : one of `NUISANCES`.
    value : pole [Hz], delay [samples] or gain [1].
    deviation : its standard deviation.
    """

    name: str
    value: float
    deviation: float


@dataclass(frozen=True)
class ChainFit:
    """The drive chain of maximum likelihood.

    Attributes
    ----------
    device : its parameters.
    instrument : amplifier and accelerometer as fitted.
    nuisances : properties of the accelerometer that differ from what was stated.
    coordinates : the chain's unknowns, which come first in `maximum`.
    maximum : all unknowns, those of `INSTRUMENT` last.
    grips_N : grips of the responses.
    trials : number of trials of all held grips.
    starts, agreeing : number of starts, and of those that led to the best device.
    """

    device: DriveChain
    instrument: Instrument
    nuisances: tuple[Nuisance, ...]
    coordinates: Coordinates
    maximum: Maximum
    grips_N: tuple[float, ...]
    trials: int
    starts: int
    agreeing: int

    @property
    def unknowns(self) -> FloatArray:
        """(size,) unknowns of the chain."""
        return self.maximum.unknowns[: self.coordinates.size]

    @property
    def covariance(self) -> FloatArray:
        """(size, size) covariance of the chain's unknowns."""
        return self.maximum.covariance[: self.coordinates.size, : self.coordinates.size]

    @property
    def varying(self) -> BoolArray:
        """(size,) whether an unknown is the hand's and differs between trials by more than noise explains."""
        of_hand = np.arange(self.coordinates.size) >= len(SHARED)
        return np.asarray(of_hand & (self.maximum.between[: self.coordinates.size] > VARIES))

    @property
    def trials_to_an_end(self) -> float:
        """Number of trials per end grip, which the hand's parameters are estimated from; at least 1."""
        return max(self.trials / max(len(self.coordinates.ends_N), 1), 1.0)

    @property
    def scatter(self) -> float:
        """Mean square of the residuals: near 1 if the model is right."""
        return self.maximum.scatter

    @property
    def at_bounds(self) -> tuple[str, ...]:
        """Names of the chain's unknowns that ended at a bound."""
        names = self.coordinates.names
        return tuple(name for name, at in zip(names, self.maximum.bounded, strict=False) if at)

    @property
    def unidentified(self) -> dict[str, float]:
        """Names of the chain's unknowns that are not identified -> standard deviation of their logarithm."""
        sigma = np.sqrt(np.diag(self.covariance))
        return {name: float(s) for name, s in zip(self.coordinates.names, sigma, strict=True) if s > UNKNOWN}

    def stated(self) -> tuple[tuple[str, ...], FloatArray, FloatArray, FloatArray]:
        """Names, values (q,), covariance (q, q) and 95 % intervals (q, 2) as a model file states them, in SI.

        Intervals of the shared parameters, which are positive, are symmetric on a logarithmic scale; those of the
        hand's constants and slopes on a linear one.
        """
        names, values, matrix = self.coordinates.stated(self.unknowns)
        covariance = matrix @ self.covariance @ matrix.T
        spans = intervals_around(values, covariance)
        for j, value in enumerate(values[: len(SHARED)]):
            factor = factor_of(float(np.sqrt(covariance[j, j]) / value))
            spans[j] = value / factor, value * factor
        return names, values, covariance, spans

    def meaningless(self) -> list[str]:
        """Reasons why the parameters may predict well and still not be the device's masses, springs and dampers."""
        sentences = []
        if self.scatter > WHOLLY:
            sentences.append(
                f"residuals of {self.scatter:.2g} times the noise: the parameters make up for what the chain lacks "
                "(friction, masses, samples not read together, accelerometer_Hz), so that their intervals do not hold"
            )
        if self.at_bounds:
            sentences.append(f"at a bound, so without meaning by themselves: {', '.join(self.at_bounds)}")
        return sentences


def factor_of(sigma: float) -> float:
    """Factor to either end of a positive number's 95 % interval, by its logarithm's deviation; at most `RANGE`."""
    return float(np.exp(min(quantile() * sigma, np.log(RANGE))))


def scaled_to(device: DriveChain, measured: Sequence[GripResponse], instrument: Instrument) -> DriveChain:
    """A device scaled so that its response has the height and the peak frequency of the measured one.

    The response is inversely proportional to a common factor of all masses, stiffnesses and dampings, and its peak
    moves with the root of stiffness over mass.
    """
    one = min(measured, key=lambda response: response.grip_N)
    frequencies, size = one.estimate.frequencies_Hz, np.abs(one.estimate.response)

    def modelled(by: DriveChain) -> FloatArray:
        return np.abs(sampled_response(by.plant(one.grip_N), instrument, frequencies)[0])

    weight = size / np.hypot(size, one.deviation)
    faster = frequencies[np.argmax(size * weight)] / frequencies[np.argmax(modelled(device))]
    speeds = np.array([1.0, 1.0, faster**2, faster])
    hand = np.array([1.0, faster**2, faster, faster**2, faster])[: device.hand.shape[0], None]
    device = DriveChain(device.force_per_current_N_A, device.shared * speeds, device.hand * hand)
    heavier = float(np.median(modelled(device) / np.maximum(size, 1e-300)))
    return DriveChain(device.force_per_current_N_A, device.shared * heavier, device.hand * heavier)


def _free(measured: Sequence[GripResponse], coordinates: Coordinates, instrument: Instrument) -> BoolArray:
    """(p,) whether these records can determine an unknown: the amplifier if the current was read beside the command,
    the accelerometer's gain if an encoder measured the motion."""
    amplifier = instrument.amplifier is not None and all(CURRENT in one.outputs for one in measured)
    moved = any(max(one.outputs) > ACCELERATION for one in measured)
    return np.array([True] * coordinates.size + [amplifier] * 3 + [True, True, moved])


def _with_amplifier(measured: Sequence[GripResponse], instrument: Instrument) -> Instrument:
    """The instrument with the amplifier fitted to the measured currents; unchanged if they were not measured."""
    amplifier = instrument.amplifier
    if amplifier is None or any(CURRENT not in one.outputs for one in measured):
        return instrument
    places = [one.outputs.index(CURRENT) for one in measured]
    currents = [one.data.some(outputs=slice(j, j + 1)) for one, j in zip(measured, places, strict=True)]
    log_pole, ticks, gain = fit_pole(currents, start=(amplifier.pole_Hz, amplifier.delay_s)).unknowns.tolist()
    found = replace(amplifier, pole_Hz=float(np.exp(log_pole)), delay_s=ticks * instrument.dt_s)
    return replace(instrument, amplifier=found, amplifier_gain=gain)


def fit_chain(
    measured: Sequence[GripResponse],
    instrument: Instrument,
    nominal: DriveChain,
    *,
    random_starts: int = RANDOM_STARTS,
    tick: Callable[[], None] = lambda: None,
) -> ChainFit:
    """Fit the chain and the instrument of maximum likelihood.

    The first stage takes every fourth bin and allows a relative error of 10 %, so that low and high frequencies count
    equally; the second takes all bins. Further starts follow if the residuals stay large. There is no regularisation:
    what the data do not determine shows in the covariance. All nuisances are free at first; those that differ from
    their nominal values by less than five standard deviations are then fixed, the least significant one first.

    Parameters
    ----------
    measured : one response per grip, 0 for the free device.
    instrument : as stated by the files and the scene.
    nominal : device to start from, with the known force per ampere.
    random_starts : number of starts in addition to the nominal device, unscaled, scaled to the data, and the latter
        behind a slow accelerometer, as half of the random ones are.
    tick : called after each start.

    Raises
    ------
    InputError : only the free device was recorded, whose response does not separate its two masses.
    """
    held = tuple(sorted(one.grip_N for one in measured if one.grip_N > 0))
    if not held:
        raise InputError(
            "device: only the free device (grip 0) was recorded, which tells neither the hand nor the motor's mass "
            "from the stylus's; record held grips too, or choose --kind state_space"
        )
    coordinates, force, stated = Coordinates(held), nominal.force_per_current_N_A, instrument.accelerometer_Hz
    sought = replace(instrument, accelerometer_Hz=stated or SUSPECTED_HZ)
    free = _free(measured, coordinates, sought)
    sought = _with_amplifier(measured, sought)
    tail = unknowns_of(sought)
    chain_alone = np.arange(free.size) < coordinates.size
    nuisances = np.array([False] * coordinates.size + [name in NUISANCES for name in INSTRUMENT])
    # Nuisances can compensate for a chain that is far off, and a chain for nuisances. So each start is searched
    # twice: with both free at once, and with the nuisances freed only after the chain was fitted.
    first, second = (
        ChainSearch(measured, coordinates, sought, force, moving, loose=LOOSE, step=DECIMATION)
        for moving in (chain_alone, free & (chain_alone | nuisances))
    )
    exact = ChainSearch(measured, coordinates, sought, force, free)
    near = coordinates.of(scaled_to(nominal, measured, sought))
    random = np.random.default_rng(0)
    slow = unknowns_of(replace(sought, accelerometer_Hz=SLOW_HZ))
    starts = [(near, tail), (coordinates.of(nominal), tail), (near, slow)]
    spread = np.log(SPREAD) * random.uniform(-1, 1, (random_starts, near.size))
    starts += [(near + off, (slow, tail)[j % 2]) for j, off in enumerate(spread)]
    reached: list[tuple[FloatArray, float]] = []
    best: Maximum | None = None
    for start in starts:
        whole = np.concatenate(start)
        reached.append(min((second.coarse(one) for one in (whole, first.coarse(whole)[0])), key=lambda one: one[1]))
        tick()
        # The exact fit decides between coarse ends that are alike: sums of squares that differ by 1 are.
        if reached[-1][1] <= (1 + SAME) * min(cost for _, cost in reached) + 1:
            tried = exact.maximum(reached[-1][0])
            best = tried if best is None or tried.total < best.total else best
            if best.scatter < WHOLLY:
                break
    assert best is not None
    measured = _weighed(measured, best)
    least = min(cost for _, cost in reached)
    agreeing = sum(cost <= (1 + SAME) * least + 1 for _, cost in reached)
    kept = _contradicted(best, coordinates, instrument)

    def with_nuisances(names: tuple[str, ...]) -> tuple[Maximum, Instrument]:
        known = (
            replace(sought, accelerometer_Hz=None) if stated is None and "accelerometer_pole" not in names else sought
        )
        fixed = nuisances & np.isin([*coordinates.names, *INSTRUMENT], names, invert=True)
        nominally = np.concatenate([best.unknowns[: coordinates.size], unknowns_of(known)])
        start = np.where(fixed, nominally, best.unknowns)
        return ChainSearch(measured, coordinates, known, force, free & ~fixed).maximum(start), known

    final, known = with_nuisances(kept)
    if kept and final.scatter > WHOLLY:
        # A device that is not a chain is fitted better with any nuisance: keep them only if they explain most of it.
        plain = with_nuisances(())
        if plain[0].scatter < BETTER * final.scatter:
            kept, (final, known) = (), plain
    tick()
    return _result(final, coordinates, known, force, measured, kept, len(reached), agreeing)


def _weighed(measured: Sequence[GripResponse], found: Maximum) -> list[GripResponse]:
    """The responses with the noise of the encoder raised to its residuals.

    Its quantisation is not random: the same sweep meets the same steps in every trial, so the scatter between trials
    underestimates the error.
    """
    weighed = []
    for one, squares, points in zip(measured, found.chi_square, found.points, strict=True):
        noise = one.data.noise.copy()
        if POSITION in one.outputs:
            j = one.outputs.index(POSITION)
            noise[j] *= max(float(squares[j] / max(points[j], 1)), 1.0)
        weighed.append(replace(one, data=replace(one.data, noise=noise)))
    return weighed


def _contradicted(found: Maximum, coordinates: Coordinates, stated: Instrument) -> tuple[str, ...]:
    """Nuisances that differ significantly from nominal, by backward elimination in the normal approximation."""
    nominal = unknowns_of(stated)
    left = [INSTRUMENT.index(name) for name in NUISANCES if found.free[coordinates.size + INSTRUMENT.index(name)]]
    off = found.unknowns[coordinates.size :] - nominal
    spread = found.covariance[coordinates.size :, coordinates.size :].copy()
    pole = INSTRUMENT.index("accelerometer_pole")
    if stated.accelerometer_Hz is None:
        # An ideal accelerometer has a time constant of 0: its relative distance from the one found is 1.
        off[pole] = 1.0
    while left:
        sizes = [abs(off[j]) / np.sqrt(max(spread[j, j], 1e-300)) for j in left]
        least = left[int(np.argmin(sizes))]
        if min(sizes) >= SIGNIFICANT:
            break
        left.remove(least)
        column = spread[:, least] / max(spread[least, least], 1e-300)
        off = off - column * off[least]
        spread = spread - np.outer(column, spread[least])
    return tuple(INSTRUMENT[j] for j in left)


def refit(fit: ChainFit, measured: Sequence[GripResponse]) -> ChainFit:
    """Fit again to other responses, for example without one grip, starting from `fit`."""
    coordinates = Coordinates(tuple(sorted(one.grip_N for one in measured if one.grip_N > 0)))
    force = fit.device.force_per_current_N_A
    free = np.concatenate([np.ones(coordinates.size, dtype=bool), fit.maximum.free[fit.coordinates.size :]])
    start = np.concatenate([coordinates.of(fit.device), unknowns_of(fit.instrument)])
    found = ChainSearch(measured, coordinates, fit.instrument, force, free).maximum(start)
    kept = tuple(nuisance.name for nuisance in fit.nuisances)
    return _result(found, coordinates, fit.instrument, force, measured, kept, 1, 1)


def response_slopes(fit: ChainFit, grip_N: float, frequencies_Hz: FloatArray) -> ComplexArray:
    """(size, m) derivatives of the chain's response, acceleration over current, with respect to its unknowns."""
    free = np.arange(fit.maximum.unknowns.size) < fit.coordinates.size
    force = fit.device.force_per_current_N_A
    model = ChainModel([(grip_N, (ACCELERATION,), False)], fit.coordinates, fit.instrument, force, free)
    return model(fit.maximum.unknowns, 0, frequencies_Hz)[1][: fit.coordinates.size, 0]


def response_variance(fit: ChainFit, one: GripResponse) -> tuple[FloatArray, FloatArray]:
    """(m,) variance E|.|^2 of the fitted response at the bins of an estimate, twice: against the mean recorded
    response, and against that of the next tap, whose hand differs where the hand varies between trials."""
    slopes = response_slopes(fit, one.grip_N, one.estimate.frequencies_Hz)
    spread = np.sqrt(np.where(fit.varying, fit.trials_to_an_end, 1.0))
    found = [
        np.einsum("im,ij,jm->m", slopes.conj(), fit.covariance * np.outer(factor, factor), slopes).real
        for factor in (np.ones(spread.size), spread)
    ]
    return np.asarray(found[0]), np.asarray(found[1])


def _result(
    found: Maximum,
    coordinates: Coordinates,
    known: Instrument,
    force_per_current_N_A: float,
    measured: Sequence[GripResponse],
    kept: tuple[str, ...],
    starts: int,
    agreeing: int,
) -> ChainFit:
    size = coordinates.size
    nuisances = []
    for name in kept:
        j = size + INSTRUMENT.index(name)
        value, deviation = float(found.unknowns[j]), float(np.sqrt(found.covariance[j, j]))
        if name != "late":
            value, deviation = float(np.exp(value)), float(np.exp(value) * deviation)
        nuisances.append(Nuisance(name, value, deviation))
    return ChainFit(
        device=coordinates.device(found.unknowns[:size], force_per_current_N_A),
        instrument=instrument_at(found.unknowns[size:], known),
        nuisances=tuple(nuisances),
        coordinates=coordinates,
        maximum=found,
        grips_N=tuple(one.grip_N for one in measured),
        trials=sum(one.data.normal.shape[0] for one in measured if one.grip_N > 0),
        starts=starts,
        agreeing=agreeing,
    )


@dataclass(frozen=True)
class GripFit:
    """A hand fitted to one grip alone with the drive fixed, compared with the hand that is linear in grip.

    Attributes
    ----------
    grip_N : grip of the response.
    scatter : mean square of its residuals with the hand that is linear in grip.
    own_scatter : the same with the hand fitted to this grip alone.
    difference_dB : largest ratio of the two models' magnitudes where coherence is high.
    """

    grip_N: float
    scatter: float
    own_scatter: float
    difference_dB: float


def fit_per_grip(fit: ChainFit, measured: Sequence[GripResponse], *, least_coherence: float) -> list[GripFit]:
    """Lack of fit of the hand that is linear in grip: fit each held grip again with a hand of its own."""
    force, found = fit.device.force_per_current_N_A, []
    for one in measured:
        if one.grip_N == 0:
            continue
        coordinates = Coordinates((one.grip_N,))
        start = np.concatenate([coordinates.of(fit.device), unknowns_of(fit.instrument)])
        order = np.arange(start.size)
        hand_only = (order >= len(SHARED)) & (order < coordinates.size)
        search = ChainSearch([one], coordinates, fit.instrument, force, hand_only)
        own = search.maximum(start)
        frequencies = one.estimate.frequencies_Hz
        by_own, by_all = (
            sampled_response(device.plant(one.grip_N), fit.instrument, frequencies)[0]
            for device in (coordinates.device(own.unknowns[: coordinates.size], force), fit.device)
        )
        clear = one.estimate.coherence > least_coherence
        apart = 20 * np.abs(np.log10(np.abs(by_own) / np.abs(by_all)))[clear]
        before = float(np.sum(search.likelihood.evaluate(start)[0] ** 2))
        found.append(GripFit(one.grip_N, before / own.count, own.scatter, float(apart.max(initial=0.0))))
    return found
