"""One session in virtual time that something happens to at a random instant, and whether all stayed as it must.

The device is the compiled core; beside it stands a judge that reads what arrives at the device and sees every
command, so that "within the lease" is counted in the device's own ticks from the last heartbeat that it got.
"""

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from controller.host.session_states import OPEN
from controller.protocol import messages as m
from controller.protocol.codes import Kind
from controller.protocol.configuration import configuration_of
from controller.protocol.events import Ended, Happened, News, Samples
from controller.protocol.image import image_of
from controller.protocol.wire import Decoder
from controller.record.recorder import Recorder
from controller.record.telemetry import CSV_NAME
from controller.servo.interface import Fault, Output, Readings, State
from tests.benches.compiled import DT_S, SETTINGS, TAIL, smooth_bank
from tests.benches.probed import ProbedDevice
from tests.benches.rehearsal import NotWithinError, Rehearsal
from tests.benches.telemetry_file import read_csv
from tests.benches.virtual_link import Trouble

PHASES = {"connect": 8e-3, "configure": 0.015, "upload": 0.04, "check pending": 0.1, "armed": 0.15, "playing": 0.5}
KINDS = ("cable", "port", "reset", "host killed", "host hangs", "short gap")
SILENT = ("cable", "port", "reset")  # after these the session has to end
LINES = (
    Trouble(latency_s=1e-3),
    Trouble(latency_s=4e-3, jitter_s=2e-3),
    Trouble(latency_s=1e-3, loss=0.05, corruption=0.05, repetition=0.05),
)
REPORT_S, CONNECT_S = 1.0, 2.0  # while it connects, a host may wait for a device that starts
WATCHED_S, AFTER_S = 1.5, 0.3  # looked on after the fault, and after connecting again
LEASES_MS = (50, 100, 200, 500, 1000)
EVERY = (1, 5, 20)
CONFIGURATION = configuration_of(SETTINGS)
IMAGE = image_of(smooth_bank(4, 4, 2000), DT_S, SETTINGS.lead_s, TAIL)
ACTIVE = (State.ARMED, State.PLAYING)


def compare_recording(
    folder: Path, names: Sequence[str], was: Callable[[int], tuple[object, ...] | None], breaches: list[str]
) -> int:
    """Lines of a recording, each of which has to be what the device did in that tick; what is not is a breach."""
    columns = read_csv(folder / CSV_NAME)
    ticks = columns["tick"]
    if np.any(np.diff(ticks) <= 0):
        breaches.append("recording: ticks out of order")
    for tick, *line in zip(ticks.tolist(), *(columns[name].tolist() for name in names), strict=True):
        if was(tick) != tuple(line):
            breaches.append(f"recording: tick {tick} is {line} and was {was(tick)}")
            break
    return int(ticks.size)


class TappingHand:
    """Up and down through the surface, from where it may also rest; the current follows the command."""

    HEIGHT_M, SWING_M, RATE_HZ = 5e-3, 6e-3, 4.0
    PUSH_M_S2_A = 30.0  # that is felt and moves nothing

    def __init__(self) -> None:
        self.moving, self.command_A = False, 0.0
        self._current_A, self._turn = 0.0, 0.0
        self._decay = 0.0 if SETTINGS.amplifier is None else math.exp(-SETTINGS.amplifier.rate_rad_s * DT_S)

    @property
    def at_rest(self) -> bool:
        return not self.moving and self._turn == 0.0

    def readings(self, tick: int) -> Readings:
        self._current_A = self._decay * self._current_A + (1 - self._decay) * self.command_A
        if not self.at_rest:
            self._turn += self.RATE_HZ * DT_S
            if self._turn >= 1:
                self._turn = self._turn - 1 if self.moving else 0.0
        angle, turns_1_s = 2 * math.pi * self._turn, 0.0 if self.at_rest else 2 * math.pi * self.RATE_HZ
        z = self.HEIGHT_M - self.SWING_M * (1 - math.cos(angle))
        felt = -self.SWING_M * turns_1_s**2 * math.cos(angle) + self.PUSH_M_S2_A * self._current_A
        return Readings(tick, round(z / SETTINGS.count_m), 3.0, self._current_A, felt)


