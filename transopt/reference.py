"""From recordings to references: what the motor has to make the stylus do (DESIGN 2 and 5)."""

import glob
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import integrate, signal, stats

from transopt.discretise import TimeGrid
from transopt.errors import InputError
from transopt.importers import load_recording
from transopt.recording import Recording
from transopt.scene import Recordings
from transopt.signals import STANDARD_GRAVITY_M_S2, FloatArray, Signal, highpass, lowpass, nrmse

BASELINE_GUARD_S = 1e-3  # of the recording's own time, kept free before the onset
BASELINE_SAMPLES = 8  # fewer are no baseline
SPEED_FIT_S = 10e-3  # a quadratic over 10 ms before contact: a line would be biased by the hand's acceleration
LEAST_PEAK_TO_NOISE = 6.0  # below, nothing stands out
CLEAR_PEAK_TO_NOISE = 20.0  # below, noise alone may pass the 30 % of the peak by which the onset is found
ALIGNMENT_S = 1e-3  # repeats are shifted against each other by at most this
SETTLING_S = 20e-3  # the filters start this long before contact


def _paths(settings: Recordings) -> list[Path]:
    """Files of the scene; an entry that is no file itself is a pattern, expanded in sorted order."""
    paths: list[Path] = []
    for entry in settings.files:
        literal = Path(settings.folder) / entry
        if literal.is_file() or not any(character in entry for character in "*?["):
            paths.append(literal)
            continue
        # The folder is no pattern, whatever characters its name has; an absolute entry stands for itself.
        found = sorted(glob.glob(str(Path(glob.escape(settings.folder)) / entry)))  # noqa: PTH207
        if not found:
            source = f" (source: {settings.source})" if settings.source else ""
            raise InputError(
                f"recordings.files: {entry!r} matches no file in {settings.folder}: "
                f"put the recordings there, or name their folder with --recordings FOLDER{source}"
            )
        paths += [Path(name) for name in found]
    return paths


def read_recordings(settings: Recordings) -> list[Recording]:
    """Load the files that a scene names.

    `speed_by_file_m_s` overrides what a file states; `speed_m_s` and `grip_N` serve files that state none.

    Raises
    ------
    InputError : a pattern that matches nothing, a file name in `speed_by_file_m_s` that is not among the files, or
        whatever a file itself is refused for.
    """
    paths = _paths(settings)
    stray = set(settings.speed_by_file_m_s) - {path.name for path in paths}
    if stray:
        raise InputError(
            f"recordings.speed_by_file_m_s: {sorted(stray)[0]!r} is not among the files; correct the name"
        )
    found = []
    for path in paths:
        recording = load_recording(path, columns=settings.columns, full_scale_m_s2=settings.full_scale_m_s2)
        stated = settings.speed_m_s if recording.speed_m_s is None else recording.speed_m_s
        grip = settings.grip_N if recording.grip_N is None else recording.grip_N
        found.append(replace(recording, speed_m_s=settings.speed_by_file_m_s.get(path.name, stated), grip_N=grip))
    return found


@dataclass(frozen=True)
class Tap:
    """A recording made ready: SI, contact at t = 0, positive where the tap decelerates the stylus.

    Attributes
    ----------
    acceleration : low-passed, similarity-scaled, not yet scaled to a grid speed [m/s^2].
    speed_m_s : incoming speed after similarity scaling; NaN where the recording serves every grid speed.
    speed_source : how the speed is known.
    offset_m_s2, polarity, onset_s : found in the recording, in its own time and sign.
    peak_m_s2 : of the low-passed acceleration.
    amplitude : similarity factor that `acceleration` has been multiplied by.
    clipped_samples : samples that sit at the sensor's end stop.
    notes : what a user should know about this recording, one sentence each.
    """

    recording: Recording
    acceleration: Signal
    speed_m_s: float
    speed_source: str
    offset_m_s2: float
    polarity: int
    onset_s: float
    peak_m_s2: float
    amplitude: float
    clipped_samples: int
    notes: tuple[str, ...]


def _crossing(times_s: FloatArray, values: FloatArray, before: int, level: float) -> float:
    """Last time before sample `before` at which the values rise through `level`; the first sample if none."""
    below = np.flatnonzero(values[:before] < level)
    if below.size == 0:
        return float(times_s[0])
    j = int(below[-1])
    fraction = (level - values[j]) / (values[j + 1] - values[j])
    return float(times_s[j] + fraction * (times_s[j + 1] - times_s[j]))


