"""One tap on a real surface: find its contact, check its recording, and fit a mass on a spring and a damper to it.

Seed Eqs. 1-2: F_surface = m y'' + b y' + k y, where y is the stylus' deviation from the intended motion, which goes
straight on at the incoming speed. Before contact y = 0, so y' and y are integrals of the acceleration from contact
on, and neither the incoming speed nor an encoder is needed. A hand cannot react to a tap within 30 ms; the fit ends
there.

Sources of bias, and their remedies:

- a delay between force and acceleration. The accelerometer's pole at 2.5 kHz alone, 64 us, lowers the damping by 4 %
  and raises the stiffness by 13 %; so the force is filtered by the same pole.
- noise in the regressors (errors in variables). It lowers m by its share of the power of a. Both sides are filtered
  by the same causal 500 Hz low-pass, which keeps any linear relation between them, and the share falls to 1e-4.
- a static offset, which integrates to a drift. It is estimated from the record before contact and subtracted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import integrate, optimize, signal, stats

from transopt.base.errors import InputError
from transopt.base.signals import REACTION_S, FloatArray, stops
from transopt.identify.checks import UNITS, check_unit
from transopt.identify.findings import JITTER_LIMIT
from transopt.identify.measurement import Measurement
from transopt.recordings.approach import separated, unsteady

LOWPASS_HZ = 500.0
_BASELINE_S = 5e-3  # least record before contact
_GUARD_S = 0.5e-3  # before the force is seen to rise
_RISE = 0.02  # share of its peak at which the force counts as risen
_NOISE = 6.0  # standard deviations of the noise at which the force counts as risen
_STANDS_OUT = 10.0  # least peak over the noise of a sample: no noise is as high
_LEAST_HEARD_HZ, _HEARD_BANDS = 50.0, 20  # lowest and number of the bands, a third of an octave apart or closer
_HEARD = 100.0  # least power over that of the noise in a band
_FEWEST = 4  # least samples that an offset is estimated from
_IN_PULSE = 0.1  # share of the peak: a record that begins higher begins within the pulse
_CALIBRATION = 0.2  # largest relative difference of displacements by encoder and by accelerometer
MOST_LEFT_OUT = 0.2  # largest share of trials left out


@dataclass(frozen=True)
class HandTap:
    """The samples of a trial that are fitted, from shortly before contact to `REACTION_S` after it.

    Attributes
    ----------
    name : name of the trial, for messages.
    grip_N : as stated.
    speed_m_s : incoming speed as stated; None if the file has none.
    dt_s : sampling period.
    force_N, acceleration_m_s2 : (n,) without offsets, equally delayed and low-passed.
    noise_N : rms of the recorded force before contact; NaN if nothing was recorded before it.
    note : a warning about how the tap was cut; empty if there is none.
    """

    name: str
    grip_N: float
    speed_m_s: float | None
    dt_s: float
    force_N: FloatArray
    acceleration_m_s2: FloatArray
    noise_N: float = np.nan
    note: str = ""

    @property
    def velocity_m_s(self) -> FloatArray:
        """(n,) velocity of the deviation y, from rest."""
        return integrate.cumulative_trapezoid(self.acceleration_m_s2, dx=self.dt_s, initial=0)

    @property
    def displacement_m(self) -> FloatArray:
        """(n,) deviation y, from zero."""
        return integrate.cumulative_trapezoid(self.velocity_m_s, dx=self.dt_s, initial=0)


@dataclass(frozen=True)
class TapFit:
    """Mass, damper and spring of one tap; `unexplained` is |F - fit| / |F|."""

    mass_kg: float
    damping_N_s_m: float
    stiffness_N_m: float
    unexplained: float


def fit_tap(tap: HandTap) -> TapFit:
    """Least squares of F = m y'' + b y' + k y over the tap, none of the three negative (passive)."""
    regressors = np.stack([tap.acceleration_m_s2, tap.velocity_m_s, tap.displacement_m], axis=1)
    scale = np.linalg.norm(regressors, axis=0)
    found, left = optimize.nnls(regressors / scale, tap.force_N)
    m, b, k = (found / scale).tolist()
    return TapFit(m, b, k, float(left / np.linalg.norm(tap.force_N)))


