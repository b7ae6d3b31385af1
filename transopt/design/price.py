"""What the limits that bind cost: the error with a wider one, and from where on it would not bind, both solved.

Nothing here is extrapolated. Multipliers are slopes at the limit as it stands; a step along them promises up to a
third more than there is to have, since what a wider limit buys falls off on the way. They tell which limits bind, and
no more.
"""

from dataclasses import dataclass, replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.base.writing import percent, rounded_up
from transopt.design.optimum import seek
from transopt.library.library import Library
from transopt.problem.answer import Multipliers, Status
from transopt.problem.leave_out import leave_out
from transopt.problem.limits.limit import Limit
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import Effect, boxes_of, inside
from transopt.solvers.choose import Certified, solve_certified
from transopt.solvers.options import SolverOptions, TrialOptions
from transopt.solvers.prove import certificates
from transopt.solvers.side_by_side import Ask, Search, together
from transopt.solvers.unlimited import solve as solve_unlimited

BINDS = 1e-8  # of J: what all of a limit would buy along its multipliers; below, rounding
AMPLE = (1.5, 6.0, 30.0)  # times what the optimum without limits takes: out of the way
NEAR = 1e-5  # of a limit: what comes no nearer is not held back by it
CLEARANCE = 2 * NEAR  # by which it lies above what it shall not hold back
ASIDE = 1.02  # times what is about enough: near it, and does not bind
NUDGE = 1e-4  # relative, upwards, where what was taken for enough binds; four times that where it does again
MOST_GUESSES, MOST_TRIALS = 8, 30  # from the peaks, and in all: the others halve what is left
STEP_SHARE = 0.25  # of a limit, where the step of its kind is more than there is of it


@dataclass(frozen=True)
class Price:
    """One limit that binds, with the others as they are.

    Attributes
    ----------
    limit, unit, step_unit : what it is called, its unit, and that of differences.
    bound : where it stands; for the coil the temperature.
    tap_error : against the recorded tap over the intention, with the limit there.
    step, then : by how much it is raised, and the tap error that is then the optimum's; NaN where that is not
        certified.
    enough, there : the least bound, to the digits that are printed, at which it does not bind, and the tap error
        there; NaN where no such answer is certified, infinity and NaN where it still binds at `tried`.
    tried : the widest bound that was solved for; infinite where the problem without the limit was.
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
        """The limit and where it stands."""
        return f"{self.limit} {_with_unit(f'{self.bound:.8g}', self.unit)}"

    @property
    def more(self) -> str:
        """The step."""
        return _with_unit(f"{self.step:g}", self.step_unit)

    @property
    def free_from(self) -> str:
        """From where on it does not bind, or why that is not known."""
        if np.isnan(self.enough):
            return "not certified"
        if np.isinf(self.enough):
            return f"still binds at {_with_unit(f'{self.tried:.4g}', self.unit)}"
        return _with_unit(f"{self.enough:.8g}", self.unit)

    @property
    def sentence(self) -> str:
        now, free = f"{percent(self.tap_error)} %", self.free_from
        then = f"no certified answer with {self.more} more, so no price"
        if not np.isnan(self.then):
            then = f"{self.more} more gives a tap error of {percent(self.then)} % in place of {now}"
        if np.isfinite(self.enough):
            free = f"would not bind from {free} on, with {percent(self.there)} %"
        elif np.isnan(self.enough):
            free = "from where on it would not bind is not certified"
        return f"{self.stated}: {then}, {free}"


def _with_unit(number: str, unit: str) -> str:
    """A number with its unit; a limit of a user's own may have none."""
    return f"{number} {unit}".rstrip()


def price_step(limit: Limit) -> float:
    """Step by which a limit is raised: that of its kind or, if that is more than there is of it, a share.

    The share is the largest of 1, 2, 5 times a power of ten that is at most a quarter.
    """
    if limit.price_step <= limit.room:
        return limit.price_step
    size = STEP_SHARE * limit.room
    power = 10.0 ** np.floor(np.log10(size))
    return float(max(m for m in (1, 2, 5) if m * power <= size * (1 + 1e-12)) * power)


