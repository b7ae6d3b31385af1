"""How much of a tap a warm coil allows: norms of currents, the rise that they bound, and the blend that is played.

The servo decides by this at every contact, and the page shows what it would decide. All is arithmetic in a stated
order, so that firmware which does the same gets the same bits.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import signal

from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import COPPER_PER_K, PWM_RIPPLE_A, RESISTANCE_REFERENCE_C, CoilModel
from transopt.problem.heat import heating

WITHHOLD_K = (
    5.0  # below the coil's limit no transient starts: a tap heats by 0.2 K at most, a minute on a wall by more
)
LEAST_SCALE = 0.25  # less of a transient is withheld: a fourth of a tap is no longer the same material


def currents(command_A: FloatArray, amplifier: Amplifier | None, dt_s: float) -> FloatArray:
    """(..., N + 1) current at the switching instants from rest, and after the last servo period."""
    if amplifier is None:
        return np.concatenate([command_A, np.zeros((*command_A.shape[:-1], 1))], axis=-1)
    decay = float(np.exp(-amplifier.rate_rad_s * dt_s))
    after = signal.lfilter([1 - decay], [1.0, -decay], command_A, axis=-1)
    return np.concatenate([np.zeros((*command_A.shape[:-1], 1)), after], axis=-1)


def norms(current_A: FloatArray, amplifier: Amplifier | None, dt_s: float) -> FloatArray:
    """(...) sqrt(sum of the mean i^2 of each servo period) for currents (..., N + 1) at the switching instants."""
    if amplifier is None:
        return np.asarray(np.linalg.norm(current_A, axis=-1))
    first, cross, last = heating(amplifier, dt_s).square
    a, b = current_A[..., :-1], current_A[..., 1:]
    return np.asarray(np.sqrt(np.sum(first * a * a + cross * a * b + last * b * b, axis=-1)))


@dataclass(frozen=True)
class WarmCoil:
    """What a winding below its limit may take.

    Attributes
    ----------
    rise_K : what an A^2 tick can add to the winding: resistance at the limit, no heat leaves.
    from_housing : part of its difference to a warmer housing that the winding rises by in a tick.
    play_limit_C : what a transient may bring the winding to.
    least_scale : a transient that the heat allows less of is withheld.
    """

    rise_K: float
    from_housing: float
    play_limit_C: float
    least_scale: float

    @classmethod
    def of(
        cls, coil: CoilModel, dt_s: float, withhold_K: float = WITHHOLD_K, least_scale: float = LEAST_SCALE
    ) -> "WarmCoil":
        """For a coil and a servo period; transients keep `withhold_K` away from its limit."""
        rise_K = (
            coil.R_ohm
            * (1 + COPPER_PER_K * (coil.limit_C - RESISTANCE_REFERENCE_C))
            * (coil.R_wh_K_W / coil.tau_w_s)
            * dt_s
        )
        return cls(rise_K, dt_s / coil.tau_w_s, coil.limit_C - withhold_K, least_scale)

    def rise(
        self, winding_C: float, housing_C: float, transient_A: float, feedback_A: float, ticks: int, scale: float
    ) -> float:
        """Bound on the winding's rise over a transient played at `scale` [K].

        Parameters
        ----------
        winding_C, housing_C : temperatures when it begins.
        transient_A, feedback_A : norms sqrt(sum i^2) over the servo periods of the transient's current and of the
            feedback's beside it, or bounds on them [A]. ticks : servo periods it takes.
        """
        norm = scale * transient_A + feedback_A + PWM_RIPPLE_A * math.sqrt(ticks)
        warmer = housing_C - winding_C
        return self.rise_K * norm * norm + (ticks * self.from_housing * warmer if warmer > 0.0 else 0.0)

    def allowed(
        self, winding_C: float, housing_C: float, transient_A: float, cool_A: float, feedback_A: float, ticks: int
    ) -> tuple[float, float]:
        """Scale, and part of the cool command in what is scaled, that keep the winding within `play_limit_C`.

        A coil that cannot take the first transient gets a blend of both whose norms add up to what it can take: the
        blend's own norm is no larger, and a convex combination of admissible commands is admissible. What cannot
        take even the cool one gets it scaled; a scale below the least one is 0. Without a cool command of less
        heat the first is scaled. This is the adaptive limit that the seed leaves as future work.

        Parameters
        ----------
        cool_A : norm of the cool command, infinite without one; the others as in `rise`.
        """
        left = self.play_limit_C - winding_C
        if self.rise(winding_C, housing_C, transient_A, feedback_A, ticks, 1.0) <= left:
            return 1.0, 0.0
        without = self.rise(winding_C, housing_C, 0.0, feedback_A, ticks, 0.0)
        if not (without < left and transient_A > 0.0):
            return 0.0, 0.0
        # rise = a (n + m)^2 + h with a m^2 + h = `without`
        steady = feedback_A + PWM_RIPPLE_A * math.sqrt(ticks)
        norm_A = math.sqrt(steady * steady + (left - without) / self.rise_K) - steady
        cooler = cool_A < transient_A
        if cooler and norm_A >= cool_A:
            cooled = (transient_A - norm_A) / (transient_A - cool_A)
            return 1.0, cooled if cooled > 0.0 else 0.0
        scale = norm_A / (cool_A if cooler else transient_A)
        if not scale >= self.least_scale:
            return 0.0, 0.0
        return scale, 1.0 if cooler else 0.0
