"""What a command does in a problem: motion, heat, and the value of every limit's row beside its multipliers."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.discretise import Motion
from transopt.plant.time_grid import TimeGrid
from transopt.problem.answer import Multipliers
from transopt.problem.limits.limit import Limit
from transopt.problem.limits.row import Row
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.problem import BESIDES_THE_TARGET, TransientProblem, objectives

TEMPERATURE = TemperatureLimit.row_names[0]
ALIKE = 1e-6  # a violation less than the largest by this share is as large: the first instant of these is named


@dataclass(frozen=True)
class Box:
    """One limit's row along the horizon, lower <= value <= upper, with its multipliers.

    Attributes
    ----------
    limit : the limit that the row belongs to.
    value : (N,) value of the row.
    lower, upper : (N,) bounds, infinite where there is none.
    by_lower, by_upper : (N,) multipliers >= 0.
    condition : the case that the row covers, in words; empty for none.
    """

    limit: Limit
    value: FloatArray
    lower: FloatArray
    upper: FloatArray
    by_lower: FloatArray
    by_upper: FloatArray
    condition: str = ""

    @property
    def name(self) -> str:
        return self.limit.label

    @property
    def unit(self) -> str:
        return self.limit.unit

    @property
    def excess(self) -> FloatArray:
        """(N,) violation of the bounds, negative where they hold."""
        return np.asarray(np.maximum(self.value - self.upper, self.lower - self.value))

    @property
    def most(self) -> float:
        """Largest violation of a bound, negative where all hold."""
        return float(self.excess.max())

    @property
    def below(self) -> bool:
        """Whether the value is farthest out at its lower bound."""
        at = int(np.argmax(self.excess))
        return bool(self.lower[at] - self.value[at] > self.value[at] - self.upper[at])

    def missed(self, grid: TimeGrid) -> str:
        """The largest violation in words: by how much, of which bound, and when."""
        time_s = grid.switching_times_s[int(np.argmax(self.excess >= (1 - ALIKE) * self.most))]
        return f"{self.limit.missed(self.most, lower=self.below)} at {time_s * 1e3:.1f} ms"

    @property
    def kept(self) -> bool:
        """Whether all bounds hold, without any tolerance."""
        return bool((self.value <= self.upper).all()) and bool((self.value >= self.lower).all())

    @property
    def peak(self) -> float:
        """Largest absolute value where there is a bound."""
        return float(np.abs(self.value[np.isfinite(self.upper) | np.isfinite(self.lower)]).max())

    @property
    def complementarity(self) -> float:
        """Sum of multiplier times |slack| over the finite bounds."""
        return _paired(self.by_upper, self.upper - self.value) + _paired(self.by_lower, self.value - self.lower)


def _paired(multiplier: FloatArray, slack: FloatArray) -> float:
    if not multiplier.any():
        return 0.0
    stated = np.isfinite(slack)
    return float(multiplier[stated] @ np.abs(slack[stated]))


class Effect:
    """Motion and heat of a problem under a command (N,), each part computed on first use.

    Parameters
    ----------
    motion : (N,) motion of the problem's own device, if it is known already.
    """

    def __init__(self, problem: TransientProblem, command: FloatArray, motion: Motion | None = None) -> None:
        self.problem, self.command = problem, command
        if motion is not None:
            self.motion = motion

    def of(self, problem: TransientProblem) -> "Effect":
        """The effect of the command in another problem; the motion is reused if devices and wall are the same."""
        effect, own = Effect(problem, self.command), self.problem
        alike = [*map(id, problem.devices)] == [*map(id, own.devices)] and problem.grid == own.grid
        if not alike or problem.wall is not own.wall:
            return effect
        for name in ("continued", "lasting", "motion", "others", "accelerations_m_s2"):
            if name in vars(self):
                setattr(effect, name, getattr(self, name))
        return effect

    @cached_property
    def continued(self) -> FloatArray:
        """(N + M,) the command, continued after the window."""
        with np.errstate(over="ignore", invalid="ignore"):  # the loop of an unstable wall overflows
            return self.problem.continued(self.command)

    @cached_property
    def lasting(self) -> Motion:
        """(N + M,) motion of the problem's own device through the window and after it."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self.problem.stage.motion(self.continued)

    @cached_property
    def motion(self) -> Motion:
        """(N,) motion of the problem's own device within the window."""
        return self.lasting.first(self.command.shape[-1])

    @property
    def heat_A2(self) -> float:
        """Sum of i_k^2 over the window, of all motors."""
        current = self.motion.plant_input
        return float(np.vdot(current, current))

    @cached_property
    def others(self) -> tuple[Motion, ...]:
        """(N + M,) motion of every further device through the window and after it."""
        return tuple(device.motion(self.continued) for device in self.problem.spread)

    def value(self, row: Row) -> FloatArray:
        """(N,) value of a row of the problem's limits."""
        if row.name not in self.values:
            self.values[row.name] = row.value(self.motion_of(row.device), self.command)
        return self.values[row.name]

    @cached_property
    def values(self) -> dict[str, FloatArray]:
        """Values (N,) of rows by name, as far as they have been computed."""
        return {}

    def motion_of(self, device: int) -> Motion:
        """(N,) motion of a device within the window; 0 is the problem's own."""
        return self.others[device - 1].first(self.command.shape[-1]) if device else self.motion

    @cached_property
    def accelerations_m_s2(self) -> FloatArray:
        """(S, N + M) y'' of every device, or (p, N + M) of every direction."""
        if self.problem.directions:
            return self.lasting.acceleration_m_s2
        return np.stack([motion.acceleration_m_s2 for motion in (self.lasting, *self.others)])

    @cached_property
    def mean_square_A2(self) -> FloatArray:
        """(N,) mean of i_eff^2 over each period; only for a problem with a temperature limit."""
        assert self.problem.thermal is not None
        return self.problem.thermal.model.heating.mean_square(self.motion.plant_input, self.command)

    @cached_property
    def rise_K(self) -> FloatArray:
        """(N + 1, m) rises of the thermal nodes at tau_0 to tau_N; only for a problem with a temperature limit."""
        assert self.problem.thermal is not None
        return self.problem.thermal.model.rise(self.mean_square_A2)

    @cached_property
    def winding_C(self) -> FloatArray:
        """(N,) winding temperature at tau_1 to tau_N; only for a problem with a temperature limit."""
        assert self.problem.thermal is not None
        return np.asarray(self.rise_K[1:, 0] + self.problem.thermal.model.unpowered_C)

    def by_heating(self, multipliers: Multipliers) -> FloatArray:
        """(N,) gradient of the temperature limit's term of the Lagrangian by the heatings; zero without a limit."""
        thermal, by_winding = self.problem.thermal, multipliers.upper(TEMPERATURE)
        if thermal is None or not by_winding.any():
            return np.zeros(self.command.shape[-1])
        return thermal.model.adjoint(self.mean_square_A2, by_winding, self.rise_K)


