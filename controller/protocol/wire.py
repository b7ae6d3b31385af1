"""Frames on a byte stream: COBS(payload + CRC-32) + 0x00.

COBS (Cheshire and Baker 1999) removes every zero byte, so that only the end of a frame is a zero: after any damage
the decoder resynchronises at the next zero. CRC-32 is zlib's (IEEE 802.3), over the payload, appended little-endian.
This module does not interpret payloads, and no received bytes make it raise.

A payload never begins with a zero byte. After a complete frame with its CRC the CRC register has the value that four
zeros give it from the start, so a frame whose delimiter was lost, followed by a frame that lost its four leading
zeros, would pass the check.
"""

import zlib

PAYLOAD_LIMIT = 8 + 1024  # header and body, see `messages`
CRC_BYTES = 4
_RAW_LIMIT = PAYLOAD_LIMIT + CRC_BYTES
ENCODED_LIMIT = _RAW_LIMIT + -(-_RAW_LIMIT // 254)  # without the delimiter
DELIMITER = b"\0"
_RUN = 254  # bytes without a zero that one code byte can announce
_CODES = [bytes([code]) for code in range(256)]


def stuff(raw: bytes) -> bytes:
    """COBS encoding of `raw`: no zero byte, at most one additional byte per 254 or part of them."""
    out = []
    pieces = raw.split(DELIMITER)
    for piece in pieces:
        rest = piece
        while len(rest) > _RUN:
            out.append(b"\xff" + rest[:_RUN])
            rest = rest[_RUN:]
        out.append(_CODES[len(rest) + 1])
        out.append(rest)
        if len(rest) == _RUN:
            out.append(b"\x01")
    if len(pieces[-1]) % _RUN == 0 and pieces[-1]:
        out.pop()  # a full last run needs nothing after it
    return b"".join(out)


def unstuff(stuffed: bytes) -> bytes | None:
    """The inverse of `stuff`; None if there is a zero, or if a code byte points beyond the end."""
    if DELIMITER in stuffed:
        return None
    out, place, size = bytearray(stuffed), 0, len(stuffed)
    full = []  # code bytes of full runs: no zero stands there
    while place < size:
        code = out[place]
        out[place] = 0
        if code == 0xFF:
            full.append(place + code)
        place += code
    if place != size:
        return None
    for cut in reversed(full):
        if cut < size:
            del out[cut]
    return bytes(out[1:])


def encode(payload: bytes) -> bytes:
    """One frame, delimiter included.

    Raises
    ------
    ValueError : the payload is empty or begins with a zero.
    """
    if not payload or payload[0] == 0:
        raise ValueError("a payload begins with its kind, which is not 0")
    return stuff(payload + zlib.crc32(payload).to_bytes(CRC_BYTES, "little")) + DELIMITER


def decode(stuffed: bytes) -> bytes | None:
    """Payload of one frame without its delimiter; None if it is damaged, too long or too short."""
    if len(stuffed) > ENCODED_LIMIT:
        return None
    raw = unstuff(stuffed)
    if raw is None or not CRC_BYTES < len(raw) <= _RAW_LIMIT:
        return None
    payload = raw[:-CRC_BYTES]
    return payload if zlib.crc32(payload) == int.from_bytes(raw[-CRC_BYTES:], "little") else None


class Decoder:
    """Extracts payloads from a byte stream that comes in pieces of any size.

    It buffers one unfinished frame, at most `ENCODED_LIMIT` bytes of it: anything longer is not a frame and is
    discarded up to the next delimiter.

    Attributes
    ----------
    frames, bad_frames : numbers of frames so far. An empty frame (two delimiters in a row) counts as neither.
    """

    def __init__(self) -> None:
        self.frames = self.bad_frames = 0
        self._held = b""
        self._overlong = False

    def feed(self, data: bytes) -> list[bytes]:
        """Payloads of the frames that `data` completes."""
        *whole, rest = data.split(DELIMITER)
        payloads = []
        for piece in whole:
            stuffed = self._held + piece if self._held else piece
            overlong, self._held, self._overlong = self._overlong, b"", False
            if not stuffed and not overlong:
                continue
            payload = None if overlong else decode(stuffed)
            if payload is None:
                self.bad_frames += 1
            else:
                self.frames += 1
                payloads.append(payload)
        if self._overlong or len(self._held) + len(rest) > ENCODED_LIMIT:
            self._held, self._overlong = b"", True
        else:
            self._held += rest
        return payloads
