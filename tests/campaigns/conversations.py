"""Random talk of a host, sensible, foolish and damaged, for two devices that must answer it alike."""

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from controller.protocol import messages as m
from controller.protocol.codes import Kind
from controller.protocol.configuration import CONFIGURATION_BYTES, HEADER, NAMES, configuration_of
from controller.protocol.image import IMAGE_FIELDS, image_of, sha256
from controller.protocol.packed import Packed
from controller.protocol.wire import encode
from controller.servo.interface import Readings
from controller.servo.settings import Settings
from controller.waveforms.bank import Bank, Method
from tests.campaigns.parity_runs import (
    COUNT_M,
    DT_S,
    TAIL,
    Random,
    draw_amplifier,
    draw_bank,
    draw_settings,
    falsified,
    stored,
)
from transopt.plant.amplifier import Amplifier
from transopt.plant.wall import Wall

NUMBERS = (math.nan, math.inf, -1.0, 0.0, -0.0, 0.5, 1.0, 2.0, 33.0, 1e5, 1e300, -1e300, 5e-324)
TELEMETRY = ((0, 0), (1, 0), (1, 50), (2, 0), (7, 300), (100, 0), (65535, 0))  # every, before
CHUNK = 300  # bytes of a configuration in one frame


def damaged_configuration(random: Random, data: bytes) -> bytes:
    """One number of the table another one, or a byte of its head."""
    if random.uniform() < 0.1:
        at = int(random.integers(HEADER.size))
        return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]
    at = HEADER.size + 8 * int(random.integers(len(NAMES)))
    (value,) = struct.unpack_from("<d", data, at)
    # Not so little that it passes: then the core computes with what came, Python with what it works out itself.
    others = (*NUMBERS, value * 1.001, -value, value + 1.0)
    return data[:at] + struct.pack("<d", float(random.choice(others))) + data[at + 8 :]


def damaged_image(random: Random, data: bytes) -> bytes:
    """A field of the header another value, a number of the tables, a sample, or a piece missing."""
    kind = random.uniform()
    if kind < 0.5:
        at = 0
        for _, form in IMAGE_FIELDS[: int(random.integers(len(IMAGE_FIELDS)))]:
            at += struct.calcsize("<" + form)
        return data[:at] + bytes([data[at] ^ int(random.choice([1, 2, 128, 255]))]) + data[at + 1 :]
    if kind < 0.7:
        at = m.HEADER.size * 7 + 8 * int(random.integers(12))
        return data[:at] + struct.pack("<d", float(random.choice(NUMBERS))) + data[at + 8 :]
    if kind < 0.9:
        at = len(data) - 2 * int(random.integers(1, 30))
        return data[:at] + struct.pack("<h", int(random.choice([1, -32768, 32767]))) + data[at + 2 :]
    return data[: int(random.choice([0, 40, 55, 56, len(data) - 1]))]


def damaged_frame(random: Random, frame: bytes) -> bytes:
    """Bytes flipped, lost, doubled or made up."""
    data = bytearray(frame)
    kind = random.uniform()
    if kind < 0.6:
        for _ in range(int(random.integers(1, 5))):
            data[int(random.integers(len(data)))] ^= int(random.integers(1, 256))
    elif kind < 0.75:
        del data[int(random.integers(len(data)))]
    elif kind < 0.9:
        data.insert(int(random.integers(len(data))), int(random.integers(256)))
    else:
        data = bytearray(random.bytes(int(random.integers(1, 2500))))
    return bytes(data)


