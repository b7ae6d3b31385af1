"""One window's conversation: requests come in, answers go out, and the newest change takes the place of older ones.

Every window has its own service and its own thread, so that two of them never see each other's changes. A change that
has begun to be solved is answered; of those that came meanwhile only the newest is. What takes long, the replays and
prices of a slider at rest, is given up as soon as there is a newer one.
"""

import json
import re
import tempfile
import threading
from collections import deque
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import signal

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.scene.written import scene_text
from transopt.web.crew import Crew, service_name
from transopt.web.frames import arrays, curves, frame
from transopt.web.question import asked
from transopt.web.service import Service, described, own_taps, plain

SUFFIXES = (".csv", ".txt", ".mat", ".npz", ".wav")
MOST_FILES = 200
MOST_UPLOAD_BYTES = 16 * 2**20
SOUND_RATE_HZ = 48000
LOUDEST = 0.5  # of full scale, the recorded peak of the scene's loudest tap: -6 dB leave room for what is stronger

Send = Callable[[str | bytes], None]
Message = dict[str, Any]


class Session:
    """A window.

    Parameters
    ----------
    opener : makes its service.
    send : takes what goes to the browser; called from this session's thread.
    crew : solves several taps side by side; by default nobody does.
    """

    def __init__(self, opener: Callable[[], Service], send: Send, crew: Crew | None = None) -> None:
        self._opener, self._send, self._crew = opener, send, crew or Crew(0)
        self._waiting = threading.Condition()
        self._newest: Message | None = None
        self._others: deque[tuple[Message, bytes]] = deque()
        self._ended = False
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._names: list[str] = []
        self._service_name = ""  # by which the crew knows the service
        self.service: Service | None = None
        self.thread = threading.Thread(target=self._run, name="page", daemon=True)

    def start(self) -> None:
        self.thread.start()

    def put(self, message: Message, body: bytes = b"") -> None:
        """A request of the browser."""
        with self._waiting:
            if message.get("type") == "change":
                before = self._newest or {}
                # The values of a change that nobody has looked at yet are still meant.
                merged = {**before.get("changes", {}), **message.get("changes", {})}
                self._newest = {**message, "changes": merged}
            else:
                self._others.append((message, body))
            self._waiting.notify()

    def end(self) -> None:
        """The window is closed."""
        with self._waiting:
            self._ended = True
            self._waiting.notify()

    @property
    def _superseded(self) -> bool:
        return self._ended or self._newest is not None

    def _say(self, message: Message) -> None:
        self._send(json.dumps(message))

    def _run(self) -> None:
        try:
            self._guarded("open", self._open)
            while (request := self._next()) is not None:
                message, body = request
                self._guarded(str(message.get("type")), partial(self._answer, message, body), message)
        finally:
            if self._folder is not None:
                self._folder.cleanup()

    def _next(self) -> tuple[Message, bytes] | None:
        with self._waiting:
            while not (self._ended or self._newest or self._others):
                self._waiting.wait()
            if self._ended:
                return None
            if self._newest is not None:
                message, self._newest = self._newest, None
                return message, b""
            return self._others.popleft()

    def _guarded(self, about: str, work: Callable[[], None], message: Message | None = None) -> None:
        """What a user can cause is said on the page; what nobody foresaw is too, and the window goes on."""
        try:
            work()
        except InputError as error:
            words = str(error)
        except (KeyError, TypeError, ValueError) as error:  # a request that no page of ours makes
            words = f"a request of the page was not understood ({type(error).__name__}): load the page again"
        except Exception as error:
            words = f"{type(error).__name__}: {error}: this is a fault of the program; please report it"
        else:
            return
        self._say({"type": "refused", "about": about, "id": (message or {}).get("id"), "words": words})

    def _open(self) -> None:
        self.service, self._service_name = self._opener(), service_name()
        self._describe()

    def _describe(self) -> None:
        assert self.service is not None
        self._say({"type": "scene", **described(self.service), "own": self._names})

    def _answer(self, message: Message, body: bytes) -> None:
        handlers: dict[str, Callable[[Message], None]] = {
            "change": self._change,
            "ask": self._ask,
            "sound": self._sound,
            "save": self._save,
            "reset": lambda _: self._reset(),
        }
        kind = message["type"]
        if kind == "drop":
            self._drop(message, body)
        else:
            handlers[kind](message)

    def _service(self) -> Service:
        if self.service is None:
            raise InputError("no scene is open: start `transopt page` with one that can be read")
        return self.service

    def _change(self, message: Message) -> None:
        service, number = self._service(), message["id"]
        probe, winding = message.get("probe"), message.get("winding_C")
        before = service.places
        service.change(
            message["changes"],
            None if probe is None else (float(probe[0]), float(probe[1])),
            None if winding is None else float(winding),
        )
        if service.places != before:
            self._say({"type": "places", "places": [vars(place) for place in service.places]})
        order = service.order(int(message["selected"]))
        found = self._crew.quick(self._service_name, service, order)
        self._send(curves({"type": "curves", "id": number, "last": len(order) == 1}, [next(found)]))
        if rest := list(found):
            self._send(curves({"type": "curves", "id": number, "last": True}, rest))
        if message.get("final"):
            self._settle(service, order, number)

    def _settle(self, service: Service, order: list[int], number: int) -> None:
        """Every tap as a library has it, one after the other, until something newer is asked for."""
        for done, index in enumerate(order):
            if self._superseded:
                return
            self._say({"type": "progress", "words": "replaying and pricing", "done": done, "of": len(order)})
            self._say({"type": "settled", "id": number, "tap": plain(service.settled(index))})
        if not self._superseded:
            self._say({"type": "rested", "id": number, "controls": [vars(each) for each in service.controls]})

    def _ask(self, message: Message) -> None:
        service = self._service()
        control = next((each for each in service.controls if each.key == message["key"]), None)
        if control is None:
            raise InputError(f"{message['key']}: no slider of this scene")
        self._say({"type": "progress", "words": "searching the limit", "done": 0, "of": 1})
        found = asked(service, self._index(message), control, float(message["tap_error"]))
        self._say({"type": "answer", "key": control.key, "value": found.value, "words": found.words})

    def _index(self, message: Message) -> int:
        index = int(message["tap"])
        if not 0 <= index < len(self._service().places):
            raise InputError(f"tap {index}: there is none of that number: choose another")
        return index

    def _sound(self, message: Message) -> None:
        service = self._service()
        loudest = max(np.abs(r.target.window_m_s2).max() for r in service.references(service.scene))
        ratio = Fraction(SOUND_RATE_HZ * service.grid.dt_s).limit_denominator(1000)

        def sound(acceleration: FloatArray) -> FloatArray:
            heard = signal.resample_poly(acceleration, ratio.numerator, ratio.denominator)
            return np.asarray(heard * (LOUDEST / loudest if loudest > 0 else 0.0))

        made = service.accelerations(self._index(message))
        head = {"type": "sound", "rate_Hz": SOUND_RATE_HZ, "tap": message["tap"]}
        self._send(arrays(head, [(name, sound(values)) for name, values in made.items()]))

    def _save(self, message: Message) -> None:
        service = self._service()
        if message["what"] == "scene":
            scene = service.scene
            if self._names:  # they were dropped on the page, and lie beside the scene from now on
                scene = scene.model_copy(update={"recordings": scene.recordings.model_copy(update={"folder": "."})})
            self._file(f"{scene.name}.toml", scene_text(scene).encode(), "text/plain")
            return
        library = service.library(
            lambda done, of: self._say({"type": "progress", "words": "building the library", "done": done, "of": of})
        )
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "library.npz"
            library.save(path)
            self._file("library.npz", path.read_bytes(), "application/octet-stream")

    def _file(self, name: str, content: bytes, kind: str) -> None:
        self._send(frame({"type": "file", "name": name, "kind": kind}, content))

    def _drop(self, message: Message, body: bytes) -> None:
        """Files of a user's own, in one body one after the other: the browser's names are never opened."""
        service, listed = self._service(), message["files"]
        if not listed or len(listed) > MOST_FILES:
            raise InputError(f"{len(listed)} files dropped: from 1 to {MOST_FILES} at once")
        if len(body) > MOST_UPLOAD_BYTES:
            raise InputError(f"the files have {len(body)} bytes, at most {MOST_UPLOAD_BYTES}: drop fewer at once")
        if sum(int(size) for _, size in listed) != len(body):
            raise InputError("the files did not arrive whole: drop them again")
        folder = tempfile.TemporaryDirectory()
        try:
            names: list[str] = []
            at = 0
            for name, size in listed:
                safe = safe_name(str(name), names)
                (Path(folder.name) / safe).write_bytes(body[at : at + int(size)])
                names.append(safe)
                at += int(size)
            speed = message.get("speed_m_s")
            try:
                taken = own_taps(service.opened, Path(folder.name), names, None if speed is None else float(speed))
                taken.change(service.changes)
            except InputError as error:
                raise InputError(str(error).replace(f"{folder.name}/", "")) from None
        except BaseException:
            folder.cleanup()
            raise
        if self._folder is not None:
            self._folder.cleanup()
        self._folder, self._names, self.service, self._service_name = folder, names, taken, service_name()
        self._describe()

    def _reset(self) -> None:
        self._names = []
        self._open()


def safe_name(name: str, taken: list[str]) -> str:
    """A file's name of letters, digits, dashes and underscores, with one of the suffixes that are read.

    Raises
    ------
    InputError : another suffix.
    """
    stem, dot, suffix = name.rpartition(".")
    suffix = f"{dot}{suffix}".lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{name[:80]}: no recording: files of taps end in {', '.join(SUFFIXES)}")
    safe = re.sub(r"[^A-Za-z0-9_-]", "_", stem)[:60] or "tap"
    while f"{safe}{suffix}" in taken:
        safe += "_"
    return f"{safe}{suffix}"
