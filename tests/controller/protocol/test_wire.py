"""Frames: round trips, resynchronisation, bounded memory, and damage that is never taken for a frame."""

import random
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.protocol.wire import DELIMITER, ENCODED_LIMIT, PAYLOAD_LIMIT, Decoder, decode, encode, stuff, unstuff
from tests.benches.device import need_compiler
from tests.campaigns.test_wire_fuzz import Ends, fuzz, random_frame

RAW = st.one_of(
    st.binary(max_size=1100),
    st.lists(st.sampled_from([0, 0, 1, 254, 255]), max_size=600).map(bytes),
    st.integers(250, 260).map(lambda n: b"\x07" * n),
    st.integers(250, 260).map(lambda n: b"\x07" * n + b"\0"),
)
PAYLOAD = st.binary(min_size=1, max_size=PAYLOAD_LIMIT).filter(lambda payload: payload[0] != 0)


def reference_stuff(raw: bytes) -> bytes:
    """Byte by byte, as Cheshire and Baker have it (the listing of their appendix)."""
    out, code_place, code = bytearray([0]), 0, 1
    for j, byte in enumerate(raw):
        if byte:
            out.append(byte)
            code += 1
        if byte == 0 or (code == 0xFF and j + 1 < len(raw)):
            out[code_place] = code
            code_place, code = len(out), 1
            out.append(0)
    out[code_place] = code
    return bytes(out)


@given(RAW)
def test_stuffing_is_cobs(raw: bytes) -> None:
    stuffed = stuff(raw)
    assert 0 not in stuffed
    assert len(stuffed) <= len(raw) + 1 + len(raw) // 254
    assert unstuff(stuffed) == raw
    assert stuffed == reference_stuff(raw)


def test_stuffing_known_examples() -> None:
    """From the paper and from the standard's usual table."""
    assert stuff(b"") == b"\x01"
    assert stuff(b"\0") == b"\x01\x01"
    assert stuff(b"\x11\x22\x00\x33") == b"\x03\x11\x22\x02\x33"
    assert stuff(bytes(range(1, 255))) == b"\xff" + bytes(range(1, 255))
    assert stuff(bytes(range(1, 256))) == b"\xff" + bytes(range(1, 255)) + b"\x02\xff"
    assert unstuff(b"\xff" + bytes(range(1, 255)) + b"\x01") == bytes(range(1, 255))


@given(st.binary(max_size=400))
def test_any_bytes_unstuff_or_are_refused(stuffed: bytes) -> None:
    raw = unstuff(stuffed)
    assert raw is None or len(raw) <= len(stuffed)


@given(st.lists(PAYLOAD, max_size=5), st.data())
def test_frames_come_back_in_pieces_of_any_size(payloads: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(encode(payload) for payload in payloads)
    decoder, taken = Decoder(), []
    while stream:
        size = data.draw(st.integers(1, max(len(stream), 1)))
        taken += decoder.feed(stream[:size])
        stream = stream[size:]
    assert taken == payloads
    assert (decoder.frames, decoder.bad_frames) == (len(payloads), 0)


def test_the_largest_payload_fits_and_no_larger() -> None:
    most = bytes(range(1, 256)) * 5
    assert len(encode(most[:PAYLOAD_LIMIT])) == ENCODED_LIMIT + 1
    assert decode(encode(most[:PAYLOAD_LIMIT])[:-1]) == most[:PAYLOAD_LIMIT]
    assert decode(encode(most[: PAYLOAD_LIMIT + 1])[:-1]) is None
    zeros = b"\x01" + bytes(PAYLOAD_LIMIT)
    assert decode(encode(zeros)[:-1]) is None
    assert decode(stuff(zlib.crc32(b"").to_bytes(4, "little"))) is None
    for payload in (b"", b"\0", b"\0kind"):
        with pytest.raises(ValueError, match="begins with its kind"):
            encode(payload)


@pytest.mark.parametrize("piece", [1, 7, 4096])
def test_an_endless_stream_without_delimiter_is_not_kept(piece: int) -> None:
    decoder = Decoder()
    for _ in range(100_000 // piece):
        assert decoder.feed(b"\x05" * piece) == []
        assert len(decoder._held) <= ENCODED_LIMIT
    assert decoder.feed(DELIMITER + encode(b"after")) == [b"after"]
    assert (decoder.frames, decoder.bad_frames) == (1, 1)


def test_a_frame_hidden_behind_an_overlong_one_is_not_taken() -> None:
    decoder = Decoder()
    decoder.feed(b"\x05" * (ENCODED_LIMIT + 1))
    assert decoder.feed(encode(b"hidden")) == []
    assert decoder.feed(encode(b"open")) == [b"open"]


def test_delimiters_alone_are_nothing() -> None:
    decoder = Decoder()
    assert decoder.feed(DELIMITER * 10 + encode(b"x") + DELIMITER * 3) == [b"x"]
    assert decoder.bad_frames == 0


@given(PAYLOAD, st.integers(0, 10_000), st.integers(1, 255))
def test_every_single_changed_byte_is_seen(payload: bytes, place: int, change: int) -> None:
    frame = bytearray(encode(payload))
    frame[place % len(frame)] ^= change
    assert Decoder().feed(bytes(frame) + DELIMITER) == []


def test_damaged_frames_are_never_taken_for_others() -> None:
    """Short form of tests/campaigns/test_wire_fuzz.py."""
    counts = fuzz(20_000, seed=1)
    assert counts["wrong"] == 0
    assert counts["lost"] == 0
    assert counts["rejected"] > 15_000


def test_damaged_messages_fail_neither_end() -> None:
    need_compiler()
    ends = Ends()
    counts = fuzz(4_000, 2, random_frame, (ends,))
    assert counts["wrong"] == counts["lost"] == ends.driven == 0
    assert ends.device.look().dropped_frames > 0


def test_random_messages_of_any_session_fail_neither_end() -> None:
    """Sound frames with random bodies: worse than any line can do."""
    need_compiler()
    chance, ends = random.Random(3), Ends()
    for _ in range(4_000):
        ends(encode(random_frame(chance)))
    assert ends.driven == 0
    assert ends.greetings > 10
