"""Prepares recordings for a reference: offset, polarity, onset, speed, similarity scaling, low-pass.

An accelerometer reads gravity as a static offset, may be mounted upside down, and does not mark the contact. All of
these are found in the recording unless the scene states them.
"""

import glob
import itertools
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from transopt.base.errors import InputError
from transopt.base.files import is_file
from transopt.base.filters import highpass, lowpass
from transopt.base.shown import brief
from transopt.base.signals import FloatArray, Signal, median
from transopt.base.sizes import MOST_FILES
from transopt.files.formats import refuse_idle
from transopt.files.unclear import UnclearError
from transopt.recordings.after_contact import pulled_back_after_s, second_hit
from transopt.recordings.approach import GUARD_S, find_approach
from transopt.recordings.plausible import HAND_M_S, implausible_motion, implausible_time
from transopt.recordings.recording import Recording, load_recording
from transopt.recordings.settings import Recordings
from transopt.recordings.speed import FITTED, UNKNOWN, incoming_speed
from transopt.recordings.split import SLOWEST_HZ, split, white_noise

AT_THE_START_S = 0.5e-3  # an onset this close to the start of the record has no baseline
BASELINE_SAMPLES = 8  # fewest samples of a baseline
LEAST_PEAK_TO_NOISE = 6.0  # below it no tap stands out
CLIPPED_RUN = 3  # samples; two equal ones may be chance
CLEAR_PEAK_TO_NOISE = 20.0  # below it noise alone may exceed the 30 % of the peak by which the onset is found
USUAL_SPEEDS_M_S = (0.2, 0.1, 0.3, 0.05, 0.5)  # common speeds of a tapping hand
TOE_SHARE = 1e-4  # of a pulse's energy before its onset, 1 % of the error; above it contact moves to its start
TOE_LEVEL = 5e-3  # of the peak: level at which a pulse begins; the energy below it is negligible
TOE_TO_NOISE = 3.0  # times the noise: least such level


def _paths(settings: Recordings) -> list[Path]:
    """Files of the scene; an entry that is no existing file is a pattern, expanded in sorted order."""
    paths: list[Path] = []
    for entry in settings.files:
        literal = Path(settings.folder) / entry
        if is_file(literal) or not any(character in entry for character in "*?["):
            paths.append(literal)
            continue
        # The folder is not a pattern, whatever characters it has; an absolute entry ignores the folder.
        matches = glob.iglob(str(Path(glob.escape(settings.folder)) / entry))  # noqa: PTH207
        found = sorted(itertools.islice(matches, MOST_FILES + 1))
        if len(found) > MOST_FILES:
            raise InputError(f"recordings.files: {entry!r} matches more than {MOST_FILES} files: name fewer")
        if not found and Path(entry).is_absolute():
            raise InputError(f"{entry}: matches no file: check the names of folder and files")
        if not found:
            source = f" (source: {settings.source})" if settings.source else ""
            raise InputError(
                f"recordings.files: {entry!r} matches no file in {settings.folder}: "
                f"put the recordings there, or name their folder with --recordings FOLDER{source}"
            )
        paths += [Path(name) for name in found]
    return paths


