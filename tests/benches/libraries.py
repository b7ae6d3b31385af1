"""Libraries beside those that were solved: other nodes or values, changed files, and files that are proven again."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from transopt.design.verify import verify_library
from transopt.library.arrays import HASH_FIELD, content_hash
from transopt.library.library import Library
from transopt.library.multipliers import ARRAYS
from transopt.library.proven import load_proven
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


def proven_again(library: Library | None, folder: Path) -> Library:
    """A library as it is read from its file: the same arrays, proven when it is read, and verified entry by entry."""
    library.save(folder / "library.npz")
    read = load_proven(folder / "library.npz")
    assert read.content_sha256 == library.content_sha256
    for name in library.stored():
        np.testing.assert_array_equal(read.array(name), library.array(name), err_msg=name)
    for check in verify_library(read):
        assert check.shortfalls == [], check.cells
        assert check.certificate.accepted or (check.certificate.is_stationary and read.is_stationary), check.cells
    return read


def rewritten(path: Path, *, drop: str = "", hashed: bool = True, **changed: object) -> Path:
    """The file without an array or with other ones, and with the hash that they have, or else with the old one."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files if name != drop}
    arrays |= {name: np.asarray(array) for name, array in changed.items()}
    if hashed and drop != HASH_FIELD:
        arrays.pop(HASH_FIELD)
        arrays[HASH_FIELD] = np.array(content_hash(arrays))
    np.savez(path, **arrays)  # type: ignore[arg-type]
    return path
