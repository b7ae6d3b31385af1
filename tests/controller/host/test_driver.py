"""Blocking calls against the compiled device: in virtual time, and once over a pseudo-terminal."""

import os
import select
import threading
from collections.abc import Callable, Iterator

import pytest

from controller.host.driver import HOLD_STILL, Device, DeviceError, LinkLostError
from controller.protocol.capacity import REST_BETWEEN_PULSES_S
from controller.protocol.codes import Kind, LinkNotice
from controller.protocol.events import Happened, Samples
from controller.protocol.image import sha256
from controller.servo.interface import Fault, Notice, Readings, State
from tests.benches.desk import Cable
from tests.benches.device import CONFIGURATION, DT_S, EXCITED, IMAGE, ONE_WAVEFORM, World, image, started
from tests.benches.virtual_link import Trouble
from transopt.base.errors import InputError


class VirtualStream(Cable):
    """The host's side of a world, whose time passes while the host waits."""

    def __init__(self, world: World) -> None:
        super().__init__(world.device, world, DT_S, line=world.link)  # type: ignore[arg-type]
        self.world, world.host_alive = world, False  # the driver pumps, not the world

    def now_s(self) -> float:
        return self.world.now_s

    def step(self) -> None:
        self._need_cable()
        self.world.step()


def driven(
    trouble: Trouble | None = None, seed: int = 0, *, simulated: bool = True
) -> tuple[World, VirtualStream, Callable[[], Device]]:
    world = World(trouble, seed, simulated=simulated)
    stream = VirtualStream(world)
    return world, stream, lambda: Device(stream, session=world.session)


def armed(device: Device) -> None:
    device.configure(CONFIGURATION)
    device.upload(IMAGE)
    device.arm(1.0, 100)


@pytest.mark.parametrize("trouble", [Trouble(), Trouble(latency_s=0.01, loss=0.1, corruption=0.05, repetition=0.1)])
def test_one_session_from_end_to_end(trouble: Trouble) -> None:
    world, stream, connect = driven(trouble, 1)
    seen: list[tuple[int, int]] = []
    samples: list[Samples] = []
    with connect() as device:
        assert device.hello.boot == world.device.look().boot
        assert device.configure(CONFIGURATION)
        assert device.upload(IMAGE, lambda done, total: seen.append((done, total)))
        assert not device.configure(CONFIGURATION)
        assert not device.upload(IMAGE)
        assert device.listeners == []
        device.set_telemetry(10)
        device.arm(0.5, 200)
        assert device.state is State.ARMED
        device.listeners.append(lambda news: samples.append(news) if isinstance(news, Samples) else None)
        assert not device.listen(1.0)
        assert world.device.state is State.ARMED
        device.set_gain(0.2)
        device.disarm()
        assert world.device.state is State.IDLE
    assert seen[-1] == (len(IMAGE), len(IMAGE))
    assert sum(len(x.records) for x in samples) > 500
    assert stream.closed == 1


def test_arming_waits_for_a_stylus_that_moves() -> None:
    """The tap by which a library new to the device is tried has just ended, say."""
    world, _, connect = driven()
    still_s, told = 2.0, list[str]()
    with connect() as device:
        device.configure(CONFIGURATION)
        device.upload(IMAGE)
        world.readings = lambda k: Readings(k, 200 + min(k, round(still_s / DT_S)), 3.0, 0.0, 0.0)  # outwards
        device.listen(0.1)
        with pytest.raises(DeviceError, match="the stylus is moving"):
            device.arm(1.0)
        assert device.now_s() < still_s
        device.arm(1.0, tell=told.append)
        assert device.state is State.ARMED
        assert still_s < device.now_s() < still_s + 0.2
    assert told == [HOLD_STILL]


def test_leaving_disarms_and_an_exception_stops() -> None:
    world, stream, connect = driven()
    with connect() as device:
        armed(device)
    assert world.device.state is State.IDLE
    for error in (KeyboardInterrupt, ZeroDivisionError):
        world, stream, connect = driven()

        def tap(connect: Callable[[], Device] = connect, error: type[BaseException] = error) -> None:
            with connect() as device:
                armed(device)
                device.listen(0.1)
                raise error

        with pytest.raises(error):
            tap()
        assert world.device.state is State.FAULT
        assert world.device.look().fault is Fault.HOST_STOP
        assert stream.closed == 1


