"""Settings of the servo: plain numbers, checked once and frozen."""

import math
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from transopt.base.errors import InputError
from transopt.base.writing import rounded_up
from transopt.library.library import Library
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import CoilModel
from transopt.plant.wall import Wall
from transopt.problem.limits.slew import SlewLimit
from transopt.problem.warm_coil import LEAST_SCALE, WITHHOLD_K

SCALE_LEAST, SCALE_MOST = 0.2, 5.0  # range of |scale| in a calibration: beyond it something else is wrong
SHORTEST_DT_S, LONGEST_DT_S = 5e-5, 1e-3  # servo periods of 20 to 1 kHz
PULSE_NODES = 4
DELAY_TICKS = 4  # largest delay of an amplifier in servo periods
ROUNDED_TICKS = 1e-9
# Amplifier and motor of the built-in device (a Maxon RE 25), assumed where neither a library nor the device says.
AMPLIFIER = Amplifier(1050.0, 68e-6, 6.0)
RE_25 = CoilModel(R_ohm=2.18, R_wh_K_W=3.1, R_ha_K_W=14.0, tau_w_s=12.0, tau_h_s=612.0, limit_C=100.0)
PUSH_S = 5e-3  # part of a pulse over which the acceleration is compared with its prediction
SCALES = ("acceleration_scale", "grip_scale", "monitor_scale", "amplifier_scale")
SIGNED = ("grip_open_N", "surface_counts", "encoder_direction", "acceleration_rest_m_s2", "grip_zero_N", *SCALES)
MAY_BE_ZERO = (
    "lead_s",
    "amplifier_tolerance",
    "rearm_s",
    "grip_filter_s",
    "grip_margin_N",
    "grid_slack",
    "grid_slack_N",
    "withhold_K",
    "grip_min_N",
    "assumed_grip_N",
)


