"""Simulated users: the hand's intended position and its grip over time.

The intention from contact on is defined in `transopt.plant.intention`, for recordings and simulated users alike.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from transopt.plant.intention import BRAKING_S, INTENTION_S, Intention, Path

RETREAT_S = 200e-3
REST_S = 30e-3  # rest above the surface between two taps
HOLD_S = 50e-3  # hold below the surface
STARTING_S = 30e-3  # duration of the uniform acceleration to the approach's speed
STRAIGHT_S, STRAIGHT_M = 40e-3, 3e-3  # straight approach: a duration plus a length
STRAIGHT = Intention(yields="straight")


class User(Protocol):
    """A user: intention and grip as functions of the simulator's time."""

    def intention_m(self, time_s: float) -> float:
        """Intended position of the hand along the surface normal."""
        ...

    def grip_N(self, time_s: float) -> float: ...


@dataclass(frozen=True)
class Tremor:
    """Physiological tremor on the intention: 8-12 Hz, some 0.1 mm."""

    amplitude_m: float = 1e-4
    frequency_Hz: float = 10.0
    phase_rad: float = 0.0

    def at(self, time_s: float) -> float:
        return self.amplitude_m * math.sin(2 * math.pi * self.frequency_Hz * time_s + self.phase_rad)


@dataclass(frozen=True)
class TapUser(User):
    """One tap: straight in at `speed_m_s`, the intention reaches the surface at `contact_s`.

    Attributes
    ----------
    intention : intention of the hand from contact on.
    incoming_m_s2 : acceleration during the approach.
    grip_rate_N_s : ramp of the grip from contact on.
    """

    speed_m_s: float
    held_N: float
    contact_s: float
    intention: Intention = STRAIGHT
    tremor: Tremor | None = None
    grip_rate_N_s: float = 0.0
    incoming_m_s2: float = 0.0

    @cached_property
    def _path(self) -> Path:
        return Path(self.speed_m_s, self.intention, self.incoming_m_s2)

    def intention_m(self, time_s: float) -> float:
        z = self._path.at(time_s - self.contact_s)
        return z if self.tremor is None else z + self.tremor.at(time_s)

    def grip_N(self, time_s: float) -> float:
        return max(self.held_N + self.grip_rate_N_s * max(time_s - self.contact_s, 0.0), 0.0)


def _minimum_jerk(part: float) -> float:
    """Minimum-jerk profile from 0 to 1 (Flash and Hogan 1985)."""
    return part**3 * (10 - 15 * part + 6 * part**2)


@dataclass(frozen=True)
class Cycle:
    """One of many taps: rest, start, straight approach, yield, hold, retreat to where the next tap begins."""

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
    def _path(self) -> Path:
        return Path(self.speed_m_s)

    @cached_property
    def retreat_s(self) -> float:
        return self.contact_s + INTENTION_S + BRAKING_S + HOLD_S

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
        z = self._path.at(time_s - self.contact_s)
        back = max(time_s - self.retreat_s, 0.0) / RETREAT_S
        return z + (self.next_height_m - z) * _minimum_jerk(min(back, 1.0))

    def held_N(self, time_s: float) -> float:
        back = max(time_s - self.retreat_s, 0.0) / RETREAT_S
        return self.grip_N + (self.next_grip_N - self.grip_N) * _minimum_jerk(min(back, 1.0))


def start_height_m(speed_m_s: float) -> float:
    """Height above the surface at which an approach starts."""
    return speed_m_s * (STARTING_S / 2 + STRAIGHT_S) + STRAIGHT_M


class TapsInTurn(User):
    """A hand that makes the given taps one after the other, endlessly, yielding to each and retreating.

    Parameters
    ----------
    taps : (speed [m/s], grip [N]) of each tap; the grip changes during the retreat.
    period_s : period of a whole round; the hand rests at its start height for the remainder. None for no remainder.

    Raises
    ------
    ValueError : no taps, or a period too short for them.
    """

    def __init__(self, taps: list[tuple[float, float]], period_s: float | None = None) -> None:
        if not taps:
            raise ValueError("taps: give at least one")
        self._cycles: list[Cycle] = []
        start = 0.0
        for (speed, grip), (next_speed, next_grip) in zip(taps, [*taps[1:], taps[0]], strict=True):
            self._cycles.append(
                Cycle(start, speed, grip, start_height_m(speed), start_height_m(next_speed), next_grip)
            )
            start = self._cycles[-1].end_s
        self.period_s = start if period_s is None else period_s
        if self.period_s < start:
            raise ValueError(f"period_s = {self.period_s:g}: these taps take {start:g} s")
        self._starts = [cycle.start_s for cycle in self._cycles]

    def _at(self, time_s: float) -> tuple[Cycle, float]:
        """The present tap, and the time on its cycle's time axis."""
        into_s = time_s % self.period_s
        return self._cycles[bisect_right(self._starts, into_s) - 1], into_s

    def intention_m(self, time_s: float) -> float:
        cycle, into_s = self._at(time_s)
        return cycle.intention_m(into_s)

    def grip_N(self, time_s: float) -> float:
        cycle, into_s = self._at(time_s)
        return cycle.held_N(into_s)


@dataclass(frozen=True)
class StillHand(User):
    """A hand that holds the stylus still above the surface."""

    held_N: float = 3.0
    height_m: float = 5e-3
    period_s: float = 0.1  # any value is a period of a motion at rest

    def intention_m(self, time_s: float) -> float:
        return self.height_m

    def grip_N(self, time_s: float) -> float:
        return self.held_N
