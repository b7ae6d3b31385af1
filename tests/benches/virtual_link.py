"""A serial link in virtual time that can delay, lose, damage and repeat frames, and be unplugged.

Bytes stay in order. Faults affect whole frames when they are sent, drawn by a seeded generator, so runs repeat.
"""

import random
from collections import Counter, deque
from dataclasses import dataclass

from controller.protocol.wire import DELIMITER
from controller.sim.port import Line


@dataclass(frozen=True, slots=True)
class Trouble:
    """Disturbances of one direction.

    Attributes
    ----------
    latency_s : delay of every byte; jitter_s : largest additional delay, without overtaking.
    loss, corruption, repetition : probability per frame. A damaged frame has 1 to 4 bytes changed, cut or inserted.
    """

    latency_s: float = 0.0
    jitter_s: float = 0.0
    loss: float = 0.0
    corruption: float = 0.0
    repetition: float = 0.0


def damaged(frame: bytes, chance: random.Random) -> bytes:
    """The frame with 1 to 4 random errors: a byte changed (even to the delimiter), removed, or inserted."""
    data = bytearray(frame)
    for _ in range(chance.randint(1, 4)):
        place = chance.randrange(len(data)) if data else 0
        hit = chance.choice(("change", "cut", "insert"))
        if hit == "change" and data:
            data[place] = (data[place] + chance.randint(1, 255)) % 256
        elif hit == "cut" and data:
            del data[place]
        else:
            data.insert(place, chance.randrange(256))
    return bytes(data)


class Direction:
    """One direction of a link.

    Attributes
    ----------
    kinds : number of frames sent so far, by kind.
    """

    def __init__(self, trouble: Trouble, chance: random.Random) -> None:
        self.trouble, self._chance = trouble, chance
        self.kinds = Counter[int]()
        self._under_way: deque[tuple[float, bytes]] = deque()
        self._last_s = 0.0

    def send(self, data: bytes, now_s: float) -> None:
        if not data:
            return
        t, chance = self.trouble, self._chance
        for piece in data.split(DELIMITER)[:-1]:
            frame = piece + DELIMITER
            # The kind is never 0, so COBS leaves it unchanged after the first code byte.
            self.kinds.update(piece[1:2])
            if chance.random() < t.loss:
                continue
            if chance.random() < t.corruption:
                frame = damaged(frame, chance)
            copies = 2 if chance.random() < t.repetition else 1
            self._last_s = max(self._last_s, now_s + t.latency_s + t.jitter_s * chance.random())
            self._under_way.append((self._last_s, frame * copies))

    def arrived(self, now_s: float) -> bytes:
        if not self._under_way or self._under_way[0][0] > now_s:  # fast path: true at most instants
            return b""
        out = []
        while self._under_way and self._under_way[0][0] <= now_s:
            out.append(self._under_way.popleft()[1])
        return b"".join(out)

    def clear(self) -> None:
        self._under_way.clear()


class Link(Line):
    """Both directions of a link; while not `connected` everything is lost, frames in transit included."""

    def __init__(self, trouble: Trouble | None = None, seed: int = 0) -> None:
        chance = random.Random(seed)
        calm = Trouble() if trouble is None else trouble
        self.to_device, self.to_host = Direction(calm, chance), Direction(calm, chance)
        self.connected = True

    def set_trouble(self, trouble: Trouble) -> None:
        self.to_device.trouble = self.to_host.trouble = trouble

    def unplug(self) -> None:
        self.connected = False
        self.to_device.clear()
        self.to_host.clear()

    def plug(self) -> None:
        self.connected = True

    def host_sends(self, data: bytes, now_s: float) -> None:
        if self.connected:
            self.to_device.send(data, now_s)

    def device_sends(self, data: bytes, now_s: float) -> None:
        if self.connected:
            self.to_host.send(data, now_s)

    def at_device(self, now_s: float) -> bytes:
        return self.to_device.arrived(now_s)

    def at_host(self, now_s: float) -> bytes:
        return self.to_host.arrived(now_s)