def test_leaving_cuts_test_pulses() -> None:
    """The device is in IDLE while they play, so its state alone does not tell the host to disarm."""
    world, _, connect = driven(simulated=False)

    def interrupted() -> None:
        with connect() as device:
            device.configure(CONFIGURATION)
            device.listen(0.1)
            device.pulse(0.1, 200)
            assert not device.listen(REST_BETWEEN_PULSES_S + 1e-3)
            assert (device.state, world.output.command_A) == (State.IDLE, 0.1)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert (world.device.state, world.output.command_A) == (State.IDLE, 0.0)


def test_an_exception_at_rest_stops_nothing() -> None:
    world, _, connect = driven()

    def upload() -> None:
        with connect() as device:
            device.configure(CONFIGURATION)
            device.upload(image(speeds=64, grips=64, samples=100))

    with pytest.raises(InputError, match="the device holds"):
        upload()
    assert world.device.state is State.IDLE


def test_an_arm_without_answer_is_stopped_too() -> None:
    world, _, connect = driven()

    def arm() -> None:
        with connect() as device:
            device.configure(CONFIGURATION)
            device.upload(IMAGE)
            device.listen(0.05)
            world.link.to_host.trouble = Trouble(loss=1.0)
            device.session.arm(1.0, 200)
            device.pump(world.now_s + 0.01)
            assert device.state is State.IDLE
            assert world.device.state is State.ARMED
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        arm()
    assert world.device.state is State.FAULT


def test_a_refusal_is_one_line_in_words() -> None:
    _, _, connect = driven(simulated=False)
    with connect() as device:
        device.configure(CONFIGURATION)
        device.upload(IMAGE)
        with pytest.raises(DeviceError) as refused:
            device.arm(0.5)
        words = "device: arm refused: no sound test pulse under this configuration since the device started"
        assert str(refused.value).startswith(words)
    _, _, connect = driven()
    with connect() as device:
        device.configure(CONFIGURATION)
        device.upload(IMAGE)
        with pytest.raises(DeviceError, match=r"outside its range \(device saw 0.5\)"):
            device.arm(0.5, trial=True)
        device.arm(0.1, trial=True)
        with pytest.raises(DeviceError, match="gain refused"):
            device.set_gain(0.2)
        device.disarm()
        device.pulse(0.05, 50)
        assert device.listen(0.3, until=lambda x: isinstance(x, Happened) and x.what is LinkNotice.PULSE_ENDED)


def test_a_fault_meanwhile_is_told_and_no_misuse() -> None:
    """Heard of with a heartbeat between two calls, not as a refusal."""
    world, _, connect = driven()
    with connect() as device:
        device.configure(CONFIGURATION)
        device.upload(IMAGE)
        world.readings = lambda k: Readings(k, 200, 3.0, 0.0, 0.0, emergency_stop=True)
        device.listen(0.3)
        assert device.state is State.FAULT
        requests = (
            lambda: device.configure(CONFIGURATION),
            lambda: device.upload(IMAGE),
            lambda: device.arm(0.1, trial=True),
            lambda: device.pulse(0.05, 50),
            lambda: device.surface(0.0),
        )
        for request in requests:
            with pytest.raises(DeviceError, match=r"device: a fault is latched: emergency stop: .* \(--reset\)"):
                request()
        world.readings = lambda k: Readings(k, 200, 3.0, 0.0, 0.0)
        device.listen(0.01)
        device.reset()
        device.arm(0.1, trial=True)


