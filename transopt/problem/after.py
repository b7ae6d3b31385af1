"""How a command goes on when the waveform is over: not at all, or as the wall asks.

From tau_N on nothing is left of the transient. Without a wall the command is zero; with one it is what the feedback
asks for, and the wall goes on pushing where it did not come to rest. With the ticks at which it pushes held fixed
that is affine in the commands of the window: with c = (c_w, c_a) before and after tau_N, and Phi the feedback's
command for the motion that c makes, c_a = Phi(c)_a. An encoder is read before the command that answers it, so the
derivative T of Phi_a by c_a is strictly lower triangular, and c_a follows by substitution from
(1 - T) c_a = Phi((c_w, 0))_a.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy

from transopt.base.signals import FloatArray
from transopt.plant.amplifier import prefilter_coefficients
from transopt.plant.discretise import Motion, StageModel, TimeGrid
from transopt.plant.wall import HandOver, earlier_by, feedback_command, feedback_command_transpose


@dataclass(frozen=True)
class Feedback:
    """The wall's feedback command as a function of the command, (K,) each for any K <= N + M.

    Of several motors the commands are (m, K), and there is no wall.

    Attributes
    ----------
    stage : whose encoder is read.
    wall : None without one: the feedback asks for nothing.
    grid : time axis.
    """

    stage: StageModel
    wall: HandOver | None
    grid: TimeGrid

    def course(self, motion: Motion) -> FloatArray:
        """(K,) y of the motor mass at the ticks t_k of a motion (K,) at the switching instants."""
        late = self.stage.whole_delay + 1
        return np.append(np.zeros(late), motion.encoder_m)[: motion.encoder_m.size]

    def command(self, motion: Motion) -> FloatArray:
        """(K,) that the wall asks for during a motion (K,), pushing at the ticks that are held fixed."""
        if self.wall is None:
            return np.zeros(motion.plant_input.shape)
        dt = self.grid.dt_s
        return feedback_command(self.wall.masked_feedback(self.course(motion), dt), self.stage.amplifier, dt)

    def transposed(self, by_command: FloatArray) -> FloatArray:
        """(K,) gradient by the encoder for a gradient (K,) by what the wall asks for."""
        if self.wall is None:
            return np.zeros(by_command.shape[-1:])
        dt, late = self.grid.dt_s, self.stage.whole_delay + 1
        by_feedback = feedback_command_transpose(by_command, self.stage.amplifier, dt)
        return earlier_by(late, self.wall.feedback_transpose(by_feedback, dt))

    def continued(self, command: FloatArray) -> FloatArray:
        """(N + M,) a command (N,) and what follows it."""
        M = self.grid.after_stages
        silence = np.zeros((*command.shape[:-1], M), dtype=command.dtype)
        lasting = np.concatenate([command, silence], axis=-1)
        if self.wall is None or M == 0:
            return lasting
        asked = self.command(self.stage.motion(lasting))[command.size :]
        lasting[command.size :] = self._solved(asked, transposed=False)
        return lasting

    def continued_transposed(self, by_lasting: FloatArray) -> FloatArray:
        """(N,) gradient by a command for a gradient (N + M,) by the command and what follows it."""
        N = self.grid.stages
        if self.wall is None or by_lasting.size == N:
            return by_lasting[..., :N]
        by_asked = np.append(np.zeros(N), self._solved(by_lasting[N:], transposed=True))
        by_encoder = self.transposed(by_asked)
        through = self.stage.adjoint(replace(Motion.zero(by_lasting.size), encoder_m=by_encoder))
        return np.asarray(by_lasting[:N] + through[:N])

    def _solved(self, asked: FloatArray, *, transposed: bool) -> FloatArray:
        side: Literal[0, 1] = 1 if transposed else 0
        asked = np.asarray(asked, dtype=float)
        found = scipy.linalg.solve_triangular(
            self._one_less_T, asked, trans=side, lower=True, unit_diagonal=True, check_finite=False
        )
        return np.asarray(found)

    @cached_property
    def _one_less_T(self) -> FloatArray:
        """(M, M) 1 - T."""
        assert self.wall is not None
        M, N, dt, amplifier = self.grid.after_stages, self.grid.stages, self.grid.dt_s, self.stage.amplifier
        pulse = np.zeros(M)
        pulse[0] = 1.0
        answer = self.wall.wall.linear(self.course(self.stage.motion(pulse)), dt)
        current = scipy.linalg.toeplitz(answer, np.zeros(M)) * self.wall.pressing[N : N + M, None]
        now, before = (1.0, 0.0) if amplifier is None else prefilter_coefficients(amplifier, dt)
        T = now * current
        T[1:] += before * current[:-1]
        return np.asarray(np.eye(M) - T)
