"""Safe reading of untrusted NPZ archives: no array is unpacked before its size is known and allowed.

numpy.load trusts the sizes that a file states: 6 MB can unpack to 9 GB. An NPZ file is a zip archive of NPY files; an
NPY file is a header with type and shape, followed by the numbers (NEP 1 of NumPy).
"""

import io
import zipfile
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from transopt.base.sizes import MOST_UNPACKED_BYTES, megabytes

SUFFIX = ".npy"
# The compression methods that NumPy uses. Others would unpack without bound before their output can be counted.
PACKED_BY = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
HEADS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


class Archive(Mapping[str, NDArray[Any]]):
    """The arrays of an NPZ file by name, each read on access; objects (pickles) are never loaded.

    Parameters
    ----------
    data : the file's bytes.

    Raises
    ------
    ValueError : not an archive of arrays, or one whose arrays exceed `MOST_UNPACKED_BYTES` together. A damaged array,
        or one of objects, raises on access: ValueError, zipfile.BadZipFile, zlib.error, EOFError.
    """

    def __init__(self, data: bytes) -> None:
        if data[: len(npy.MAGIC_PREFIX)] == npy.MAGIC_PREFIX:
            raise ValueError("a single array, not an archive")
        self._zip = zipfile.ZipFile(io.BytesIO(data))
        self._members = {member.filename.removesuffix(SUFFIX): member for member in self._zip.infolist()}
        size = sum(member.file_size for member in self._zip.infolist())
        if size > MOST_UNPACKED_BYTES:
            raise ValueError(f"unpacks to {megabytes(size)}, at most {megabytes(MOST_UNPACKED_BYTES)}")

    def __iter__(self) -> Iterator[str]:
        return iter(self._members)

    def __contains__(self, name: object) -> bool:
        return name in self._members  # without reading it

    def __len__(self) -> int:
        return len(self._members)

    def __getitem__(self, name: str) -> NDArray[Any]:
        member = self._members[name]
        if member.compress_type not in PACKED_BY or member.flag_bits & 1:
            raise ValueError(f"{name} is packed or encrypted in a way that NumPy does not write")
        with self._zip.open(member) as file:
            version = npy.read_magic(file)
            if version not in HEADS:
                raise ValueError(f"{name} is of version {version} of the NPY format")
            shape, fortran, dtype = HEADS[version](file)
            if dtype.hasobject or dtype.itemsize == 0:
                raise ValueError(f"{name} holds pickled objects, which are never loaded, or nothing")
            # The size in the zip directory bounds the unpacked data; the header's size is checked against it.
            content = file.read()
        count = 1
        for length in shape:
            count *= length
        if count * dtype.itemsize != len(content):
            raise ValueError(
                f"{name} of shape {shape} takes {count * dtype.itemsize} bytes, {len(content)} are there"
            )
        return np.frombuffer(content, dtype).reshape(shape, order="F" if fortran else "C").copy()
