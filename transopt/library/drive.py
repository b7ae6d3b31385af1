"""The waveform sent to a driver: the command of an entry, at the driver's rate and in its counts.

A library holds each command over one period of the design. A driver holds each of its samples over a period of its
own, 1 / rate. Each sample is therefore the mean of the command over one period of the driver:

- among all waveforms that the driver can hold, it is nearest to the command in least squares (the projection of one
  staircase onto the other);
- at a whole multiple of the design's rate it is the command itself, each of its values repeated;
- it keeps the integral of the command over every period, which is what a plant slower than the driver responds to;
- a mean of admissible commands is admissible: it exceeds neither full scale nor the input limit, starts no earlier
  and adds no delay. A polyphase low-pass would overshoot at every jump of a saturated command, and so be clipped, and
  would ring before the jump.

Unless the driver's rate is a multiple of the design's, the mean loses part of the command. `drive_replay` measures
the effect of that loss, of saturation and of rounding.
"""

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.problem.limits.limit import tolerated

LEAST_RATE_HZ, MOST_RATE_HZ = 100.0, 1e6
WHOLE = 1e-6  # samples of the driver: bound on the rounding error accumulated over a waveform


@dataclass(frozen=True)
class Depth:
    """Storage format of a driver's samples.

    Attributes
    ----------
    bits : bits per sample in a file.
    counts : the largest count; the smallest is its negative, so that the scale is symmetric. 0 means no counts:
        samples are single-precision numbers, full scale is 1.
    dtype : type of the array that holds the samples; 24 bit have no type of their own and are held in 32 bit.
    """

    bits: int
    counts: int
    dtype: type[np.generic]

    @property
    def word(self) -> str:
        """Name in a table, such as "16 bit"."""
        return f"{self.bits} bit" if self.counts else f"{self.bits} bit float"


DEPTHS: Final = MappingProxyType(
    {
        "8": Depth(8, 2**7 - 1, np.int8),
        "16": Depth(16, 2**15 - 1, np.int16),
        "24": Depth(24, 2**23 - 1, np.int32),
        "32": Depth(32, 2**31 - 1, np.int32),
        "float": Depth(32, 0, np.float32),
    }
)


@dataclass(frozen=True)
class Driver:
    """The driver that the samples are for: output `full_scale` at the largest count, each sample held for 1 / rate.

    Attributes
    ----------
    rate_Hz : samples per second.
    depth : storage format of a sample.
    full_scale : largest magnitude of its output [A or V].
    unit : unit of its output, "A" or "V".
    """

    rate_Hz: float
    depth: Depth
    full_scale: float
    unit: str

    @property
    def scale(self) -> float:
        """Output per count, or at a float sample of 1 [A or V]."""
        return self.full_scale / (self.depth.counts or 1)

    def samples(self, wanted: FloatArray) -> tuple[NDArray[Any], int]:
        """(m,) samples as stored for the desired outputs (m,), and the number of outputs beyond full scale."""
        step = self.scale if self.depth.counts else 0.0
        beyond = np.abs(wanted) > self.full_scale + max(step / 2, tolerated(self.full_scale))
        clipped = np.clip(wanted / self.scale, -(self.depth.counts or 1), self.depth.counts or 1)
        stored = np.rint(clipped) if self.depth.counts else clipped
        return stored.astype(self.depth.dtype), int(beyond.sum())


@dataclass(frozen=True)
class Drive:
    """The command of one entry, converted for a driver.

    Attributes
    ----------
    iv, ig : indices of the entry.
    name : its target, or its speed and grip.
    driver : the driver that the samples are for.
    samples : (m,) as stored: integer counts, or single-precision shares of full scale.
    saturated : number of samples clipped at full scale.
    """

    iv: int
    ig: int
    name: str
    driver: Driver
    samples: NDArray[Any]
    saturated: int

    __repr__ = brief

    @property
    def values(self) -> FloatArray:
        """(m,) output of the driver [A or V]."""
        return np.asarray(self.samples * self.driver.scale, dtype=float)

    @property
    def peak(self) -> float:
        """Largest magnitude of the output [A or V]."""
        return float(np.abs(self.values).max())


