"""The axes of an accelerometer made one signal, since a tap moves the stylus along one line."""

from collections.abc import Mapping

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray

STRONG = 0.5  # of the largest deviation from rest: samples of at least so much show the direction of a tap


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
    size = np.linalg.norm(moved, axis=0)
    direction = np.linalg.svd(moved[:, size >= STRONG * size.max()], full_matrices=False)[0][:, 0]
    nearest = int(np.argmax(np.abs(direction)))
    direction = direction * np.sign(direction[nearest])
    along, whole = float(np.sum((direction @ moved) ** 2)), float(np.sum(moved**2))
    across = 0.0 if whole == 0 else 1 - along / whole
    off = np.degrees(np.arccos(min(direction[nearest], 1.0)))
    return direction @ table, (
        f"axes {listed} are joined along the tap's main direction, {off:.0f} degrees off {names[nearest]}; "
        f"{100 * across:.1f} % of the energy lies across it"
    )
