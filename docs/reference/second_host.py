"""A host written from the page of the protocol: play one tap. Usage: second_host.py PORT CONFIGURATION IMAGE."""

import hashlib
import os
import random
import select
import socket
import struct
import sys
import time
import tty
import zlib
from pathlib import Path

MAGIC, PROTOCOL = 0x54504E54, 3
FORMATS = {"configuration": (0x46434E54, 3), "image": (0x4D494E54, 2)}
HELLO, CONFIGURE, CONFIGURE_COMMIT, UPLOAD_BEGIN, DATA, COMMIT, ARM, LEASE, DISARM = range(1, 10)
EVIDENCE, EVENT_ACK = 14, 15
HELLO_REPLY, DONE, REFUSED, UPLOAD_READY, ACK, LEASE_REPLY, EVENT = range(64, 71)
EVIDENCE_REPLY = 73
FINISHED, LEASE_LOST = 2, 32
NOT_AT_REST = 9  # a reason of REFUSED
PART, LEASE_MS = 1020, 500
REMEDY = "bring host and firmware to one version"


def cobs(data: bytes) -> bytes:
    """Every zero replaced by the distance to the next one."""
    out = bytearray()
    for block in data.split(b"\0"):
        whole = len(block) // 254 * 254
        for at in range(0, whole, 254):
            out += b"\xff" + block[at : at + 254]
        out += bytes([len(block) - whole + 1]) + block[whole:]
    return bytes(out)


def uncobs(data: bytes) -> bytes:
    """The inverse of `cobs`; what was damaged fails the checksum later."""
    out = bytearray()
    while data:
        code = data[0]
        out += data[1:code]
        data = data[code:] if code else b""
        if data and code < 255:
            out.append(0)
    return bytes(out)


