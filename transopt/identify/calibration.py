"""The hand of a new user from a few of its taps, by their likelihood with a population of hands as prior.

The drive is known; what is sought are the hand's five parameters at the two grips of the population. The taps are
played on the device, so that what drives them is known: the commands, and the current that was measured beside them.
What the hand does of its own accord is taken for a steady course until it can react, and left out by least squares:
a constant of the accelerometer and a parabola of the position, fitted along with the rest from before the contact on.

The grip that a sensor reads is off as well, by some part of its own in every tap; these parts are sought too.

In whitened unknowns u, of which the population is normal with unit covariance, the negative logarithm of the
posterior is a sum of squares: of the residuals over their deviations, and of u. Its minimum is the maximum a
posteriori. What the chain does not explain (a drive that is not as stated, a hand that trembles) shows as residuals
above the sensors' noise; they then count by so much less, and the prior by so much more.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import ValidationError

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.identify.device.chain import HAND, SHARED, Coordinates, log_slopes
from transopt.identify.device.response import ACCELERATION, CURRENT, POSITION, Instrument, courses
from transopt.identify.fit import around, known
from transopt.identify.squares import Squares, inverse
from transopt.scene.fitted import Source, complaint
from transopt.scene.model_parts import DriveDevice
from transopt.scene.population import Population

FARTHEST = 4.0  # deviations of the population in each of its axes within which a hand is sought
LOOSE = 30.0  # sensors taken to be so much worse in the first search, which so finds the valley of the best hand
ROUNDS = 3  # of searches after it, each with the residuals' size as the one before left it
GRIP_ERROR = 0.03  # standard deviation of a grip that is read, relative: a hysteresis of 5 % to either side
TOLD = 0.7  # a posterior deviation above this share of the prior's: the taps hardly tell
UNEXPLAINED = 2.25  # mean square of the residuals over the sensors' noise from which on that is said
ONE_GRIP = 1.2  # largest over smallest grip of taps that say nothing of how a hand changes with grip
LEAST_SHARE = 0.01  # of a parameter at the lighter end, below which it is taken for no hand's
LEAST_SPREAD = 1e-9  # of the population: an axis along which it does not vary


@dataclass(frozen=True)
class PlayedRecord:
    """One tap that a device played, tick by tick, from before the contact to the end of the hand's intention.

    Attributes
    ----------
    grip_N : as the device measured it.
    dt_s : servo period.
    command_A, current_A : (K,) issued at each tick, and read at it.
    acceleration_m_s2, position_m : (K,) as read; a constant and a parabola of their own do not matter.
    first : index of the first command that is played.
    acceleration_noise_m_s2, position_noise_m : standard deviations of what the sensors add.
    """

    grip_N: float
    dt_s: float
    command_A: FloatArray
    current_A: FloatArray
    acceleration_m_s2: FloatArray
    position_m: FloatArray
    first: int
    acceleration_noise_m_s2: float
    position_noise_m: float


@dataclass(frozen=True)
class Calibration:
    """A hand as its taps and the population have it.

    Attributes
    ----------
    device : drive and hand, with the covariance of the hand.
    logarithms, covariance : (10,), (10, 10) of the hand's parameters at both grips of the population.
    grips_N : of the taps, as read.
    prior_deviation, deviation : (5,) of the parameters' logarithms at their mean grip, before and after the taps.
    scatter : mean square of the residuals over the sensors' own noise, of acceleration and of position.
    """

    device: DriveDevice
    logarithms: FloatArray
    covariance: FloatArray
    grips_N: tuple[float, ...]
    prior_deviation: FloatArray
    deviation: FloatArray
    scatter: tuple[float, float]

    @property
    def grip_N(self) -> float:
        """Mean grip of the taps."""
        return float(np.mean(self.grips_N))

    @property
    def at_ends(self) -> FloatArray:
        """(2, 5) values of `HAND` at both grips of the population."""
        return np.exp(self.logarithms).reshape(2, -1)

    @property
    def told(self) -> dict[str, tuple[float, float, bool]]:
        """Name of `HAND` -> relative deviations of prior and posterior, and whether the taps speak.

        If they do not, the population does.
        """
        rows = zip(HAND, self.prior_deviation.tolist(), self.deviation.tolist(), strict=True)
        return {name: (prior, own, own <= TOLD * prior) for name, prior, own in rows}

    @property
    def in_words(self) -> str:
        """How sure the hand is, what the taps left to the population, and what they do not fit."""
        known = [f"{name} to {100 * own:.2g} %" for name, (_, own, told) in self.told.items() if told]
        left = [name for name, (_, _, told) in self.told.items() if not told]
        taps = len(self.grips_N)
        said = f"the hand by {taps} tap{'s' if taps > 1 else ''} on a drive that is taken as known: "
        said += f"at {self.grip_N:.2g} N {', '.join(known) or 'nothing'} (one standard deviation)"
        if left:
            said += f"; left to the population: {', '.join(left)}: tap at other grips and speeds to know them"
        if max(self.grips_N) < ONE_GRIP * min(self.grips_N):
            said += "; at other grips the population speaks, for all taps are of one: tap at more"
        if (worst := max(self.scatter)) > UNEXPLAINED:
            said += (
                f"; the taps are {np.sqrt(worst):.1f} times as far from any such hand as the sensors' noise "
                "explains, and count by so much less: identify the drive, or tap with a steadier hand"
            )
        return said


class _Posterior:
    """Residuals and their Jacobian by the whitened unknowns: those of the hand, then the error of each tap's grip."""

    def __init__(
        self, records: Sequence[PlayedRecord], drive: DriveDevice, instrument: Instrument, population: Population
    ) -> None:
        self.records, self._drive, self._instrument = records, drive, instrument
        factor = population.factor()
        self.mean, self.factor = population.mean(), factor[:, np.linalg.norm(factor, axis=0) > LEAST_SPREAD]
        self.size = self.factor.shape[1] + len(records)
        self.coordinates = Coordinates((population.grips_N[0], population.grips_N[1]), ())
        self.sizes = np.ones(2)  # of the residuals over the sensors' noise, of acceleration and position
        self._shared = np.array([getattr(drive, name) for name in SHARED])
        pole_Hz = instrument.accelerometer_Hz
        # Noise of the acceleration goes through the accelerometer's pole, that of counts is white.
        self._kept = (0.0 if pole_Hz is None else float(np.exp(-2 * np.pi * pole_Hz * instrument.dt_s)), 0.0)
        self._left_out = [
            [
                _own_course(kept, degree, record.command_A.size)
                for kept, degree in zip(self._kept, (0, 2), strict=True)
            ]
            for record in records
        ]
        # What the amplifier lets flow beside what its model says, joined by straight lines, in means over a tick.
        self._beside = []
        for record in records:
            model = courses(drive.plant(record.grip_N), instrument, record.command_A)[0, CURRENT]
            left = record.current_A - record.current_A[: record.first].mean() - model
            left[: record.first] = 0.0
            self._beside.append((left + np.append(left[1:], left[-1])) / 2)

    def logarithms(self, unknowns: FloatArray) -> FloatArray:
        """(10,) of the hand, at both grips of the population."""
        return np.asarray(self.mean + self.factor @ unknowns[: self.factor.shape[1]])

    def _motion(self, unknowns: FloatArray, j: int) -> FloatArray:
        """(1 + u, 2, K) acceleration and position of a record, and their derivatives by the unknowns."""
        record, n, at_ends = self.records[j], self.factor.shape[1], np.exp(self.logarithms(unknowns))
        off_N = GRIP_ERROR * record.grip_N
        matrix = self.coordinates.at(record.grip_N + off_N * unknowns[n + j])
        # Beyond the population's grips a line may cross zero on the way of a search: no hand does.
        hand = np.maximum(matrix @ at_ends, LEAST_SHARE * at_ends.reshape(2, -1).min(axis=0))
        by_grip = (self.coordinates.at(off_N) - self.coordinates.at(0.0)) @ at_ends
        plant, slopes = log_slopes(np.concatenate([self._shared, hand]), self._drive.force_per_current_N_A)
        own = slopes[len(SHARED) :]
        ideal = Instrument(record.dt_s, None, self._instrument.accelerometer_Hz)
        found = courses(plant, self._instrument, record.command_A, own) + courses(plant, ideal, self._beside[j], own)
        by_unknowns = np.zeros((self.size, len(HAND)))
        by_unknowns[:n] = self.factor.T @ (matrix * at_ends / hand[:, None]).T
        by_unknowns[n + j] = by_grip / hand
        value, slope = found[:1], np.einsum("up,pok->uok", by_unknowns, found[1:])
        return np.concatenate([value, slope])[:, [ACCELERATION, POSITION]]

    def data(self, unknowns: FloatArray, j: int) -> FloatArray:
        """(1 + u, 2, K) residuals of a record over the sensors' noise, made white, and their derivatives."""
        record, found = self.records[j], self._motion(unknowns, j)
        found[0] -= [record.acceleration_m_s2, record.position_m]
        for o, noise in enumerate((record.acceleration_noise_m_s2, record.position_noise_m)):
            axes = self._left_out[j][o]
            white = _whitened(found[:, o], self._kept[o]) / noise
            found[:, o] = white - (white @ axes) @ axes.T
        return found

    def evaluate(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (n,) and Jacobian (n, u), those of the prior last."""
        each = [self.data(unknowns, j) / self.sizes[:, None] for j in range(len(self.records))]
        whole = np.concatenate([found.reshape(1 + self.size, -1) for found in each], axis=1)
        return np.append(whole[0], unknowns), np.concatenate([whole[1:].T, np.eye(self.size)])

    def scatter(self, unknowns: FloatArray) -> FloatArray:
        """(2,) mean square of the residuals over the sensors' noise, of acceleration and position."""
        each = [self.data(unknowns, j)[0] for j in range(len(self.records))]
        return np.asarray(np.mean(np.concatenate(each, axis=1) ** 2, axis=1))


def _whitened(values: FloatArray, kept: float) -> FloatArray:
    """(..., K) values of which each keeps a part of the one before it, made independent, of the same variance."""
    found = values.copy()
    found[..., 1:] = (values[..., 1:] - kept * values[..., :-1]) / np.sqrt(1 - kept**2)
    return found


def _own_course(kept: float, degree: int, count: int) -> FloatArray:
    """Orthonormal (K, 1 + degree): what a polynomial looks like once it is whitened."""
    powers = np.vander(np.linspace(-1, 1, count), degree + 1).T
    return np.linalg.qr(_whitened(powers, kept).T)[0]


def calibrate(
    records: Sequence[PlayedRecord],
    drive: DriveDevice,
    instrument: Instrument,
    population: Population,
    sources: Sequence[Source],
) -> Calibration:
    """The most probable hand behind some taps, and how sure it is.

    Parameters
    ----------
    drive : whose drive is known; its hand is replaced, its grips are those that shall be served.
    instrument : amplifier and accelerometer; its gain and lateness are taken as ideal.
    sources : what the model file says it was fitted to.

    Raises
    ------
    InputError : no taps, or a hand that is not passive at a grip that shall be served.
    """
    if not records:
        raise InputError("calibrate: no tap was played to its end: tap again")
    posterior = _Posterior(records, drive, instrument, population)
    unknowns, far = np.zeros(posterior.size), np.full(posterior.size, FARTHEST)
    posterior.sizes = np.full(2, LOOSE)
    for _ in range(1 + ROUNDS):
        unknowns, _ = Squares(posterior.evaluate).search(unknowns, -far, far)
        scatter = posterior.scatter(unknowns)
        posterior.sizes = np.sqrt(np.maximum(scatter, 1.0))
    n = posterior.factor.shape[1]
    covariance = posterior.factor @ inverse(posterior.evaluate(unknowns)[1])[:n, :n] @ posterior.factor.T
    logarithms = posterior.logarithms(unknowns)
    grips = tuple(record.grip_N for record in records)
    matrix, at_ends = posterior.coordinates.at(float(np.mean(grips))), np.exp(logarithms)
    by_ends = matrix * at_ends / (matrix @ at_ends)[:, None]

    def deviations(of: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt(np.diag(by_ends @ of @ by_ends.T)))

    found = Calibration(
        device=_device(drive, posterior.coordinates, logarithms, covariance, sources),
        logarithms=logarithms,
        covariance=covariance,
        grips_N=grips,
        prior_deviation=deviations(population.covariance()),
        deviation=deviations(covariance),
        scatter=(float(scatter[0]), float(scatter[1])),
    )
    device = found.device.model_copy(update={"verdict": found.in_words})
    return replace(found, device=device)


def _device(
    drive: DriveDevice,
    coordinates: Coordinates,
    logarithms: FloatArray,
    covariance: FloatArray,
    sources: Sequence[Source],
) -> DriveDevice:
    """The drive with the hand of (10,) logarithms at both ends and their covariance, as a model file states it."""
    names, values, matrix = coordinates.stated(logarithms)
    spread = matrix @ covariance @ matrix.T
    hand: dict[str, dict[str, float]] = {}
    for name, value in zip(names, values.tolist(), strict=True):
        _, parameter, part = name.split(".")
        hand.setdefault(parameter, {})[part] = value
    stated = {
        "hand": hand,
        **known(names, spread, around(values, spread)),
        "sources": [source.model_dump() for source in sources],
    }
    try:
        return DriveDevice.model_validate({**drive.model_dump(), **stated})
    except ValidationError as error:
        ends = " and ".join(f"{end:g}" for end in coordinates.ends_N)
        raise InputError(
            f"calibrate: the hand is linear in grip from {ends} N, and not passive farther out ({complaint(error)}): "
            "solve the library for grips nearer to these, or state the population at its grips"
        ) from None
