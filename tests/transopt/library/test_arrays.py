"""Declarations of a library's arrays: one for each field, and all that is read from them agrees."""

from dataclasses import fields
from pathlib import Path

import numpy as np

from transopt.library.arrays import absent, content_hash, declared
from transopt.library.held import Held
from transopt.library.library import Library
from transopt.library.meta import stated
from transopt.library.multipliers import ARRAYS, MULTIPLIERS

UNITS = {"A2_s": "A^2 s", "m_s2": "m/s^2", "m_s": "m/s", "m": "m", "A": "A", "N": "N", "C": "C", "s": "s"}


def test_every_field_but_meta_and_the_multipliers_is_declared_once() -> None:
    named = [field.name for field in fields(Library) if field.name not in ("meta", "multipliers_of", "cool")]
    assert list(declared(Held)) == named
    assert list(ARRAYS) == [*named, *MULTIPLIERS]


def test_a_unit_in_the_name_is_the_unit_declared() -> None:
    named = 0
    for name, array in ARRAYS.items():
        if name.startswith(("plant_", "spread_")):
            continue
        suffix = next((suffix for suffix in UNITS if name.endswith(f"_{suffix}")), None)
        if suffix is not None:
            assert array.unit == UNITS[suffix], name
            named += 1
    assert named >= 14


def test_a_library_file_holds_what_is_declared(library: Library, tmp_path: Path) -> None:
    missing = absent(ARRAYS, stated(library.scene(), library.meta))
    wanted = {name for name in ARRAYS if name not in missing} | {"meta", "content_sha256"}
    library.save(tmp_path / "library.npz")
    with np.load(tmp_path / "library.npz") as file:
        assert set(file.files) == wanted


def test_the_hash_tells_names_types_shapes_and_bytes_apart() -> None:
    one = {"a": np.zeros(4), "b": np.ones(2)}
    others = [
        {"a": np.zeros(4), "c": np.ones(2)},
        {"a": np.zeros(4, dtype=np.float32), "b": np.ones(2)},
        {"a": np.zeros((2, 2)), "b": np.ones(2)},
        {"a": np.zeros(4), "b": np.array([1.0, 2.0])},
    ]
    assert content_hash(one) == content_hash(dict(reversed(one.items())))
    assert len({content_hash(each) for each in [one, *others]}) == 5
