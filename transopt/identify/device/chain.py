"""The drive chain and its instrument as a model of the likelihood: parameters, unknowns, responses, derivatives.

The chain has nine parameters at a grip and four for the free device. It is that of `transopt.plant.drive`: motor
mass, transmission, stylus, and the seed's Fig. 4b for the hand.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from transopt.base.signals import BoolArray, ComplexArray, FloatArray
from transopt.identify.condensed import Condensed
from transopt.identify.device.response import ACCELERATION, CURRENT, INSTRUMENT, Instrument, Slope, responses
from transopt.identify.likelihood import Likelihood, Maximum
from transopt.identify.spectrum import TransferEstimate
from transopt.plant.chain import Link, chain
from transopt.plant.state_space import StateSpace
from transopt.scene.plausible import PLAUSIBLE

SHARED = ("moving_mass_kg", "stylus_mass_kg", "transmission_stiffness_N_m", "transmission_damping_N_s_m")
HAND = ("mass_kg", "skin_stiffness_N_m", "skin_damping_N_s_m", "arm_stiffness_N_m", "arm_damping_N_s_m")
RANGE = 1e3  # every parameter of the chain stays within this factor of its start
# A fit may end at its bound; the margin keeps that number plausible where it is rounded.
LEAST_KG = {name: PLAUSIBLE[name][0] * (1 + 1e-9) for name in ("moving_mass_kg", "stylus_mass_kg", "hand.mass_kg")}
UNITS = {"mass_kg": "kg", "stiffness_N_m": "N/m", "damping_N_s_m": "N s/m"}


def unit_of(name: str) -> str:
    """Unit of a parameter by its name; a slope is per newton of grip."""
    unit = next(unit for ending, unit in UNITS.items() if ending in name)
    return f"{unit}/N" if name.endswith(".per_newton") else unit


@dataclass(frozen=True)
class DriveChain:
    """Motor mass - transmission - stylus - skin - hand mass - arm.

    Attributes
    ----------
    force_per_current_N_A : known, not identified: all masses, stiffnesses and dampings are proportional to it.
    shared : (4,) values of `SHARED`.
    hand : (5, 2) constant and slope per newton of `HAND`; (0, 2) without a hand.
    """

    force_per_current_N_A: float
    shared: FloatArray
    hand: FloatArray

    def hand_at(self, grip_N: float) -> FloatArray:
        """(5,) values of `HAND` at a grip."""
        return np.asarray(self.hand[:, 0] + self.hand[:, 1] * grip_N)

    def parameters(self, grip_N: float) -> FloatArray:
        """(9,) parameters at a held grip, (4,) for the free device."""
        return np.concatenate([self.shared, self.hand_at(grip_N)]) if grip_N > 0 else self.shared

    def plant(self, grip_N: float) -> StateSpace:
        """The plant at a grip, 0 for the free device.

        Raises
        ------
        InputError : the chain is not passive at this grip.
        """
        return chain_of(self.parameters(grip_N), self.force_per_current_N_A)

    def with_force(self, force_per_current_N_A: float) -> "DriveChain":
        """The device with the same response for another force per ampere."""
        factor = force_per_current_N_A / self.force_per_current_N_A
        return DriveChain(force_per_current_N_A, self.shared * factor, self.hand * factor)


def hand_table(hand: FloatArray) -> dict[str, dict[str, float]]:
    """Constants and slopes (5, 2) of `HAND` as a model file states them."""
    lines = zip(HAND, hand.tolist(), strict=True)
    return {name: {"constant": constant, "per_newton": slope} for name, (constant, slope) in lines}


def chain_of(parameters: FloatArray, force_per_current_N_A: float, shared: tuple[str, ...] = SHARED) -> StateSpace:
    """The plant of parameters in the order of `shared` and `HAND`, or of `shared` alone for the free device."""
    named = list(zip((*shared, *HAND), parameters.tolist(), strict=False))
    masses = {name: value for name, value in named if name.endswith("mass_kg")}
    stiffness, damping = ([value for name, value in named if unit in name] for unit in ("stiffness", "damping"))
    links, stylus = list(map(Link, stiffness, damping)), _stylus(masses)
    return chain(list(masses.values()), links, force_per_current_N_A=force_per_current_N_A, stylus=stylus)


def _stylus(names: Iterable[str]) -> int:
    """Index of the stylus among the masses of a chain with these parameters."""
    return [name for name in names if name.endswith("mass_kg")].index("stylus_mass_kg")


def log_slopes(
    parameters: FloatArray, force_per_current_N_A: float, shared: tuple[str, ...] = SHARED
) -> tuple[StateSpace, tuple[Slope, ...]]:
    """A chain and its exact derivatives with respect to the logarithm of each parameter.

    The acceleration of a mass (`transopt.plant.chain`) is proportional to 1/mass, and enters the rates of the two
    links that it joins. A is linear in each stiffness and in each damping, which fill one column each.
    """
    plant, names = chain_of(parameters, force_per_current_N_A, shared), (*shared, *HAND)[: parameters.size]
    n, stylus = plant.order // 2, _stylus(names)
    joined, sums = np.eye(n) - np.eye(n, k=1), np.triu(np.ones((n, n)))  # rates by velocities, and their inverse
    by_state, by_current = sums @ plant.A[n:], sums @ plant.B[n:]
    A, B = np.zeros((parameters.size, *plant.A.shape)), np.zeros((parameters.size, *plant.B.shape))
    mass = link = 0
    for j, name in enumerate(names):
        if name.endswith("mass_kg"):
            A[j, n:] = -np.outer(joined[:, mass], by_state[mass])
            B[j, n:] = -np.outer(joined[:, mass], by_current[mass])
            mass += 1
        elif name.endswith("stiffness_N_m"):
            A[j, n:, link] = plant.A[n:, link]
        else:
            A[j, n:, n + link] = plant.A[n:, n + link]
            link += 1
    C, D = (sums[stylus : stylus + 1] @ each[:, n:] for each in (A, B))
    return plant, tuple(Slope(*matrices) for matrices in zip(A, B, C, D, strict=True))


@dataclass(frozen=True)
class Coordinates:
    """The unknowns: logarithms of the shared parameters and of the hand's at the lowest and the highest held grip.

    Between these two grips the hand's parameters are linear, so any unknowns give a chain that is passive at every
    recorded grip. With one held grip the hand is taken to be independent of grip.

    Attributes
    ----------
    held_N : recorded grips above 0, increasing.
    shared : names of the parameters that do not depend on grip.
    """

    held_N: tuple[float, ...]
    shared: tuple[str, ...] = SHARED

    @property
    def ends_N(self) -> tuple[float, ...]:
        """Lowest and highest held grip; only one or none if no more were recorded."""
        return self.held_N if len(self.held_N) < 2 else (self.held_N[0], self.held_N[-1])

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.shared) + len(HAND) * len(self.ends_N)

    @property
    def names(self) -> tuple[str, ...]:
        """(size,) names of the unknowns."""
        return (*self.shared, *(f"hand.{name} at {grip:g} N" for grip in self.ends_N for name in HAND))

    def shares(self, grip_N: float) -> FloatArray:
        """(ends,) interpolation weight of each end grip at a grip."""
        if len(self.ends_N) < 2:
            return np.ones(len(self.ends_N))
        low, high = self.ends_N
        part = (grip_N - low) / (high - low)
        return np.array([1 - part, part])

    def of(self, device: DriveChain) -> FloatArray:
        """(size,) unknowns of a device that is passive at both ends."""
        values: FloatArray = np.concatenate([device.shared, *(device.hand_at(grip) for grip in self.ends_N)])
        return np.asarray(np.log(values))

    def _hand(self) -> FloatArray:
        """(2, ends) matrix from the values at the end grips to constant and slope per newton."""
        if len(self.ends_N) < 2:
            return np.array([[1.0], [0.0]])[:, : len(self.ends_N)]
        low, high = self.ends_N
        return np.array([[high, -low], [-1.0, 1.0]]) / (high - low)

    def device(self, unknowns: FloatArray, force_per_current_N_A: float) -> DriveChain:
        """The chain of unknowns (size,)."""
        values = np.exp(unknowns)
        ends = values[len(SHARED) :].reshape(-1, len(HAND))
        hand = (self._hand() @ ends).T if self.ends_N else np.zeros((0, 2))
        return DriveChain(force_per_current_N_A, values[: len(SHARED)], hand)

    def at(self, grip_N: float) -> FloatArray:
        """(n + 5, size) matrix from the values at the end grips to the n shared and the hand's parameters."""
        hand = np.kron(self.shares(grip_N), np.eye(len(HAND)))
        return np.asarray(linalg.block_diag(np.eye(len(self.shared)), hand))

    def lines(self) -> tuple[tuple[str, ...], FloatArray]:
        """Names of the q numbers in a model file, and the (q, size) matrix from the values at the end grips."""
        parts = ("constant", "per_newton")[: len(self.ends_N)]
        names = (*self.shared, *(f"hand.{name}.{part}" for name in HAND for part in parts))
        each = self._hand()[: len(parts)]
        hand = np.einsum("ab,pe->apeb", np.eye(len(HAND)), each).reshape(
            len(HAND) * len(parts), len(HAND) * len(self.ends_N)
        )
        return names, np.asarray(linalg.block_diag(np.eye(len(self.shared)), hand))

    def stated(self, unknowns: FloatArray) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
        """Names and values (q,) as a model file states them, and d value / d unknown (q, size)."""
        names, lines = self.lines()
        matrix = lines * np.exp(unknowns)
        return names, matrix.sum(axis=1), matrix


