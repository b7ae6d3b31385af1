"""The drive chain and what stood between it and the records, by one likelihood over all trials and grips.

What goes in is the command, which nothing disturbs, or the measured current where the amplifier is no pole and delay.
What comes out are the measured current, the acceleration and, where the encoder moved by counts enough, its position.
Unknown are the chain, the amplifier, and what nobody may have told of the accelerometer: its pole, its gain, and by
how much later than the current it is read. Such a nuisance is kept only where the records contradict its nominal
value; then it is named.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.signals import ComplexArray, FloatArray
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
from transopt.identify.fit import around, quantile
from transopt.identify.likelihood import Maximum

RANDOM_STARTS = 6
SPREAD = 3.0  # random starts lie within this factor of the nominal device scaled to the data
LOOSE = 0.1  # relative error allowed in the first stage, so that one sharp peak does not rule the search
DECIMATION = 4
SAME = 0.05  # sums of squares of the first stage that differ by less count as the same device
EXPLAINED = 2.0  # mean square of the residuals below which no further start is tried
UNKNOWN = 0.5  # standard deviation of a logarithm from which on a parameter counts as not identified
VARIES = 4.0  # observed variance between trials over the noise's, from which on a hand is said to vary
SIGNIFICANT = 5.0  # deviations of a nuisance from its nominal value that the records must show to keep it
MISFIT = 3.0  # mean square of the residuals from where on the fit is lacking
WHOLLY = 1.3  # mean square of the residuals up to which a fit leaves nothing unexplained
BETTER = 4.0  # times smaller a misfit that nuisances leave behind, where they do not explain all of it
SUSPECTED_HZ = 3000.0  # where the search for a pole begins that no file states
NUISANCES = ("accelerometer_pole", "late", "gain")


@dataclass(frozen=True)
class Nuisance:
    """Something that no file states and that the records show.

    Attributes
    ----------
    name : of `NUISANCES`.
    value : a frequency in Hz, samples, or a factor.
    deviation : its standard deviation.
    """

    name: str
    value: float
    deviation: float


@dataclass(frozen=True)
class ChainFit:
    """The drive chain that fits best.

    Attributes
    ----------
    device : the parameters.
    instrument : what stood between it and the records, as found.
    nuisances : what of the accelerometer was found other than stated.
    coordinates : how the chain was sought; its unknowns are the first of `maximum`.
    maximum : all unknowns, those of `INSTRUMENT` last.
    grips_N : of the responses.
    trials : of all held grips together.
    starts, agreeing : how many starts there were, and how many of them led to the best device.
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
        """(size,) of the chain."""
        return self.maximum.unknowns[: self.coordinates.size]

    @property
    def covariance(self) -> FloatArray:
        """(size, size) of the chain's unknowns."""
        return self.maximum.covariance[: self.coordinates.size, : self.coordinates.size]

    @property
    def varying(self) -> NDArray[np.bool_]:
        """(size,) unknowns of the hand that differ from trial to trial by more than noise makes them."""
        of_hand = np.arange(self.coordinates.size) >= len(SHARED)
        return np.asarray(of_hand & (self.maximum.between[: self.coordinates.size] > VARIES))

    @property
    def trials_to_an_end(self) -> float:
        """How many trials tell of the hand at either of the two grips that it is stated at."""
        return max(self.trials / max(len(self.coordinates.ends_N), 1), 1.0)

    @property
    def scatter(self) -> float:
        """Mean square of the residuals: 1 where the model is right and the noise is known."""
        return self.maximum.scatter

    @property
    def at_bounds(self) -> tuple[str, ...]:
        """Unknowns of the chain that ended at a bound."""
        names = self.coordinates.names
        return tuple(name for name, at in zip(names, self.maximum.bounded, strict=False) if at)

    @property
    def unidentified(self) -> dict[str, float]:
        """Unknowns that these responses leave open, with the standard deviation of their logarithm."""
        sigma = np.sqrt(np.diag(self.covariance))
        return {name: float(s) for name, s in zip(self.coordinates.names, sigma, strict=True) if s > UNKNOWN}

    def stated(self) -> tuple[tuple[str, ...], FloatArray, FloatArray, FloatArray]:
        """Names, values (q,), covariance (q, q) and 95 % intervals (q, 2) as a model file states them, in SI.

        What must be positive has its interval on a logarithmic scale, constants and slopes on a plain one.
        """
        names, values, matrix = self.coordinates.stated(self.unknowns)
        covariance = matrix @ self.covariance @ matrix.T
        spans = around(values, covariance)
        for j, value in enumerate(values[: len(SHARED)]):
            factor = factor_of(float(np.sqrt(covariance[j, j]) / value))
            spans[j] = value / factor, value * factor
        return names, values, covariance, spans

    def meaningless(self) -> list[str]:
        """Why parameters that predict well may be no masses, springs and dampers of the device all the same."""
        said = []
        if self.scatter > MISFIT:
            said.append(
                f"residuals of {self.scatter:.2g} times the noise: the parameters make up for what the chain lacks "
                "(further masses, samples not read together, accelerometer_Hz), so that their intervals do not hold"
            )
        if self.at_bounds:
            said.append(f"at a bound, so without meaning by themselves: {', '.join(self.at_bounds)}")
        return said


