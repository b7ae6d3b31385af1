"""A solved library with other numbers of speeds and grips than were solved, or with some of them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from transopt.library.library import Library
from transopt.library.multipliers import ARRAYS
from transopt.scene.keys import with_values


def under(library: Library, values: Mapping[str, object]) -> Library:
    """What is in a library, under its scene with other values at dotted keys: nothing is solved again."""
    scene = with_values(library.scene(), values)
    return replace(library, meta={**library.meta, "scene": scene.model_dump(mode="json")})


def resized(library: Library, speeds: int, grips: int) -> Library:
    """Waveforms of the nearest nodes on a grid of so many speeds and grips; nothing else in it is solved."""
    nodes = {
        "v": np.linspace(0, library.speeds_m_s.size - 1, speeds).round().astype(int),
        "g": np.linspace(0, library.grips_N.size - 1, grips).round().astype(int),
    }
    arrays = {}
    for name, stated in ARRAYS.items():
        array = library.array(name)
        for axis, letter in enumerate(stated.letters(())):
            array = np.take(array, nodes[letter], axis=axis) if letter in nodes else array
        arrays[name] = array
    arrays["speeds_m_s"], arrays["grips_N"] = np.linspace(0.1, 0.4, speeds), np.linspace(1.0, 5.0, grips)
    return Library.of(arrays, {**library.meta, **_tables(library, nodes["v"], nodes["g"])})


def part_of(library: Library, speeds: Sequence[int], grips: Sequence[int]) -> Library:
    """Some of its nodes."""
    arrays = {}
    for name, stated in ARRAYS.items():
        array = library.array(name)
        for axis, letter in enumerate(stated.letters(())):
            array = np.take(array, {"v": speeds, "g": grips}.get(letter, range(array.shape[axis])), axis=axis)
        arrays[name] = array
    left_out = {
        part: said if isinstance(said, str) else [[said[iv][ig] for ig in grips] for iv in speeds]
        for part, said in library.meta["left_out"].items()
    }
    return Library.of(arrays, {**library.meta, "left_out": left_out, **_tables(library, speeds, grips)})


def _tables(library: Library, speeds: Sequence[int], grips: Sequence[int]) -> dict[str, object]:
    """What `meta` says of every entry, of some of them."""
    said = {name: library.meta[name] for name in ("repeatability", "slow_part_known")}
    return {name: [[table[iv][ig] for ig in grips] for iv in speeds] for name, table in said.items()}
