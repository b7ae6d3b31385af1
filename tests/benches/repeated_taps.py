"""A simulated user of endless taps at random, for long runs."""

from bisect import bisect_right

import numpy as np

from controller.sim.user import Cycle, Tremor, User, start_height_m


class RepeatedTaps(User):
    """Endless taps at random speeds and grips, for long runs.

    Speeds are log-uniform, grips uniform; the grip changes during the retreat.

    Parameters
    ----------
    seed : the same seed gives the same taps.
    """

    def __init__(
        self,
        seed: int,
        *,
        speeds_m_s: tuple[float, float] = (0.05, 1.0),
        grips_N: tuple[float, float] = (0.0, 10.0),
        tremor: Tremor | None = None,
    ) -> None:
        self._random = np.random.default_rng([seed, 4])
        self._speeds_m_s, self._grips_N, self.tremor = speeds_m_s, grips_N, tremor
        self._next = self._draw()
        self._cycles: list[Cycle] = []
        self._starts: list[float] = []
        self._append(0.0)
        self._now = self._cycles[0]

    def _draw(self) -> tuple[float, float]:
        low, high = np.log(self._speeds_m_s)
        return float(np.exp(self._random.uniform(low, high))), float(self._random.uniform(*self._grips_N))

    def _append(self, start_s: float) -> None:
        (speed, grip), self._next = self._next, self._draw()
        cycle = Cycle(start_s, speed, grip, start_height_m(speed), start_height_m(self._next[0]), self._next[1])
        self._cycles.append(cycle)
        self._starts.append(start_s)

    def cycle(self, time_s: float) -> Cycle:
        """The present tap."""
        if not self._now.start_s <= time_s < self._now.end_s:
            while time_s >= self._cycles[-1].end_s:
                self._append(self._cycles[-1].end_s)
            self._now = self._cycles[max(bisect_right(self._starts, time_s) - 1, 0)]
        return self._now

    def intention_m(self, time_s: float) -> float:
        z = self.cycle(time_s).intention_m(time_s)
        return z if self.tremor is None else z + self.tremor.at(time_s)

    def grip_N(self, time_s: float) -> float:
        return self.cycle(time_s).held_N(time_s)
