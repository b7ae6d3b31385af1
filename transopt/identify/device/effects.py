"""What a device does at the amplitude of use that no response shows, told apart by name.

Each candidate is a force that acts inside the drive chain, beside the linear ones, as the motion predicted by the
chain makes it: friction against the motor's velocity, play that takes back a part of the transmitted force, a skin
whose spring grows with the cube of its stretch; and an amplifier whose current falls short of the command with the
cube of it. The chain turns the force into an acceleration; the candidate that explains most of what was missed is
named. It is the first order of a perturbation: small effects add to the linear answer, each in a shape of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from transopt.base.filters import highpass
from transopt.base.signals import ComplexArray, FloatArray, Signal
from transopt.identify.checks import within
from transopt.identify.device.chain import DriveChain
from transopt.identify.device.chain_fit import ChainFit, response_slopes
from transopt.identify.device.response import Instrument
from transopt.identify.device.trials import felt_current
from transopt.identify.device.validation import Model, predict, through
from transopt.identify.findings import JITTER_NOTED
from transopt.identify.measurement import Measurement
from transopt.plant.state_space import StateSpace
from transopt.scene.model_error import AtUse, ModelError

HIGHPASS_HZ = 25.0  # what is slower in a held hand is its tremor, and little of a tap
QUIET = 0.02  # of the predicted peak: below, a record shows its noise alone
LEAST_QUIET_S = 0.02
OFFSET = 0.1  # of what an offset makes of a record, that has to lie where it rests
LOWEST_HZ = 0.1  # stands for 0 Hz, where a free chain answers with a drift
ALIGNED_HZ = 500.0  # below which command and current are laid over each other
CERTAIN = 4.0  # deviations of the noise's energy that an excess must have
EXPLAINS = 0.25  # of what was missed: a candidate that explains less is not named
LEAST_PERIODS, EXCITED = 2, 1e-6  # after the transient; of the largest line, from which on a line is excited
LOUD = 5.0  # deviations of the noise, from which on the shape of a cause is in the detection lines
SHOWS, CLEARLY = 0.15, 3.0  # of the distortion that a cause explains, and how much more than another
PLAYS = 0.02  # of the answer: the distortion from which on play is to be feared
OF_THE_CURRENT = 0.5  # of the acceleration's distortion that the current must have to be its cause
SLOW, PLAY = 0.02, 0.1  # of the largest speed and stretch: over which friction and play change their sign
SHORTFALL = 0.01  # of the largest current that the amplifier may miss before it is named
SIGNIFICANT = 50.0  # variances of the noise that a dead band takes off the residual of a current
CROSSOVER, CROSSOVERS = 2e-3, 40  # A, the least that is looked for; and how many are, up to a tenth of the peak


@dataclass(frozen=True)
class Missed:
    """One record at the amplitude of use against its prediction.

    Attributes
    ----------
    run : what was recorded.
    current_A : (n,) that the prediction is of.
    residual : (n,) recorded less predicted acceleration after the high-pass [m/s^2].
    energy : of the recorded acceleration where something happens.
    excess : energy of the residual there beyond the noise's, over `energy`.
    deviation : of `excess`, by the noise alone; infinite where the record never rests, so that its noise is unknown.
    """

    run: Measurement
    current_A: FloatArray
    residual: FloatArray
    energy: float
    excess: float
    deviation: float


def missed(model: Model, grip_N: float, instrument: Instrument, run: Measurement) -> Missed:
    """What a prediction from the command misses beyond the noise; from the current where that alone was recorded.

    As a design predicts: with the amplifier's pole and delay and a gain of one. The noise is that of the record
    itself where the prediction rests.
    """
    recorded = run.require("acceleration", "acceleration_m_s2")
    current = _commanded(run, instrument)

    from_rest = _from_rest(current.values)
    parts = predict(model, grip_N, instrument, from_rest), recorded.values, np.ones(recorded.values.size)
    predicted, measured, step = (_passed(recorded.start_s, recorded.dt_s, values) for values in parts)
    residual = measured - predicted
    size = np.abs(predicted)
    least = QUIET * size.max(initial=0.0)
    # Not yet begun, or rung down for good.
    quiet = (np.maximum.accumulate(size) < least) | (np.maximum.accumulate(size[::-1])[::-1] < least)
    known = float(step[quiet] @ step[quiet])  # the high-pass lets an offset through only where a record begins
    offset = float(step[quiet] @ residual[quiet]) / known if known > OFFSET * float(step @ step) else 0.0
    residual = residual - offset * step
    busy = ~quiet
    energy = float(np.sum((measured - offset * step)[busy] ** 2))
    noise, uncertain = 0.0, np.inf
    if np.count_nonzero(quiet) * recorded.dt_s >= LEAST_QUIET_S:
        noise = float(np.mean(residual[quiet] ** 2))
        n, rest = int(np.count_nonzero(busy)), int(np.count_nonzero(quiet))
        alike = _alike(residual[quiet])
        uncertain = noise * n * float(np.sqrt(2 * alike * (1 / max(n, 1) + 1 / rest)))
    if run.off_grid > JITTER_NOTED:
        uncertain = np.inf  # stamps that are off make samples off by their slope, which no rest shows
    excess = float(np.sum(residual[busy] ** 2)) - noise * np.count_nonzero(busy)
    scale = max(energy, np.finfo(float).tiny)
    return Missed(run, from_rest, residual, energy, excess / scale, uncertain / scale)


def _commanded(run: Measurement, instrument: Instrument) -> Signal:
    """The current that a design expects: the command's, laid over the measured one in time.

    A card of its own may read the command late; what is a shift is no error of the model.
    """
    if run.command is None or run.current is None:
        return felt_current(run, instrument.amplifier)
    expected, measured = felt_current(replace(run, current=None), instrument.amplifier), run.current
    size = fft.next_fast_len(2 * expected.values.size, real=True)
    w = 2 * np.pi * fft.rfftfreq(size, expected.dt_s)
    given, read = (fft.rfft(x.values - np.median(x.values), size) for x in (expected, measured))
    cross = read * given.conj()
    weight = np.where(w < 2 * np.pi * ALIGNED_HZ, np.abs(cross), 0.0)
    shift_s = -float(np.sum(weight * w * np.angle(cross)) / max(np.sum(weight * w**2), np.finfo(float).tiny))
    moved = fft.irfft(fft.rfft(expected.values, size) * np.exp(-1j * w * shift_s), size)[: expected.values.size]
    return Signal(expected.start_s, expected.dt_s, moved)


def _from_rest(values: FloatArray) -> FloatArray:
    """(n,) less what they begin with."""
    return values - np.median(values[: max(3, values.size // 50)])


def _passed(start_s: float, dt_s: float, values: FloatArray) -> FloatArray:
    """(n,) what is fast enough to be of a tap."""
    return highpass(Signal(start_s, dt_s, values), HIGHPASS_HZ).values


def _alike(noise: FloatArray) -> float:
    """How many times as uncertain the energy of this noise is as that of white noise: the sum of its squared
    autocorrelations (Bartlett 1946)."""
    size = fft.next_fast_len(2 * noise.size, real=True)
    power = np.abs(fft.rfft(noise - noise.mean(), size)) ** 2
    along = fft.irfft(power, size)[: noise.size // 2]
    return float(1 + 2 * np.sum((along[1:] / max(along[0], np.finfo(float).tiny)) ** 2))


def at_use(found: Sequence[Missed], error: ModelError) -> list[AtUse]:
    """What each record missed beyond noise and beyond what the response's own error explains."""
    stated = []
    for one in found:
        assert one.run.grip_N is not None
        linear = error.nrmse(one.run.grip_N, one.current_A, one.run.require("acceleration", "").dt_s, one.energy) ** 2
        beyond = one.excess - linear
        significant = beyond > CERTAIN * one.deviation
        stated.append(
            AtUse(
                grip_N=one.run.grip_N,
                peak_A=max(float(np.abs(one.current_A).max()), 1e-9),
                excess=float(np.sqrt(beyond)) if significant else 0.0,
            )
        )
    return stated


