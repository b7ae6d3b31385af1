"""Joins the axes of an accelerometer into one signal, since a tap moves the stylus along one line."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray
from transopt.files.names import Layout, Vocabulary
from transopt.files.unclear import in_file

if TYPE_CHECKING:
    from transopt.files.table import Table

BLOCK_S = 0.05  # length of the blocks over which the earth's field is averaged
APPROACH_S, RINGING_S = 0.03, 0.1  # times before and after a tap that are unusable for the field
LOUD = 0.1  # share of the largest deviation from rest that marks a tap or its ringing
FIELD = 0.1  # relative error of the earth's field that a sensor at rest may read
TURNED_DEG = 2.0  # a smaller turn is sensor noise
ALL = "all"  # way of joining that also keeps the acceleration across the main direction
STRONG = 0.5  # share of the largest deviation from rest, from which on samples show the direction of a tap


def read_signals(path: Path, words: Vocabulary, layout: Layout) -> "Table":
    """Read one file, and join the axes of its accelerometer as the layout says, or along the main direction.

    Raises
    ------
    InputError : see `read_table` and `joined`; or an axis is chosen, and the file has one acceleration.
    """
    # Imported here, since simulated taps have no files.
    from transopt.files.table import read_table

    table, way = read_table(path, words, layout), layout.axis
    with in_file(path):
        if not table.axes:
            if way:
                raise InputError(
                    f"--axis {way} (in a scene recordings.axis): the file has one acceleration; leave it out"
                )
            return table
        one = next(iter(table.axes.values()))
        axes, turned = without_turning({name: x.values for name, x in table.axes.items()}, one.dt_s)
        whole, said = joined(axes, way or "main")
        made = {"acceleration": whole}
        if way == ALL:
            made["across_1"], made["across_2"] = across(axes)
    signals = {**table.signals, **{quantity: replace(one, values=values) for quantity, values in made.items()}}
    return replace(table, signals=signals, axes={}, notes=(said, *filter(None, [turned]), *table.notes))


def without_turning(axes: Mapping[str, FloatArray], step_s: float) -> tuple[dict[str, FloatArray], str]:
    """Remove from the axes the change of gravity of a sensor that turned, and say so in a sentence.

    Gravity is averaged over quiet stretches, interpolated across the taps, and kept at its mean magnitude, so that an
    acceleration of the hand along it stays in the signal. The axes are unchanged if the sensor does not read gravity
    or was not quiet before and after the taps.

    Parameters
    ----------
    axes : name of an axis -> (n,) [m/s^2].
    """
    table = np.array(list(axes.values()))
    away = np.linalg.norm(table - np.median(table, axis=1, keepdims=True), axis=0)
    loud = np.flatnonzero(away >= LOUD * away.max())
    size = table.shape[1]
    edges = np.zeros(size + 1, dtype=int)
    np.add.at(edges, np.maximum(loud - round(APPROACH_S / step_s), 0), 1)
    np.add.at(edges, np.minimum(loud + round(RINGING_S / step_s), size), -1)
    quiet = np.cumsum(edges)[:-1] == 0
    pieces = np.array_split(np.arange(size), np.clip(int(size * step_s / BLOCK_S), 1, size))
    blocks = [at for at in pieces if quiet[at].all()]
    if len(axes) < len("xyz") or len(blocks) < 2 or not blocks[0][0] < loud[0] < blocks[-1][0]:
        return dict(axes), ""
    means = np.array([table[:, at].mean(axis=1) for at in blocks])
    sizes = np.linalg.norm(means, axis=1)
    if np.abs(sizes / STANDARD_GRAVITY_M_S2 - 1).max() > FIELD:
        return dict(axes), ""
    turned = np.degrees(np.arccos(np.clip(means @ means[0] / (sizes * sizes[0]), -1, 1))).max()
    if turned < TURNED_DEG:
        return dict(axes), ""
    middles = [at.mean() for at in blocks]
    field = np.array([np.interp(np.arange(size), middles, mean) for mean in means.T])
    field *= sizes.mean() / np.linalg.norm(field, axis=0)
    kept = table - field + field[:, loud[:1]]
    said = f"the sensor turned by {turned:.0f} degrees in the earth's field, whose change is taken off"
    return dict(zip(axes, kept, strict=True)), said


def joined(axes: Mapping[str, FloatArray], way: str) -> tuple[FloatArray, str]:
    """Join two or three axes into one signal (n,), and say in a sentence how.

    `main` projects onto the direction in which the tap is strongest, found among its strong samples by singular value
    decomposition and signed so that the nearest sensor axis counts positive. `dft321` keeps the energy of all axes,
    without gravity, and the phase of their sum (Landin, Romano, McMahan and Kuchenbecker, EuroHaptics 2010).

    Parameters
    ----------
    axes : name of an axis -> (n,) [m/s^2].
    way : "main", "dft321" or the name of one axis.

    Raises
    ------
    InputError : an axis that the file does not have.
    """
    names, table = list(axes), np.array(list(axes.values()))
    listed = ", ".join(names)
    if way == ALL:
        way = "main"
    if way in axes:
        return axes[way], f"axis {way} of {listed} is used alone"
    moved = table - np.median(table, axis=1, keepdims=True)
    if way == "dft321":
        parts = np.fft.rfft(moved)
        spectrum = np.linalg.norm(parts, axis=0) * np.exp(1j * np.angle(parts.sum(axis=0)))
        made = np.fft.irfft(spectrum, table.shape[1])
        return np.asarray(made), f"axes {listed} are joined by DFT321: the energy of all, the phase of their sum"
    if way != "main":
        raise InputError(
            f"--axis {way} (in a scene recordings.axis): the file has {listed}; choose one of them or main"
        )
    direction = _main(moved)
    nearest = int(np.argmax(np.abs(direction)))
    along, whole = float(np.sum((direction @ moved) ** 2)), float(np.sum(moved**2))
    across = 0.0 if whole == 0 else 1 - along / whole
    off = np.degrees(np.arccos(min(direction[nearest], 1.0)))
    return direction @ table, (
        f"axes {listed} are joined along the tap's main direction, {off:.0f} degrees off {names[nearest]}; "
        f"{100 * across:.1f} % of the energy lies across it"
    )


def _main(moved: FloatArray) -> FloatArray:
    """(a,) direction in which a tap (a, n) is strongest, signed to be positive along the nearest axis."""
    size = np.linalg.norm(moved, axis=0)
    direction = np.linalg.svd(moved[:, size >= STRONG * size.max()], full_matrices=False)[0][:, 0]
    return np.asarray(direction * np.sign(direction[np.argmax(np.abs(direction))]))


def across(axes: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """(n,) acceleration along each of two tangents, across the tap's main direction (`joined`) [m/s^2].

    The sensor's frame is turned by the smallest angle that takes the axis nearest to the main direction onto it. The
    tangents are then the other two axes, in cyclic order x, y, z, so that the three are right-handed.

    Raises
    ------
    InputError : there are not three axes.
    """
    if len(axes) != len("xyz"):
        listed = ", ".join(axes)
        raise InputError(
            f"--axis {ALL} (in a scene recordings.axis): needs three axes, the file has {listed}: choose main"
        )
    table = np.array([axes[name] for name in sorted(axes)])
    normal = _main(table - np.median(table, axis=1, keepdims=True))
    nearest = int(np.argmax(normal))
    start = np.eye(3)[nearest]
    half = start + normal  # a half turn about `start`, then one about this, compose the smallest turn
    turned = (2 * np.outer(half, half) / (half @ half) - np.eye(3)) @ (2 * np.outer(start, start) - np.eye(3))
    first, second = (turned @ np.eye(3)[(nearest + step) % 3] for step in (1, 2))
    return np.asarray(first @ table), np.asarray(second @ table)