def read_recordings(settings: Recordings) -> list[Recording]:
    """Load the files that a scene names; a file with several taps gives one recording per tap.

    `speed_by_file_m_s` overrides a file's speed, for all taps by the file's name or for one by `FILE#2`; `speed_m_s`
    and `grip_N` apply to files that state none. `taps_by_file` selects taps. A stated onset is in a file's own time,
    so the file is not split then.

    Raises
    ------
    InputError : a pattern matches nothing; no file can use a setting; a name in `speed_by_file_m_s` or `taps_by_file`
        is not among the files; or a file itself is refused.
    """
    paths, by_file = _paths(settings), settings.speed_by_file_m_s
    for pattern in settings.taps_by_file:
        if not any(fnmatchcase(path.name, pattern) for path in paths):
            raise InputError(f"recordings.taps_by_file: {pattern!r} is not among the files; correct the name")
    refuse_idle(settings.layout(), [path.suffix for path in paths])
    found = []
    for path in paths:
        whole = load_recording(path, settings.layout())
        # If the unit of time is wrong, every ripple looks like a tap.
        entire = settings.onset_s != "auto" or (
            settings.implausible == "refuse" and implausible_time(whole.acceleration)
        )
        for recording in [whole] if entire else split(whole, settings.taps_by_file):
            stated = settings.speed_m_s if recording.speed_m_s is None else recording.speed_m_s
            grip = settings.grip_N if recording.grip_N is None else recording.grip_N
            speed = by_file.get(recording.name, by_file.get(path.name, stated))
            notes = recording.notes
            if recording.name != path.name and speed is not None and recording.name not in by_file:
                notes = (*notes, f"its speed is the one that is stated for all taps of {path.name}")
            found.append(replace(recording, speed_m_s=speed, grip_N=grip, notes=notes))
    stray = set(by_file) - {path.name for path in paths} - {recording.name for recording in found}
    if stray:
        raise InputError(
            f"recordings.speed_by_file_m_s: {sorted(stray)[0]!r} is not among the files; correct the name"
        )
    return found


@dataclass(frozen=True)
class PreparedTap:
    """A prepared recording: SI, contact at t = 0, positive where the tap decelerates the stylus.

    Attributes
    ----------
    recording : as read from the file.
    acceleration : low-passed, similarity-scaled, not yet scaled to a grid speed [m/s^2].
    speed_m_s : incoming speed after similarity scaling; NaN if the recording serves every grid speed.
    speed_source : what the speed is known from.
    offset_m_s2 : static offset of the sensor, found in the recording or stated.
    incoming_acceleration_m_s2 : a0, acceleration of the hand before contact, similarity-scaled; 0 if unknown.
    incoming_source : what a0 is known from.
    slow_part_known : whether the acceleration contains frequencies below those of the tap.
    polarity : 1, or -1 if the sensor was upside down.
    onset_s : contact in the recording's own time.
    peak_m_s2 : peak of the low-passed acceleration.
    amplitude : similarity factor already applied to `acceleration`.
    clipped_samples : number of samples at the end of the sensor's range.
    notes : what a user should know about this recording, one sentence each.
    implausible : why it cannot be a tap in the stated units; empty if it can be or was simulated.
    across : acceleration along two tangents, processed alike, relative to rest; empty for one direction.
    """

    recording: Recording
    acceleration: Signal
    speed_m_s: float
    speed_source: str
    offset_m_s2: float
    incoming_acceleration_m_s2: float
    incoming_source: str
    slow_part_known: bool
    polarity: int
    onset_s: float
    peak_m_s2: float
    amplitude: float
    clipped_samples: int
    notes: tuple[str, ...]
    implausible: str
    across: tuple[Signal, ...] = ()

    __repr__ = brief


def _behind_last_below(values: FloatArray, level: float) -> int:
    """Number of values up to and including the last one below a level; 0 if none is below."""
    below = values[::-1] < level
    last = int(np.argmax(below)) if below.size else 0
    return values.size - last if below.any() else 0


def _crossing(x: Signal, before: int, level: float) -> float:
    """Last time before sample `before` at which a signal rises through `level`; the first sample's if never."""
    j = _behind_last_below(x.values[:before], level) - 1
    if j < 0:
        return x.start_s
    low, high = float(x.values[j]), float(x.values[j + 1])
    return x.start_s + x.dt_s * (j + (level - low) / (high - low))


def find_onset(x: Signal) -> float:
    """Contact time of a tap without offset and with positive polarity [s].

    The line through the 10 % and 30 % points (of the highest peak) of the first rise is extrapolated to zero. A
    threshold alone would be late by a part of the rise, and an error of one servo tick costs 8 %. The highest peak
    need not be the first.
    """
    height = float(x.values.max())
    risen = int(np.argmax(x.values >= 0.3 * height))
    low, high = _crossing(x, risen, 0.1 * height), _crossing(x, risen, 0.3 * height)
    return max(low - 0.5 * (high - low), x.start_s)


