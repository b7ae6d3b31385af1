"""Comparison of a played tap with its prediction and its recording, by the device's own sensors only.

The simulator's truth is not used: measurement and prediction are compared as a device can measure them. Contact is
where the approach, a parabola through the encoder's counts, would have met the surface. The prediction is filtered by
the accelerometer's pole. Both are low-passed like recordings, and compared until the hand can react, since its own
motion afterwards is not predictable.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from controller.device.device_file import Accelerometer
from controller.device.rail import why_at_rail
from controller.record.metrics import MOST_SHIFT_S, align, rate_hardness_N_m, spectral_error_dB
from controller.record.recorder import Contact
from controller.servo.settings import Settings
from controller.waveforms.prediction import Prediction, predict
from transopt.base.filters import lowpass
from transopt.base.recursions import filtered
from transopt.base.signals import REACTION_S, FloatArray, Signal, integral, nrmse
from transopt.library.library import Library
from transopt.plant.intention import INTENTION_S
from transopt.problem.answer import verdict
from transopt.problem.objective.bands import Levels, levels
from transopt.problem.objective.figures import Figures, felt
from transopt.recordings.approach import MOST_OWN, separated, unsteady

FIT_S = 0.03  # part of the approach that the parabola is fitted to
LEAST_FIT = 10  # least records for the fit
LEAST_COUNTS = 20.0  # least way by which encoder and accelerometer are compared: one count is 5 % of it
SCALE_OFF = 0.1  # relative difference of the two that is told; that of sound ones is within 0.05
REST_S = 0.02  # time before the waveform in which the accelerometer reads gravity and offset only
HAND_PART = 0.8  # least energy of the line in the difference: hands have 0.89 and more, wrong devices at most 0.45
CUTOFF_HZ = 1000.0  # low-pass, as for recordings
NOTHING = float("nan")


@dataclass(frozen=True)
class Compared:
    """Figures of a played tap against the recorded tap and its prediction, until the hand can react.

    Attributes
    ----------
    latency_s : shift within 1 ms that aligns played and predicted tap, positive if played late; applied before the
        following errors.
    tap_error : error against the recorded tap. felt_error : the same in the band in which vibration is felt.
    playback_error : error against the prediction.
    scale : least squares factor of the prediction to the played tap.
    encoder : see `encoder_ratio`.
    by_hand : the same error of a straight line alone, if that is most of the difference; else 0. A hand can do no
        more within this time, and a device that is off differs in the pulse.
    speed : change of speed, played over recorded.
    peak_m_s2, predicted_peak_m_s2, reference_peak_m_s2 : largest |acceleration| after the low-pass.
    spectral_error_dB : against the recorded tap, see `metrics.spectral_error_dB`.
    levels : energies over those of the recorded tap; None if nothing is compared.
    """

    latency_s: float
    tap_error: float
    playback_error: float
    speed: float
    peak_m_s2: float
    predicted_peak_m_s2: float
    reference_peak_m_s2: float
    spectral_error_dB: float
    levels: Levels | None
    scale: float = float("nan")
    felt_error: float = float("nan")
    encoder: float = float("nan")
    by_hand: float = 0.0


NOT_COMPARED = Compared(NOTHING, NOTHING, NOTHING, NOTHING, NOTHING, NOTHING, NOTHING, NOTHING, None)


@dataclass(frozen=True)
class PlayedTap:
    """One played tap with its prediction.

    Attributes
    ----------
    contact : the recorded contact.
    times_s : (n,) times of its records, from the instant at which the undriven stylus would have met the surface.
    position_m : (n,) height above the surface.
    gain : gain of the device.
    prediction : the library's, at the contact's speed and grip, with the transient as scaled for the coil's heat.
    compared : all NaN if `why` gives a reason why nothing can be compared.
    """

    contact: Contact
    times_s: FloatArray
    position_m: FloatArray
    gain: float
    prediction: Prediction
    compared: Compared
    why: str = ""

    @property
    def peak_current_A(self) -> float:
        """Largest current, as measured."""
        return float(np.abs(self.contact.current_A).max())

    @cached_property
    def acceleration_m_s2(self) -> FloatArray:
        """(n,) acceleration less the accelerometer's reading at rest."""
        return self.contact.acceleration_m_s2 - resting_m_s2(self.contact)

    @property
    def remark(self) -> str:
        """In words: why nothing can be compared, else what the coil's heat and the hand have changed."""
        heat = [f"{100 * self.contact.cooled:.0f} % of the cooler transient"] if self.contact.cooled > 0 else []
        heat += [f"scaled by {self.contact.scale:.2f} for the coil"] if self.contact.scale < 1 else []
        part = self.compared.by_hand
        hand = f"off by {100 * part:.0f} % as by a hand that brakes or speeds up at contact, or not the library's"
        ratio = self.compared.encoder
        scale = f"{ratio:.2f} times the motion by the encoder: `check` tells if its scale, and so the speed, is off"
        said = [*heat, *[hand] * (part > MOST_OWN), *[scale] * (abs(ratio - 1) > SCALE_OFF)]
        return self.why or ", ".join(said)

    @property
    def verdict(self) -> str:
        """In words: what limits the tap, or what a hand can feel of its error."""
        if self.why or self.compared.levels is None:
            return self.why
        prediction, compared = self.prediction, self.compared
        figures = Figures(compared.tap_error, NOTHING, NOTHING, compared.speed, NOTHING, NOTHING, NOTHING)
        return verdict(figures, prediction.floor, prediction.repeatability, self.compared.levels, (), named=False)

    def rate_hardness_N_m(self, force_per_current_N_A: float) -> float:
        """Rate-hardness of the rendered surface, from the measured current; NaN if nothing was compared."""
        if self.why:
            return NOTHING
        return rate_hardness_N_m(self.times_s, force_per_current_N_A * self.contact.current_A, self.contact.speed_m_s)


