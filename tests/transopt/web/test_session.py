"""One window's conversation, without a web server."""

import codecs
import json
import queue
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from transopt.base.errors import InputError
from transopt.recordings.plausible import PEAK_G
from transopt.scene.builtin import FOLDER, load_scene, scene_path
from transopt.scene.file import read_scene
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.web.frames import frame, parted
from transopt.web.opening import opened as opened_scene
from transopt.web.service import Service
from transopt.web.session import Session
from transopt.web.upload import safe_name

RECORDINGS = Path(__file__).parents[3] / "problems/recordings"
WAIT_S = 60.0


class Window:
    """A session and what it has said."""

    def __init__(self, scene: Scene, text: str = "") -> None:
        self.said: queue.Queue[str | bytes] = queue.Queue()
        self.session = Session(lambda: Service(scene, text=text), self.said.put)
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


def test_all_taps_come_in_one_frame_the_selected_first(window: Window) -> None:
    window.session.put(change(1, current_A=3.0))
    found, body = window.until("curves", id=1)
    assert [tap["index"] for tap in found["taps"]] == [1, 0]
    assert [place["speed_m_s"] for place in found["places"]] == [0.2, 0.4]
    names = [name for name, _ in found["arrays"]]
    assert names[:2] == ["times_s", "1.recorded_m_s2"]
    sizes = dict(found["arrays"])
    values = np.frombuffer(body, dtype="<f4")
    assert values.size == sum(sizes.values())
    before = sum(sizes[name] for name in names[: names.index("1.input")])
    assert np.abs(values[before : before + sizes["1.input"]]).max() == pytest.approx(3.0, abs=1e-4)


def arrays_of(found: dict[str, Any], body: bytes) -> dict[str, Any]:
    ends = np.cumsum([size for _, size in found["arrays"]])
    parts = np.split(np.frombuffer(body, dtype="<f4"), ends[:-1])
    return {name: part for (name, _), part in zip(found["arrays"], parts, strict=True)}


@pytest.mark.parametrize("view_s", [(0.005, 0.01), (-1.0, 0.002), (-1.0, 1.0), (2.0, 3.0), (0.00501, 0.00502)])
def test_while_a_slider_moves_only_samples_that_are_looked_at_come(
    window: Window, view_s: tuple[float, float]
) -> None:
    window.session.put(change(1, current_A=3.0))
    head = window.until("curves", id=1)
    window.session.put({**change(2, current_A=3.0), "view_s": view_s})
    seen_head = window.until("curves", id=2)
    whole, seen = arrays_of(*head), arrays_of(*seen_head)
    times_s = whole["times_s"]
    assert head[0]["whole_s"] == seen_head[0]["whole_s"] == [times_s[0], times_s[-1]]
    assert seen_head[0]["taps"] == head[0]["taps"]
    inside = np.flatnonzero((times_s >= view_s[0]) & (times_s <= view_s[1]))
    at = np.flatnonzero(np.isin(times_s, seen["times_s"]))
    assert set(inside) <= set(at)
    assert 2 <= at.size <= inside.size + 2
    for name in ("0.recorded_m_s2", "1.optimum_m_s2", "1.input"):
        np.testing.assert_allclose(seen[name], whole[name][at], rtol=0, atol=1e-6)


def test_the_newest_change_wins_and_is_all_there_is(small: Scene) -> None:
    # Everything is put before the session begins to look.
    said: queue.Queue[str | bytes] = queue.Queue()
    session = Session(lambda: Service(small), said.put)
    session.put(change(1, current_A=2.0, velocity_m_s=3.0))
    session.put(change(2, current_A=2.5, stroke_m=0.01))
    session.put(change(3, current_A=3.5, velocity_m_s=3.0))
    session.start()
    message: str | bytes = ""
    while not isinstance(message, bytes):
        message = said.get(timeout=WAIT_S)
    assert parted(message)[0]["id"] == 3
    assert session.service is not None
    limits = session.service.scene.limits
    assert (limits.current_A, limits.velocity_m_s, limits.stroke_m) == (3.5, 3.0, None)
    session.end()
    session.thread.join(WAIT_S)