def odd_settings(random: Random, settings: Settings) -> Settings:
    """Sound ones, some of which ask for more than a device has."""
    wall = Wall(100.0, 0.0, 1.25, int(random.choice([31, 32, 10**6])), 100.0)
    changes: tuple[dict[str, Any], ...] = (
        {"window_ticks": int(random.choice([4, 256, 257, 10**6]))},
        {"encoder_limit_counts": int(random.choice([1, 1 << 29, (1 << 29) + 1, 10**12]))},
        {"current_limit_A": float(random.choice([1e-3, 10.0, 10.001, 1e9]))},
        {"amplifier": Amplifier(float(random.choice([1e-12, 1.0, 1e9])), 0.0, float(random.choice([6.0, 11.0])))},
        {"amplifier": None},
        {"wall": wall, "host_starts": False},
        {"coil": None},
        {"stuck_s": float(random.choice([1e-9, 3600.0, 3601.0]))},
        {"rearm_s": 1e300},
        {"no_current_s": 1.5 * DT_S},
        {"dt_s": 2 * DT_S},
        {"lead_s": float(random.choice([0.0, 1.0, 1e200]))},
        {"over_current": 1e308},
        {"grip_filter_s": float(random.choice([DT_S, 0.5 * DT_S, 1.0]))},
        {"host_starts": not settings.host_starts, "wall": None},
    )
    return replace(settings, **changes[int(random.integers(len(changes)))])


def table_of(settings: Settings) -> bytes:
    """The settings' numbers."""
    return configuration_of(settings)


def odd_image(random: Random, settings: Settings) -> bytes:
    """Sound ones, of sizes at the edge of what a device holds."""
    nv, ng, N = ((1, 1, 20_000), (1, 1, 20_001), (64, 1, 12), (65, 1, 12), (1, 65, 12), (14, 1, 19_000))[
        int(random.integers(6))
    ]
    norms = np.zeros((nv, ng)).tolist()
    axes = np.linspace(0.1, 1.0, nv).tolist(), np.linspace(0.5, 5.0, ng).tolist()
    table = Bank(Method.BILINEAR, *axes, np.zeros((nv, ng, N)), norms, norms, 0.5, True, False)
    return image_of(table, settings.dt_s, settings.lead_s, TAIL)


def excited(settings: Settings, table: Bank) -> tuple[Settings, Bank]:
    """The first waveform of a table as an excitation that the host starts."""
    first = replace(
        table,
        speeds_m_s=table.speeds_m_s[:1],
        grips_N=table.grips_N[:1],
        command_A=table.command_A[:1, :1],
        transient_A=[table.transient_A[0][:1]],
        feedback_A=[table.feedback_A[0][:1]],
        cool_command_A=None,
        cool_transient_A=[],
    )
    return replace(settings, host_starts=True, wall=None), first