@dataclass(frozen=True)
class Settings:
    """Settings of one servo; `of` derives them from a library.

    Attributes
    ----------
    dt_s, lead_s : servo period, and time by which a waveform starts before contact.
    current_limit_A : beta * i_ss, limit on |i| of transient and feedback together (seed Eq. 8).
    amplifier : model of the amplifier; None for an ideal one, i = c.
    amplifier_tolerance : largest relative error of the amplifier's pole, below 1. The clamp keeps the current limit
        for every such pole, at the cost of some error where taps saturate (0.7 % at 10 %). With 0, a pole that is
        10 % faster drives a tap of the built-in library from 4 A to 4.14 A, one that is 20 % faster to 4.34 A.
    wall : None renders only the transient.
    coil : None if unknown: then there is no thermal guard, and the winding's temperature is NaN.
    slew_limit_A_per_s : slew limit of the command; None for no limit.
    grip_min_N : no transient starts below it, and falling below it while one plays is a fault (4 A on a free stylus
        gives 13 g); 0 for a library of the free device, which nobody holds.
    assumed_grip_N : grip of a device without a grip sensor, whose readings are ignored; None with a sensor.

    count_m : encoder resolution at the tip. surface_counts : reading at the surface. An encoder that rounds down
        reads half a count less than one that rounds to nearest; at 0.1 m/s half a count is a tick.
    window_ticks : window of the fit to the approach, chosen by measurement, see td_approach.h of the core.
    least_speed_m_s : a slower touch is no tap; well above the fit's noise of at most 1 mm/s.
    touch_height_m : the stylus has left the surface when it is above this height (four counts) and moves out.
    rearm_height_m, rearm_s : another tap plays only after this time above this height. Rebounds of the stylus and a
        trembling hand on the surface stay lower or are shorter; a hand that taps ten times a second is longer above.
    grip_filter_s : time constant of the smoothed grip. A grip changes within tens of ms, noise within ticks.
    grip_margin_N : margin above `grip_min_N` at which a transient may start, so that noise does not abort it.
    grid_slack, grid_slack_N : relative speed and grip by which a contact may lie outside the grid before it is
        reported: the errors of sensors and fit, so that taps on the edge are not reported.
    gain_rate_1_s : rate at which the gain follows a change: from 0 to 1 in 0.1 s, without a bang.

    withhold_K : no transient starts within this margin below the coil's limit; feedback continues. A tap heats by
        0.2 K at most, a minute on the wall by more.
    least_scale : a transient is withheld if the coil's heat allows less than this share. A fifth in amplitude is
        noticeable, and a fourth of a tap no longer feels like the same material.

    encoder_limit_counts : no device moves further. fastest_m_s : no hand moves faster, and no free stylus under 4 A
        within 20 ms.
    current_range_A : range of the current sensor; larger readings are absurd. over_current : measured current over
        `current_limit_A` that is a fault, with a margin for noise and model error.
    no_current_A, no_current_part, no_current_s : fault if at least this current is expected and less than this share
        of it is measured, for this time: a few ticks, since the two may differ when the sign changes.
    stuck_A_s : impulse of the transient's strokes (above `stuck_A`) without a count. On a hard surface a hand with a
        tremor of 60 um stays within one count for 31 ms, 0.12 A s at 4 A.
    stuck_A, stuck_s : current and time without a count, or with an encoder that only turns between two of them; a
        hand's tremor of 4 counts allows neither.
    grip_open_N, grip_short_N : readings below and above are those of an open and of a shorted sensor.

    encoder_direction, acceleration_scale, acceleration_rest_m_s2, has_accelerometer, grip_scale, grip_zero_N,
    monitor_scale, amplifier_scale : calibration of sensors and amplifier by the device's owner. The device first
        corrects its raw readings: counts times direction, acceleration times scale minus rest, grip times scale minus
        zero, current times scale. It divides the command by `amplifier_scale`, the ratio of current to command.
    pulse_A, pulse_ticks : the test pulse by which the device checks its wiring.
    pulse_grip_N, pulse_acceleration, pulse_path_m : predicted response to it per ampere, at up to PULSE_NODES
        increasing grips: mean acceleration [m/s^2 per A] over `pulse_push_ticks` readings from `pulse_skip_ticks` on,
        and path [m per A] from the reading at the pulse's first command to the one `pulse_ticks` later. Empty: there
        is no prediction, and so no evidence.

    host_starts : the host starts the single waveform, an excitation, and contacts are ignored; without a wall. If the
        stylus is held at the start it must be held to the end; a free device can be excited too.
    """

    dt_s: float
    lead_s: float
    current_limit_A: float
    amplifier: Amplifier | None = None
    amplifier_tolerance: float = 0.0
    wall: Wall | None = None
    coil: CoilModel | None = None
    slew_limit_A_per_s: float | None = None
    grip_min_N: float = 0.5
    assumed_grip_N: float | None = None

    count_m: float = 24.5e-6
    surface_counts: float = 0.0
    window_ticks: int = 100
    least_speed_m_s: float = 0.02
    touch_height_m: float = 1e-4
    rearm_height_m: float = 5e-4
    rearm_s: float = 5e-3
    grip_filter_s: float = 5e-3
    grip_margin_N: float = 0.1
    grid_slack: float = 0.02
    grid_slack_N: float = 0.1
    gain_rate_1_s: float = 10.0

    withhold_K: float = WITHHOLD_K
    least_scale: float = LEAST_SCALE

    encoder_limit_counts: int = 1_000_000
    fastest_m_s: float = 5.0
    current_range_A: float = 50.0
    over_current: float = 1.25
    no_current_A: float = 0.5
    no_current_part: float = 0.25
    no_current_s: float = 1e-3
    stuck_A_s: float = 0.15
    stuck_A: float = 0.5
    stuck_s: float = 1.0
    grip_open_N: float = -1.0
    grip_short_N: float = 60.0

    encoder_direction: int = 1
    acceleration_scale: float = 1.0
    acceleration_rest_m_s2: float = 0.0
    has_accelerometer: bool = True
    grip_scale: float = 1.0
    grip_zero_N: float = 0.0
    monitor_scale: float = 1.0
    amplifier_scale: float = 1.0
    pulse_A: float = 0.1
    pulse_ticks: int = 50
    pulse_grip_N: tuple[float, ...] = ()
    pulse_acceleration: tuple[float, ...] = ()
    pulse_path_m: tuple[float, ...] = ()

    host_starts: bool = False

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, int | float) or isinstance(value, bool) or field.name in SIGNED:
                continue
            least = 0.0 if field.name in MAY_BE_ZERO else np.nextafter(0.0, 1.0)
            if not least <= value < np.inf:
                sign = ">= 0" if field.name in MAY_BE_ZERO else "> 0"
                raise InputError(f"servo: {field.name} = {value:g}: must be {sign} and finite")
        if not (np.isfinite(self.surface_counts) and -np.inf < self.grip_open_N < self.grip_short_N):
            raise InputError("servo: surface_counts and grip_open_N must be finite, grip_open_N below grip_short_N")
        self._check_calibration()
        self._check_pulse()
        if self.delay_s > (DELAY_TICKS + ROUNDED_TICKS) * self.dt_s:
            raise InputError(
                f"amplifier.delay_s = {1e3 * self.delay_s:g} ms: a device follows an amplifier that is late by up to "
                f"{DELAY_TICKS} servo periods, {1e3 * DELAY_TICKS * self.dt_s:g} ms: take one with less delay, or "
                f"time.dt_s of {rounded_up(self.delay_s / DELAY_TICKS):g} s or more"
            )
        if self.amplifier_tolerance >= 1:
            raise InputError(f"servo: amplifier_tolerance = {self.amplifier_tolerance:g}: must be below 1")
        if self.host_starts and self.wall is not None:
            raise InputError("servo: host_starts beside a wall: an excitation has no feedback")
        if self.window_ticks < 4:
            raise InputError(f"servo: window_ticks = {self.window_ticks}: a quadratic needs at least 4 readings")

    def _check_calibration(self) -> None:
        if self.encoder_direction not in (1, -1):
            raise InputError(f"servo: encoder_direction = {self.encoder_direction:g}: must be 1 or -1")
        for name in SCALES:
            if not SCALE_LEAST <= abs(getattr(self, name)) <= SCALE_MOST:
                raise InputError(
                    f"servo: {name} = {getattr(self, name):g}: its size must be {SCALE_LEAST:g} to {SCALE_MOST:g}"
                )
        for name in ("acceleration_rest_m_s2", "grip_zero_N"):
            if not np.isfinite(getattr(self, name)):
                raise InputError(f"servo: {name} must be finite")

    def _check_pulse(self) -> None:
        nodes, table = self.pulse_grip_N, (self.pulse_grip_N, self.pulse_acceleration, self.pulse_path_m)
        if len({len(column) for column in table}) != 1 or len(nodes) > PULSE_NODES:
            raise InputError(
                f"servo: the pulse's prediction must have at most {PULSE_NODES} nodes, alike in all three"
            )
        sound = np.all(np.isfinite(np.array(table))) and np.all(np.diff(nodes) > 0) and all(g >= 0 for g in nodes)
        if not sound or any(value <= 0 for value in (*self.pulse_acceleration, *self.pulse_path_m)):
            raise InputError("servo: the pulse's prediction must be > 0 and finite, over grips that increase")

    @classmethod
    def of(cls, library: Library, **others: Any) -> Self:
        """Settings for a library; `others` override what it says and the defaults."""
        coil = library.coil()
        known: dict[str, Any] = {
            "dt_s": library.dt_s,
            "lead_s": library.lead_s,
            "current_limit_A": library.input_limit,
            "amplifier": library.amplifier(),
            "wall": library.wall(),
            "coil": None if coil is None else coil.on_a_device(),
            "slew_limit_A_per_s": library.posing().asked[SlewLimit.key],
            "grip_min_N": library.grip_min_N,
        }
        if library.grips_N[0] == 0:
            known["assumed_grip_N"] = 0.0
        return cls(**{**known, **others})

    @property
    def command_limit_A(self) -> float:
        return self.current_limit_A if self.amplifier is None else self.amplifier.command_limit

    @property
    def delay_s(self) -> float:
        return 0.0 if self.amplifier is None else self.amplifier.delay_s

    @property
    def pulse_skip_ticks(self) -> int:
        """Ticks from the first command of a pulse to the first reading after the delay that it certainly affects."""
        return math.ceil(self.delay_s / self.dt_s) + 1

    @property
    def pulse_push_ticks(self) -> int:
        """Number of readings over which the acceleration of a pulse is compared."""
        return min(self.ticks(PUSH_S), self.pulse_ticks)

    def ticks(self, duration_s: float) -> int:
        """Duration in whole servo periods, at least one."""
        return max(round(duration_s / self.dt_s), 1)
