"""Nodes of a grid of speeds and grips, the points between them, and their weights of linear interpolation."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from transopt.design.context import Spot
from transopt.scene.scene import Scene

Point = tuple[float, float]  # speed [m/s], grip [N]
Interval = tuple[float, float]  # two neighbouring nodes, or a single node repeated


def bracket(nodes: Sequence[float], value: float) -> Interval:
    """The interval of neighbouring nodes that contains a value; (node, node) for a value that is a node."""
    if value in nodes:
        return value, value
    j = int(np.searchsorted(nodes, value))
    return nodes[j - 1], nodes[j]


def intervals(nodes: Sequence[float]) -> list[Interval]:
    """All intervals of neighbouring nodes; (node, node) if there is only one node."""
    return list(itertools.pairwise(nodes)) or [(nodes[0], nodes[0])]


def middle(interval: Interval) -> float:
    # Twelve digits, so that the middle of 0.1 and 0.2 is 0.15 and not 0.15000000000000002.
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
        """The product of both axes' nodes and midpoints."""
        return list(itertools.product(halved(self.speeds), halved(self.grips)))

    def quarters(self, excess: dict[Point, float], above: float) -> list[Point]:
        """Nodes, midpoints and quarter points of every cell whose excess is above a bound at a node or midpoint."""
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
    """Places of an arm's scene, and those half-way between -> surrounding places of the scene with blend weights."""
    if not scene.axes.places:
        return {None: [(None, 1.0)]}
    nodes = [sorted(set(numbers)) for numbers in zip(*scene.axes.places, strict=True)]
    found: dict[Spot, list[tuple[Spot, float]]] = {}
    for spot in itertools.product(*map(halved, nodes)):
        by_normal, by_posture = (shares(bracket(own, at), at) for own, at in zip(nodes, spot, strict=True))
        corners = itertools.product(by_normal, by_posture)
        found[spot[0], spot[1]] = [((o, q), a * b) for (o, a), (q, b) in corners]
    return found
