"""Real processes on a real line: the compiled device, a host, and between them a line that can be cut.

The line passes bytes both ways and reads along what the device says, also when the host is dead: the ticks at which
heartbeats arrived, and the telemetry with every command, which is what the lease is judged by.
"""

import os
import random
import select
import socket
import subprocess
import sys
import threading
import time
from bisect import bisect_right
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from controller.host.connection import PortError
from controller.host.driver import Device, DeviceError
from controller.protocol import messages as m
from controller.protocol.codes import STATES
from controller.protocol.wire import Decoder
from controller.record.telemetry import CSV_NAME
from controller.servo.interface import State
from controller.sim.compiled_device import CompiledDevice
from controller.sim.user import TapsInTurn
from tests.benches.compiled import DT_S, plant_of
from tests.benches.places import ROOT
from tests.campaigns.unplug_cases import ACTIVE, compare_recording
from transopt.base.errors import InputError

KINDS = ("host killed", "device killed", "unplugged", "cable cut")
PHASES = {"connect": 0.02, "configure": 0.02, "upload": 0.04, "pending": 0.1, "armed": 1.5}
LEASES_MS = (200, 500)
WORD_S, ENDS_S, REPORT_S, AFTER_S = 30.0, 10.0, 1.0, 0.3
SETTLED_S = 0.3  # beyond the lease, until the line is no longer listened to
CHUNK = 65_536


def tapping_plant() -> bytes:
    """A hand that taps at 0.2 m/s, rests for half a second, and taps again."""
    taps = [(0.2, 3.0)]
    period_s = round((TapsInTurn(taps).period_s + 0.5) / DT_S) * DT_S
    return plant_of(TapsInTurn(taps, period_s), period_s)


class Line:
    """From the host's port to the device's, by a thread of its own.

    Attributes
    ----------
    name : what the host opens. leases, records : of the device so far: ticks of heartbeats, telemetry by tick.
    """

    def __init__(self, device_name: str) -> None:
        self._listener: socket.socket | None = None
        self._host = -1
        if device_name.startswith("socket://"):
            where, port = device_name.removeprefix("socket://").split(":")
            self._device = socket.create_connection((where, int(port))).detach()
            self._listener = socket.create_server(("localhost", 0))
            self.name = f"socket://localhost:{self._listener.getsockname()[1]}"
        else:
            import tty

            self._device = os.open(device_name, os.O_RDWR | os.O_NOCTTY)
            self._host, self._kept = os.openpty()
            tty.setraw(self._kept)
            self.name = os.ttyname(self._kept)
        self.leases: list[int] = []
        self.records: dict[int, m.Record] = {}
        self._decoder, self._stop, self._cut, self._pull = Decoder(), threading.Event(), False, False
        self._to_device = self._to_host = b""
        self._thread = threading.Thread(target=self._carry)
        self._thread.start()

    def cut(self) -> None:
        """Silence; both ports stay."""
        self._cut = True

    def pull(self) -> None:
        """The host's port goes away."""
        self._pull = True

    @property
    def active(self) -> bool:
        """Tell by the newest record whether the device is active."""
        records = self.records
        return bool(records) and STATES[records[max(records)].state] in ACTIVE

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._drop_host()
        if self._listener is not None:
            self._listener.close()
        with suppress(OSError):
            os.close(self._device)

    def _drop_host(self) -> None:
        ends = [self._host] if self._listener is not None else [self._host, self._kept]
        for end in ends if self._host >= 0 else ():
            os.close(end)
        self._host = -1

    def _carry(self) -> None:
        while not self._stop.is_set():
            self._to_device = self._sent(self._device, self._to_device)
            self._to_host = self._sent(self._host, self._to_host)
            if self._pull:
                self._drop_host()
            waiting = self._listener if self._listener is not None and self._host < 0 and not self._pull else None
            watched = [self._device, *([self._host] if self._host >= 0 else []), *([waiting] if waiting else [])]
            ready = select.select(watched, [], [], 0.005)[0]
            if waiting is not None and waiting in ready:
                self._host = waiting.accept()[0].detach()
            if self._host >= 0 and self._host in ready:
                data = self._read(self._host)
                if data and not self._cut:
                    self._to_device += data
                elif not data and self._listener is not None:
                    self._drop_host()
                    self._pull = True
            if self._device in ready:
                data = self._read(self._device)
                if not data:
                    # The device's process is dead, and its port with it.
                    self._drop_host()
                    return
                self._hear(data)
                if self._host >= 0 and not self._cut:
                    self._to_host += data

    @staticmethod
    def _sent(end: int, data: bytes) -> bytes:
        """What could not be written yet; nobody reads from a dead host's port."""
        if data and end >= 0:
            with suppress(OSError):
                os.set_blocking(end, False)
                return data[os.write(end, data) :]
        return data[-CHUNK:]

    @staticmethod
    def _read(end: int) -> bytes:
        try:
            return os.read(end, CHUNK)
        except OSError:
            return b""

    def _hear(self, data: bytes) -> None:
        for payload in self._decoder.feed(data):
            message = m.read_frame(payload).message
            if isinstance(message, m.LeaseReply):
                self.leases.append(message.tick)
            elif isinstance(message, m.TelemetryData):
                records = m.Record.FORMAT.iter_unpack(message.records)
                self.records |= {message.tick + j * message.every: m.Record(*one) for j, one in enumerate(records)}


