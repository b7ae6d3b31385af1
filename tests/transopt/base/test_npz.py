"""Archives of arrays that may be anything."""

import io
import zipfile
from typing import Any

import numpy as np
import pytest

from transopt.base.npz import Archive
from transopt.base.sizes import MOST_UNPACKED_BYTES

ARRAYS: dict[str, Any] = {
    "numbers": np.arange(12.0).reshape(3, 4),
    "columns first": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "words": np.array([["a", "longer"]]),
    "one": np.array(2.5),
    "none": np.zeros((0, 3)),
}


def packed(**members: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return stream.getvalue()


def npy(array: Any, shape: tuple[int, ...] | None = None) -> bytes:
    """An NPY file, whose head may state another shape."""
    array, stream = np.asarray(array), io.BytesIO()
    head = {"descr": array.dtype.str, "fortran_order": False, "shape": array.shape if shape is None else shape}
    np.lib.format.write_array_header_1_0(stream, head)
    return stream.getvalue() + array.tobytes()


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_reads_what_numpy_writes(save: Any) -> None:
    stream = io.BytesIO()
    save(stream, **ARRAYS)
    archive = Archive(stream.getvalue())
    assert set(archive) == set(ARRAYS)
    assert len(archive) == len(ARRAYS)
    for name, array in ARRAYS.items():
        assert archive[name].dtype == array.dtype
        np.testing.assert_array_equal(archive[name], array)


@pytest.mark.parametrize("shape", [(2**40,), (4, -1), (2,), (2**33, 2**33)])
def test_a_head_that_states_another_size(shape: tuple[int, ...]) -> None:
    archive = Archive(packed(a=npy(np.arange(4.0), shape)))
    with pytest.raises(ValueError, match=r"a of shape|negative"):
        archive["a"]


def test_what_would_unpack_to_more_than_there_is_room_for() -> None:
    stream, zeros = io.BytesIO(), bytes(2**20)
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a.npy", "w") as member:
        for _ in range(MOST_UNPACKED_BYTES // len(zeros) + 1):
            member.write(zeros)
    data = stream.getvalue()
    assert len(data) < MOST_UNPACKED_BYTES / 500
    with pytest.raises(ValueError, match="unpacks to 257 MB, at most 256 MB"):
        Archive(data)


def test_objects_and_foreign_packing() -> None:
    stream = io.BytesIO()
    np.savez(stream, a=np.array([{}], dtype=object))
    with pytest.raises(ValueError, match="never loaded"):
        Archive(stream.getvalue())["a"]
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("a.npy", npy([1.0]))
    with pytest.raises(ValueError, match="packed or encrypted"):
        Archive(stream.getvalue())["a"]
    with pytest.raises(ValueError, match="a single array"):
        Archive(npy([1.0]))
