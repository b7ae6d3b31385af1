"""The tracking cost: the weighted error of the stylus' acceleration, over all terms and devices."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.target import ZERO_M_S2, Target

FILTERED = ("wanted", "unit_wanted", "energy_m2_s4", "lost_m2_s4")  # what `filter_together` computes


@dataclass(frozen=True)
class Tracking:
    """Tracking cost: sum over the terms of sum_k weight_k (F e)_k^2 / E with e = y'' - (r - a_free).

    The cost is the mean over the devices or that of the worst device. E normalises it: it is the same sum with
    e = r - a_free, lost samples and tail included, so that the cost without any current is 1. The tail has to count:
    otherwise a saturated optimum ends in a kick that rings after the waveform like a second tap.

    Where limits bind, a least-squares optimum is too weak. A price lam > 0 on the missing energy subtracts

        lam [mean over devices of sum_(k<N) (F y'')_k^2 - level sum_(k<N) (F r)_k^2] / E

    from the cost, with F the filter of the last term. For lam < weight_k the result is still a sum of squares:
    w (a - r)^2 - lam a^2 = (w - lam) (a - w r / (w - lam))^2 - lam w r^2 / (w - lam).

    The loss of the worst device, max_s T_s, is the maximum of sum_s p_s T_s over the shares p >= 0 with sum p = 1. So
    the minimum of the worst loss is a saddle point: with its shares, the weighted sum has its optimum at the same
    commands, and there sum_s p_s T_s = max_s T_s.

    For a plant with several directions the sum runs over directions in place of devices, each with its own target.
    Then `shares` are the weights (p,) of the directions, of any sum, and E is the weighted sum over all targets.

    Attributes
    ----------
    target : target of y''.
    terms : error terms, at least one; the price on intensity refers to the energy of the last one.
    intensity : lam, 0 <= lam < every weight of the last term within the window.
    level : wanted energy over that of the target.
    shares : (S,) p_s >= 0 of the devices, of sum one; None for 1 / S each.
    worst : whether the cost is the loss of the worst device; `shares` are then those of the saddle point.
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
        """(T, L + N + M) target through every term's filter; (T, p, L + N + M) with several directions."""
        return np.asarray(self._filtered("wanted"))

    @cached_property
    def weights(self) -> FloatArray:
        """(T, L + N + M) weights of the samples in every term."""
        sizes = self._lost, self.target.after_m_s2.shape[-1]
        return np.stack([term.all_weights(*sizes) for term in self.terms])

    @cached_property
    def energy_m2_s4(self) -> float:
        """E, the normalisation of the cost."""
        return float(self._filtered("energy_m2_s4"))

    def _filtered(self, name: str) -> Any:
        """One of the parts that `filter_together` computes."""
        filter_together([self])
        return vars(self)[name]

    @property
    def _directions(self) -> bool:
        """Whether several directions are tracked, each with its own target."""
        return self.wanted.ndim == 3

    @cached_property
    def counts_nothing(self) -> bool:
        """Whether the weighted rms of the filtered target is below `ZERO_M_S2`.

        An error relative to so small an E would be dominated by rounding.
        """
        return not self.energy_m2_s4 >= ZERO_M_S2**2 * float(self.weights.sum()) > 0

    @cached_property
    def lost_m2_s4(self) -> float:
        """The lost samples' part of every loss, times E."""
        return float(self._filtered("lost_m2_s4"))

    def error(self, accelerations_m_s2: FloatArray) -> FloatArray:
        """(T, S, K) F e for accelerations (S, K) from tau_0 on, K <= N + M; (T, p, K) with several directions."""
        return _errors([self], accelerations_m_s2[None])[:, 0]

    def value(self, accelerations_m_s2: FloatArray) -> float:
        """The cost at the accelerations (S, N + M) of every device, or (p, N + M) of every direction."""
        return float(values([self], accelerations_m_s2[None])[0])

    def mean(self, of_devices: FloatArray) -> FloatArray:
        """Mean of numbers (..., S) of the devices, or (..., p) of the directions, weighted by their shares."""
        found = np.mean(of_devices, axis=-1) if self.shares is None else of_devices @ self.shares
        return np.asarray(found)

    def losses(self, accelerations_m_s2: FloatArray) -> FloatArray:
        """(S,) loss T_s of each device; the cost is their mean or the largest."""
        return np.asarray(_losses([self], np.atleast_2d(accelerations_m_s2)[None])[0])

    def above_mean(self, accelerations_m_s2: FloatArray) -> float:
        """Excess of the worst device's loss over the weighted mean, >= 0; zero at the saddle point."""
        losses = self.losses(accelerations_m_s2)
        return max(float(losses.max() - self.mean(losses)), 0.0)

    def reward(self, accelerations_m_s2: FloatArray) -> float:
        """The reward for intensity that is subtracted from the cost: lam times the energy above the level, over E."""
        if self.intensity == 0:
            return 0.0
        made, wanted = self._energies(accelerations_m_s2)
        return self.intensity * (made - self.level * wanted) / (self.energy_m2_s4 or 1.0)

    def energy_dB(self, accelerations_m_s2: FloatArray) -> float:
        """Mean energy of accelerations (S, >= N) in the last term over the target's, within the window [dB]."""
        # A difference of logarithms, as the ratio of the energies may overflow.
        made, wanted = (np.log10(max(energy, np.finfo(float).tiny)) for energy in self._energies(accelerations_m_s2))
        return float(10 * (made - wanted))

    @cached_property
    def _window(self) -> slice:
        """The N samples of the window among the L + N + M."""
        return slice(self._lost, self._lost + self.target.window_m_s2.shape[-1])

    def _energies(self, accelerations_m_s2: FloatArray) -> tuple[float, float]:
        """Mean energy made and energy wanted in the last term within the window."""
        N = self.target.window_m_s2.size
        made = np.atleast_2d(self.terms[-1].filtered(accelerations_m_s2[..., :N]))
        return float(self.mean(np.sum(made**2, axis=-1))), float(np.sum(self.wanted[-1, self._window] ** 2))

    @cached_property
    def unit_wanted(self) -> FloatArray:
        """(T, N + M) reference of the outputs, F (r - a_free) / sqrt(E); zero for a tap of zero.

        With several directions it is (p T, N + M), the terms of one direction side by side.
        """
        return np.asarray(self._filtered("unit_wanted"))

    @cached_property
    def solved_weights(self) -> FloatArray:
        """(T, N) weights of the minimised squares within the window; those of the last term are w - lam."""
        weights = self.weights[:, self._window].copy()
        weights[-1] -= self.intensity
        return weights

    @cached_property
    def solved_wanted(self) -> FloatArray:
        """(T, N) reference of the minimised squares in the window, over sqrt(E); the last one times w / (w - lam)."""
        wanted = self.unit_wanted[:, : self.target.window_m_s2.shape[-1]]
        if self.intensity == 0:
            return wanted
        wanted = wanted.copy()
        wanted[-1] *= self.weights[-1, self._window] / self.solved_weights[-1]
        return wanted

    @property
    def constant(self) -> float:
        """The part of the minimised cost that no command changes: lost samples and the constant of the reward."""
        lost = self.lost_m2_s4 / (self.energy_m2_s4 or 1.0)
        if self.intensity == 0:
            return lost
        squares = self.unit_wanted[-1, : self.target.window_m_s2.size] ** 2
        turned = float(squares @ (self.weights[-1, self._window] / self.solved_weights[-1]))
        return lost + self.intensity * (self.level * float(np.sum(squares)) - turned)


