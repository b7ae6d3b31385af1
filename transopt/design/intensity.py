"""The root search over the price of intensity: the least lam at which an entry attains the requested energy.

Where limits bind, the waveform nearest to the target is too weak. L = J - lam (energy - requested energy) is a sum of
squares for every lam below the smallest weight. Its minimiser c(lam) is the global optimum of J subject to at least
the energy of c(lam): no admissible command with as much energy has a smaller J, up to the certified gap of L. The
energy grows with lam, so the search is for one scalar.

Without limits c(lam) produces y'' = r / (1 - lam), so that the energy in dB is linear in t = -log(1 - lam). Limits
bend this curve, but two solved problems give more than two points of it: by the envelope theorem dJ = lam d(energy)
along the path, so the difference of their J is the integral of lam over the energy between them. The search follows
the parabola t(dB) through both points with this integral. It stays inside a bracket, which is halved where the
parabola makes too little progress (as in the projection step of ITP: Oliveira and Takahashi, ACM Trans. Math. Softw.
47, 2020).
"""

from dataclasses import dataclass, replace

import numpy as np

from transopt.design.optimum import seek
from transopt.design.worst import least_worst
from transopt.problem.problem import TransientProblem
from transopt.proof.designed import Attained, Designed, TOLERANCE_dB
from transopt.proof.effect import free_optima
from transopt.solvers import unlimited
from transopt.solvers.options import SolverOptions
from transopt.solvers.side_by_side import Search

MOST = 0.99  # largest lam, relative to the smallest tracking weight and to 1, so that L stays convex
MOST_PROBLEMS = 14
FIRST_dB = 4.0  # assumed dB per unit of t in the first step: 8.7 without limits, about this where a limit binds
SLOW = 0.5  # the bracket is halved if a step misses by more than this share of the older problem's miss
INSET = 1e-3  # share of the bracket by which a candidate keeps away from its ends
STEEPEST = 0.9  # largest deviation of the parabola's slope at its ends from the chord's slope, relative to the latter
NEWTON = 8
NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)
NARROW = 1e-9  # width of a bracket in lam below which the energy is taken to jump inside it


@dataclass(frozen=True)
class _Tried:
    """A lam whose problem was solved: energy relative to that of r [dB], objective J, and the answer."""

    lam: float
    energy_dB: float
    objective: float
    designed: Designed

    @property
    def t(self) -> float:
        return float(-np.log1p(-self.lam))


def most_price(problem: TransientProblem) -> float:
    """The largest lam that is tried; 0 where a weight of the last error term is zero."""
    return MOST * min(1.0, float(problem.terms[-1].weights.min()))


def intense(problem: TransientProblem, options: SolverOptions) -> Search[Designed]:
    """Search for the minimiser of L whose energy is `problem.intensity_dB`.

    The unlimited optimum and its figures stay those of J. The certificate is that of L at the lam found. The search's
    remaining energy error is stated in dB (`Designed.attained`) and is not part of the gap.
    """
    first = yield from seek(problem.without_intensity(), options)
    if not first.is_proven or problem.reference_is_zero:
        return first
    found, problems, spent_s = yield from _search(problem.within(first.problem.parts), first, options)
    wave = _tried(0.0, first)
    attained = Attained(
        asked_dB=problem.intensity_dB,
        energy_dB=found.energy_dB,
        waveform_dB=wave.energy_dB,
        waveform_tap_error=problem.yardstick.tap_error(problem.target, first.effect.lasting.acceleration_m_s2),
        price=found.lam,
        most=most_price(problem),
        problems=problems,
    )
    return replace(
        found.designed,
        solution=replace(found.designed.solution, solve_time_s=spent_s),
        unlimited_command=first.unlimited_command,
        floor=first.floor,
        free_peak=first.free_peak,
        unlimited_objective=first.unlimited_objective,
        attained=attained,
    )


def best(problem: TransientProblem, options: SolverOptions, *, objective: str) -> Search[Designed]:
    """Search for the optimum of a scene's objective: "waveform" minimises J, "intensity" asks for energy too.

    Where the scene asks for the worst of a spread of devices, the largest loss over the devices is minimised.
    """
    if problem.worst:
        return least_worst(problem, options)
    if objective == "intensity":
        return (yield from intense(problem, options))
    designed = yield from seek(problem, options)
    if problem.intensity == 0:
        return designed
    # lam is given, as by a library that is solved again; what no limit holds back is the waveform, here as well.
    waveform = problem.without_intensity()
    (answer,) = unlimited.solve([waveform])
    ((_, free),) = free_optima([(waveform, answer.command)])
    return replace(
        designed,
        unlimited_command=free.command,
        floor=free.floor,
        free_peak=free.peak,
        unlimited_objective=free.objective,
    )


def _tried(lam: float, designed: Designed) -> _Tried:
    accelerations = designed.effect.accelerations_m_s2
    energy_dB = designed.problem.tracking.energy_dB(accelerations)
    return _Tried(lam, energy_dB, designed.certificate.objective, designed)


