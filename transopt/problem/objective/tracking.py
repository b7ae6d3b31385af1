"""How far the stylus accelerates from the recorded tap: the terms of the error, summed over the devices."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.target import ZERO_M_S2, Target


@dataclass(frozen=True)
class Tracking:
    """Sum over the terms of sum_k weight_k (F e)_k^2 / E, e = y'' - (r - a_free), as the mean over the devices or
    as the worst of them.

    E is that sum with e = r - a_free, lost samples and tail included, so that it is 1 without any current. Without
    what the device does when the waveform is over a saturated optimum ends in a kick that rings on, a second tap.

    Where limits bind, least squares plays too weak. At a price lam > 0 of the energy that is missing, what is
    minimised is the sum less lam [mean over devices sum_(k<N) (F y'')_k^2 - level sum_(k<N) (F r)_k^2] / E, with F
    of the last term. For lam < weight_k it is a sum of squares:
    w (a - r)^2 - lam a^2 = (w - lam) (a - w r / (w - lam))^2 - lam w r^2 / (w - lam).

    What the worst of the devices loses, max_s T_s, is max over the shares p >= 0, sum p = 1, of sum_s p_s T_s. So
    the least worst is a saddle point: for its shares the sum has its optimum there, and sum_s p_s T_s = max_s T_s.

    Of a plant with several directions the sum runs over these in place of devices, each with a target of its own.
    Then `shares` are their weights (p,), of any sum, and E is the sum of all weighted targets.

    Attributes
    ----------
    target : what is asked of y''.
    terms : of the error, one at least; the last one is that whose energy intensity is about.
    intensity : lam, 0 <= lam < every weight of the last term within the window.
    level : energy that is asked for, over that of the target.
    shares : (S,) p_s >= 0 of the devices in the sum, of sum one; None for 1 / S each.
    worst : the sum is the loss of the worst device, and `shares` are those of its saddle point.
    """

    target: Target
    terms: Sequence[ErrorTerm]
    intensity: float = 0.0
    level: float = 1.0
    shares: FloatArray | None = None
    worst: bool = False
    _lost: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_lost", self.target.lost)

    @cached_property
    def wanted(self) -> FloatArray:
        """(T, L + N + M) what every term's filter makes of the target; of several directions (T, p, L + N + M)."""
        return np.stack([term.filtered(self.target.whole_m_s2) for term in self.terms])

    @cached_property
    def weights(self) -> FloatArray:
        """(T, L + N + M) of the samples in every term."""
        sizes = self._lost, self.target.after_m_s2.shape[-1]
        return np.stack([term.all_weights(*sizes) for term in self.terms])

    @cached_property
    def energy_m2_s4(self) -> float:
        """E."""
        if self._directions:
            return self.mean(self._squares(self.wanted))
        return float(np.sum(self.weights * self.wanted**2))

    @property
    def _directions(self) -> bool:
        """Whether several directions are tracked, each with its own target."""
        return self.wanted.ndim == 3

    def _squares(self, filtered: FloatArray) -> FloatArray:
        """(p,) weighted squares of the last samples (T, p, K) of each direction."""
        last = self.weights.shape[1] - filtered.shape[2]
        return np.asarray(np.einsum("tk,tpk->p", self.weights[:, last:], filtered**2))

    @cached_property
    def counts_nothing(self) -> bool:
        """Whether the tap is zero where it counts: its rms by the weights, after the filters, is below `ZERO_M_S2`.

        An error relative to so small an E is dominated by the rounding of the samples that do not count.
        """
        return not self.energy_m2_s4 >= ZERO_M_S2**2 * float(self.weights.sum()) > 0

    @cached_property
    def lost_m2_s4(self) -> float:
        """What the samples that no command can reach add to every loss, times E."""
        lost = slice(self._lost)
        if self._directions:
            return self.mean(np.einsum("tk,tpk->p", self.weights[:, lost], self.wanted[..., lost] ** 2))
        return float(np.sum(self.weights[:, lost] * self.wanted[:, lost] ** 2))

    def error(self, accelerations_m_s2: FloatArray) -> FloatArray:
        """(T, ..., K) F e of accelerations (..., K) from tau_0 on, K <= N + M; of several directions (p, K)."""
        K = accelerations_m_s2.shape[-1]
        # Before tau_0 the device is at rest, so that its filter is as well.
        return np.stack(
            [
                term.filtered(accelerations_m_s2) - wanted[..., self._lost : self._lost + K]
                for term, wanted in zip(self.terms, self.wanted, strict=True)
            ]
        )

    def value(self, accelerations_m_s2: FloatArray) -> float:
        """The sum at the accelerations (S, N + M) of every device, or (p, N + M) of every direction."""
        if self._directions:
            squares = self.mean(self._squares(self.error(accelerations_m_s2)))
            return (self.lost_m2_s4 + squares) / self.energy_m2_s4
        losses = self.losses(accelerations_m_s2)
        return float(losses.max()) if self.worst else self.mean(losses)

    def mean(self, of_devices: FloatArray) -> float:
        """What figures (S,) of the devices, or (p,) of the directions, come to by their shares."""
        return float(np.mean(of_devices) if self.shares is None else self.shares @ of_devices)

    def losses(self, accelerations_m_s2: FloatArray) -> FloatArray:
        """(S,) what each device loses, of which the sum is a mean or the largest."""
        errors = self.error(np.atleast_2d(accelerations_m_s2))
        squares = np.einsum("tk,tsk->s", self.weights[:, self._lost :], errors**2)
        return np.asarray((self.lost_m2_s4 + squares) / self.energy_m2_s4)

    def above_mean(self, accelerations_m_s2: FloatArray) -> float:
        """Excess of the worst device's loss over the mean by the shares; zero at the saddle point, >= 0."""
        losses = self.losses(accelerations_m_s2)
        return max(float(losses.max()) - self.mean(losses), 0.0)

    def reward(self, accelerations_m_s2: FloatArray) -> float:
        """lam times the energy above the level that is asked for, over E: what the minimised sum has less."""
        if self.intensity == 0:
            return 0.0
        made, wanted = self._energies(accelerations_m_s2)
        return self.intensity * (made - self.level * wanted) / self.energy_m2_s4

    def energy_dB(self, accelerations_m_s2: FloatArray) -> float:
        """Energy in the last term within the window over the target's, of accelerations (S, >= N), the mean [dB]."""
        # Either may be too small or too large for their ratio.
        made, wanted = (np.log10(max(energy, np.finfo(float).tiny)) for energy in self._energies(accelerations_m_s2))
        return float(10 * (made - wanted))

    @cached_property
    def _window(self) -> slice:
        """The N samples of the window among the L + N + M."""
        return slice(self._lost, self._lost + self.target.window_m_s2.shape[-1])

    def _energies(self, accelerations_m_s2: FloatArray) -> tuple[float, float]:
        N = self.target.window_m_s2.size
        made = np.atleast_2d(self.terms[-1].filtered(accelerations_m_s2[..., :N]))
        return self.mean(np.sum(made**2, axis=-1)), float(np.sum(self.wanted[-1, self._window] ** 2))

    def gradient(self, acceleration_m_s2: FloatArray, share: float) -> FloatArray:
        """(N + M,) of the minimised sum by the acceleration (N + M,) of a device that has this share in it."""
        if self._directions:
            assert self.shares is not None
            by_direction = self.weights[:, None, self._lost :] * self.error(acceleration_m_s2)
            by_direction *= 2 * self.shares[:, None] / self.energy_m2_s4
            return np.asarray(sum(term.transposed(by) for term, by in zip(self.terms, by_direction, strict=True)))
        by_filtered = self.weights[:, self._lost :] * self.error(acceleration_m_s2)
        if self.intensity > 0:
            N = self.target.window_m_s2.size
            by_filtered[-1, :N] -= self.intensity * self.terms[-1].filtered(acceleration_m_s2)[:N]
        by_filtered *= 2 * share / self.energy_m2_s4
        return np.asarray(sum(term.transposed(by) for term, by in zip(self.terms, by_filtered, strict=True)))

    @cached_property
    def unit_wanted(self) -> FloatArray:
        """(T, N + M) of F (r - a_free) / sqrt(E), what the outputs are compared with; zero for a tap of zero.

        Of several directions it is (p T, N + M), the terms of one direction side by side.
        """
        wanted = self.wanted[..., self._lost :] / (np.sqrt(self.energy_m2_s4) or 1.0)
        return np.asarray(np.moveaxis(wanted, 0, 1).reshape(-1, wanted.shape[-1]) if self._directions else wanted)

    @cached_property
    def solved_weights(self) -> FloatArray:
        """(T, N) of the squares that are minimised within the window: of the last term w - lam."""
        weights = self.weights[:, self._window].copy()
        weights[-1] -= self.intensity
        return weights

    @cached_property
    def solved_wanted(self) -> FloatArray:
        """(T, N) what the outputs are led to in the window, over sqrt(E); of the last term w / (w - lam) as much."""
        wanted = self.unit_wanted[:, : self.target.window_m_s2.shape[-1]]
        if self.intensity == 0:
            return wanted
        wanted = wanted.copy()
        wanted[-1] *= self.weights[-1, self._window] / self.solved_weights[-1]
        return wanted

    @property
    def constant(self) -> float:
        """What the minimised sum has beside the squares over window and tail."""
        lost = self.lost_m2_s4 / (self.energy_m2_s4 or 1.0)
        if self.intensity == 0:
            return lost
        squares = self.unit_wanted[-1, : self.target.window_m_s2.size] ** 2
        turned = float(squares @ (self.weights[-1, self._window] / self.solved_weights[-1]))
        return lost + self.intensity * (self.level * float(np.sum(squares)) - turned)
