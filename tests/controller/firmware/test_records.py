"""Telemetry that waits for the line: what a device keeps, where, and what it sends of it; an oracle of the ring."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from controller.protocol import messages as m
from controller.protocol.image import HEADER, sha256
from controller.protocol.messages import RECORDS_LIMIT, Record
from controller.protocol.packed import Packed
from controller.servo.interface import State
from tests.benches.device import ARM, EXCITED, IMAGE, ONE_WAVEFORM, REST, Talker, image
from tests.benches.probed import ProbedDevice

pytestmark = pytest.mark.usefixtures("c_compiler")
OWN, LIBRARY_SAMPLES, SPEEDS, GRIPS = 64, 4000, 4, 4
SMALL = (
    f"-DTD_MAX_RECORDS={OWN}",
    f"-DTD_MAX_LIBRARY_SAMPLES={LIBRARY_SAMPLES}",
    f"-DTD_MAX_SPEEDS={SPEEDS}",
    f"-DTD_MAX_GRIPS={GRIPS}",
)
# TD_MAX_IMAGE_BYTES: header, axes, two tables of nodes, samples of 2 bytes; a record with its number.
IMAGE_BYTES = HEADER.size + 8 * (SPEEDS + GRIPS + 2 * SPEEDS * GRIPS) + 2 * LIBRARY_SAMPLES
KEPT = OWN + IMAGE_BYTES // (4 + Record.FORMAT.size)


@pytest.fixture
def bench() -> Talker:
    """A small device with a library, in the precision of most boards."""
    return Talker(ProbedDevice(7, flags=(*SMALL, "-DTD_REAL_FLOAT"), simulated=True)).ready()


@dataclass
class Ring:
    """What of the records a device has, by their numbers: the newest are dropped where there is no room."""

    room: int
    kept: list[int] = field(default_factory=list)
    next: int = 0

    def tick(self) -> None:
        if len(self.kept) < self.room:
            self.kept.append(self.next)
        self.next += 1

    def take(self, count: int) -> list[int]:
        out, self.kept = self.kept[:count], self.kept[count:]
        return out


def run(bench: Talker, ticks: int) -> None:
    """Let ticks pass, of which the accelerometer tells the numbers; nothing is sent."""
    for _ in range(ticks):
        bench.step(1, REST._replace(acceleration_m_s2=float(bench.tick)))


def say(bench: Talker, message: Packed) -> list[int]:
    """Ask for something that is granted; numbers of the records that come with the answer."""
    heard = bench.tell(message)
    assert [one for one in heard if isinstance(one, m.Done | m.UploadReady | m.Ack)], heard
    return numbers(heard)


def numbers(heard: Sequence[object]) -> list[int]:
    """Numbers of the records that were heard, in order; each is the one that it says, of the tick that it says."""
    found = []
    for one in heard:
        if not isinstance(one, m.TelemetryData):
            continue
        records = [
            Record.unpack(one.records[at : at + Record.FORMAT.size])
            for at in range(0, len(one.records), Record.FORMAT.size)
        ]
        assert len(records) <= RECORDS_LIMIT
        for j, record in enumerate(records):
            assert record.acceleration_m_s2 == pytest.approx(one.tick + j * one.every)
        found += list(range(one.first, one.first + len(records)))
    return found


def test_what_does_not_go_out_is_kept_in_the_memory_of_the_next_library(bench: Talker) -> None:
    before = bench.device.image()
    bench.done(m.Telemetry(1, 0))
    run(bench, KEPT + 500)
    assert numbers(bench.heard()) == list(range(KEPT))
    assert bench.device.image() == before == IMAGE
    # After them the numbers tell how many were lost.
    run(bench, 2 * RECORDS_LIMIT)
    assert numbers(bench.heard())[0] == KEPT + 500


@pytest.mark.parametrize("every", [1, 3])
def test_the_ring_is_its_oracle_for_any_pattern_of_sending(bench: Talker, every: int) -> None:
    """Frames are taken one by one at random; the ring goes round in its own memory and in what it is lent."""
    random, ring = np.random.default_rng(every), Ring(KEPT)
    bench.done(m.Telemetry(every, 0))
    begun, heard, meant = bench.tick, [], []
    for _ in range(60):
        for _ in range(int(random.integers(1, 900))):
            run(bench, 1)
            if (bench.tick - 1 - begun) % every == 0:
                ring.tick()
        if random.random() < 0.7:
            heard += numbers(bench.heard())
            # Frames that are not full wait for the hold, of which the oracle knows nothing: it follows what went out.
            meant += ring.take(len(heard) - len(meant))
            assert heard == meant
    assert len(heard) > 5 * KEPT / every
    assert np.diff(heard).max() > 1


def test_an_upload_takes_the_memory_back_and_its_library_is_sound(bench: Talker) -> None:
    bench.done(m.Telemetry(1, 0))
    run(bench, KEPT)
    other = image(samples=70)
    heard = say(bench, m.UploadBegin(len(other), sha256(other)))
    assert heard == []
    run(bench, OWN + 100)
    for offset in range(0, len(other), m.DATA_LIMIT):
        heard += say(bench, m.Data(offset, other[offset : offset + m.DATA_LIMIT]))
    heard += say(bench, m.Commit())
    assert bench.device.image() == other
    # What waited is lost, which its numbers tell, and what came after it had the device's own memory alone.
    assert heard == list(range(KEPT, KEPT + OWN))
    bench.done(m.Telemetry(1, 0))
    run(bench, KEPT + 500)
    assert numbers(bench.heard()) == list(range(KEPT))
    assert bench.device.image() == other


def test_while_a_library_is_arriving_nothing_is_recorded_into_it(bench: Talker) -> None:
    other = image(samples=70)
    heard = say(bench, m.UploadBegin(len(other), sha256(other)))
    half = 300
    assert half < len(other)
    heard += say(bench, m.Data(0, other[:half]))
    bench.done(m.Telemetry(1, 0))
    run(bench, KEPT)
    for offset in range(half, len(other), m.DATA_LIMIT):
        heard += say(bench, m.Data(offset, other[offset : offset + m.DATA_LIMIT]))
    heard += say(bench, m.Commit())
    assert heard == list(range(OWN))
    assert bench.device.image() == other


def test_an_upload_that_was_cut_off_is_resumed_until_another_session_wants_records(bench: Talker) -> None:
    other = image(samples=70)
    begin, cut = m.UploadBegin(len(other), sha256(other)), m.Data(0, other[:300])
    bench.tell(begin, cut)
    bench.put(m.Hello(m.MAGIC, m.PROTOCOL, 6), session=10)
    bench.session = 10
    bench.done(m.Telemetry(0, 0))
    assert bench.ask(begin) == m.UploadReady(300)
    bench.put(m.Hello(m.MAGIC, m.PROTOCOL, 7), session=11)
    bench.session = 11
    bench.done(m.Telemetry(1, 0))
    run(bench, KEPT + 500)
    assert numbers(bench.heard()) == list(range(KEPT))
    assert bench.ask(begin) == m.UploadReady(0)


def test_a_library_plays_while_the_memory_of_the_next_is_full_of_records(bench: Talker) -> None:
    bench.done(m.Telemetry(1, 0))
    run(bench, KEPT + 10)
    say(bench, ARM)
    assert bench.device.state is State.ARMED
    assert bench.device.image() == IMAGE


def excited(bench: Talker) -> None:
    """A configuration that the host starts, its one waveform of 300 ticks, and a stylus at rest."""
    bench.configured(EXCITED).loaded(ONE_WAVEFORM)
    bench.step(200)
    bench.heard()


EXCITE = replace(ARM, configuration_sha256=sha256(EXCITED), library_sha256=sha256(ONE_WAVEFORM))


@pytest.mark.parametrize("before", [1, 40, OWN + 20])
def test_records_begin_with_a_waveform_and_with_what_was_just_before(bench: Talker, before: int) -> None:
    excited(bench)
    bench.done(m.Telemetry(1, before))
    run(bench, 1000)
    assert numbers(bench.heard()) == []
    bench.done(EXCITE)
    run(bench, 100)
    bench.done(m.Start(0))
    begun = bench.tick
    run(bench, KEPT + 100)
    frames = [one for one in bench.heard() if isinstance(one, m.TelemetryData)]
    # The tick that begins to play is the first in which the oldest is no longer dropped.
    assert frames[0].tick == begun - before
    assert numbers(frames) == list(range(KEPT))
    # What no longer fitted is lost, and its numbers tell.
    run(bench, 100)
    assert numbers(bench.heard())[0] == before + KEPT + 100


def test_of_a_device_that_is_asked_for_more_than_it_keeps_the_newest_before_come(bench: Talker) -> None:
    excited(bench)
    bench.done(m.Telemetry(1, 65_535))
    run(bench, KEPT + 300)
    bench.done(EXCITE, m.Start(0))
    begun = bench.tick
    run(bench, 100)
    frames = [one for one in bench.heard() if isinstance(one, m.TelemetryData)]
    assert frames[0].tick == begun - KEPT
    assert numbers(frames) == list(range(KEPT))


def test_a_tap_is_whole_over_a_line_that_carries_a_thirtieth_and_loses_frames(bench: Talker) -> None:
    """One full frame in 30 ticks' worth of time; a lost one is a gap of numbers, no more."""
    excited(bench)
    bench.done(m.Telemetry(1, 40), EXCITE, m.Start(0))
    begun, heard = bench.tick, []
    bench.device.ROOM_BYTES = 1000
    for turn in range(40):
        run(bench, 8)
        if turn % 5 == 0:
            frames = bench.heard()
            heard += [] if turn == 15 else numbers(frames)
    gaps = np.flatnonzero(np.diff(heard) > 1)
    assert begun > 0
    assert gaps.size == 1
    assert heard[gaps[0] + 1] - heard[gaps[0]] <= 2 * RECORDS_LIMIT + 1