def values(costs: Sequence[Tracking], accelerations_m_s2: FloatArray) -> FloatArray:
    """(G,) values of costs at accelerations (G, S, N + M) of every device, or (G, p, N + M) of every direction.

    Parameters
    ----------
    costs : G of them, which differ in their targets alone.
    """
    first = costs[0]
    if first._directions:
        squares, (lost, energy) = _squares(costs, accelerations_m_s2), _sizes(costs)
        return np.asarray((lost + first.mean(squares)) / energy)
    losses = _losses(costs, accelerations_m_s2)
    return np.asarray(losses.max(axis=1) if first.worst else first.mean(losses))


def gradients(costs: Sequence[Tracking], accelerations_m_s2: FloatArray, shares: FloatArray) -> FloatArray:
    """(G, S, N + M) gradients of the minimised costs by the accelerations (G, S, N + M), or (G, p, N + M).

    Parameters
    ----------
    costs : as for `values`.
    shares : (S,) shares of the devices, or (p,) weights of the directions.
    """
    first, (_, energy) = costs[0], _sizes(costs)
    by_filtered = _errors(costs, accelerations_m_s2)
    by_filtered *= first.weights[:, None, None, first._lost :]
    if first.intensity > 0:
        N = first.target.window_m_s2.shape[-1]
        by_filtered[-1, ..., :N] -= first.intensity * first.terms[-1].filtered(accelerations_m_s2)[..., :N]
    by_filtered *= 2 * shares[:, None] / energy[:, None, None]
    return np.asarray(sum(term.transposed(by) for term, by in zip(first.terms, by_filtered, strict=True)))