def test_every_tap_is_replayed_at_rest_and_limits_that_follow_are_told_at_once(window: Window, small: Scene) -> None:
    window.session.put(change(1, final=True, current_A=3.0))
    following = window.until("curves")[0]["following"]
    assert following == {"limits.current_A": 3.0, "limits.beta": pytest.approx(3.0 / small.limits.steady_input)}
    settled = [window.until("settled")[0]["tap"] for _ in range(2)]
    assert all(tap["replayed"] for tap in settled)
    (dearest, *_) = settled[0]["prices"]
    assert "current 3 A" in dearest["sentence"]
    assert dearest["now"] in [bound for bound, _ in dearest["points"]]
    assert window.until("rested")[0]["id"] == 1


def test_a_refusal_says_why_and_the_window_goes_on(window: Window) -> None:
    window.session.put(change(1, current_A=1e3))
    refused, _ = window.until("refused")
    assert "the motor's peak current" in refused["words"]
    assert refused["id"] == 1
    for odd in ({"type": "change", "id": 2}, {"type": "nothing"}, {"type": "sound", "tap": 99}, {"type": "ask"}):
        window.session.put(odd)
        assert window.until("refused")[0]["words"]
    window.session.put(change(3, current_A=3.0))
    assert window.until("curves", id=3)


def test_a_request_about_the_scene_before_is_left_unanswered(window: Window) -> None:
    window.session.put({"type": "reset"})
    assert window.until("scene")[0]["number"] == 2
    for late in ({"type": "movers", "tap": 99}, {"type": "sound", "tap": 99}, change(1, current_A=1e3)):
        window.session.put({**late, "scene": 1})
    window.session.put({**change(2, current_A=3.0), "scene": 2})
    assert window.until("curves")[0]["id"] == 2  # nothing was refused before


@pytest.mark.parametrize("written", [True, False], ids=["as its file has it", "without a file"])
def test_the_saved_scene_is_the_one_on_the_page_and_keeps_its_comments(tmp_path: Path, written: bool) -> None:
    opened = opened_scene("own_taps" if written else load_scene("own_taps"))
    window = Window(opened.opened, opened.source)
    window.until("scene")
    window.session.put(change(1, current_A=3.25))
    window.until("curves")
    window.session.put({"type": "save", "what": "scene"})
    head, body = window.until("file")
    text = body.decode()
    (tmp_path / "saved.toml").write_text(text)
    saved = read_scene(tmp_path / "saved.toml", search=[FOLDER])
    assert head["name"] == f"{saved.name}.toml"
    assert window.session.service is not None
    beside = with_values(window.session.service.scene, {"recordings.folder": str(tmp_path / "recordings")})
    assert saved == beside
    assert str(FOLDER) not in text
    assert ("# servo period" in text) is written
    assert ("# beta = 3.2" in text) is written
    window.session.end()


def test_a_scene_as_editors_on_windows_save_it_keeps_its_comments(tmp_path: Path) -> None:
    text = scene_path("own_taps").read_text(encoding="utf-8").replace('"../', f'"{FOLDER.as_posix()}/')
    marked = tmp_path / "marked.toml"
    marked.write_bytes(codecs.BOM_UTF8 + text.replace("\n", "\r\n").encode())
    opened = opened_scene(marked)
    window = Window(opened.opened, opened.source)
    window.until("scene")
    window.session.put({"type": "save", "what": "scene"})
    _, body = window.until("file")
    assert "# servo period" in body.decode()
    window.session.end()


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


def drop(*files: tuple[str, bytes], **fields: Any) -> tuple[dict[str, Any], bytes]:
    listed = [[name, len(content)] for name, content in files]
    return parted(frame({"type": "drop", "files": listed, **fields}, b"".join(c for _, c in files)))


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
        ("tap.exe", b"MZ", "not a recording"),
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


