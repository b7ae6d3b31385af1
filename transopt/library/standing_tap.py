"""A tap between the nodes as a standing problem (`solvers.standing`): its device, target and certificate by numbers.

`online` poses any tap as an object of all its parts. Most libraries have one device, no wall, and limits that are the
same for every tap; then only the device's matrices and the target differ from tap to tap. What this module answers is
certified for exactly the grip asked; whatever it does not answer is left to `online`'s general way.
"""

import numpy as np

from transopt.base.recursions import Recursion
from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.library.place import Place, around
from transopt.plant.coil import CoilModel
from transopt.plant.state_space import StateSpace
from transopt.problem.answer import OBJECTIVE_SCALE, Certificate
from transopt.problem.heat import winding_limit_C
from transopt.problem.leave_out import leave_out
from transopt.problem.limits.temperature import TemperatureLimit, temperature_limit
from transopt.problem.objective.target import ZERO_M_S2
from transopt.problem.objective.tracking import Tracking
from transopt.problem.posing import Posing
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import left_over
from transopt.solvers.standing import Proof, Standing, stands

SURELY_A_TAP = 10.0  # rms of a target, in units of that which counts as zero, from which no closer look is needed


class StandingTap:
    """The taps of a library under one set of limits, solved in arrays allocated once.

    Parameters
    ----------
    problem : the problem of any tap of the library under these limits, of the kind that `of` takes.
    tolerance, most_iterations : as of `solvers.native.extension.interior_points`.
    """

    def __init__(self, library: Library, problem: TransientProblem, tolerance: float, most_iterations: int) -> None:
        whole = problem.without(TemperatureLimit.name)
        amplifier, grid = whole.stage.amplifier, whole.grid
        assert amplifier is not None
        self._standing = Standing(whole, leave_out(whole).problem, tolerance, most_iterations)
        self._problem, self._thermal = whole, problem.thermal
        self._speeds_m_s, self._grips_N = library.speeds_m_s, library.grips_N
        nodes = library.command.shape[:2]
        costs = [Tracking(library.wanted_of(*at).target, whole.terms) for at in np.ndindex(*nodes)]
        # A filter is linear: the filtered target of a tap is the blend of the nodes' filtered ones, r / v.
        courses = np.stack([each.wanted.ravel() for each in costs]).reshape(*nodes, -1)
        self._shapes_1_s = courses / library.speeds_m_s[:, None, None]
        weights, lost = costs[0].weights, np.arange(costs[0].weights.shape[1]) < whole.target.lost
        self._weights, self._lost = weights, np.where(lost, weights, 0.0)
        self._least_m2_s4 = SURELY_A_TAP**2 * ZERO_M_S2**2 * float(weights.sum())
        self._decay = float(np.exp(-amplifier.rate_rad_s * grid.dt_s))
        self._lag = Recursion(np.array([[self._decay]]))
        self._takes_s = (grid.stages + 1) * grid.dt_s + grid.delay_s

    @classmethod
    def of(
        cls, library: Library, posing: Posing, problem: TransientProblem, tolerance: float, most_iterations: int
    ) -> "StandingTap | None":
        """The standing taps of a library; None if they differ in more than the device's matrices and the target."""
        same = bool(np.all(library.meta["slow_part_known"])) and not library.correction_m_s2.any()
        alone = posing.objective == "waveform" and posing.budget.tap_rate_Hz is None and not problem.named
        if not same or not alone or not stands(problem.without(TemperatureLimit.name)):
            return None
        return cls(library, problem, tolerance, most_iterations)

    def solved(
        self, plant: StateSpace, place: Place, coil: CoilModel | None, cut: int
    ) -> tuple[FloatArray, Certificate] | None:
        """Command (N,) and accepted certificate of a tap; None where the general way has to look.

        Parameters
        ----------
        coil : at its temperatures at the start; None without one.
        cut : number of stages at which limits are stated first; 0 if none is expected to bind.
        """
        standing, p = self._standing, self._standing.plant
        if plant.A.shape != (p, p) or plant.B.shape != (p, 1) or plant.C.shape != (1, p):
            return None
        standing.drive(plant)
        speeds, by_speed = around(self._speeds_m_s, place.speed_m_s)
        grips, by_grip = around(self._grips_N, place.grip_N)
        shape_1_s = np.einsum("v,g,vgk->k", by_speed, by_grip, self._shapes_1_s[speeds, grips])
        wanted = (place.speed_m_s * shape_1_s).reshape(self._weights.shape)
        squares = wanted * wanted
        energy, lost = (float(np.vdot(weights, squares)) for weights in (self._weights, self._lost))
        if not self._least_m2_s4 < energy < np.inf or not standing.poses(wanted, energy, lost / energy):
            return None
        return self._certified(coil, cut)

    def _certified(self, coil: CoilModel | None, cut: int) -> tuple[FloatArray, Certificate] | None:
        """The optimum without limits if it keeps them; else under limits at the first stages, then at further ones."""
        most = 3 * self._problem.free_stages // 4
        cuts = [each for each in (cut, 2 * cut) if 0 < each <= most]
        attempts: list[int | None] = [*cuts, 0] if cut else [None, 0]
        for attempt in attempts:
            command = self._standing.unlimited() if attempt is None else self._standing.limited(attempt)
            if command is None:
                continue
            proof = self._standing.proven()
            if attempt is None and not max(proof.excess) <= 0:
                continue
            if not self._warmer_K(command, coil) <= 0:
                return None
            certificate = self._certificate(proof, heats=coil is not None)
            if certificate.accepted:
                return command, certificate
        return None

    def _certificate(self, proof: Proof, *, heats: bool) -> Certificate:
        """The certificate from a proof's numbers, as `solvers.prove` makes it."""
        outside = [(limit, by) for (limit, _), by in zip(self._problem.rows(), proof.excess, strict=True)]
        violations, excess = left_over(self._problem, outside, proof.residual)
        if heats:
            violations[TemperatureLimit.base_unit()] = 0.0
        gap = proof.gap_by_command
        if gap > Certificate.GAP_TOLERANCE * max(proof.merit, OBJECTIVE_SCALE) and self._problem.movement.weight > 0:
            gap = float(np.fmin(gap, proof.gap_by_movement))
        return Certificate(
            objective=proof.merit,
            merit=proof.merit,
            violations=violations,
            excess=excess,
            dual_residual=proof.dual_residual,
            duality_gap=gap,
            lower_bound=proof.merit - gap,
            finite=bool(np.isfinite([*proof.excess, *proof[1:]]).all()),
        )

    def _warmer_K(self, command: FloatArray, coil: CoilModel | None) -> float:
        """Largest excess over the winding's limit [K]; 0 where no command could reach it."""
        if coil is None or self._thermal is None:
            return 0.0
        budget, limit = self._thermal.budget, self._problem.limits.input_limit
        if coil.adiabatic_bound_C(limit, self._takes_s) <= winding_limit_C(coil, budget):
            return 0.0
        forcing = np.zeros((command.size, 1))
        forcing[1:, 0] = (1 - self._decay) * command[:-1]
        current = self._lag.run(forcing)[:, 0]
        stated = temperature_limit(coil, self._problem.stage.amplifier, self._problem.grid, budget)
        return float((stated.temperatures_C(current, command) - stated.bounds_C).max())
