"""The hand of a new user, from a few of its taps: the maximum a posteriori with a population of hands as prior.

The drive is known; the unknowns are the hand's five parameters at the two grips of the population. The taps are
played on the device, so their input is known: the commands, and the current measured beside them. Until the hand can
react, its own motion is taken to be smooth and is eliminated by least squares: a constant of the acceleration and a
parabola of the position, fitted from before the contact on.

The grip sensor has an error that differs from tap to tap; these errors are unknowns too.

In whitened unknowns u, in which the population is normal with unit covariance, the negative logarithm of the
posterior is a sum of squares: of the residuals over their deviations, and of u. Its minimum is the maximum a
posteriori. What the chain does not explain (a drive other than stated, a hand that trembles) raises the residuals
above the sensors' noise; the residuals' weights are then lowered accordingly, so that the prior counts for more.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import ValidationError

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.identify.device.chain import HAND, SHARED, Coordinates, hand_table, log_slopes
from transopt.identify.device.response import ACCELERATION, CURRENT, POSITION, Instrument, courses
from transopt.identify.fit import intervals_around, known
from transopt.identify.squares import Squares, inverse
from transopt.scene.fitted import Source, complaint
from transopt.scene.model_parts import DriveDevice
from transopt.scene.population import Population

FARTHEST = 4.0  # bound of the search, in standard deviations of the population along each axis
LOOSE = 30.0  # factor on the sensors' noise in the first search, so that it finds the valley of the best hand
ROUNDS = 3  # searches after the first, each with the residuals' size that the previous one left
GRIP_ERROR = 0.03  # relative standard deviation of a grip reading: a hysteresis of 5 % to either side
DETERMINED = 0.7  # largest posterior over prior deviation at which the taps count as determining a parameter
UNEXPLAINED = 2.25  # mean square of the residuals over the sensors' noise above which the verdict mentions it
ONE_GRIP = 1.2  # largest over smallest grip below which the taps cannot show how the hand changes with grip
LEAST_SHARE = 0.01  # least value of a parameter, as a share of the smaller of its values at the two ends
LEAST_SPREAD = 1e-9  # deviation of the population below which an axis counts as constant


@dataclass(frozen=True)
class PlayedRecord:
    """One tap that a device played, tick by tick, from before the contact to the end of the hand's intention.

    Attributes
    ----------
    grip_N : as the device measured it.
    dt_s : servo period.
    command_A, current_A : (K,) issued at each tick, and read at it.
    acceleration_m_s2, position_m : (K,) as read; a constant in the one and a parabola in the other have no effect.
    first : index of the first command of the waveform.
    acceleration_noise_m_s2, position_noise_m : standard deviations of the sensors' noise.
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
    """A hand estimated from its taps and the population.

    Attributes
    ----------
    device : drive and hand, with the covariance of the hand.
    logarithms, covariance : (10,) logarithms of the hand's parameters at both grips of the population; (10, 10).
    grips_N : grips of the taps, as read.
    prior_deviation, deviation : (5,) standard deviations of the parameters' logarithms at the taps' mean grip, prior
        and posterior.
    scatter : mean square of the residuals over the sensors' noise, of acceleration and of position.
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
    def determined(self) -> dict[str, tuple[float, float, bool]]:
        """Name of `HAND` -> relative deviations of prior and posterior, and whether the taps determine it.

        Otherwise its value is mostly that of the population.
        """
        rows = zip(HAND, self.prior_deviation.tolist(), self.deviation.tolist(), strict=True)
        return {name: (prior, own, own <= DETERMINED * prior) for name, prior, own in rows}

    @property
    def in_words(self) -> str:
        """How certain the hand is, which parameters come from the population, and whether the residuals are large."""
        known = [f"{name} to {100 * own:.2g} %" for name, (_, own, by_taps) in self.determined.items() if by_taps]
        left = [name for name, (_, _, by_taps) in self.determined.items() if not by_taps]
        taps = len(self.grips_N)
        sentence = f"the hand by {taps} tap{'s' if taps > 1 else ''} on a drive that is taken as known: "
        sentence += f"at {self.grip_N:.2g} N {', '.join(known) or 'nothing'} (one standard deviation)"
        if left:
            sentence += f"; left to the population: {', '.join(left)}: tap at other grips and speeds to know them"
        if max(self.grips_N) < ONE_GRIP * min(self.grips_N):
            sentence += "; at other grips the population speaks, for all taps are of one: tap at more"
        if (worst := max(self.scatter)) > UNEXPLAINED:
            sentence += (
                f"; the taps are {np.sqrt(worst):.1f} times as far from any such hand as the sensors' noise "
                "explains, and count by so much less: identify the drive, or tap with a steadier hand"
            )
        return sentence


class _Posterior:
    """Residuals and their Jacobian; the unknowns u are the whitened ones of the hand, then each tap's grip error."""

    def __init__(
        self, records: Sequence[PlayedRecord], drive: DriveDevice, instrument: Instrument, population: Population
    ) -> None:
        self.records, self._drive, self._instrument = records, drive, instrument
        factor = population.factor()
        self.mean, self.factor = population.mean(), factor[:, np.linalg.norm(factor, axis=0) > LEAST_SPREAD]
        self.size = self.factor.shape[1] + len(records)
        self.coordinates = Coordinates((population.grips_N[0], population.grips_N[1]), ())
        self.sizes = np.ones(2)  # rms of the residuals over the sensors' noise, of acceleration and position
        self._shared = np.array([getattr(drive, name) for name in SHARED])
        pole_Hz = instrument.accelerometer_Hz
        # The accelerometer's pole colours the noise of the acceleration; the noise of the encoder's counts is white.
        self._kept = (0.0 if pole_Hz is None else float(np.exp(-2 * np.pi * pole_Hz * instrument.dt_s)), 0.0)
        self._left_out = [
            [
                _own_course(kept, degree, record.command_A.size)
                for kept, degree in zip(self._kept, (0, 2), strict=True)
            ]
            for record in records
        ]
        # Measured less modelled current, taken as linear between ticks: its mean over each tick drives the plant too.
        self._beside = []
        for record in records:
            model = courses(drive.plant(record.grip_N), instrument, record.command_A)[0, CURRENT]
            left = record.current_A - record.current_A[: record.first].mean() - model
            left[: record.first] = 0.0
            self._beside.append((left + np.append(left[1:], left[-1])) / 2)

    def logarithms(self, unknowns: FloatArray) -> FloatArray:
        """(10,) logarithms of the hand's parameters at both grips of the population."""
        return np.asarray(self.mean + self.factor @ unknowns[: self.factor.shape[1]])

    def _motion(self, unknowns: FloatArray, j: int) -> FloatArray:
        """(1 + u, 2, K) acceleration and position of a record, and their derivatives by the unknowns."""
        record, n, at_ends = self.records[j], self.factor.shape[1], np.exp(self.logarithms(unknowns))
        off_N = GRIP_ERROR * record.grip_N
        matrix = self.coordinates.at(record.grip_N + off_N * unknowns[n + j])
        # Beyond the population's grips a line over grip may cross zero during the search; no hand's parameter does.
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
        """(1 + u, 2, K) whitened residuals of a record over the sensors' noise, and their derivatives."""
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
    """(..., K) whitened values of an autoregressive process of first order with coefficient `kept`; same variance."""
    found = values.copy()
    found[..., 1:] = (values[..., 1:] - kept * values[..., :-1]) / np.sqrt(1 - kept**2)
    return found


def _own_course(kept: float, degree: int, count: int) -> FloatArray:
    """Orthonormal basis (K, 1 + degree) of the whitened polynomials of this degree."""
    powers = np.vander(np.linspace(-1, 1, count), degree + 1).T
    return np.linalg.qr(_whitened(powers, kept).T)[0]


def calibrate(
    records: Sequence[PlayedRecord],
    drive: DriveDevice,
    instrument: Instrument,
    population: Population,
    sources: Sequence[Source],
) -> Calibration:
    """The most probable hand given some taps, and its uncertainty.

    Parameters
    ----------
    drive : the known drive; its hand is replaced, its grips are those that the model must serve.
    instrument : amplifier and accelerometer; its gain and lateness are taken as ideal.
    sources : the recordings that the model file names as fitted.

    Raises
    ------
    InputError : no taps, or a hand that is not passive at a grip that the model must serve.
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
    stated = {
        "hand": hand_table(values.reshape(-1, 2)),
        **known(names, spread, intervals_around(values, spread)),
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