def find_onset(x: Signal) -> float:
    """Contact time of a tap without offset and with positive polarity [s].

    The line through the first rise's 10 % and 30 % points (of the highest peak) is followed back to zero. A
    threshold alone would be late by a part of the rise, and a servo tick of error costs 8 % NRMSE; and the highest
    peak need not be the first.
    """
    height = float(x.values.max())
    risen = int(np.argmax(x.values >= 0.3 * height))
    low = _crossing(x.times_s, x.values, risen, 0.1 * height)
    high = _crossing(x.times_s, x.values, risen, 0.3 * height)
    return max(low - 0.5 * (high - low), x.start_s)


def _offset(x: Signal, settings: Recordings) -> tuple[float, list[str]]:
    """Static offset of the sensor, from the samples before the tap; a bump while the hand moves does not count."""
    if settings.offset_m_s2 != "baseline":
        return float(settings.offset_m_s2), []
    centred = x.values - np.median(x.values)
    upright = replace(x, values=centred * np.sign(centred[np.argmax(np.abs(centred))]))
    quiet = x.values[x.times_s < find_onset(upright) - BASELINE_GUARD_S]
    if quiet.size < BASELINE_SAMPLES:
        return 0.0, ["no baseline before the onset: offset taken as 0; state recordings.offset_m_s2 if there is one"]
    return float(stats.trim_mean(quiet, 0.2)), []


def _polarity(values: FloatArray, settings: Recordings) -> tuple[int, list[str]]:
    high, low = float(values.max()), float(-values.min())
    if settings.polarity != "auto":
        return (1 if settings.polarity == "positive" else -1), []
    notes = []
    if min(high, low) > 0.8 * max(high, low):
        notes.append("both signs peak alike: state recordings.polarity")
    return (1 if high >= low else -1), notes


def _clipped(values: FloatArray, offset: float) -> int:
    """Samples in runs of three or more that sit exactly at the largest or smallest value.

    Only an extreme at least half as far from the offset as the other is an end stop; a silent baseline is none.
    """
    count = 0
    reach = float(np.abs(values - offset).max())
    for extreme in (values.max(), values.min()):
        if abs(extreme - offset) < 0.5 * reach:
            continue
        at_stop = np.concatenate([[False], values == extreme, [False]])
        edges = np.flatnonzero(np.diff(at_stop.astype(int)))
        runs = edges[1::2] - edges[::2]
        count += int(runs[runs >= 3].sum())
    return count


def _speed(recording: Recording, onset_s: float) -> tuple[float, str]:
    """Incoming speed [m/s] and its source."""
    if recording.speed_m_s is not None:
        return recording.speed_m_s, "stated"
    if recording.position is None:
        raise InputError(
            f"{recording.name}: no incoming speed: state it in the file (`# speed_m_s: ...`), record a position_m "
            "column, or name it in recordings.speed_by_file_m_s (`transopt taps`: --speed)"
        )
    t, z = recording.position.times_s, recording.position.values
    before = (t >= onset_s - SPEED_FIT_S) & (t <= onset_s)
    if np.count_nonzero(before) < BASELINE_SAMPLES:
        raise InputError(
            f"{recording.name}: position_m has {np.count_nonzero(before)} samples in the {SPEED_FIT_S * 1e3:g} ms "
            f"before contact, {BASELINE_SAMPLES} needed to fit the speed: state `# speed_m_s: ...`"
        )
    fit = np.polynomial.Polynomial.fit(t[before], z[before], 2)
    speed = -float(fit.deriv()(onset_s))
    if not speed > 0:
        raise InputError(
            f"{recording.name}: speed fitted from position_m = {speed:g} m/s: must be > 0 (z is positive out of "
            "the object): check the sign of position_m or state `# speed_m_s: ...`"
        )
    return speed, "position"


def _noise(x: Signal) -> float:
    """Size (rms) of the white noise in a recording, from its steps: a tap is smooth, whatever part of it it fills."""
    return float(stats.median_abs_deviation(np.diff(x.values), scale="normal") / np.sqrt(2))


def _doubts(raw: Signal, speed_m_s: float, peak_m_s2: float, noise_m_s2: float) -> list[str]:
    """What makes a recording an unlikely tap; none of it refuses the file."""
    notes = []
    if peak_m_s2 < CLEAR_PEAK_TO_NOISE * noise_m_s2:
        notes.append(f"peak is only {peak_m_s2 / noise_m_s2:.1f} times the noise: the onset may be wrong")
    if speed_m_s > 3:
        notes.append(f"{speed_m_s:g} m/s is faster than a hand taps: check the unit of the speed")
    if not np.isnan(speed_m_s) and not 0.2 <= peak_m_s2 / STANDARD_GRAVITY_M_S2 <= 200:
        notes.append("peak is far from a tap's 0.5 to 100 g: check the unit of the acceleration")
    if raw.rate_Hz < 2000:
        notes.append(f"sampled at {raw.rate_Hz:.0f} Hz: what a tap has above {raw.rate_Hz / 2:.0f} Hz is missing")
    return notes


