"""Reads the recordings of a scene, and prepares each for a reference: onset, speed, similarity scaling, low-pass."""

import glob
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from transopt.base.errors import InputError
from transopt.base.files import is_file
from transopt.base.filters import lowpass, lowpassed
from transopt.base.shown import brief
from transopt.base.signals import REACTION_S, FloatArray, Signal, alike, median
from transopt.base.sizes import MOST_FILES
from transopt.files.names import apart
from transopt.files.unclear import Answer, UnclearError
from transopt.files.units import read_unit
from transopt.recordings.after_contact import pulled_back_after_s, second_hit
from transopt.recordings.approach import GUARD_S, Approach, find_approach, unsteady
from transopt.recordings.onset import Upright, contacts, uprights
from transopt.recordings.plausible import HAND_M_S, implausible_grip, implausible_motion, implausible_time
from transopt.recordings.recording import VOCABULARY, Recording, load_recording
from transopt.recordings.settings import Recordings
from transopt.recordings.speed import FITTED, UNKNOWN, contradiction, facing_out, incoming_speed
from transopt.recordings.split import split, white_noises

CLIPPED_RUN = 3  # samples; two equal ones may be chance
ENTERED_COUNTS = 3.0  # steps of the resolution by which a signal enters or leaves its end stop
ROUNDING = 1e-9  # of the largest value: two values that differ by less are one
TAPS_AT_ONCE = 32  # taps that are prepared together: their samples fit into the processor's cache
GRIPPED_S = 50e-3  # before contact: time over which the grip is averaged
CLEAR_PEAK_TO_NOISE = 20.0  # below it noise alone may exceed the 30 % of the peak by which the onset is found
USUAL_SPEEDS_M_S = (0.2, 0.1, 0.3, 0.05, 0.5)  # common speeds of a tapping hand


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
    # Imported here, since simulated taps have no files.
    from transopt.files.formats import refuse_idle

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
            measured = recording.grip_N is not None or recording.grip is not None
            grip = recording.grip_N if measured else settings.grip_N
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
    peak_m_s2 : peak of the low-passed acceleration, as of the target.
    amplitude : similarity factor already applied to `acceleration`.
    clipped_samples : number of samples at the end of the sensor's range.
    notes : what a user should know about this recording, one sentence each.
    implausible : why it cannot be a tap in the stated units, or is clipped; empty if neither, or if it was simulated.
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


def _clipped(values: FloatArray, offset: float) -> int:
    """Number of samples in runs of at least `CLIPPED_RUN` that equal the largest or smallest value.

    An extreme counts only if it is at least half as far from the offset as the other; a constant baseline is not
    clipped. A run counts only if the signal enters or leaves it by more than `ENTERED_COUNTS` steps of its
    resolution. The smooth top of a coarsely quantised pulse begins and ends by one or two.
    """
    count = 0
    extremes = float(values.min()), float(values.max())
    reach = max(abs(extreme - offset) for extreme in extremes)
    for extreme in extremes:
        if abs(extreme - offset) < 0.5 * reach:
            continue
        at_stop = values == extreme
        if np.count_nonzero(at_stop) < CLIPPED_RUN:
            continue
        beside = np.concatenate([[extreme], values, [extreme]])
        edges = np.flatnonzero(np.diff(np.concatenate([[False], at_stop, [False]])))
        begins, ends = edges[::2], edges[1::2]
        away = np.maximum(np.abs(beside[begins] - extreme), np.abs(beside[ends + 1] - extreme))
        runs = (ends - begins)[away > ENTERED_COUNTS * _resolution(values)]
        count += int(runs[runs >= CLIPPED_RUN].sum())
    return count


def _resolution(values: FloatArray) -> float:
    """Smallest difference between two values."""
    steps = np.diff(np.unique(values))
    return float(steps[steps > ROUNDING * np.abs(values).max()].min(initial=np.inf))


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


def _speed(
    recording: Recording, x: Signal, smooth: FloatArray, onset_s: float, settings: Recordings, *, is_level_known: bool
) -> tuple[float, str, str, list[str]]:
    """Incoming speed [m/s] before any scaling and its source, why the recording cannot be a tap, and notes.

    Parameters
    ----------
    x, smooth : without offset, positive where the tap decelerates the stylus; as recorded and low-passed.
    is_level_known : whether the offset is known, so that gravity is not in `x`.
    """
    doubtful = "" if settings.simulated else implausible_time(recording.acceleration)
    try:
        speed, source, notes = incoming_speed(recording, onset_s)
    except InputError:
        if doubtful:  # the wrong unit of time, not the failed fit of a speed, has to be reported
            raise InputError(f"{recording.name}: {doubtful}") from None
        raise
    if not (settings.simulated or doubtful):
        # If no baseline gave the offset, the signal contains gravity, which the median removes.
        gravity = 0.0 if is_level_known else median(x.values)
        freed = x.with_values(x.values - gravity)
        peak = float(smooth.max()) - gravity
        doubtful = implausible_motion(freed, peak, onset_s, speed, settings, fitted=source == FITTED)
        notes = [*notes, *filter(None, [contradiction(recording, onset_s)])]
    return speed, source, doubtful, notes