def height_m(contact: Contact, settings: Settings) -> FloatArray:
    """(n,) height above the surface, at its position during this contact."""
    surface = settings.surface_counts if contact.surface_counts is None else contact.surface_counts
    return np.asarray((contact.counts - surface) * settings.count_m)


def met_surface(contact: Contact, settings: Settings) -> tuple[float, float]:
    """Instant of the undriven contact after the tick at which the waveform began [s], and its speed [m/s].

    They follow from the tangent, at `lead` after that tick, of a parabola through the counts up to the tick, which no
    current has moved yet. Both are NaN if the stylus was not approaching or too little was recorded.
    """
    times = (contact.ticks - contact.tick) * contact.dt_s
    seen = (times <= 0) & (times > -FIT_S)
    if seen.sum() < LEAST_FIT:
        return NOTHING, NOTHING
    z = height_m(contact, settings)[seen]
    a, b, c = np.polynomial.polynomial.polyfit(times[seen], z, 2)
    lead = settings.lead_s
    slope = b + 2 * c * lead
    return (float(lead - (a + b * lead + c * lead**2) / slope), float(-slope)) if slope < 0 else (NOTHING, NOTHING)


def known_motion(contact: Contact, settings: Settings) -> tuple[Signal, Signal] | None:
    """Acceleration less the reading at rest, and height, over the times after `contact.tick`; None if too short.

    Another contact before or after this one may have reached the accelerometer's rail: that part is left out.
    """
    times = (contact.ticks - contact.tick) * contact.dt_s
    none = np.flatnonzero(~np.isfinite(contact.acceleration_m_s2))
    first, end = max(none[times[none] < 0] + 1, default=0), min(none[times[none] >= 0], default=times.size)
    if np.count_nonzero(times[first:end] < 0) < LEAST_FIT:
        return None
    start_s, step = float(times[first]), float(times[1] - times[0])
    acceleration = Signal(start_s, step, contact.acceleration_m_s2[first:end] - resting_m_s2(contact))
    return acceleration, Signal(start_s, step, height_m(contact, settings)[first:end])


def why_not_steady(contact: Contact, settings: Settings, prediction: Prediction) -> str:
    """Reason why the hand did not come in as the prediction assumes; empty if it did."""
    known = known_motion(contact, settings)
    return "" if known is None else unsteady(separated(*known, 0.0), 0.0, prediction.recorded_rms_m_s2)


