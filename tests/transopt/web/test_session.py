"""One window's conversation, without a web server."""

import json
import queue
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from transopt.base.errors import InputError
from transopt.scene.file import read_scene
from transopt.scene.scene import Scene
from transopt.web.frames import frame, parted
from transopt.web.service import Service
from transopt.web.session import Session, safe_name

RECORDINGS = Path(__file__).parents[3] / "problems/recordings"
WAIT_S = 60.0


class Window:
    """A session and what it has said."""

    def __init__(self, scene: Scene) -> None:
        self.said: queue.Queue[str | bytes] = queue.Queue()
        self.session = Session(lambda: Service(scene), self.said.put)
        self.session.start()

    def until(self, kind: str, **having: Any) -> tuple[dict[str, Any], bytes]:
        while True:
            said = self.said.get(timeout=WAIT_S)
            message, body = (json.loads(said), b"") if isinstance(said, str) else parted(said)
            assert message["type"] != "refused" or kind == "refused", message
            if message["type"] == kind and all(message.get(name) == value for name, value in having.items()):
                return message, body


@pytest.fixture
def window(small: Scene) -> Iterator[Window]:
    opened = Window(small)
    opened.until("scene")
    yield opened
    opened.session.end()
    opened.session.thread.join(WAIT_S)
    assert not opened.session.thread.is_alive()


def change(number: int, final: bool = False, **changes: float) -> dict[str, Any]:
    values = {f"limits.{key}": value for key, value in changes.items()}
    return {"type": "change", "id": number, "changes": values, "selected": 1, "probe": None, "final": final}


def test_the_selected_tap_comes_first_and_the_curves_with_it(window: Window) -> None:
    window.session.put(change(1, current_A=3.0))
    first, body = window.until("curves", id=1)
    assert [tap["index"] for tap in first["taps"]] == [1]
    names = [name for name, _ in first["arrays"]]
    assert names[:2] == ["times_s", "1.recorded_m_s2"]
    sizes = dict(first["arrays"])
    values = np.frombuffer(body, dtype="<f4")
    assert values.size == sum(sizes.values())
    before = sum(sizes[name] for name in names[: names.index("1.input")])
    assert np.abs(values[before : before + sizes["1.input"]]).max() == pytest.approx(3.0, abs=1e-4)
    rest, _ = window.until("curves", id=1)
    assert rest["last"]
    assert [tap["index"] for tap in rest["taps"]] == [0]


def test_the_newest_change_wins_and_no_value_is_lost(small: Scene) -> None:
    # Everything is put before the session begins to look.
    said: queue.Queue[str | bytes] = queue.Queue()
    session = Session(lambda: Service(small), said.put)
    session.put(change(1, current_A=2.0))
    session.put(change(2, velocity_m_s=3.0))
    session.put(change(3, current_A=3.5))
    session.start()
    numbers = []
    while not numbers or not numbers[-1][1]:
        message = said.get(timeout=WAIT_S)
        if isinstance(message, bytes):
            head, _ = parted(message)
            numbers.append((head["id"], head["last"]))
    assert {number for number, _ in numbers} == {3}
    assert session.service is not None
    assert session.service.scene.limits.current_A == pytest.approx(3.5)
    assert session.service.scene.limits.velocity_m_s == pytest.approx(3.0)
    session.end()
    session.thread.join(WAIT_S)


def test_at_rest_every_tap_is_replayed_and_the_sliders_are_told(window: Window) -> None:
    window.session.put(change(1, final=True, current_A=3.0))
    settled = [window.until("settled")[0]["tap"] for _ in range(2)]
    assert all(tap["replayed"] for tap in settled)
    assert "current 3 A" in settled[0]["price"]
    rested, _ = window.until("rested")
    assert {"limits.current_A", "weights.rho"} <= {control["key"] for control in rested["controls"]}


