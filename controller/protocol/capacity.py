"""What a device holds and allows: one place for the generated C header, the host and its messages."""

from dataclasses import dataclass

from transopt.base.errors import InputError

PULSE_LIMIT_A, PULSE_LIMIT_S = 0.1, 0.02  # of the polarity test
LEASE_LEAST_MS, LEASE_MOST_MS, LEASE_DEFAULT_MS = 50, 1000, 200
TRIAL_GAIN = 0.1  # of the tap that the bring-up check ends with
REST_SPEED_M_S = 0.05  # ARM is refused while the stylus moves faster
LINK_SILENCE_MS = 1000  # a host that was silent for so long gets no telemetry and no events until it speaks
EVENT_REPEAT_MS = 50  # an event that is not acknowledged is sent again after this
EVENT_WINDOW, EVENT_QUEUE = 8, 64  # events in flight, events kept
TELEMETRY_HOLD_MS = 10  # no record waits longer for its batch to fill
LONGEST_S = 3600.0  # of any duration in a configuration: ticks are counted in 32 bits
ENCODER_MOST_COUNTS = 1 << 29  # further out the sums of the approach's fit would overflow 64 bits


def checked(name: str, value: float, low: float, high: float, unit: str = "") -> float:
    """The value of what a device is asked for, if it lies within its limits; `options.within` is for a command's.

    Raises
    ------
    InputError : it does not, or is no number.
    """
    if not low <= value <= high:
        raise InputError(f"{name} = {value:g}{unit}: must be {low:g} to {high:g}{unit}")
    return value


@dataclass(frozen=True, slots=True)
class Capacity:
    """Of one device, all chosen at its build; the default is that of the host build.

    Attributes
    ----------
    samples : int16 samples of all waveforms of a library together; two libraries of this size are held.
    speeds, grips : nodes of the axes. waveform_samples : of one waveform.
    approach_ticks : `Settings.window_ticks`. latency_ticks : `Wall.latency_ticks`.
    upload_frames : frames of DATA in flight before an ACK.
    """

    samples: int = 262_144
    speeds: int = 64
    grips: int = 64
    waveform_samples: int = 20_000
    approach_ticks: int = 256
    latency_ticks: int = 31
    upload_frames: int = 16


@dataclass(frozen=True, slots=True)
class Hardware:
    """What the amplifier behind a device is good for: no configuration may ask for more [A], servo period [s]."""

    current_A: float = 10.0
    command_A: float = 10.0
    dt_s: float = 1e-4
