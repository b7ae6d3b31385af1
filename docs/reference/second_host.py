"""A host written from the page of the protocol: play one tap. Usage: second_host.py PORT CONFIGURATION IMAGE."""

import hashlib
import random
import struct
import sys
import time
import zlib
from pathlib import Path

import serial

MAGIC, PROTOCOL = 0x54504E54, 6
FORMATS = {"configuration": (0x46434E54, 3), "image": (0x4D494E54, 3)}
HELLO, CONFIGURE, CONFIGURE_COMMIT, UPLOAD_BEGIN, DATA, COMMIT, ARM, LEASE, DISARM = range(1, 10)
HELLO_REPLY, DONE, REFUSED, UPLOAD_READY, ACK, LEASE_REPLY, EVENT = range(64, 71)
EVENT_ACK, FINISHED, LEASE_LOST, NOT_AT_REST = 15, 2, 32, 9
PART, LEASE_MS = 1020, 500
REMEDY = "bring host and firmware to one version"


def cobs(data: bytes) -> bytes:
    """Every zero replaced by the distance to the next one, and a zero at the end."""
    out = b""
    for block in data.split(b"\0"):
        whole = len(block) // 254 * 254
        for at in range(0, whole, 254):
            out += b"\xff" + block[at : at + 254]
        out += bytes([len(block) - whole + 1]) + block[whole:]
    return out + b"\0"


def uncobs(data: bytes) -> bytes:
    """The inverse of `cobs`; what was damaged fails the checksum later."""
    out = b""
    while data and data[0]:
        code, out, data = data[0], out + data[1 : data[0]], data[data[0] :]
        out += b"\0" if data and code < 255 else b""
    return out


class Host:
    """One session with one device."""

    def __init__(self, port: str) -> None:
        self.line = serial.serial_for_url(port, timeout=0.02)
        self.session, self.sequence = random.randrange(1, 2**32), 0
        self.arrived, self.wanted, self.opened, self.leased, self.over = b"", 0, -1, 0.0, False

    def send(self, kind: int, body: bytes = b"") -> None:
        payload = struct.pack("<BBHI", kind, 0, self.sequence, self.session) + body
        self.line.write(cobs(payload + struct.pack("<I", zlib.crc32(payload))))

    def receive(self) -> list[tuple[int, int, bytes]]:
        """What arrived: kind, sequence, body. Events are printed and acknowledged here."""
        *frames, self.arrived = (self.arrived + self.line.read(self.line.in_waiting or 1)).split(b"\0")
        found = []
        for payload in map(uncobs, frames):
            if len(payload) < 12 or zlib.crc32(payload[:-4]) != int.from_bytes(payload[-4:], "little"):
                continue
            kind, _, sequence, session = struct.unpack_from("<BBHI", payload)
            if kind == EVENT and self.opened >= 0:  # one that came too early is sent again
                self.event(payload[8:-4])
            elif session == self.session:
                found.append((kind, sequence, payload[8:-4]))
        return found

    def event(self, body: bytes) -> None:
        number, tick, code, _, speed, grip, _, _ = struct.unpack("<IQBHdddd", body)
        if number == self.wanted:
            print(f"event {number} at tick {tick}: code {code}, {speed:.3f} m/s, {grip:.2f} N", flush=True)
            self.wanted, self.over = number + 1, self.over or (code == FINISHED and tick > self.opened)
        self.send(EVENT_ACK, struct.pack("<I", self.wanted))
        if code >= LEASE_LOST and tick > self.opened:
            raise SystemExit(f"the device stopped with event {code}: remove its cause, then start again")

    def ask(self, kind: int, body: bytes = b"", answer: int = DONE) -> bytes:
        """One request and its answer; sent again with the same sequence when nothing comes."""
        self.sequence = (self.sequence + 1) % 2**16
        for _ in range(10):
            self.send(kind, body)
            end = time.monotonic() + 0.5
            while time.monotonic() < end:
                for got, sequence, content in self.receive():
                    if (got, sequence) == (answer, self.sequence):
                        return content
                    if (got, sequence) == (REFUSED, self.sequence) and (kind, content[1]) == (ARM, NOT_AT_REST):
                        return b""
                    if (got, sequence) == (REFUSED, self.sequence):
                        raise SystemExit(f"request {kind} was refused for reason {content[1]}: see the reasons")
        raise SystemExit(f"no answer to request {kind}: check the port")

    def upload(self, image: bytes, sha256: bytes, seconds: float) -> None:
        begin = self.ask(UPLOAD_BEGIN, struct.pack("<I", len(image)) + sha256, UPLOAD_READY)
        has, end = int.from_bytes(begin, "little"), time.monotonic() + seconds
        while has < len(image) and time.monotonic() < end:
            self.send(DATA, struct.pack("<I", has) + image[has : has + PART])
            has = max([has, *(int.from_bytes(body, "little") for kind, _, body in self.receive() if kind == ACK)])
        self.ask(COMMIT)

    def play(self, configuration: bytes, image: bytes, seconds: float = 30.0) -> None:
        reply = self.ask(HELLO, struct.pack("<IHI", MAGIC, PROTOCOL, random.randrange(2**32)), HELLO_REPLY)
        magic, protocol = struct.unpack_from("<IH", reply.ljust(6, b"\0"))
        if (magic, protocol) != (MAGIC, PROTOCOL) or len(reply) < 95:
            raise SystemExit(f"the device speaks protocol {protocol}, this host {PROTOCOL}: {REMEDY}")
        (self.wanted,), (self.opened,) = struct.unpack_from("<I", reply, 27), struct.unpack_from("<Q", reply, 47)

        hashes = hashlib.sha256(configuration).digest(), hashlib.sha256(image).digest()
        if reply[-64:-32] != hashes[0]:  # the one in force keeps its evidence and its surface
            for at in range(0, len(configuration), PART):
                self.ask(CONFIGURE, struct.pack("<I", at) + configuration[at : at + PART])
            self.ask(CONFIGURE_COMMIT, hashes[0])
        if reply[-64:] != b"".join(hashes):
            self.upload(image, hashes[1], seconds)

        end = time.monotonic() + seconds
        while not self.ask(ARM, struct.pack("<BHd", 0, LEASE_MS, 1.0) + b"".join(hashes)):
            if time.monotonic() > end:
                raise SystemExit("the stylus does not come to rest: hold it still, then start again")
        while not self.over and time.monotonic() < end:
            if time.monotonic() - self.leased > LEASE_MS / 4e3:
                self.leased = time.monotonic()
                self.send(LEASE, struct.pack("<Q", int(1e6 * self.leased)))
            self.receive()
        self.ask(DISARM)
        if not self.over:
            raise SystemExit(f"no tap in {seconds:.0f} s: start again and tap the surface")


def main(port: str, *paths: str) -> None:
    given = [Path(path).read_bytes() for path in paths]
    for (name, (magic, version)), data in zip(FORMATS.items(), given, strict=True):
        found = struct.unpack_from("<IH", data.ljust(6, b"\0"))
        if found != (magic, version):
            raise SystemExit(f"the {name} is of version {found[1]}, this host sends {version}: export it again")
    Host(port).play(*given)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        raise SystemExit(__doc__)
    try:
        main(*sys.argv[1:])
    except (OSError, KeyboardInterrupt) as error:
        raise SystemExit(f"stopped: {error}") from None
