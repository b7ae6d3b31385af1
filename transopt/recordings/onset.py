"""The beginning of a tap: offset and polarity of the sensor, and the contact, which the sensor does not mark.

An accelerometer reads gravity as a static offset and may be mounted upside down. Offset, polarity and onset are found
in the recording unless the scene states them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from transopt.base.errors import InputError
from transopt.base.filters import highpassed
from transopt.base.signals import FloatArray, IndexArray, Signal, medians
from transopt.recordings.approach import GUARD_S
from transopt.recordings.recording import Recording
from transopt.recordings.settings import Recordings
from transopt.recordings.split import SLOWEST_HZ

IntArray = IndexArray
Quick = tuple[FloatArray, FloatArray]  # what a high-pass at 8 Hz leaves of a tap and of it low-passed, (n,) each

AT_THE_START_S = 0.5e-3  # an onset this close to the start of the record has no baseline
BASELINE_SAMPLES = 8  # fewest samples of a baseline
LEAST_PEAK_TO_NOISE = 6.0  # below it no tap stands out
TOE_SHARE = 1e-4  # of a pulse's energy before its onset, 1 % of the error; above it contact moves to its start
TOE_LEVEL = 5e-3  # of the peak: level at which a pulse begins; the energy below it is negligible
TOE_TO_NOISE = 3.0  # times the noise: least such level


def _behind_last_below(values: FloatArray, before: IntArray, levels: FloatArray) -> IntArray:
    """(m,) number of values up to and including the last one below a level; 0 if none is below.

    Parameters
    ----------
    values : (m, n). before : (m,) samples of each that are looked at. levels : (m,).
    """
    n = values.shape[1]
    below = (values < levels[:, None]) & (np.arange(n) < before[:, None])
    return np.where(below.any(axis=1), n - np.argmax(below[:, ::-1], axis=1), 0)


def _crossings(values: FloatArray, before: IntArray, levels: FloatArray) -> FloatArray:
    """(m,) last place before sample `before`, in samples, at which values (m, n) rise through a level; 0 if none."""
    j = _behind_last_below(values, before, levels) - 1
    taps, at = np.arange(j.size), np.maximum(j, 0)
    low, high = values[taps, at], values[taps, np.minimum(at + 1, values.shape[1] - 1)]
    rise = np.where(j < 0, 1.0, high - low)
    return np.where(j < 0, 0.0, j + (levels - low) / rise)


def find_onsets(axis: Signal, values: FloatArray) -> FloatArray:
    """(m,) contact times of taps (m, n) without offset and with positive polarity [s].

    The line through the 10 % and 30 % points (of the highest peak) of the first rise is extrapolated to zero. A
    threshold alone would be late by a part of the rise, and an error of one servo tick costs 8 %. The highest peak
    need not be the first.

    Parameters
    ----------
    axis : a signal at their times.
    """
    height = values.max(axis=1)
    risen = np.argmax(values >= 0.3 * height[:, None], axis=1)
    values = values[:, : int(risen.max()) + 1]
    low, high = (axis.start_s + axis.dt_s * _crossings(values, risen, share * height) for share in (0.1, 0.3))
    return np.maximum(low - 0.5 * (high - low), axis.start_s)


class Upright(NamedTuple):
    """A recording less its offset, turned so that the tap is positive.

    Attributes
    ----------
    signal : in the recording's own time [m/s^2].
    highest_m_s2 : its largest value.
    polarity : 1, or -1 if the sensor was upside down.
    offset_m_s2 : offset that was subtracted.
    rest_m_s2 : level from which the tap rises; relative to a stated offset, it may be the incoming acceleration.
    is_level_known : whether a baseline or the user gives the offset.
    notes : one sentence each.
    """

    signal: Signal
    highest_m_s2: float
    polarity: int
    offset_m_s2: float
    rest_m_s2: float
    is_level_known: bool
    notes: list[str]


def _toe(
    up: Upright, quick: Quick | None, onset_s: float, noise_m_s2: float, settings: Recordings
) -> tuple[float, float]:
    """Find where a pulse begins, at or before its onset [s], and the share of its energy between the two.

    A pulse between soft bodies rises gradually, and the onset line reaches zero long after the pulse has begun.
    Before contact only the waveform's lead is played; an earlier part of the pulse would be neither played nor
    counted. Energy is measured after a high-pass at 8 Hz, because a hand that slows down before contact is not part
    of the pulse.

    In the low-passed signal the pulse is traced back from the onset to where it cannot be distinguished from zero.
    Its energy is that of the recorded signal less that of the noise, because a zero-phase low-pass would move part of
    a hard pulse before its onset.
    """
    if quick is None:  # the rate is too low for the high-pass
        return onset_s, 0.0
    x, (recorded, rises) = up.signal, quick
    left = noise_m_s2 * np.sqrt(min(2 * settings.time_scale * settings.lowpass_Hz / x.rate_Hz, 1.0))
    level = max(TOE_LEVEL * (up.highest_m_s2 - up.rest_m_s2), TOE_TO_NOISE * left)
    onset = x.before(onset_s)
    first = 1 + int(np.flatnonzero(rises[:onset] < level).max(initial=-1))
    parts = recorded[first:onset], recorded[first:]
    toe, whole = (float(part @ part) - part.size * noise_m_s2**2 for part in parts)
    return min(x.start_s + x.dt_s * first, onset_s), max(toe, 0.0) / whole if whole > 0 else 0.0


def _turned(values: FloatArray) -> FloatArray:
    """Courses (m, n) less their medians, turned so that the largest deviation is positive."""
    centred = values - medians(values)[:, None]
    peaks = centred[np.arange(len(values)), np.argmax(np.abs(centred), axis=1)]
    centred *= np.sign(peaks)[:, None]
    return centred


def _baseline(x: Signal, onset_s: float) -> float | None:
    """Mean of the samples before the tap without their lowest and highest fifth; None if there are too few.

    The trimming ignores a bump caused by the moving hand.
    """
    quiet = x.values[: x.before(onset_s - GUARD_S)]
    if quiet.size < BASELINE_SAMPLES:
        return None
    fifth = quiet.size // 5
    return float(np.sort(quiet)[fifth : quiet.size - fifth].mean())


def _polarity(values: FloatArray, settings: Recordings) -> tuple[int, list[str]]:
    """Sign of the larger peak, and notes."""
    high, low = float(values.max()), float(-values.min())
    if settings.polarity != "auto":
        return (1 if settings.polarity == "positive" else -1), []
    notes = []
    if min(high, low) > 0.8 * max(high, low):
        notes.append("both signs peak alike: state recordings.polarity")
    return (1 if high >= low else -1), notes


def uprights(recordings: Sequence[Recording], values: FloatArray, settings: Recordings) -> list[Upright]:
    """Subtract the offsets, and turn sensors that were upside down.

    Parameters
    ----------
    values : (m, n) accelerations of the recordings, at the same times.

    Raises
    ------
    InputError : nothing is above the offset.
    """
    onsets = find_onsets(recordings[0].acceleration, _turned(values)).tolist()
    return [_upright(recording, onset, settings) for recording, onset in zip(recordings, onsets, strict=True)]


def _upright(recording: Recording, onset_s: float, settings: Recordings) -> Upright:
    raw = recording.acceleration
    baseline, is_stated = _baseline(raw, onset_s), settings.offset_m_s2 != "baseline"
    offset = float(settings.offset_m_s2) if is_stated else baseline or 0.0
    notes = []
    if not is_stated and baseline is None:
        notes.append("no baseline before the onset: offset taken as 0; state recordings.offset_m_s2 if there is one")
    values = raw.values - offset
    polarity, more = _polarity(values, settings)
    values *= polarity
    highest = float(values.max())
    if not highest > 0:
        raise InputError(
            f"{recording.name}: no sample above the offset of {offset:g} m/s^2: "
            "check recordings.polarity and recordings.offset_m_s2"
        )
    rest, is_known = 0.0 if baseline is None else polarity * (baseline - offset), is_stated or baseline is not None
    return Upright(raw.with_values(values), highest, polarity, offset, rest, is_known, [*notes, *more])


def contacts(
    recordings: Sequence[Recording],
    ups: Sequence[Upright],
    smooth: FloatArray,
    noises_m_s2: Sequence[float],
    settings: Recordings,
) -> list[tuple[float, list[str]]]:
    """Times of contact [s], each with notes; a soft pulse begins before the onset that its rise points to.

    Parameters
    ----------
    recordings : of the taps, at the same times. smooth : (m, n) the signals of `ups`, low-passed.
    noises_m_s2 : rms of the white noise in each.

    Raises
    ------
    InputError : no tap stands out of the noise, or the stated onset lies outside of the recording.
    """
    axis, rest = ups[0].signal, np.array([up.rest_m_s2 for up in ups])[:, None]
    risen, slowest_Hz = np.stack([up.signal.values for up in ups]) - rest, settings.time_scale * SLOWEST_HZ
    stated = settings.onset_s
    onsets = find_onsets(axis, risen).tolist() if stated == "auto" else [float(stated)] * len(ups)
    quick: Sequence[Quick | None] = [None] * len(ups)
    if slowest_Hz < 0.45 * axis.rate_Hz:
        quick = list(zip(*(highpassed(of, axis.rate_Hz, slowest_Hz) for of in (risen, smooth - rest)), strict=True))
    each = zip(recordings, ups, quick, onsets, noises_m_s2, strict=True)
    return [_contact(*of, settings) for of in each]


def _contact(
    recording: Recording,
    up: Upright,
    quick: Quick | None,
    onset: float,
    noise_m_s2: float,
    settings: Recordings,
) -> tuple[float, list[str]]:
    raw, is_found, notes = recording.acceleration, settings.onset_s == "auto", list[str]()
    if not raw.start_s <= onset <= raw.end_s:
        raise InputError(
            f"{recording.name}: recordings.onset_s = {onset:g} s lies outside of the recording, {raw.start_s:g} to "
            f"{raw.end_s:g} s: state it in the file's own time, or leave it out and it is found"
        )
    highest = up.highest_m_s2
    if is_found and highest < LEAST_PEAK_TO_NOISE * noise_m_s2:
        raise InputError(
            f"{recording.name}: highest sample {highest:.3g} m/s^2, noise {noise_m_s2:.3g} m/s^2 rms: no tap "
            f"stands out (limit {LEAST_PEAK_TO_NOISE:g} times): record it again or state recordings.onset_s"
        )
    begins, share = _toe(up, quick, onset, noise_m_s2, settings)
    if share > TOE_SHARE:
        found = f"a soft pulse: {100 * share:.2g} % of its energy in the {1e3 * (onset - begins):.2g} ms before"
        if is_found:
            notes.append(f"{found} the onset that its rise points to; contact is put where it begins")
            onset = begins
        else:
            notes.append(f"{found} recordings.onset_s, of which only the waveform's lead is played: state it earlier")
    if is_found and onset - raw.start_s < AT_THE_START_S:
        notes.append("the contact is at the start of the file (a trigger without pre-roll): what came before is lost")
    return onset, notes