class Host:
    """Says one thing after the other; what it says depends on nothing but the random numbers."""

    def __init__(self, random: Random) -> None:
        self.random = random
        self.session, self.sequence, self.host_us = 1, 0, 0
        self.acknowledges = bool(random.uniform() < 0.7)
        amplifier = draw_amplifier(random)
        self.settings = draw_settings(random, amplifier, free=False)
        table = draw_bank(random, amplifier, free=False)
        if random.uniform() < 0.4:
            self.settings, table = excited(self.settings, table)
        peak = float(np.max(np.abs(table.command_A)))
        size = random.uniform(0.3, 1.1) * min(self.settings.current_limit_A, 6.0) / peak
        table.command_A[:] *= size
        if table.cool_command_A is not None:
            table.cool_command_A[:] *= size
        self.configuration = configuration_of(self.settings)
        self.image = stored(self.settings, table, TAIL)

    def frame(self, message: Packed, *, sequence: int | None = None, session: int | None = None) -> bytes:
        if sequence is None:
            self.sequence = (self.sequence + 1) % 0x10000
            sequence = self.sequence
        payload = m.Frame(sequence, self.session if session is None else session, message).payload()
        return encode(payload)

    def lease(self, drawn: int, *, sequence: int | None = None) -> bytes:
        """A heartbeat, by a sixteenth of the draws an old one that comes again."""
        self.host_us += 1 + drawn // 2**20 if drawn % 16 else 0
        return self.frame(m.Lease(self.host_us), sequence=sequence)

    def hello(self) -> list[bytes]:
        self.session = int(self.random.integers(1 << 32))
        return [self.frame(m.Hello(m.MAGIC, m.PROTOCOL, int(self.random.integers(1 << 32))))]

    def configure(self, data: bytes) -> list[bytes]:
        parts = [self.frame(m.Configure(at, data[at : at + CHUNK])) for at in range(0, len(data), CHUNK)]
        return [*parts, self.frame(m.ConfigureCommit(sha256(data)))]

    def upload(self, image: bytes) -> list[bytes]:
        at = range(0, len(image), m.DATA_LIMIT)
        parts = [self.frame(m.Data(j, image[j : j + m.DATA_LIMIT]), sequence=0) for j in at]
        return [self.frame(m.UploadBegin(len(image), sha256(image))), *parts, self.frame(m.Commit())]

    def arm(self, **others: object) -> list[bytes]:
        said: dict[str, object] = {
            "trial": 0,
            "lease_ms": 200,
            "gain": 1.0,
            "configuration_sha256": sha256(self.configuration),
            "library_sha256": sha256(self.image),
        }
        return [self.frame(m.Arm(**{**said, **others}))]  # type: ignore[arg-type]

    def bring_up(self) -> list[bytes]:
        """All that leads to ARMED."""
        evidence = self.frame(m.Evidence())
        start = [*self.hello(), *self.configure(self.configuration), *self.upload(self.image)]
        # Time passes between them: a device knows of a rest only after it has read for a while.
        meanwhile = [self.lease(1, sequence=0) for _ in range(60)]
        return [*start, self.frame(m.Surface(0.0)), evidence, *meanwhile, *self.arm()]

    def odd_arm(self) -> list[bytes]:
        random = self.random
        return self.arm(
            **{
                str(random.choice(["trial"])): int(random.integers(3)),
                "lease_ms": int(random.choice([0, 49, 50, 200, 1000, 1001, 65535])),
                "gain": float(random.choice([*NUMBERS, 0.1])),
                **({"library_sha256": random.bytes(32)} if random.uniform() < 0.2 else {}),
                **({"configuration_sha256": random.bytes(32)} if random.uniform() < 0.2 else {}),
            }
        )

    def odd_frame(self) -> list[bytes]:
        """Sound in its CRC, wrong otherwise."""
        random = self.random
        kind = int(random.choice([*Kind, 16, 18, 63, 73, 255]))
        flags = int(random.uniform() < 0.1)
        body = random.bytes(int(random.integers(0, 200)))
        if kind in (Kind.HELLO, Kind.HELLO_REPLY) and random.uniform() < 0.8:
            magic, protocol = (m.MAGIC, m.PROTOCOL + 1) if random.uniform() < 0.5 else (1, m.PROTOCOL)
            body = struct.pack("<IH", magic, protocol) + body
        session = self.session if random.uniform() < 0.8 else 7
        return [encode(m.HEADER.pack(kind, flags, int(random.integers(1 << 16)), session) + body)]

    def repeated(self) -> list[bytes]:
        sequence = (self.sequence - int(self.random.integers(0, 3))) % 0x10000
        return [self.frame(m.Telemetry(3, 0), sequence=sequence)]

    def say(self) -> list[bytes]:
        """One thing, as frames."""
        random, frame = self.random, self.frame
        number = float(random.choice([*NUMBERS, 0.05, -0.1, 0.101]))
        acknowledges = 2.0 if self.acknowledges else 0.0
        things: tuple[tuple[float, Callable[[], list[bytes]]], ...] = (
            (8, lambda: [self.lease(int(random.integers(1 << 40)))]),
            (acknowledges, lambda: [frame(m.EventAck(int(random.integers(40))))]),
            (1.0, self.bring_up),
            (0.5, self.hello),
            (0.7, lambda: self.configure(damaged_configuration(random, self.configuration))),
            (0.5, lambda: self.configure(table_of(odd_settings(random, self.settings)))),
            (0.02, lambda: self.upload(odd_image(random, self.settings))),
            (0.4, lambda: self.configure(self.configuration)),
            (0.3, lambda: [frame(m.Hello(m.MAGIC, m.PROTOCOL, 1), sequence=self.sequence + int(random.integers(2)))]),
            (0.7, lambda: self.upload(damaged_image(random, self.image))),
            (0.4, lambda: self.upload(self.image)),
            (0.3, lambda: [frame(m.UploadBegin(int(random.choice([0, 10, 10**6, 2**32 - 1])), random.bytes(32)))]),
            (0.5, lambda: [frame(m.Data(int(random.integers(3000)), random.bytes(50)), sequence=0)]),
            (0.3, lambda: [frame(m.Configure(int(random.integers(CONFIGURATION_BYTES + 9)), random.bytes(9)))]),
            (0.2, lambda: [frame(m.ConfigureCommit(random.bytes(32))), frame(m.Commit())]),
            (2, self.arm),
            (1, self.odd_arm),
            (2, lambda: [frame(m.Start(int(random.choice([0, 0, 1, 1, 2]))))]),
            (0.4, lambda: [frame(m.Disarm())]),
            (2, lambda: [frame(m.Reset())]),
            (0.7, lambda: [frame(m.Gain(number))]),
            (
                0.8,
                lambda: [frame(m.Telemetry(*map(int, random.choice(TELEMETRY))))],
            ),
            (1, lambda: [frame(m.Pulse(number, int(random.choice([0, 1, 50, 200, 201])), int(random.integers(3))))]),
            (0.3, lambda: [frame(m.Surface(number)) if random.uniform() < 0.5 else frame(m.Evidence())]),
            (0.2, lambda: [frame(m.EmergencyStop(), session=int(random.integers(9)))]),
            (1, self.odd_frame),
            (1, self.repeated),
        )
        weights = np.array([weight for weight, _ in things])
        return things[int(random.choice(len(things), p=weights / weights.sum()))][1]()


