"""The compiled device says and does what was recorded; its frames and hashes are the host's and the standards'."""

import hashlib
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.firmware import core_device
from controller.firmware.build import CORE, NoCompilerError, sources
from controller.firmware.core_device import REPLAY
from controller.protocol import wire
from controller.servo.interface import State
from tests.benches.device import World, need_clean
from tests.benches.probed import Decoder, ProbedDevice, crc32, encode, sha256
from tests.campaigns.recorded import BOOT, Conversation, load, save
from tests.campaigns.test_device_conversations import SCENES, VECTORS, random_talk, said, scene, taps, vouched
from tests.campaigns.test_wire_fuzz import fuzz

pytestmark = pytest.mark.usefixtures("c_compiler")

RECORDED = load(VECTORS)


@pytest.mark.parametrize("conversation", RECORDED, ids=lambda one: one.name)
def test_the_device_says_and_does_what_was_recorded(conversation: Conversation) -> None:
    """Every byte and every command, as `tests/campaigns/test_device_conversations.py` has recorded them."""
    assert conversation.differs(ProbedDevice(BOOT, simulated=True)) == ""


def test_much_is_said_in_these_conversations() -> None:
    """Else they would show little."""
    assert {play.__name__ for play in SCENES} < {one.name for one in RECORDED}
    found = set(said(RECORDED))
    assert {state.value for state in State} <= found
    assert {"HelloReply", "Done", "UploadReady", "Ack", "LeaseReply", "TelemetryData"} <= found
    assert {f"Event {what}" for what in ("contact", "finished", "lease_lost", "host_stop", "bad_sensor")} <= found
    assert sum(name.startswith("Refused") for name in found) >= 20
    assert {f"Refused {why}" for why in ("not_armed", "still_playing", "one_waveform", "not_at_rest")} <= found


def test_a_difference_would_be_seen() -> None:
    """A device of another start differs in its first answer, and the last bit of one command is seen."""
    (recorded,) = (one for one in RECORDED if one.name == taps.__name__)
    assert "tick 1: said" in recorded.differs(ProbedDevice(BOOT + 1, simulated=True))
    ticks = recorded.ticks.copy()
    playing = np.flatnonzero(ticks["state"] == b"playing")
    ticks["command_A"][playing[5]] = np.nextafter(ticks["command_A"][playing[5]], 9.0)
    changed = Conversation("changed", ticks, recorded.arrived, recorded.said)
    assert f"changed, tick {playing[5]}: Output" in changed.differs(ProbedDevice(BOOT, simulated=True))


def test_what_is_recorded_anew_is_kept_whole(tmp_path: Path) -> None:
    made = [scene(taps, vouched), random_talk(4, 0.1, 1, ticks=500)]
    save(tmp_path / "made.npz", made)
    for one, kept in zip(made, load(tmp_path / "made.npz"), strict=True):
        assert (one.name, one.arrived, one.said) == (kept.name, kept.arrived, kept.said)
        assert one.ticks.tobytes() == kept.ticks.tobytes()
        assert kept.differs(ProbedDevice(BOOT, simulated=True)) == ""


def test_corrupted_frames_are_neither_accepted_nor_seen_differently() -> None:
    counts = fuzz(5000, 0, core=Decoder())
    assert counts["rejected"] > 2500
    assert (counts["wrong"], counts["lost"], counts["differently"]) == (0, 0, 0)


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=1031).map(lambda data: b"\1" + data) | st.integers(1, 1032).map(lambda size: b"\1" * size))
def test_frames_are_those_of_the_python_side(payload: bytes) -> None:
    frame = encode(payload)
    assert frame == wire.encode(payload)
    assert Decoder().feed(frame) == [payload]
    assert crc32(payload) == zlib.crc32(payload)


@pytest.mark.parametrize("size", [253, 254, 255, 507, 508, 509, 1032])
@pytest.mark.parametrize("zero_at", [None, 1, -1, 250, 252])
def test_runs_at_the_edge_of_what_one_code_can_say(size: int, zero_at: int | None) -> None:
    payload = bytearray(b"\5" * size)
    if zero_at is not None:
        payload[zero_at] = 0
    assert encode(bytes(payload)) == wire.encode(bytes(payload))


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.binary(max_size=60) | st.sampled_from([b"\0", b"\xff" * 300, b"\1" * 1100, wire.encode(b"12345678")]))
)
def test_any_bytes_in_any_pieces_decode_alike(pieces: list[bytes]) -> None:
    python, core = wire.Decoder(), Decoder()
    for piece in [*pieces, b"\0"]:
        assert core.feed(piece) == python.feed(piece)


def test_sha256_of_every_length_about_its_blocks() -> None:
    data = np.random.default_rng(0).bytes(100_000)
    for size in (*range(200), len(data)):
        assert sha256(data[:size]) == hashlib.sha256(data[:size]).digest()


def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    (tmp_path / "talk").write_bytes(b"".join(one.talk() for one in RECORDED))
    files = [*sources(CORE), REPLAY / "td_probe.c", REPLAY / "talk_main.c"]
    need_clean("talk", files, tmp_path / "talk")


@pytest.mark.parametrize(("flags", "real_bytes"), [((), 8), (("-DTD_REAL_FLOAT",), 4)], ids=["double", "single"])
def test_the_host_session_brings_the_core_up_and_arms_it(flags: tuple[str, ...], real_bytes: int) -> None:
    """And the core goes safe within its lease when the host falls silent."""
    world, core = World(), ProbedDevice(100, flags=flags, simulated=True)
    world.device = core  # type: ignore[assignment]
    world.armed()
    assert world.session.device is not None
    assert world.session.device.real_bytes == real_bytes
    assert world.output.state is State.ARMED
    world.host_alive = False
    world.until(lambda: world.output.state is State.IDLE, 0.21)
    assert core.look().lost_frames == 0


def test_without_a_compiler_the_core_that_was_installed_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """The installed core has its usual size only: another size is compiled or refused."""
    if not core_device.INSTALLED.exists():
        pytest.skip("the package was installed without a compiler")
    monkeypatch.setenv("CC", "no-such-compiler")
    core_device.core_library.cache_clear()
    try:
        assert ProbedDevice(BOOT).look().boot == BOOT
        with pytest.raises(NoCompilerError, match="no-such-compiler"):
            ProbedDevice(BOOT, flags=("-DTD_MAX_LIBRARY_SAMPLES=300001",))
    finally:
        core_device.core_library.cache_clear()
