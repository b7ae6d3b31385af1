"""Plan of the sweeps that identify an amplifier or a device: trials of one file each, on a port or simulated."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

from controller.record import excitation
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray

FREE_LOW_HZ = 20.0  # nothing holds a free stylus: at 1 Hz and 1 A it would go 0.8 m
MOST_TRIALS = 100
REPEATED = 0.5  # current of a multisine over that of a tap, since it lasts while a tap peaks for a moment only


class Purpose(Enum):
    """What a sweep is to identify; the value is its name on the command line and in files."""

    AMPLIFIER = "amplifier"
    DEVICE = "device"


class Shape(Enum):
    """Shape of the excitation; the value is its name in file names."""

    SWEEP = ""
    TAP = "tap"
    MULTISINE = "multisine"


class Preset(NamedTuple):
    """Default parameters of a sweep (seed Sec. 4.1 and 5)."""

    low_Hz: float
    high_Hz: float
    amplitude_A: float
    offsets_A: tuple[float, ...]
    seconds: float
    grips_N: tuple[float, ...]


PRESETS = {
    # The second offset keeps the current on one side of the crossover.
    Purpose.AMPLIFIER: Preset(10.0, 4000.0, 0.3, (0.0, 0.5), 2.0, (3.0,)),
    Purpose.DEVICE: Preset(1.0, 2000.0, 0.75, (0.0,), 2.0, (1.0, 3.0, 5.0)),
}


@dataclass(frozen=True)
class PlannedSweep:
    """One sweep; or, at the current of use, a burst like a tap's or a multisine.

    Attributes
    ----------
    grip_N : grip at which the stylus is held still; 0 for the free device. number : from 1, among equal trials.
    polarity : +1 or -1, of sine and offset together.
    shape : shape of the excitation; only sweeps are fitted.
    """

    purpose: Purpose
    grip_N: float
    number: int
    polarity: int
    low_Hz: float
    high_Hz: float
    amplitude_A: float
    offset_A: float
    seconds: float
    shape: Shape = Shape.SWEEP

    def command(self, dt_s: float) -> FloatArray:
        """(N,) command to be issued at k dt and held [A].

        Raises
        ------
        InputError : see `excitation`.
        """
        if self.shape is Shape.TAP:
            return self.polarity * excitation.tap_command(self.amplitude_A, dt_s)
        if self.shape is Shape.MULTISINE:
            return self.polarity * excitation.multisine_command(self.amplitude_A, dt_s)
        sweep = excitation.sweep_command(
            self.low_Hz, self.high_Hz, self.seconds, self.amplitude_A, dt_s, self.offset_A
        )
        return self.polarity * sweep

    def period_s(self, dt_s: float) -> float | None:
        """Period of the excitation; None for one that does not repeat."""
        return excitation.multisine_period_s(dt_s) if self.shape is Shape.MULTISINE else None

    @property
    def file_name(self) -> str:
        shape = f"_{self.shape.value}" if self.shape is not Shape.SWEEP else ""
        offset = shape or (f"_{self.offset_A:g}A" if self.offset_A else "")
        sign = "pos" if self.polarity > 0 else "neg"
        return f"{self.purpose.value}_{self.grip_N:g}N{offset}_{self.number}_{sign}.npz"


def sweep_plan(
    purpose: Purpose,
    grips_N: Sequence[float] | None,
    trials: int,
    *,
    low_Hz: float | None = None,
    high_Hz: float | None = None,
    amplitude_A: float | None = None,
    offset_A: float | None = None,
    seconds: float | None = None,
    tap_A: float | None = None,
) -> list[PlannedSweep]:
    """Trials grip by grip and offset by offset, of alternating polarity; a parameter of None is taken from `PRESETS`.

    Parameters
    ----------
    trials : number of trials at each grip and offset.
    tap_A : largest current of use: at each grip, after its sweeps, two bursts like a tap's, of either sign, and a
        multisine of half that current; None for none.

    Raises
    ------
    InputError : a number out of its range.
    """
    preset = PRESETS[purpose]
    grips = preset.grips_N if grips_N is None else tuple(grips_N)
    if not grips:
        raise InputError("--grips: name at least one grip in N, like 1,3,5; 0 is the free device")
    for grip in grips:
        if not 0 <= grip <= 50:
            raise InputError(f"--grips {grip:g}: must be 0 to 50 N, what a hand does")
    if len(set(grips)) < len(grips):
        raise InputError(f"--grips {','.join(f'{grip:g}' for grip in grips)}: each grip once")
    if not 1 <= trials <= MOST_TRIALS:
        raise InputError(f"--trials {trials}: must be 1 to {MOST_TRIALS}")
    planned = []
    for grip in grips:
        lowest = max(preset.low_Hz, FREE_LOW_HZ) if grip == 0 else preset.low_Hz
        for offset in preset.offsets_A if offset_A is None else (offset_A,):
            for number in range(1, trials + 1):
                trial = PlannedSweep(
                    purpose=purpose,
                    grip_N=grip,
                    number=number,
                    polarity=1 if number % 2 else -1,
                    low_Hz=lowest if low_Hz is None else low_Hz,
                    high_Hz=preset.high_Hz if high_Hz is None else high_Hz,
                    amplitude_A=preset.amplitude_A if amplitude_A is None else amplitude_A,
                    offset_A=offset,
                    seconds=preset.seconds if seconds is None else seconds,
                )
                planned.append(trial)
        if tap_A is not None:
            tap = replace(planned[-1], amplitude_A=tap_A, offset_A=0.0, seconds=excitation.TAP_S, shape=Shape.TAP)
            planned += [replace(tap, number=number, polarity=sign) for number, sign in ((1, 1), (2, -1))]
            lasting = excitation.PERIODS * excitation.PERIOD_S + excitation.FADE_S
            repeated = replace(tap, amplitude_A=REPEATED * tap_A, seconds=lasting, shape=Shape.MULTISINE)
            planned.append(replace(repeated, number=1, polarity=1))
    return planned