def cut_tap(
    name: str,
    force_N: FloatArray,
    acceleration_m_s2: FloatArray,
    dt_s: float,
    *,
    grip_N: float,
    speed_m_s: float | None = None,
    accelerometer_Hz: float | None = None,
    window_s: float = REACTION_S,
) -> HandTap:
    """Find the contact, subtract the offsets, delay the force like the acceleration, low-pass both, and cut.

    Parameters
    ----------
    name, grip_N, speed_m_s : see `HandTap`.
    force_N, acceleration_m_s2 : (n,) as recorded, on one time grid.
    dt_s : sampling period.
    accelerometer_Hz : pole of the accelerometer, None for one to be taken as ideal.
    window_s : time from contact to the end of the fitted samples.

    Raises
    ------
    InputError : no contact, or a record that ends too early; the message lacks the trial's name.
    """
    contact, begin = _contact(force_N, dt_s)
    count = round(window_s / dt_s) + contact - begin
    rest, note = slice(0, begin), ""
    if begin < _BASELINE_S / dt_s:
        offsets = f"from the {begin} samples before it" if begin >= _FEWEST else "taken as 0"
        rest = rest if begin >= _FEWEST else slice(0, 0)
        early = f"contact at the start, {1e3 * contact * dt_s:.3g} ms into the record"
        note = f"{early} (a trigger without pre-roll): offsets {offsets}"
    if begin + count > force_N.size:
        after = f"the record ends {1e3 * (force_N.size - contact) * dt_s:.3g} ms after contact"
        raise InputError(f"{after}: {1e3 * window_s:g} ms are needed; record longer")
    noise_N = float(force_N[rest].std()) if rest.stop else np.nan
    force, acceleration = (x - (x[rest].mean() if x[rest].size else 0.0) for x in (force_N, acceleration_m_s2))
    if accelerometer_Hz is not None:
        force = _one_pole(force, 2 * np.pi * accelerometer_Hz * dt_s)
    if 0.45 / dt_s > LOWPASS_HZ:
        sos = signal.butter(2, LOWPASS_HZ, fs=1 / dt_s, output="sos")
        force, acceleration = signal.sosfilt(sos, np.stack([force, acceleration]), axis=1)
    kept = slice(begin, begin + count)
    return HandTap(
        name, grip_N, speed_m_s, dt_s, np.asarray(force[kept]), np.asarray(acceleration[kept]), noise_N, note
    )


def heard_Hz(taps: Sequence[HandTap]) -> float:
    """Frequency up to which the force of all taps together stands out of its noise, at most `LOWPASS_HZ`.

    Above it a model of the response to the force would fit noise and overestimate the stylus' mass. Each tap is faded
    out over its second half: a soft object's force does not end at zero, and a cut would add high frequencies.
    """
    known = [tap for tap in taps if tap.noise_N > 0]
    if not known:
        return LOWPASS_HZ
    bands = np.geomspace(_LEAST_HEARD_HZ, LOWPASS_HZ, _HEARD_BANDS)
    power, noise = np.zeros(bands.size), 0.0
    for tap in known:
        faded = tap.force_N * signal.windows.tukey(2 * tap.force_N.size, 0.5)[tap.force_N.size :]
        lines = np.exp(-2j * np.pi * np.outer(bands, tap.dt_s * np.arange(faded.size)))
        power += np.abs(lines @ faded) ** 2
        noise += tap.noise_N**2 * faded.size
    # A pulse has zeros in its spectrum; averaging over neighbouring bands bridges them.
    heard = np.convolve(np.pad(power, 1, mode="edge"), np.full(3, 1 / 3), mode="valid") > _HEARD * noise
    return float(bands[max(int(np.argmin([*heard, False])) - 1, 0)])


