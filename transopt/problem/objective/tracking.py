"""The first term of the objective: how far the stylus accelerates from the recorded tap."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.objective.target import Target
from transopt.problem.objective.weighting import ErrorFilter


@dataclass(frozen=True)
class Tracking:
    """[lost + sum_(k<N) w_k (F e)_k^2 + sum_(j<M) (F e)_(N+j)^2] / E with e = y'' - r, as the mean over the devices,
    or as the worst of them.

    Lost is what came before the first command could act, E the energy of the tap (`Target`). The last sum is over
    what the device does when the waveform is over: without it a saturated optimum ends in a kick that rings on, a
    second tap. The error filter F starts at rest at tau_0 and runs on.

    Where limits bind, least squares plays too weak. At a price lam > 0 of the energy that is missing, what is
    minimised is the term less lam [mean over devices sum_(k<N) (F y'')_k^2 - level sum_(k<N) (F r)_k^2] / E. For
    lam < w_k it is a sum of squares:
    w (a - r)^2 - lam a^2 = (w - lam) (a - w r / (w - lam))^2 - lam w r^2 / (w - lam).

    What the worst of the devices loses, max_s T_s, is max over the shares p >= 0, sum p = 1, of sum_s p_s T_s. So
    the least worst is a saddle point: for its shares the sum has its optimum there, and sum_s p_s T_s = max_s T_s.

    Attributes
    ----------
    target : r.
    weights : (N,) w_k >= 0 within the window; after it every sample counts as it is.
    error_filter : F; None for 1.
    intensity : lam, 0 <= lam < w_k.
    level : energy that is asked for, over that of r.
    shares : (S,) p_s >= 0 of the devices in the term, of sum one; None for 1 / S each.
    worst : the term is the loss of the worst device, and `shares` are those of its saddle point.
    """

    target: Target
    weights: FloatArray
    error_filter: ErrorFilter | None
    intensity: float = 0.0
    level: float = 1.0
    shares: FloatArray | None = None
    worst: bool = False

    @cached_property
    def all_weights(self) -> FloatArray:
        """(N + M,) of the window and of what comes after it."""
        return np.append(self.weights, np.ones(self.target.after_m_s2.size))

    def filtered(self, accelerations_m_s2: FloatArray) -> FloatArray:
        """(..., K) F of accelerations from tau_0 on."""
        return accelerations_m_s2 if self.error_filter is None else self.error_filter.apply(accelerations_m_s2)

    def error(self, accelerations_m_s2: FloatArray) -> FloatArray:
        """(..., K) F e of accelerations (..., K), of the window or beyond, K <= N + M."""
        wanted = self.target.continued_m_s2[: accelerations_m_s2.shape[-1]]
        return self.filtered(accelerations_m_s2 - wanted)

    def value(self, accelerations_m_s2: FloatArray) -> float:
        """The term at the accelerations (S, N + M) of every device."""
        losses = self.losses(accelerations_m_s2)
        return float(losses.max()) if self.worst else self.mean(losses)

    def mean(self, of_devices: FloatArray) -> float:
        """What figures (S,) of the devices come to by their shares."""
        return float(np.mean(of_devices) if self.shares is None else self.shares @ of_devices)

    def losses(self, accelerations_m_s2: FloatArray) -> FloatArray:
        """(S,) what each device loses, of which the term is a mean or the largest."""
        squares = np.atleast_2d(self.error(accelerations_m_s2)) ** 2 @ self.all_weights
        return np.asarray((self.target.lost_m2_s4 + squares) / self.target.energy_m2_s4)

    def above_mean(self, accelerations_m_s2: FloatArray) -> float:
        """Excess of the worst device's loss over the mean by the shares; zero at the saddle point, >= 0."""
        losses = self.losses(accelerations_m_s2)
        return max(float(losses.max()) - self.mean(losses), 0.0)

    def reward(self, accelerations_m_s2: FloatArray) -> float:
        """lam times the energy above the level that is asked for, over E: what the minimised term has less."""
        if self.intensity == 0:
            return 0.0
        made, wanted = self._energies(accelerations_m_s2)
        return self.intensity * (made - self.level * wanted) / self.target.energy_m2_s4

    def energy_dB(self, accelerations_m_s2: FloatArray) -> float:
        """Energy within the window over that of r, the mean over the devices, of accelerations (S, >= N) [dB]."""
        # Either may be too small or too large for their ratio.
        made, wanted = (np.log10(max(energy, np.finfo(float).tiny)) for energy in self._energies(accelerations_m_s2))
        return float(10 * (made - wanted))

    def _energies(self, accelerations_m_s2: FloatArray) -> tuple[float, float]:
        N = self.target.window_m_s2.size
        made = np.atleast_2d(self.filtered(accelerations_m_s2[..., :N]))
        return self.mean(np.sum(made**2, axis=-1)), float(np.sum(self.filtered(self.target.window_m_s2) ** 2))

    def gradient(self, acceleration_m_s2: FloatArray, share: float) -> FloatArray:
        """(N + M,) of the minimised term by the acceleration (N + M,) of a device that has this share in it."""
        by_filtered = self.all_weights * self.error(acceleration_m_s2)
        if self.intensity > 0:
            N = self.target.window_m_s2.size
            by_filtered[:N] -= self.intensity * self.filtered(acceleration_m_s2)[:N]
        by_filtered *= 2 * share / self.target.energy_m2_s4
        return by_filtered if self.error_filter is None else self.error_filter.transpose(by_filtered)

    @cached_property
    def unit_reference(self) -> FloatArray:
        """(N + M,) F r / sqrt(E), the outputs' target where they are in units of sqrt(E); zero for a tap of zero."""
        return np.asarray(self.filtered(self.target.continued_m_s2) / (np.sqrt(self.target.energy_m2_s4) or 1.0))

    @property
    def solved_weights(self) -> FloatArray:
        """(N,) w - lam, of the squares that are minimised within the window."""
        return self.weights - self.intensity

    @property
    def solved_reference(self) -> FloatArray:
        """(N,) w / (w - lam) F r / sqrt(E), what the outputs in units of sqrt(E) are led to within the window."""
        wanted = self.unit_reference[: self.weights.size]
        return wanted if self.intensity == 0 else np.asarray(self.weights / self.solved_weights * wanted)

    @property
    def constant(self) -> float:
        """What the minimised term has beside the squares over window and tail."""
        energy = self.target.energy_m2_s4 or 1.0
        lost = self.target.lost_m2_s4 / energy
        if self.intensity == 0:
            return lost
        squares = self.unit_reference[: self.weights.size] ** 2
        turned = float(squares @ (self.weights / self.solved_weights))
        return lost + self.intensity * (self.level * float(np.sum(squares)) - turned)

    def nrmse(self, acceleration_m_s2: FloatArray) -> float:
        """The NRMSE of accelerations (N,) as the filter hears it; what is lost counts as it is."""
        lost, error = self.target.lost_m2_s4, self.error(acceleration_m_s2)
        wanted = self.filtered(self.target.window_m_s2)
        return float(np.sqrt((lost + error @ error) / (lost + wanted @ wanted)))
