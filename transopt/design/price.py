"""Prices of binding limits: the tap error with the limit raised by a step, and the bound at which it stops binding.

Both are found by solving the changed problem, not by extrapolation. Multipliers are derivatives at the present limit.
A step extrapolated with them promises up to a third more than can be gained, since the gain flattens along the step.
They only identify the limits that bind.
"""

from dataclasses import dataclass, replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.base.writing import percent, rounded_up
from transopt.design.intensity import best
from transopt.library.library import Library
from transopt.problem.answer import Multipliers, Status
from transopt.problem.leave_out import leave_out
from transopt.problem.limits.limit import Limit
from transopt.problem.problem import TransientProblem
from transopt.proof.effect import Effect, boxes_of, inside
from transopt.solvers.choose import Certified, solve_certified
from transopt.solvers.options import SolverOptions, TrialOptions
from transopt.solvers.prove import certificates
from transopt.solvers.side_by_side import Ask, Search, together
from transopt.solvers.unlimited import solve as solve_unlimited

BINDS = 1e-8  # a limit binds if its multipliers times its bound exceed this share of J; less is rounding
AMPLE = (1.5, 6.0, 30.0)  # bounds tried as not binding, in multiples of what the unlimited optimum takes
NEAR = 1e-5  # share of a limit; a limit does not bind while the distance to it is larger
CLEARANCE = 2 * NEAR  # distance of a sufficient bound above the peak, as a share of the limit
ASIDE = 1.02  # factor on the estimate of a sufficient bound: close to it, but not binding
DIGITS = 2  # of the rise to a sufficient bound: more are in nobody's data sheet
NUDGE = 1e-4  # relative increase of a bound that was estimated as sufficient but binds; four times that on repetition
MOST_GUESSES, MOST_TRIALS = 8, 30  # trials from peaks, and trials in all: the others bisect
STEP_SHARE = 0.25  # largest step relative to the limit, where the step of its kind is larger than the limit


@dataclass(frozen=True)
class Price:
    """Price of one binding limit, the other limits unchanged; all bounds are in the unit of the limit's scene key.

    Attributes
    ----------
    limit, unit, step_unit : name of the limit, its unit, and the unit of differences of it.
    bound : the present bound, of a limit with two that differ the one that binds more; for the coil the temperature.
    tap_error : tap error of the optimum at the present bound, over the time of the intention.
    step, then : change of the bound that widens the limit, below 0 for a lower bound, and tap error of the optimum
        with it; NaN if that optimum is not certified.
    enough, there : the nearest bound at which the limit does not bind, its change rounded up to two digits, and the
        tap error there; NaN if no such answer is certified, infinity and NaN if the limit still binds at `tried`.
    tried : the widest bound that was solved for; infinite if the problem was solved without the limit.
    """

    limit: str
    unit: str
    step_unit: str
    bound: float
    tap_error: float
    step: float
    then: float
    enough: float
    there: float
    tried: float

    @property
    def stated(self) -> str:
        """The limit's name and its present bound as text."""
        return f"{self.limit} {_with_unit(f'{self.bound:.8g}', self.unit)}"

    @property
    def more(self) -> str:
        """The step as text, with its unit."""
        return _with_unit(f"{self.step:g}", self.step_unit)

    @property
    def free_from(self) -> str:
        """The bound from which on the limit does not bind as text, or why it is not known."""
        if np.isnan(self.enough):
            return "not certified"
        if np.isinf(self.enough):
            return f"still binds at {_with_unit(f'{self.tried:.4g}', self.unit)}"
        return _with_unit(f"{self.enough:.8g}", self.unit)

    @property
    def sentence(self) -> str:
        at = _with_unit(f"{self.bound + self.step:.8g}", self.unit)
        then = (
            f"no certified answer at {at} and so no price"
            if np.isnan(self.then)
            else f"{percent(self.then)} % at {at}"
        )
        if np.isfinite(self.enough):
            free = f"{percent(self.there)} % from {self.free_from} on, where it no longer binds"
        elif np.isnan(self.enough):
            free = "not certified from where on it no longer binds"
        else:
            free = self.free_from
        return f"{self.stated}: tap error {percent(self.tap_error)} %, {then}, {free}"


def _with_unit(number: str, unit: str) -> str:
    """A number with its unit; a user-defined limit may have no unit."""
    return f"{number} {unit}".rstrip()