def effects(commands: Sequence[tuple[TransientProblem, FloatArray]]) -> list[Effect]:
    """What commands (N,) do, each in its problem, those of one device rolled out side by side."""
    found = [Effect(problem, command) for problem, command in commands]
    groups: dict[tuple[int, TimeGrid], list[Effect]] = {}
    for effect in found:
        groups.setdefault((id(effect.problem.stage), effect.problem.grid), []).append(effect)
    for group in groups.values():
        first = group[0].problem
        if all(effect.problem.wall is None for effect in group):
            continued = first.continued(np.stack([effect.command for effect in group]))
        else:
            continued = np.stack([effect.continued for effect in group])
        with np.errstate(over="ignore", invalid="ignore"):  # a wall that grows by itself
            lasting = first.stage.motion(continued)
        for course, effect in enumerate(group):
            effect.continued, effect.lasting = continued[course], lasting.of_course(course)
    return found


class Free(NamedTuple):
    """The optimum (N,) of a problem without limits: its tap error, its largest plant input [A or V], and its J."""

    command: FloatArray
    floor: float
    peak: float
    objective: float


def free_optima(commands: Sequence[tuple[TransientProblem, FloatArray]]) -> list[tuple[Effect, Free]]:
    """Effects and figures of optima (N,) without limits, each in its problem, those of one device side by side."""
    done, found = effects(commands), dict[int, Free]()
    groups: dict[tuple[int, ...], list[int]] = {}
    for i, effect in enumerate(done):
        problem = effect.problem
        groups.setdefault((problem.target.lost, *map(id, BESIDES_THE_TARGET(problem))), []).append(i)
    for group in groups.values():
        problems, some = [commands[i][0] for i in group], Together([done[i] for i in group], [])
        inputs, made = np.stack([each.motion.plant_input for each in some.effects]), some.accelerations_m_s2
        along = made if problems[0].directions else made[:, 0]
        with np.errstate(over="ignore", invalid="ignore"):  # a wall that grows by itself
            floors = problems[0].yardstick.tap_errors([problem.target for problem in problems], along)
            objective = objectives(problems, some.command, made, inputs)
        peaks = np.abs(inputs).reshape(len(group), -1).max(axis=1)
        figures = (each.tolist() for each in (floors, peaks, objective))
        found |= zip(group, map(Free, [effect.command for effect in some.effects], *figures), strict=True)
    return [(effect, found[i]) for i, effect in enumerate(done)]