def encoder_ratio(contact: Contact, settings: Settings, bandwidth_Hz: float) -> float:
    """Motion by the encoder over that by the accelerometer; NaN if too little of it is known.

    Compared is how far the stylus is off the straight way of the last 30 ms before contact when the hand can react.

    Parameters
    ----------
    bandwidth_Hz : bandwidth of the accelerometer, whose pole is compensated.
    """
    known = known_motion(contact, settings)
    if known is None or known[0].end_s < REACTION_S:
        return NOTHING
    x, height = separated(*known, 0.0).acceleration, known[1]
    before, last = slice(x.before(-FIT_S), x.before(0.0)), x.until(REACTION_S) - 1

    def left_m(way_m: FloatArray) -> float:
        straight = np.polynomial.Polynomial.fit(x.times_s[before], way_m[before], 1)
        return float(way_m[last] - straight(x.times_s[last]))

    felt = before_pole(x.values, x.dt_s, bandwidth_Hz)
    by_accelerometer = left_m(integral(integral(felt, x.dt_s), x.dt_s))
    return left_m(height.values) / by_accelerometer if by_accelerometer > LEAST_COUNTS * settings.count_m else NOTHING


def through_pole(values: FloatArray, dt_s: float, bandwidth_Hz: float) -> FloatArray:
    """(N,) output of one pole, from rest, to a signal that is linear between its samples."""
    pole = 2 * np.pi * bandwidth_Hz * dt_s
    kept = np.exp(-pole)
    # x' = p (u - x) over one step with u going straight from u_0 to u_1.
    mean = (1 - kept) / pole
    return filtered(np.array([1 - mean, mean - kept]), np.array([1.0, -kept]), values)


def before_pole(values: FloatArray, dt_s: float, bandwidth_Hz: float) -> FloatArray:
    """(N,) inverse of `through_pole`; it amplifies noise beyond the bandwidth."""
    pole = 2 * np.pi * bandwidth_Hz * dt_s
    kept = np.exp(-pole)
    mean = (1 - kept) / pole
    # Minimum phase: (mean - kept) / (1 - mean) < 1 for every pole.
    return filtered(np.array([1.0, -kept]), np.array([1 - mean, mean - kept]), values)


def since_contact(
    contact: Contact,
    library: Library,
    settings: Settings,
    accelerometer: Accelerometer,
    prediction: Prediction,
    last_s: float,
) -> Signal | str:
    """Acceleration less the reading at rest, over the time from contact; or the reason why there is none.

    Parameters
    ----------
    library : the one that was played.
    accelerometer : as the device file describes it.
    prediction : of this tap.
    last_s : time to which it must be recorded, from the prediction's first on; the largest shift of the alignment is
        added on both sides.
    """
    if contact.spoilt:
        return contact.spoilt
    times = (contact.ticks - contact.tick) * contact.dt_s
    step = float(times[1] - times[0]) if times.size > 1 else float("nan")
    if not step <= 1.5 * contact.dt_s:
        return "telemetry of every tick is needed"
    times -= met_surface(contact, settings)[0]
    first_s, last_s = float(prediction.times_s[0]) - MOST_SHIFT_S, last_s + MOST_SHIFT_S
    if not (times[0] <= first_s and last_s <= times[-1]):
        return "not all of it was recorded"
    acceleration, needed = contact.acceleration_m_s2, (times >= first_s) & (times <= last_s)
    if why := why_at_rail(times[needed], acceleration[needed], accelerometer, library):
        return why
    if why := why_not_steady(contact, settings, prediction):
        return why
    known = known_motion(contact, settings)
    if known is None:
        return "not all of it was recorded"
    return replace(known[0], start_s=known[0].start_s - met_surface(contact, settings)[0])


def resting_m_s2(contact: Contact) -> float:
    """Mean of the accelerometer's numbers before the waveform; NaN if none was recorded before it."""
    times = (contact.ticks - contact.tick) * contact.dt_s
    resting = contact.acceleration_m_s2[(times < 0) & (times >= -REST_S) & np.isfinite(contact.acceleration_m_s2)]
    return float(resting.mean()) if resting.size else NOTHING