def _scaling(speed_m_s: float, source: str, settings: Recordings) -> tuple[float, float, str]:
    """Factor on the acceleration, the speed after it [m/s], and its source, by the scene's similarity scaling.

    Linear contact: time stretches by s, acceleration scales by v' / (v s). Scaled to every grid speed, v' follows at
    each of them, and the speed is NaN.
    """
    stretch = settings.time_scale
    if settings.amplitude_scale == "to_grid_speed":
        scaled = source if source == UNKNOWN else f"{source}, scaled to every grid speed"
        return 1 / (speed_m_s * stretch), float("nan"), scaled
    factor = settings.amplitude_scale
    is_scaled = (stretch, factor) != (1.0, 1.0)
    return factor, speed_m_s * stretch * factor, f"{source}, similarity-scaled" if is_scaled else source


def _gripped(recording: Recording, onset_s: float) -> tuple[Recording, list[str]]:
    """The recording with the grip force that its column shows before contact, and a note on it.

    A load cell may count pressure as negative, so the grip is the magnitude of the mean.
    """
    if recording.grip is None or recording.grip_N is not None:
        return recording, []
    held = recording.grip.values[recording.grip.until(onset_s - GRIPPED_S) : recording.grip.before(onset_s - GUARD_S)]
    if held.size == 0:
        return recording, ["the grip column has no sample before contact: the grip is not known from it"]
    grip_N = float(f"{abs(float(held.mean())):.4g}")
    note = f"the grip of {grip_N:g} N is the mean of its column in the {1e3 * GRIPPED_S:.0f} ms before contact"
    return replace(recording, grip_N=grip_N), [note]


def _hand_after_contact(recording: Recording, tap: Signal, onset_s: float, settings: Recordings) -> tuple[str, str]:
    """Notes on a hand that pulls back, and on a second hit; empty where there is none.

    Parameters
    ----------
    tap : low-passed and scaled, contact at t = 0.
    """
    pulled = hit = ""
    pulled_s = None if recording.position is None else pulled_back_after_s(recording.position, onset_s)
    if pulled_s is not None:
        pulled = (
            f"within {1e3 * pulled_s:.0f} ms of contact the hand pulls the stylus back, which raises the error above "
            "30 Hz to 14 %: leave it out unless the player's hand pulls too"
        )
    again = None if settings.simulated else second_hit(tap, 0.0)
    if again is not None:
        hit = (
            f"a second hit {1e3 * again[0]:.0f} ms after contact, {100 * again[1]:.0f} % of the first: if the stylus "
            "was thrown back and came again, record another tap or cut the file before it"
        )
    return pulled, hit


def _unsteady(came: Approach, smooth: FloatArray, onset_s: float, settings: Recordings) -> str:
    """Note on a hand that did not come in steadily; empty for one that did, and for impacts of another rig."""
    x = came.acceleration
    tap = smooth[x.before(onset_s) : x.until(onset_s + REACTION_S)]
    if (settings.time_scale, settings.amplitude_scale) != (1.0, 1.0) or not tap.size:
        return ""
    return unsteady(came, onset_s, float(np.sqrt(np.mean(tap**2))))


def prepare(recording: Recording, settings: Recordings) -> PreparedTap:
    """Find offset, polarity, onset and speed of one recording; scale it by similarity and low-pass it.

    A speed that is neither stated nor fitted is NaN with the source `UNKNOWN`; `check_usable` refuses it.

    Raises
    ------
    InputError : the recording has no tap, the onset lies outside of it, or no speed can be fitted to the position.
    """
    return prepare_all([recording], settings)[0]