class Judged:
    """The compiled core from one start to the next, with a judge of its lease and a memory of what it did.

    Attributes
    ----------
    breaches : in words. held_ticks : most ticks from the last heartbeat to the last command that was not zero.
    lease_ticks : of the last ARM that arrived. history : by tick, what a recording must show.
    """

    def __init__(self, boot: int, hand: TappingHand) -> None:
        self._core, self._hand = ProbedDevice(boot, simulated=True), hand
        self._decoder, self._session, self._last, self._tick = Decoder(), 0, 0, 0
        self.state = State.IDLE
        self.breaches: list[str] = []
        self.held_ticks = self.lease_ticks = 0
        self.history: dict[int, tuple[int, float, str]] = {}

    def receive(self, data: bytes) -> None:
        for payload in self._decoder.feed(data) if data else ():
            frame = m.read_frame(payload)
            if isinstance(frame.message, m.Hello):
                self._session = frame.session
            elif frame.session == self._session and isinstance(frame.message, m.Lease | m.Arm):
                self._last = self._tick
                if isinstance(frame.message, m.Arm):
                    self.lease_ticks = round(frame.message.lease_ms * 1e-3 / DT_S)
        self._core.receive(data)

    def step(self, readings: Readings) -> Output:
        output = self._core.step(readings)
        self._hand.command_A, self.state = output.command_A, output.state
        self._hold(readings.tick, output)
        # Commands are told as float32, so the history holds them in that precision.
        command_A = float(np.float32(output.command_A))
        self.history[readings.tick] = (readings.encoder_counts, command_A, output.state.value)
        self._tick = readings.tick + 1
        return output

    def _hold(self, tick: int, output: Output) -> None:
        """Against the lease."""
        since = tick - self._last
        if output.command_A != 0.0:
            self.held_ticks = max(self.held_ticks, since)
        active = output.command_A != 0.0 or output.state in ACTIVE
        if active and since >= self.lease_ticks and not self.breaches:
            self.breaches.append(f"{output.state.value}, {output.command_A:g} A {since} ticks after a heartbeat")

    def bytes_to_send(self) -> bytes:
        return self._core.bytes_to_send()


@dataclass
class Outcome:
    """Outcome of one case.

    Attributes
    ----------
    phase : in which it happened; kind : what. breaches : in words.
    safe_s : from the fault until nothing was armed or commanded, by the device's ticks; NaN if nothing was.
    report_s : from the fault until the host said so; NaN where nothing is to be said.
    rows : of the recording. told_rows : records that the host had by then.
    """

    phase: str
    kind: str
    safe_s: float = math.nan
    report_s: float = math.nan
    rows: int = 0
    told_rows: int = 0
    lease_ms: int = 0
    held_ms: float = 0.0
    breaches: list[str] = field(default_factory=list)


