"""Text encoding of a file, recognised by byte-order marks, by zero bytes and by readable units."""

import codecs
import re

from transopt.base.errors import InputError
from transopt.files.units import is_unit

HEAD = 65536  # leading bytes in which units are looked for and the encoding is recognised
_ZERO_BYTES = 0.4  # share of zeros among every second byte: above it in UTF-16 of mostly ASCII text
_CODE_PAGES = ("cp1252", "cp850", "mac_roman")  # Windows, its console and DOS, Mac OS before X: western Europe
_CONTROLS = "".join(map(chr, [*range(9), *range(14, 26), *range(28, 32)]))  # absent from text in any page
_BEYOND_ASCII = re.compile(r"[^\s,;:\"()\[\]{}]*[^\x00-\x7f\s][^\s,;:\"()\[\]{}]*")


def encoding_of(data: bytes) -> str:
    """Name of the encoding: by the byte-order mark, the pattern of zero bytes, as UTF-8, or a code page.

    Code pages map the same bytes to different characters, and a few such bytes are too few for statistics. The first
    page under which a unit can be read is chosen.

    Raises
    ------
    InputError : the bytes are text in no known encoding.
    """
    pairs = data[: min(len(data), HEAD) // 2 * 2]
    even, odd = (2 * pairs[k::2].count(0) / max(len(pairs), 1) for k in (0, 1))
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        name = "utf-16"
    elif max(even, odd) > _ZERO_BYTES > min(even, odd):
        name = "utf-16-be" if even > odd else "utf-16-le"
    else:
        name = "utf-8-sig"
    bad = _undecodable(data, name.removesuffix("-sig"), "\0")
    if bad is None:
        return name
    pages = [page for page in _CODE_PAGES if _undecodable(data, page, _CONTROLS) is None]
    if name == "utf-8-sig" and not data.startswith(codecs.BOM_UTF8) and pages:
        return next((page for page in pages if _has_units(data[:HEAD].decode(page))), pages[0])
    row = data.count(b"\n", 0, bad) + 1
    raise InputError(f"row {row}: byte 0x{data[bad]:02x} is not UTF-8 text; save it as UTF-8 text")


def _undecodable(data: bytes, name: str, controls: str) -> int | None:
    """Position of the first undecodable byte or control character; None if there is none."""
    try:
        text = data.decode(name)
    except UnicodeDecodeError as error:
        return error.start
    places = [at for character in controls if (at := text.find(character)) >= 0]
    return min(places, default=None)


def _has_units(text: str) -> bool:
    """Whether a word with a non-ASCII character is a unit, or ends in a unit after a slash."""
    words = {word for found in _BEYOND_ASCII.findall(text) for word in (found, found.partition("/")[2])}
    return any(map(is_unit, words))
