"""Finds the speeds that a set of taps was meant to have: hand taps of one speed scatter by 5 % and more.

A division of the sorted speeds is clear-cut if every gap between groups is wide compared with the widest gap within
one. Equally many taps in each group are evidence for a division, as a plan of so many repeats makes them. Without a
clear-cut division the speeds are the fewest with which every tap is within the tolerance of its speed, and of those
divisions the one of least scatter.
"""

from collections.abc import Sequence

import numpy as np

from transopt.base.signals import FloatArray

LEAST_GAP = 0.1  # relative gap between two speeds; a hand with two taps of one speed makes a smaller one
ROUNDING = 1e-9  # of the mean of equal speeds, which is within a tolerance of 0
CLEAR_EQUAL, CLEAR = 2.0, 4.0  # gap between groups over the widest within one, for groups of equal size and others


def speed_groups(speeds_m_s: Sequence[float], tolerance: float) -> list[list[float]]:
    """The speeds, sorted and in groups; the mean of a group is a speed of the grid.

    Parameters
    ----------
    tolerance : largest relative distance of a grid speed from the speed of its taps, as `Recordings.speed_tolerance`.
    """
    speeds, tolerance = np.sort(np.asarray(speeds_m_s, dtype=float)), max(tolerance, ROUNDING)
    if speeds.size == 0:
        return []
    ends = _clear_cut(speeds, tolerance) or _fewest(speeds, tolerance)
    return [group.tolist() for group in np.split(speeds, ends)]


def _within(speeds: FloatArray, tolerance: float) -> bool:
    """Whether the mean of sorted speeds is within the tolerance of each."""
    mean = float(speeds.mean())
    return mean <= (1 + tolerance) * float(speeds[0]) and mean >= (1 - tolerance) * float(speeds[-1])


def _clear_cut(speeds: FloatArray, tolerance: float) -> list[int]:
    """Cuts of the finest clear-cut division of sorted speeds; empty if there is none."""
    gaps = np.diff(np.log(speeds))
    widest = np.argsort(-gaps, kind="stable")
    for cuts in range(int(np.count_nonzero(gaps >= np.log1p(LEAST_GAP))), 0, -1):
        ends = sorted((widest[:cuts] + 1).tolist())
        groups = np.split(speeds, ends)
        clear = CLEAR_EQUAL if len({group.size for group in groups}) == 1 else CLEAR
        inside = float(gaps[widest[cuts]]) if cuts < gaps.size else 0.0
        if gaps[widest[cuts - 1]] >= clear * inside and all(_within(group, tolerance) for group in groups):
            return ends
    return []


def _fewest(speeds: FloatArray, tolerance: float) -> list[int]:
    """Cuts of the division of sorted speeds into the fewest groups within the tolerance, that of least scatter."""
    logs = np.log(speeds)
    sums, squares = (np.concatenate([[0.0], np.cumsum(each)]) for each in (logs, logs**2))
    totals = np.concatenate([[0.0], np.cumsum(speeds)])
    costs, begins = np.zeros(speeds.size + 1), np.zeros(speeds.size + 1, dtype=int)
    for end in range(1, speeds.size + 1):
        first = np.arange(end)
        count, mean = end - first, (totals[end] - totals[first]) / (end - first)
        scatter = squares[end] - squares[first] - (sums[end] - sums[first]) ** 2 / count
        fits = (mean <= (1 + tolerance) * speeds[first]) & (mean >= (1 - tolerance) * speeds[end - 1])
        fits[-1] = True  # a speed alone, whatever rounding says of its mean
        cost = np.where(fits, costs[first] + 1 + scatter / (1 + squares[-1]), np.inf)  # scatter never costs a group
        begins[end] = int(np.argmin(cost))
        costs[end] = cost[begins[end]]
    ends, end = [], speeds.size
    while begins[end] > 0:
        end = int(begins[end])
        ends.append(end)
    return ends[::-1]
