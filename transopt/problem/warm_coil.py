"""How much of a transient a warm coil allows: norms of currents, a bound on the rise, and the blend to play.

The servo decides with it at every contact, and the page shows the decision. The order of all operations is fixed, so
that the firmware, which repeats them, gets the same bits.
"""

import math
from dataclasses import dataclass

import numpy as np

from transopt.base.recursions import LinearSystem
from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import COPPER_PER_K, PWM_RIPPLE_A, RESISTANCE_REFERENCE_C, CoilModel
from transopt.problem.heat import heating

# Transients keep this far below the coil's limit. A tap heats by 0.2 K at most, but a minute against a wall by more.
WITHHOLD_K = 5.0
LEAST_SCALE = 0.25  # no transient plays at a smaller scale: a quarter of a tap feels like another material


def currents(command_A: FloatArray, amplifier: Amplifier | None, dt_s: float) -> FloatArray:
    """(..., N + 1) current from rest under commands (..., N), at tau_0 to tau_N."""
    if amplifier is None:
        return np.concatenate([command_A, np.zeros((*command_A.shape[:-1], 1))], axis=-1)
    decay = np.exp(-amplifier.rate_rad_s * dt_s).reshape(1, 1)
    after = LinearSystem(decay, 1 - decay, decay, 1 - decay).outputs(command_A[..., None, :])[..., 0, :]
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
    """The heat that a winding below its limit can still take.

    Attributes
    ----------
    rise_K : bound on the winding's rise per A^2 and tick: resistance at the limit temperature, no heat leaves.
    from_housing : rise per tick and per kelvin by which the housing is warmer than the winding.
    play_limit_C : temperature that the winding may reach during a transient.
    least_scale : a transient that would have to play at a smaller scale is withheld.
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
        winding_C, housing_C : temperatures at the transient's first tick.
        transient_A, feedback_A : norms sqrt(sum i^2) over the servo periods, or bounds on them, of the transient's
            current and of the wall's feedback that is added to it [A].
        ticks : servo periods of the transient.
        """
        norm = scale * transient_A + feedback_A + PWM_RIPPLE_A * math.sqrt(ticks)
        warmer = housing_C - winding_C
        return self.rise_K * norm * norm + (ticks * self.from_housing * warmer if warmer > 0.0 else 0.0)

    def allowed(
        self, winding_C: float, housing_C: float, transient_A: float, cool_A: float, feedback_A: float, ticks: int
    ) -> tuple[float, float]:
        """Scale of the played command, and the share of the cool command in it, within `play_limit_C`.

        If the coil can take the transient, it plays as it is. Otherwise it is blended with the cool command, a second
        optimum of less heat, such that the weighted sum of both norms is what the coil can take: the norm of the
        blend is no larger, and a convex combination of admissible commands is admissible. If the coil cannot take
        even the cool command, that is scaled down; without a cool command the transient itself is. A scale below
        `least_scale` becomes 0. This is the adaptive limit that the seed leaves as future work.

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
