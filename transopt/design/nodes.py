"""Nodes of a grid of speeds and grips, what lies between them, and the weights of linear interpolation there."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from transopt.design.context import Spot
from transopt.scene.scene import Scene

Point = tuple[float, float]  # speed [m/s], grip [N]
Interval = tuple[float, float]  # two neighbouring nodes, or one node twice


def bracket(nodes: Sequence[float], value: float) -> Interval:
    """The interval of the nodes that holds a value; a node stands for itself."""
    if value in nodes:
        return value, value
    j = int(np.searchsorted(nodes, value))
    return nodes[j - 1], nodes[j]


def intervals(nodes: Sequence[float]) -> list[Interval]:
    """Neighbouring nodes; a single one is its own interval."""
    return list(itertools.pairwise(nodes)) or [(nodes[0], nodes[0])]


def middle(interval: Interval) -> float:
    # Twelve digits: 0.1 and 0.2 have 0.15 between them, not 0.15000000000000002.
    return float(f"{sum(interval) / 2:.12g}")


def halved(nodes: Iterable[float]) -> list[float]:
    """Nodes and the midpoints between them."""
    ordered = sorted(set(nodes))
    return sorted({*ordered, *map(middle, itertools.pairwise(ordered))})


def shares(interval: Interval, value: float) -> list[tuple[float, float]]:
    """Nodes and their weights in linear interpolation."""
    low, high = interval
    if low == high:
        return [(low, 1.0)]
    w = (value - low) / (high - low)
    return [(low, 1 - w), (high, w)]


@dataclass(frozen=True)
class Nodes:
    speeds: tuple[float, ...]
    grips: tuple[float, ...]

    @property
    def entries(self) -> int:
        return len(self.speeds) * len(self.grips)

    def cell(self, point: Point) -> tuple[Interval, Interval]:
        return bracket(self.speeds, point[0]), bracket(self.grips, point[1])

    def midpoints(self) -> list[Point]:
        """Nodes and midpoints of each axis against those of the other."""
        return list(itertools.product(halved(self.speeds), halved(self.grips)))

    def quarters(self, excess: dict[Point, float], above: float) -> list[Point]:
        """Nodes, midpoints and quarter points of every cell that has an excess above a bound at a midpoint."""
        points: dict[Point, None] = {}
        for speeds, grips in itertools.product(intervals(self.speeds), intervals(self.grips)):
            halves = itertools.product(halved(speeds), halved(grips))
            if any(not excess[point] <= above for point in halves):
                points.update(dict.fromkeys(itertools.product(halved(halved(speeds)), halved(halved(grips)))))
        return list(points)

    def split(self, axis: int, interval: Interval) -> "Nodes":
        if axis == 0:
            return Nodes(tuple(sorted({*self.speeds, middle(interval)})), self.grips)
        return Nodes(self.speeds, tuple(sorted({*self.grips, middle(interval)})))


def spots(scene: Scene) -> dict[Spot, list[tuple[Spot, float]]]:
    """Places of an arm's scene and half-way between them -> the scene's own around, and their weights in a blend."""
    if not scene.axes.places:
        return {None: [(None, 1.0)]}
    nodes = [sorted(set(numbers)) for numbers in zip(*scene.axes.places, strict=True)]
    found: dict[Spot, list[tuple[Spot, float]]] = {}
    for spot in itertools.product(*map(halved, nodes)):
        by_normal, by_posture = (shares(bracket(own, at), at) for own, at in zip(nodes, spot, strict=True))
        corners = itertools.product(by_normal, by_posture)
        found[spot[0], spot[1]] = [((o, q), a * b) for (o, a), (q, b) in corners]
    return found
