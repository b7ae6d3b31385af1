"""The incoming speed of the stylus: stated by the file, or fitted to the position before contact.

The fit is a quadratic over the last 10 ms, whose slope at contact is the speed. With a shorter record or a coarse
encoder that slope is soon meaningless: for n readings of scatter s over a time T its standard deviation is about
s sqrt(192 / n) / T. The speed therefore has a confidence interval, which is reported where it is wide.
"""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray, Signal, integral
from transopt.recordings.recording import Recording

UNKNOWN = "unknown"  # source of a speed that is not known
FITTED = "position"  # source of a fitted speed
SPEED_FIT_S = 10e-3  # a quadratic over 10 ms before contact: a line would be biased by the hand's acceleration
LEAST_SAMPLES = 8
CONTRADICTED = 0.15  # relative difference of a stated speed from the position's, above which a note reports it
UNSURE_SPEED = 0.05  # half the 95 % interval over the speed, above which a note reports it
UNKNOWN_SPEED = 0.2  # half the 95 % interval over the speed, above which the fit is refused
STOPS_S = (5e-3, 20e-3)  # after contact: least and usual time over which position and acceleration are compared
OPPOSED = 0.25  # share of the way that the acceleration gives, by which the position may go the other way
LAST_STEP = 1e-9  # relative step of Newton's method at which it stops; the next would be its square, below rounding


def incoming_speed(recording: Recording, onset_s: float) -> tuple[float, str, list[str]]:
    """Incoming speed [m/s], NaN if unknown; its source and notes.

    Raises
    ------
    InputError : the position has too few samples before contact, or scatters so much that the speed is uncertain by
        more than 20 %.
    """
    if recording.speed_m_s is not None:
        return recording.speed_m_s, "stated", []
    if recording.position is None:
        return float("nan"), UNKNOWN, []
    position = recording.position
    z = _before_contact(position, onset_s)
    lead_ms = 1e3 * min(SPEED_FIT_S, onset_s - position.start_s)
    remedy = f"record {SPEED_FIT_S * 1e3:g} ms before contact, or state `# speed_m_s: ...`"
    if z.size < LEAST_SAMPLES:
        raise InputError(
            f"{recording.name}: position_m has {z.size} samples in the {SPEED_FIT_S * 1e3:g} ms "
            f"before contact, {LEAST_SAMPLES} needed to fit the speed: {remedy}"
        )
    speed, error = _fitted_speed(position, onset_s, z)
    share = error / abs(speed) if speed else np.inf
    found = f"speed fitted to the position of the {lead_ms:.2g} ms before contact: {speed:.3g} +- {error:.2g} m/s"
    if not (speed > 0 and share <= UNKNOWN_SPEED):
        limit = f"limit +- {100 * UNKNOWN_SPEED:g} % (95 %)"
        raise InputError(f"{recording.name}: {found}, {limit}: {remedy}")
    return speed, FITTED, [f"{found} (95 %): {remedy}"] if share > UNSURE_SPEED else []


def facing_out(recording: Recording, x: Signal, onset_s: float) -> tuple[Recording, list[str]]:
    """The recording with its position positive out of the object, and a note if its sign was turned for that.

    A tap approaches the object, so the position falls before contact. The sign is left as it is where the position
    does not tell: too few samples, or a speed within its interval.

    Parameters
    ----------
    x : without offset, positive where the tap decelerates the stylus [m/s^2]. onset_s : time of contact.

    Raises
    ------
    InputError : after contact the position speeds up where the acceleration slows the stylus down.
    """
    position = recording.position
    z = np.empty(0) if position is None else _before_contact(position, onset_s)
    if position is None or z.size < LEAST_SAMPLES:
        return recording, []
    speed, error = _fitted_speed(position, onset_s, z)
    if abs(speed) <= error:
        return recording, []
    facing = position if speed > 0 else position.scaled(-1.0)
    _refuse_opposed(recording.name, facing, abs(speed), error, x, onset_s)
    if speed > 0:
        return recording, []
    note = "the position grows towards the object: its sign is turned, so that it is positive out of the object"
    return replace(recording, position=facing), [note]


def _refuse_opposed(
    name: str, position: Signal, speed_m_s: float, error_m_s: float, x: Signal, onset_s: float
) -> None:
    """Refuse a position and an acceleration that cannot be of one tap.

    Over the time T after contact the acceleration moves the stylus by its double integral off the straight way with
    the incoming speed. The position has to leave that way to the same side.
    """
    during = x.part(x.before(onset_s), x.until(min(onset_s + STOPS_S[1], position.end_s, x.end_s)))
    duration = during.end_s - onset_s
    if duration < STOPS_S[0]:
        return
    slowed = float(integral(integral(during.values, x.dt_s), x.dt_s)[-1])
    ends = np.interp([onset_s, during.end_s], position.times_s, position.values)
    left = float(ends[1] - ends[0]) + speed_m_s * duration
    if slowed > 0 and left < -max(OPPOSED * slowed, error_m_s * duration + 2 * position.count):
        raise InputError(
            f"{name}: by the acceleration the stylus stops short by {1e3 * slowed:.2g} mm in the "
            f"{1e3 * duration:.0f} ms after contact, by the position it runs {-1e3 * left:.2g} mm ahead: both cannot "
            "be of one tap; check that the columns are of one contact, or leave the position out (name it `-` in "
            "--columns)"
        )


