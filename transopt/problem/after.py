"""The command after the waveform: zero, or with a virtual wall the wall's feedback.

From tau_N on the transient contributes nothing. Without a wall the command is zero. With one it is the feedback's
command, which is not zero until the stylus rests. While the ticks at which the wall pushes are held fixed, the
commands after the window are affine in those within it: let c = (c_w, c_a) be the commands before and after tau_N and
Phi(c) the feedback's command for the motion under c; then c_a = Phi(c)_a. The encoder is read before the command that
responds to it, so the derivative T of Phi_a by c_a is strictly lower triangular, and forward substitution solves
(1 - T) c_a = Phi((c_w, 0))_a.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy

from transopt.base.signals import FloatArray
from transopt.plant.amplifier import prefilter_coefficients
from transopt.plant.discretise import Motion, StageModel
from transopt.plant.time_grid import TimeGrid
from transopt.plant.wall import HandOver, earlier_by, feedback_command, feedback_command_transpose


@dataclass(frozen=True)
class Feedback:
    """The wall's feedback command as a function of the command, (K,) each for any K <= N + M.

    A plant with several motors has commands (m, K) and no wall.

    Attributes
    ----------
    stage : device whose encoder is read.
    wall : None where the scene has none; the feedback command is then zero.
    grid : time axis.
    """

    stage: StageModel
    wall: HandOver | None
    grid: TimeGrid

    def course(self, motion: Motion) -> FloatArray:
        """(K,) y that the encoder reads at the ticks t_k, for a motion (K,) at the switching instants."""
        late = self.stage.whole_delay + 1
        return np.append(np.zeros(late), motion.encoder_m)[: motion.encoder_m.size]

    def command(self, motion: Motion) -> FloatArray:
        """(K,) feedback command during a motion (K,); the wall pushes at the fixed ticks `wall.pressing`."""
        if self.wall is None:
            return np.zeros(motion.plant_input.shape)
        dt = self.grid.dt_s
        return feedback_command(self.wall.masked_feedback(self.course(motion), dt), self.stage.amplifier, dt)

    def transposed(self, by_command: FloatArray) -> FloatArray:
        """(..., K) gradient by the encoder's reading for a gradient (..., K) by the feedback command."""
        if self.wall is None:
            return np.zeros(by_command.shape[-1:])
        if by_command.ndim > 1:
            return np.stack([self.transposed(each) for each in by_command])
        dt, late = self.grid.dt_s, self.stage.whole_delay + 1
        by_feedback = feedback_command_transpose(by_command, self.stage.amplifier, dt)
        return earlier_by(late, self.wall.feedback_transpose(by_feedback, dt))

    def continued(self, command: FloatArray) -> FloatArray:
        """(N + M,) a command (N,) of the window, continued after it."""
        M = self.grid.after_stages
        silence = np.zeros((*command.shape[:-1], M), dtype=command.dtype)
        lasting = np.concatenate([command, silence], axis=-1)
        if self.wall is None or M == 0:
            return lasting
        by_window = self.command(self.stage.motion(lasting))[command.size :]
        lasting[command.size :] = self._substituted(by_window, transposed=False)
        return lasting

    def continued_transposed(self, by_lasting: FloatArray) -> FloatArray:
        """(..., N) gradient by the command of the window for a gradient (..., N + M) by the continued command."""
        N = self.grid.stages
        if self.wall is None or by_lasting.shape[-1] == N:
            return by_lasting[..., :N]
        if by_lasting.ndim > 1:
            return np.stack([self.continued_transposed(each) for each in by_lasting])
        by_feedback = np.append(np.zeros(N), self._substituted(by_lasting[N:], transposed=True))
        by_encoder = self.transposed(by_feedback)
        through = self.stage.adjoint(replace(Motion.zero(by_lasting.size), encoder_m=by_encoder))
        return np.asarray(by_lasting[:N] + through[:N])

    def _substituted(self, right: FloatArray, *, transposed: bool) -> FloatArray:
        """(M,) solution of (1 - T) x = right, or of its transpose."""
        side: Literal[0, 1] = 1 if transposed else 0
        right = np.asarray(right, dtype=float)
        solution = scipy.linalg.solve_triangular(
            self._minus_T, right, trans=side, lower=True, unit_diagonal=True, check_finite=False
        )
        return np.asarray(solution)

    @cached_property
    def _minus_T(self) -> FloatArray:
        """(M, M) -T: all of 1 - T but its diagonal of ones."""
        assert self.wall is not None
        M, N, dt, amplifier = self.grid.after_stages, self.grid.stages, self.grid.dt_s, self.stage.amplifier
        pulse = np.zeros(M)
        pulse[0] = 1.0
        response = self.wall.wall.linear(self.course(self.stage.motion(pulse)), dt)
        current = scipy.linalg.toeplitz(response, np.zeros(M)) * self.wall.pressing[N : N + M, None]
        now, before = (1.0, 0.0) if amplifier is None else prefilter_coefficients(amplifier, dt)
        minus_T = -now * current
        minus_T[1:] -= before * current[:-1]
        return minus_T
