"""The user: where the hand means to be, and how firmly it holds.

Nobody reacts to a tap within 30 ms, so until then the intention of every user goes on at the incoming speed, as in
the seed; what comes after is a law of its own.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Protocol

import numpy as np

from controller.waveforms.prediction import REACTION_S
from transopt.base.signals import FloatArray

BRAKING_S = 60e-3  # in which a yielding hand comes to rest, evenly
RETREAT_S = 200e-3
REST_S = 30e-3  # above the surface between two taps
HOLD_S = 50e-3  # below it
STARTING_S = 30e-3  # in which the hand reaches the approach's speed, evenly
STRAIGHT_S, STRAIGHT_M = 40e-3, 3e-3  # straight approach: at least so long and so far together


class Habit(Enum):
    """What the hand does after the contact; the value is its name on the command line."""

    MILD = "mild"  # the intention goes on at the incoming speed: the design's assumption
    YIELDING = "yielding"  # from 30 ms on it brakes evenly and rests after another 60 ms
    STOPPING = "stopping"  # at 30 ms it stops dead
    RECORDED = "recorded"  # it moves as the hands in the recordings did: z_nom, the nominal path


class User(Protocol):
    """Functions of the simulator's time; most users give the device no acceleration of their own accord."""

    def intention_m(self, time_s: float) -> float:
        """Position that the hand means to have along the surface normal."""
        ...

    def carried_m_s2(self, time_s: float) -> float:
        """Acceleration that the hand gives to all it moves, of its own accord: r_u = r_raw - r."""
        return 0.0

    def grip_N(self, time_s: float) -> float: ...


@dataclass(frozen=True)
class Tremor:
    """Physiological tremor on the intention: 8-12 Hz, some 0.1 mm."""

    amplitude_m: float = 1e-4
    frequency_Hz: float = 10.0
    phase_rad: float = 0.0

    def at(self, time_s: float) -> float:
        return self.amplitude_m * math.sin(2 * math.pi * self.frequency_Hz * time_s + self.phase_rad)


def _after_reaction(habit: Habit, speed_m_s: float, after_s: float) -> float:
    """How far the intention has come since `REACTION_S` after contact [m], positive inwards."""
    if habit is Habit.STOPPING:
        return 0.0
    if habit is Habit.YIELDING:
        braked = min(after_s, BRAKING_S)
        return speed_m_s * (braked - braked**2 / (2 * BRAKING_S))
    return speed_m_s * after_s


@dataclass(frozen=True)
class TapUser(User):
    """One tap: straight in at `speed_m_s`, the intention reaches the surface at `contact_s`.

    Attributes
    ----------
    grip_rate_N_s : ramp of the grip from contact on.
    """

    speed_m_s: float
    held_N: float
    contact_s: float
    habit: Habit = Habit.MILD
    tremor: Tremor | None = None
    grip_rate_N_s: float = 0.0

    def intention_m(self, time_s: float) -> float:
        t = time_s - self.contact_s
        if t <= REACTION_S:
            z = -self.speed_m_s * t
        else:
            z = -self.speed_m_s * REACTION_S - _after_reaction(self.habit, self.speed_m_s, t - REACTION_S)
        return z if self.tremor is None else z + self.tremor.at(time_s)

    def grip_N(self, time_s: float) -> float:
        return max(self.held_N + self.grip_rate_N_s * max(time_s - self.contact_s, 0.0), 0.0)


class RecordedUser(User):
    """One tap by a hand that moves as in the recordings: along z_nom, giving all it moves the acceleration r_u.

    After the library's window it goes on straight.

    Parameters
    ----------
    times_s, carried_m_s2 : (N,) r_u at times from contact on.
    """

    STEP_S = 2.5e-5

    def __init__(
        self, speed_m_s: float, held_N: float, contact_s: float, times_s: FloatArray, carried_m_s2: FloatArray
    ) -> None:
        self._speed_m_s, self._held_N, self._contact_s = speed_m_s, held_N, contact_s
        times = np.arange(0.0, times_s[-1] + 2 * self.STEP_S, self.STEP_S)
        carried = np.interp(times, times_s, carried_m_s2)
        # Integrated here, so that position and acceleration agree on this grid exactly.
        velocity = -speed_m_s + np.append(0.0, np.cumsum((carried[1:] + carried[:-1]) / 2 * self.STEP_S))
        steps = velocity[:-1] * self.STEP_S + (2 * carried[:-1] + carried[1:]) / 6 * self.STEP_S**2
        self._position: list[float] = np.append(0.0, np.cumsum(steps)).tolist()
        self._carried: list[float] = carried.tolist()
        self._last_m_s = float(velocity[-1])

    def _at(self, time_s: float) -> tuple[int, float]:
        place = (time_s - self._contact_s) / self.STEP_S
        j = min(int(place), len(self._position) - 2)
        return j, place - j

    def intention_m(self, time_s: float) -> float:
        t = time_s - self._contact_s
        if t <= 0:
            return -self._speed_m_s * t
        j, part = self._at(time_s)
        if part > 1:
            return self._position[-1] + (part - 1) * self.STEP_S * self._last_m_s
        return (1 - part) * self._position[j] + part * self._position[j + 1]

    def carried_m_s2(self, time_s: float) -> float:
        if time_s <= self._contact_s:
            return 0.0
        j, part = self._at(time_s)
        return 0.0 if part > 1 else (1 - part) * self._carried[j] + part * self._carried[j + 1]

    def grip_N(self, time_s: float) -> float:
        return self._held_N


