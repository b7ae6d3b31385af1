"""A tap between the nodes as a standing problem (`solvers.standing`): its device, target and certificate by numbers.

`online` poses any tap as an object of all its parts. Most libraries have one device, no wall, and limits that are the
same for every tap; then only the device's matrices and the target differ from tap to tap. What this module answers is
certified for exactly the grip asked; whatever it does not answer is left to `online`'s general way.
"""

from collections.abc import Iterator
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from transopt.base.recursions import Recursion
from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.library.place import Between, Place
from transopt.plant.coil import CoilModel
from transopt.plant.state_space import StateSpace
from transopt.problem.answer import Certificate
from transopt.problem.heat import winding_limit_C
from transopt.problem.leave_out import leave_out
from transopt.problem.limits.row import COMMAND, HELD, INPUT
from transopt.problem.limits.temperature import TemperatureLimit, temperature_limit
from transopt.problem.objective.target import ZERO_M_S2
from transopt.problem.objective.tracking import Tracking
from transopt.problem.posing import Posing
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import BINDING_MULTIPLIER, left_over
from transopt.solvers.prove import of_numbers
from transopt.solvers.standing import Proof, Standing, stands

MARGIN = 24  # stages beyond the last at which a limit is expected to bind, up to which it is stated
NEAR = 0.02  # share of a limit within which a guess of the optimum without limits may leave it
BARELY = 0.06  # share of a limit up to which an excess of that guess tells where the limit will bind
SURELY_A_TAP = 10.0  # rms of a target, in units of that which counts as zero, from which no closer look is needed


