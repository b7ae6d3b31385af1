"""The nonlinear program of an entry on a nonlinear plant, by multiple shooting, for IPOPT.

Variables are the states z_1 to z_(N+M) at the switching instants and the free commands c_0 to c_(F-1), each in units
of its own size; z_0 = 0, and the commands of the hand-over and after the window are zero and no variables. The step
of a stage is one function, mapped over all stages, so that first and second derivatives are as well: a program of
2880 stages is built in half a second. (`Function.map` is called without a number of threads: with one, CasADi shares
memory that it must not.) What a limit bounds alone is a box on its variable; limits on sums are rows behind the
dynamics. The start is a command, the linear design's, rolled out.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from transopt.base.arithmetic import FUNCTIONS, Functions
from transopt.base.recursions import LinearSystem
from transopt.base.signals import FloatArray
from transopt.plant.discretise import AFTER
from transopt.plant.nonlinear_stage import NonlinearStage, resolved
from transopt.plant.scaling import state_scale
from transopt.problem.answer import OBJECTIVE_SCALE, Multipliers, Pair, Solution, Status
from transopt.problem.limits.limit import Limit
from transopt.problem.limits.row import COMMAND, HELD, INPUT, Row
from transopt.problem.nonlinear import NonlinearProblem
from transopt.problem.objective.weighting import ErrorFilter
from transopt.proof.nonlinear import NonlinearEffect, with_hand_over
from transopt.solvers.casadi_ipopt import STATUS
from transopt.solvers.options import SolverOptions, most_time_s

# Additional time [s] per stage and substep beside that of a QP; most of it goes into the second derivatives.
TIME_PER_SUBSTEP_S: Final = 1e-2
COARSE: Final = 1e-3  # integration error of the first, coarse program, relative to the largest acceleration
# IPOPT's options for a start from the answer of a coarser program: do not push it away from the bounds it touches.
NEARBY: Final[Mapping[str, str | float]] = MappingProxyType(
    {
        "warm_start_init_point": "yes",
        "mu_init": 1e-9,
        "warm_start_bound_push": 1e-11,
        "warm_start_bound_frac": 1e-11,
        "warm_start_slack_bound_push": 1e-11,
        "warm_start_slack_bound_frac": 1e-11,
        "warm_start_mult_bound_push": 1e-11,
    }
)
CASADI: Final[Functions] = MappingProxyType(
    {"abs": ca.fabs, **{name: getattr(ca, name) for name in FUNCTIONS if name != "abs"}}
)


@dataclass(frozen=True)
class _Value:
    """A limit's row in the scaled variables: now z_k + after z_(k+1) + command c_k + held c_(k-1).

    Attributes
    ----------
    unit : divisor of value and bounds.
    lower, upper : (N,) bounds less the offset; infinite where no variable affects the value.
    """

    name: str
    unit: float
    now: FloatArray
    after: FloatArray
    command: float
    held: float
    lower: FloatArray
    upper: FloatArray

    def alone(self, free: int) -> tuple[int, NDArray[np.int64], NDArray[np.int64], float] | None:
        """The only variable in the row, so that the limit is a box on it; None for a sum of several.

        Returns
        -------
        Index of the state, -1 for the command; its instants; the stages of the row; its factor in the row.
        """
        N, n = self.lower.size, self.now.size
        parts = np.concatenate([self.now, self.after, [self.command, self.held]])
        if np.count_nonzero(parts) != 1 or parts.max() <= 0 or self.held:
            return None
        of, k = int(np.argmax(parts)), np.arange(N)
        if of == 2 * n:
            return -1, k[:free], k[:free], float(parts[of])
        # Column k of the states is z_(k+1); z_0 is the state of rest and not a variable.
        return (of, k[:-1], k[1:], float(parts[of])) if of < n else (of - n, k, k, float(parts[of]))


@dataclass(frozen=True)
class Point:
    """IPOPT's answer, variables and multipliers, used as the starting point of a nearby program."""

    x: FloatArray
    lam_x: FloatArray
    lam_g: FloatArray


