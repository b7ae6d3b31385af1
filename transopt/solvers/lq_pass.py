"""Linear-quadratic tracking by a Riccati recursion over the stages, run in CasADi's virtual machine.

    minimise    sum_k  w_k' (C z_k + D dc_k - r_k)^2 + s_k dc_k^2  +  |Z z_N - e|^2
    subject to  z_(k+1) = A z_k + B dc_k,  z_0 = 0,
                dc_k = f_k' z_k + g_k over the last h stages

The recursion takes `BLOCK` stages at a time: most of a stage's cost in a virtual machine is not arithmetic. Between
blocks the state stays a variable, and the products of four stages cost no digits.

An optimum is found by `Pass.improved` from any point: gradient by the adjoint recursion with the gains fed back,
movement by the closed loop. The problem is quadratic, so a second call is one step of iterative refinement.
All gradients are halved: of half the objective.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from transopt.base.signals import FloatArray

BLOCK = 4


@dataclass(frozen=True)
class Tracking:
    """The problem above, all numbers in any units: the recursion does not pivot, so scaling changes no digit.

    Attributes
    ----------
    A : (n, n). B : (n,). C : (ny, n). D : (ny,).
    reference, weights : (N, ny) r and w >= 0. movement_weights : (N,) s >= 0.
    rule_gains, rule_offsets : (h, n), (h,) f and g, 0 <= h <= N.
    end_gain, end_target : (m, n), (m,) Z and e.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    reference: FloatArray
    weights: FloatArray
    movement_weights: FloatArray
    rule_gains: FloatArray
    rule_offsets: FloatArray
    end_gain: FloatArray
    end_target: FloatArray

    @property
    def free_stages(self) -> int:
        return int(self.reference.shape[0] - self.rule_offsets.size)


@dataclass(frozen=True)
class Point:
    """A movement that obeys dynamics and rule.

    Attributes
    ----------
    movement : (N,) dc.
    error : (N, ny) C z + D dc - r.
    end_error : (m,) Z z_N - e.
    """

    movement: FloatArray
    error: FloatArray
    end_error: FloatArray


@dataclass(frozen=True)
class Gains:
    """Gains by block: feedback K (blocks, n, BLOCK) with dc = K' z, inverse factor (blocks, BLOCK, BLOCK) of R."""

    feedback: FloatArray
    inverse_factor: FloatArray


@dataclass(frozen=True)
class Recursions:
    """Functions over all blocks; a block's matrices stand side by side, its stages are stacked."""

    factor: ca.Function
    adjoint: ca.Function
    rollout: ca.Function


def _inverse_factor() -> ca.Function:
    """(R, s) -> X with X'X = (R + diag s)^-1, X lower triangular; NaN where that is not positive definite."""
    R, weight = ca.SX.sym("R", BLOCK, BLOCK), ca.SX.sym("s", BLOCK)
    L, X = ca.SX(BLOCK, BLOCK), ca.SX(BLOCK, BLOCK)
    for j in range(BLOCK):
        X[j, j] = 1 / ca.sqrt(R[j, j] + weight[j] - ca.sumsqr(L[j, :j]))
        for i in range(j + 1, BLOCK):
            L[i, j] = (R[i, j] - ca.dot(L[i, :j], L[j, :j])) * X[j, j]
    for j in range(BLOCK):
        for i in range(j + 1, BLOCK):
            X[i, j] = -X[i, i] * ca.dot(L[i, j:i].T, X[j:i, j])
    return ca.Function("inverse_factor", [R, weight], [ca.densify(X)])