@dataclass
class _Bracket:
    """The interval that contains the lam searched for.

    Attributes
    ----------
    is_open : whether no upper bound has been found yet; the upper end is then a candidate itself.
    """

    low: float
    high: float
    is_open: bool = True

    @property
    def is_empty(self) -> bool:
        return self.high - self.low <= NARROW

    @property
    def halfway(self) -> float:
        """The candidate that interpolation does not choose: the untried upper end, or else the midpoint."""
        return self.high if self.is_open else 0.5 * (self.low + self.high)

    def inside(self, lam: float) -> float:
        """Clip lam to the bracket, a little away from the ends that were tried."""
        inset = INSET * (self.high - self.low)
        return min(max(lam, self.low + inset), self.high if self.is_open else self.high - inset)

    def cut(self, lam: float, *, too_weak: bool) -> None:
        """Make a lam that was tried the new lower or upper end."""
        if too_weak:
            self.low = lam
        else:
            self.high, self.is_open = lam, False


def _search(problem: TransientProblem, first: Designed, options: SolverOptions) -> Search[tuple[_Tried, int, float]]:
    """The lam found with its answer, the number of problems solved, and their total solver time [s]."""
    asked_dB = problem.intensity_dB

    def missed_dB(each: _Tried) -> float:
        return abs(each.energy_dB - asked_dB)

    tried, problems, spent_s = [_tried(0.0, first)], 1, first.solution.solve_time_s
    if tried[0].energy_dB >= asked_dB - TOLERANCE_dB:
        return tried[0], problems, spent_s
    bracket, slow = _Bracket(0.0, most_price(problem)), False
    while not bracket.is_empty and problems < MOST_PROBLEMS:
        nearest = sorted(tried, key=missed_dB)[:2]
        lam = bracket.halfway if slow else _next(nearest, asked_dB)
        if not bracket.low < lam < bracket.high:
            # Extrapolation from the two nearest points leaves the bracket: interpolate between its ends instead.
            ends = [each for each in tried if each.lam in (bracket.low, bracket.high)]
            lam = bracket.halfway if len(ends) < 2 else _next(ends, asked_dB)
        lam = bracket.inside(lam)
        designed = yield from seek(replace(problem, intensity=lam), options)
        problems += 1
        spent_s += designed.solution.solve_time_s
        if not designed.is_proven:
            # The energy at this lam is unknown: treat it as an upper end, and halve the bracket next.
            bracket.cut(lam, too_weak=False)
            slow = True
            continue
        here = _tried(lam, designed)
        tried.append(here)
        if missed_dB(here) <= TOLERANCE_dB:
            break
        slow = not slow and missed_dB(here) > SLOW * missed_dB(nearest[-1])
        bracket.cut(lam, too_weak=here.energy_dB < asked_dB)
    # If even the highest lam is too weak, it is the result; near-equal energies could otherwise rank by rounding.
    last = max(tried, key=lambda each: each.lam)
    unreached = last.lam == most_price(problem) and last.energy_dB < asked_dB - TOLERANCE_dB
    return last if unreached else min(tried, key=missed_dB), problems, spent_s


def _next(nearest: list[_Tried], asked_dB: float) -> float:
    """The next lam, extrapolated from one solved problem or interpolated from two."""
    first = nearest[0]
    t = first.t + (asked_dB - first.energy_dB) / FIRST_dB
    if len(nearest) > 1:
        t = _parabola(first, nearest[1], asked_dB)
    return float(-np.expm1(-max(t, 0.0)))  # t < 0 has no meaning; the bracket then chooses


def _parabola(one: _Tried, other: _Tried, at_dB: float) -> float:
    """t at an energy, by the parabola t(dB) through two points.

    The parabola's integral of lam d(energy) equals the difference of the two J. With the chord t_c it is
    t = t_c + c (dB - dB_1) (dB - dB_2); Newton's method finds c, which is bounded so that t increases over the whole
    interval.
    """
    low, high = sorted((one, other), key=lambda each: each.energy_dB)
    width = high.energy_dB - low.energy_dB
    if width <= 0 or high.t <= low.t:
        return 0.5 * (low.t + high.t)
    slope = (high.t - low.t) / width
    dB = low.energy_dB + 0.5 * width * (1 + NODES)
    energy = 10 ** (dB / 10)
    weights = 0.5 * width * WEIGHTS * energy * np.log(10) / 10  # of d(energy)
    chord, bow = low.t + slope * (dB - low.energy_dB), (dB - low.energy_dB) * (dB - high.energy_dB)
    # J is relative to the whole energy of the reference; the requested energy counts its share within the window.
    tracking = low.designed.problem.tracking
    share = float(np.sum(tracking.unit_wanted[-1, : tracking.target.window_m_s2.size] ** 2))
    wanted = (high.objective - low.objective) / share
    c, most = 0.0, STEEPEST * slope / width
    for _ in range(NEWTON):
        remaining = np.exp(-chord - c * bow)  # 1 - lam
        missed, by_c = float(weights @ (1 - remaining)) - wanted, float(weights @ (remaining * bow))
        c = float(np.clip(c - missed / by_c, -most, most))
    return low.t + slope * (at_dB - low.energy_dB) + c * (at_dB - low.energy_dB) * (at_dB - high.energy_dB)
