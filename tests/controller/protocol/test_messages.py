"""The message table: round trips, lengths, versions; C header, page and vectors are what the table says."""

import json
import math
import runpy
import struct
from dataclasses import fields
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.protocol import messages as m
from controller.protocol.c_header import HEADER_PATH, header_text
from controller.protocol.codes import EVENT_CODES, EVENTS, REASONS, Kind, LinkNotice, Reason
from controller.protocol.packed import BadBodyError, Packed
from controller.protocol.wire import Decoder, encode
from controller.servo.interface import Fault, Notice
from tests.benches.probed import Decoder as CoreDecoder
from tests.benches.probed import encode as core_encode

RANGES = {
    "B": (0, 2**8 - 1),
    "H": (0, 2**16 - 1),
    "I": (0, 2**32 - 1),
    "i": (-(2**31), 2**31 - 1),
    "Q": (0, 2**64 - 1),
}


def values_of(form: str) -> st.SearchStrategy[object]:
    if form in RANGES:
        return st.integers(*RANGES[form])
    if form in ("f", "d"):
        return st.floats(width=32 if form == "f" else 64, allow_nan=False)
    return st.binary(max_size=200) if form == "*" else st.binary(min_size=int(form[:-1]), max_size=int(form[:-1]))


@st.composite
def messages(draw: st.DrawFn) -> Packed:
    kind = draw(st.sampled_from(list(Kind)))
    message = m.MESSAGES[kind]
    drawn = [draw(values_of(form)) for _, form in message.layout()]
    if message in (m.Hello, m.HelloReply):
        drawn[:2] = [m.MAGIC, m.PROTOCOL]
    built: Packed = message(*drawn)
    return built


@given(messages(), st.integers(0, 0xFFFF), st.integers(0, 2**32 - 1))
def test_every_message_comes_back(message: Packed, sequence: int, session: int) -> None:
    frame = m.Frame(sequence, session, message)
    assert m.read_frame(frame.payload()) == frame


@given(messages(), st.binary(min_size=1, max_size=20))
def test_wrong_lengths_are_refused(message: Packed, more: bytes) -> None:
    payload = m.Frame(1, 2, message).payload()
    if not message.OPEN:
        with pytest.raises(BadBodyError):
            m.read_frame(payload + more)
    fixed = m.HEADER.size + message.FORMAT.size
    if message.FORMAT.size:
        with pytest.raises(BadBodyError):
            m.read_frame(payload[: fixed - 1])


@given(st.binary(max_size=1100))
def test_any_bytes_are_read_or_refused(payload: bytes) -> None:
    try:
        frame = m.read_frame(payload)
    except (BadBodyError, m.OtherProtocolError):
        return
    assert frame.payload() == payload or any(isinstance(x, float) and math.isnan(x) for x in _values(frame.message))


def _values(message: Packed) -> list[object]:
    return [getattr(message, name) for name in message.NAMES]


def test_flags_kinds_and_bodies_of_a_later_version_are_refused() -> None:
    payload = m.Frame(1, 2, m.Disarm()).payload()
    for changed in (b"\x3f" + payload[1:], payload[:1] + b"\x01" + payload[2:], payload[:5]):
        with pytest.raises(BadBodyError):
            m.read_frame(changed)
    with pytest.raises(BadBodyError):
        m.read_frame(m.Frame(1, 2, m.Data(0, bytes(m.DATA_LIMIT + 1))).payload())
    m.read_frame(m.Frame(1, 2, m.Data(0, bytes(m.DATA_LIMIT))).payload())


@pytest.mark.parametrize("kind", [Kind.HELLO, Kind.HELLO_REPLY])
def test_other_versions_are_recognised_whatever_follows(kind: Kind) -> None:
    head = m.HEADER.pack(kind, 0, 1, 2)
    with pytest.raises(m.OtherProtocolError) as newer:
        m.read_frame(head + struct.pack("<IH", m.MAGIC, m.PROTOCOL + 7) + b"of another length")
    assert not newer.value.foreign
    assert newer.value.protocol == m.PROTOCOL + 7
    with pytest.raises(m.OtherProtocolError) as foreign:
        m.read_frame(head + struct.pack("<IH", m.MAGIC ^ 1, m.PROTOCOL))
    assert foreign.value.foreign
    with pytest.raises(BadBodyError):
        m.read_frame(head + b"\0\0")


def test_the_table_is_complete() -> None:
    assert set(m.MESSAGES) == set(Kind)
    assert len(set(m.MESSAGES.values())) == len(Kind)
    assert set(EVENTS.values()) == {*Notice, *Fault, *LinkNotice}
    assert {EVENT_CODES[what] for what in EVENTS.values()} == set(EVENTS)
    assert 0 not in EVENTS
    assert set(REASONS.values()) == set(Reason)
    for message in m.MESSAGES.values():
        assert message.FORMAT.size <= m.BODY_LIMIT
        # Only the last field may be open.
        assert all(form != "*" for _, form in message.layout()[:-1])
        assert [name for name, _ in message.layout()] == [field.name for field in fields(message)]  # type: ignore[arg-type]


def test_the_c_header_is_generated_from_the_table() -> None:
    assert HEADER_PATH.read_text(encoding="ascii") == header_text(), "run python -m controller.protocol.c_header"


DOCS = Path(__file__).parents[3] / "docs"
VECTORS = DOCS / "reference" / "protocol_vectors.json"
FRAMES = json.loads(VECTORS.read_text(encoding="ascii"))


@pytest.mark.parametrize("kind", list(Kind), ids=lambda kind: kind.name)
@pytest.mark.usefixtures("c_compiler")
def test_both_ends_read_and_write_the_frames_of_the_manual(kind: Kind) -> None:
    payload, frame = (bytes.fromhex(FRAMES[kind.name][part]) for part in ("payload", "frame"))
    assert encode(payload) == frame == core_encode(payload)
    assert list(Decoder().feed(frame)) == [payload] == CoreDecoder().feed(frame)
    read = m.read_frame(payload)
    assert m.KINDS[type(read.message)] is kind
    assert read.payload() == payload


def test_every_kind_of_a_host_stands_in_the_table_of_requests() -> None:
    requests = runpy.run_path(str(DOCS / "protocol_pages.py"))["REQUESTS"]
    assert set(requests) == {kind for kind in Kind if kind < 64}


def test_every_message_says_what_it_is_for() -> None:
    """A dataclass without a docstring gets its signature for one, which each Python writes in its own way."""
    assert not [kind.name for kind in Kind if f"{m.MESSAGES[kind].__name__}(" in (m.MESSAGES[kind].__doc__ or "")]


def test_the_page_is_what_the_code_says() -> None:
    pages = runpy.run_path(str(DOCS / "protocol_pages.py"))
    assert (DOCS / "reference" / "protocol.md").read_text(encoding="utf-8") == pages["protocol_page"]()
    assert pages["vectors"]() == FRAMES