def prepare(recording: Recording, settings: Recordings) -> Tap:
    """Offset, polarity, onset, speed, similarity scaling and low-pass of one recording.

    Raises
    ------
    InputError : no way to know the speed, or no tap in the recording.
    """
    raw = recording.acceleration
    offset, notes = _offset(raw, settings)
    polarity, more = _polarity(raw.values - offset, settings)
    upright = replace(raw, values=polarity * (raw.values - offset))
    if not upright.values.max() > 0:
        raise InputError(
            f"{recording.name}: no sample above the offset of {offset:g} m/s^2: "
            "check recordings.polarity and recordings.offset_m_s2"
        )
    onset = find_onset(upright) if settings.onset_s == "auto" else float(settings.onset_s)
    noise = _noise(raw)
    if settings.onset_s == "auto" and upright.values.max() < LEAST_PEAK_TO_NOISE * noise:
        raise InputError(
            f"{recording.name}: highest sample {upright.values.max():.3g} m/s^2, noise {noise:.3g} m/s^2 rms: no tap "
            f"stands out (limit {LEAST_PEAK_TO_NOISE:g} times): record it again or state recordings.onset_s"
        )
    speed, source = _speed(recording, onset)
    clipped = _clipped(raw.values, offset)
    if clipped:
        more.append(f"{clipped} samples at the end stop: the true peak is higher; use a sensor of larger range")

    stretch = settings.time_scale
    if settings.amplitude_scale == "to_grid_speed":
        # Linear contact: time stretches by s, acceleration scales by v' / (v s); v' follows at each grid speed.
        factor, speed, source = 1 / (speed * stretch), float("nan"), f"{source}, scaled to every grid speed"
    else:
        factor = settings.amplitude_scale
        if (stretch, factor) != (1.0, 1.0):
            source += ", similarity-scaled"
        speed *= stretch * factor
    scaled = Signal((raw.start_s - onset) * stretch, raw.dt_s * stretch, factor * upright.values)
    filtered = lowpass(scaled, settings.lowpass_Hz)
    peak = float(np.abs(upright.values if np.isnan(speed) else filtered.values).max())
    more += _doubts(raw, speed, peak, noise if np.isnan(speed) else factor * noise)
    return Tap(recording, filtered, speed, source, offset, polarity, onset, peak, factor, clipped, (*notes, *more))


@dataclass(frozen=True)
class Reference:
    """What the device has to do at one grid speed, at the switching instants.

    Attributes
    ----------
    raw_m_s2 : (N,) r_raw, the recorded acceleration. motor_m_s2 : (N,) r = H r_raw.
    nominal_position_m, nominal_velocity_m_s : (N,) z_nom and its derivative.
    nominal_position_at_ticks_m : (N,) z_nom at the servo ticks t_k, where the encoder is read.
    repeatability, repeatability_unaligned : mean NRMSE of the repeats against their mean; NaN for one tap.
    taps : the recordings used. factors : (n,) by which each was scaled to the grid speed.
    times_s, repeats_m_s2 : (K,), (n, K) the aligned repeats, for figures.
    between_m_s : the two recorded speeds it was derived from by `between`; None if it was recorded itself.
    """

    speed_m_s: float
    raw_m_s2: FloatArray
    motor_m_s2: FloatArray
    nominal_position_m: FloatArray
    nominal_velocity_m_s: FloatArray
    nominal_position_at_ticks_m: FloatArray
    repeatability: float
    repeatability_unaligned: float
    taps: tuple[Tap, ...]
    factors: FloatArray
    times_s: FloatArray
    repeats_m_s2: FloatArray
    between_m_s: tuple[float, float] | None = None

    @property
    def scalings(self) -> FloatArray:
        """(n,) by which each recorded acceleration was multiplied in all."""
        return np.asarray([factor * tap.amplitude for factor, tap in zip(self.factors, self.taps, strict=True)])

    @property
    def user_share(self) -> float:
        """|r_raw - r| / |r_raw|: the part of the tap that is the user's own motion."""
        return nrmse(self.motor_m_s2, self.raw_m_s2)


