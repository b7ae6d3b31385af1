"""Location of a measured tap on the grid of a library, and the waveform for it."""

from bisect import bisect_left
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief_without, cut
from transopt.base.signals import FloatArray


@dataclass(frozen=True)
class Place:
    """Location of a measured tap on the grid of speeds and grips.

    Attributes
    ----------
    speed_m_s, grip_N : after clamping to the grid.
    speed_clamped, grip_clamped : whether the measured value lay outside the grid.
    silent : no transient is played, because grip or speed is too small.
    normal, posture : for an arm, places along its lists, counted from 1, after clamping. place_clamped : whether
        clamped.
    """

    speed_m_s: float
    grip_N: float
    speed_clamped: bool
    grip_clamped: bool
    silent: bool
    normal: float = 1.0
    posture: float = 1.0
    place_clamped: bool = False

    @property
    def at(self) -> tuple[float, float]:
        """Places along the lists of normals and of postures."""
        return self.normal, self.posture


@dataclass(frozen=True)
class Waveform(Place):
    """A command for a place: zero if the place is silent, else a blend of the nodes or a solved command.

    Attributes
    ----------
    command : (N,), or (m, N) with m motors, total command c_k, issued at -lead + k dt and held [A].
    transient_command : (N,) what a device with the library's wall adds to its feedback [A].
    """

    command: FloatArray = field(kw_only=True)
    transient_command: FloatArray = field(kw_only=True)

    def __repr__(self) -> str:
        """All fields; without those of an arm's places where it is the first, the only one of other devices."""
        elsewhere = self.at != (1.0, 1.0) or self.place_clamped
        return brief_without(() if elsewhere else ("normal", "posture", "place_clamped"), self)


def finite(what: str, value: Any, unit: str) -> float:
    """A number from a caller who may be wrong about it.

    Raises
    ------
    InputError : not one finite number.
    """
    number = value.item() if isinstance(value, np.generic | np.ndarray) and np.size(value) == 1 else value
    if isinstance(number, bool) or not isinstance(number, int | float) or not abs(number) < float("inf"):
        raise InputError(f"{what} {cut(repr(value))} {unit}: must be a finite number")
    return float(number)


def around(nodes: FloatArray, value: float) -> tuple[slice, tuple[float, ...]]:
    """The one or two nodes around `value`, which lies within their range, and their weights in an interpolation."""
    after = bisect_left(nodes, value)
    if value == nodes[after]:
        return slice(after, after + 1), (1.0,)
    share = float((value - nodes[after - 1]) / (nodes[after] - nodes[after - 1]))
    return slice(after - 1, after + 1), (1 - share, share)


@dataclass(frozen=True)
class Between:
    """The nodes of a grid around a place, up to two speeds and two grips.

    Attributes
    ----------
    at : indices of these speeds and grips.
    weights : (speeds, grips) of these nodes in a bilinear interpolation.
    """

    at: tuple[slice, slice]
    weights: FloatArray

    @classmethod
    def of_place(cls, speeds_m_s: FloatArray, grips_N: FloatArray, place: Place) -> "Between":
        (speeds, by_speed), (grips, by_grip) = around(speeds_m_s, place.speed_m_s), around(grips_N, place.grip_N)
        return cls((speeds, grips), np.array([[v * g for g in by_grip] for v in by_speed]))

    def of(self, nodes: FloatArray) -> FloatArray:
        """(...) bilinear interpolation of a number or a course (v, g, ...) of the nodes."""
        return np.asarray(np.einsum("vg,vg...->...", self.weights, nodes[self.at]))


def interpolation_weights(nodes: FloatArray, value: float) -> FloatArray:
    """(n,) weights of linear interpolation at `value`, which lies within the nodes' range."""
    (between, own), weights = around(nodes, value), np.zeros(nodes.size)
    weights[between] = own
    return weights


def speed_weights(nodes_m_s: FloatArray, speed_m_s: float) -> FloatArray:
    """(nv,) weights that blend the references of the nodes into that of a speed on the grid (`reference.between`).

    r = v ((1 - w) r_1 / v_1 + w r_2 / v_2): the shape r / v is linear in speed.
    """
    return np.asarray(speed_m_s * interpolation_weights(nodes_m_s, speed_m_s) / nodes_m_s)
