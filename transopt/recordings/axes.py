"""The axes of an accelerometer made one signal, since a tap moves the stylus along one line."""

from collections.abc import Mapping

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray

BLOCK_S = 0.05  # over which the earth's field is averaged
APPROACH_S, RINGING_S = 0.03, 0.1  # before and after a tap, which tell nothing of the field
LOUD = 0.1  # of the largest deviation from rest: a tap, or what rings behind it
FIELD = 0.1  # of its size, that a sensor at rest may read the earth's field off
TURNED_DEG = 2.0  # less is a sensor's noise
ALL = "all"  # the way to join axes that keeps what lies across the main direction beside it
STRONG = 0.5  # of the largest deviation from rest: samples of at least so much show the direction of a tap


def without_turning(axes: Mapping[str, FloatArray], step_s: float) -> tuple[dict[str, FloatArray], str]:
    """Axes of a sensor that turned in the earth's field, with its change taken off, and a sentence that says so.

    Gravity is averaged over what is quiet, interpolated across the taps, and kept at the size that it has: a hand
    that speeds up along it is left in the signal. A sensor that does not read gravity, or was not quiet before and
    after, is left as it is.

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
    """One signal (n,) of two or three axes, and a sentence that says how it was made of them.

    `main` projects onto the direction in which the tap is strongest, found among its strong samples by singular
    values; along the sensor's axis that is nearest to it, it counts positive. `dft321` keeps the energy of all axes,
    gravity taken off, with the phase of their sum (Landin, Romano, McMahan and Kuchenbecker, EuroHaptics 2010).

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
    """(a,) direction in which a tap (a, n) is strongest, positive along the axis that is nearest to it."""
    size = np.linalg.norm(moved, axis=0)
    direction = np.linalg.svd(moved[:, size >= STRONG * size.max()], full_matrices=False)[0][:, 0]
    return np.asarray(direction * np.sign(direction[np.argmax(np.abs(direction))]))


def across(axes: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """What lies across a tap's main direction (`joined`): (n,) along two tangents [m/s^2].

    The sensor is turned by the smallest angle that takes its axis nearest to the main direction onto it. The other
    two, in the order x, y, z, x, are the tangents then, so that the three are right-handed.

    Raises
    ------
    InputError : other than three axes.
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
    half = start + normal  # half a turn about `start` and half a turn about this is the smallest turn
    turned = (2 * np.outer(half, half) / (half @ half) - np.eye(3)) @ (2 * np.outer(start, start) - np.eye(3))
    first, second = (turned @ np.eye(3)[(nearest + step) % 3] for step in (1, 2))
    return np.asarray(first @ table), np.asarray(second @ table)
