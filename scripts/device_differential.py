"""The device in C against the device in Python, byte for byte: random conversations and corrupted frames.

    python scripts/device_differential.py [--conversations 200] [--frames 1000000] [--seed 0] [--write FILE]

Both get the same bytes and readings; what they say and what they command must be the same in every tick. Of the
corrupted frames none may be taken for a sound one, and both decoders must agree about every one. Exit code 1 if
something is off. --write keeps the conversations in a file for `controller/firmware/replay/talk_main.c`.
"""

import argparse
import math
import struct
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from campaign.conversations import conversation, damaged_frame

from controller.device.endpoint import Device
from controller.firmware.core_device import CoreDevice
from controller.firmware.core_device import Decoder as CoreDecoder
from controller.firmware.replay import counts_of
from controller.protocol import messages as m
from controller.protocol.codes import REASONS
from controller.protocol.wire import Decoder, encode
from controller.servo.interface import Output, Readings
from transopt.base.errors import InputError

TICKS = 4000  # of one conversation
DAMAGES = (0.0, 0.02, 0.3)  # parts of the frames that arrive damaged, in turn
FETCHES = (1, 1, 1, 40, 2500)  # ticks from one look at what the device said to the next, in turn
ANOTHER_DEVICE = b"\xff\xff\xff\xff"
BOOT = 1


@dataclass
class Talk:
    """What came of some conversations.

    Attributes
    ----------
    different : words for each conversation in which the two were not the same. said : by kind, how often.
    record : the conversations as `talk_main.c` reads them.
    """

    ticks: int = 0
    different: list[str] = field(default_factory=list)
    said: Counter[str] = field(default_factory=Counter)
    record: bytearray = field(default_factory=bytearray)

    def hold(self, seed: int, ticks: int, damage: float) -> None:
        """One conversation with both."""
        python, core, listener = Device(BOOT), CoreDevice(BOOT), Decoder()
        self.record += ANOTHER_DEVICE
        for data, readings in conversation(seed, ticks, damage):
            self.record += record_of(data, readings)
            python.receive(data)
            core.receive(data)
            outputs = python.step(readings), core.step(readings)
            fetched = readings.tick % FETCHES[seed % len(FETCHES)] == 0
            said = (python.bytes_to_send(), core.bytes_to_send()) if fetched else (b"", b"")
            self.ticks += 1
            self._count(listener.feed(said[0]), outputs[0])
            if said[0] != said[1] or not same(*outputs):
                self.different.append(f"conversation {seed}, tick {readings.tick}: {outputs}, {said}")
                return

    def _count(self, payloads: list[bytes], output: Output) -> None:
        self.said[output.state.value] += 1
        for payload in payloads:
            message = m.read_frame(payload).message
            refused = f" {REASONS[message.reason].name.lower()}" if isinstance(message, m.Refused) else ""
            self.said[type(message).__name__ + refused] += 1


def record_of(data: bytes, readings: Readings) -> bytes:
    r = readings
    numbers = struct.pack(
        "<iIddd", counts_of(r.encoder_counts), r.emergency_stop, r.grip_N, r.current_A, r.acceleration_m_s2
    )
    return struct.pack("<I", len(data)) + data + numbers


def same(one: Output, other: Output) -> bool:
    """Whether two answers are; events go over the wire, and NaN is like NaN."""
    pairs = ((one.command_A, other.command_A), (one.feedback_A, other.feedback_A), (one.winding_C, other.winding_C))
    return one.state is other.state and all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in pairs)


def corrupted(frames: int, seed: int) -> tuple[int, int]:
    """(taken for sound, seen differently) of so many corrupted frames, each followed by a sound one."""
    random = np.random.default_rng([seed, 22])
    python, core = Decoder(), CoreDecoder()
    accepted = different = 0
    sound = encode(b"12345678sound")
    for _ in range(frames):
        payload = b"\1" + random.bytes(int(random.integers(7, 79)))  # a kind is not 0
        frame = encode(payload)
        damaged = damaged_frame(random, frame)
        # A delimiter first ends whatever the damage has left open.
        heard = [decoder.feed(damaged + b"\0" + sound) for decoder in (python, core)]
        different += heard[0] != heard[1]
        # Damage may spare the frame: a delimiter lost at its end, or one put before it.
        taken = [found for found in heard[1][:-1] if found != payload]
        accepted += len(taken) + (heard[1][-1:] != [b"12345678sound"])
    return accepted, different


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--conversations", type=int, default=200)
    parser.add_argument("--frames", type=int, default=1_000_000, help="corrupted ones")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", type=Path, metavar="FILE", help="keep the conversations for talk_main.c")
    arguments = parser.parse_args()
    if min(arguments.conversations, arguments.frames, arguments.seed) < 0:
        parser.error("--conversations, --frames and --seed must be at least 0")
    talk = Talk()
    try:
        for j in range(arguments.conversations):
            talk.hold(1000 * arguments.seed + j, TICKS, DAMAGES[j % len(DAMAGES)])
        accepted, different = corrupted(arguments.frames, arguments.seed)
    except InputError as error:
        parser.error(str(error))
    print(
        f"{arguments.conversations} conversations, {talk.ticks} ticks, {len(talk.different)} in which the two differ"
    )
    print("said: " + ", ".join(f"{name} {count}" for name, count in talk.said.most_common()))
    for words in talk.different[:5]:
        print(f"  DIFFERENT {words}"[:1000])
    print(f"{arguments.frames} corrupted frames: {accepted} accepted wrongly, {different} seen differently")
    if arguments.write is not None:
        arguments.write.write_bytes(bytes(talk.record))
    return 1 if talk.different or accepted or different else 0


if __name__ == "__main__":
    sys.exit(main())