def _one_pole(x: FloatArray, rate: float) -> FloatArray:
    """Exact response of a pole of `rate` (angular frequency times sampling period) to a piecewise linear input."""
    q = np.exp(-rate)
    after = 1 - (1 - q) / rate
    return np.asarray(signal.lfilter([after, 1 - q - after], [1.0, -q], x))


def onset(force_N: FloatArray, dt_s: float) -> int:
    """Sample at which the surface force rises out of the noise; the first sample if the record begins in the pulse.

    A trigger without pre-roll, as of an instrumented hammer, leaves no rest before contact to estimate offset and
    noise from. The noise is then estimated from differences between samples, and the offset from the first samples,
    or taken as 0 if these lie in the pulse.

    Raises
    ------
    InputError : the force never rises out of the noise.
    """
    quiet = force_N[: max(int(_BASELINE_S / dt_s), _FEWEST)]
    noise = float(stats.median_abs_deviation(np.diff(force_N), scale="normal")) / np.sqrt(2)
    highest = float(np.abs(force_N - np.median(force_N)).max())
    if highest <= _STANDS_OUT * noise:
        found = f"highest {highest:.3g} N off its middle, noise {noise:.3g} N rms"
        raise InputError(
            f"no contact: {found}, must be {_STANDS_OUT:g} times as high; tap harder, or check the sensor"
        )
    rest = float(np.median(quiet))
    if np.ptp(quiet) > max(_STANDS_OUT * noise, _RISE * highest):  # the pulse is in it
        rest = float(np.median(force_N[:_FEWEST]))
        rest = rest if abs(rest) < _IN_PULSE * float(np.abs(force_N).max()) else 0.0
    else:
        noise = max(noise, float(quiet.std()))
    away = np.abs(force_N - rest)
    return int(np.argmax(away > max(_NOISE * noise, _RISE * float(away.max()))))


def _contact(force_N: FloatArray, dt_s: float) -> tuple[int, int]:
    """Sample at which the contact is detected, and the one surely before it from which a tap is cut."""
    contact = onset(force_N, dt_s)
    return contact, max(contact - int(np.ceil(_GUARD_S / dt_s)) - _unseen(force_N, contact), 0)


def _unseen(force_N: FloatArray, contact: int) -> int:
    """Samples from the true contact to the detected one: noise hides the beginning of a soft object's slow rise."""
    away = np.abs(force_N - np.median(force_N[: max(contact, 1)]))
    peak = contact + int(np.argmax(away[contact:]))
    return int(np.ceil(float(away[contact] / away[peak]) * (peak - contact)))


def tap_of(trial: Measurement, window_s: float = REACTION_S) -> HandTap:
    """The tap of a recorded trial.

    Raises
    ------
    InputError : the trial lacks a column or its grip, or cannot be used; the message names the trial and a remedy.
    """
    force = trial.require("force")
    acceleration = trial.require("acceleration")
    if trial.grip_N is None:
        raise InputError(f"{trial.name}: no grip: state it in the file (grip_N); the fits run over grip")
    if not trial.grip_N > 0:
        raise InputError(f"{trial.name}: grip_N = 0: nobody holds the stylus; leave the trial out")
    try:
        _check_recording(trial)
        tap = cut_tap(
            trial.name,
            force.values,
            acceleration.values,
            force.dt_s,
            grip_N=trial.grip_N,
            speed_m_s=trial.speed_m_s,
            accelerometer_Hz=trial.accelerometer_Hz,
            window_s=window_s,
        )
        _check_signs_and_units(trial, tap)
    except InputError as error:
        raise InputError(f"{trial.name}: {error}") from None
    return replace(tap, note="; ".join(filter(None, [trial.missing, tap.note, _unsteady(trial, tap)])))