@dataclass(frozen=True)
class Distortion:
    """What a periodic excitation finds at lines that it does not excite: rms per line over that at excited ones.

    Less what is noise; 0 where it is no more than noise.

    Attributes
    ----------
    even, odd : of the acceleration at even and at odd detection lines.
    current_even, current_odd : of the measured current at the same lines; 0 where it was not measured.
    """

    even: float
    odd: float
    current_even: float = 0.0
    current_odd: float = 0.0

    @property
    def largest(self) -> float:
        """Larger of the acceleration's even and odd parts."""
        return max(self.even, self.odd)

    def words(self) -> str:
        """What it says of the device, and what to do about it."""
        size = (
            f"{100 * self.odd:.2g} % odd and {100 * self.even:.2g} % even distortion at lines that were not excited"
        )
        if max(self.current_even, self.current_odd) > OF_THE_CURRENT * self.largest:
            current = f"the current has {100 * self.current_odd:.2g} and {100 * self.current_even:.2g} % of its own"
            return f"{size}; {current}: the amplifier gives way or has a crossover: identify it, or use less current"
        if self.odd > self.even:
            kind = "alike in both directions, as friction, play and a spring that stiffens are"
        else:
            kind = "different between pushing and pulling, as a preload, a stop or a force that varies with place is"
        return f"{size}: {kind}; a response predicts no tap nearer than that: refine the library on the device"