def seen_speed(recording: Recording, onset_s: float) -> tuple[float, float] | None:
    """Speed that the position shows and half its 95 % interval [m/s]; None if it is not known within 20 %."""
    position = recording.position
    if position is None or (z := _before_contact(position, onset_s)).size < LEAST_SAMPLES:
        return None
    speed, error = _fitted_speed(position, onset_s, z)
    return None if error > UNKNOWN_SPEED * abs(speed) else (speed, error)


def contradiction(recording: Recording, onset_s: float) -> str:
    """Note that the position contradicts the stated speed; empty if it agrees, or cannot tell."""
    stated, seen = recording.speed_m_s, seen_speed(recording, onset_s)
    if stated is None or seen is None:
        return ""
    speed, error = seen
    if abs(speed - stated) <= error + CONTRADICTED * stated:
        return ""
    return (
        f"the position before contact has {speed:.3g} +- {error:.2g} m/s, stated are {stated:.3g} m/s: check which "
        "is right, since the tap is compared and scaled by the stated speed"
    )


def _before_contact(position: Signal, onset_s: float) -> FloatArray:
    """(n,) positions over the last 10 ms before contact."""
    return position.values[position.before(onset_s - SPEED_FIT_S) : position.until(onset_s)]


def _fitted_speed(position: Signal, onset_s: float, z: FloatArray) -> tuple[float, float]:
    """Speed into the object at contact and half its 95 % interval [m/s]; `z` are the positions before contact."""
    first_s = position.start_s + position.dt_s * position.before(onset_s - SPEED_FIT_S) - onset_s
    (_, slope, _), (_, error, _) = (part.tolist() for part in fitted(first_s, position.dt_s, z, position.count, 3))
    return -slope, abs(error)


def fitted(first_s: float, dt_s: float, z: FloatArray, count: float, terms: int) -> tuple[FloatArray, FloatArray]:
    """Polynomial in time fitted to (n,) samples: coefficients, lowest power first, and half their 95 % intervals.

    The scatter is that of the residuals, but at least that of an encoder with this count, count / sqrt(12), because a
    few counts may lie on a parabola by chance.

    Parameters
    ----------
    first_s : time of the first sample. dt_s : time step of the samples.
    terms : number of coefficients, below n.
    """
    powers, inverse, root, choose, orders = _polynomials(z.size, terms)
    half_s = 0.5 * dt_s * (z.size - 1)
    # The binomial theorem converts coefficients in u, from -1 to 1, into those in t = half_s (u - start).
    start = -(first_s + half_s) / half_s
    of_time = choose * start**orders / half_s ** orders[0][:, None]
    found = inverse @ z
    rest, free = z - powers @ found, z.size - terms
    scatter = max(math.sqrt(float(rest @ rest) / free), count / math.sqrt(12.0))
    errors = two_sided(free) * scatter * np.linalg.norm(of_time @ root, axis=1)
    return of_time @ found, errors


@lru_cache(maxsize=8)  # taps of one rate have the same number of points
def _polynomials(n: int, terms: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Powers (n, terms) of n evenly spaced numbers from -1 to 1, and their pseudo-inverse (terms, n).

    They are followed by a square root R of the latter's Gram matrix R R', the binomial coefficients (k over i) and
    the positive differences k - i of the orders i (rows) and k (columns), each (terms, terms).
    """
    powers, j = np.vander(np.linspace(-1.0, 1.0, n), terms, increasing=True), np.arange(terms)
    choose = np.array([[math.comb(k, i) for k in range(terms)] for i in range(terms)], dtype=float)
    inverse = np.asarray(np.linalg.pinv(powers), dtype=float)
    return powers, inverse, np.linalg.cholesky(inverse @ inverse.T), choose, np.maximum(j - j[:, None], 0)


@lru_cache(maxsize=64)  # taps of one rate have the same number of points
def two_sided(free: int) -> float:
    """Quantile t of Student's distribution with |T| < t in 95 %, for `free` >= 1 degrees of freedom.

    Newton's method from below on the finite sum for the probability (Abramowitz and Stegun 26.7.3 and 26.7.4), which
    is concave, so that no step overshoots. Loading scipy.special would take longer than preparing a hundred
    recordings.
    """
    odd = free % 2
    j = np.arange(1 + odd, free - 1, 2)
    factors = np.append(1.0, np.cumprod(j / (j + 1)))
    scale = math.exp(math.lgamma((free + 1) / 2) - math.lgamma(free / 2)) / math.sqrt(free * math.pi)
    t: float = 1.9
    while True:
        theta = math.atan(t / math.sqrt(free))
        within = math.sin(theta) * float(factors @ math.cos(theta) ** (2 * np.arange(factors.size) + odd))
        if odd:
            within = (theta + (within if free > 1 else 0.0)) * 2 / math.pi
        step = (0.95 - within) / (2 * scale * (1 + t * t / free) ** (-(free + 1) / 2))
        t += step
        if abs(step) < LAST_STEP * t:
            return t
