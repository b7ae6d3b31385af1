"""What a session carries: libraries up, telemetry and time down."""

import pytest

from controller.protocol import messages as m
from controller.protocol.codes import Kind
from controller.protocol.configuration import configuration_of
from controller.protocol.events import Completed, Progress, Samples
from controller.protocol.image import sha256
from controller.servo.interface import Readings
from tests.benches.device import CONFIGURATION, DT_S, IMAGE, SETTINGS, World, image
from tests.benches.virtual_link import Trouble


@pytest.mark.parametrize(("trouble", "most_s"), [(Trouble(latency_s=0.016), 4.0), (Trouble(loss=0.05), 20.0)])
def test_upload_of_400_kB(trouble: Trouble, most_s: float) -> None:
    world = World(trouble, seed=2).connected()
    world.session.configure(CONFIGURATION)
    world.until(lambda: world.session.idle, 3.0)
    big = image(speeds=17, grips=20, samples=590)
    assert len(big) > 400_000
    started = world.now_s
    world.session.upload(big)
    world.until(lambda: world.session.idle, most_s)
    assert world.device.look().library_sha256 == sha256(big)
    done = [x.done for x in world.told if isinstance(x, Progress)]
    assert done == sorted(done)
    assert done[-1] == len(big)
    assert world.now_s - started <= most_s


def test_an_interrupted_upload_goes_on_where_it_was() -> None:
    world = World(Trouble(latency_s=0.016)).connected()
    world.session.configure(CONFIGURATION)
    world.until(lambda: world.session.idle, 3.0)
    big = image(speeds=17, grips=20, samples=590)
    world.session.upload(big)
    world.run(0.5)
    arrived = world.device.look().arrived_bytes
    assert 100_000 < arrived < len(big)
    world.link.unplug()
    world.session.unplugged()
    world.link.plug()
    world.connected()
    frames = world.link.to_device.kinds[Kind.DATA]
    world.session.configure(CONFIGURATION)
    world.session.upload(big)
    world.until(lambda: world.session.idle, 2.0)
    assert world.device.look().library_sha256 == sha256(big)
    assert world.link.to_device.kinds[Kind.DATA] - frames <= (len(big) - arrived) / m.DATA_LIMIT + 1
    # Another image does not go on from there.
    world.session.upload(IMAGE)
    world.until(lambda: world.session.idle, 2.0)
    assert world.device.look().library_sha256 == sha256(IMAGE)


def test_telemetry_gaps_are_counted() -> None:
    world = World().ready()
    world.session.set_telemetry(2)
    world.run(0.5)
    calm = [x for x in world.told if isinstance(x, Samples)]
    assert sum(x.missed for x in calm) == world.session.records.missed == 0
    ticks = [x.tick + j * x.every for x in calm for j in range(len(x.records))]
    assert ticks == list(range(ticks[0], ticks[-1] + 1, 2))
    assert len(ticks) > 2400
    world.link.set_trouble(Trouble(loss=0.2, repetition=0.3))
    world.run(1.0)
    world.link.set_trouble(Trouble())
    world.run(0.1)
    samples = [x for x in world.told if isinstance(x, Samples)]
    ticks = [x.tick + j * x.every for x in samples for j in range(len(x.records))]
    assert ticks == sorted(set(ticks))
    assert world.session.records.missed > 100
    assert len(ticks) + world.session.records.missed == (ticks[-1] - ticks[0]) // 2 + 1
    world.session.set_telemetry(0)
    world.until(lambda: world.session.idle, 0.1).run(0.02)
    count = len(world.of(Samples))
    world.run(0.1)
    assert len(world.of(Samples)) == count


@pytest.mark.parametrize("drift", [0.0, 80e-6])
def test_the_clock_is_found_within_its_stated_error(drift: float) -> None:
    """The device's ticks against virtual time, over a link with a jitter of ten ticks."""
    world = World(Trouble(latency_s=0.002, jitter_s=0.001), seed=4)
    world.readings = lambda k: Readings(round(k * (1 + drift)) + 5000, 200, 3.0, 0.0, 0.0)
    world.connected().run(7.0)
    fit = world.session.clock
    true_tick = (world.device_tick - 1) * (1 + drift) + 5000
    assert abs(fit.tick(world.now_s) - true_tick) * DT_S <= fit.error_s
    assert fit.error_s < 0.005
    assert fit.drift == pytest.approx(drift, abs=40e-6)
    assert fit.host_s(fit.tick(3.25)) == pytest.approx(3.25, abs=1e-9)


def test_another_configuration_that_the_library_fits_needs_no_second_upload() -> None:
    world = World().ready()
    world.session.configure(configuration_of(SETTINGS.__class__(**{**vars(SETTINGS), "grip_margin_N": 0.2})))
    world.session.upload(IMAGE)
    data = world.link.to_device.kinds[Kind.DATA]
    world.until(lambda: world.session.idle, 1.0)
    assert world.link.to_device.kinds[Kind.DATA] == data
    assert world.device.look().library_sha256 == sha256(IMAGE)
    assert Completed(Kind.COMMIT) in world.told[-2:]


def test_a_library_comes_into_force_and_is_not_sent_twice() -> None:
    world = World().ready()
    device = world.device.look()
    assert device.library_sha256 == sha256(IMAGE)
    assert device.configuration_sha256 == sha256(CONFIGURATION)
    assert [x.done for x in world.told if isinstance(x, Progress)] == [0, len(IMAGE)]
    sent = world.link.to_device.kinds.total()
    world.session.configure(CONFIGURATION)
    world.session.upload(IMAGE)
    world.until(lambda: world.session.idle, 1.0).run(0.002)
    assert [x for x in world.told[-3:] if isinstance(x, Completed)] == [
        Completed(Kind.CONFIGURE_COMMIT, skipped=True),
        Completed(Kind.COMMIT, skipped=True),
    ]
    assert world.link.to_device.kinds.total() - sent <= 1  # a heartbeat
    # A new connection learns it from HELLO.
    world.session.close()
    world.connected()
    world.session.configure(CONFIGURATION)
    world.session.upload(IMAGE)
    world.until(lambda: world.session.idle, 0.01).run(0.002)
    assert world.told[-1] == Completed(Kind.COMMIT, skipped=True)