@dataclass(frozen=True)
class _Lines:
    """Lines at which a periodic record was excited or not; the first period, its transient, is left out.

    Attributes
    ----------
    first, size, periods : sample at which the second period begins, samples of one, and how many whole ones follow.
    excited, even, odd : (size // 2 + 1,) lines of one period: with excitation, and between those without.
    """

    first: int
    size: int
    periods: int
    excited: NDArray[np.bool_]
    even: NDArray[np.bool_]
    odd: NDArray[np.bool_]

    @classmethod
    def of(cls, run: Measurement) -> "_Lines | None":
        """Lines of a run; None for one that does not repeat, or not often enough."""
        given, period_s = run.command if run.command is not None else run.current, run.period_s
        if run.acceleration is None or given is None or period_s is None:
            return None
        size = round(period_s / given.dt_s)
        acts = np.flatnonzero(np.abs(given.values) > EXCITED * np.abs(given.values).max(initial=0.0))
        first = int(acts[0]) + size if acts.size else given.values.size
        periods = (int(acts[-1]) + 1 - first) // size if acts.size else 0
        if periods < LEAST_PERIODS:
            return None
        put = np.abs(np.fft.rfft(given.values[first : first + size * periods].reshape(periods, size), axis=1))
        excited = put.mean(axis=0) > EXCITED * put.max()
        lowest, highest = np.flatnonzero(excited)[[0, -1]]
        k = np.arange(excited.size)
        silent = (k >= max(lowest, 1)) & (k <= highest) & ~excited
        return cls(first, size, periods, excited, silent & (k % 2 == 0), silent & (k % 2 == 1))

    def mean(self, values: FloatArray) -> tuple[ComplexArray, FloatArray]:
        """(m,) spectrum of the mean period, and the variance of the noise in it, by the scatter of the periods."""
        whole = values[self.first : self.first + self.size * self.periods].reshape(self.periods, self.size)
        spectra = np.fft.rfft(whole, axis=1)
        return spectra.mean(axis=0), spectra.var(axis=0, ddof=1) / self.periods


def distortion(run: Measurement) -> Distortion | None:
    """Even and odd distortion by the detection lines of a periodic record; None of one that has none.

    A linear device answers at excited lines alone; what scatters between the periods is noise (Pintelon & Schoukens
    2012, Ch. 4).
    """
    lines = _Lines.of(run)
    if lines is None:
        return None

    def levels(values: FloatArray) -> tuple[float, float]:
        """At even and at odd detection lines."""
        mean, noise = lines.mean(values)
        beyond, found = np.abs(mean) ** 2 - noise, []
        scale = max(float(beyond[lines.excited].mean()), np.finfo(float).tiny)
        for some in (lines.even, lines.odd):
            power = float(beyond[some].mean()) if some.any() else 0.0
            certain = power > CERTAIN * float(noise[some].mean()) / np.sqrt(some.sum()) if some.any() else False
            found.append(float(np.sqrt(power / scale)) if certain else 0.0)
        return found[0], found[1]

    own = levels(run.current.values) if run.current is not None and run.command is not None else (0.0, 0.0)
    return Distortion(*levels(run.require("acceleration", "").values), *own)