def _toe(x: Signal, smooth: Signal, onset_s: float, noise_m_s2: float, settings: Recordings) -> tuple[float, float]:
    """Find where a pulse begins, at or before its onset [s], and the share of its energy between the two.

    A pulse between soft bodies rises gradually, and the onset line reaches zero long after the pulse has begun.
    Before contact only the waveform's lead is played; an earlier part of the pulse would be neither played nor
    counted. Energy is measured after a high-pass at 8 Hz, because a hand that slows down before contact is not part
    of the pulse.

    In the low-passed signal the pulse is traced back from the onset to where it cannot be distinguished from zero.
    Its energy is that of the recorded signal less that of the noise, because a zero-phase low-pass would move part of
    a hard pulse before its onset.
    """
    slowest_Hz = settings.time_scale * SLOWEST_HZ
    if slowest_Hz >= 0.45 * x.rate_Hz:
        return onset_s, 0.0
    recorded, rises = (highpass(each, slowest_Hz).values for each in (x, smooth))
    left = noise_m_s2 * np.sqrt(min(2 * settings.time_scale * settings.lowpass_Hz / x.rate_Hz, 1.0))
    level = max(TOE_LEVEL * float(x.values.max()), TOE_TO_NOISE * left)
    contact = x.before(onset_s)
    first = _behind_last_below(rises[:contact], level)
    energy = recorded[first:] ** 2 - noise_m_s2**2
    toe, whole = float(energy[: contact - first].sum()), float(energy.sum())
    return min(x.start_s + x.dt_s * first, onset_s), max(toe, 0.0) / whole if whole > 0 else 0.0


def _baseline(x: Signal) -> float | None:
    """Mean of the samples before the tap without their lowest and highest fifth; None if there are too few.

    The trimming ignores a bump caused by the moving hand.
    """
    centred = x.values - median(x.values)
    upright = Signal(x.start_s, x.dt_s, centred * np.sign(centred[np.argmax(np.abs(centred))]))
    quiet = x.values[: x.before(find_onset(upright) - GUARD_S)]
    if quiet.size < BASELINE_SAMPLES:
        return None
    fifth = quiet.size // 5
    inner = np.partition(quiet, (fifth, quiet.size - fifth - 1))[fifth : quiet.size - fifth]
    return float(inner.mean())


def _polarity(values: FloatArray, settings: Recordings) -> tuple[int, list[str]]:
    """Sign of the larger peak, and notes."""
    high, low = float(values.max()), float(-values.min())
    if settings.polarity != "auto":
        return (1 if settings.polarity == "positive" else -1), []
    notes = []
    if min(high, low) > 0.8 * max(high, low):
        notes.append("both signs peak alike: state recordings.polarity")
    return (1 if high >= low else -1), notes


def _clipped(values: FloatArray, offset: float) -> int:
    """Number of samples in runs of at least `CLIPPED_RUN` that equal the largest or smallest value.

    An extreme counts only if it is at least half as far from the offset as the other; a constant baseline is not
    clipped.
    """
    count = 0
    extremes = float(values.min()), float(values.max())
    reach = max(abs(extreme - offset) for extreme in extremes)
    for extreme in extremes:
        if abs(extreme - offset) < 0.5 * reach:
            continue
        at_stop = values == extreme
        if np.count_nonzero(at_stop) >= CLIPPED_RUN:
            edges = np.flatnonzero(np.diff(np.concatenate([[False], at_stop, [False]])))
            runs = edges[1::2] - edges[::2]
            count += int(runs[runs >= CLIPPED_RUN].sum())
    return count


def _doubts(raw: Signal, speed_m_s: float, peak_m_s2: float, noise_m_s2: float) -> list[str]:
    """Notes on what makes a recording an unlikely tap; none of them refuses the file."""
    notes = []
    if peak_m_s2 < CLEAR_PEAK_TO_NOISE * noise_m_s2:
        notes.append(f"peak is only {peak_m_s2 / noise_m_s2:.1f} times the noise: the onset may be wrong")
    if speed_m_s > HAND_M_S[1]:
        notes.append(f"{speed_m_s:g} m/s is faster than a hand taps: check the unit of the speed")
    if raw.rate_Hz < 2000:
        notes.append(f"sampled at {raw.rate_Hz:.0f} Hz: what a tap has above {raw.rate_Hz / 2:.0f} Hz is missing")
    return notes


