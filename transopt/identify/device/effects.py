"""Nonlinear effects of a device at the amplitude of use, which no frequency response shows, identified by name.

Each candidate is a nonlinear force inside the drive chain, computed from the motion that the linear chain predicts:
friction against the motor's velocity, play that takes back a part of the transmitted force, a skin whose spring force
has a cubic term; and an amplifier whose current falls short of the command by a cubic term. The chain turns the force
into an acceleration, the candidate's shape; the candidate that explains most of the residual is named. This is a
first-order perturbation: small effects add to the linear response.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from transopt.base.filters import highpass
from transopt.base.signals import BoolArray, ComplexArray, FloatArray, Signal
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

HIGHPASS_HZ = 25.0  # slower motion of a held device is mostly tremor, and little of a tap
QUIET = 0.02  # share of the predicted peak below which a record counts as noise only
LEAST_QUIET_S = 0.02
OFFSET = 0.1  # least share of an offset's filtered energy at rest, for the offset to be estimated there
LOWEST_HZ = 0.1  # replaces 0 Hz, where the response of a free chain is infinite
ALIGNED_HZ = 500.0  # command and current are aligned in time below this frequency
CERTAIN = 4.0  # standard deviations of the noise at which an excess is significant
EXPLAINS = 0.25  # share of the residual that a candidate must explain to be named
LEAST_PERIODS, EXCITED = 2, 1e-6  # periods after the transient; share of the largest line of an excited line
LOUD = 5.0  # standard deviations of the noise at which a candidate is significant at the detection lines
SHOWS, CLEARLY = 0.15, 3.0  # share of the distortion that a candidate must explain, and over that of another
PLAYS = 0.02  # distortion, as a share of the response, above which play is suspected
OF_THE_CURRENT = 0.5  # share of the acceleration's distortion in the current above which the amplifier is the cause
SLOW, PLAY = 0.02, 0.1  # of the largest speed and elongation: range over which friction and play change sign
SHORTFALL = 0.01  # share of the largest current missing above which the amplifier is named
SIGNIFICANT = 50.0  # reduction of a current's residual, in variances of the noise, that makes a dead band significant
CROSSOVER, CROSSOVERS = 2e-3, 40  # least dead band [A] and number of dead bands tried, up to a tenth of the peak


@dataclass(frozen=True)
class Missed:
    """One record at the amplitude of use against its prediction.

    Attributes
    ----------
    run : the record.
    current : input of the prediction, from rest.
    residual : (n,) recorded less predicted acceleration after the high-pass [m/s^2].
    energy : energy of the recorded acceleration outside the rests.
    excess : energy of the residual there less that of the noise, over `energy`.
    deviation : standard deviation of `excess` due to noise; infinite if the record never rests and so shows no noise.
    """

    run: Measurement
    current: Signal
    residual: FloatArray
    energy: float
    excess: float
    deviation: float


def missed(model: Model, grip_N: float, instrument: Instrument, run: Measurement) -> Missed:
    """Residual of a prediction from the command beyond the noise; from the current if no command was recorded.

    It predicts like a design does: with the amplifier's pole and delay and a gain of one. The noise is estimated from
    the record where the prediction is at rest.
    """
    recorded = run.require("acceleration")
    current = _driving(run, instrument)
    parts = predict(model, grip_N, instrument, current.values), recorded.values, np.ones(recorded.values.size)
    predicted, measured, step = (_passed(replace(recorded, values=values)) for values in parts)
    residual = measured - predicted
    size = np.abs(predicted)
    least = QUIET * size.max(initial=0.0)
    # Quiet: before the prediction begins, or after it has decayed for good.
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
    return Missed(run, current, residual, energy, excess / scale, uncertain / scale)


def _driving(run: Measurement, instrument: Instrument) -> Signal:
    """The current that a design expects from the command (`_commanded`), from rest."""
    current = _commanded(run, instrument)
    return replace(current, values=_from_rest(current.values))


def _commanded(run: Measurement, instrument: Instrument) -> Signal:
    """The current that a design expects from the command, aligned in time with the measured one.

    The command may be read late by a separate card; such a shift is not an error of the model.
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
    """(n,) values less their initial level."""
    return values - np.median(values[: max(3, values.size // 50)])


def _passed(x: Signal) -> FloatArray:
    """(n,) values after the high-pass, which keeps what a tap is made of."""
    return highpass(x, HIGHPASS_HZ).values


def _alike(noise: FloatArray) -> float:
    """Variance of this noise's energy over that of white noise: the sum of its squared autocorrelations
    (Bartlett 1946)."""
    size = fft.next_fast_len(2 * noise.size, real=True)
    power = np.abs(fft.rfft(noise - noise.mean(), size)) ** 2
    along = fft.irfft(power, size)[: noise.size // 2]
    return float(1 + 2 * np.sum((along[1:] / max(along[0], np.finfo(float).tiny)) ** 2))


def at_use(found: Sequence[Missed], error: ModelError) -> list[AtUse]:
    """Relative excess of each record beyond noise and beyond the expected error of the linear response."""
    stated = []
    for one in found:
        assert one.run.grip_N is not None
        linear = error.nrmse(one.run.grip_N, one.current.values, one.current.dt_s, one.energy) ** 2
        beyond = one.excess - linear
        significant = beyond > CERTAIN * one.deviation
        stated.append(
            AtUse(
                grip_N=one.run.grip_N,
                peak_A=max(float(np.abs(one.current.values).max()), 1e-9),
                excess=float(np.sqrt(beyond)) if significant else 0.0,
            )
        )
    return stated


@dataclass(frozen=True)
class Distortion:
    """Distortion under a periodic excitation: rms per line at lines not excited, over that at excited lines.

    The noise is subtracted; a value is 0 if it is not significant.

    Attributes
    ----------
    even, odd : distortion of the acceleration at even and at odd detection lines.
    current_even, current_odd : that of the measured current at the same lines; 0 if it was not measured.
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
        """A sentence for the user: the distortion, its likely kind, and a remedy."""
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
    """Excited and detection lines of a periodic record; its first period, the transient, is left out.

    Attributes
    ----------
    first, size, periods : sample at which the second period begins, samples per period, number of whole periods.
    excited, even, odd : (size // 2 + 1,) masks of the excited lines, and of the even and odd ones without excitation
        between them.
    """

    first: int
    size: int
    periods: int
    excited: BoolArray
    even: BoolArray
    odd: BoolArray

    @classmethod
    def of(cls, run: Measurement) -> "_Lines | None":
        """Lines of a run; None if it is not periodic or has too few periods."""
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
        """(m,) spectrum of the mean period, and its noise variance (m,) from the scatter of the periods."""
        whole = values[self.first : self.first + self.size * self.periods].reshape(self.periods, self.size)
        spectra = np.fft.rfft(whole, axis=1)
        return spectra.mean(axis=0), spectra.var(axis=0, ddof=1) / self.periods


def distortion(run: Measurement) -> Distortion | None:
    """Even and odd distortion at the detection lines of a periodic record; None if the record is not periodic.

    A linear device responds at excited lines only; scatter between the periods is noise (Pintelon & Schoukens 2012,
    Ch. 4).
    """
    lines = _Lines.of(run)
    if lines is None:
        return None

    def levels(values: FloatArray) -> tuple[float, float]:
        """Relative rms at even and at odd detection lines; 0 where it is not significant."""
        mean, noise = lines.mean(values)
        beyond, found = np.abs(mean) ** 2 - noise, []
        scale = max(float(beyond[lines.excited].mean()), np.finfo(float).tiny)
        for some in (lines.even, lines.odd):
            power = float(beyond[some].mean()) if some.any() else 0.0
            certain = power > CERTAIN * float(noise[some].mean()) / np.sqrt(some.sum()) if some.any() else False
            found.append(float(np.sqrt(power / scale)) if certain else 0.0)
        return found[0], found[1]

    own = levels(run.current.values) if run.current is not None and run.command is not None else (0.0, 0.0)
    return Distortion(*levels(run.require("acceleration").values), *own)


def named_by_lines(fit: ChainFit, repeated: Sequence[Measurement]) -> list[tuple[str, float]]:
    """The cause of a distortion, and the share of the detection lines that it explains; empty if there is none.

    No error of a linear model affects these lines, so friction and stiffening are recognised by their shapes alone.
    Play that opens and closes is not a small perturbation and has no such shape: it is named if the distortion is
    strong and neither of the other two explains it.
    """
    wanted: list[ComplexArray] = []
    shapes: dict[str, list[ComplexArray]] = {"friction": [], "stiffening": []}
    energy = noise = strongest = 0.0
    for run in repeated:
        lines, found = _Lines.of(run), distortion(run)
        if lines is None or found is None or run.grip_N is None or not within(run.grip_N, fit.grips_N):
            continue
        if max(found.current_even, found.current_odd) > OF_THE_CURRENT * found.largest:
            continue  # the amplifier causes it, which `Distortion.words` tells
        silent = lines.even | lines.odd
        mean, variance = lines.mean(run.require("acceleration").values)
        wanted.append(mean[silent])
        energy, noise = energy + float(np.sum(np.abs(mean[silent]) ** 2)), noise + float(np.sum(variance[silent]))
        strongest = max(strongest, found.odd)
        driving = _driving(run, fit.instrument)
        for name, parts in shapes.items():
            parts.append(lines.mean(_shape(name, fit.device, run.grip_N, driving))[0][silent])
    beyond = energy - noise
    if not wanted or beyond <= 0:
        return []
    share = {}
    for name, parts in shapes.items():
        shape = np.concatenate(parts)
        explained = _explained(shape, np.concatenate(wanted))
        chance = noise / (2 * shape.size)  # energy of the noise along one real direction
        share[name] = explained / beyond if explained > LOUD**2 * chance else 0.0
    best, other = sorted(share, key=lambda name: -share[name])
    if share[best] > SHOWS and share[best] > CLEARLY * share[other]:
        return [(best, min(share[best], 1.0))]
    return [("backlash", 1 - share[best])] if strongest > PLAYS and share[best] < SHOWS else []


def _explained(shape: FloatArray | ComplexArray, wanted: FloatArray | ComplexArray) -> float:
    """Energy of `wanted` (n,) that a shape (n,) explains; 0 for a negative coefficient, which no such effect has."""
    along = max(float(np.vdot(shape, wanted).real), 0.0)
    return along**2 / max(float(np.vdot(shape, shape).real), np.finfo(float).tiny)


def named(fit: ChainFit, found: Sequence[Missed]) -> list[tuple[str, float]]:
    """The candidate that explains most of the records' residuals, and the share that it explains; empty if none does.

    An effect also biases the linear fit to the sweeps. So the chain's parameters may change, by the same amounts for
    all records, and a candidate must explain what then remains of the residuals.

    Parameters
    ----------
    found : records with a significant excess.
    """
    if not found:
        return []
    wanted = np.concatenate([one.residual for one in found])
    linear = np.concatenate([_slopes(fit, one.run.grip_N or 0.0, one.current) for one in found])
    scale = np.maximum(np.linalg.norm(linear, axis=0), np.finfo(float).tiny)
    Q, _ = np.linalg.qr(linear / scale)
    left = wanted - Q @ (Q.T @ wanted)
    noise = sum(float(np.sum(one.residual**2)) - max(one.excess, 0.0) * one.energy for one in found)
    fitted: dict[str, float] = {}
    for name in ("friction", "backlash", "stiffening"):
        shape = np.concatenate([_shape(name, fit.device, one.run.grip_N or 0.0, one.current) for one in found])
        shape -= Q @ (Q.T @ shape)
        fitted[name] = _explained(shape, left) / max(float(left @ left) - noise, np.finfo(float).tiny)
    best = max(fitted, key=lambda name: fitted[name])
    return [(best, min(fitted[best], 1.0))] if fitted[best] > EXPLAINS else []


def _slopes(fit: ChainFit, grip_N: float, current: Signal) -> FloatArray:
    """(n, p) derivatives of a predicted acceleration after the high-pass by the chain's p unknowns [m/s^2]."""
    moved = through(current.values, current.dt_s, lambda f: response_slopes(fit, grip_N, f), zero_Hz=LOWEST_HZ)
    return np.stack([_passed(replace(current, values=one)) for one in moved], axis=1)


def _shape(name: str, device: DriveChain, grip_N: float, current: Signal) -> FloatArray:
    """(n,) acceleration after the high-pass that a candidate adds, up to a factor [m/s^2]."""
    plant = device.plant(grip_N)
    n = plant.order // 2
    masses = np.concatenate([device.shared[:2], device.hand_at(grip_N)[:1]])[:n]

    def moved(row: FloatArray) -> FloatArray:
        """(n,) course of an elongation or velocity under the current."""
        return _through(plant, plant.B[:, 0], row, 0.0, current)

    stretches = np.eye(plant.order)[:n]
    if name == "friction":
        motion = moved(plant.Cv[0])
        forces = {0: -np.tanh(motion / (SLOW * np.abs(motion).max(initial=1e-12)))}
    elif name == "backlash":
        stretch = moved(stretches[0])
        part = np.tanh(stretch / (PLAY * np.abs(stretch).max(initial=1e-12)))
        forces = {0: part, 1: -part}
    else:
        if n < 3:
            return np.zeros(current.values.size)
        stretch = moved(stretches[1])
        part = (stretch / np.abs(stretch).max(initial=1e-12)) ** 3
        forces = {1: -part, 2: part}
    total = np.zeros(current.values.size)
    for mass, force in forces.items():
        given = np.zeros(plant.order)  # the rates of the links that the mass joins
        given[n + mass] = 1 / masses[mass]
        if mass:
            given[n + mass - 1] = -1 / masses[mass]
        pushed = replace(current, values=force)
        total += _through(plant, given, plant.C[0], 1 / masses[1] if mass == 1 else 0.0, pushed)
    return _passed(replace(current, values=total))


def _through(plant: StateSpace, given: FloatArray, row: FloatArray, direct: float, x: Signal) -> FloatArray:
    """(n,) response from rest of output `row`, with feedthrough `direct`, to an input that enters along `given`."""
    poles, modes = np.linalg.eig(plant.A)
    gains = (row @ modes) * np.linalg.solve(modes, given.astype(complex))

    def ratio(frequencies_Hz: FloatArray) -> ComplexArray:
        return np.asarray((gains / (2j * np.pi * frequencies_Hz[:, None] - poles)).sum(axis=1) + direct)

    return through(x.values, x.dt_s, ratio, zero_Hz=LOWEST_HZ)


def current_missed(instrument: Instrument, run: Measurement) -> tuple[float, float]:
    """Saturation and dead band of an amplifier beyond pole and delay; zeros unless command and current were read.

    Returns
    -------
    Missing share of the largest current, from a fit with a cubic term, and half width of the dead band [A].
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
        # A dead band is accepted only if it reduces the residual by more than chance does.
        worth = 1 - (SIGNIFICANT / expected.size if half_A and not dead_A else 0.0)
        if left.size and left[0] < worth * wanted:
            wanted, dead_A, cube = float(left[0]), float(half_A), float(found[1])
    return max(-cube, 0.0), dead_A
