"""The price on heat, which limits slow currents that no other term of the objective penalises."""

from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray


@dataclass(frozen=True)
class HeatPrice:
    """price sum_(k<N) i_k^2, with i_k the plant's input at the switching instants of the window.

    The term is convex. For every price the minimiser of J is also the optimum under the constraint that the heat is
    at most the minimiser's own.

    Attributes
    ----------
    price : >= 0 [1/A^2 or 1/V^2].
    """

    price: float

    def value(self, plant_input: FloatArray) -> float:
        """The term at inputs (N,), or the sum over the motors at (m, N)."""
        return self.price * float(np.vdot(plant_input, plant_input))

    def gradient(self, plant_input: FloatArray) -> FloatArray:
        """(..., N) of the term by the inputs (..., N)."""
        return 2 * self.price * plant_input