def factor_of(sigma: float) -> float:
    """Half the 95 % interval of a positive number from the deviation of its logarithm; at most the range searched."""
    return float(np.exp(min(quantile() * sigma, np.log(RANGE))))


def scaled_to(device: DriveChain, measured: Sequence[GripResponse], instrument: Instrument) -> DriveChain:
    """A device like this one, as heavy and as fast as the measured one.

    The response falls as all masses, stiffnesses and dampings grow alike, and shifts along the frequency axis with
    the root of stiffness over mass: heights and peaks of measured and modelled response are laid over each other.
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


def _free(measured: Sequence[GripResponse], coordinates: Coordinates, instrument: Instrument) -> NDArray[np.bool_]:
    """(p,) what these records may tell: the amplifier where the current was read beside the command, a gain where the
    encoder says how far the device moved."""
    amplifier = instrument.amplifier is not None and all(CURRENT in one.outputs for one in measured)
    told = [amplifier, amplifier, amplifier, True, True, any(max(one.outputs) > ACCELERATION for one in measured)]
    return np.array([True] * coordinates.size + told)


def _with_amplifier(measured: Sequence[GripResponse], instrument: Instrument) -> Instrument:
    """The instrument with the amplifier that the currents alone tell; as it was where they were not read."""
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
    """The most likely chain and instrument.

    First a start on each fourth bin with a relative error of 10 % allowed, so that low and high frequencies count
    alike; then on everything. Further starts follow where that leaves the records unexplained. No regularisation:
    what the data leave open shows in the covariance. All nuisances are free at first; those that do not differ from
    their nominal values by five standard deviations are then taken back, the least different one first.

    Parameters
    ----------
    measured : one per grip, 0 for the free device.
    instrument : as stated by the files and the scene.
    nominal : where to start, with the known force per ampere.
    random_starts : beside the nominal device, as it is and scaled to the data.
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
    # Nuisances could make up for a chain that is far off, and a chain for nuisances: both orders are tried.
    first, second = (
        ChainSearch(measured, coordinates, sought, force, moving, loose=LOOSE, step=DECIMATION)
        for moving in (chain_alone, free & (chain_alone | nuisances))
    )
    exact = ChainSearch(measured, coordinates, sought, force, free)
    near = coordinates.of(scaled_to(nominal, measured, sought))
    random = np.random.default_rng(0)
    starts = [near, coordinates.of(nominal)]
    starts += [near + np.log(SPREAD) * random.uniform(-1, 1, near.size) for _ in range(random_starts)]
    reached: list[tuple[FloatArray, float]] = []
    best: Maximum | None = None
    for start in starts:
        whole = np.concatenate([start, tail])
        reached.append(min((second.coarse(one) for one in (whole, first.coarse(whole)[0])), key=lambda one: one[1]))
        tick()
        if reached[-1][1] <= min(cost for _, cost in reached):
            tried = exact.maximum(reached[-1][0])
            best = tried if best is None or tried.total < best.total else best
            if best.scatter < EXPLAINED:
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
        start, moving, values = best.unknowns.copy(), free.copy(), unknowns_of(known)
        for j, name in enumerate(INSTRUMENT):
            if name in NUISANCES:
                moving[coordinates.size + j] = name in names
                if name not in names:
                    start[coordinates.size + j] = values[j]
        return ChainSearch(measured, coordinates, known, force, moving).maximum(start), known

    final, known = with_nuisances(kept)
    if kept and final.scatter > WHOLLY:
        # What is no chain can be bent towards one by any nuisance: none is named that does not explain most of it.
        plain = with_nuisances(())
        if plain[0].scatter < BETTER * final.scatter:
            kept, (final, known) = (), plain
    tick()
    return _result(final, coordinates, known, force, measured, kept, len(reached), agreeing)