def _fine_times(grid: TimeGrid) -> FloatArray:
    """Ten points per servo period around contact, with t = 0 among them."""
    step = min(grid.dt_s / 10, 1e-5)
    before = int(np.ceil((SETTLING_S + grid.lead_s) / step))
    after = int(np.ceil(max(grid.end_s, 0.0) / step)) + 1
    return np.asarray(np.arange(-before, after + 1) * step)


def _lags(repeats: FloatArray, mean: FloatArray, step_s: float) -> FloatArray:
    """(n,) shift [s] by which each repeat is later than the mean, to a fraction of the step."""
    reach = round(ALIGNMENT_S / step_s)
    lags = []
    for repeat in repeats:
        match = signal.correlate(repeat, mean, mode="full", method="fft")
        window = match[mean.size - 1 - reach : mean.size + reach]
        best = int(np.argmax(window))
        shift = float(best - reach)
        if 0 < best < window.size - 1:
            left, centre, right = window[best - 1 : best + 2]
            curvature = left - 2 * centre + right
            shift += 0.5 * (left - right) / curvature if curvature < 0 else 0.0
        lags.append(shift * step_s)
    return np.asarray(lags)


def _spread(repeats: FloatArray) -> float:
    if repeats.shape[0] < 2:
        return float("nan")
    mean = repeats.mean(axis=0)
    return float(np.mean([nrmse(repeat, mean) for repeat in repeats]))


def build_reference(
    speed_m_s: float, taps: Sequence[Tap], factors: FloatArray, grid: TimeGrid, settings: Recordings
) -> Reference:
    """Scale, align and average the taps of one grid speed, and split off the user's share.

    r_raw is the mean; r = H r_raw with H a causal second-order high-pass; z_nom integrates r_raw - r twice from
    z = 0, dz/dt = -speed at contact.

    Raises
    ------
    InputError : a tap that ends before the horizon does.
    """
    needed = float(grid.switching_times_s[-1])
    for tap in taps:
        if tap.acceleration.end_s < needed:
            raise InputError(
                f"{tap.recording.name}: ends {tap.acceleration.end_s * 1e3:.1f} ms after contact, the window needs "
                f"{needed * 1e3:.1f} ms: record longer or lower time.stages"
            )
    times = _fine_times(grid)
    repeats = np.stack([f * tap.acceleration.at(times) for f, tap in zip(factors, taps, strict=True)])
    unaligned = _spread(repeats)
    if len(taps) > 1:
        lags = _lags(repeats, repeats.mean(axis=0), times[1] - times[0])
        # The mean onset stays where it is: alignment must not move the contact.
        lags -= lags.mean()
        shifted = [tap.acceleration.shifted(-lag) for tap, lag in zip(taps, lags, strict=True)]
        repeats = np.stack([f * x.at(times) for f, x in zip(factors, shifted, strict=True)])
    raw = Signal(float(times[0]), float(times[1] - times[0]), repeats.mean(axis=0))
    motor = highpass(raw, settings.highpass_Hz)
    user = raw.values - motor.values
    contact = int(np.argmin(np.abs(times)))
    velocity = integrate.cumulative_trapezoid(user, times, initial=0)
    velocity += -speed_m_s - velocity[contact]
    position = integrate.cumulative_trapezoid(velocity, times, initial=0)
    position -= position[contact]
    tau = grid.switching_times_s
    nominal = Signal(raw.start_s, raw.dt_s, position)
    return Reference(
        speed_m_s=speed_m_s,
        raw_m_s2=raw.at(tau),
        motor_m_s2=motor.at(tau),
        nominal_position_m=nominal.at(tau),
        nominal_velocity_m_s=Signal(raw.start_s, raw.dt_s, velocity).at(tau),
        nominal_position_at_ticks_m=nominal.at(grid.issue_times_s),
        repeatability=_spread(repeats),
        repeatability_unaligned=unaligned,
        taps=tuple(taps),
        factors=np.asarray(factors),
        times_s=times,
        repeats_m_s2=repeats,
    )


