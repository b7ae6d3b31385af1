"""The hand with its unmeasured state: stylus - skin - hand mass - arm, fitted to all taps at once (seed Fig. 4b).

The seed calls this fit difficult: of the two masses only the stylus is measured. Here the surface force drives the
simulated chain, its stylus acceleration is compared with the recorded one, and nonlinear least squares from several
starts finds the parameters, each a line over grip and none negative at any recorded grip (passive). The covariance is
White's sandwich over trials, since a hand that varies from tap to tap leaves residuals correlated within a tap.

One line for all taps is biased if the hand varies: by 0.5 % of the stylus mass and 1 % of the hand mass for a hand
that varies by 5 to 10 % from tap to tap. The intervals do not include this bias.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from pydantic import ValidationError
from scipy import signal, stats

from transopt.base.signals import REACTION_S, FloatArray
from transopt.identify.device.chain import HAND, Coordinates, chain_of, log_slopes
from transopt.identify.device.response import ACCELERATION, Instrument, Slope, courses
from transopt.identify.fit import Fit, intervals_around, known, quantile
from transopt.identify.hand.lines import LACK_OF_FIT_P, LOUDER, MOST_UNEXPLAINED, HandFit
from transopt.identify.hand.tap import LOWPASS_HZ, HandTap
from transopt.identify.measurement import Measurement
from transopt.identify.squares import Found, Squares, inverse
from transopt.plant.hand import LinearInGrip
from transopt.plant.state_space import StateSpace
from transopt.scene.identified import known_to
from transopt.scene.model_parts import FourthOrderHand, SecondOrderHand

SHARED = ("stylus_mass_kg",)
NAMES = (*SHARED, *(f"hand.{name}.{part}" for name in HAND for part in ("constant", "per_newton")))
ARM = len(SHARED) + HAND.index("arm_stiffness_N_m")
STARTS, ENOUGH = 6, 3  # most starts tried; number of them that end in one optimum after which no more are tried
SAME = 1.01  # sum of squares over the least one up to which a start counts as having found the same optimum
DETERMINED = 0.25  # largest relative half width of the interval at the middle grip of a determined parameter
MOST_UNKNOWN = 0.15  # largest relative half width of the interval of the response, rms over the band of a tap
MOST_MISSED = 0.15  # largest relative error of the acceleration: one person's taps do not differ more
LEAST_RATE_HZ, GOOD_RATE_HZ = 2000.0, 5000.0  # a slower record loses the course of the force between its samples
LEAST_TAPS, MARGIN = 81, 1.5  # least number of taps asked for; factor on the number computed
LOUD_HZ = 200.0  # if the force stands out of its noise beyond this, louder taps tell no more
ENTANGLED = 0.95  # correlation above which two parameters are determined only together
_FEW = 18  # taps that the starts are tried on
_OVERSAMPLED = 5  # compared samples per period of the low-pass frequency
_TOLERANCE, _TRIES = 1e-5, 30  # relative tolerance of a search; its largest number of evaluations
_RELEASES = 20  # restarts of parameters that reached zero during the search
_LEAST_KG, _LEAST_SHARE = 1e-3, 1e-6  # lower bounds of a mass, and of a spring or damper as a share of its guess
_LEAST_GUESS = (0.01, 1.0, 10.0)  # least guess of mass [kg], damping [N s/m] and stiffness [N/m] of the whole hand
_SKIN_HZ, _SKIN_DAMPING, _STYLUS_SHARE = 80.0, 0.3, 0.2  # guess: skin resonance and damping ratio, share of the mass


@dataclass(frozen=True)
class FourthOrderFit(Fit):
    """The fourth-order hand of one session.

    Attributes
    ----------
    stylus_mass_kg : mass that moves rigidly with the accelerometer.
    lines : name of `HAND` -> its line over grip.
    grips_N : recorded grips, increasing.
    taps, rate_Hz, window_s, heard_Hz : number of taps, their sampling rate, their length from contact on, and the
        frequency up to which their force stands out of its noise.
    intervals : (11, 2) 95 % intervals. covariance : (11, 11). Both in the order of `NAMES`.
    uncertain : name of the stylus mass and of each line -> relative half width of its interval at the middle grip.
    entangled : pairs whose values at the middle grip have a correlation above `ENTANGLED` in magnitude.
    unexplained : median over the taps of |a - model| / |a|.
    expected : sum of squares of the relative errors expected for other taps of this session.
    second : sum of squares of the relative errors of the second-order hand.
    starts : sum of squares reached from each start, the best first.
    brake_m_s2, brake_p : acceleration of the hand against the tap, from contact on, that all taps have in common, and
        the probability of one that large by chance.
    unbraked_N_m : stiffness of the arm at the middle grip if that is taken out.
    """

    stylus_mass_kg: float
    lines: dict[str, LinearInGrip]
    grips_N: tuple[float, ...]
    taps: int
    rate_Hz: float
    window_s: float
    heard_Hz: float
    intervals: FloatArray
    covariance: FloatArray
    uncertain: dict[str, float]
    entangled: tuple[tuple[str, str], ...]
    unexplained: float
    expected: float
    second: float
    starts: tuple[float, ...]
    brake_m_s2: float
    brake_p: float
    unbraked_N_m: float

    @property
    def undetermined(self) -> list[str]:
        """Names of the parameters whose relative half width at the middle grip exceeds `DETERMINED` or is NaN."""
        return [name for name, share in self.uncertain.items() if not share <= DETERMINED]

    def word(self) -> str:
        """Which parameters these taps determine, and which they do not."""
        known = [f"{name} to {100 * u:.2g} %" for name, u in self.uncertain.items() if u <= DETERMINED]
        text = f"determined: {', '.join(known) or 'nothing'}"
        if self.undetermined:
            text += (
                f"; not determined by these taps: {', '.join(self.undetermined)} (more than {100 * DETERMINED:.0f} %)"
            )
        if self.entangled:
            # Each name is printed once: six parameters have up to fifteen entangled pairs.
            text += f"; only together: {', '.join(dict.fromkeys(name for pair in self.entangled for name in pair))}"
        text += f"; {_agreeing(self.starts)} of {len(self.starts)} starts end in the same optimum"
        if not self.is_better:
            return f"{text}; other taps are explained no better than by one mass on a spring and a damper"
        return "; ".join(
            [f"{text}; other taps are explained better", *(f"but {short}" for short in self.shortfalls())]
        )

    def braking(self) -> str:
        """Warning that the hand brakes or speeds up from contact on, which weakens or stiffens the fitted arm."""
        if not self.brake_p < LACK_OF_FIT_P:
            return ""
        middle_N = (self.grips_N[0] + self.grips_N[-1]) / 2
        found_N_m = self.lines["arm_stiffness_N_m"].at(middle_N)
        return (
            f"the hand {'brakes' if self.brake_m_s2 > 0 else 'speeds up'} by about {abs(self.brake_m_s2):.2g} m/s^2 "
            f"from contact on (p = {self.brake_p:.1g}): without that its arm has about {self.unbraked_N_m:.3g} N/m "
            f"at {middle_N:.2g} N, not {found_N_m:.3g}, whatever the intervals; go on evenly through the contact, or "
            "tap faster"
        )

    @property
    def is_better(self) -> bool:
        """Whether other taps of this session are expected to show a smaller error than with the second-order hand."""
        return self.expected < self.second

    def shortfalls(self) -> list[str]:
        found = []
        if self.rate_Hz < LEAST_RATE_HZ:
            found.append(
                f"sampled at {self.rate_Hz:g} Hz (at least {LEAST_RATE_HZ:g} Hz), the course of the force is lost: "
                f"record at {GOOD_RATE_HZ:g} Hz or faster"
            )
        if self.unexplained > MOST_MISSED:
            # Other shortfalls would only follow from this one.
            return [
                *found,
                f"the fourth-order hand misses {100 * self.unexplained:.0f} % of the acceleration (at most "
                f"{100 * MOST_MISSED:.0f} %): hold the stylus alike in all taps, and record {LEAST_TAPS} or more",
            ]
        grip_N, deviation = max(known_to(self.part()).items(), key=lambda one: one[1])
        unknown = float(quantile()) * deviation
        if not unknown <= MOST_UNKNOWN:
            found.append(
                f"how this hand answers a tap at {grip_N:.2g} N is known to {100 * unknown:.0f} % (at most "
                f"{100 * MOST_UNKNOWN:.0f} %): record {self._to_record(unknown)}"
            )
        return found

    def _to_record(self, unknown: float) -> str:
        """Taps to record so that the response is known well enough: longer ones, louder ones, or more of them."""
        if self.window_s < 0.9 * REACTION_S:
            return f"{1e3 * REACTION_S:.0f} ms from contact on (--window {REACTION_S:g})"
        if self.heard_Hz < LOUD_HZ:
            loud = f"whose force stands out of its noise beyond {self.heard_Hz:.0f} Hz ({LOUDER})"
            return f"{LEAST_TAPS} taps or more {loud}"
        # The variance falls with the number of taps in excess of the number of unknowns.
        beyond = (self.taps - len(NAMES)) * (unknown / MOST_UNKNOWN) ** 2
        return f"{max(np.ceil(MARGIN * (len(NAMES) + beyond)), LEAST_TAPS):.0f} taps or more at grips like these"

    def supports(self) -> str:
        return (
            f"supports designs with a fourth_order hand from {self.grips_N[0]:.2g} to {self.grips_N[-1]:.2g} N: "
            f"stylus, skin, hand mass and arm miss {100 * self.unexplained:.1f} % of the acceleration ({self.taps} "
            f"taps), one mass on a spring and a damper {100 * np.sqrt(self.second / self.taps):.0f} %"
        )

    def stated(self) -> dict[str, Any]:
        return {
            "kind": "fourth_order",
            "stylus_mass_kg": self.stylus_mass_kg,
            "hand": {name: asdict(line) for name, line in self.lines.items()},
            "grips_N": list(self.grips_N),
            **known(NAMES, self.covariance, self.intervals),
        }

    def part(self) -> FourthOrderHand:
        """The hand as a part of a model file, without verdict and sources."""
        return FourthOrderHand.model_validate({**self.stated(), "verdict": "not judged", "sources": []})


class _Session(Squares):
    """Residuals of all taps over the size of each tap's acceleration.

    The unknowns are the parameters at the lowest and the highest grip (`coordinates`), in units of `scale` (11,).
    """

    def __init__(self, taps: Sequence[HandTap], coordinates: Coordinates, scale: FloatArray) -> None:
        super().__init__(self._all)
        self.taps, self._to_taps = taps, [coordinates.at(tap.grip_N) * scale for tap in taps]
        # Both sides are low-passed, so neighbouring samples are redundant.
        self.every = max(1, int(1 / (max(tap.dt_s for tap in taps) * _OVERSAMPLED * LOWPASS_HZ)))
        # Index of each tap's first residual.
        self.first = np.cumsum([0, *(-(-tap.force_N.size // self.every) for tap in taps)])[:-1]

    def residuals(self, tap: HandTap, plant: StateSpace, slopes: tuple[Slope, ...] = ()) -> FloatArray:
        """(1 + p, n / every) residuals of a tap under its force, linear between samples, and their derivatives."""
        found = courses(plant, Instrument(tap.dt_s), tap.force_N, slopes, ramped=True)[:, ACCELERATION]
        found[0] -= tap.acceleration_m_s2
        return np.asarray(found[:, :: self.every] / np.linalg.norm(tap.acceleration_m_s2))

    def _all(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        parts = []
        for tap, at in zip(self.taps, self._to_taps, strict=True):
            values = at @ unknowns
            found = self.residuals(tap, *log_slopes(values, 1.0, SHARED))
            parts.append(np.vstack([found[:1], (at / values[:, None]).T @ found[1:]]))
        whole = np.concatenate(parts, axis=1)
        return whole[0], whole[1:].T

    def braked(self, unknowns: FloatArray) -> FloatArray:
        """Derivative of all residuals by an acceleration of the hand from contact on, against the tap.

        The masses are pushed by their inertia in the frame of the hand's motion: only the last state, the rate of the
        link to the arm, feels it.
        """
        parts = []
        for tap, at in zip(self.taps, self._to_taps, strict=True):
            plant = chain_of(at @ unknowns, 1.0, SHARED)
            carried = replace(plant, B=-np.eye(plant.order)[:, -1:], D=np.zeros_like(plant.D))
            course = courses(carried, Instrument(tap.dt_s), np.ones(tap.force_N.size), ramped=True)[0, ACCELERATION]
            parts.append(course[:: self.every] / np.linalg.norm(tap.acceleration_m_s2))
        return np.concatenate(parts)

    def second_order(self, hand: HandFit) -> float:
        """Sum of squares of the second-order hand; infinite if that is not passive."""
        try:
            part = SecondOrderHand.model_validate({**hand.stated(), "verdict": "not judged", "sources": []})
        except ValidationError:
            return np.inf
        return sum(float(np.sum(self.residuals(tap, part.plant(tap.grip_N)) ** 2)) for tap in self.taps)


def fit_fourth_order(taps: Sequence[HandTap], hand: HandFit, *, starts: int = STARTS) -> FourthOrderFit:
    """Stylus mass and five lines over grip from all taps together.

    Parameters
    ----------
    taps : all taps of the session.
    hand : the second-order fit of the same taps; the starts are drawn around it, log-uniform within a factor of 3.
    starts : most starts tried on a few taps; the best is continued with all taps.
    """
    taps = [_below(tap, hand.heard_Hz) for tap in taps]
    ends = (float(hand.grips_N.min()), float(hand.grips_N.max()))
    coordinates = Coordinates(ends, SHARED)
    order = np.argsort(hand.grips_N)
    few = order[np.unique(np.linspace(0, order.size - 1, _FEW).round().astype(int))]
    guess = _guess(hand, ends)
    random = np.random.default_rng(0)
    factors = np.vstack([np.ones(guess.size), 3.0 ** random.uniform(-1, 1, (starts - 1, guess.size))])
    # No parameter is negative at either end, and so none is between them, rounding included.
    least = _LEAST_SHARE * guess
    least[[0, 1, 1 + len(HAND)]] = _LEAST_KG  # the stylus, and the hand's mass at both ends
    bounds = least / guess, np.full(guess.size, np.inf)
    part, session = (_Session(some, coordinates, guess) for some in ([taps[j] for j in few], taps))
    tried = list[Found]()
    for factor in factors:
        tried.append(part.search(factor, *bounds, most=_TRIES, tolerance=_TOLERANCE, releases=_RELEASES))
        tried.sort(key=lambda one: one[1])
        if _agreeing([cost for _, cost in tried]) == ENOUGH:
            break
    best, _ = session.search(tried[0][0], *bounds, most=_TRIES, tolerance=_TOLERANCE, releases=_RELEASES)
    return _with_uncertainty(session, coordinates, best, guess, hand, tuple(cost for _, cost in tried))


def _agreeing(costs: Sequence[float]) -> int:
    """Number of starts that end in the best optimum, by the sums of squares that they reach, the least first."""
    return sum(cost <= SAME * costs[0] for cost in costs)


def _below(tap: HandTap, cutoff_Hz: float) -> HandTap:
    """The tap low-passed at the frequency above which its force is noise."""
    if cutoff_Hz >= min(LOWPASS_HZ, 0.45 / tap.dt_s):
        return tap
    sos = signal.butter(4, cutoff_Hz, fs=1 / tap.dt_s, output="sos")
    force, acceleration = signal.sosfilt(sos, np.stack([tap.force_N, tap.acceleration_m_s2]), axis=1)
    return replace(tap, force_N=force, acceleration_m_s2=acceleration)


def _guess(hand: HandFit, ends: tuple[float, float]) -> FloatArray:
    """(11,) guess of stylus mass and of the hand at both end grips, from the second-order hand."""
    mass, damping, stiffness = (
        np.array([max(line.line.at(grip), 0.1 * float(np.median(line.at_taps)), least) for grip in ends])
        for line, least in zip(hand.lines, _LEAST_GUESS, strict=True)
    )
    stylus = _STYLUS_SHARE * mass.mean()
    skin_k = stylus * (2 * np.pi * _SKIN_HZ) ** 2
    skin_b = 2 * _SKIN_DAMPING * np.sqrt(skin_k * stylus)
    ends_of_hand = zip((1 - _STYLUS_SHARE) * mass, stiffness, damping, strict=True)
    return np.array([stylus, *(value for m, k, b in ends_of_hand for value in (m, skin_k, skin_b, k, b))])


def _with_uncertainty(
    session: _Session,
    coordinates: Coordinates,
    unknowns: FloatArray,
    scale: FloatArray,
    hand: HandFit,
    costs: tuple[float, ...],
) -> FourthOrderFit:
    """The fit at the optimum (11,), in units of `scale`, with covariance, intervals and undetermined parameters."""
    T, p, (residuals, J) = len(session.taps), unknowns.size, session.evaluate(unknowns)
    # One score per tap: the residuals of a tap are correlated, since its hand differs from that of other taps.
    scores = np.add.reduceat(J * residuals[:, None], session.first)
    bread, meat = inverse(J), scores.T @ scores
    covariance = np.outer(scale, scale) * (bread @ meat @ bread) * T / (T - p)
    to_lines, to_middle = coordinates.lines()[1], coordinates.at(float(np.mean(coordinates.held_N)))
    found, of_lines = to_lines @ (scale * unknowns), to_lines @ covariance @ to_lines.T
    middle, of_middle = to_middle @ (scale * unknowns), to_middle @ covariance @ to_middle.T
    brake = session.braked(unknowns)
    moved = bread @ J.T @ brake
    brake -= J @ moved
    # A score test (Rao) of each tap's slope of the squares by that acceleration, robust as the covariance is.
    slopes = np.add.reduceat(brake * residuals, session.first)
    by_brake = -float(slopes.sum() / (brake @ brake))
    deviation, names = np.sqrt(np.diagonal(of_middle)), (*SHARED, *(f"hand.{name}" for name in HAND))
    correlation = of_middle / np.outer(deviation, deviation)
    entangled = [
        (names[i], names[j]) for i in range(6) for j in range(i + 1, 6) if abs(correlation[i, j]) > ENTANGLED
    ]
    per_tap = np.sqrt(session.every * np.add.reduceat(residuals**2, session.first))
    return FourthOrderFit(
        stylus_mass_kg=float(found[0]),
        lines={name: LinearInGrip(*line) for name, line in zip(HAND, found[1:].reshape(-1, 2).tolist(), strict=True)},
        grips_N=tuple(hand.recorded_N),
        taps=T,
        rate_Hz=1 / max(tap.dt_s for tap in session.taps),
        window_s=min(tap.dt_s * tap.force_N.size for tap in session.taps),
        heard_Hz=hand.heard_Hz,
        intervals=intervals_around(found, of_lines, T - p),
        covariance=of_lines,
        uncertain=dict(zip(names, (quantile(T - p) * deviation / middle).tolist(), strict=True)),
        entangled=tuple(entangled),
        unexplained=float(np.median(per_tap)),
        # Takeuchi's criterion: the error expected for other taps exceeds that of the fitted ones by 2 tr(bread meat).
        expected=float(np.sum(per_tap**2)) + 2 * session.every * float(np.sum(bread * meat)),
        second=session.every * session.second_order(hand),
        starts=costs,
        brake_m_s2=by_brake,
        brake_p=float(stats.ttest_1samp(slopes, 0.0).pvalue),
        unbraked_N_m=float(middle[ARM] - to_middle[ARM] @ (scale * moved) * by_brake),
    )


def hand_part(fit: HandFit, chain: FourthOrderFit, runs: Sequence[Measurement]) -> SecondOrderHand | FourthOrderHand:
    """The hand for the model file: of fourth order if that is better and without shortfalls, else of second order.

    Raises
    ------
    pydantic.ValidationError : the hand is not passive.
    """
    if chain.is_better and not chain.shortfalls():
        return FourthOrderHand.model_validate(chain.content(runs))
    content = fit.content(runs)
    if fit.unexplained > MOST_UNEXPLAINED and chain.is_better:
        # More taps would not make one mass fit this hand, so the file states what the fourth order lacks.
        content |= {"verdict": chain.verdict(), "shortfalls": chain.shortfalls()}
    return SecondOrderHand.model_validate(content)
