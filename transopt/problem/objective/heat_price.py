"""The price on heat: what holds the slow current back where nothing else does."""

from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray


@dataclass(frozen=True)
class HeatPrice:
    """price sum_(k<N) i_k^2, i_k what drives the plant at the switching instants of the window.

    At any price J is convex, and its minimiser is the best tap with no more heat than it makes itself.

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