class NonlinearProgram:
    """The nonlinear program of one problem.

    Parameters
    ----------
    problem : a problem whose limits are linear in the outputs.
    near : the answer of a program that differs only in the number of substeps; IPOPT then starts there.
    """

    def __init__(self, problem: NonlinearProblem, options: SolverOptions, near: Point | None = None) -> None:
        self.near = near
        self.problem, stage, linear = problem, problem.stage, problem.linear
        N, M = linear.grid.stages, linear.grid.after_stages
        self.free, self.stages = linear.free_stages, N + M
        self.by_command = linear.input_scale
        self.filters = [term.error_filter for term in linear.terms]
        self.by_state = np.concatenate(
            [_sizes(stage, self.by_command, N), *(_filter_sizes(by, N) for by in self.filters if by is not None)]
        )
        self.order = n = self.by_state.size
        self.values = [self._value(limit, row) for limit, row in linear.rows()]
        self.alone = {v.name: found for v in self.values if (found := v.alone(self.free)) is not None}
        self.sums = [v for v in self.values if v.name not in self.alone]

        states, free = ca.MX.sym("states", n, self.stages), ca.MX.sym("commands", 1, self.free)
        command = ca.horzcat(free, ca.DM.zeros(1, self.stages - self.free))
        before = ca.horzcat(ca.DM.zeros(n, 1), states[:, :-1])
        after, made = self._stage_function().map(self.stages)(before, command)
        wanted, weights = self._led_to()
        error = made - ca.DM(wanted)
        window = command[:, :N]
        held = ca.horzcat(ca.DM.zeros(1, 1), window[:, :-1])
        weight = linear.movement.weight * self.by_command**2
        objective = ca.dot(ca.DM(weights), error**2) + weight * ca.sumsqr(window - held)
        rows = [ca.vec(states - after)]
        for value in self.sums:
            along = ca.DM(value.now[None]) @ before[:, :N] + ca.DM(value.after[None]) @ states[:, :N]
            rows.append(ca.vec(along + value.command * window + value.held * held))
        self.nlp: dict[str, ca.MX] = {
            "x": ca.veccat(states, free),
            "f": objective / OBJECTIVE_SCALE,
            "g": ca.vertcat(*rows),
        }
        second = self._hessian(states, free, wanted, weights)
        self.solver = ca.nlpsol(
            "ipopt",
            "ipopt",
            {**self.nlp},
            {
                "print_time": False,
                "show_eval_warnings": False,  # IPOPT answers what is no number by a shorter step or its message
                "hess_lag": second,
                "ipopt": {
                    "print_level": 0,
                    "sb": "yes",
                    "tol": options.tolerance,
                    "max_iter": options.max_iterations,
                    "max_cpu_time": most_time_s(self.stages) + TIME_PER_SUBSTEP_S * self.stages * stage.substeps,
                    # IPOPT relaxes bounds by default; the answer would violate the box.
                    "bound_relax_factor": 0.0,
                    # The program is scaled already.
                    "nlp_scaling_method": "none",
                    **({} if near is None else NEARBY),
                },
            },
        )

    def _led_to(self) -> tuple[FloatArray, FloatArray]:
        """(outputs, N + M) targets of the stage function's outputs, and their weights."""
        linear, tracking = self.problem.linear, self.problem.linear.tracking
        lost = linear.target.before_m_s2.size
        wanted, weights = tracking.unit_wanted, tracking.weights[:, lost:]
        if linear.heat_price == 0:
            return wanted, weights
        price = np.zeros((1, self.stages))
        price[0, : linear.grid.stages] = linear.heat_price * self.by_command**2
        return np.append(wanted, np.zeros_like(price), axis=0), np.append(weights, price, axis=0)

    def _stage_function(self) -> ca.Function:
        """(z_k, c_k) -> (z_(k+1), outputs), scaled; z holds the device's states and those of the error filters.

        The outputs are y''_k / sqrt(E) through the filter of each error term and, if heat has a price, the input.
        """
        stage, linear, m = self.problem.stage, self.problem.linear, self.problem.stage.order
        z, c = ca.SX.sym("z", self.order), ca.SX.sym("c")
        states, command = [z[j] * float(by) for j, by in enumerate(self.by_state)], c * self.by_command
        after = list(stage.step(states[:m], command, CASADI))
        made = stage.acceleration(states[:m], command, CASADI) / float(np.sqrt(linear.tracking.energy_m2_s4))
        outputs, first = [], m
        for by in self.filters:
            if by is None:
                outputs.append(made)
                continue
            A, B, C, D = by.state_space()
            kept = ca.vertcat(*states[first : first + 2])
            outputs.append(ca.DM(C) @ kept + D[0, 0] * made)
            after += ca.vertsplit(ca.DM(A) @ kept + ca.DM(B) * made)
            first += 2
        if linear.heat_price > 0:
            outputs.append((command if stage.amplifier is None else states[m - 1]) / self.by_command)
        after = [each / float(by) for each, by in zip(after, self.by_state, strict=True)]
        return ca.Function("stage", [z, c], [ca.vertcat(*after), ca.vertcat(*outputs)])

    def _hessian(self, states: ca.MX, free: ca.MX, wanted: FloatArray, weights: FloatArray) -> ca.Function:
        """Hessian of the Lagrangian, upper triangle, in the form that IPOPT expects.

        A stage adds mu' (outputs - r)^2 - lambda' (its step) to the Lagrangian. The second derivatives by z_k and c_k
        are one expression, mapped over all stages; this takes half the time of CasADi's own Hessian of the mapped
        stage. The movement adds a constant band.
        """
        linear, n, K, F = self.problem.linear, self.order, self.stages, self.free
        step, o = self._stage_function(), wanted.shape[0]
        z, c, by_step, mu, r = (ca.SX.sym(name, size) for name, size in zip("zclmr", (n, 1, n, o, o), strict=True))
        after, made = step(z, c)
        block, _ = ca.hessian(ca.dot(mu, (made - r) ** 2) - ca.dot(by_step, after), ca.vertcat(z, c))
        i, j = np.triu_indices(n + 1)
        entries = ca.vertcat(*(block[int(a), int(b)] for a, b in zip(i, j, strict=True)))
        of_stage = ca.Function("second", [z, c, by_step, mu, r], [entries])

        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.nlp["g"].numel())
        command = ca.horzcat(free, ca.DM.zeros(1, K - F))
        before = ca.horzcat(ca.DM.zeros(n, 1), states[:, :-1])
        scaled = ca.DM(weights) * (lam_f / OBJECTIVE_SCALE)
        by_dynamics = ca.reshape(lam_g[: n * K], n, K)
        blocks = of_stage.map(K)(before, command, by_dynamics, scaled, ca.DM(wanted))
        # Entry (a, b) of the block of stage k: z_k starts at variable n (k - 1), c_k comes after all states.
        rows, columns, values, k = [], [], [], np.arange(K)
        for entry, (a, b) in enumerate(zip(i.tolist(), j.tolist(), strict=True)):
            first, last = (0 if a == n else 1), (F if b == n else K)
            at = k[first:last]
            rows.append(n * K + at if a == n else n * (at - 1) + a)
            columns.append(n * K + at if b == n else n * (at - 1) + b)
            values.append(blocks[entry, first:last].T)
        weight = 2 * linear.movement.weight * self.by_command**2 / OBJECTIVE_SCALE * lam_f
        # c_k enters dc_k and dc_(k+1); the last command enters only one movement.
        both = np.full(F, 2.0)
        both[linear.grid.stages - 1 :] = 1.0
        values[-1] = values[-1] + weight * ca.DM(both)
        rows.append(n * K + np.arange(F - 1))
        columns.append(n * K + np.arange(1, F))
        values.append(-weight * ca.DM.ones(F - 1))
        row, column = np.concatenate(rows), np.concatenate(columns)
        order = np.lexsort((row, column))
        size = self.nlp["x"].numel()
        pattern = ca.Sparsity.triplet(size, size, row[order].tolist(), column[order].tolist())
        triangle = ca.MX(pattern, ca.vertcat(*values)[order.tolist()])
        named = ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        return ca.Function("second", [self.nlp["x"], ca.MX(0, 1), lam_f, lam_g], [triangle], *named)

    def _value(self, limit: Limit, row: Row) -> _Value:
        stage, N, m = self.problem.stage, self.problem.linear.grid.stages, self.problem.stage.order
        now, after, command, held = np.zeros(self.order), np.zeros(self.order), 0.0, 0.0
        for output, by in row.outputs.items():
            if output == COMMAND or (output == INPUT and stage.amplifier is None):
                command += by
            elif output == HELD:
                held += by
            elif output == INPUT:
                now[m - 1] += by
            elif output.endswith(AFTER):
                after[:m] += by * stage.rows[output.removesuffix(AFTER)]
            else:
                now[:m] += by * stage.rows[output]
        lower, upper = (np.array((bound - row.offset) / limit.stated) for bound in row.bounds(N))
        if not (after.any() or command):
            # At tau_0 the device is at rest and the held command is zero: the value is fixed.
            lower[0], upper[0] = -np.inf, np.inf
        by_state, by_command = self.by_state / limit.stated, self.by_command / limit.stated
        return _Value(
            row.name,
            limit.stated,
            now * by_state,
            after * by_state,
            command * by_command,
            held * by_command,
            lower,
            upper,
        )

    def _boxes(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Lower and upper bounds of the states (n, N + M) and of the free commands (F,)."""
        n = self.order
        states = np.full((2, n, self.stages), np.inf)
        commands = np.full((2, self.free), np.inf)
        for value in self.values:
            if value.name in self.alone:
                of, at, k, by = self.alone[value.name]
                sides = commands if of < 0 else states[:, of]
                for side, bound in zip(sides, (-value.lower, value.upper), strict=True):
                    side[at] = np.minimum(side[at], bound[k] / by)
        for side in (states, commands):
            # IPOPT takes no bounds that cross: at their middle both limits are missed, and the proof says so.
            crossing = side.sum(axis=0) < 0
            middle = (side[1, crossing] - side[0, crossing]) / 2
            side[:, crossing] = -middle, middle
        return -states[0], states[1], -commands[0], commands[1]

    def _guess(self, start: FloatArray) -> dict[str, FloatArray]:
        """Starting point of IPOPT: the nearby answer or, without one, a rolled-out command (N,)."""
        if self.near is not None:
            return {"x0": self.near.x, "lam_x0": self.near.lam_x, "lam_g0": self.near.lam_g}
        effect = NonlinearEffect(self.problem, start)
        states, made = [effect.states[1:]], effect.lasting.acceleration_m_s2
        unit = np.append(made, 0.0)[None] / np.sqrt(self.problem.linear.tracking.energy_m2_s4)
        for by in self.filters:
            if by is not None:
                A, B, _, _ = by.state_space()
                states.append(LinearSystem(A, B, np.eye(2), np.zeros((2, 1))).outputs(unit)[:, 1:].T)
        rolled = np.hstack(states) / self.by_state
        return {"x0": np.concatenate([np.nan_to_num(rolled).ravel(), start[: self.free] / self.by_command])}

    def solve(self, start: FloatArray) -> tuple[Solution, Point]:
        """Stationary point that IPOPT finds from the nearby answer or, without one, from a command (N,)."""
        began, linear, n = time.perf_counter(), self.problem.linear, self.order
        lower_z, upper_z, lower_c, upper_c = self._boxes()
        nothing = np.zeros(n * self.stages)
        found = self.solver(
            **self._guess(start),
            lbx=np.concatenate([lower_z.T.ravel(), lower_c]),
            ubx=np.concatenate([upper_z.T.ravel(), upper_c]),
            lbg=np.concatenate([nothing, *(value.lower for value in self.sums)]),
            ubg=np.concatenate([nothing, *(value.upper for value in self.sums)]),
        )
        message = str(self.solver.stats()["return_status"])
        x, lam_x, lam_g = (np.asarray(found[name]).ravel() for name in ("x", "lam_x", "lam_g"))
        command = np.zeros(linear.grid.stages)
        command[: self.free] = np.clip(x[n * self.stages :], lower_c, upper_c) * self.by_command
        multipliers = self._multipliers(lam_x, lam_g)
        solution = Solution(
            status=STATUS.get(message, Status.NUMERICAL_FAILURE),
            command=command,
            multipliers=with_hand_over(NonlinearEffect(self.problem, command), multipliers),
            solver="casadi-ipopt",
            message=message,
            iterations=int(self.solver.stats()["iter_count"]),
            solve_time_s=time.perf_counter() - began,
        )
        return solution, Point(x, lam_x, lam_g)

    def _multipliers(self, lam_x: FloatArray, lam_g: FloatArray) -> Multipliers:
        """CasADi's multipliers (grad f + J' lam_g + lam_x = 0) as multipliers of J in SI, clipped to their sign."""
        linear, n = self.problem.linear, self.order
        N, pairs, row = linear.grid.stages, dict[str, Pair](), n * self.stages
        by_state, by_command = lam_x[: n * self.stages].reshape(self.stages, n).T, lam_x[n * self.stages :]
        lower_z, upper_z, lower_c, upper_c = self._boxes()
        # A variable has one multiplier per side; it is assigned to the first row whose bound is active as the box.
        taken: dict[tuple[int, str], NDArray[np.bool_]] = {}
        for value in self.values:
            lower, upper = np.zeros(N), np.zeros(N)
            if value.name in self.alone:
                of, at, k, by = self.alone[value.name]
                on = (by_command if of < 0 else by_state[of])[at] * (OBJECTIVE_SCALE / (by * value.unit))
                low, high = (lower_c, upper_c) if of < 0 else (lower_z[of], upper_z[of])
                for side, mine, mu, target in (
                    ("lower", value.lower[k] / by >= low[at], -on, lower),
                    ("upper", value.upper[k] / by <= high[at], on, upper),
                ):
                    before = taken.setdefault((of, side), np.zeros(self.stages, dtype=bool))
                    own = mine & ~before[at]
                    target[k] = np.where(own, mu, 0.0)
                    before[at] |= own
            else:
                mu = lam_g[row : row + N] * (OBJECTIVE_SCALE / value.unit)
                lower, upper, row = -mu, mu, row + N
            pairs[value.name] = (lower, upper)
        return Multipliers(N, pairs, np.zeros(linear.hand_over_samples), np.zeros(N)).clipped()


def solve(problem: NonlinearProblem, start: FloatArray, options: SolverOptions) -> tuple[NonlinearProblem, Solution]:
    """Solve from a command (N,), that of the linear design, with as many substeps as the answer needs.

    A coarse program with few substeps is solved first and takes most of IPOPT's iterations. The program with all
    substeps that its command needs is then solved from the coarse answer, in few iterations. Where IPOPT does not
    converge, it starts once more from rest: on a plant that stiffens much the linear design's command may make a
    motion far from any optimum.

    Returns
    -------
    The problem with the final number of substeps, and its answer.
    """
    linear = problem.linear
    posed = replace(problem, stage=resolved(problem.stage, linear.continued(start), COARSE)[0])
    coarse = NonlinearProgram(posed, options)
    found, near = coarse.solve(start)
    spent, iterations = found.solve_time_s, found.iterations
    if found.status not in (Status.OPTIMAL, Status.INFEASIBLE):
        again, its_near = coarse.solve(np.zeros_like(start))
        spent, iterations = spent + again.solve_time_s, iterations + again.iterations
        if again.status is Status.OPTIMAL:
            found, near = again, its_near
    while found.status is Status.OPTIMAL:
        stage, _ = resolved(posed.stage, linear.continued(found.command))
        if stage.substeps <= posed.stage.substeps:
            break
        posed = replace(posed, stage=stage)
        found, near = NonlinearProgram(posed, options, near).solve(found.command)
        spent, iterations = spent + found.solve_time_s, iterations + found.iterations
    return posed, replace(found, solve_time_s=spent, iterations=iterations)


def _sizes(stage: NonlinearStage, input_size: float, stages: int) -> FloatArray:
    """(n,) typical size of each state, from the linear model; used as its unit.

    Friction is left out: at rest it may be so steep that the step is unstable there.
    """
    smooth = replace(stage, plant=replace(stage.plant, friction=None))
    rest = smooth.linearised(np.zeros(1), np.zeros((2, stage.order)))
    return state_scale(rest.A[0], rest.B[0], input_size, stages)


def _filter_sizes(by: ErrorFilter, stages: int) -> FloatArray:
    """(2,) typical size of each state of a filter whose input is of order one; used as its unit."""
    A, B, _, _ = by.state_space()
    return state_scale(A, B[:, 0], 1.0, stages)