def played_tap(
    contact: Contact,
    library: Library,
    settings: Settings,
    gain: float,
    accelerometer: Accelerometer,
) -> PlayedTap:
    """Compare a recorded contact with the library's prediction.

    Parameters
    ----------
    gain : gain of the device.
    accelerometer : as the device file describes it.
    """
    prediction = predict(library, contact.speed_m_s, contact.grip_N, gain, contact.scale, contact.cooled)
    compared = _compare(contact, prediction, library, settings, gain, accelerometer)
    return PlayedTap(
        contact=contact,
        times_s=(contact.ticks - contact.tick) * contact.dt_s - met_surface(contact, settings)[0],
        position_m=height_m(contact, settings),
        gain=gain,
        prediction=prediction,
        compared=NOT_COMPARED if isinstance(compared, str) else compared,
        why=compared if isinstance(compared, str) else "",
    )


def outside(contact: Contact, library: Library, settings: Settings) -> str:
    """Reason why a tap outside the library's grid cannot be judged; empty within the grid.

    Outside, the edge was played, but no recorded tap exists to compare with: an acceleration grows about in
    proportion to the speed. A library of one grip serves every grip.
    """
    speeds, grips, slack_N = library.speeds_m_s, library.grips_N, settings.grid_slack_N
    came_m_s, edge = contact.speed_m_s, "its edge"
    slack_m_s = settings.grid_slack * came_m_s
    if not speeds[0] - slack_m_s <= came_m_s <= speeds[-1] + slack_m_s:
        grid = f"{came_m_s:.3g} m/s lies outside the library's {speeds[0]:g} to {speeds[-1]:g} m/s"
        edge += f", about {np.clip(came_m_s, speeds[0], speeds[-1]) / came_m_s:.2g} times what this speed asks for,"
    elif grips.size > 1 and not grips[0] - slack_N <= contact.grip_N <= grips[-1] + slack_N:
        grid = f"{contact.grip_N:.3g} N lies outside the library's {grips[0]:g} to {grips[-1]:g} N"
    else:
        return ""
    return f"not judged: {grid}, so {edge} was played, and no recorded tap says how near that comes"


def _compare(
    contact: Contact,
    prediction: Prediction,
    library: Library,
    settings: Settings,
    gain: float,
    accelerometer: Accelerometer,
) -> Compared | str:
    """The figures of a tap, or the reason why there are none."""
    if gain == 0:
        return "nothing is played at gain 0"
    if prediction.silent or not np.any(prediction.acceleration_m_s2):
        return "the library is silent there"
    if beyond := outside(contact, library, settings):
        return beyond
    until = prediction.times_s <= INTENTION_S
    at = prediction.times_s[until]
    measured = since_contact(contact, library, settings, accelerometer, prediction, float(at[-1]))
    if isinstance(measured, str):
        return measured

    def sensed(acceleration_m_s2: FloatArray) -> FloatArray:
        behind = through_pole(acceleration_m_s2, contact.dt_s, accelerometer.bandwidth_Hz)
        return lowpass(Signal(float(at[0]), contact.dt_s, behind), CUTOFF_HZ).values[until]

    played, expected = lowpass(measured, CUTOFF_HZ), sensed(prediction.whole_m_s2)
    aligned = align(played.times_s, played.values, at, expected)
    reference = sensed(prediction.recorded_m_s2)
    difference = aligned.played_m_s2 - expected
    slow = np.polynomial.Polynomial.fit(at, difference, 1)(at)
    heard = [felt(course, contact.dt_s) for course in (aligned.played_m_s2, reference)]
    return Compared(
        latency_s=aligned.latency_s,
        tap_error=nrmse(aligned.played_m_s2, reference),
        playback_error=aligned.nrmse,
        speed=float(aligned.played_m_s2.sum() / reference.sum()),
        peak_m_s2=float(np.abs(aligned.played_m_s2).max()),
        predicted_peak_m_s2=float(np.abs(expected).max()),
        reference_peak_m_s2=float(np.abs(reference).max()),
        spectral_error_dB=spectral_error_dB(aligned.played_m_s2, reference, contact.dt_s),
        levels=levels(aligned.played_m_s2, reference, contact.dt_s),
        scale=float(aligned.played_m_s2 @ expected / (expected @ expected)),
        felt_error=nrmse(*heard),
        encoder=encoder_ratio(contact, settings, accelerometer.bandwidth_Hz),
        by_hand=nrmse(expected + slow, expected) if slow @ slow > HAND_PART * (difference @ difference) else 0.0,
    )