@pytest.mark.parametrize(
    ("asked", "words", "key"),
    [
        ({"current_A": -1.0}, "current = -1", "limits.current_A"),
        ({"current_A": 1e3}, "above the motor's peak current of 10 A: lower it to 10 or less", "limits.current_A"),
        ({"supply_V": 0.0}, "supply = 0", "limits.supply_V"),
    ],
)
def test_a_refusal_calls_things_as_the_page_does(
    window: Window, asked: dict[str, float], words: str, key: str
) -> None:
    window.session.put(change(1, **asked))
    refused, _ = window.until("refused")
    assert words in refused["words"]
    assert refused["key"] == key
    assert "limits." not in refused["words"]
    assert "_A" not in refused["words"]


def test_a_recording_is_read_as_the_fields_of_the_page_say(window: Window) -> None:
    times = np.arange(-0.02, 0.09, 1e-4)
    pulse = np.where((times > 0) & (times < 3e-3), 160 * np.sin(np.pi * times / 3e-3), 0.0)
    text = "p,q\n" + "\n".join(f"{t:.4f},{a:.3f}" for t, a in zip(times, pulse, strict=True))
    file, stated = ("odd.csv", text.encode()), {"columns": "time [s], acc [m/s^2]"}
    window.session.put(*drop(file))
    units = dict(refused(window, "odd.csv: unknown column 'p'"))
    reading = next(each for words, each in units.items() if words.startswith("p in s, q in m/s^2: 10 kHz, a peak of"))
    peaks_g = [float(words.rpartition("a peak of ")[2].split()[0]) for words in units]
    assert max(peaks_g) <= PEAK_G[1]  # what no tap has is not among the answers while another is
    window.session.put(*drop(file, reading=reading))
    assert refused(window, "odd.csv: no incoming speed")[0][1]["units"] == reading["units"]  # what was answered stays
    window.session.put(*drop(file, **stated))
    speeds = refused(window, "odd.csv: no incoming speed")
    assert speeds[0][0].startswith("speed 0.2 m/s: 10 kHz")
    window.session.put(*drop(file, **stated, speed_m_s=0.01))
    assert ("the numbers are right", "accept") in [
        (words.partition(":")[0], reading.get("implausible")) for words, reading in refused(window, "odd.csv: ")
    ]
    window.session.put(*drop(file, reading={**reading, "speed_m_s": 0.3}))
    assert window.until("scene")[0]["places"][0]["speed_m_s"] == pytest.approx(0.3)


def refused(window: Window, words: str) -> list[tuple[str, dict[str, Any]]]:
    """The choices of a refusal that begins with these words, each with words and what is then stated."""
    said = window.until("refused")[0]
    assert said["words"].startswith(words)
    assert "--" not in said["words"]
    assert "recordings." not in said["words"]
    return [(each["words"], each["reading"]) for each in said["choices"]]


def test_other_scenes_are_looked_at_and_chosen(window: Window) -> None:
    window.session.put({"type": "gallery"})
    listed = window.until("gallery")[0]["scenes"]
    assert {"name": "lra_click", "description": load_scene("lra_click").description} in listed
    window.session.put({"type": "glimpse", "name": "lra_click"})
    head, _ = window.until("glimpse")
    assert head["taps"][0]["certified"]
    window.session.put({"type": "choose", "name": "lra_click"})
    assert window.until("scene")[0]["name"] == "lra_click"
    window.session.put({"type": "choose", "name": "../lra_click"})
    assert "no built-in scene" in window.until("refused")[0]["words"]


def test_what_can_move_an_error_is_told(window: Window) -> None:
    window.session.put({"type": "movers", "tap": 1})
    movers = {each["key"]: each for each in window.until("movers")[0]["movers"]}
    assert movers["limits.current_A"]["best"] < movers["limits.current_A"]["worst"]
    assert "thermal.ambient_C" not in movers


def test_names_are_made_safe_and_stay_apart() -> None:
    assert safe_name("a/b.CSV", []) == "a_b.csv"
    assert safe_name("a.b.csv", ["a_b.csv"]) == "a_b_.csv"
    assert safe_name(".csv", []) == "tap.csv"
    with pytest.raises(InputError, match="not a recording"):
        safe_name("tap", [])
    with pytest.raises(InputError, match="load the page again"):
        parted(b"\xff\xff\xff\xff")
