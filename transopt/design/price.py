"""What binds, in the user's words: the price of each limit and the least limit that would not bind."""

from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray
from transopt.base.writing import rounded_up
from transopt.problem.answer import Multipliers, Status
from transopt.problem.leave_out import leave_out
from transopt.problem.limits.limit import Limit
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import boxes, inside
from transopt.solvers.choose import solve_certified
from transopt.solvers.options import SolverOptions

WORTH_SAYING = 1e-9  # of J per unit of the limit
AMPLE = (1.5, 6.0, 30.0)  # times what the unlimited optimum takes: out of the way
LEAST_STEP = 1e-6  # of the limit
CLEAR = 0.999  # of a bound: what stays below is not held by it
STEP_SHARE = 0.25  # of the limit, at most, by which it is raised in the sentence


@dataclass(frozen=True)
class Price:
    """One limit that binds.

    Attributes
    ----------
    limit, unit, step_unit : what it is called, its unit, and that of differences.
    bound : where it stands; for the coil the temperature.
    slope : dNRMSE per unit of the limit, negative; from the multipliers.
    step : by how much it is raised in the sentence. nrmse, then : now and, to first order, after that step.
    enough : least bound at which it would not bind, the other limits as they are.
    """

    limit: str
    unit: str
    step_unit: str
    bound: float
    slope: float
    step: float
    nrmse: float
    then: float
    enough: float

    @property
    def sentence(self) -> str:
        enough = "binds however wide it is"
        if np.isfinite(self.enough):
            enough = f"would not bind from {_stated(f'{rounded_up(self.enough):.8g}', self.unit)} on"
        bound, step = _stated(f"{self.bound:g}", self.unit), _stated(f"{self.step:g}", self.step_unit)
        return (
            f"{self.limit} {bound}: {step} more: NRMSE {100 * self.nrmse:.3g} % to {100 * self.then:.3g} %; {enough}"
        )


def _stated(number: str, unit: str) -> str:
    """A number with its unit; a limit of a user's own may have none."""
    return f"{number} {unit}".rstrip()


def _round_step(size: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above `size`."""
    power = 10.0 ** np.floor(np.log10(size))
    return float(max(m for m in (1, 2, 5) if m * power <= size * (1 + 1e-12)) * power)


def _peak(problem: TransientProblem, limit: Limit, command_A: FloatArray) -> float:
    """Largest value that a command reaches of what one limit bounds."""
    found = boxes(problem, command_A, problem.stage.motion(command_A), Multipliers.zero(problem))
    return max(box.peak for box in found if box.limit.name == limit.name)


@dataclass(frozen=True)
class _Without:
    """What an optimum without one limit takes of it, and its NRMSE: no wider limit can do better."""

    enough: float
    nrmse: float


def _without(problem: TransientProblem, limit: Limit, unlimited_A: FloatArray, options: SolverOptions) -> _Without:
    """The optimum with one limit out of the way and the others as they are."""
    if limit is problem.thermal:
        wide = [problem.without(limit.name)]
    else:
        needed = max(_peak(problem, limit, unlimited_A) / limit.stated, 1.0)
        wide = [problem.replaced(limit.wider(ample * needed)) for ample in AMPLE]
    for wider in wide:
        if inside(wider, unlimited_A):
            # No other limit binds: the optimum without any is the one without this one.
            command, status = unlimited_A, Status.OPTIMAL
        else:
            answer, _ = solve_certified(leave_out(wider).problem, options)
            command, status = answer.command_A, answer.status
        peak = _peak(problem, limit, command)
        clear = limit is problem.thermal or peak < CLEAR * wider.limits[limit.name].stated
        if status is Status.OPTIMAL and clear:
            acceleration, _ = problem.stage.rollout(command)
            return _Without(limit.enough(peak), problem.target.nrmse(acceleration))
    return _Without(float("inf"), 0.0)


def prices(
    problem: TransientProblem,
    command_A: FloatArray,
    multipliers: Multipliers,
    unlimited_A: FloatArray,
    options: SolverOptions,
) -> list[Price]:
    """Price of every limit that binds; empty if none does or if the error is not the plain one of one device.

    J is the squared NRMSE but for the movement term, so dNRMSE = dJ / (2 NRMSE) and dJ = -sum of the multipliers per
    unit of the limit; the current limit also stands in the movement term. Where the NRMSE goes linearly with the
    limit, as it does for a peak that is cut off, the step's figure is nearly exact; it never falls below the floor.
    What is enough takes one more solve for each limit that binds: with that limit out of the way, the others kept.
    """
    if problem.error_filter is not None or problem.spread or problem.reference_is_zero:
        return []
    if multipliers.largest * problem.grid.stages <= WORTH_SAYING:
        return []
    stage, target = problem.stage, problem.target
    motion, free = stage.motion(command_A), stage.motion(unlimited_A)
    error, floor = target.nrmse(motion.acceleration_m_s2), target.nrmse(free.acceleration_m_s2)
    gains: dict[str, float] = {}
    for box in boxes(problem, command_A, motion, multipliers):
        gain = float(box.by_upper.sum()) + float(box.by_lower.sum())
        gains[box.limit.name] = gains.get(box.limit.name, 0.0) + gain
    found = []
    for limit in problem.limits:
        gain = gains[limit.name]
        if gain <= WORTH_SAYING:
            continue
        # The current limit also stands in the movement term, as its unit.
        gain += problem.movement.relief(command_A) * limit.scales_movement
        without = _without(problem, limit, unlimited_A, options)
        # No step beyond what is enough: from there on nothing is bought.
        lacking = max(without.enough - limit.stated, LEAST_STEP * limit.stated)
        step = _round_step(min(STEP_SHARE * limit.room, lacking))
        slope = -gain / (2 * error)
        then = max(error + slope * step, without.nrmse, floor)
        found.append(
            Price(limit.label, limit.unit, limit.step_unit, limit.stated, slope, step, error, then, without.enough)
        )
    return sorted(found, key=lambda price: price.then)
