"""What binds, in the user's words: the price of each limit and the least limit that would not bind (DESIGN 4)."""

from dataclasses import dataclass, replace

import numpy as np

from transopt.base.signals import FloatArray, nrmse
from transopt.design.explain import rounded_up, widened
from transopt.plant.discretise import Motion
from transopt.problem.leave_out import leave_out
from transopt.problem.problem import Multipliers, Status, TransientProblem
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
    limit, unit : name and unit. bound : where it stands; for the coil the temperature.
    slope : dNRMSE per unit of the limit, negative; from the multipliers.
    step : by how much it is raised in the sentence. nrmse, then : now and, to first order, after that step.
    enough : least bound at which it would not bind, the other limits as they are.
    """

    limit: str
    unit: str
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
            enough = f"would not bind from {rounded_up(self.enough):.8g} {self.unit} on"
        return (
            f"{self.limit} {self.bound:g} {self.unit}: {self.step:g} {_step_unit(self.unit)} more: "
            f"NRMSE {100 * self.nrmse:.3g} % to {100 * self.then:.3g} %; "
            f"{enough}"
        )


def _step_unit(unit: str) -> str:
    return "K" if unit == "C" else unit


def _round_step(size: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above `size`."""
    power = 10.0 ** np.floor(np.log10(size))
    return float(max(m for m in (1, 2, 5) if m * power <= size * (1 + 1e-12)) * power)


def _peak(problem: TransientProblem, name: str, command_A: FloatArray) -> float:
    """Largest value that a command reaches of what one limit bounds."""
    found = boxes(problem, command_A, problem.stage.motion(command_A), Multipliers.zero(problem))
    return max(float(np.abs(box.value[np.isfinite(box.bound)]).max()) for box in found if box.name == name)


@dataclass(frozen=True)
class _Without:
    """What an optimum without one limit takes of it, and its NRMSE: no wider limit can do better."""

    enough: float
    nrmse: float


def _bound(problem: TransientProblem, name: str) -> float:
    rest = Motion.zero(problem.grid.stages)
    found = boxes(problem, rest.current_A, rest, Multipliers.zero(problem))
    return next(float(box.bound.min()) for box in found if box.name == name)


def _without(problem: TransientProblem, name: str, unlimited_A: FloatArray, options: SolverOptions) -> _Without:
    """The optimum with one limit out of the way and the others as they are."""
    if name == "coil":
        wide = [replace(problem, thermal=None)]
    else:
        needed = max(_peak(problem, name, unlimited_A) / _bound(problem, name), 1.0)
        wide = [widened(problem)[name](ample * needed) for ample in AMPLE]
    for wider in wide:
        if inside(wider, unlimited_A):
            # No other limit binds: the optimum without any is the one without this one.
            command, status = unlimited_A, Status.OPTIMAL
        else:
            answer, _ = solve_certified(leave_out(wider).problem, options)
            command, status = answer.command_A, answer.status
        peak = _peak(problem, name, command)
        if status is Status.OPTIMAL and (name == "coil" or peak < CLEAR * _bound(wider, name)):
            acceleration, _ = problem.stage.rollout(command)
            return _Without(peak, nrmse(acceleration, problem.reference_m_s2))
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
    stage, r = problem.stage, problem.reference_m_s2
    motion, free = stage.motion(command_A), stage.motion(unlimited_A)
    error, floor = nrmse(motion.acceleration_m_s2, r), nrmse(free.acceleration_m_s2, r)
    movement = np.diff(command_A, prepend=0.0)
    gains: dict[str, float] = {}
    units, bounds, room = {}, {}, {}
    for box in boxes(problem, command_A, motion, multipliers):
        gain = float(box.upper.sum()) + (0.0 if box.lower is None else float(box.lower.sum()))
        gains[box.name] = gains.get(box.name, 0.0) + gain
        units[box.name], bounds[box.name] = box.unit, box.stated
        room[box.name] = bounds[box.name]
        if box.name == "coil":
            headroom = box.bound - (problem.thermal.model.unpowered_C if problem.thermal is not None else 0.0)
            room[box.name] = float(headroom[np.isfinite(headroom)].max())
    if gains["current"] > WORTH_SAYING:
        gains["current"] += 2 * problem.movement_weight * float(movement @ movement) / problem.limits.current_A
    found = []
    for name, gain in gains.items():
        if gain <= WORTH_SAYING:
            continue
        without = _without(problem, name, unlimited_A, options)
        # No step beyond what is enough: from there on nothing is bought.
        lacking = max(without.enough - bounds[name], LEAST_STEP * bounds[name])
        step = _round_step(min(STEP_SHARE * room[name], lacking))
        slope = -gain / (2 * error)
        then = max(error + slope * step, without.nrmse, floor)
        found.append(Price(name, units[name], bounds[name], slope, step, error, then, without.enough))
    return sorted(found, key=lambda price: price.then)
