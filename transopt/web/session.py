"""Handles the requests of one window; a newer change replaces older ones that are not solved yet.

Every window has its own service and thread, so windows do not see each other's changes. A change that is being solved
is answered; of the changes that arrive meanwhile only the newest is. Replays and prices, which take long, are
abandoned as soon as a newer change arrives.
"""

import json
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import signal

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.files.unclear import joined
from transopt.report.tried import AskedError
from transopt.web.controls import following
from transopt.web.crew import Crew, service_name
from transopt.web.fields import choice, in_words
from transopt.web.frames import arrays, curves, frame
from transopt.web.opening import described, gallery, opened
from transopt.web.question import limit_for_error, movers
from transopt.web.service import Service
from transopt.web.shown import plain
from transopt.web.upload import Upload, uploadable

OF_A_SCENE = ("change", "ask", "sound", "save", "movers")  # requests about what the window shows
SOUND_RATE_HZ = 48000
CHOOSE = 'choose what is right, of what was tried on it, or fill in the fields under "how they are read"'
LOUDEST = 0.5  # recorded peak of the loudest tap over full scale: -6 dB of headroom for stronger curves

Send = Callable[[str | bytes], None]
Message = dict[str, Any]


class Session:
    """The session of one window.

    Parameters
    ----------
    opener : creates its service.
    send : sends a message to the browser; called from this session's thread.
    crew : processes that solve taps in parallel; by default none.
    """

    def __init__(self, opener: Callable[[], Service], send: Send, crew: Crew | None = None) -> None:
        self._opener, self._send, self._crew = opener, send, crew or Crew(0)
        self._waiting = threading.Condition()
        self._newest: Message | None = None
        self._others: deque[tuple[Message, bytes]] = deque()
        self._ended = False
        self._upload: Upload | None = None
        self._service_name = ""  # the crew's cache key of the service
        self._opened = 0  # scenes that this window has shown
        self.service: Service | None = None
        self.thread = threading.Thread(target=self._run, name="page", daemon=True)

    def start(self) -> None:
        self.thread.start()

    def put(self, message: Message, body: bytes = b"") -> None:
        """Queue a request of the browser."""
        with self._waiting:
            if message.get("type") == "change":  # it contains all changes, so earlier ones are dropped
                self._newest = message
            else:
                self._others.append((message, body))
            self._waiting.notify()

    def end(self) -> None:
        """End the session, as the window is closed."""
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
            self._take(None)

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
        """Run work and show its errors on the page, unexpected ones too; the window stays usable."""
        try:
            work()
        except InputError as error:
            words = str(error)
        except (KeyError, TypeError, ValueError) as error:  # a malformed request
            words = f"a request of the page was not understood ({type(error).__name__}): load the page again"
        except Exception as error:
            words = f"{type(error).__name__}: {error}: this is a fault of the program; please report it"
        else:
            return
        refusal = in_words(words, self.service)
        key = refusal.key if about == "change" else ""
        self._say(
            {"type": "refused", "about": about, "id": (message or {}).get("id"), "words": refusal.words, "key": key}
        )

    def _open(self) -> None:
        self._show(self._opener())

    def _show(self, service: Service, upload: Upload | None = None) -> None:
        """Switch to another service, and to the files that were dropped for it."""
        self.service, self._service_name = service, service_name()
        self._take(upload)
        self._opened += 1
        own = upload.names if upload else []
        head = {"type": "scene", "number": self._opened}
        self._say({**head, **described(service), "own": own, "takes": uploadable()})

    def _take(self, upload: Upload | None) -> None:
        if self._upload is not None:
            self._upload.close()
        self._upload = upload

    def _answer(self, message: Message, body: bytes) -> None:
        handlers: dict[str, Callable[[Message], None]] = {
            "change": self._change,
            "ask": self._ask,
            "sound": self._sound,
            "save": self._save,
            "movers": self._movers,
            "gallery": lambda _: self._say({"type": "gallery", "scenes": gallery()}),
            "glimpse": self._glimpse,
            "choose": self._choose,
            "reset": lambda _: self._open(),
        }
        kind = message["type"]
        if kind in OF_A_SCENE and message.get("scene", self._opened) != self._opened:
            return  # it was on its way while another scene was opened, and its taps and sliders are shown no more
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
        probe, winding, view = message.get("probe"), message.get("winding_C"), message.get("view_s")
        service.change(
            message["changes"],
            None if probe is None else (float(probe[0]), float(probe[1])),
            None if winding is None else float(winding),
        )
        order = service.order(int(message["selected"]))
        view_s = None if view is None else (float(view[0]), float(view[1]))
        places = [vars(place) for place in service.places]
        head = {"type": "curves", "id": number, "places": places, "following": following(service.scene)}
        # All taps in one frame, so that all displays show results of the same frame number.
        self._send(curves(head, self._crew.quick(self._service_name, service, order), view_s))
        if message.get("final"):
            self._settle(service, order, number)

    def _settle(self, service: Service, order: list[int], number: int) -> None:
        """Send every tap as an entry of a library, one after the other, until a newer request arrives."""
        for done, index in enumerate(order):
            if self._superseded:
                return
            self._say({"type": "progress", "words": "replaying and pricing", "done": done, "of": len(order)})
            self._say({"type": "settled", "id": number, "tap": plain(service.settled(index))})
        if not self._superseded:
            self._say({"type": "rested", "id": number})

    def _ask(self, message: Message) -> None:
        service = self._service()
        control = next((each for each in service.controls if each.key == message["key"]), None)
        if control is None:
            raise InputError(f"{message['key']}: no slider of this scene")
        self._say({"type": "progress", "words": "searching the limit", "done": 0, "of": 1})
        self._say(
            {
                "type": "answer",
                "key": control.key,
                **vars(limit_for_error(service, self._index(message), control, float(message["tap_error"]))),
            }
        )

    def _movers(self, message: Message) -> None:
        """Send the numbers that change the error of a tap, unless a newer request arrives."""
        service, index = self._service(), self._index(message)
        found = movers(service, index, lambda: self._superseded or bool(self._others))
        if found is not None:
            self._say({"type": "movers", "tap": index, "movers": [vars(each) for each in found]})
        elif not self._superseded and all(other["type"] != "movers" for other, _ in list(self._others)):
            self.put(message)  # try again after the newer requests

    def _choose(self, message: Message) -> None:
        """Switch to another built-in scene."""
        chosen = opened(str(message["name"]))
        self._opener = chosen.another
        self._open()

    def _glimpse(self, message: Message) -> None:
        """Send the last tap of a built-in scene, for its picture in the gallery."""
        service = opened(str(message["name"]))
        found = service.quick([len(service.places) - 1])
        head = {"type": "glimpse", "name": message["name"], "window_end_s": service.grid.end_s}
        self._send(curves(head, found))

    def _index(self, message: Message) -> int:
        index = int(message["tap"])
        if not 0 <= index < len(self._service().places):
            raise InputError(f"tap {index}: no tap has this number: choose another")
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
            self._file(f"{service.scene.name}.toml", service.text.encode(), "text/plain")
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
        service = self._service()
        upload = Upload(message, body)
        try:
            taken = upload.service(service)
        except BaseException as error:
            upload.close()
            if not isinstance(error, AskedError):
                raise
            self._ask_which(error, upload.reading)
            return
        self._show(taken, upload)

    def _ask_which(self, asked: AskedError, reading: Mapping[str, Any]) -> None:
        """Ask which answer to what dropped files leave open is right; each comes with how the files are then read."""
        choices = [
            {"words": f"{choice(answer)}: {read}", "reading": joined(reading, answer)} for answer, read in asked.good
        ]
        words = in_words(f"{asked.problem}: {CHOOSE}", self.service).words
        self._say({"type": "refused", "about": "drop", "words": words, "choices": choices})