class Host:
    """One session with one device."""

    def __init__(self, port: str) -> None:
        if port.startswith("socket://"):
            name, number = port.removeprefix("socket://").rsplit(":", 1)
            self.socket = socket.create_connection((name, int(number)), 5.0)
            self.line = self.socket.fileno()
        else:
            self.line = os.open(port, os.O_RDWR | os.O_NOCTTY)
            tty.setraw(self.line)
        self.session, self.sequence = random.randrange(1, 2**32), 0
        self.arrived, self.wanted, self.leased, self.over = b"", 0, 0.0, False

    def send(self, kind: int, body: bytes = b"") -> None:
        payload = struct.pack("<BBHI", kind, 0, self.sequence, self.session) + body
        frame = cobs(payload + struct.pack("<I", zlib.crc32(payload))) + b"\0"
        while frame:
            frame = frame[os.write(self.line, frame) :]

    def receive(self, seconds: float) -> list[tuple[int, int, bytes]]:
        """What arrived: kind, sequence, body. Events are printed and acknowledged here."""
        if select.select([self.line], [], [], seconds)[0]:
            data = os.read(self.line, 65536)
            if not data:
                raise SystemExit("the device has closed the line: start it again")
            self.arrived += data
        *frames, self.arrived = self.arrived.split(b"\0")
        found = []
        for payload in map(uncobs, frames):
            if len(payload) < 12 or zlib.crc32(payload[:-4]) != int.from_bytes(payload[-4:], "little"):
                continue
            kind, _, sequence, session = struct.unpack_from("<BBHI", payload)
            body = payload[8:-4]
            if kind == EVENT:
                self.event(body)
            elif session == self.session:
                found.append((kind, sequence, body))
        return found

    def event(self, body: bytes) -> None:
        number, tick, code, _, speed, grip = struct.unpack("<IQBHdd", body)
        if number == self.wanted:
            print(f"event {number} at tick {tick}: code {code}, {speed:.3f} m/s, {grip:.2f} N", flush=True)
            self.wanted, self.over = number + 1, self.over or code == FINISHED
            if code >= LEASE_LOST:
                raise SystemExit(f"the device stopped with event {code}: remove its cause, then start again")
        self.send(EVENT_ACK, struct.pack("<I", self.wanted))

    def ask(self, kind: int, body: bytes = b"", answer: int = DONE) -> bytes:
        """One request and its answer; sent again with the same sequence when nothing comes."""
        self.sequence = (self.sequence + 1) % 2**16
        for _ in range(10):
            self.send(kind, body)
            end = time.monotonic() + 0.5
            while (left := end - time.monotonic()) > 0:
                for got, sequence, content in self.receive(left):
                    if sequence == self.sequence and got == answer:
                        return content
                    if sequence == self.sequence and got == REFUSED:
                        if (kind, content[1]) == (ARM, NOT_AT_REST):
                            return b""
                        raise SystemExit(
                            f"request {kind} was refused for reason {content[1]}: see the page's reasons"
                        )
        raise SystemExit(f"no answer to request {kind}: check the port")

    def hello(self) -> None:
        reply = self.ask(HELLO, struct.pack("<IHI", MAGIC, PROTOCOL, random.randrange(2**32)), HELLO_REPLY)
        magic, protocol = struct.unpack_from("<IH", reply.ljust(6, b"\0"))
        if (magic, protocol) != (MAGIC, PROTOCOL):
            raise SystemExit(f"the device speaks protocol {protocol}, this host {PROTOCOL}: {REMEDY}")
        if len(reply) < 64 + 31:
            raise SystemExit(f"no device of this protocol answers: {REMEDY}")
        self.wanted = struct.unpack_from("<I", reply, 27)[0]
        print(f"device holds configuration {reply[-64:-56].hex()}, image {reply[-32:-24].hex()}")
        print(f"evidence: bits {self.ask(EVIDENCE, b'', EVIDENCE_REPLY)[0]}")

    def give(self, configuration: bytes, image: bytes) -> None:
        for at in range(0, len(configuration), PART):
            self.ask(CONFIGURE, struct.pack("<I", at) + configuration[at : at + PART])
        self.ask(CONFIGURE_COMMIT, hashlib.sha256(configuration).digest())
        begin = struct.pack("<I", len(image)) + hashlib.sha256(image).digest()
        wanted = int.from_bytes(self.ask(UPLOAD_BEGIN, begin, UPLOAD_READY), "little")
        end = time.monotonic() + 60.0
        while wanted < len(image) and time.monotonic() < end:
            self.send(DATA, struct.pack("<I", wanted) + image[wanted : wanted + PART])
            acks = [int.from_bytes(body, "little") for kind, _, body in self.receive(0.5) if kind == ACK]
            wanted = max([wanted, *acks])
        self.ask(COMMIT)

    def play(self, configuration: bytes, image: bytes, seconds: float = 30.0) -> int:
        hashes = hashlib.sha256(configuration).digest() + hashlib.sha256(image).digest()
        end = time.monotonic() + seconds
        while not self.ask(ARM, struct.pack("<BHd", 0, LEASE_MS, 1.0) + hashes):
            if time.monotonic() > end:
                raise SystemExit("the stylus does not come to rest: hold it still, then start again")
            self.receive(0.02)
        while not self.over and time.monotonic() < end:
            if time.monotonic() - self.leased > LEASE_MS / 4e3:
                self.leased = time.monotonic()
                self.send(LEASE, struct.pack("<Q", int(1e6 * self.leased)))
            self.receive(0.05)
        self.ask(DISARM)
        return 0 if self.over else 1


def main(arguments: list[str]) -> int:
    if len(arguments) != 3:
        raise SystemExit("usage: second_host.py PORT CONFIGURATION IMAGE")
    port, *paths = arguments
    configuration, image = (Path(path).read_bytes() for path in paths)
    for (name, (magic, version)), data in zip(FORMATS.items(), (configuration, image), strict=True):
        found = struct.unpack_from("<IH", data.ljust(6, b"\0"))
        if found != (magic, version):
            raise SystemExit(f"the {name} is of version {found[1]}, this host sends {version}: export it again")
    host = Host(port)
    host.hello()
    host.give(configuration, image)
    return host.play(configuration, image)


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except (OSError, KeyboardInterrupt) as error:
        print(f"stopped: {error}", file=sys.stderr)
        sys.exit(2)
    except SystemExit as stop:
        if isinstance(stop.code, str):
            print(stop.code, file=sys.stderr)
            sys.exit(2)
        raise