def price_step(limit: Limit) -> float:
    """Step by which a limit is raised: the step of its kind or, if that is too large for the limit, a share of it.

    That share is the largest number of the form 1, 2 or 5 times a power of ten, up to a quarter of the limit.
    """
    if limit.price_step <= limit.room:
        return limit.price_step
    size = STEP_SHARE * limit.room
    power = 10.0 ** np.floor(np.log10(size))
    return float(max(m for m in (1, 2, 5) if m * power <= size * (1 + 1e-12)) * power)


def binding(
    problem: TransientProblem, command: FloatArray, multipliers: Multipliers, *, effect: Effect | None = None
) -> dict[str, float]:
    """Name of every binding limit -> slope: decrease of J per unit by which the limit is raised, to first order.

    Only multipliers at instants at which the limit is reached count. An interior-point solver also leaves small
    multipliers where the limit is nearly reached, since it drives only the product of multiplier and slack to zero.

    Parameters
    ----------
    effect : the command's effect in this problem, if it is known already.
    """
    found: dict[str, float] = {}
    if multipliers.largest == 0:
        return found
    for box in boxes_of(effect or Effect(problem, command), multipliers):
        near = NEAR * box.limit.room
        gain = float(box.by_upper[box.upper - box.value <= near].sum()) if box.by_upper.any() else 0.0
        gain += float(box.by_lower[box.value - box.lower <= near].sum()) if box.by_lower.any() else 0.0
        found[box.limit.name] = found.get(box.limit.name, 0.0) + gain
    return {name: gain for name, gain in found.items() if gain * problem.limits[name].room > BINDS}


def _binds_below(effect: Effect, multipliers: Multipliers, limit: Limit) -> bool:
    """Whether a limit's lower bound costs more than its upper one."""
    of = boxes_of(effect, multipliers, only=limit.name)
    return sum(float((box.by_lower - box.by_upper).sum()) for box in of) > 0


def _excess(effect: Effect, limit: Limit) -> float:
    """Increase of a limit's bound that a command needs to keep the limit; negative if the limit is kept already."""
    of = boxes_of(effect, Multipliers.zero(effect.problem), only=limit.name)
    return max(float(box.excess.max()) for box in of)


@dataclass(frozen=True)
class _Answer:
    """A certified optimum of a problem with other limits.

    Attributes
    ----------
    effect : effect of its command in the solved problem. multipliers : those of the solved problem.
    tap_error : against the recorded tap, over the time of the intention.
    binding : result of `binding`: limit -> slope.
    """

    effect: Effect
    multipliers: Multipliers
    tap_error: float
    binding: dict[str, float]


def _solved(
    problem: TransientProblem, options: SolverOptions, unlimited: Effect, objective: str
) -> Search[_Answer | None]:
    """Search for the optimum; None if it is not certified in the way that an entry of a library has to be.

    Parameters
    ----------
    unlimited : effect of an approximate unlimited optimum; it decides whether the unlimited problem is tried first.
    objective : of the scene. For intensity the search finds lam anew, for the worst device the shares: those of one
        limit are not those of another.
    """
    small = leave_out(problem).problem
    searched = objective == "intensity" or problem.worst
    if not searched and small.wall is None and small.thermal is None and not small.nonlinear:
        found = (yield from _without_limits(small)) if _nearly_inside(unlimited.of(small)) else None
        answer, proof, effect = found or (yield Ask(solve_certified, small, (options,)))
        certified = answer.status is Status.OPTIMAL and proof.accepted
    else:
        # It also finds the ticks at which the wall pushes, and drops the temperature limit if it does not bind.
        designed = yield from best(problem, options, objective=objective)
        small, answer, effect = designed.problem, designed.solution, designed.effect
        certified = designed.is_accepted
    if not certified:
        return None
    error = small.yardstick.tap_error(small.target, effect.lasting.acceleration_m_s2)
    return _Answer(
        effect, answer.multipliers, error, binding(small, answer.command, answer.multipliers, effect=effect)
    )


def _nearly_inside(effect: Effect) -> bool:
    """Whether a command keeps all limits of its problem, up to a small excess."""
    of = boxes_of(effect, Multipliers.zero(effect.problem))
    return all(bool((box.excess <= (ASIDE - 1) * box.limit.stated).all()) for box in of)


