"""A solved library with other numbers of speeds and grips than were solved."""

import numpy as np

from transopt.library.library import ARRAYS, Library


def resized(library: Library, speeds: int, grips: int) -> Library:
    """Waveforms of the nearest nodes on a grid of so many speeds and grips; nothing else in it is solved."""
    nodes = {
        "v": np.linspace(0, library.speeds_m_s.size - 1, speeds).round().astype(int),
        "g": np.linspace(0, library.grips_N.size - 1, grips).round().astype(int),
    }
    arrays = {}
    for name, stated in ARRAYS.items():
        array = library.array(name)
        for axis, letter in enumerate(stated.shape):
            array = np.take(array, nodes[letter], axis=axis) if letter in nodes else array
        arrays[name] = array
    arrays["speeds_m_s"], arrays["grips_N"] = np.linspace(0.1, 0.4, speeds), np.linspace(1.0, 5.0, grips)
    return Library.of(arrays, library.meta)