@dataclass
class Ended:
    """Outcome of one case with real processes; figures as in `unplug_cases.Outcome`."""

    phase: str
    kind: str
    port: str
    lease_ms: int
    report_s: float = float("nan")
    held_ms: float = 0.0
    rows: int = 0
    playing: bool = False
    breaches: list[str] = field(default_factory=list)


class Host:
    """The process, and the words it has said so far with their times."""

    def __init__(self, port: str, folder: Path, lease_ms: int) -> None:
        command = [sys.executable, "-m", "tests.campaigns.unplug_host", port, str(folder), str(lease_ms)]
        self.process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        self.words: dict[str, float] = {}
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            word, _, when = line.partition(" ")
            self.words[word] = float(when)

    def wait_for(self, word: str, within_s: float) -> bool:
        end_s = time.monotonic() + within_s
        while word not in self.words and time.monotonic() < end_s:
            if self.process.poll() is not None and not self._thread.is_alive():
                break
            time.sleep(0.001)
        return word in self.words

    def close(self) -> str:
        """Kill it if it still runs; what it said on standard error."""
        self.process.kill()
        self._thread.join()
        said = self.process.stderr.read()
        self.process.wait()
        self.process.stderr.close()
        self.process.stdout.close()
        return said


def play(seed: int, folder: Path, *, listen: bool = False, kind: str | None = None) -> Ended:
    """One case: processes started, one thing done to them at a random instant, and what came of it."""
    chance = random.Random(seed)
    lease_ms, phase = chance.choice(LEASES_MS), chance.choice([*PHASES, "armed", "armed", "armed"])
    out = Ended(phase, kind or chance.choice(KINDS), "socket" if listen else "pty", lease_ms)
    options = ("--listen", "localhost:0") if listen else ()
    with CompiledDevice(tapping_plant(), *options) as served:
        line = Line(served.name)
        host = Host(line.name, folder, lease_ms)
        try:
            if not host.wait_for(phase, WORD_S):
                raise InputError(f"the host did not get to {phase}: {host.close()}")
            time.sleep(chance.uniform(0.0, PHASES[phase]))
            _strike(out, served, line, host)
        finally:
            said = host.close()
            line.close()
        if said and out.kind != "host killed":
            out.breaches.append(f"the host said {said.strip().splitlines()[-1]}")
        _judge(out, line)
        _recording(out, line, folder)
        if out.kind != "device killed":
            _again(out, served.name)
    return out


def _strike(out: Ended, served: CompiledDevice, line: Line, host: Host) -> None:
    connected = "configure" in host.words
    struck_s = time.monotonic()
    if out.kind == "host killed":
        host.process.kill()
    elif out.kind == "device killed":
        served.process.kill()
    elif out.kind == "unplugged":
        line.pull()
    else:
        line.cut()
    if out.kind != "host killed":
        if connected and host.wait_for("ended", ENDS_S):
            out.report_s = host.words["ended"] - struck_s
        try:
            host.process.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            out.breaches.append("the host hangs")
        if connected and not out.report_s <= REPORT_S:
            out.breaches.append(f"reported after {out.report_s:.3f} s")
    time.sleep(max(struck_s + 1e-3 * out.lease_ms + SETTLED_S - time.monotonic(), 0.0))
    # A busy machine's device may be behind the clock; its own ticks are what is judged.
    while out.kind != "device killed" and line.active and time.monotonic() < struck_s + ENDS_S:
        time.sleep(0.01)


def _judge(out: Ended, line: Line) -> None:
    """Active at most a lease after the last heartbeat, or after it was armed, in the device's own ticks."""
    ticks = sorted(line.records)
    active = [tick for tick in ticks if STATES[line.records[tick].state] in ACTIVE]
    if any(line.records[tick].command_A != 0.0 for tick in set(ticks) - set(active)):
        out.breaches.append("a command at rest")
    if not active:
        return
    out.playing = any(line.records[tick].command_A != 0.0 for tick in active)
    renewed = sorted([*line.leases, active[0]])
    held = max(tick - renewed[bisect_right(renewed, tick) - 1] for tick in active)
    out.held_ms = 1e3 * DT_S * held
    if out.held_ms > out.lease_ms:
        out.breaches.append(f"active {out.held_ms:.1f} ms after the last heartbeat")
    if out.kind != "device killed" and STATES[line.records[ticks[-1]].state] is not State.IDLE:
        out.breaches.append("not seen safe")


def _recording(out: Ended, line: Line, folder: Path) -> None:
    if out.phase != "armed" and not (folder / CSV_NAME).exists():
        return

    def was(tick: int) -> tuple[object, ...] | None:
        record = line.records.get(tick)
        return None if record is None else (record.encoder_counts, record.command_A)

    out.rows = compare_recording(folder, ("encoder_counts", "command_A"), was, out.breaches)


def _again(out: Ended, name: str) -> None:
    """Another host comes; it arms nothing, and finds nothing armed."""
    try:
        with Device(name) as device:
            found = [STATES[device.hello.state]]
            device.listen(AFTER_S)
            found.append(device.state)
    except (DeviceError, PortError) as error:
        out.breaches.append(f"connecting again: {error}")
        return
    if found != [State.IDLE] * 2:
        out.breaches.append(f"after connecting again: {', '.join(state.value for state in found)}")
