"""Numeric arrays of level 5 MAT files (The MathWorks, "MAT-File Format", Sec. 1).

scipy.io.loadmat reads them too, but a single damaged type tag makes it crash the process, while a damaged recording
must end in an error message.
"""

import struct
import zlib
from collections.abc import Iterator

import numpy as np

from transopt.base.sizes import MOST_UNPACKED_BYTES, megabytes

MOST_BYTES = MOST_UNPACKED_BYTES // 2  # unpacked; half, since elements are copied once

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_COMPRESSED = 15
_NUMERIC_CLASSES = range(6, 16)  # mxDOUBLE_CLASS to mxUINT64_CLASS
_COMPLEX = 0x800
_STRUCTURE = 2
_CHARACTERS = 4
LONGEST_TEXT = 200  # characters: of a unit or a remark
_DEEPEST = 4  # nesting depth of structures


def variables(data: bytes) -> dict[str, object]:
    """All variables of a file by name, a field of a structure as `log.acc`; the value is None for cells and the like.

    Raises
    ------
    ValueError : not a level 5 file (-v7.3 is HDF5), cut short, or too large unpacked. Other damage raises whatever
        the bytes lead to (struct.error, zlib.error, KeyError, IndexError ...).
    """
    order = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}.get(data[124:128])
    if order is None:
        raise ValueError("not of -v6 or -v7; -v7.3 is HDF5")
    found: dict[str, object] = {}
    room = MOST_BYTES
    for kind, content in _elements(data[128:], order):
        matrix = content
        if kind == _COMPRESSED:
            unpacked = _unpacked(content, room)
            room -= len(unpacked)
            matrix = next(_elements(unpacked, order))[1]
        _, _, (_, name), *_ = _elements(matrix, order)
        _put(found, name.decode("latin-1"), matrix, order, _DEEPEST)
    return found


def _put(found: dict[str, object], name: str, matrix: bytes, order: str, deepest: int) -> None:
    """Add a matrix to `found` under its name, or the fields of a structure of one element."""
    (_, flags), (_, dims), _, *elements = _elements(matrix, order)
    flag_bits, shape = int(np.frombuffer(flags, order + "u4")[0]), np.frombuffer(dims, order + "i4")
    found[name] = None
    if flag_bits & 0xFF == _STRUCTURE and deepest and np.prod(shape) == 1:
        (_, length), (_, names), *fields = elements
        size = int(np.frombuffer(length, order + "i4")[0])
        del found[name]
        for k, (_, field) in enumerate(fields):
            own = names[k * size : (k + 1) * size].split(b"\0")[0].decode("latin-1")
            _put(found, f"{name}.{own}", field, order, deepest - 1)
    elif flag_bits & 0xFF == _CHARACTERS:
        kind, content = elements[0]
        codes = np.frombuffer(content, order + _TYPES.get(kind, "u1"))
        found[name] = "".join(map(chr, codes[:LONGEST_TEXT]))
    elif flag_bits & 0xFF in _NUMERIC_CLASSES:
        parts = [
            np.frombuffer(part, order + _TYPES[kind]) for kind, part in elements[: 1 + bool(flag_bits & _COMPLEX)]
        ]
        values = parts[0] + 1j * parts[1] if len(parts) == 2 else parts[0]
        found[name] = values.reshape(shape, order="F")


def _unpacked(packed: bytes, room: int) -> bytes:
    """The content of a compressed element, cut at `room` bytes."""
    unpacker = zlib.decompressobj()
    content = unpacker.decompress(packed, room + 1)
    if len(content) > room:
        raise ValueError(f"it unpacks to more than {megabytes(MOST_BYTES)}")
    if not unpacker.eof:
        raise ValueError("it is cut short")
    return content


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type number and content of the elements of a MAT file, or of one matrix in it."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(order + "II", data, at)
        start, end = at + 8, at + 8 + size
        at = end if kind == _COMPRESSED else end + -size % 8
        if kind >> 16:  # a small element packs size, type and up to 4 bytes of content into the 8
            kind, start, end, at = kind & 0xFFFF, start - 4, start - 4 + (kind >> 16), start
        if end > len(data):
            raise ValueError("it is cut short")
        yield kind, data[start:end]