def assign(taps: Sequence[Tap], speeds_m_s: Sequence[float], settings: Recordings) -> list[list[tuple[Tap, float]]]:
    """For each grid speed its taps, each with the factor that scales it to that speed.

    A tap belongs to the nearest grid speed, if it lies within `speed_tolerance` of it; taps that serve every
    grid speed belong to all.

    Raises
    ------
    InputError : a tap too far from every grid speed; a grid speed without a tap.
    """
    nodes = np.asarray(speeds_m_s, dtype=float)
    groups: list[list[tuple[Tap, float]]] = [[] for _ in nodes]
    for tap in taps:
        if np.isnan(tap.speed_m_s):
            for group, node in zip(groups, nodes, strict=True):
                group.append((tap, float(node)))
            continue
        distance = np.abs(nodes / tap.speed_m_s - 1)
        nearest = int(np.argmin(distance))
        if distance[nearest] > settings.speed_tolerance:
            raise InputError(
                f"{tap.recording.name}: speed {tap.speed_m_s:.4g} m/s is {distance[nearest]:.0%} from the nearest "
                f"grid speed {nodes[nearest]:g} m/s, limit {settings.speed_tolerance:.0%}: "
                "add a grid speed or leave the file out"
            )
        groups[nearest].append((tap, float(nodes[nearest] / tap.speed_m_s)))
    for group, node in zip(groups, nodes, strict=True):
        if not group:
            raise InputError(
                f"grid.speeds_m_s: no recording within {settings.speed_tolerance:.0%} of {node:g} m/s: "
                "record taps at that speed or take it off the grid"
            )
    return groups


def build_references(
    recordings: Sequence[Recording], speeds_m_s: Sequence[float], grid: TimeGrid, settings: Recordings
) -> list[Reference]:
    """One reference per grid speed from all recordings of a scene.

    Raises
    ------
    InputError : see `prepare`, `assign` and `build_reference`.
    """
    taps = [prepare(recording, settings) for recording in recordings]
    return [
        build_reference(node, [tap for tap, _ in group], np.array([f for _, f in group]), grid, settings)
        for node, group in zip(speeds_m_s, assign(taps, speeds_m_s, settings), strict=True)
    ]


def between(references: Sequence[Reference], speed_m_s: float) -> Reference:
    """The reference at any speed within the recorded ones; at a recorded speed the recorded one itself.

    Between neighbours v1 < v < v2 the shape r / v is interpolated linearly in speed, with w = (v - v1) / (v2 - v1):

        r = v ((1 - w) r_1 / v1 + w r_2 / v2)

    Beside a recorded speed this is the scaling by v / v1 that a tap near a grid speed undergoes (`assign`). r_raw and
    z_nom with its velocity follow the same rule, which keeps dz_nom/dt = -v at contact and d2z_nom/dt2 = r_raw - r.
    The taps of both neighbours are listed, scaled to v; the repeatability is the larger of the two, NaN if one is.

    Parameters
    ----------
    references : of the recorded speeds, increasing.

    Raises
    ------
    InputError : a speed outside the recorded ones.
    """
    speeds = [reference.speed_m_s for reference in references]
    if not speeds[0] <= speed_m_s <= speeds[-1]:
        raise InputError(
            f"speed {speed_m_s:g} m/s: references are known from {speeds[0]:g} to {speeds[-1]:g} m/s only: "
            "record taps at that speed"
        )
    if speed_m_s in speeds:
        return references[speeds.index(speed_m_s)]
    j = int(np.searchsorted(speeds, speed_m_s))
    slow, fast = references[j - 1], references[j]
    w = (speed_m_s - slow.speed_m_s) / (fast.speed_m_s - slow.speed_m_s)
    to_slow, to_fast = speed_m_s / slow.speed_m_s, speed_m_s / fast.speed_m_s

    def shape(of_slow: FloatArray, of_fast: FloatArray) -> FloatArray:
        return np.asarray((1 - w) * to_slow * of_slow + w * to_fast * of_fast)

    return Reference(
        speed_m_s=speed_m_s,
        raw_m_s2=shape(slow.raw_m_s2, fast.raw_m_s2),
        motor_m_s2=shape(slow.motor_m_s2, fast.motor_m_s2),
        nominal_position_m=shape(slow.nominal_position_m, fast.nominal_position_m),
        nominal_velocity_m_s=shape(slow.nominal_velocity_m_s, fast.nominal_velocity_m_s),
        nominal_position_at_ticks_m=shape(slow.nominal_position_at_ticks_m, fast.nominal_position_at_ticks_m),
        repeatability=float(np.maximum(slow.repeatability, fast.repeatability)),
        repeatability_unaligned=float(np.maximum(slow.repeatability_unaligned, fast.repeatability_unaligned)),
        taps=slow.taps + fast.taps,
        factors=np.append(to_slow * slow.factors, to_fast * fast.factors),
        times_s=slow.times_s,
        repeats_m_s2=np.append(to_slow * slow.repeats_m_s2, to_fast * fast.repeats_m_s2, axis=0),
        between_m_s=(slow.speed_m_s, fast.speed_m_s),
    )
