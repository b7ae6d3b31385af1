"""The blend of a bank at a contact, by a fixed order of products and sums, which the core repeats bit by bit."""

import math
from dataclasses import dataclass, field

from controller.waveforms.bank import Bank
from transopt.base.signals import FloatArray


@dataclass(frozen=True, slots=True)
class Play:
    """The transient of one contact.

    Attributes
    ----------
    samples_A : transient commands, one per servo period; empty if this method has none.
    speed_m_s, grip_N : point of the grid it was taken from, after clipping to the grid.
    out_of_grid : whether the requested point lay outside the grid.
    silent : whether nothing may be played, for lack of speed or grip.
    transient_A, feedback_A : bounds on the norms of the currents, as `Guard.allowed` takes them.
    cool_samples_A : the cool command, of less heat, as long as the first; empty where the table has none.
    cool_transient_A : bound on the norm of its current; infinite where the table has none.
    """

    samples_A: list[float]
    speed_m_s: float
    grip_N: float
    out_of_grid: bool
    silent: bool
    transient_A: float
    feedback_A: float
    cool_samples_A: list[float] = field(default_factory=list)
    cool_transient_A: float = math.inf

    def blended(self, cooled: float) -> list[float]:
        """The samples with a part `cooled` (0 to 1) of the cool command and the rest of the first [A]."""
        if not cooled > 0.0:
            return self.samples_A
        first = 1.0 - cooled
        return [first * warm + cooled * cool for warm, cool in zip(self.samples_A, self.cool_samples_A, strict=True)]


def _interval(nodes: list[float], value: float, nearest: bool) -> tuple[int, float, bool]:
    """Interval of increasing nodes that `value` lies in, its place there (0..1), and whether it lay outside."""
    j = 0
    while j + 2 < len(nodes) and value >= nodes[j + 1]:
        j += 1
    if len(nodes) == 1:
        return 0, 0.0, value != nodes[0]
    place = (value - nodes[j]) / (nodes[j + 1] - nodes[j])
    clamped = 0.0 if place < 0.0 else min(place, 1.0)
    if nearest:
        return j, 0.0 if clamped < 0.5 else 1.0, clamped != place
    return j, clamped, clamped != place


def blend_at(bank: Bank, speed_m_s: float, grip_N: float) -> Play:
    """The transient for a contact; outside the grid its edge is taken, and NaN plays nothing."""
    if not (speed_m_s > 0.0 and grip_N >= bank.grip_min_N):
        return Play([], speed_m_s, grip_N, False, True, 0.0, 0.0)
    iv, y, fast = _interval(bank.speeds_m_s, speed_m_s, bank.nearest)
    ig, x, odd = _interval(bank.grips_N, grip_N, bank.nearest)
    jv, jg = min(iv + 1, len(bank.speeds_m_s) - 1), min(ig + 1, len(bank.grips_N) - 1)
    w = ((1.0 - y) * (1.0 - x), (1.0 - y) * x, y * (1.0 - x), y * x)

    def norm(of: list[list[float]]) -> float:
        return w[0] * of[iv][ig] + w[1] * of[iv][jg] + w[2] * of[jv][ig] + w[3] * of[jv][jg]

    def samples(c: FloatArray) -> list[float]:
        mixed = w[0] * c[iv, ig] + w[1] * c[iv, jg] + w[2] * c[jv, ig] + w[3] * c[jv, jg]
        return list(mixed.tolist())

    cool = bank.cool_command_A
    return Play(
        samples_A=samples(bank.command_A),
        speed_m_s=(1.0 - y) * bank.speeds_m_s[iv] + y * bank.speeds_m_s[jv],
        grip_N=(1.0 - x) * bank.grips_N[ig] + x * bank.grips_N[jg],
        out_of_grid=fast or (odd and bank.by_grip),
        silent=False,
        transient_A=norm(bank.transient_A),
        feedback_A=norm(bank.feedback_A),
        cool_samples_A=[] if cool is None else samples(cool),
        cool_transient_A=math.inf if cool is None else norm(bank.cool_transient_A),
    )