def binding(
    problem: TransientProblem, command: FloatArray, multipliers: Multipliers, *, effect: Effect | None = None
) -> dict[str, float]:
    """Name of every limit that binds -> slope: by how much J falls per unit by which it is raised, to first order.

    Multipliers count where the limit is reached. Near a limit that is just not reached a solver leaves some as well,
    since it knows only their product with the distance.

    Parameters
    ----------
    effect : of this command in this problem, where it is known already.
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


def _excess(effect: Effect, limit: Limit) -> float:
    """How far a limit has to be raised for a command to keep it; negative where it is kept."""
    of = boxes_of(effect, Multipliers.zero(effect.problem), only=limit.name)
    return max(float(box.excess.max()) for box in of)


@dataclass(frozen=True)
class _Answer:
    """A certified optimum of a problem with other limits.

    Attributes
    ----------
    effect : of its command in the problem that has been solved. multipliers : its own.
    tap_error : against the recorded tap over the intention.
    binding : of `binding`.
    """

    effect: Effect
    multipliers: Multipliers
    tap_error: float
    binding: dict[str, float]


def _solved(problem: TransientProblem, options: SolverOptions, unlimited: Effect) -> Search[_Answer | None]:
    """Search for the optimum; None where it is not certified, as an entry of a library has to be.

    Parameters
    ----------
    unlimited : about what the optimum without limits does.
    """
    small = leave_out(problem).problem
    if small.wall is None and small.thermal is None and not small.nonlinear:
        found = (yield from _without_limits(small)) if _nearly_inside(unlimited.of(small)) else None
        answer, proof, effect = found or (yield Ask(solve_certified, small, (options,)))
        certified = answer.status is Status.OPTIMAL and proof.accepted
    else:
        # The ticks at which the wall pushes are looked for, and whether the temperature binds at all.
        designed = yield from seek(problem, options)
        small, answer, effect = designed.problem, designed.solution, designed.effect
        bent = any(name != TemperatureLimit.name for name in problem.nonlinear)
        certified = designed.is_proven and (designed.certificate.accepted or bent)
    if not certified:
        return None
    error = small.yardstick.tap_error(small.target, effect.motion.acceleration_m_s2)
    return _Answer(
        effect, answer.multipliers, error, binding(small, answer.command, answer.multipliers, effect=effect)
    )


def _nearly_inside(effect: Effect) -> bool:
    """Whether a command keeps all limits of its problem, or little is missing."""
    of = boxes_of(effect, Multipliers.zero(effect.problem))
    return all(bool((box.excess <= (ASIDE - 1) * box.limit.stated).all()) for box in of)


def _without_limits(problem: TransientProblem) -> Search[Certified | None]:
    """The optimum without limits, where it keeps them all and is proven: one linear solve."""
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
    unlimited : what its optimum without limits does.
    tap_error : of its own optimum.
    """

    problem: TransientProblem
    unlimited: Effect
    tap_error: float
    options: SolverOptions

    def price(self, limit: Limit) -> Search[Price]:
        step = price_step(limit)
        raised = free = yield from self._raised(limit, step)
        widest = limit.stated + step
        if free is None or limit.name in free.binding:
            free, widest = yield from self._out_of_the_way(limit)
        enough, there = (np.nan, np.nan)
        if free is not None and limit.name in free.binding:
            enough = np.inf
        elif free is not None:
            # A limit that does not bind is stated at the switching instants alone.
            plain = replace(self, problem=self.problem.within(dict.fromkeys(self.problem.parts, 1)))
            enough, there = yield from plain._enough(plain.problem.limits[limit.name], free, widest)
        return Price(
            limit=limit.label,
            unit=limit.unit,
            step_unit=limit.step_unit,
            bound=limit.stated,
            tap_error=self.tap_error,
            step=step,
            then=np.nan if raised is None else raised.tap_error,
            enough=enough,
            there=there,
            tried=widest,
        )

    def _beyond(self, limit: Limit, answer: _Answer) -> float:
        """How far this problem's limit would have to be raised for another problem's answer to keep it."""
        return _excess(answer.effect.of(self.problem), limit)

    def _raised(self, limit: Limit, by: float) -> Search[_Answer | None]:
        return _solved(self.problem.replaced(limit.raised(by)), self.options, self.unlimited)

    def _keeps(self, limit: Limit, by: float, without: _Answer) -> Search[bool]:
        """Whether the optimum without a limit is proven to be that with the limit raised by so much.

        Where the limit is in J as well the two have another J.
        """
        if limit.scales_movement:
            return False
        raised = without.effect.of(self.problem.replaced(limit.raised(by)))
        proof = yield Ask(certificates, (raised, without.multipliers))
        return proof.accepted and inside(raised.problem, raised.command, only=limit.name, effect=raised)

    def _out_of_the_way(self, limit: Limit) -> Search[tuple[_Answer | None, float]]:
        """The optimum without a limit, or with one that is so wide that it does not bind, and how wide it was."""
        if not limit.indispensable:
            return (yield from _solved(self.problem.without(limit.name), self.options, self.unlimited)), np.inf
        needed = limit.stated + max(_excess(self.unlimited, limit), 0.0)
        for ample in AMPLE:
            answer = yield from self._raised(limit, ample * needed - limit.stated)
            if answer is None or limit.name not in answer.binding:
                break
        return answer, ample * needed

    def _enough(self, limit: Limit, without: _Answer, widest: float) -> Search[tuple[float, float]]:
        """The least bound at which a limit does not bind, and the tap error there: solved for, and found not to bind.

        What the optimum without the limit takes of it is enough, since any wider one has that same optimum. Only the
        limit on the current also stands in J, as the unit I of the movement's weight, so that the optimum takes p(I)
        of it; a weight that goes with 1 / I^2 makes p a straight line over 1 / I^2, whose crossing with I is sought.

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
            bound = float(f"{rounded_up(max(peak + CLEARANCE * limit.room, least)):.8g}")
            if bound >= high[0]:
                return high if np.isfinite(high[0]) else (np.nan, np.nan)
            if (yield from self._keeps(limit, bound - limit.stated, without)):
                return bound, without.tap_error
            answer = yield from self._raised(limit, bound - limit.stated)
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
    effect: Effect | None = None,
) -> list[Price]:
    """Price of every limit that binds, the dearest first; empty if none does.

    Each is two to four further optima: with the limit raised by a step, with it out of the way, and at what is then
    said to be enough. The others stay as they are. Where the optimum without limits is one of them it is not searched
    for by a method that has limits, and one that is known already only has to be proven. Where the worst of several
    devices counts, so do their shares: to first order it falls with the mean by these.

    Parameters
    ----------
    command, multipliers : (N,) and its multipliers: the certified optimum.
    unlimited : (N,) the optimum without limits.
    effect : of the certified optimum in this problem, where it is known already.
    """
    if problem.reference_is_zero:
        return []
    problem = replace(problem, worst=False)
    effect = Effect(problem, command) if effect is None else effect.of(problem)
    binds = binding(problem, command, multipliers, effect=effect)
    if not binds:
        return []
    error = problem.tap_error(effect.motion.acceleration_m_s2)
    trials = TrialOptions(options.solver, options.tolerance, options.max_iterations)
    pricing = _Pricing(problem, Effect(problem, unlimited), error, trials)
    found = together([pricing.price(limit) for limit in problem.limits if limit.name in binds])
    return sorted(found, key=lambda price: np.inf if np.isnan(price.then) else price.then)


def library_prices(library: Library, iv: int, ig: int) -> list[Price]:
    """Prices of an entry of a library file; empty on a nonlinear plant, whose answer is no proven optimum."""
    if library.nonlinear:
        return []
    problem = library.problem(iv, ig)
    free = solve_unlimited([problem.without_intensity()])[0].command
    return prices(problem, library.command[iv, ig], library.multipliers(iv, ig), free, SolverOptions())