def _without_limits(problem: TransientProblem) -> Search[Certified | None]:
    """The unlimited optimum, by one linear solve; None unless it keeps all limits and is proven."""
    answer = yield Ask(solve_unlimited, problem)
    effect = Effect(problem, answer.command)
    if answer.status is not Status.OPTIMAL or not inside(problem, answer.command, effect=effect):
        return None
    proof = yield Ask(certificates, (effect, answer.multipliers))
    return Certified(answer, proof, effect) if proof.is_stationary else None


@dataclass(frozen=True)
class _Pricing:
    """One entry whose limits are priced.

    Attributes
    ----------
    unlimited : effect of the entry's unlimited optimum.
    tap_error : tap error of the entry's own optimum.
    objective : of the scene, "waveform" or "intensity".
    """

    problem: TransientProblem
    unlimited: Effect
    tap_error: float
    options: SolverOptions
    objective: str

    def price(self, limit: Limit, *, lower: bool) -> Search[Price]:
        """Search for the price of a limit, named by its `lower` bound or by the upper one."""
        step = price_step(limit)
        raised = free = yield from self._raised(limit, step)
        widest = limit.stated + step
        if free is None or limit.name in free.binding:
            free, widest = yield from self._out_of_the_way(limit, raised)
        enough, there = (np.nan, np.nan)
        if free is not None and limit.name in free.binding:
            enough = np.inf
        elif free is not None:
            # A limit that does not bind need not be stated between the switching instants.
            plain = replace(self, problem=self.problem.within(dict.fromkeys(self.problem.parts, 1)))
            enough, there = yield from plain._enough(plain.problem.limits[limit.name], free, widest)
        return Price(
            limit=limit.label,
            unit=limit.key_unit(),
            step_unit=limit.key_unit(step=True),
            bound=limit.written(lower=lower),
            tap_error=self.tap_error,
            step=limit.written(step, lower=lower) - limit.written(lower=lower),
            then=np.nan if raised is None else raised.tap_error,
            enough=limit.written(enough - limit.stated, lower=lower),
            there=there,
            tried=limit.written(widest - limit.stated, lower=lower),
        )

    def _beyond(self, limit: Limit, answer: _Answer) -> float:
        """Increase of this problem's limit that another problem's answer would need to keep it."""
        return _excess(answer.effect.of(self.problem), limit)

    def _raised(self, limit: Limit, by: float, near: _Answer | None = None) -> Search[_Answer | None]:
        return self._optimum(self.problem.replaced(limit.raised(by)), near)

    def _optimum(self, problem: TransientProblem, near: _Answer | None) -> Search[_Answer | None]:
        """Search for an optimum; for the worst device from the shares of an answer with other limits, `near`."""
        if near is not None and problem.worst:
            problem = replace(problem, shares=near.effect.problem.shares)
        return _solved(problem, self.options, self.unlimited, self.objective)

    def _keeps(self, limit: Limit, by: float, without: _Answer) -> Search[bool]:
        """Whether the optimum `without` a limit is certified as the optimum with the limit raised by `by`.

        Always False for a limit that also scales J, since the two problems then have different objectives.
        """
        if limit.scales_movement:
            return False
        found = without.effect.problem
        own = replace(self.problem, intensity=found.intensity, shares=found.shares)
        raised = without.effect.of(own.replaced(limit.raised(by)))
        proof = yield Ask(certificates, (raised, without.multipliers))
        return proof.accepted and inside(raised.problem, raised.command, only=limit.name, effect=raised)

    def _out_of_the_way(self, limit: Limit, near: _Answer | None) -> Search[tuple[_Answer | None, float]]:
        """The optimum without a limit, or with a bound so wide that it does not bind, and that bound."""
        if not limit.indispensable:
            return (yield from self._optimum(self.problem.without(limit.name), near)), np.inf
        needed = limit.stated + max(_excess(self.unlimited, limit), 0.0)
        for ample in AMPLE:
            answer = yield from self._raised(limit, ample * needed - limit.stated, near)
            if answer is None or limit.name not in answer.binding:
                break
        return answer, ample * needed

    def _enough(self, limit: Limit, without: _Answer, widest: float) -> Search[tuple[float, float]]:
        """The least bound at which a limit does not bind, and the tap error there, confirmed by a solve or a proof.

        The peak of the optimum without the limit is enough, since any wider bound has the same optimum. Only the
        limit I on the current also scales J, as the unit of the movement's weight, so that the peak is a function
        p(I). A weight proportional to 1 / I^2 makes p about linear in 1 / I^2; the bound is the solution of p(I) = I.

        Parameters
        ----------
        without : the optimum with the limit at `widest`, where it does not bind.
        """
        by = max(self._beyond(limit, without), 0.0)
        free, low, high, nudge = [(widest, limit.stated + by)], limit.stated, (widest, without.tap_error), NUDGE
        for trial in range(MOST_TRIALS):
            peak = free[0][1] if len(free) < 2 else _crossing(*free[-2:])
            if limit.scales_movement and len(free) < 2 and peak * ASIDE < widest:
                peak *= ASIDE
            if trial >= MOST_GUESSES:
                peak = float(np.sqrt(low * high[0]))
            least = low if low == limit.stated else low * (1 + nudge)
            rise = rounded_up(max(peak + CLEARANCE * limit.room, least) - limit.stated, DIGITS)
            bound = float(f"{limit.stated + rise:.8g}")
            if bound >= high[0]:
                return high if np.isfinite(high[0]) else (np.nan, np.nan)
            if (yield from self._keeps(limit, bound - limit.stated, without)):
                return bound, without.tap_error
            answer = yield from self._raised(limit, bound - limit.stated, without)
            if answer is None:
                break
            if limit.name in answer.binding:
                low, nudge = bound, 4 * nudge
                continue
            high = bound, answer.tap_error
            if not limit.scales_movement:
                return high
            free.append((bound, limit.stated + self._beyond(limit, answer)))
        return np.nan, np.nan