def prepare_all(recordings: Sequence[Recording], settings: Recordings) -> list[PreparedTap]:
    """`prepare` each recording, those of one time axis side by side.

    Raises
    ------
    InputError : as by `prepare`, for one of the recordings that are refused.
    """
    found: dict[int, PreparedTap] = {}
    for numbers, values in alike([recording.acceleration for recording in recordings], TAPS_AT_ONCE):
        taps = [recordings[i] for i in numbers]
        ups, noises = uprights(taps, values, settings), white_noises(values)
        rate_Hz, cutoff_Hz = taps[0].acceleration.rate_Hz, settings.time_scale * settings.lowpass_Hz
        smooth = lowpassed(np.stack([up.signal.values for up in ups]), rate_Hz, cutoff_Hz)
        each = zip(taps, ups, smooth, contacts(taps, ups, smooth, noises, settings), noises, strict=True)
        found.update(zip(numbers, (_prepared(*of, settings) for of in each), strict=True))
    return [found[i] for i in range(len(recordings))]


def _prepared(
    recording: Recording,
    up: Upright,
    smooth: FloatArray,
    touched: tuple[float, list[str]],
    noise: float,
    settings: Recordings,
) -> PreparedTap:
    raw, stretch, (onset, found) = recording.acceleration, settings.time_scale, touched
    # A simulated position has the project's sign.
    recording, turned = (recording, []) if settings.simulated else facing_out(recording, up.signal, onset)
    recording, gripped = _gripped(recording, onset)
    is_stated = settings.offset_m_s2 != "baseline"
    came = find_approach(up.signal, recording.position, onset, noise, settings.trusted_from_Hz, stated=is_stated)
    if came.acceleration is not up.signal:
        smooth = lowpass(came.acceleration, stretch * settings.lowpass_Hz).values
    offset = up.offset_m_s2 - up.polarity * came.offset_error_m_s2
    incoming, source, doubtful, unsure = _speed(
        recording, came.acceleration, smooth, onset, settings, is_level_known=up.is_level_known
    )
    factor, speed, source = _scaling(incoming, source, settings)
    filtered = Signal((raw.start_s - onset) * stretch, raw.dt_s * stretch, factor * smooth)
    peak = float(np.abs(smooth if np.isnan(factor) else filtered.values).max())
    coming = _unsteady(came, smooth, onset, settings)
    pulled, hit = _hand_after_contact(recording, filtered, onset, settings)
    clipped = _clipped(raw.values, offset)
    stop = f"{clipped} samples at the end stop: the true peak is higher; use a sensor of larger range" * (clipped > 0)
    if not settings.simulated:
        doubtful = doubtful or implausible_grip(recording.grip_N or 0.0) or f"clipped, {stop}" * (clipped > 0)
    doubts = _doubts(raw, speed, peak, noise if np.isnan(speed) else factor * noise)
    notes = (*up.notes, *found, *turned, *gripped, *came.notes, coming, pulled, *unsure, stop, hit, *doubts)
    return PreparedTap(
        recording=recording,
        acceleration=filtered,
        speed_m_s=speed,
        speed_source=source,
        offset_m_s2=offset,
        incoming_acceleration_m_s2=factor * came.incoming_m_s2,
        incoming_source=came.source,
        slow_part_known=came.slow_part_known,
        polarity=up.polarity,
        onset_s=onset,
        peak_m_s2=peak,
        amplitude=factor,
        clipped_samples=clipped,
        notes=(*recording.notes, *filter(None, notes)),
        implausible=doubtful,
        across=_across(recording, settings, onset, up.polarity, factor),
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
        smooth = lowpass(x.with_values(sign * (x.values - rest)), stretch * settings.lowpass_Hz)
        found.append(Signal((x.start_s - onset_s) * stretch, x.dt_s * stretch, factor * smooth.values))
    return tuple(found)


def _possible_positions(file: Path) -> list[Answer]:
    """Units that make a position of a column whose name means nothing, as answers to a question."""
    # Imported here, since simulated taps have no files.
    from transopt.files.formats import columns_of

    unused = [apart(name) for name in columns_of(file, VOCABULARY) if VOCABULARY.quantity_of(name) is None]
    return [{"units": {base: unit}} for base, unit in unused if unit and read_unit(unit, "position")]


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
            f'scene does, recordings.speed_by_file_m_s = {{ "{name}" = 0.2 }}; a tap changes it by 1 to 2 times',
            [*_possible_positions(Path(tap.recording.source)), *({"speed_m_s": v} for v in USUAL_SPEEDS_M_S)],
            Path(tap.recording.source),
        )


def check_usable(tap: PreparedTap, settings: Recordings) -> None:
    """Refuse a tap unfit for a library: of unknown speed, or implausible or clipped unless the settings accept that.

    Raises
    ------
    InputError : the tap is unfit.
    """
    check_speed(tap)
    if tap.implausible and settings.implausible == "refuse":
        accept = 'if it is right as it is, --accept takes it, or recordings.implausible = "accept" in the scene'
        raise InputError(f"{tap.recording.name}: {tap.implausible}; `transopt taps` shows more; {accept}")