class Case:
    """One session of one host with one device, from the seed alone."""

    def __init__(self, seed: int, folder: Path) -> None:
        self._chance = chance = random.Random(seed)
        self._hand, self._folder = TappingHand(), folder
        self._world = Rehearsal(lambda boot: Judged(boot, self._hand), DT_S, chance.choice(LINES), seed)
        self._world.readings = self._hand.readings
        self._lease_ms, self._every = chance.choice(LEASES_MS), chance.choice(EVERY)
        self.outcome = Outcome(chance.choice(list(PHASES)), chance.choice(KINDS), lease_ms=self._lease_ms)
        self._struck = self._world.device
        self._recorder = Recorder(folder, DT_S, SETTINGS.count_m)
        self._world.listeners += [self._recorder.take, self._count]

    def play(self) -> Outcome:
        """Never raises for what it finds; that stands in the outcome."""
        try:
            self._reach(self.outcome.phase)
            self._world.run(self._chance.uniform(0.0, PHASES[self.outcome.phase]))
            self._happen()
            self._recording()
            self._again()
        except NotWithinError as hung:
            self.outcome.breaches.append(f"hangs: {hung}")
        finally:
            self._recorder.close()
        return self.outcome

    def _count(self, news: News) -> None:
        if isinstance(news, Samples):
            self.outcome.told_rows += len(news.records)

    # Up to the fault.

    def _reach(self, phase: str) -> None:
        """Everything before this phase, and its beginning."""
        world, session = self._world, self._world.session
        steps: dict[str, tuple[Callable[[], None], Callable[[], bool]]] = {
            "connect": (
                lambda: session.connect(world.now_s, CONNECT_S),
                lambda: session.state in OPEN and session.idle,
            ),
            "configure": (self._configure, lambda: session.idle),
            "upload": (lambda: session.upload(IMAGE), lambda: session.idle),
            "check pending": (lambda: None, lambda: True),
            "armed": (self._arm, lambda: world.device.state is State.ARMED and session.device_state is State.ARMED),
            "playing": (lambda: setattr(self._hand, "moving", True), lambda: True),
        }
        for name, (begin, done) in steps.items():
            begin()
            if name == phase:
                return
            world.until(done, 5.0)

    def _configure(self) -> None:
        self._world.session.configure(CONFIGURATION)
        self._world.session.set_telemetry(self._every)

    def _arm(self) -> None:
        self._world.session.arm(1.0, self._lease_ms)

    # The fault, and what has to follow from it.

    def _happen(self) -> None:
        world, kind, out = self._world, self.outcome.kind, self.outcome
        struck, began_s, active = world.device, world.now_s, world.device.state in ACTIVE
        arms = world.link.to_device.kinds[Kind.ARM]
        lasts_s = self._chance.uniform(0.01, 1.2 if kind == "host hangs" else 0.55)
        arming = world.session.arming
        connecting = world.session.state not in OPEN
        if kind in ("cable", "port", "short gap"):
            world.link.unplug()
        if kind == "port":
            world.session.unplugged("pulled out")
        elif kind == "reset":
            world.reset_device()
        elif kind in ("host killed", "host hangs"):
            world.host_alive = False
        if kind in ("host hangs", "short gap"):
            self._watch(lambda: world.now_s >= began_s + lasts_s, began_s, active)
            world.link.plug()
            world.host_alive = True
            # From here on the host can know.
            since_s = world.now_s
            self._watch(self._agreed, began_s, active)
            out.report_s = world.now_s - since_s
        elif kind in SILENT:
            self._watch(lambda: self._ended() or (connecting and world.session.state in OPEN), began_s, active)
            out.report_s = world.now_s - began_s
        self._watch(lambda: world.now_s >= began_s + 1e-3 * self._lease_ms + 0.01, began_s, active)
        if not connecting and out.report_s > REPORT_S:
            out.breaches.append(f"reported after {out.report_s:.3f} s")
        if active and math.isnan(out.safe_s) and (kind in SILENT or kind == "host killed"):
            out.breaches.append("never safe")
        if not arming and world.link.to_device.kinds[Kind.ARM] != arms:
            out.breaches.append("armed again by itself")
        self._judged(struck)

    def _ended(self) -> bool:
        return any(isinstance(news, Ended) for news in self._world.told)

    def _agreed(self) -> bool:
        """The session is over, or host and device mean the same state."""
        session, device = self._world.session, self._world.device
        return self._ended() or (
            session.state in OPEN and (session.device_state in ACTIVE) == (device.state in ACTIVE)
        )

    def _watch(self, met: Callable[[], bool], began_s: float, active: bool) -> None:
        """Run until it is so, and note when the device is at rest."""
        world, out = self._world, self.outcome

        def seen() -> bool:
            if (
                active
                and math.isnan(out.safe_s)
                and world.device.state not in ACTIVE
                and world.output.command_A == 0.0
            ):
                out.safe_s = world.now_s - began_s
            return met()

        world.until(seen, WATCHED_S + CONNECT_S)

    def _judged(self, device: Judged) -> None:
        """What the judge has seen in this device, and in the one after a reset."""
        for one in {id(device): device, id(self._world.device): self._world.device}.values():
            self.outcome.breaches += one.breaches
            self.outcome.held_ms = max(self.outcome.held_ms, 1e3 * DT_S * one.held_ticks)
            one.breaches = []
        self._struck = device

    # What is left of the recording.

    def _recording(self) -> None:
        """A killed host flushes nothing; every line there is has to be one of the device's ticks."""
        out = self.outcome
        if out.kind != "host killed":
            self._recorder.flush()
        if out.told_rows == 0 and not (self._folder / CSV_NAME).exists():
            return
        history = self._struck.history
        out.rows = compare_recording(
            self._folder, ("encoder_counts", "command_A", "state"), history.get, out.breaches
        )
        if out.rows > out.told_rows or (out.kind != "host killed" and out.rows != out.told_rows):
            out.breaches.append(f"recording: {out.rows} lines of {out.told_rows} records")

    # A host connects once more: the one that was there before, or another.

    def _again(self) -> None:
        world, out = self._world, self.outcome
        world.link.plug()
        self._hand.moving = False
        if out.kind == "host killed":
            world.restart_host()
        elif world.session.state in OPEN:
            world.session.close()
            world.run(2 * world.dt_s)
        else:
            world.until(self._ended, CONNECT_S + REPORT_S)
        arms = world.link.to_device.kinds[Kind.ARM]
        world.listeners = []
        world.connected().run(AFTER_S).until(lambda: self._hand.at_rest, 1.0)
        if world.device.state in ACTIVE or world.link.to_device.kinds[Kind.ARM] != arms:
            out.breaches.append(f"armed by itself after connecting again: {world.device.state.value}")
            return
        faults = [news.what for news in world.told if isinstance(news, Happened) and isinstance(news.what, Fault)]
        if faults or world.device.state is State.FAULT:
            out.breaches.append(f"fault: {faults}")
        # It is as good as new.
        self._configure()
        world.session.upload(IMAGE)
        self._arm()
        world.until(lambda: world.device.state is State.ARMED and world.session.idle, 5.0)
        self._judged(world.device)
