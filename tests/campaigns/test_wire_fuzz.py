"""Damaged frames by the million: none is taken for another one, none makes the decoder fail.

    python -m pytest -m long -n 0 tests/campaigns/test_wire_fuzz.py
        --campaign="[--frames 1000000] [--seed 0] [--endpoints]"

Frames of random length and content are hit in 2 to 4 bytes, cut, lengthened, or merged with the next, and given to
the host's decoder and to the compiled core's in pieces of random size. Whatever they then take for a sound frame must
be one that was sent, and the same for both. `--endpoints` puts the damaged frames to a device and a session as well:
neither may fail, and the device must stay without a command. It fails if a frame was accepted wrongly, seen
differently, or lost after the damage.
"""

import random
import time
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import cycle
from typing import Annotated

from typer import Option

from controller.host.session import Session
from controller.host.session_states import OVER
from controller.protocol import messages as m
from controller.protocol.codes import Kind
from controller.protocol.wire import DELIMITER, PAYLOAD_LIMIT, Decoder, encode
from controller.servo.interface import Readings
from tests.benches.probed import Decoder as CoreDecoder
from tests.benches.probed import ProbedDevice
from tests.campaigns.harness import Seed, at_least, long_form

Damage = Callable[[bytes, bytes, random.Random], bytes]
BATCH = 200  # frames between two that must come through


def hit(frame: bytes, following: bytes, chance: random.Random) -> bytes:
    """2 to 4 bytes changed, delimiters among them."""
    data = bytearray(frame)
    for _ in range(chance.randint(2, 4)):
        data[chance.randrange(len(data))] ^= chance.randint(1, 255)
    return bytes(data)


def cut(frame: bytes, following: bytes, chance: random.Random) -> bytes:
    """Some bytes missing."""
    first = chance.randrange(len(frame))
    return frame[:first] + frame[first + chance.randint(1, 8) :]


def lengthen(frame: bytes, following: bytes, chance: random.Random) -> bytes:
    """Some bytes put in."""
    place = chance.randrange(len(frame))
    return frame[:place] + chance.randbytes(chance.randint(1, 8)) + frame[place:]


def merge(frame: bytes, following: bytes, chance: random.Random) -> bytes:
    """The beginning of one frame and the end of another."""
    return frame[: chance.randrange(len(frame))] + following[chance.randrange(len(following)) :]


DAMAGES: tuple[Damage, ...] = (hit, cut, lengthen, merge)


def random_payload(chance: random.Random) -> bytes:
    """Short ones as most are, long ones as an upload's, many zeros as in a waveform's tail; the first is a kind's."""
    first = bytes([chance.randint(1, 255)])
    size = chance.choice((1, chance.randint(1, 40), chance.randint(1, PAYLOAD_LIMIT), 254, PAYLOAD_LIMIT))
    if chance.random() < 0.3:
        return first + bytes(chance.choice((0, 0, 0, 1, 255)) for _ in range(min(size, 64)))
    return first + chance.randbytes(size - 1)


def random_frame(chance: random.Random) -> bytes:
    """A message of a random kind with a random body, of one of few sessions."""
    kind = chance.choice(list(Kind))
    message = m.MESSAGES[kind]
    body = chance.randbytes(message.FORMAT.size + (chance.randint(0, 30) if message.OPEN else 0))
    return m.HEADER.pack(kind, 0, chance.randint(0, 3), chance.randint(0, 2)) + body


def pieces(stream: bytes, chance: random.Random) -> Iterator[bytes]:
    """Pieces of a stream as a port hands them out."""
    place = 0
    while place < len(stream):
        size = chance.choice((1, chance.randint(1, 64), chance.randint(1, 4096)))
        yield stream[place : place + size]
        place += size


def fuzz(
    frames: int,
    seed: int,
    payload: Callable[[random.Random], bytes] = random_payload,
    ends: tuple[Callable[[bytes], object], ...] = (),
    core: CoreDecoder | None = None,
) -> Counter[str]:
    """Counts of frames sent damaged, passed unharmed all the same, taken wrongly, and of sound ones lost.

    Parameters
    ----------
    payload : what is sent.
    ends : more places to put the damaged stream.
    core : another decoder; the pieces of which it takes something else than the host's are counted, too.
    """
    chance, decoder, counts = random.Random(seed), Decoder(), Counter[str]()
    while counts["damaged"] < frames:
        batch = min(BATCH, frames - counts["damaged"])
        sent = [payload(chance) for _ in range(batch + 1)]
        encoded = [encode(x) for x in sent]
        damages = [chance.choice(DAMAGES) for _ in range(batch)]
        stream = b"".join(
            damage(frame, following, chance)
            for damage, frame, following in zip(damages, encoded[:-1], encoded[1:], strict=True)
        )
        # After whatever came, a delimiter and a sound frame: that one must come through.
        stream += DELIMITER + encoded[-1]
        taken = []
        for piece in pieces(stream, chance):
            found = decoder.feed(piece)
            taken += found
            counts["differently"] += core is not None and core.feed(piece) != found
            for end in ends:
                end(piece)
        counts["damaged"] += batch
        counts["unharmed"] += len(taken) - 1
        counts["lost"] += not taken or taken[-1] != sent[-1]
        known = set(sent)
        counts["wrong"] += sum(x not in known for x in taken)
    counts["rejected"] = decoder.bad_frames
    return counts


class Ends:
    """A device and a session, connected with each other, that get what is left of the frames.

    Attributes
    ----------
    greetings : how often the session had to connect anew. driven : ticks with a command.
    """

    def __init__(self) -> None:
        sessions = cycle((1, 2))
        self.device, self.session = ProbedDevice(1, simulated=True), Session(lambda: next(sessions))
        self.tick = self.greetings = self.driven = 0
        self._greet()

    def __call__(self, data: bytes) -> None:
        self._step(data)
        self.session.receive(data, self._now_s)
        if self.session.state in OVER:
            self._greet()
        self.session.bytes_to_send(self._now_s)

    @property
    def _now_s(self) -> float:
        return self.tick * 1e-4

    def _step(self, data: bytes) -> bytes:
        self.device.receive(data)
        self.driven += self.device.step(Readings(self.tick, 200, 3.0, 0.0, 0.0)).command_A != 0.0
        self.tick += 1
        return self.device.bytes_to_send()

    def _greet(self) -> None:
        self.session.connect(self._now_s)
        reply = self._step(DELIMITER + self.session.bytes_to_send(self._now_s))
        self.session.receive(reply, self._now_s)
        self.greetings += 1


def main(
    frames: Annotated[int, at_least(1, "damaged ones")] = 1_000_000,
    seed: Seed = 0,
    endpoints: Annotated[bool, Option("--endpoints", help="put them to a device and a session, too")] = False,
) -> int:
    started, ends = time.perf_counter(), Ends()
    of_ends = (random_frame, (ends,)) if endpoints else ()
    counts = fuzz(frames, seed, *of_ends, core=CoreDecoder())
    print(
        f"{counts['damaged']} damaged frames in {time.perf_counter() - started:.0f} s: {counts['rejected']} pieces "
        f"rejected,\n{counts['unharmed']} frames unharmed all the same, {counts['wrong']} accepted wrongly, "
        f"{counts['differently']} pieces seen differently,\n{counts['lost']} sound frames lost after damage, "
        f"{ends.driven} ticks with a command"
    )
    return 1 if counts["wrong"] or counts["lost"] or counts["differently"] or ends.driven else 0


test_long_form = long_form(main)