@pytest.mark.parametrize("how", ["port", "cable", "reset"])
def test_a_lost_link_is_one_error_within_a_second_and_arms_nothing(how: str) -> None:
    world, stream, connect = driven()
    with connect() as device:
        armed(device)
        died, arms = world.now_s, world.link.to_device.kinds[Kind.ARM]
        if how == "port":
            stream.gone = True
        elif how == "cable":
            world.link.unplug()
        else:
            world.reset_device()
        with pytest.raises(LinkLostError, match="does not arm by itself"):
            device.listen(5.0)
        assert world.now_s - died < 1.0
        stream.gone = False
        world.link.plug()
        device.connect()
        device.listen(0.5)
        assert world.device.state is State.IDLE
        assert world.link.to_device.kinds[Kind.ARM] == arms


def test_a_pause_at_rest_is_no_lost_link() -> None:
    """A program that waits for its user for a while finds its device as it left it; an armed one has disarmed."""
    world, _, connect = driven()
    with connect() as device:
        armed(device)
        device.disarm()
        device.listen(0.33)
        world.run(5.0)
        device.listen(0.3)
        device.arm(1.0, 100)
        device.listen(0.2)
        world.run(5.0)
        device.listen(0.3)
        assert world.device.state is State.IDLE
        assert device.state is State.IDLE


def test_nobody_there() -> None:
    world, stream, connect = driven()
    world.link.unplug()
    with pytest.raises(LinkLostError, match="nothing answers on this port"):
        connect()
    assert stream.closed == 1
    assert world.now_s < 4.0


def test_closing_twice_and_closing_a_dead_one() -> None:
    world, stream, connect = driven()
    device = connect()
    armed(device)
    world.link.unplug()
    device.close()
    device.close()
    assert stream.closed == 2
    # Nobody could tell it: its lease did.
    world.run(0.2)
    assert world.device.state is State.IDLE


def test_a_start_out_of_turn_is_one_line_and_no_misuse() -> None:
    world, _, connected = driven()
    with connected() as device:
        with pytest.raises(DeviceError, match="the device is not armed: arm it, then start"):
            device.start()
        armed(device)
        with pytest.raises(DeviceError, match="start refused: this configuration plays at a contact"):
            device.start()
        assert world.device.state is State.ARMED
        device.disarm()
        device.configure(EXCITED)
        device.upload(ONE_WAVEFORM)
        device.arm(1.0, 100)
        device.start(negative=True)
        assert world.device.state is State.PLAYING
        with pytest.raises(DeviceError, match="start refused: something is playing"):
            device.start()
        assert device.listen(1.0, until=lambda news: isinstance(news, Happened) and news.what is Notice.FINISHED)
        assert world.device.state is State.ARMED


class Served:
    """A device on the master's side of a pseudo-terminal; ticks as fast as it can."""

    def __init__(self, master: int) -> None:
        self.device, self._master, self._stop = started(7), master, threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        tick = 0
        while not self._stop.is_set():
            if select.select([self._master], [], [], 0.001)[0]:
                self.device.receive(os.read(self._master, 65_536))
            self.device.step(Readings(tick, 200, 3.0, 0.0, 0.0))
            tick += 1
            data = self.device.bytes_to_send()
            while data:
                data = data[os.write(self._master, data) :]

    def stop(self) -> None:
        self._stop.set()
        self._thread.join(5.0)


@pytest.fixture
def served(patient: None) -> Iterator[tuple[Served, str]]:
    try:
        master, slave = os.openpty()
    except OSError as error:
        pytest.skip(f"no pseudo-terminals here: {error}")
    name = os.ttyname(slave)
    import tty

    tty.setraw(slave)
    server = Served(master)
    yield server, name
    server.stop()
    os.close(master)
    os.close(slave)


def test_over_a_pseudo_terminal(served: tuple[Served, str]) -> None:
    server, name = served
    big = image(speeds=17, grips=20, samples=580)
    with Device(name) as device:
        device.configure(CONFIGURATION)
        device.upload(big)
        assert server.device.look().library_sha256 == sha256(big)
        device.arm(1.0, 1000)
        device.listen(0.05)
        assert server.device.state is State.ARMED
        assert device.session.decoder.bad_frames == 0
    assert server.device.state is State.IDLE
    assert device.hello.dt_s == DT_S