def named_by_lines(fit: ChainFit, repeated: Sequence[Measurement]) -> list[tuple[str, float]]:
    """The cause of a distortion, and which part of it at the detection lines it explains; none where all is quiet.

    No error of a linear model reaches these lines, so friction and stiffening are told by their shapes alone. Play
    that opens and closes has no shape of a small disturbance: it is named where the distortion is strong and neither
    of the two is in it.
    """
    wanted: list[ComplexArray] = []
    shapes: dict[str, list[ComplexArray]] = {"friction": [], "stiffening": []}
    energy = noise = strongest = 0.0
    for run in repeated:
        lines, found = _Lines.of(run), distortion(run)
        if lines is None or found is None or run.grip_N is None or not within(run.grip_N, fit.grips_N):
            continue
        if max(found.current_even, found.current_odd) > OF_THE_CURRENT * found.largest:
            continue  # the amplifier's, which is said elsewhere
        silent = lines.even | lines.odd
        mean, variance = lines.mean(run.require("acceleration", "").values)
        wanted.append(mean[silent])
        energy, noise = energy + float(np.sum(np.abs(mean[silent]) ** 2)), noise + float(np.sum(variance[silent]))
        strongest = max(strongest, found.odd)
        for name, parts in shapes.items():
            parts.append(lines.mean(_shape(name, fit.device, fit.instrument, run))[0][silent])
    beyond = energy - noise
    if not wanted or beyond <= 0:
        return []
    share = {}
    for name, parts in shapes.items():
        shape = np.concatenate(parts)
        explained = _explained(shape, np.concatenate(wanted))
        chance = noise / (2 * shape.size)  # what noise has along one real direction
        share[name] = explained / beyond if explained > LOUD**2 * chance else 0.0
    best, other = sorted(share, key=lambda name: -share[name])
    if share[best] > SHOWS and share[best] > CLEARLY * share[other]:
        return [(best, min(share[best], 1.0))]
    return [("backlash", 1 - share[best])] if strongest > PLAYS and share[best] < SHOWS else []


def _explained(shape: FloatArray | ComplexArray, wanted: FloatArray | ComplexArray) -> float:
    """The energy of `wanted` (n,) that a shape (n,) explains; with the other sign it is no such effect."""
    along = max(float(np.vdot(shape, wanted).real), 0.0)
    return along**2 / max(float(np.vdot(shape, shape).real), np.finfo(float).tiny)


def named(fit: ChainFit, found: Sequence[Missed]) -> list[tuple[str, float]]:
    """The candidate that explains most of what the records missed, and which part of it; none where none does.

    An effect bends the linear fit to the sweeps as well: so the chain's parameters may move too, by the same for all
    records, and a candidate has to explain what is left of the residuals then.

    Parameters
    ----------
    found : records with a significant excess.
    """
    if not found:
        return []
    wanted = np.concatenate([one.residual for one in found])
    linear = np.concatenate([_slopes(fit, one.run) for one in found])
    scale = np.maximum(np.linalg.norm(linear, axis=0), np.finfo(float).tiny)
    Q, _ = np.linalg.qr(linear / scale)
    left = wanted - Q @ (Q.T @ wanted)
    noise = sum(float(np.sum(one.residual**2)) - max(one.excess, 0.0) * one.energy for one in found)
    fitted: dict[str, float] = {}
    for name in ("friction", "backlash", "stiffening"):
        shape = np.concatenate([_shape(name, fit.device, fit.instrument, one.run) for one in found])
        shape -= Q @ (Q.T @ shape)
        fitted[name] = _explained(shape, left) / max(float(left @ left) - noise, np.finfo(float).tiny)
    best = max(fitted, key=lambda name: fitted[name])
    return [(best, min(fitted[best], 1.0))] if fitted[best] > EXPLAINS else []