def _weighed(measured: Sequence[GripResponse], found: Maximum) -> list[GripResponse]:
    """The responses with the noise of the encoder as large as it turned out.

    Its steps are no noise: the same sweep meets the same ones in every trial, which then agree on their error.
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
    """Nuisances whose nominal values the records exclude, by backward elimination on the normal distribution."""
    nominal = unknowns_of(stated)
    left = [INSTRUMENT.index(name) for name in NUISANCES if found.free[coordinates.size + INSTRUMENT.index(name)]]
    off = found.unknowns[coordinates.size :] - nominal
    spread = found.covariance[coordinates.size :, coordinates.size :].copy()
    pole = INSTRUMENT.index("accelerometer_pole")
    if stated.accelerometer_Hz is None:
        # No pole at all is a time constant of 0: a distance of 1 in units of what was found.
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
    """Fit again to other responses, for example to one grip less, begun where `fit` ended."""
    coordinates = Coordinates(tuple(sorted(one.grip_N for one in measured if one.grip_N > 0)))
    force = fit.device.force_per_current_N_A
    free = np.concatenate([np.ones(coordinates.size, dtype=bool), fit.maximum.free[fit.coordinates.size :]])
    start = np.concatenate([coordinates.of(fit.device), unknowns_of(fit.instrument)])
    found = ChainSearch(measured, coordinates, fit.instrument, force, free).maximum(start)
    kept = tuple(nuisance.name for nuisance in fit.nuisances)
    return _result(found, coordinates, fit.instrument, force, measured, kept, 1, 1)


def response_slopes(fit: ChainFit, grip_N: float, frequencies_Hz: FloatArray) -> ComplexArray:
    """(size, m) derivatives of the chain's acceleration over current by its unknowns."""
    free = np.arange(fit.maximum.unknowns.size) < fit.coordinates.size
    force = fit.device.force_per_current_N_A
    model = ChainModel([(grip_N, (ACCELERATION,), False)], fit.coordinates, fit.instrument, force, free)
    return model(fit.maximum.unknowns, 0, frequencies_Hz)[1][: fit.coordinates.size, 0]


def response_variance(fit: ChainFit, one: GripResponse) -> tuple[FloatArray, FloatArray]:
    """(m,) of the chain's acceleration over current at the bins of an estimate, E|.|^2: of the fitted one against the
    mean of what was recorded, and against the next tap's, whose hand is another one where hands were seen to vary."""
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


def fit_per_grip(fit: ChainFit, measured: Sequence[GripResponse], *, least_coherence: float) -> list[GripFit]:
    """Lack of fit of the hand's linear functions: each held grip once more with a hand of its own."""
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
