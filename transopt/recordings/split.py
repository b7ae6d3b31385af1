"""Several taps in one file: where each begins and ends, and which of them a user has chosen.

A session is often recorded in one go. Taken as one tap it would be the tap of its highest peak, and the others would
be what rings behind it; so it is cut into its taps, each a record of its own with the name `FILE#2`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.filters import highpass
from transopt.base.signals import FloatArray, Signal, median
from transopt.recordings.recording import Recording

PAUSE_S = 0.1  # between two taps: a rebound comes sooner and belongs to its tap, no hand taps as fast
LEAST_SHARE = 0.15  # of the highest peak: taps of 0.1 and 0.4 m/s differ by a factor of four
LEAST_TO_NOISE = 10.0  # times its rms: the highest of a million samples of noise is five times as large
NORMAL_QUARTILE = 0.6744897501960817  # median of |x| of normally distributed x, in standard deviations
START_S = 2e-3
SLOWEST_HZ = 8.0  # below it the hand moves and turns the sensor in the earth's field
SIGNALS = ("acceleration", "position", "force", "current", "across_1", "across_2")  # of a recording


def bounds(x: Signal) -> list[tuple[int, int]]:
    """First sample and end of every tap of a signal, in order; the whole signal where there is one tap or none.

    A tap is where the signal without its slow share exceeds a threshold in the direction of its highest peak,
    together with all that follows less than `PAUSE_S` later. Two taps are parted in the middle of the quiet stretch
    between them.
    """
    whole = [(0, x.values.size)]
    if x.values.size * x.dt_s < PAUSE_S or x.rate_Hz < 5 * SLOWEST_HZ:
        return whole
    # From the level that the file begins with, or the filter would see a step there.
    rest = np.median(x.values[: max(int(START_S / x.dt_s), 1)])
    quick = highpass(replace(x, values=x.values - rest), SLOWEST_HZ).values
    # A force that is let go, or a stylus that is lifted, moves the other way than a tap.
    quick = quick * np.sign(quick[np.argmax(np.abs(quick))])
    loud = np.flatnonzero(quick > max(LEAST_SHARE * float(quick.max()), LEAST_TO_NOISE * white_noise(x)))
    if loud.size == 0:
        return whole
    breaks = np.flatnonzero(np.diff(loud) > PAUSE_S / x.dt_s)
    ends, begins = loud[breaks], loud[breaks + 1]
    cuts = [int(max((end + begin) // 2, end + 1)) for end, begin in zip(ends, begins, strict=True)]
    return list(zip([0, *cuts], [*cuts, x.values.size], strict=True))


def white_noise(x: Signal) -> float:
    """Size (rms) of the white noise in a recording, from its steps: the tap itself is smooth and adds little."""
    steps = x.values[1:] - x.values[:-1]
    return median(np.abs(steps - median(steps))) / (NORMAL_QUARTILE * math.sqrt(2))


def _cut(x: Signal, first: int, end: int) -> Signal:
    return Signal(x.start_s + first * x.dt_s, x.dt_s, x.values[first:end])


def peak_times(x: Signal, pieces: Sequence[tuple[int, int]]) -> FloatArray:
    """(n,) time of the largest deviation from rest in each piece [s]."""
    away = np.abs(x.values - np.median(x.values))
    return np.array([x.start_s + x.dt_s * (first + int(np.argmax(away[first:end]))) for first, end in pieces])


def chosen(name: str, count: int, times_s: FloatArray, wanted: Mapping[str, Sequence[int]]) -> list[int]:
    """Which taps of a file to take, counted from 1: all, unless a pattern that its name matches says which.

    Raises
    ------
    InputError : a tap that the file does not have.
    """
    own = [taps for pattern, taps in wanted.items() if fnmatchcase(name, pattern)]
    numbers = sorted({number for taps in own for number in taps}) if own else list(range(1, count + 1))
    beyond = [number for number in numbers if number > count]
    if beyond:
        at = ", ".join(f"{time:.4g}" for time in times_s)
        has = f"{count} tap{'s' * (count > 1)}, at {at} s"
        raise InputError(f"{name}: tap {beyond[0]} is not there, the file has {has}: choose 1 to {count}")
    return numbers


def split(recording: Recording, wanted: Mapping[str, Sequence[int]]) -> list[Recording]:
    """The chosen taps of a file; the recording itself where it holds one.

    Parameters
    ----------
    wanted : pattern of file names -> taps to take, counted from 1.

    Raises
    ------
    InputError : a tap that the file does not have.
    """
    pieces = bounds(recording.acceleration)
    times_s = peak_times(recording.acceleration, pieces)
    numbers = chosen(recording.name, len(pieces), times_s, wanted)
    if len(pieces) == 1:
        return [recording]
    signals = {name: getattr(recording, name) for name in SIGNALS}
    found = []
    for number in numbers:
        first, end = pieces[number - 1]
        cut: dict[str, Any] = {
            name: None if signal is None else _cut(signal, first, end) for name, signal in signals.items()
        }
        note = f"tap {number} of {len(pieces)} in {recording.name}, peak at {times_s[number - 1]:.4g} s"
        named = f"{recording.name}#{number}"
        found.append(replace(recording, name=named, notes=(*recording.notes, note), **cut))
    return found