def _slopes(fit: ChainFit, run: Measurement) -> FloatArray:
    """(n, p) what the chain's unknowns change of a predicted acceleration after the high-pass [m/s^2]."""
    assert run.grip_N is not None
    current = _commanded(run, fit.instrument)
    grip_N = run.grip_N
    moved = through(
        _from_rest(current.values), current.dt_s, lambda f: response_slopes(fit, grip_N, f), zero_Hz=LOWEST_HZ
    )
    return np.stack([_passed(current.start_s, current.dt_s, one) for one in moved], axis=1)


def _shape(name: str, device: DriveChain, instrument: Instrument, run: Measurement) -> FloatArray:
    """(n,) acceleration after the high-pass that a candidate of some size adds [m/s^2]."""
    assert run.grip_N is not None
    plant = device.plant(run.grip_N)
    current = _commanded(run, instrument)
    values = _from_rest(current.values)
    n = plant.order // 2
    masses = np.concatenate([device.shared[:2], device.hand_at(run.grip_N)[:1]])[:n]
    velocities, stretches = np.eye(plant.order)[n : n + n], np.eye(plant.order)[:n]
    if name == "friction":
        motion = _through(plant, plant.B[:, 0], velocities[0], 0.0, current.dt_s, values)
        forces = {0: -np.tanh(motion / (SLOW * np.abs(motion).max(initial=1e-12)))}
    elif name == "backlash":
        stretch = _through(plant, plant.B[:, 0], stretches[0], 0.0, current.dt_s, values)
        part = np.tanh(stretch / (PLAY * np.abs(stretch).max(initial=1e-12)))
        forces = {0: part, 1: -part}
    else:
        if n < 3:
            return np.zeros(values.size)
        stretch = _through(plant, plant.B[:, 0], stretches[1], 0.0, current.dt_s, values)
        part = (stretch / np.abs(stretch).max(initial=1e-12)) ** 3
        forces = {1: -part, 2: part}
    total = np.zeros(values.size)
    for mass, force in forces.items():
        given = np.zeros(plant.order)
        given[n + mass] = 1 / masses[mass]
        total += _through(plant, given, plant.C[0], 1 / masses[1] if mass == 1 else 0.0, current.dt_s, force)
    return _passed(current.start_s, current.dt_s, total)


def _through(
    plant: StateSpace, given: FloatArray, row: FloatArray, direct: float, dt_s: float, values: FloatArray
) -> FloatArray:
    """(n,) what an input along `given` makes of an output `row`, from rest."""
    poles, modes = np.linalg.eig(plant.A)
    gains = (row @ modes) * np.linalg.solve(modes, given.astype(complex))

    def ratio(frequencies_Hz: FloatArray) -> ComplexArray:
        return np.asarray((gains / (2j * np.pi * frequencies_Hz[:, None] - poles)).sum(axis=1) + direct)

    return through(values, dt_s, ratio, zero_Hz=LOWEST_HZ)


def current_missed(instrument: Instrument, run: Measurement) -> tuple[float, float]:
    """What an amplifier does that is no pole and delay; zeros where command and current were not both read.

    Returns
    -------
    Part of the largest current that is missing, as the cube of the command shows it; and half the width of the
    commands that the amplifier does not follow [A].
    """
    if run.current is None or run.command is None or instrument.amplifier is None:
        return 0.0, 0.0
    expected = _commanded(run, instrument).values
    measured = _from_rest(run.current.values)
    peak = max(float(np.abs(expected).max()), 1e-12)
    shapes = [expected, expected**3 / peak**2]
    wanted, dead_A, cube = np.inf, 0.0, 0.0
    for half_A in (0.0, *np.geomspace(CROSSOVER, 0.1 * peak, CROSSOVERS)):
        lost = replace(run.command, values=np.clip(run.command.values, -half_A, half_A))
        course = measured + instrument.amplifier_gain * _commanded(replace(run, command=lost), instrument).values
        found, left, *_ = np.linalg.lstsq(np.stack(shapes, axis=1), course, rcond=None)
        # A dead band is believed where it takes more off the residual than chance does.
        worth = 1 - (SIGNIFICANT / expected.size if half_A and not dead_A else 0.0)
        if left.size and left[0] < worth * wanted:
            wanted, dead_A, cube = float(left[0]), float(half_A), float(found[1])
    return max(-cube, 0.0), dead_A