@dataclass(frozen=True)
class GripResponse:
    """The measured responses at one grip, 0 for the free device.

    Attributes
    ----------
    grip_N : mean grip of the trials.
    estimate : response of acceleration over current.
    data : condensed lines from the command to current, acceleration and position, or from the current to the others.
    outputs : row of `responses` for each output of `data`.
    commanded : whether the input of `data` is the command; else it is the current.
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
    """Responses of all grips and their derivatives by theta: the chain's unknowns, then those of `INSTRUMENT`.

    A group is a grip, its outputs, and whether the command is its input (see `GripResponse`).
    """

    def __init__(
        self,
        groups: Sequence[tuple[float, tuple[int, ...], bool]],
        coordinates: Coordinates,
        instrument: Instrument,
        force_per_current_N_A: float,
        free: BoolArray,
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
    """The instrument with these (6,) unknowns; an ideal part of `known` stays ideal."""
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
    """The likelihood of a chain with the bounds of its unknowns."""

    def __init__(
        self,
        measured: Sequence[GripResponse],
        coordinates: Coordinates,
        instrument: Instrument,
        force_per_current_N_A: float,
        free: BoolArray,
        *,
        loose: float = 0.0,
        step: int = 1,
    ) -> None:
        groups = [(one.grip_N, one.outputs, one.commanded) for one in measured]
        model = ChainModel(groups, coordinates, instrument, force_per_current_N_A, free)
        self.likelihood = Likelihood([one.data for one in measured], model, loose=loose, step=step)
        self._coordinates, self._free, self._rate = coordinates, free, 1 / instrument.dt_s

    def bounds(self, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds (p,) of the unknowns.

        A mass that the records do not show, as where stylus and hand move as one, falls until a bound stops it. It
        must end at what a device can have: one of a microgram under the same damping is too stiff to be simulated.
        """
        size, rate = self._coordinates.size, self._rate
        low, high = start - np.log(RANGE), start + np.log(RANGE)
        for j, name in enumerate(self._coordinates.names):
            least_kg = LEAST_KG.get(name.partition(" at ")[0])
            if least_kg is not None and start[j] >= np.log(least_kg):
                low[j] = max(low[j], np.log(least_kg))
        low[size:] = [np.log(1e-3 * rate), 0.0, -np.log(20.0), np.log(0.01 * rate), -20.0, -np.log(20.0)]
        high[size:] = [np.log(2 * rate), 20.0, np.log(20.0), np.log(2 * rate), 20.0, np.log(20.0)]
        return low, high

    def coarse(self, start: FloatArray) -> tuple[FloatArray, float]:
        """Unknowns at the end of a search from a start, and their sum of squares, without covariance."""
        return self.likelihood.search(start, *self.bounds(start), self._free, most=60)

    def maximum(self, start: FloatArray) -> Maximum:
        """The maximum of the likelihood near a start, with its covariance."""
        return self.likelihood.maximum(start, *self.bounds(start), self._free)
