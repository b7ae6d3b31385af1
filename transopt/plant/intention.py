"""The intended motion of the hand that holds the stylus, and the stylus' motion under it without current.

Nobody reacts to a tap within some 30 ms: the intended motion continues at the incoming speed for that time (seed
Eq. 2). A law of yielding describes what follows. All motions here are per m/s of incoming speed and relative to the
straight line -v t.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from transopt.base.matrices import expm
from transopt.base.recursions import LinearSystem
from transopt.base.signals import REACTION_S, FloatArray
from transopt.plant.state_space import StateSpace

INTENTION_S = REACTION_S  # time after contact during which the hand's intended motion does not change
BRAKING_S = 60e-3  # time in which a hand that brakes comes to rest, at constant deceleration
PULLING_S = (
    60e-3  # time in which a hand that pulls back reaches the incoming speed outwards, at constant acceleration
)
DECAY_S = 30e-3  # time constant of a hand whose speed decays
FOLLOWS_S = 2.5e-3  # time constant of the stylus behind the hand for a device that is no chain; fitted to chains

Yielding = Literal["brakes", "straight", "stops", "decays", "pulls"]
YIELDINGS: tuple[str, ...] = get_args(Yielding)


@dataclass(frozen=True)
class Phase:
    """A phase of the intended motion with u'' = rate - decay u', u the displacement from the straight line at 1 m/s.

    Attributes
    ----------
    start_s : beginning, after contact.
    jump : jump of u' at the beginning [1].
    rate_1_s, decay_1_s : coefficients of the law.
    """

    start_s: float
    jump: float = 0.0
    rate_1_s: float = 0.0
    decay_1_s: float = 0.0

    def after(self, u: float, rate: float, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """u, u' and u'' at times t (...) after the beginning, from u and u' = `rate` there, the jump included."""
        if self.decay_1_s == 0:
            return u + rate * t + self.rate_1_s * t**2 / 2, rate + self.rate_1_s * t, np.full(t.shape, self.rate_1_s)
        d, end = self.decay_1_s, self.rate_1_s / self.decay_1_s
        left = (rate - end) * np.exp(-d * t)
        return u + end * t + (rate - end - left) / d, end + left, -d * left


@dataclass(frozen=True)
class Intention:
    """The intended motion of the hand from contact on.

    Attributes
    ----------
    intention_s : time for which it continues at the incoming speed.
    yields : law of yielding after that. "brakes": constant deceleration to rest in 60 ms. "straight": no change.
        "stops": at rest at once. "decays": exponential to rest with 30 ms. "pulls": reversal within 60 ms.
    """

    intention_s: float = INTENTION_S
    yields: Yielding = "brakes"

    @property
    def phases(self) -> Sequence[Phase]:
        """Phases of the motion, the straight one first."""
        T, straight = self.intention_s, Phase(0.0)
        match self.yields:
            case "straight":
                return (straight,)
            case "stops":
                return (straight, Phase(T, jump=1.0))
            case "decays":
                return (straight, Phase(T, rate_1_s=1 / DECAY_S, decay_1_s=1 / DECAY_S))
            case "pulls":
                return (straight, Phase(T, rate_1_s=2 / PULLING_S), Phase(T + PULLING_S))
        return (straight, Phase(T, rate_1_s=1 / BRAKING_S), Phase(T + BRAKING_S))

    @cached_property
    def begun(self) -> list[tuple[float, float, Phase]]:
        """u and u' at the beginning of every phase, u' with its jump, and the phase."""
        found, u, rate = list[tuple[float, float, Phase]](), 0.0, 0.0
        for phase in self.phases:
            if found:
                u, rate, before = found[-1]
                way, slope, _ = before.after(u, rate, np.array(phase.start_s - before.start_s))
                u, rate = float(way), float(slope)
            found.append((u, rate + phase.jump, phase))
        return found

    def motion(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(K,) u, u' and u'' each at times after contact, zero before it; u'' is without the jumps of u'."""
        found = np.zeros((3, times_s.size))
        for u, rate, phase in self.begun:
            later = times_s >= phase.start_s
            found[:, later] = phase.after(u, rate, times_s[later] - phase.start_s)
        return found[0], found[1], found[2]


@dataclass(frozen=True)
class Path:
    """Intended position of the hand during one tap, contact at t = 0.

    Attributes
    ----------
    speed_m_s : incoming speed at contact.
    intention : intended motion from contact on.
    incoming_m_s2 : acceleration before contact, which continues until `intention.intention_s`.
    """

    speed_m_s: float
    intention: Intention = Intention()
    incoming_m_s2: float = 0.0

    def at(self, time_s: float) -> float:
        """Intended position along the surface normal [m], positive outwards."""
        v, a, T = self.speed_m_s, self.incoming_m_s2, self.intention.intention_s
        if time_s <= 0:
            return -v * time_s + a * time_s**2 / 2
        carried = min(time_s, T)
        z = -v * time_s + a * carried**2 / 2 + a * carried * (time_s - carried)
        if time_s <= T:
            return z
        u, rate, phase = next(each for each in reversed(self.intention.begun) if each[2].start_s <= time_s)
        way, _, _ = phase.after(u, rate, np.array(time_s - phase.start_s))
        return z + (v - a * T) * float(way)