def prepare(recording: Recording, settings: Recordings) -> PreparedTap:
    """Find offset, polarity, onset and speed of one recording; scale it by similarity and low-pass it.

    A speed that is neither stated nor fitted is NaN with the source `UNKNOWN`; `check_usable` refuses it.

    Raises
    ------
    InputError : the recording has no tap, the onset lies outside of it, or no speed can be fitted to the position.
    """
    raw = recording.acceleration
    baseline, notes, stated = _baseline(raw), [], settings.offset_m_s2 != "baseline"
    offset = float(settings.offset_m_s2) if stated else baseline or 0.0
    if not stated and baseline is None:
        notes.append("no baseline before the onset: offset taken as 0; state recordings.offset_m_s2 if there is one")
    polarity, more = _polarity(raw.values - offset, settings)
    upright = Signal(raw.start_s, raw.dt_s, polarity * (raw.values - offset))
    if not upright.values.max() > 0:
        raise InputError(
            f"{recording.name}: no sample above the offset of {offset:g} m/s^2: "
            "check recordings.polarity and recordings.offset_m_s2"
        )
    # The tap rises from the baseline; relative to a stated offset, the baseline may be the incoming acceleration.
    rest = 0.0 if baseline is None else polarity * (baseline - offset)
    risen = Signal(raw.start_s, raw.dt_s, upright.values - rest)
    onset = find_onset(risen) if settings.onset_s == "auto" else float(settings.onset_s)
    if not raw.start_s <= onset <= raw.end_s:
        raise InputError(
            f"{recording.name}: recordings.onset_s = {onset:g} s lies outside of the recording, {raw.start_s:g} to "
            f"{raw.end_s:g} s: state it in the file's own time, or leave it out and it is found"
        )
    noise = white_noise(raw)
    if settings.onset_s == "auto" and upright.values.max() < LEAST_PEAK_TO_NOISE * noise:
        raise InputError(
            f"{recording.name}: highest sample {upright.values.max():.3g} m/s^2, noise {noise:.3g} m/s^2 rms: no tap "
            f"stands out (limit {LEAST_PEAK_TO_NOISE:g} times): record it again or state recordings.onset_s"
        )
    stretch = settings.time_scale
    smooth = lowpass(upright, stretch * settings.lowpass_Hz)
    begins, share = _toe(risen, replace(smooth, values=smooth.values - rest), onset, noise, settings)
    if share > TOE_SHARE:
        early_ms = 1e3 * (onset - begins)
        found = f"a soft pulse: {100 * share:.2g} % of its energy in the {early_ms:.2g} ms before"
        if settings.onset_s == "auto":
            more.append(f"{found} the onset that its rise points to; contact is put where it begins")
            onset = begins
        else:
            more.append(f"{found} recordings.onset_s, of which only the waveform's lead is played: state it earlier")
    if settings.onset_s == "auto" and onset - upright.start_s < AT_THE_START_S:
        more.append("the contact is at the start of the file (a trigger without pre-roll): what came before is lost")
    came = find_approach(upright, recording.position, onset, noise, settings.trusted_from_Hz, stated=stated)
    if came.acceleration is not upright:
        upright = came.acceleration
        smooth = lowpass(upright, stretch * settings.lowpass_Hz)
    offset -= polarity * came.offset_error_m_s2
    more += came.notes
    pulled_s = None if recording.position is None else pulled_back_after_s(recording.position, onset)
    if pulled_s is not None:
        more.append(
            f"within {1e3 * pulled_s:.0f} ms of contact the hand pulls the stylus back, which raises the error above "
            "30 Hz to 14 %: leave it out unless the player's hand pulls too"
        )
    doubtful = "" if settings.simulated else implausible_time(raw)
    try:
        speed, source, unsure = incoming_speed(recording, onset)
    except InputError:
        if doubtful:  # the wrong unit of time, not the failed fit of a speed, has to be reported
            raise InputError(f"{recording.name}: {doubtful}") from None
        raise
    more += unsure
    if not (settings.simulated or doubtful):
        # If no baseline gave the offset, the signal contains gravity, which the median removes.
        gravity = median(upright.values) if notes else 0.0
        freed = replace(upright, values=upright.values - gravity)
        doubtful = implausible_motion(freed, onset, speed, settings, fitted=source == FITTED)
    clipped = _clipped(raw.values, offset)
    if clipped:
        more.append(f"{clipped} samples at the end stop: the true peak is higher; use a sensor of larger range")

    if settings.amplitude_scale == "to_grid_speed":
        # Linear contact: time stretches by s, acceleration scales by v' / (v s); v' follows at each grid speed.
        if source != UNKNOWN:
            source += ", scaled to every grid speed"
        factor, speed = 1 / (speed * stretch), float("nan")
    else:
        factor = settings.amplitude_scale
        if (stretch, factor) != (1.0, 1.0):
            source += ", similarity-scaled"
        speed *= stretch * factor
    filtered = Signal((raw.start_s - onset) * stretch, raw.dt_s * stretch, factor * smooth.values)
    peak = float(np.abs(upright.values if np.isnan(speed) else filtered.values).max())
    hit = None if settings.simulated else second_hit(filtered, 0.0)
    if hit is not None:
        more.append(
            f"a second hit {1e3 * hit[0]:.0f} ms after contact, {100 * hit[1]:.0f} % of the first: if the stylus was "
            "thrown back and came again, record another tap or cut the file before it"
        )
    more += _doubts(raw, speed, peak, noise if np.isnan(speed) else factor * noise)
    return PreparedTap(
        recording,
        filtered,
        speed,
        source,
        offset,
        factor * came.incoming_m_s2,
        came.source,
        came.slow_part_known,
        polarity,
        onset,
        peak,
        factor,
        clipped,
        (*recording.notes, *notes, *more),
        doubtful,
        _across(recording, settings, onset, polarity, factor),
    )