def held(command: FloatArray, periods: float) -> FloatArray:
    """(m,) mean of a held command (N,) over each period of a driver; the last period is padded with zero.

    Parameters
    ----------
    periods : driver periods per design period, dt * rate, > 0.
    """
    N = command.size
    if _repeats(periods, N):
        return np.repeat(command, round(periods))
    edges = np.arange(int(np.ceil(N * periods - WHOLE)) + 1) / periods
    integral = np.interp(edges, np.arange(N + 1), np.append(0.0, np.cumsum(command)))
    return np.asarray(np.diff(integral) * periods)


def is_multiple(library: Library, rate_Hz: float) -> bool:
    """Whether the driver plays the command unchanged: its rate is a whole multiple of the design's."""
    return _repeats(library.dt_s * rate_Hz, library.command.shape[2])


def _repeats(periods: float, stages: int) -> bool:
    """Whether a design period is a whole number of driver periods, within `WHOLE` over the entire waveform."""
    return round(periods) >= 1 and abs(periods - round(periods)) * stages <= WHOLE


def command_range(library: Library) -> float:
    """Largest possible command: the amplifier's range, or the input limit for an ideal amplifier [A or V]."""
    amplifier = library.amplifier()
    return library.input_limit if amplifier is None else amplifier.command_limit


def driver_for(
    library: Library, rate_Hz: float | None = None, bits: str = "16", full_scale: float | None = None
) -> Driver:
    """A driver for a library's commands.

    Parameters
    ----------
    rate_Hz : None means the design's rate, 1 / dt.
    bits : a name in `DEPTHS`.
    full_scale : None means `command_range`, at which nothing saturates [A or V].

    Raises
    ------
    InputError : one of them is out of its range.
    """
    unit, own_Hz = library.driven_by.unit, 1 / library.dt_s
    rate = own_Hz if rate_Hz is None else rate_Hz
    if not LEAST_RATE_HZ <= rate <= MOST_RATE_HZ:
        raise InputError(
            f"rate {rate:g} Hz: must be {LEAST_RATE_HZ:g} to {MOST_RATE_HZ:g} Hz; give the driver's with --rate-Hz "
            f"(the design's is {own_Hz:g} Hz)"
        )
    if bits not in DEPTHS:
        raise InputError(f"bits {bits!r}: must be one of {', '.join(DEPTHS)}")
    most = command_range(library) if full_scale is None else full_scale
    if not 0 < most < np.inf:
        raise InputError(
            f"full scale {most:g} {unit}: must be > 0 and finite; without --full-scale it is "
            f"{command_range(library):g} {unit}"
        )
    # Remove the rounding error of dt from a whole rate, because files state whole rates.
    rate = float(round(rate)) if abs(rate - round(rate)) <= WHOLE * 1e-3 * rate else rate
    return Driver(rate, DEPTHS[bits], most, unit)


def drive_of(library: Library, iv: int, ig: int, driver: Driver) -> Drive:
    """The total command of an entry, converted for a driver."""
    wanted = held(library.command[iv, ig], library.dt_s * driver.rate_Hz)
    samples, saturated = driver.samples(wanted)
    return Drive(iv, ig, library.axes.place(iv, ig), driver, samples, saturated)


def chosen(
    library: Library, target: str | None = None, speed_m_s: float | None = None, grip_N: float | None = None
) -> list[tuple[int, int]]:
    """Entries (iv, ig) of this target, or this speed, or this grip; all entries if none is given.

    Raises
    ------
    InputError : the library has no such target, speed or grip.
    """
    axes = library.axes
    if target is not None and not axes.targets:
        raise InputError("--target: this library has no targets but speeds and grips; choose with --speed and --grip")
    if target is not None and target not in axes.targets:
        raise InputError(
            f"--target {target!r}: this library has no such target; choose one of {', '.join(axes.targets)}"
        )
    for option, wanted, nodes, unit in (
        ("--speed", speed_m_s, axes.speeds_m_s, "m/s"),
        ("--grip", grip_N, axes.grips_N, "N"),
    ):
        if wanted is None:
            continue
        if axes.targets:
            raise InputError(f"{option}: this library has targets; choose with --target: {', '.join(axes.targets)}")
        if wanted not in nodes:
            stated = ", ".join(f"{node:g}" for node in nodes)
            raise InputError(f"{option} {wanted:g} {unit}: not on the library's grid; choose one of {stated} {unit}")
    return [
        (iv, ig)
        for iv, speed in enumerate(axes.speeds_m_s)
        for ig, grip in enumerate(axes.grips_N)
        if (target is None or axes.targets[iv] == target)
        and (speed_m_s is None or speed == speed_m_s)
        and (grip_N is None or grip == grip_N)
    ]