class FreeMotion:
    """The acceleration a_free of the stylus in one hand without current, for 1 m/s of incoming speed.

    In the frame of the intended motion inertial forces accelerate every mass of a chain by -u''. Of its states x,
    elongations and then their rates, only the last, the rate of the link to the ground, feels them:
    dx/dt = A x - b u'' with b a unit vector, and the stylus accelerates with C x. A device that is no chain of known
    masses is assumed to follow the intended motion with a time constant of 2.5 ms.

    Parameters
    ----------
    intention : intended motion of the hand.
    chain : the device in the hand with states elongations, then their rates; its input is not used. None if the
        device is no chain.
    is_held : whether a hand holds the stylus; a free one continues at its speed.
    """

    def __init__(self, intention: Intention, chain: StateSpace | None, *, is_held: bool = True) -> None:
        self.intention, self._chain, self._is_held = intention, chain, is_held
        self._kept: tuple[FloatArray, FloatArray] | None = None

    @cached_property
    def _plant(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A, the input column of u'', and the row of the stylus' acceleration."""
        if self._chain is None:
            return np.array([[-1 / FOLLOWS_S]]), np.array([-1.0]), np.array([-1 / FOLLOWS_S])
        return self._chain.A, -np.eye(self._chain.order)[-1], self._chain.C[0]

    def yielding_m_s2(self, times_s: FloatArray) -> FloatArray:
        """(K,) acceleration due to the hand's yielding at evenly spaced times, for 1 m/s."""
        if not self._is_held or len(self.intention.phases) == 1:
            return np.zeros(times_s.size)
        if self._kept is None or not np.array_equal(self._kept[0], times_s):
            self._kept = times_s, self._yielding(times_s)
        return self._kept[1]

    def _yielding(self, times_s: FloatArray) -> FloatArray:
        A, b, row = self._plant
        n, step = A.shape[0], times_s[1] - times_s[0]
        flow = np.zeros((n + 1, n + 1))
        flow[:n, :n], flow[:n, n] = A, b
        exponential = expm(flow * step)
        # u'' is held at its mean over each step; a jump of u' becomes an impulse spread over one step.
        _, rate, _ = self.intention.motion(np.append(times_s, times_s[-1] + step))
        mean = np.diff(rate) / step
        system = LinearSystem(exponential[:n, :n], exponential[:n, n:], row[None], np.zeros((1, 1)))
        return np.asarray(system.outputs(mean[None])[0])

    def _carried(self, times_s: FloatArray) -> FloatArray:
        """(K,) acceleration of the stylus if the hand accelerates with 1 m/s^2 until its intention ends.

        Until then the masses lag behind the hand by their inertia, x = A^-1 b; afterwards dx/dt = A x. Without a
        spring in the hand there is no such static lag (A is singular); the stylus then follows as for no chain.
        """
        A, b, row = self._plant
        left = times_s - self.intention.intention_s
        first, step = int(np.searchsorted(left, 0.0, side="right")), times_s[1] - times_s[0]
        found = np.ones(times_s.size)
        if first == times_s.size:
            return found
        if np.linalg.matrix_rank(A) < A.shape[0]:
            found[first:] = np.exp(-left[first:] / FOLLOWS_S)
            return found
        start = expm(A * left[first]) @ np.linalg.solve(A, -b)
        alone = LinearSystem(expm(A * step), start[:, None], row[None], np.zeros((1, 1)))
        begins = np.zeros((1, times_s.size - first + 1))
        begins[0, 0] = 1.0
        found[first:] = alone.outputs(begins)[0, 1:]
        return found

    def acceleration_m_s2(self, speed_m_s: float, incoming_m_s2: float, times_s: FloatArray) -> FloatArray:
        """(K,) a_free at evenly spaced times, contact at t = 0.

        Parameters
        ----------
        incoming_m_s2 : acceleration a0 of hand and stylus before contact. It continues until the intention ends and
            then decays with the chain's dynamics.
        """
        if not self._is_held:
            return np.zeros(times_s.size)
        found = (speed_m_s - incoming_m_s2 * self.intention.intention_s) * self.yielding_m_s2(times_s)
        return np.asarray(found if incoming_m_s2 == 0 else found + incoming_m_s2 * self._carried(times_s))