class StandingTap:
    """The taps of a library under one set of limits, solved in arrays allocated once.

    Parameters
    ----------
    problem : the problem of any tap of the library under these limits, of the kind that `of` takes.
    own : whether they are the library's own, which bind about as long as in the nodes around.
    tolerance, most_iterations : as of `solvers.native.extension.interior_points`.
    """

    def __init__(
        self, library: Library, problem: TransientProblem, tolerance: float, most_iterations: int, *, own: bool
    ) -> None:
        whole = problem.without(TemperatureLimit.name)
        amplifier, grid, nodes = whole.stage.amplifier, whole.grid, library.command.shape[:2]
        assert amplifier is not None
        self._standing = Standing(whole, leave_out(whole).problem, tolerance, most_iterations)
        self._problem, self._thermal = whole, problem.thermal
        self._speeds_m_s, self._grips_N, self._commands = library.speeds_m_s, library.grips_N, library.command
        self._bound = _last_bound(library) if own else np.zeros(nodes, dtype=int)
        self._decay = float(np.exp(-amplifier.rate_rad_s * grid.dt_s))
        self._lag = Recursion(np.array([[self._decay]]))
        self._takes_s = (grid.stages + 1) * grid.dt_s + grid.delay_s
        costs = [Tracking(library.wanted_of(*at).target, whole.terms) for at in np.ndindex(*nodes)]
        # A filter is linear: the filtered target of a tap is the blend of the nodes' filtered ones, r / v.
        shapes = np.stack([each.wanted.ravel() for each in costs]).reshape(*nodes, -1)
        self._courses_s_m = shapes / library.speeds_m_s[:, None, None]  # the targets, and then `_free_at_node`
        weights = self._weights = costs[0].weights
        self._lost = np.where(np.arange(weights.shape[1]) < whole.target.lost, weights, 0.0)
        self._least_m2_s4 = (SURELY_A_TAP * ZERO_M_S2) ** 2 * float(weights.sum())
        lower, upper = zip(*(row.bounds(grid.stages) for _, row in whole.rows()), strict=True)
        self._stated = np.array([limit.stated for limit, _ in whole.rows()])[:, None]
        self._lower, self._upper = np.stack(lower) / self._stated, np.stack(upper) / self._stated
        free = [self._free_at_node(library, *at) for at in np.ndindex(*nodes)]
        self._courses_s_m = np.concatenate([self._courses_s_m, np.stack(free).reshape(*nodes, -1)], axis=2)

    @classmethod
    def of(
        cls,
        library: Library,
        posing: Posing,
        problem: TransientProblem,
        tolerance: float,
        most_iterations: int,
    ) -> "StandingTap | None":
        """The standing taps of a library; None if they differ in more than the device's matrices and the target."""
        same = bool(np.all(library.meta["slow_part_known"])) and not library.correction_m_s2.any()
        alone = posing.objective == "waveform" and posing.budget.tap_rate_Hz is None and not problem.named
        if not same or not alone or not stands(problem.without(TemperatureLimit.name)):
            return None
        own = posing is library.posing()
        return cls(library, problem, tolerance, most_iterations, own=own)

    def solved(
        self, plant: StateSpace, place: Place, coil: CoilModel | None
    ) -> tuple[FloatArray, Certificate] | None:
        """Command (N,) and accepted certificate of a tap; None where the general way has to look.

        Parameters
        ----------
        coil : at its temperatures at the start; None without one.
        """
        between = Between.of_place(self._speeds_m_s, self._grips_N, place)
        courses, targets = place.speed_m_s * between.of(self._courses_s_m), self._weights.size
        temperature = self._temperature(coil)
        if temperature is not None and not self._keeps(temperature, between.of(self._commands)):
            return None  # the nodes' commands would make the winding too hot: its limit binds as a rule
        if not self._poses(plant, courses[:targets]):
            return None
        values = courses[targets:]
        for stated in self._attempts(values.reshape(self._lower.shape), between):
            command = self._standing.unlimited() if stated is None else self._standing.limited(stated)
            if command is None:
                continue
            proof = self._standing.proven()
            certificate = self._certificate(proof, heats=coil is not None)
            if certificate and certificate.accepted and (stated is not None or max(proof.excess) <= 0):
                keeps = temperature is None or self._keeps(temperature, command)
                return (command, certificate) if keeps else None
        return None

    def _poses(self, plant: StateSpace, targets: FloatArray) -> bool:
        """Make the stages of a plant and of targets (T (L + N + M),); False if the problem does not take them."""
        standing, p = self._standing, self._standing.plant
        if plant.A.shape != (p, p) or plant.B.shape != (p, 1) or plant.C.shape != (1, p):
            return False
        if not standing.drive(plant):
            return False
        wanted = targets.reshape(self._weights.shape)
        squares = wanted * wanted
        energy, lost = (float(np.vdot(weights, squares)) for weights in (self._weights, self._lost))
        return self._least_m2_s4 < energy < np.inf and standing.poses(wanted, energy, lost / energy)

    def _expected(self, between: Between) -> int:
        """Stages at which limits are stated first: a little beyond the last where one binds in the nodes around.

        The mean of those nodes in which one does, by their weights; 0 if there is none.
        """
        bound = self._bound[between.at]
        weight = float(np.vdot(between.weights, bound > 0))
        return MARGIN + round(float(np.vdot(between.weights, bound)) / weight) if weight > 0 else 0

    def _attempts(self, values: FloatArray, between: Between) -> Iterator[int | None]:
        """Numbers of stages at which limits are stated, in the order of trial; None for no limits, 0 for all stages.

        Parameters
        ----------
        values : (rows, N) of the optimum without limits, blended from the nodes' own, over the limits. They tell
            nearly always whether one binds.
        """
        excess = np.maximum(values - self._upper, self._lower - values).max(axis=0)
        most = float(excess.max())
        if not most > -NEAR:
            yield None
        # Limits that barely bind do so where the optimum without limits comes near them. NaN counts as near.
        near, cut = MARGIN + 1 + int(np.flatnonzero(~(excess <= -NEAR)).max(initial=-1)), self._expected(between)
        if not most > BARELY:
            cut = min(4 * cut // 3, near) if cut > 0 else near
        while 0 < cut <= 3 * self._problem.free_stages // 4:
            yield cut
            cut = 3 * cut // 2
        yield 0

    def _free_at_node(self, library: Library, iv: int, ig: int) -> FloatArray:
        """(rows N,) of the optimum without limits in a node, over the limits and the speed; NaN if there is none."""
        command = None
        if self._poses(library.plant(ig), library.speeds_m_s[iv] * self._courses_s_m[iv, ig]):
            command = self._standing.unlimited()
        if command is None:
            return np.full(self._lower.size, np.nan)
        outputs = {INPUT: self._current(command), COMMAND: command, HELD: np.append(0.0, command[:-1])}
        rows = [sum(by * outputs[name] for name, by in row.outputs.items()) for _, row in self._problem.rows()]
        return np.asarray((np.stack(rows) / self._stated / library.speeds_m_s[iv]).ravel())

    def _current(self, command: FloatArray) -> FloatArray:
        """(N,) current at the switching instants under a command."""
        forcing = np.zeros((command.size, 1))
        forcing[1:, 0] = (1 - self._decay) * command[:-1]
        return self._lag.run(forcing)[:, 0]

    def _certificate(self, proof: Proof, *, heats: bool) -> Certificate | None:
        """The certificate from a proof's numbers; None where one is not finite."""
        if not all(map(isfinite, (*proof.excess, *proof[1:5]))):
            return None
        outside = [(limit, by) for (limit, _), by in zip(self._problem.rows(), proof.excess, strict=True)]
        violations, excess = left_over(self._problem, outside, proof.residual)
        if heats:
            violations[TemperatureLimit.base_unit()] = 0.0
        gaps = proof.gap_by_command, proof.gap_by_movement
        of = self._problem, violations, excess, proof.merit
        return of_numbers(*of, dual_residual=proof.dual_residual, gaps=gaps)

    def _temperature(self, coil: CoilModel | None) -> TemperatureLimit | None:
        """The winding's limit from this start; None where no command reaches it."""
        if coil is None or self._thermal is None:
            return None
        budget, limit = self._thermal.budget, self._problem.limits.input_limit
        if coil.adiabatic_bound_C(limit, self._takes_s) <= winding_limit_C(coil, budget):
            return None
        return temperature_limit(coil, self._problem.stage.amplifier, self._problem.grid, budget)

    def _keeps(self, temperature: TemperatureLimit, command: FloatArray) -> bool:
        """Whether the winding stays within its limit under a command (N,)."""
        reached_C = temperature.temperatures_C(self._current(command), command)
        return bool((reached_C <= temperature.bounds_C).all())


def _last_bound(library: Library) -> NDArray[np.intp]:
    """(v, g) number of stages up to the last at which a limit binds in each node, 0 where none does."""
    bound = np.zeros(library.command.shape[:2], dtype=int)
    stages_of_node = 1 + np.arange(library.command.shape[-1])
    for multiplier in library.multipliers_of.values():
        bound = np.maximum(bound, ((multiplier > BINDING_MULTIPLIER) * stages_of_node).max(axis=-1))
    return bound