def _minimum_jerk(part: float) -> float:
    """From 0 to 1 as hands move (Flash and Hogan 1985)."""
    return part**3 * (10 - 15 * part + 6 * part**2)


@dataclass(frozen=True)
class _Cycle:
    """One of many taps: rest, start, straight in, yield, hold, retreat to where the next one begins."""

    start_s: float
    speed_m_s: float
    grip_N: float
    height_m: float
    next_height_m: float
    next_grip_N: float

    @cached_property
    def straight_s(self) -> float:
        return STRAIGHT_S + STRAIGHT_M / self.speed_m_s

    @cached_property
    def contact_s(self) -> float:
        return self.start_s + REST_S + STARTING_S + self.straight_s

    @cached_property
    def retreat_s(self) -> float:
        return self.contact_s + REACTION_S + BRAKING_S + HOLD_S

    @cached_property
    def end_s(self) -> float:
        return self.retreat_s + RETREAT_S

    def intention_m(self, time_s: float) -> float:
        v = self.speed_m_s
        if time_s < self.contact_s:
            moving = time_s - self.start_s - REST_S
            if moving <= 0:
                return self.height_m
            started = min(moving, STARTING_S)
            return self.height_m - v * (started**2 / (2 * STARTING_S) + moving - started)
        t = time_s - self.contact_s
        if t <= REACTION_S:
            return -v * t
        z = -v * REACTION_S - _after_reaction(Habit.YIELDING, v, t - REACTION_S)
        back = max(time_s - self.retreat_s, 0.0) / RETREAT_S
        return z + (self.next_height_m - z) * _minimum_jerk(min(back, 1.0))

    def held_N(self, time_s: float) -> float:
        back = max(time_s - self.retreat_s, 0.0) / RETREAT_S
        return self.grip_N + (self.next_grip_N - self.grip_N) * _minimum_jerk(min(back, 1.0))


def _height_m(speed_m_s: float) -> float:
    """Above the surface from where an approach starts."""
    return speed_m_s * (STARTING_S / 2 + STRAIGHT_S) + STRAIGHT_M


class _Taps(User):
    """A hand that taps in cycles, yielding to each tap and retreating."""

    tremor: Tremor | None = None

    def _at(self, time_s: float) -> tuple[_Cycle, float]:
        """The tap that is on, and the time by which its cycle goes."""
        raise NotImplementedError

    def intention_m(self, time_s: float) -> float:
        cycle, into_s = self._at(time_s)
        z = cycle.intention_m(into_s)
        return z if self.tremor is None else z + self.tremor.at(time_s)

    def grip_N(self, time_s: float) -> float:
        cycle, into_s = self._at(time_s)
        return cycle.held_N(into_s)


class RepeatedTaps(_Taps):
    """Taps without end at random speeds and grips; for long runs.

    Speeds are drawn evenly in their logarithm, grips evenly; the grip changes during the retreat.

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
        self._cycles: list[_Cycle] = []
        self._starts: list[float] = []
        self._append(0.0)
        self._now = self._cycles[0]

    def _draw(self) -> tuple[float, float]:
        low, high = np.log(self._speeds_m_s)
        return float(np.exp(self._random.uniform(low, high))), float(self._random.uniform(*self._grips_N))

    def _append(self, start_s: float) -> None:
        (speed, grip), self._next = self._next, self._draw()
        cycle = _Cycle(start_s, speed, grip, _height_m(speed), _height_m(self._next[0]), self._next[1])
        self._cycles.append(cycle)
        self._starts.append(start_s)

    def cycle(self, time_s: float) -> _Cycle:
        """The tap that is on."""
        if not self._now.start_s <= time_s < self._now.end_s:
            while time_s >= self._cycles[-1].end_s:
                self._append(self._cycles[-1].end_s)
            self._now = self._cycles[max(bisect_right(self._starts, time_s) - 1, 0)]
        return self._now

    def _at(self, time_s: float) -> tuple[_Cycle, float]:
        return self.cycle(time_s), time_s


class TapsInTurn(_Taps):
    """The given taps one after the other, over and over.

    Parameters
    ----------
    taps : (speed [m/s], grip [N]) of each; the grip changes during the retreat.
    period_s : of a whole round; the hand rests at its start height for what is left. Without it, of the taps alone.

    Raises
    ------
    ValueError : no taps, or a period too short for them.
    """

    def __init__(self, taps: list[tuple[float, float]], period_s: float | None = None) -> None:
        if not taps:
            raise ValueError("taps: give at least one")
        self._cycles: list[_Cycle] = []
        start = 0.0
        for (speed, grip), (next_speed, next_grip) in zip(taps, [*taps[1:], taps[0]], strict=True):
            self._cycles.append(_Cycle(start, speed, grip, _height_m(speed), _height_m(next_speed), next_grip))
            start = self._cycles[-1].end_s
        self.period_s = start if period_s is None else period_s
        if self.period_s < start:
            raise ValueError(f"period_s = {self.period_s:g}: these taps take {start:g} s")
        self._starts = [cycle.start_s for cycle in self._cycles]

    def _at(self, time_s: float) -> tuple[_Cycle, float]:
        into_s = time_s % self.period_s
        return self._cycles[bisect_right(self._starts, into_s) - 1], into_s


@dataclass(frozen=True)
class StillHand(User):
    """Holds the stylus above the surface and does nothing."""

    held_N: float = 3.0
    height_m: float = 5e-3
    period_s: float = 0.1  # of its motion, which any is

    def intention_m(self, time_s: float) -> float:
        return self.height_m

    def grip_N(self, time_s: float) -> float:
        return self.held_N
