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
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import ValidationError
from scipy import signal

from transopt.base.signals import FloatArray
from transopt.identify.device.chain import HAND, Coordinates
from transopt.identify.device.response import flow
from transopt.identify.fit import Fit, intervals_around, known, quantile
from transopt.identify.hand.lines import LOUDER, MOST_UNEXPLAINED, HandFit
from transopt.identify.hand.tap import LOWPASS_HZ, REACTION_S, HandTap
from transopt.identify.measurement import Measurement
from transopt.identify.squares import Squares, by_differences, inverse
from transopt.plant.hand import LinearInGrip
from transopt.scene.identified import known_to
from transopt.scene.model_parts import FourthOrderHand, SecondOrderHand

SHARED = ("stylus_mass_kg",)
NAMES = (*SHARED, *(f"hand.{name}.{part}" for name in HAND for part in ("constant", "per_newton")))
STARTS = 6
DETERMINED = 0.25  # largest relative half width of the interval at the middle grip of a determined parameter
MOST_UNKNOWN = 0.15  # largest relative half width of the interval of the response, rms over the band of a tap
MOST_MISSED = 0.15  # largest relative error of the acceleration: one person's taps do not differ more
LEAST_RATE_HZ, GOOD_RATE_HZ = 2000.0, 5000.0  # a slower record loses the course of the force between its samples
LEAST_TAPS, MARGIN = 81, 1.5  # least number of taps asked for; factor on the number computed
LOUD_HZ = 200.0  # if the force stands out of its noise beyond this, louder taps tell no more
ENTANGLED = 0.95  # correlation above which two parameters are determined only together
_FEW = 18  # taps that the starts are tried on
_OVERSAMPLED = 5  # compared samples per period of the low-pass frequency
_TOLERANCE, _TRIES = 1e-6, 30  # relative tolerance of a search; its largest number of evaluations
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
        agreeing = sum(cost <= 1.01 * self.starts[0] for cost in self.starts)
        text += f"; {agreeing} of {len(self.starts)} starts end in the same optimum"
        if not self.is_better:
            return f"{text}; other taps are explained no better than by one mass on a spring and a damper"
        return "; ".join(
            [f"{text}; other taps are explained better", *(f"but {short}" for short in self.shortfalls())]
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


@dataclass(frozen=True)
class _Session:
    """T taps in one array, shorter ones padded with zeros of zero weight.

    Attributes
    ----------
    force, acceleration : (T, n) samples of the taps, SI.
    weight : (T, n) weights that make each tap's residuals relative to its acceleration.
    dt_s : (T,) sampling periods.
    window_s : (T,) lengths.
    grips_N : (T,) grips.
    coordinates : the unknowns: parameter values at the lowest and the highest grip.
    """

    force: FloatArray
    acceleration: FloatArray
    weight: FloatArray
    dt_s: FloatArray
    window_s: FloatArray
    grips_N: FloatArray
    coordinates: Coordinates

    @classmethod
    def of(cls, taps: Sequence[HandTap], coordinates: Coordinates) -> "_Session":
        """The taps of a session."""
        n = max(tap.force_N.size for tap in taps)
        force, acceleration, weight = (np.zeros((len(taps), n)) for _ in range(3))
        for j, tap in enumerate(taps):
            size = tap.force_N.size
            force[j, :size], acceleration[j, :size] = tap.force_N, tap.acceleration_m_s2
            weight[j, :size] = 1 / np.linalg.norm(tap.acceleration_m_s2)
        dt, grips = (np.array([getattr(tap, name) for tap in taps]) for name in ("dt_s", "grip_N"))
        window = dt * [tap.force_N.size for tap in taps]
        return cls(force, acceleration, weight, dt, window, grips, coordinates)

    @cached_property
    def at_taps(self) -> FloatArray:
        """(T, 6, 11) matrices from the values at the end grips to the parameters of each tap."""
        return np.array([self.coordinates.at(grip) for grip in self.grips_N.tolist()])

    @cached_property
    def every(self) -> int:
        """Step between compared samples: both sides are low-passed, so neighbouring samples are redundant."""
        return max(1, int(1 / (float(self.dt_s.max()) * _OVERSAMPLED * LOWPASS_HZ)))

    def residuals(self, theta: FloatArray) -> FloatArray:
        """(P, T, n / every) weighted residuals for values at the end grips (P, 11)."""
        P, T = len(theta), self.grips_N.size
        stylus, *hand = np.einsum("tqe,pe->qpt", self.at_taps, theta).reshape(1 + len(HAND), -1)
        simulated = _simulate(
            stylus,
            np.array(hand),
            np.tile(self.dt_s, P),
            np.tile(self.force, (P, 1)),
        )
        return ((simulated.reshape(P, T, -1) - self.acceleration) * self.weight)[..., :: self.every]

    def second_order(self, hand: HandFit) -> FloatArray:
        """(T, n / every) weighted residuals of the second-order hand; infinite (1, 1) if that is not passive."""
        try:
            part = SecondOrderHand.model_validate({**hand.stated(), "verdict": "not judged", "sources": []})
        except ValidationError:
            return np.full((1, 1), np.inf)
        times = np.arange(self.force.shape[1])
        plants = [part.plant(grip) for grip in self.grips_N.tolist()]
        simulated = [
            signal.lsim((plant.A, plant.B, plant.C, plant.D), force, dt * times)[1]
            for plant, force, dt in zip(plants, self.force, self.dt_s, strict=True)
        ]
        return ((np.array(simulated) - self.acceleration) * self.weight)[..., :: self.every]

    def squares(self, scale: FloatArray) -> Squares:
        """The sum of squares as a function of the parameters in units of `scale` (11,)."""
        return Squares(by_differences(lambda sets: self.residuals(sets * scale).reshape(len(sets), -1)))


def _simulate(stylus: FloatArray, hand: FloatArray, dt_s: FloatArray, force: FloatArray) -> FloatArray:
    """(L, n) stylus acceleration of L chains from rest, exact for forces (L, n) that are linear between samples.

    Parameters
    ----------
    stylus : (L,) masses.
    hand : (5, L) parameters in the order of `HAND`.
    dt_s : (L,) sampling periods.
    """
    mass, skin_k, skin_b, arm_k, arm_b = hand
    L, n = force.shape
    # States: deviations of stylus and hand mass, their velocities, then the force and its slope. With the step as
    # unit of time all entries are small, although stiffness over mass is large.
    step = dt_s[:, None]
    matrices = np.zeros((L, 6, 6))
    matrices[:, 0, 2] = matrices[:, 1, 3] = matrices[:, 4, 5] = 1.0
    stylus_row = np.stack([-skin_k, skin_k, -skin_b / dt_s, skin_b / dt_s, np.ones(L)], axis=1) / stylus[:, None]
    hand_row = np.stack([skin_k, -skin_k - arm_k, skin_b / dt_s, (-skin_b - arm_b) / dt_s], axis=1) / mass[:, None]
    matrices[:, 2, :5], matrices[:, 3, :4] = step**2 * stylus_row, step**2 * hand_row
    hold = flow(matrices[:, None])[:, 0]
    transition, to_force, to_slope = hold[:, :4, :4], hold[:, :4, 4], hold[:, :4, 5]
    # Rows C A^k by doubling, and from them the response to a hat function (linear interpolation of one sample).
    rows = stylus_row[:, None, :4]
    power = transition
    while rows.shape[1] < n:
        rows = np.concatenate([rows, rows @ power], axis=1)
        power = power @ power
    rows = rows[:, :n]
    after = (rows @ to_slope[:, :, None])[..., 0]
    response = after.copy()
    response[:, 0] += stylus_row[:, 4]
    response[:, 1:] += (rows[:, :-1] @ (to_force - to_slope)[:, :, None])[..., 0]
    found = signal.fftconvolve(response, force, axes=1)[:, :n]
    # The state starts at rest even if the first force is not zero.
    return np.asarray(found - after * force[:, :1])


def fit_fourth_order(taps: Sequence[HandTap], hand: HandFit, *, starts: int = STARTS) -> FourthOrderFit:
    """Stylus mass and five lines over grip from all taps together.

    Parameters
    ----------
    taps : all taps of the session.
    hand : the second-order fit of the same taps; the starts are drawn around it, log-uniform within a factor of 3.
    starts : number of starts tried on a few taps; the best is continued with all taps.
    """
    taps = [_below(tap, hand.heard_Hz) for tap in taps]
    ends = (float(hand.grips_N.min()), float(hand.grips_N.max()))
    coordinates = Coordinates(ends, SHARED)
    session = _Session.of(taps, coordinates)
    order = np.argsort(hand.grips_N)
    few = order[np.unique(np.linspace(0, order.size - 1, _FEW).round().astype(int))]
    part = _Session.of([taps[j] for j in few], coordinates)
    guess = _guess(hand, ends)
    random = np.random.default_rng(0)
    factors = np.vstack([np.ones(guess.size), 3.0 ** random.uniform(-1, 1, (starts - 1, guess.size))])
    # No parameter is negative at either end, and so none is between them, rounding included.
    least = _LEAST_SHARE * guess
    least[[0, 1, 1 + len(HAND)]] = _LEAST_KG  # the stylus, and the hand's mass at both ends
    bounds = least / guess, np.full(guess.size, np.inf)
    tried = part.squares(guess).searches(factors, *bounds, most=_TRIES, tolerance=_TOLERANCE, releases=_RELEASES)
    squares = session.squares(guess)
    best, _ = squares.search(tried[0][0], *bounds, most=_TRIES, tolerance=_TOLERANCE, releases=_RELEASES)
    return _with_uncertainty(
        session, squares.evaluate(best), best * guess, guess, hand, tuple(cost for _, cost in tried)
    )


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
    at: tuple[FloatArray, FloatArray],
    theta: FloatArray,
    scale: FloatArray,
    hand: HandFit,
    costs: tuple[float, ...],
) -> FourthOrderFit:
    """The fit at an optimum theta (11,), with covariance, intervals and undetermined parameters.

    Parameters
    ----------
    at : residuals at the optimum and their Jacobian with respect to theta in units of `scale`.
    """
    T, p = session.grips_N.size, theta.size
    residuals, J = at[0].reshape(T, -1), at[1]
    # One score per tap: the residuals of a tap are correlated, since its hand differs from that of other taps.
    scores = np.einsum("tnp,tn->tp", J.reshape(T, -1, p), residuals)
    bread, meat = inverse(J), scores.T @ scores
    covariance = np.outer(scale, scale) * (bread @ meat @ bread) * T / (T - p)
    ends_N = session.coordinates.held_N
    (_, to_lines), to_middle = session.coordinates.lines(), session.coordinates.at(float(np.mean(ends_N)))
    found = to_lines @ theta
    of_lines = to_lines @ covariance @ to_lines.T
    middle, of_middle = to_middle @ theta, to_middle @ covariance @ to_middle.T
    deviation = np.sqrt(np.diagonal(of_middle))
    names = (*SHARED, *(f"hand.{name}" for name in HAND))
    with np.errstate(divide="ignore", invalid="ignore"):  # a parameter that ended at zero counts as not determined
        uncertain = np.where(middle > 0, quantile(T - p) * deviation / middle, np.inf)
        correlation = np.nan_to_num(of_middle / np.outer(deviation, deviation))
    entangled = [
        (names[i], names[j]) for i in range(6) for j in range(i + 1, 6) if abs(correlation[i, j]) > ENTANGLED
    ]
    return FourthOrderFit(
        stylus_mass_kg=float(found[0]),
        lines={name: LinearInGrip(*found[1 + 2 * j : 3 + 2 * j].tolist()) for j, name in enumerate(HAND)},
        grips_N=tuple(hand.recorded_N),
        taps=T,
        rate_Hz=float(1 / session.dt_s.max()),
        window_s=float(session.window_s.min()),
        heard_Hz=hand.heard_Hz,
        intervals=intervals_around(found, of_lines, T - p),
        covariance=of_lines,
        uncertain=dict(zip(names, uncertain.tolist(), strict=True)),
        entangled=tuple(entangled),
        unexplained=float(np.median(np.linalg.norm(residuals, axis=1) * np.sqrt(session.every))),
        # Takeuchi's criterion: the error expected for other taps exceeds that of the fitted ones by 2 tr(bread meat).
        expected=session.every * float(np.sum(residuals**2) + 2 * np.sum(bread * meat)),
        second=session.every * float(np.sum(session.second_order(hand) ** 2)),
        starts=costs,
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