def _errors(costs: Sequence[Tracking], accelerations_m_s2: FloatArray) -> FloatArray:
    """(T, G, S, K) F e for accelerations (G, S, K) from tau_0 on, K <= N + M; or (T, G, p, K) of directions."""
    first, K = costs[0], accelerations_m_s2.shape[-1]
    wanted = np.stack([cost.wanted[..., first._lost : first._lost + K] for cost in costs], axis=1)
    # Before tau_0 the device is at rest, and so is the filter of its acceleration.
    made = np.stack([term.filtered(accelerations_m_s2) for term in first.terms])
    return made - (wanted if first._directions else wanted[:, :, None])


def _squares(costs: Sequence[Tracking], accelerations_m_s2: FloatArray) -> FloatArray:
    """(G, S) weighted sums of squares of the errors of each device, or (G, p) of each direction."""
    errors, weights = _errors(costs, accelerations_m_s2), costs[0].weights[:, costs[0]._lost :]
    return np.asarray(np.einsum("tk,tgsk,tgsk->gs", weights, errors, errors))


def _losses(costs: Sequence[Tracking], accelerations_m_s2: FloatArray) -> FloatArray:
    """(G, S) loss of each device."""
    lost, energy = _sizes(costs)
    return np.asarray((lost[:, None] + _squares(costs, accelerations_m_s2)) / energy[:, None])


def _sizes(costs: Sequence[Tracking]) -> tuple[FloatArray, FloatArray]:
    """(G,) parts of the lost samples and (G,) energies E, 1 for a target of zero."""
    return np.array([cost.lost_m2_s4 for cost in costs]), np.array([cost.energy_m2_s4 or 1.0 for cost in costs])


def filter_together(costs: Sequence[Tracking]) -> None:
    """Filter the targets of costs with the same terms in one pass; all that depends on them is then cached."""
    groups: dict[tuple[object, ...], list[Tracking]] = {}
    for each in costs:
        if vars(each).keys() >= {*FILTERED}:
            continue
        groups.setdefault((id(each.terms), each.target.lost, each.target.whole_m_s2.shape), []).append(each)
    for group in groups.values():
        weights, lost = group[0].weights, group[0].target.lost
        whole = np.stack([each.target.whole_m_s2 for each in group])
        wanted = np.stack([term.filtered(whole) for term in group[0].terms], axis=1)
        directed = wanted.ndim > 3
        squares, of_lost = (
            np.einsum("tk,nt...k,nt...k->n...", weights[:, part], wanted[..., part], wanted[..., part])
            for part in (slice(None), slice(lost))
        )
        if directed:
            squares, of_lost = (
                np.array([each.mean(of) for each, of in zip(group, sums, strict=True)]) for sums in (squares, of_lost)
            )
        units = np.where(squares == 0, 1.0, np.sqrt(squares))
        unit_wanted = wanted[..., lost:] / units.reshape(-1, *[1] * (wanted.ndim - 1))
        if directed:
            unit_wanted = np.swapaxes(unit_wanted, 1, 2).reshape(len(group), -1, unit_wanted.shape[-1])
        parts = zip(group, wanted, unit_wanted, map(float, squares), map(float, of_lost), strict=True)
        for each, filtered, unit, energy, before in parts:
            vars(each).update(zip(FILTERED, (filtered, unit, energy, before), strict=True), weights=weights)
