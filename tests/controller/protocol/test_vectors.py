"""The manual's byte-exact frames, against both ends; and the table of requests."""

import json
import runpy
from pathlib import Path

import pytest

from controller.protocol import messages as m
from controller.protocol.codes import Kind
from controller.protocol.wire import Decoder, encode
from tests.benches.probed import Decoder as CoreDecoder
from tests.benches.probed import encode as core_encode

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