def _chain(step: ca.Function, constants: int, blocks: int, *, backwards: bool) -> ca.Function:
    """Call step(state, constants, data of the block) -> (state, results) block after block.

    Written out and not as a mapaccum, which would copy the constants once per block.
    """
    symbols = [ca.MX.sym(step.name_in(i), step.sparsity_in(i)) for i in range(1 + constants)]
    data = [
        ca.MX.sym(step.name_in(i), step.size1_in(i), blocks * step.size2_in(i))
        for i in range(1 + constants, step.n_in())
    ]
    pieces = [ca.horzsplit(all_blocks, all_blocks.size2() // blocks) for all_blocks in data]
    state, fixed, order = symbols[0], symbols[1:], list(range(blocks))
    results: list[list[ca.MX]] = []
    for j in reversed(order) if backwards else order:
        state, *found = step.call([state, *fixed, *(piece[j] for piece in pieces)])
        results.append(found)
    if backwards:
        results.reverse()
    return ca.Function(
        "chain", [*symbols, *data], [state, *(ca.horzcat(*each) for each in zip(*results, strict=True))]
    )


@lru_cache(maxsize=16)
def recursions(n: int, ny: int, blocks: int) -> Recursions:
    """The three recursions for n states and ny outputs; transposes are handed over instead of computed each time."""
    q = BLOCK * ny
    P, z, costate = ca.MX.sym("P", n, n), ca.MX.sym("z", n), ca.MX.sym("costate", n)
    A, A_T = ca.MX.sym("A", n, n + BLOCK), ca.MX.sym("A_T", n + BLOCK, n)
    C, C_T = ca.MX.sym("C", q, n + BLOCK), ca.MX.sym("C_T", n + BLOCK, q)
    K = ca.MX.sym("K", BLOCK, n)
    w, s = ca.MX.sym("w", q), ca.MX.sym("s", BLOCK)
    by_output, by_input, offset = ca.MX.sym("by_output", q), ca.MX.sym("by_input", BLOCK), ca.MX.sym("o", BLOCK)

    # Cost to go in (z, dc) of the block; completing the square in dc leaves the cost to go in z.
    both = ca.mac(C_T, ca.diag(w) @ C, A_T @ (P @ A))
    X = _inverse_factor()(both[n:, n:], s)
    Y = X @ both[n:, :n]
    factor = ca.Function("factor", [P, A, A_T, C, C_T, w, s], [ca.mac(Y.T, -Y, both[:n, :n]), -X.T @ Y, X])

    gradient = ca.mac(C_T, by_output, A_T @ costate)
    by_movement = gradient[n:] + by_input
    adjoint = ca.Function(
        "adjoint",
        [costate, A_T, C_T, K, by_output, by_input],
        [ca.mac(K.T, by_movement, gradient[:n]), by_movement],
    )

    movement = ca.mac(K, z, offset)
    stacked = ca.vertcat(z, movement)
    rollout = ca.Function("rollout", [z, A, C, K, offset], [A @ stacked, movement, C @ stacked])
    return Recursions(
        factor=_chain(factor, 4, blocks, backwards=True),
        adjoint=_chain(adjoint, 2, blocks, backwards=True),
        rollout=_chain(rollout, 2, blocks, backwards=False),
    )


def _run(function: ca.Function, *arguments: FloatArray) -> list[FloatArray]:
    """Results of a dense function, flat, column by column, as the arguments are: no conversion, a tenth of the time.

    A row-major array is read as the transpose.
    """
    buffer: Any
    buffer, evaluate = function.buffer()
    rows = [np.ascontiguousarray(argument) for argument in arguments]  # alive until the function has run
    for i, argument in enumerate(rows):
        buffer.set_arg(i, argument.data)
    results = [np.empty(function.numel_out(i)) for i in range(function.n_out())]
    for i, result in enumerate(results):
        buffer.set_res(i, result.data)
    evaluate()
    return results


def prepare(states: int, outputs: int, free_stages: int) -> None:
    """Build what all problems of one shape share, so that a solve need not."""
    if free_stages:
        recursions(states, outputs, -(-free_stages // BLOCK))


class Pass:
    """One problem in blocks. The first block is filled up with stages before the start, in which nothing moves."""

    def __init__(self, problem: Tracking) -> None:
        self.problem = problem
        n, ny = problem.A.shape[0], problem.C.shape[0]
        self._blocks = -(-problem.free_stages // BLOCK)
        self._filling = self._blocks * BLOCK - problem.free_stages
        self._functions = recursions(n, ny, self._blocks) if self._blocks else None
        self._no_feedback = np.zeros((self._blocks, n, BLOCK))

        # (z, dc of the block) -> state after it and outputs in it.
        after, outputs = np.eye(n, n + BLOCK), np.empty((BLOCK, ny, n + BLOCK))
        for j in range(BLOCK):
            outputs[j] = problem.C @ after
            outputs[j, :, n + j] += problem.D
            after = problem.A @ after
            after[:, n + j] += problem.B
        flat = outputs.reshape(-1, n + BLOCK)
        # In the column-major order that CasADi reads.
        self._A, self._A_T = np.ascontiguousarray(after.T), after
        self._C, self._C_T = np.ascontiguousarray(flat.T), flat

        # (z at the hand-over, 1) -> movement and outputs under the rule.
        h = problem.rule_offsets.size
        state = np.eye(n, n + 1)
        self._rule_movement, self._rule_outputs = np.empty((h, n + 1)), np.empty((h, ny, n + 1))
        for j in range(h):
            moved = problem.rule_gains[j] @ state
            moved[n] += problem.rule_offsets[j]
            self._rule_movement[j] = moved
            self._rule_outputs[j] = problem.C @ state + problem.D[:, None] * moved
            state = problem.A @ state + problem.B[:, None] * moved
        self._end = problem.end_gain @ state

    def _in_blocks(self, values: FloatArray, filling: float = 0.0) -> FloatArray:
        """Values (N - h, ...) of the free stages, stage after stage, behind those before the start."""
        return np.concatenate([np.full((self._filling, *values.shape[1:]), filling), values])

    def factored(self, damping: float = 0.0) -> Gains:
        """The gains of every block; NaN from where the recursion broke down.

        With `damping` on top of every movement weight they are no longer exact, but exist where the problem is flat:
        `improved`, whose gradient stays the undamped one, is then a step of the proximal point method.
        """
        p, free = self.problem, self.problem.free_stages
        n = p.A.shape[0]
        if self._functions is None:
            return Gains(self._no_feedback, np.zeros((0, BLOCK, BLOCK)))
        outputs, movement = self._rule_outputs[..., :n].reshape(-1, n), self._rule_movement[:, :n]
        P = (outputs.T * p.weights[free:].ravel()) @ outputs + (movement.T * p.movement_weights[free:]) @ movement
        P += self._end[:, :n].T @ self._end[:, :n]
        weights = self._in_blocks(p.weights[:free])
        # A movement of infinite weight is none.
        movement_weights = self._in_blocks(p.movement_weights[:free] + damping, np.inf)
        _, K, X = _run(self._functions.factor, P, self._A, self._A_T, self._C, self._C_T, weights, movement_weights)
        return Gains(K.reshape(-1, n, BLOCK), X.reshape(-1, BLOCK, BLOCK))

    def _adjoint(self, point: Point, feedback: FloatArray) -> FloatArray:
        """(filling + N - h,) gradient by dc, every later stage answering with the feedback or the rule."""
        p, free = self.problem, self.problem.free_stages
        if self._functions is None:
            return np.zeros(0)
        by_output, by_input = p.weights * point.error, p.movement_weights * point.movement
        costate = np.tensordot(by_output[free:], self._rule_outputs[..., :-1], 2)
        costate += by_input[free:] @ self._rule_movement[:, :-1] + point.end_error @ self._end[:, :-1]
        by_output, by_input = self._in_blocks(by_output[:free]), self._in_blocks(by_input[:free])
        _, gradient = _run(self._functions.adjoint, costate, self._A_T, self._C_T, feedback, by_output, by_input)
        return gradient

    def _rollout(self, offset: FloatArray, feedback: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Movement (N - h,) and outputs (N - h, ny) of dc = feedback + offset from rest, and z after them."""
        n, ny = self.problem.A.shape[0], self.problem.C.shape[0]
        if self._functions is None:
            return np.zeros(0), np.zeros((0, ny)), np.zeros(n)
        z, movement, outputs = _run(self._functions.rollout, np.zeros(n), self._A, self._C, feedback, offset)
        return movement[self._filling :], outputs.reshape(-1, ny)[self._filling :], z

    def at_rest(self) -> Point:
        """The point in which nothing moves before the hand-over: known without a rollout, as z stays 0."""
        free = self.problem.free_stages
        error = -self.problem.reference
        error[free:] += self._rule_outputs[..., -1]
        movement = np.concatenate([np.zeros(free), self._rule_movement[:, -1]])
        return Point(movement, error, self._end[:, -1] - self.problem.end_target)

    def at(self, free_movement: FloatArray) -> Point:
        """The point of a movement (N - h,) of the free stages."""
        _, outputs, z = self._rollout(self._in_blocks(free_movement), self._no_feedback)
        start = np.append(z, 1.0)
        error = np.concatenate([outputs, self._rule_outputs @ start]) - self.problem.reference
        end_error = self._end @ start - self.problem.end_target
        return Point(np.concatenate([free_movement, self._rule_movement @ start]), error, end_error)

    def improved(self, point: Point, gains: Gains) -> Point:
        """The optimum, but for rounding, from any point."""
        gradient = self._adjoint(point, gains.feedback).reshape(-1, BLOCK, 1)
        X = gains.inverse_factor  # column-major: its transpose is what one wants first
        offset = -(X @ (X.transpose(0, 2, 1) @ gradient))
        movement, outputs, z = self._rollout(offset.ravel(), gains.feedback)
        return Point(
            point.movement + np.concatenate([movement, self._rule_movement[:, :-1] @ z]),
            point.error + np.concatenate([outputs, self._rule_outputs[..., :-1] @ z]),
            point.end_error + self._end[:, :-1] @ z,
        )

    def gradient(self, point: Point) -> FloatArray:
        """(N - h,) half the objective's gradient by the free dc; the stages under the rule follow it."""
        return self._adjoint(point, self._no_feedback)[self._filling :]

    def gradient_under_rule(self, point: Point) -> FloatArray:
        """(h,) half the objective's gradient by dc under the rule, minus half the rule's multiplier."""
        p, free = self.problem, self.problem.free_stages
        by_output, by_input = p.weights * point.error, p.movement_weights * point.movement
        gradient, costate = np.empty(p.rule_offsets.size), point.end_error @ p.end_gain
        for j in range(gradient.size - 1, -1, -1):
            gradient[j] = p.B @ costate + p.D @ by_output[free + j] + by_input[free + j]
            costate = costate @ p.A + by_output[free + j] @ p.C + p.rule_gains[j] * gradient[j]
        return gradient
