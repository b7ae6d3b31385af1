"""What a driver is sent: the command of an entry at the driver's rate and in its counts.

The command of a library is held over every period of the design. A driver holds each of its samples over a period of
its own, 1 / rate. What leaves is therefore the mean of the command over each period of the driver:

- of all waveforms that the driver can hold, it is the one nearest to the command in least squares (the projection of
  one staircase onto the other);
- at a whole multiple of the design's rate it is the command itself, each of its values repeated;
- the integral of the command, which is what a plant slower than the driver answers to, is kept over every period;
- a mean of admissible commands is admissible: it leaves neither full scale nor the limit of the input, it starts no
  earlier and adds no delay. A polyphase low-pass overshoots at every jump of a saturated command, so that it would be
  clipped, and rings before it.

What the mean loses between two rates that are no multiples of each other is counted by `drive_replay`, as are
saturation and rounding.
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
WHOLE = 1e-6  # of a sample of the driver: what rounding may add up to over a waveform


@dataclass(frozen=True)
class Depth:
    """How a driver's samples are stored.

    Attributes
    ----------
    bits : of a sample in a file.
    counts : the largest count; the smallest is its negative, so that the scale is symmetric. 0: no counts, samples
        are single-precision numbers with full scale at 1.
    dtype : of the array that holds them; 24 bit have none of their own and stand in 32.
    """

    bits: int
    counts: int
    dtype: type[np.generic]

    @property
    def word(self) -> str:
        """In a table: "16 bit"."""
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
    """What the samples are for: it puts out `full_scale` at the largest count and holds each over 1 / rate.

    Attributes
    ----------
    rate_Hz : samples per second.
    depth : of a sample.
    full_scale : largest size of its output [A or V].
    unit : "A" or "V".
    """

    rate_Hz: float
    depth: Depth
    full_scale: float
    unit: str

    @property
    def scale(self) -> float:
        """Value of one count, or of a float's 1 [A or V]."""
        return self.full_scale / (self.depth.counts or 1)

    def samples(self, wanted: FloatArray) -> tuple[NDArray[Any], int]:
        """(m,) as stored, for outputs (m,) that are wanted; and how many of them are beyond full scale."""
        step = self.scale if self.depth.counts else 0.0
        beyond = np.abs(wanted) > self.full_scale + max(step / 2, tolerated(self.full_scale))
        clipped = np.clip(wanted / self.scale, -(self.depth.counts or 1), self.depth.counts or 1)
        stored = np.rint(clipped) if self.depth.counts else clipped
        return stored.astype(self.depth.dtype), int(beyond.sum())


@dataclass(frozen=True)
class Drive:
    """The command of one entry as it leaves.

    Attributes
    ----------
    iv, ig : which entry.
    name : its target, or its speed and grip.
    driver : that it is for.
    samples : (m,) as stored, integer counts or single-precision shares of full scale.
    saturated : how many of them lie at full scale because more was wanted.
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
        """(m,) what the driver puts out [A or V]."""
        return np.asarray(self.samples * self.driver.scale, dtype=float)

    @property
    def peak(self) -> float:
        """Largest size of it [A or V]."""
        return float(np.abs(self.values).max())


def held(command: FloatArray, periods: float) -> FloatArray:
    """(m,) mean of a held command (N,) over each period of a driver, the last one filled up with zero.

    Parameters
    ----------
    periods : of the driver in one of the design, dt * rate, > 0.
    """
    N = command.size
    if _repeats(periods, N):
        return np.repeat(command, round(periods))
    edges = np.arange(int(np.ceil(N * periods - WHOLE)) + 1) / periods
    integral = np.interp(edges, np.arange(N + 1), np.append(0.0, np.cumsum(command)))
    return np.asarray(np.diff(integral) * periods)


def is_multiple(library: Library, rate_Hz: float) -> bool:
    """Whether a command leaves at this rate as it is: a whole multiple of the design's."""
    return _repeats(library.dt_s * rate_Hz, library.command.shape[2])


def _repeats(periods: float, stages: int) -> bool:
    """Whether a driver has a whole number of periods in one of the design, over a whole waveform."""
    return round(periods) >= 1 and abs(periods - round(periods)) * stages <= WHOLE


def command_range(library: Library) -> float:
    """The largest command that there may be: the amplifier's range, or the input's limit without one [A or V]."""
    amplifier = library.amplifier()
    return library.input_limit if amplifier is None else amplifier.command_limit


def driver_for(
    library: Library, rate_Hz: float | None = None, bits: str = "16", full_scale: float | None = None
) -> Driver:
    """A driver for a library's commands.

    Parameters
    ----------
    rate_Hz : None is the design's, 1 / dt.
    bits : a name in `DEPTHS`.
    full_scale : None is `command_range`, so that nothing saturates [A or V].

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
    # What rounding of dt leaves of a whole rate is taken off: files state whole numbers.
    rate = float(round(rate)) if abs(rate - round(rate)) <= WHOLE * 1e-3 * rate else rate
    return Driver(rate, DEPTHS[bits], most, unit)


def drive_of(library: Library, iv: int, ig: int, driver: Driver) -> Drive:
    """The total command of an entry as it leaves for a driver."""
    wanted = held(library.command[iv, ig], library.dt_s * driver.rate_Hz)
    samples, saturated = driver.samples(wanted)
    return Drive(iv, ig, library.axes.place(iv, ig), driver, samples, saturated)


def chosen(
    library: Library, target: str | None = None, speed_m_s: float | None = None, grip_N: float | None = None
) -> list[tuple[int, int]]:
    """Entries (iv, ig) of a target, of a speed, of a grip; all where none is asked for.

    Raises
    ------
    InputError : what the library does not have.
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
