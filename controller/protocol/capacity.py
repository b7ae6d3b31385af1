"""Capacities and limits of a device, in one place for the generated C header, the host and its messages."""

import math
from dataclasses import dataclass

from transopt.base.errors import InputError

LEASE_LEAST_MS, LEASE_MOST_MS, LEASE_DEFAULT_MS = 50, 1000, 200
TRIAL_GAIN = 0.1  # of the tap that the bring-up check ends with
REST_SPEED_M_S = 0.05  # ARM is refused while the stylus moves faster
LINK_SILENCE_MS = 1000  # a host that was silent for so long gets no telemetry and no events until it speaks
EVENT_REPEAT_MS = 50  # an event that is not acknowledged is sent again after this
EVENT_WINDOW, EVENT_QUEUE = 8, 64  # events in flight, events kept
TELEMETRY_HOLD_MS = 10  # no record waits longer for its batch to fill
LONGEST_S = 3600.0  # of any duration in a configuration: ticks are counted in 32 bits
ENCODER_MOST_COUNTS = 1 << 29  # further out the sums of the approach's fit would overflow 64 bits
REST_BETWEEN_PULSES_S = 0.1  # before each pulse: the second half of it says what the sensors read at rest
PULSE_LEASE_MS = 500  # pulses end when no LEASE has come for so long
PULSE_USUAL_A, PULSE_LEAST_PART = 0.1, 0.1  # pairs below this part of it, or of the hardware's pulse, prove nothing
# A pulse of a pair after which no other one follows: its current and its push, on what was asked and predicted. Wider
# than what is sound, since a hand trembles; the mean over all pulses is judged more narrowly.
WRONG_PULSE_LEAST, WRONG_PULSE_MOST = 0.5, 1.5
WRONG_PUSH_LEAST, WRONG_PUSH_MOST = 0.3, 2.0
# A trial in which no more flowed than these parts of the hardware's current and of the library's peak proves nothing.
TRIAL_HARDWARE_PART, TRIAL_LIBRARY_PART = 5e-4, 0.01
PATH_LEAST_COUNTS = 5  # a shorter predicted path says nothing: the encoder rounds
EVIDENCE_LEAST, EVIDENCE_MOST = 0.8, 1.2  # of every ratio of measured on predicted
# How the encoder's motion is compared with the accelerometer's before a trial's contact: readings are taken together
# over a block, filtered alike at this rate, multiplied over this time; the filter has settled after so long.
MOTION_BLOCK_S, MOTION_RATE_1_S, MOTION_S, MOTION_SETTLED_S = 1e-3, 6.0, 0.5, 2.0
MOTION_LEAST_M, MOTION_ALIKE = 5e-4, 0.8  # rms and correlation of what can be compared


def checked(name: str, value: float, low: float, high: float, unit: str = "") -> float:
    """The value of a request to a device, checked against its limits; `options.within` checks those of a command.

    Raises
    ------
    InputError : the value is outside the limits or NaN.
    """
    if not low <= value <= high:
        raise InputError(f"{name} = {value:g}{unit}: must be {low:g} to {high:g}{unit}")
    return value


@dataclass(frozen=True, slots=True)
class Capacity:
    """Capacity of one device, all chosen at its build; the default is that of the host build.

    Attributes
    ----------
    samples : int16 samples of all waveforms of a library together, where an 8-bit count takes half a sample; the
        device holds two libraries of this size.
    speeds, grips : nodes of the axes. waveform_samples : samples of one waveform.
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
    """Limits of amplifier and motor that are compiled into a port; a host may only request less.

    Attributes
    ----------
    dt_s : servo period of the timer.
    current_A : largest true current, for every amplifier pole in the range below and holds of exactly one period;
        td_ring.h has the bound for holds that are longer, but not yet late.
    command_A : largest command to the amplifier.
    pulse_A, pulse_s : largest size and length of a test pulse.
    pole_least_Hz, pole_most_Hz : range of the amplifier's pole.
    over_current_A : a larger raw reading of the current monitor is a fault in every state.
    has_coil : whether the motor's coil is known; if not, the following numbers are zero.
    R_ohm : resistance of the winding at 25 C.
    R_wh_K_W, R_ha_K_W : thermal resistance from winding to housing and from housing to ambient.
    tau_w_s, tau_h_s : their time constants.
    limit_C : temperature limit of the winding. ambient_C : highest ambient temperature.
    """

    dt_s: float = 1e-4
    current_A: float = 10.0
    command_A: float = 10.0
    pulse_A: float = 0.1
    pulse_s: float = 0.02
    pole_least_Hz: float = 50.0
    pole_most_Hz: float = 20e3
    over_current_A: float = 50.0
    has_coil: bool = False
    R_ohm: float = 0.0
    R_wh_K_W: float = 0.0
    R_ha_K_W: float = 0.0
    tau_w_s: float = 0.0
    tau_h_s: float = 0.0
    limit_C: float = 0.0
    ambient_C: float = 0.0

    def __post_init__(self) -> None:
        sizes = ["dt_s", "current_A", "command_A", "pulse_A", "pulse_s", "pole_least_Hz", "over_current_A"]
        sizes += ["R_ohm", "R_wh_K_W", "R_ha_K_W", "tau_w_s", "tau_h_s"] if self.has_coil else []
        for name in sizes:
            if not 0 < getattr(self, name) < math.inf:
                raise InputError(f"hardware: {name} = {getattr(self, name):g}: must be > 0 and finite")
        if not self.pole_least_Hz <= self.pole_most_Hz < math.inf:
            raise InputError(
                f"hardware: pole_most_Hz = {self.pole_most_Hz:g}: must be at least pole_least_Hz and finite"
            )
        if self.has_coil and not -math.inf < self.ambient_C < self.limit_C < math.inf:
            raise InputError(
                f"hardware: limit_C = {self.limit_C:g}: must be above ambient_C = {self.ambient_C:g} and finite"
            )
