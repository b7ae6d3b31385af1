"""Several taps in one file: finds where each begins and ends, and selects those that the user chose.

A session is often recorded in one file. As a single tap, only its highest peak would count and the others would look
like ringing; so the file is cut into taps, each a recording of its own with the name `FILE#2`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np

from transopt.base.errors import InputError
from transopt.base.filters import highpass
from transopt.base.signals import FloatArray, Signal, medians
from transopt.recordings.recording import Recording

PAUSE_S = 0.1  # between two taps: a rebound comes sooner and belongs to its tap; no hand taps that fast
LEAST_SHARE = 0.15  # of the highest peak: taps at 0.1 and 0.4 m/s differ by a factor of four
LEAST_TO_NOISE = 10.0  # times the rms of the noise: a million samples of noise peak at five times
NORMAL_QUARTILE = 0.6744897501960817  # median of |x| of normally distributed x, in standard deviations
START_S = 2e-3
SLOWEST_HZ = 8.0  # below it the hand moves, and turns the sensor in the earth's field
SIGNALS = ("acceleration", "position", "force", "grip", "current", "across_1", "across_2")  # all are cut alike


def bounds(x: Signal) -> list[tuple[int, int]]:
    """First sample and end of every tap of a signal, in order; the whole signal if there is at most one tap.

    A tap is where the high-passed signal exceeds a threshold in the direction of its highest peak, together with all
    that follows within `PAUSE_S`. Two taps are separated in the middle of the quiet stretch between them.
    """
    whole = [(0, x.values.size)]
    if x.values.size * x.dt_s < PAUSE_S or x.rate_Hz < 5 * SLOWEST_HZ:
        return whole
    # Subtract the level at the start of the file; otherwise the filter would see a step there.
    rest = np.median(x.values[: max(int(START_S / x.dt_s), 1)])
    quick = highpass(x.with_values(x.values - rest), SLOWEST_HZ).values
    # A released force or a lifted stylus moves in the opposite direction of a tap.
    quick = quick * np.sign(quick[np.argmax(np.abs(quick))])
    (noise,) = white_noises(x.values[None])
    loud = np.flatnonzero(quick > max(LEAST_SHARE * float(quick.max()), LEAST_TO_NOISE * noise))
    if loud.size == 0:
        return whole
    breaks = np.flatnonzero(np.diff(loud) > PAUSE_S / x.dt_s)
    ends, begins = loud[breaks], loud[breaks + 1]
    cuts = [int(max((end + begin) // 2, end + 1)) for end, begin in zip(ends, begins, strict=True)]
    return list(zip([0, *cuts], [*cuts, x.values.size], strict=True))


def white_noises(values: FloatArray) -> list[float]:
    """Rms of the white noise in each recording (m, n), from its differences, to which the smooth tap adds little."""
    steps = values[:, 1:] - values[:, :-1]
    steps -= medians(steps)[:, None]
    found: list[float] = (medians(np.abs(steps, out=steps)) / (NORMAL_QUARTILE * math.sqrt(2))).tolist()
    return found


class Piece(NamedTuple):
    """One tap of a file.

    Attributes
    ----------
    name : name of the tap: that of the file, with the tap's number if there are several.
    number, taps : number of the tap from 1, and how many the file has.
    first, end : its samples.
    peak_s : time of its largest deviation from rest.
    """

    name: str
    number: int
    taps: int
    first: int
    end: int
    peak_s: float


def pieces(name: str, x: Signal, wanted: Mapping[str, Sequence[int]]) -> list[Piece]:
    """The taps to take from a file: all, unless a pattern that matches its name selects some by number, from 1.

    Raises
    ------
    InputError : the file does not have a selected tap.
    """
    parts, away = bounds(x), np.abs(x.values - np.median(x.values))
    count = len(parts)
    peaks_s = [x.start_s + x.dt_s * (first + int(np.argmax(away[first:end]))) for first, end in parts]
    own = [taps for pattern, taps in wanted.items() if fnmatchcase(name, pattern)]
    numbers = sorted({number for taps in own for number in taps}) if own else list(range(1, count + 1))
    beyond = [number for number in numbers if number > count]
    if beyond:
        at = ", ".join(f"{time:.4g}" for time in peaks_s)
        has = f"{count} tap{'s' * (count > 1)}, at {at} s"
        raise InputError(f"{name}: tap {beyond[0]} is not there, the file has {has}: choose 1 to {count}")
    called = [f"{name}#{n}" if count > 1 else name for n in numbers]
    return [Piece(one, n, count, *parts[n - 1], peaks_s[n - 1]) for one, n in zip(called, numbers, strict=True)]


def split(recording: Recording, wanted: Mapping[str, Sequence[int]]) -> list[Recording]:
    """The selected taps of a file; the recording itself if it holds one tap.

    Parameters
    ----------
    wanted : pattern of file names -> taps to take, counted from 1.

    Raises
    ------
    InputError : the file does not have a selected tap.
    """
    found = []
    for tap in pieces(recording.name, recording.acceleration, wanted):
        if tap.taps == 1:
            return [recording]
        cut: dict[str, Any] = {
            name: signal.part(tap.first, tap.end)
            for name in SIGNALS
            if (signal := getattr(recording, name)) is not None
        }
        note = f"tap {tap.number} of {tap.taps} in {recording.name}, peak at {tap.peak_s:.4g} s"
        found.append(replace(recording, name=tap.name, notes=(*recording.notes, note), **cut))
    return found