def test_a_refusal_says_why_and_the_window_goes_on(window: Window) -> None:
    window.session.put(change(1, current_A=1e3))
    refused, _ = window.until("refused")
    assert "i_peak_A" in refused["words"]
    assert refused["id"] == 1
    for odd in ({"type": "change", "id": 2}, {"type": "nothing"}, {"type": "sound", "tap": 99}, {"type": "ask"}):
        window.session.put(odd)
        assert window.until("refused")[0]["words"]
    window.session.put(change(3, current_A=3.0))
    assert window.until("curves", id=3)


def test_the_saved_scene_is_the_one_on_the_page(window: Window, tmp_path: Path) -> None:
    window.session.put(change(1, current_A=3.25))
    window.until("curves", last=True)
    window.session.put({"type": "save", "what": "scene"})
    head, body = window.until("file")
    (tmp_path / "saved.toml").write_bytes(body)
    saved = read_scene(tmp_path / "saved.toml")
    assert head["name"] == f"{saved.name}.toml"
    assert window.session.service is not None
    assert saved == window.session.service.scene


def test_the_saved_library_is_whole(window: Window, tmp_path: Path) -> None:
    window.session.put({"type": "save", "what": "library"})
    head, body = window.until("file")
    (tmp_path / head["name"]).write_bytes(body)
    from transopt.library.proven import load_proven

    assert load_proven(tmp_path / head["name"]).tap_error.shape == (2, 1)


def test_all_three_sounds_have_one_gain(window: Window) -> None:
    window.session.put({"type": "sound", "tap": 1})
    head, body = window.until("sound")
    sizes = dict(head["arrays"])
    assert list(sizes) == ["recorded", "clipped", "optimum"]
    recorded, clipped, optimum = np.split(np.frombuffer(body, dtype="<f4"), np.cumsum(list(sizes.values()))[:-1])
    assert np.abs(recorded).max() == pytest.approx(0.5, rel=0.05)  # the loudest tap of the scene, after resampling
    assert np.abs(optimum).max() < np.abs(recorded).max()
    assert not np.allclose(clipped, optimum)


def drop(*files: tuple[str, bytes]) -> tuple[dict[str, Any], bytes]:
    listed = [[name, len(content)] for name, content in files]
    return parted(frame({"type": "drop", "files": listed, "speed_m_s": None}, b"".join(c for _, c in files)))


def test_dropped_taps_are_designed_for_and_the_scenes_own_come_back(window: Window) -> None:
    content = (RECORDINGS / "tap_0.3_m_s.csv").read_bytes()
    window.session.put(*drop(("../../etc/tap 1.csv", content)))
    scene, _ = window.until("scene")
    assert scene["own"] == ["______etc_tap_1.csv"]
    assert len(scene["places"]) == 1
    window.session.put({"type": "save", "what": "scene"})
    _, saved = window.until("file")
    assert b'folder = "."' in saved
    window.session.put({"type": "reset"})
    assert len(window.until("scene")[0]["places"]) == 2


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("tap.csv", b"nothing of a tap\n", "tap.csv"),
        ("tap.exe", b"MZ", "no recording"),
        ("tap.wav", b"RIFF", "tap.wav"),
        ("tap.npz", b"PK\x03\x04", "tap.npz"),
    ],
)
def test_a_file_that_is_no_tap_is_refused_by_its_name(window: Window, name: str, content: bytes, words: str) -> None:
    window.session.put(*drop((name, content)))
    said = window.until("refused")[0]["words"]
    assert words in said
    assert "/tmp" not in said
    window.session.put(change(1, current_A=3.0))
    assert window.until("curves", id=1)


def test_names_are_made_safe_and_stay_apart() -> None:
    assert safe_name("a/b.CSV", []) == "a_b.csv"
    assert safe_name("a.b.csv", ["a_b.csv"]) == "a_b_.csv"
    assert safe_name(".csv", []) == "tap.csv"
    with pytest.raises(InputError, match="no recording"):
        safe_name("tap", [])
    with pytest.raises(InputError, match="load the page again"):
        parted(b"\xff\xff\xff\xff")