def _crossing(one: tuple[float, float], two: tuple[float, float]) -> float:
    """Solve p(I) = I for p a straight line over 1 / I^2 through two points (I, p)."""
    (limit, peak), (other, its_peak) = one, two
    slope, found = (peak - its_peak) / (limit**-2 - other**-2), its_peak
    for _ in range(20):
        found = its_peak + slope * (found**-2 - other**-2)
    return found


def prices(
    problem: TransientProblem,
    command: FloatArray,
    multipliers: Multipliers,
    unlimited: FloatArray,
    options: SolverOptions,
    *,
    objective: str = "waveform",
    effect: Effect | None = None,
) -> list[Price]:
    """Price of every binding limit, the most expensive first; empty if no limit binds.

    Each price takes two to four further optima: with the limit raised by a step, with the limit out of the way, and
    at the bound that is then estimated as sufficient. The other limits stay unchanged. An optimum that is the
    unlimited one takes one linear solve, and an optimum that is already known only a proof. Where intensity has a
    price or the worst of several devices counts, each of them is a search of its own.

    Parameters
    ----------
    command, multipliers : the certified optimum, (N,), with its multipliers.
    unlimited : (N,) the unlimited optimum.
    objective : of the scene, "waveform" or "intensity".
    effect : effect of the certified optimum in this problem, if it is known already.
    """
    if problem.reference_is_zero:
        return []
    effect = effect or Effect(problem, command)
    binds = binding(problem, command, multipliers, effect=effect)
    if not binds:
        return []
    error = problem.yardstick.tap_error(problem.target, effect.lasting.acceleration_m_s2)
    trials = TrialOptions(options.solver, options.tolerance, options.max_iterations)
    pricing = _Pricing(problem, Effect(problem, unlimited), error, trials, objective)
    found = together(
        [
            pricing.price(limit, lower=_binds_below(effect, multipliers, limit))
            for limit in problem.limits
            if limit.name in binds
        ]
    )
    return sorted(found, key=lambda price: np.inf if np.isnan(price.then) else price.then)


def library_prices(library: Library, iv: int, ig: int) -> list[Price]:
    """Prices of an entry of a library file; empty on a nonlinear plant, whose answer is not a proven optimum."""
    if library.nonlinear:
        return []
    problem, objective = library.problem(iv, ig), library.posing().objective
    free = solve_unlimited([problem.without_intensity()])[0].command
    answer = library.command[iv, ig], library.multipliers(iv, ig)
    return prices(problem, *answer, free, SolverOptions(), objective=objective)