def conversation(seed: int, ticks: int, damage: float) -> Iterator[tuple[bytes, Readings]]:
    """Bytes that arrive before each tick, and its readings.

    Parameters
    ----------
    damage : part of the frames that arrive damaged.
    """
    random = np.random.default_rng([seed, 21])
    host = Host(random)
    swings = [(random.uniform(2e-4, 4e-3), random.uniform(1.0, 15.0), random.uniform(0, 7)) for _ in range(3)]
    still, faulty = bool(random.uniform() < 0.3), float(random.choice([0.0, 1e-3]))
    waiting: list[bytes] = host.bring_up() if random.uniform() < 0.8 else []
    for tick in range(ticks):
        if random.uniform() < 0.05:
            waiting += host.say()
        arriving = b""
        for _ in range(int(random.integers(0, 4))):
            if waiting:
                frame = waiting.pop(0)
                arriving += damaged_frame(random, frame) if random.uniform() < damage else frame
        # A frame may come in pieces.
        if arriving and random.uniform() < 0.2:
            cut = int(random.integers(len(arriving)))
            arriving, rest = arriving[:cut], arriving[cut:]
            waiting.insert(0, rest)
        slow = min(1.0, tick / 3000)  # at rest first, so that it can be armed
        z = (
            3e-3
            if still
            else 1e-3 + slow * sum(a * math.sin(2 * math.pi * f * tick * DT_S + p) for a, f, p in swings)
        )
        readings = Readings(
            tick,
            math.floor(z / COUNT_M + 0.5),
            3.0 + 0.02 * random.standard_normal(),
            0.005 * random.standard_normal(),
            random.standard_normal(),
        )
        yield arriving, falsified(random, readings) if random.uniform() < faulty else readings