def _across(
    recording: Recording, settings: Recordings, onset_s: float, polarity: int, factor: float
) -> tuple[Signal, ...]:
    """Acceleration along two tangents, processed like the tap itself; empty if it was not recorded.

    It is relative to its mean before contact. A sensor that is upside down is turned about its first tangent.
    """
    if recording.across_1 is None or recording.across_2 is None:
        return ()
    stretch, found = settings.time_scale, []
    for x, sign in ((recording.across_1, 1), (recording.across_2, polarity)):
        quiet = x.values[: x.before(onset_s - GUARD_S)]
        rest = float(quiet.mean()) if quiet.size else median(x.values)
        smooth = lowpass(replace(x, values=sign * (x.values - rest)), stretch * settings.lowpass_Hz)
        found.append(Signal((x.start_s - onset_s) * stretch, x.dt_s * stretch, factor * smooth.values))
    return tuple(found)


def check_speed(tap: PreparedTap) -> None:
    """Refuse a tap of unknown speed.

    Raises
    ------
    UnclearError : the speed is unknown.
    """
    if tap.speed_source == UNKNOWN:
        name = tap.recording.name
        raise UnclearError(
            "no incoming speed: the file neither states it (`# speed_m_s: ...`) nor has a position_m column, and no "
            f'scene does, recordings.speed_by_file_m_s = {{ "{name}" = 0.2 }}',
            [{"speed_m_s": speed} for speed in USUAL_SPEEDS_M_S],
            Path(tap.recording.source),
        )


def check_usable(tap: PreparedTap, settings: Recordings) -> None:
    """Refuse a tap unfit for a library: of unknown speed, or implausible unless the settings accept that.

    Raises
    ------
    InputError : the tap is unfit.
    """
    check_speed(tap)
    if tap.implausible and settings.implausible == "refuse":
        accept = 'if it is right as it is, --accept takes it, or recordings.implausible = "accept" in the scene'
        raise InputError(f"{tap.recording.name}: {tap.implausible}; `transopt taps` shows more; {accept}")