class Together:
    """Effects of G commands, with multipliers, in problems that are `alike`; as arrays, one course for each command.

    Attributes
    ----------
    effects, multipliers : one for each command.
    """

    def __init__(self, effects: Sequence[Effect], multipliers: Sequence[Multipliers]) -> None:
        self.effects, self.multipliers = effects, multipliers

    @property
    def problem(self) -> TransientProblem:
        """The first problem, from which the others differ in their targets and in bounds and offsets of rows."""
        return self.effects[0].problem

    @cached_property
    def command(self) -> FloatArray:
        """(G, N) commands, or (G, m, N)."""
        return np.stack([effect.command for effect in self.effects])

    @cached_property
    def motions(self) -> list[Motion]:
        """(G, ..., N) motion of every device within the window, the problem's own first."""
        devices = range(len(self.problem.devices))
        return [Motion.stacked([effect.motion_of(device) for effect in self.effects]) for device in devices]

    @cached_property
    def accelerations_m_s2(self) -> FloatArray:
        """(G, S, N + M) y'' of every device, or (G, p, N + M) of every direction."""
        return np.stack([effect.accelerations_m_s2 for effect in self.effects])

    @cached_property
    def pairs(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Name of a row -> (G, N) multipliers of its lower and of its upper bound; not of a row of zeros alone."""
        stated = {name for each in self.multipliers for name, pair in each.pairs.items() if any(map(np.any, pair))}
        return {
            name: (
                np.stack([m.lower(name) for m in self.multipliers]),
                np.stack([m.upper(name) for m in self.multipliers]),
            )
            for name in stated
        }

    def row(self, number: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(G, N) values of a row of the limits, and its lower and upper bounds."""
        rows = [effect.problem.rows()[number][1] for effect in self.effects]
        if all(row is rows[0] for row in rows):
            values = rows[0].value(self.motions[rows[0].device], self.command)
            for effect, value in zip(self.effects, values, strict=True):
                effect.values[rows[0].name] = value
            lower, upper = rows[0].bounds(self.problem.grid.stages)
            return values, lower, upper
        values = np.stack([effect.value(row) for effect, row in zip(self.effects, rows, strict=True)])
        lower, upper = (np.stack(side) for side in zip(*(row.bounds(values.shape[-1]) for row in rows), strict=True))
        return values, lower, upper


def alike(effect: Effect) -> tuple[object, ...]:
    """What the problems of effects in one `Together` have to share, as a key."""
    problem, command, thermal = effect.problem, effect.command, effect.problem.thermal
    rows = [
        (limit.name, row.name, row.device, row.motor, *row.outputs.items(), None if row.linear else id(row))
        for limit, row in problem.rows()
    ]
    same = (*problem.devices, problem.terms, problem.wall, problem.shares, thermal and thermal.model.heating)
    numbers = (problem.worst, problem.rho, problem.heat_price, problem.intensity, problem.intensity_dB)
    sizes = (problem.grid, problem.hand_over_samples, problem.target.lost, command.shape, command.dtype)
    return *map(id, same), *numbers, *sizes, problem.limits.input_limit, problem.command_bound, *rows


def warm_up(some: Sequence[Effect]) -> None:
    """Compute the heatings of effects side by side; each then has its own cached (`Effect.mean_square_A2`)."""
    groups: dict[tuple[int, TimeGrid], list[Effect]] = {}
    for effect in some:
        if effect.problem.thermal is not None:
            groups.setdefault((id(effect.problem.thermal.model.heating), effect.problem.grid), []).append(effect)
    for group in groups.values():
        thermal = group[0].problem.thermal
        assert thermal is not None
        inputs = np.stack([effect.motion.plant_input for effect in group])
        squares = thermal.model.heating.mean_square(inputs, np.stack([effect.command for effect in group]))
        for effect, own in zip(group, squares, strict=True):
            effect.mean_square_A2 = own


def boxes(problem: TransientProblem, command: FloatArray, motion: Motion, multipliers: Multipliers) -> list[Box]:
    """All rows of the problem's limits, with their values under a command and its motion."""
    return list(boxes_of(Effect(problem, command, motion), multipliers))


def boxes_of(
    effect: Effect, multipliers: Multipliers, *, only: str | None = None, above: float = -np.inf
) -> Iterator[Box]:
    """Yield the rows of all limits with their values under a command's effect.

    Parameters
    ----------
    only : name of the limit whose rows are wanted; None for all limits.
    above : rows without a larger multiplier are left out.
    """
    problem, m, N = effect.problem, multipliers, effect.problem.grid.stages
    for limit, row in problem.rows():
        if only in (None, limit.name) and m.most(row.name) > above:
            yield Box(limit, effect.value(row), *row.bounds(N), m.lower(row.name), m.upper(row.name), row.condition)
    thermal = problem.thermal
    if thermal is not None and only in (None, thermal.name) and m.most(TEMPERATURE) > above:
        sides = np.full(N, -np.inf), thermal.bounds_C
        yield Box(thermal, effect.winding_C, *sides, m.lower(TEMPERATURE), m.upper(TEMPERATURE))


def farthest_out(effect: Effect, limit: Limit) -> Box:
    """The row of a limit with the largest violation by a command, or that comes nearest to its bound."""
    return max(boxes_of(effect, Multipliers.zero(effect.problem), only=limit.name), key=lambda box: box.most)


def inside(
    problem: TransientProblem, command: FloatArray, *, only: str | None = None, effect: Effect | None = None
) -> bool:
    """Whether a command meets all limits, or only the limit of one name, without any tolerance.

    Parameters
    ----------
    effect : effect of this command in this problem, if the caller reuses it.
    """
    limits = boxes_of(effect or Effect(problem, command), Multipliers.zero(problem), only=only)
    return all(box.kept for box in limits)
