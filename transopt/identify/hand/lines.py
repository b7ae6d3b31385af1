"""The hand over grip: lines through the taps' mass, damping and stiffness, with intervals (seed Eqs. 3-5, Fig. 5)."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.identify.fit import Fit, intervals_around, known
from transopt.identify.hand.tap import HandTap, TapFit, fit_tap, heard_Hz
from transopt.plant.hand import LinearInGrip

QUANTITIES = ("mass_kg", "damping_N_s_m", "stiffness_N_m")
COEFFICIENTS = tuple(f"{quantity}.{part}" for quantity in QUANTITIES for part in ("constant", "per_newton"))
LEAST_TRIALS, LEAST_GRIPS = 12, 3
_SAME_GRIP, _SAME_GRIP_N = 0.15, 0.1  # grips no farther apart than this (relative plus absolute) count as one
_PLAUSIBLE_KG = (0.03, 1.0)  # mass of a hand with a stylus
LEAST_HEARD_HZ = 100.0  # if the force stands out of its noise only below this, fast taps are not known
# Beyond the following limits the model is not fit to design with.
MOST_UNEXPLAINED = 0.10
MOST_UNCERTAIN = 0.25  # relative half width of the interval at the middle grip
LACK_OF_FIT_P = 0.01
LOUDER = "tap faster, on a harder object, or with a force sensor of less noise"
MOST_SHIFTED = 1.25  # unexplained part as recorded over that with force and acceleration shifted by a sample


@dataclass(frozen=True)
class GripLine:
    """One quantity over grip.

    Attributes
    ----------
    quantity : which of `QUANTITIES`.
    at_taps : (T,) values of the single taps.
    line : least squares line through them.
    intervals : (2, 2) 95 % intervals of its constant and of its slope.
    band : (p, 3) grips, and lower and upper end of the 95 % interval of the line there.
    lack_of_fit_p : p value of the test for lack of fit; NaN without repeated grips.
    """

    quantity: str
    at_taps: FloatArray
    line: LinearInGrip
    intervals: FloatArray
    band: FloatArray
    lack_of_fit_p: float


@dataclass(frozen=True)
class HandFit(Fit):
    """The hand of one session.

    Attributes
    ----------
    grips_N : (T,) grips of the taps.
    fits : fit of each tap.
    lines : in the order of `QUANTITIES`.
    covariance : (6, 6) covariance in the order of `COEFFICIENTS`, SI.
    shifted : median unexplained part with the force shifted by a sample, earlier and later than recorded.
    heard_Hz : frequency up to which the force stands out of its noise.
    """

    grips_N: FloatArray
    fits: tuple[TapFit, ...]
    lines: tuple[GripLine, GripLine, GripLine]
    covariance: FloatArray
    shifted: tuple[float, float]
    heard_Hz: float

    @property
    def recorded_N(self) -> list[float]:
        """Grips of the session: the lightest, the means of the inner groups (`grip_groups`), and the firmest."""
        grips = [float(self.grips_N[group].mean()) for group in grip_groups(self.grips_N)]
        return [float(self.grips_N.min()), *grips[1:-1], float(self.grips_N.max())]

    @property
    def unexplained(self) -> float:
        """Median over the taps of |F - fit| / |F|."""
        return float(np.median([fit.unexplained for fit in self.fits]))

    def shortfalls(self) -> list[str]:
        if self.unexplained > MOST_UNEXPLAINED:
            # Other shortfalls would only follow from this one.
            return [
                f"one mass on a spring and a damper leaves {100 * self.unexplained:.0f} % of the surface force "
                f"unexplained (at most {100 * MOST_UNEXPLAINED:.0f} %): the stylus moves within the grip, or force "
                "and acceleration are not sampled at the same time (accelerometer_Hz)"
            ]
        found = []
        if self.heard_Hz < LEAST_HEARD_HZ:
            found.append(
                f"the force stands out of its noise up to {self.heard_Hz:.0f} Hz only (at least "
                f"{LEAST_HEARD_HZ:.0f} Hz), so that fast taps are not known: {LOUDER}"
            )
        if min(self.shifted) * MOST_SHIFTED < self.unexplained:
            late = "later" if self.shifted[0] < self.shifted[1] else "earlier"
            found.append(
                f"the force is read about a sample {late} than the acceleration: shifted by one, mass, spring and "
                f"damper leave {100 * min(self.shifted):.2g} % unexplained, not {100 * self.unexplained:.2g} %, "
                "and damping and stiffness are others; state accelerometer_Hz, or read both at the same time"
            )
        low, high = float(self.grips_N.min()), float(self.grips_N.max())
        for line in self.lines:
            # A line that is positive at both ends is positive in between.
            for grip_N in (low, high):
                if not line.line.at(grip_N) > 0:
                    found.append(
                        f"{line.quantity} is {line.line.at(grip_N):.3g} at {grip_N:.3g} N: must be > 0 (passive); "
                        f"record more taps near {grip_N:.2g} N"
                    )
            middle, lower, upper = line.band[line.band.shape[0] // 2]
            if not line.line.at(middle) > 0:
                continue
            uncertain = float((upper - lower) / 2 / line.line.at(middle))
            if uncertain > MOST_UNCERTAIN:
                found.append(
                    f"{line.quantity} is known to {100 * uncertain:.0f} % at {middle:.2g} N (at most "
                    f"{100 * MOST_UNCERTAIN:.0f} %): record about {np.ceil((uncertain / MOST_UNCERTAIN) ** 2):.0f} "
                    "times as many taps, faster ones"
                )
            if line.lack_of_fit_p < LACK_OF_FIT_P:
                worst = self._farthest(line)
                found.append(
                    f"{line.quantity} is no line over grip (p = {line.lack_of_fit_p:.1g}; farthest off near "
                    f"{worst:.2g} N): record more taps around {worst:.2g} N, or keep to a narrower range of grips"
                )
        return found

    def supports(self) -> str:
        low, high = self.grips_N.min(), self.grips_N.max()
        return (
            f"supports designs with a second_order hand from {low:.2g} to {high:.2g} N: mass, damping and stiffness "
            f"follow grip as lines, {100 * self.unexplained:.1f} % of the surface force is left unexplained "
            f"({len(self.fits)} taps)"
        )

    def stated(self) -> dict[str, Any]:
        bounds = np.concatenate([line.intervals for line in self.lines])
        return {
            "kind": "second_order",
            **{line.quantity: asdict(line.line) for line in self.lines},
            "grips_N": self.recorded_N,
            **known(COEFFICIENTS, self.covariance, bounds),
        }

    def _farthest(self, line: GripLine) -> float:
        """Mean grip of the group whose mean lies farthest from the line."""
        groups = grip_groups(self.grips_N)
        off = [abs(np.mean(line.at_taps[g]) - line.line.at(float(self.grips_N[g].mean()))) for g in groups]
        return float(self.grips_N[groups[int(np.argmax(off))]].mean())


def fit_hand(taps: Sequence[HandTap], *, accept: bool = False) -> HandFit:
    """Fit each tap by itself, then lines over grip by least squares.

    The covariance follows from each tap's distance from the lines, since hands vary more than sensors err, and not
    equally at every grip. Its intervals hold the truth in 95 to 96 % of sessions of 12 to 81 taps.

    Parameters
    ----------
    accept : take a mass that few hands have, as that of two fingertips on a light stylus.

    Raises
    ------
    InputError : too few taps or grips, or a mass that few hands have unless accepted.
    """
    grips = np.array([tap.grip_N for tap in taps])
    if len(taps) < LEAST_TRIALS:
        raise InputError(
            f"{len(taps)} taps: at least {LEAST_TRIALS} are needed for intervals, 81 are good: tap more, "
            "simulated with record tap --grips 1,3,5 --repeats 3"
        )
    groups = grip_groups(grips)
    if len(groups) < LEAST_GRIPS:
        felt = ", ".join(f"{grips[group].mean():.2g}" for group in groups)
        raise InputError(
            f"only {len(groups)} different grips ({felt} N): at least {LEAST_GRIPS} are needed for a line and its "
            "lack of fit; record taps at other grips"
        )
    fits = tuple(fit_tap(tap) for tap in taps)
    values = np.array([[getattr(fit, quantity) for fit in fits] for quantity in QUANTITIES])  # (3, T)
    if not accept:
        _check_mass(float(np.median(values[0])))

    coefficients, covariance = _lines(grips, values)
    axis = np.linspace(grips.min(), grips.max(), 41)
    points = np.concatenate([np.eye(2), np.stack([np.ones(axis.size), axis], axis=1)])
    lines = []
    for j, quantity in enumerate(QUANTITIES):
        own = covariance[2 * j : 2 * j + 2, 2 * j : 2 * j + 2]
        line = LinearInGrip(*coefficients[j].tolist())
        bounds = intervals_around(points @ coefficients[j], points @ own @ points.T, len(taps) - 2)
        lines.append(
            GripLine(
                quantity=quantity,
                at_taps=values[j],
                line=line,
                intervals=bounds[:2],
                band=np.column_stack([axis, bounds[2:]]),
                lack_of_fit_p=_lack_of_fit(grips, values[j], line, groups),
            )
        )
    earlier, later = (float(np.median([fit_tap(_shifted(tap, by)).unexplained for tap in taps])) for by in (1, -1))
    return HandFit(grips, fits, (lines[0], lines[1], lines[2]), covariance, (earlier, later), heard_Hz(taps))


def _shifted(tap: HandTap, by: int) -> HandTap:
    """The tap with its force shifted `by` samples earlier."""
    if by > 0:
        return replace(tap, force_N=tap.force_N[by:], acceleration_m_s2=tap.acceleration_m_s2[:-by])
    return replace(tap, force_N=tap.force_N[:by], acceleration_m_s2=tap.acceleration_m_s2[-by:])


def grip_groups(grips_N: FloatArray) -> list[np.ndarray]:
    """Indices of taps whose grips count as one, from the lightest on."""
    order = np.argsort(grips_N)
    groups: list[list[int]] = []
    for index in order.tolist():
        if groups and grips_N[index] <= grips_N[groups[-1][0]] * (1 + _SAME_GRIP) + _SAME_GRIP_N:
            groups[-1].append(index)
        else:
            groups.append([index])
    return [np.array(group) for group in groups]


def _lines(grips: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least squares lines through values (q, T) over grips (T,).

    Returns
    -------
    (q, 2) constant and slope, and (2 q, 2 q) the covariance of all, consistent even if the scatter varies with grip
    (White 1980, with the leverages of MacKinnon and White's HC3, which holds for few taps too).
    """
    powers = np.stack([np.ones(grips.size), grips], axis=1)
    by_tap = np.linalg.pinv(powers)  # (2, T) contribution of each tap to constant and slope
    found = values @ by_tap.T
    off = (values - found @ powers.T) / (1 - np.einsum("ti,it->t", powers, by_tap))
    moves = (off[:, None] * by_tap).reshape(-1, grips.size)
    return found, moves @ moves.T


def _lack_of_fit(grips: FloatArray, y: FloatArray, line: LinearInGrip, groups: Sequence[np.ndarray]) -> float:
    """p value of the F test: scatter of the groups' means about the line against the scatter within the groups.

    Grips within a group differ a little, so the test uses each tap's distance from the line.
    """
    left = y - line.constant - line.per_newton * grips
    within = sum(float(((left[g] - left[g].mean()) ** 2).sum()) for g in groups)
    between = sum(g.size * float(left[g].mean()) ** 2 for g in groups)
    free, inner = len(groups) - 2, y.size - len(groups)
    if inner < 1 or free < 1 or within == 0:
        return float("nan")
    return float(stats.f.sf(between / free / (within / inner), free, inner))


def _check_mass(median_kg: float) -> None:
    low, high = _PLAUSIBLE_KG
    if low <= median_kg <= high:
        return
    found = f"the taps show a mass of {median_kg:.3g} kg (median): a hand with a stylus has {low:g} to {high:g} kg"
    remedy = (
        "is force in kgf, its column named force_N?" if median_kg < low else "was force multiplied by 9.81 twice?"
    )
    raise InputError(
        f"{found}; {remedy} Check the units of force and acceleration; if they are right, --accept takes it"
    )