def usable_taps(trials: Sequence[Measurement], window_s: float = REACTION_S) -> tuple[list[HandTap], list[str]]:
    """The taps of a session, and for each trial left out the reason.

    Raises
    ------
    InputError : more than a fifth of the trials cannot be used; the message tells the first reason and their number.
    """
    taps, complaints = [], []
    for trial in trials:
        try:
            taps.append(tap_of(trial, window_s))
        except InputError as error:
            complaints.append(str(error))
    if len(complaints) > MOST_LEFT_OUT * len(trials):
        more = f" (and {len(complaints) - 1} more of {len(trials)} trials)" if len(complaints) > 1 else ""
        raise InputError(f"{complaints[0]}{more}")
    return taps, complaints


def _unsteady(trial: Measurement, tap: HandTap) -> str:
    """Warning that the hand did not come in steadily: the fit takes its own motion for that of mass and springs."""
    acceleration = trial.require("acceleration")
    contact = onset(trial.require("force").values, acceleration.dt_s)
    if contact < _BASELINE_S / acceleration.dt_s:
        return ""
    x = acceleration.with_values(acceleration.values - acceleration.values[:contact].mean())
    onset_s, size_m_s2 = x.start_s + x.dt_s * contact, float(np.sqrt(np.mean(tap.acceleration_m_s2**2)))
    return unsteady(separated(x, trial.position, onset_s), onset_s, size_m_s2)


def _check_recording(trial: Measurement) -> None:
    """Refuse a trial with jittered time stamps or a sensor at its end stop."""
    if trial.off_grid > JITTER_LIMIT:
        found = f"time stamps lie {trial.off_grid:.2g} steps (rms) off a uniform grid"
        raise InputError(f"{found}: at most {JITTER_LIMIT:g}; sample by a timer and record again")
    for quantity in ("force", "acceleration"):
        values = trial.require(quantity).values
        for stuck in stops(values):
            at = f"{quantity} stays at {values[stuck[0]]:.4g} {UNITS[quantity]} for {stuck.size} samples"
            raise InputError(f"{at}: clipped; tap more slowly or use a sensor of larger range, and record again")


def _check_signs_and_units(trial: Measurement, tap: HandTap) -> None:
    """Check the sign of force against acceleration, and sign and unit of acceleration against a recorded position."""
    ratio = None if trial.position is None or tap.note else _displacement_ratio(trial, tap)
    opposite = float(tap.force_N @ tap.acceleration_m_s2) < 0
    if ratio is not None and ratio < 0:
        wrong = "acceleration" if opposite else "position, or both force and acceleration,"
        raise InputError(f"wrong polarity: {wrong} must be positive out of the object; turn its sign")
    if opposite:
        which = "force or acceleration" if ratio is None else "force"
        raise InputError(f"wrong polarity: at impact force and acceleration differ in sign; turn that of {which}")
    if ratio is None or abs(ratio - 1) <= _CALIBRATION:
        return
    for finding in check_unit(trial.name, 1 / ratio, "the position"):
        raise InputError(finding.text)
    raise InputError(
        f"acceleration is {1 / ratio:.3g} times what the position says: must agree within {100 * _CALIBRATION:g} %; "
        "calibrate both and record again"
    )


def _displacement_ratio(trial: Measurement, tap: HandTap) -> float:
    """Deviation measured by the encoder over that measured by the accelerometer.

    What is straight in the position, or of constant acceleration, is the hand's own motion: no baseline has it.
    """
    position = trial.require("position")
    force = trial.require("force")
    _, begin = _contact(force.values, force.dt_s)
    before = min(begin, tap.force_N.size)
    seen = position.values[begin - before : begin + tap.force_N.size]
    deviation = np.concatenate([np.zeros(before), tap.displacement_m])
    own = np.vander(np.linspace(-1, 1, seen.size), 3)
    found, *_ = np.linalg.lstsq(np.column_stack([deviation / np.abs(deviation).max(), own]), seen)
    return float(found[0] / np.abs(deviation).max())
