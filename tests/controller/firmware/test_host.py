"""The compiled device: its plant against the simulator, its command line, its link."""

import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controller.cli.device import simulated
from controller.firmware.build import CORE, FIRMWARE, STRICT, build, sources
from controller.firmware.core_device import CoreDevice
from controller.host.driver import Device
from controller.host.payload import excitation, excitation_settings
from controller.protocol import messages as m
from controller.protocol.codes import EVENT_CODES, STATES
from controller.protocol.configuration import configuration_of
from controller.protocol.image import image_of, sha256
from controller.protocol.wire import Decoder, encode
from controller.record.excitation import sweep_command
from controller.servo.interface import Notice, State
from controller.servo.settings import Settings
from controller.sim.default_device import DEFAULT_DEVICE
from controller.sim.plant_file import plant_bytes
from controller.sim.sensors import Sensors
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import Ground, device_of
from controller.sim.user import Habit, StillHand, TapsInTurn, TapUser
from controller.waveforms.bank import Bank
from scripts.campaign.compiled_device import CompiledDevice
from tests.benches.commands import Terminal, assert_refused
from tests.benches.device import Talker, checked
from transopt.base.errors import InputError
from transopt.library.library import Library
from transopt.scene.scene import Scene

pytestmark = pytest.mark.usefixtures("c_compiler")

DT_S = 1e-4
QUIET = Sensors(accelerometer_noise_g_rtHz=0.0, grip_noise_N=0.0, current_noise_A=0.0)
FILES = [*sources(CORE), *sources(FIRMWARE / "host")]
WAIT_S = 60.0  # for a process on a busy machine; nothing is judged by it


@pytest.fixture(scope="module")
def user() -> TapsInTurn:
    return TapsInTurn([(0.2, 3.0), (0.3, 5.0)], 1.2)


def hello() -> m.HelloReply:
    """Of a device without limits of its own."""
    (reply,) = Talker().put(m.Hello(m.MAGIC, m.PROTOCOL, 3), session=5)
    assert isinstance(reply, m.HelloReply)
    return reply


def simulator(user: TapsInTurn | StillHand, **others: object) -> Simulator:
    return Simulator(DEFAULT_DEVICE, user, DT_S, imperfections=Imperfections(sensors=QUIET, **others))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def plant(user: TapsInTurn, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plant") / "plant"
    path.write_bytes(plant_bytes(simulator(user), user, user.period_s))
    return path


class Stepped:
    """The compiled device in lock-step."""

    def __init__(self, program: Path, plant: Path) -> None:
        command = [str(program), "--plant", str(plant), "--lock-step", "--boot", "7"]
        self._running = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def turn(self, ticks: int, data: bytes = b"") -> bytes:
        assert self._running.stdin is not None
        assert self._running.stdout is not None
        self._running.stdin.write(struct.pack("<II", ticks, len(data)) + data)
        self._running.stdin.flush()
        (size,) = struct.unpack("<I", self._running.stdout.read(4))
        return self._running.stdout.read(size)

    def close(self) -> int:
        assert self._running.stdin is not None
        self._running.stdin.close()
        ended = self._running.wait(WAIT_S)
        assert self._running.stdout is not None
        self._running.stdout.close()
        return ended


class Both:
    """The program with its compiled plant, and the core on the simulator, told the same at the same ticks."""

    def __init__(self, program: Path, plant: Path, truth: Simulator) -> None:
        self._compiled, self._core, self._truth = Stepped(program, plant), CoreDevice(7), truth
        self._decoders = Decoder(), Decoder()
        self.said: tuple[list[m.Frame], list[m.Frame]] = ([], [])
        self._sequence = 0

    def turn(self, ticks: int, *told: object) -> None:
        data = b""
        for message in told:
            self._sequence += 1
            data += encode(m.Frame(self._sequence, 5, message).payload())  # type: ignore[arg-type]
        self._core.receive(data)
        for _ in range(ticks):
            self._truth.advance(self._core.step(self._truth.readings()).command_A)
        answers = self._compiled.turn(ticks, data), self._core.bytes_to_send()
        for decoder, said, answer in zip(self._decoders, self.said, answers, strict=True):
            said += [m.read_frame(payload) for payload in decoder.feed(answer)]

    def armed(self, configuration: bytes, image: bytes) -> None:
        """Both, with these in force."""
        hashes = sha256(configuration), sha256(image)
        chunks = [m.Data(j, image[j : j + m.DATA_LIMIT]) for j in range(0, len(image), m.DATA_LIMIT)]
        self.turn(0, m.Hello(m.MAGIC, m.PROTOCOL, 3), m.Configure(0, configuration), m.ConfigureCommit(hashes[0]))
        begin = m.UploadBegin(len(image), hashes[1])
        self.turn(10, begin, *chunks, m.Commit(), m.Checked(hashes[0]), m.Telemetry(1))
        self.turn(10, m.Arm(0, 200, 1.0, *hashes))

    def records(self, which: int) -> np.ndarray:  # type: ignore[type-arg]
        size, rows = m.Record.FORMAT.size, []
        for frame in self.said[which]:
            if isinstance(frame.message, m.TelemetryData):
                data = frame.message.records
                rows += [m.Record.FORMAT.unpack(data[j : j + size]) for j in range(0, len(data), size)]
        return np.array(rows)

    def others(self, which: int) -> list[object]:
        return [frame.message for frame in self.said[which] if not isinstance(frame.message, m.TelemetryData)]

    def close(self) -> int:
        return self._compiled.close()


@pytest.fixture(params=["plain", "checked"])
def program(request: pytest.FixtureRequest) -> Path:
    if request.param == "plain":
        return build("transopt-device", FILES, flags=STRICT)
    return checked("transopt-device", FILES)


def test_taps_go_as_on_the_simulator(
    program: Path, plant: Path, user: TapsInTurn, stated: Settings, tables: Bank
) -> None:
    """Brought up, armed, two taps in one round: the same answers and events, the same motion and commands."""
    configuration, image = configuration_of(stated), image_of(tables, DT_S, stated.lead_s, 10)
    both = Both(program, plant, simulator(user))
    both.armed(configuration, image)
    for _ in range(118):
        both.turn(100, m.Lease(0))
    assert both.close() == 0
    assert both.others(0) == both.others(1) or _but_for_rounding(both)
    records = both.records(0), both.records(1)
    assert records[0].shape == records[1].shape
    assert len(records[0]) > 11_500
    assert max(abs(records[0][:, 4])) > 2.0
    np.testing.assert_allclose(records[0], records[1], rtol=1e-5, atol=1e-5)


def test_an_excitation_goes_as_on_the_simulator(program: Path, tmp_path: Path) -> None:
    """Held still, swept with either sign: the same answers and events, the same motion and commands."""
    _, hand = simulated(None, [(0.2, 3.0)], 0.0, 0.0, 3, hold_N=3.0)
    assert hand.grip_N(0.0) == 3.0
    (tmp_path / "plant").write_bytes(plant_bytes(simulator(hand), hand, hand.period_s))
    both = Both(program, tmp_path / "plant", simulator(hand))
    given = excitation(excitation_settings(hello(), None), sweep_command(10, 1500, 0.3, 0.75, DT_S), hello())
    both.armed(given.configuration, given.image)
    for negative in (0, 1):
        both.turn(10, m.Start(negative))
        for _ in range(31):
            both.turn(100, m.Lease(0))
    assert both.close() == 0
    assert _but_for_rounding(both)
    codes = [said.code for said in both.others(0) if isinstance(said, m.Event)]
    assert set(codes) == {EVENT_CODES[Notice.FINISHED]}
    records = both.records(0), both.records(1)
    playing = records[0][:, 8] == STATES.index(State.PLAYING)
    assert int(playing.sum()) == 2 * 3000
    first, second = np.split(records[0][playing][:, 4], 2)
    np.testing.assert_array_equal(first, -second)
    np.testing.assert_allclose(records[0], records[1], rtol=1e-5, atol=1e-5)


def _but_for_rounding(both: Both) -> bool:
    """Speeds and grips of events may differ in their last digits, since sums are taken in another order."""
    pairs = list(zip(both.others(0), both.others(1), strict=True))
    events = [(one, other) for one, other in pairs if one != other]
    for one, other in events:
        assert isinstance(one, m.Event)
        assert isinstance(other, m.Event)
        assert (one.number, one.tick, one.code) == (other.number, other.tick, other.code)
        np.testing.assert_allclose([one.speed_m_s, one.grip_N], [other.speed_m_s, other.grip_N], rtol=1e-9)
    return True


@pytest.mark.parametrize(("change", "message"), [({"ground": Ground(friction_N=0.1)}, "knows no friction")])
def test_what_the_compiled_plant_cannot_do_is_refused(
    user: TapsInTurn, change: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        plant_bytes(simulator(user, **change), user, 0.01)


def test_a_hand_that_lets_go_is_refused() -> None:
    letting_go = TapUser(0.2, 1.0, 0.0, Habit.MILD, grip_rate_N_s=-1000.0)
    with pytest.raises(InputError, match="holds the stylus all the time, or never"):
        plant_bytes(Simulator(DEFAULT_DEVICE, letting_go, DT_S), letting_go, 0.01)  # type: ignore[arg-type]


def test_the_default_device_is_that_of_the_built_in_scenes(scene: Scene) -> None:
    """Up to the rounding with which `DEFAULT_DEVICE` states what follows from the motor's datasheet."""
    device = device_of(scene)
    np.testing.assert_allclose(DEFAULT_DEVICE.force_per_current_N_A, device.force_per_current_N_A, rtol=1e-3)
    for grip in (0.0, 2.0, 5.0):
        for one, other in zip(DEFAULT_DEVICE.at(grip), device.at(grip), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-3)
    rounded = {"force_per_current_N_A": 1.25, "masses_kg": DEFAULT_DEVICE.masses_kg}
    assert replace(device, **rounded) == DEFAULT_DEVICE  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "options",
    [
        [],
        ["--plant", "/nowhere"],
        ["--plant", __file__],
        ["--nonsense", "1"],
        ["--plant", "PLANT", "--loss", "much"],
        ["--plant", "PLANT", "--listen", "nowhere"],
        ["--plant", "PLANT", "--listen", "localhost:99999999"],
    ],
)
def test_the_program_refuses_in_one_line(plant: Path, options: list[str]) -> None:
    program = build("transopt-device", FILES, flags=STRICT)
    command = [str(program), *(str(plant) if word == "PLANT" else word for word in options)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=WAIT_S)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith("error: ")


@pytest.mark.parametrize(
    "address", ["nowhere", "localhost:", "localhost:x", "localhost:70000", "no.such.host.invalid:1"]
)
def test_an_address_that_cannot_be_had_is_named(plant: Path, address: str) -> None:
    command = [str(build("transopt-device", FILES)), "--plant", str(plant), "--listen", address]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=WAIT_S)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"error: --listen {address}: ")


def test_a_plant_file_cut_short_is_refused(plant: Path, tmp_path: Path) -> None:
    program = build("transopt-device", FILES, flags=STRICT)
    whole = plant.read_bytes()
    for size in (10, 100, len(whole) - 1):
        (tmp_path / "cut").write_bytes(whole[:size])
        command = [str(program), "--plant", str(tmp_path / "cut"), "--lock-step"]
        done = subprocess.run(command, input=b"", capture_output=True, check=False, timeout=WAIT_S)
        assert done.returncode == 2


@contextmanager
def served(*options: str) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """`transopt-device` as a process of its own, and the name of its port; it ends without a word."""
    command = [sys.executable, "-m", "controller.cli.device", "--tap", "0.2,3", *options]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as running:
        assert running.stdout is not None
        yield running, running.stdout.readline().strip()
        running.terminate()
        assert running.communicate(timeout=WAIT_S)[1] == ""


def greeted(port: str) -> m.HelloReply:
    with Device(port) as host:
        return host.hello


def boots_of(port: str, count: int) -> list[int]:
    """Numbers of so many starts, in the order in which they are seen."""
    boots, end_s = [greeted(port).boot], time.monotonic() + WAIT_S
    while len(boots) < count and time.monotonic() < end_s:
        boot = greeted(port).boot
        boots += [boot] if boot != boots[-1] else []
    return boots


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("options", [(), ("--listen", "localhost:0"), ("--loss", "0.1")])
def test_it_answers_like_a_device(options: tuple[str, ...]) -> None:
    with served(*options) as (running, port):
        reply = greeted(port)
        assert (reply.real_bytes, reply.protocol, reply.dt_s) == (8, m.PROTOCOL, DT_S)
        # On a socket the host before has gone, and another one comes.
        again = greeted(port)
        assert again.boot == reply.boot
        assert again.tick >= reply.tick
        assert running.stdin is not None
        print("reset", file=running.stdin, flush=True)
        while greeted(port).boot == reply.boot:
            pass
        print("quit", file=running.stdin, flush=True)
        assert running.wait(WAIT_S) == 0


@pytest.mark.usefixtures("patient")
def test_power_goes_off_and_on_by_itself() -> None:
    with served("--reset-every", "0.2") as (_, port):
        boots = boots_of(port, 3)
    assert len(boots) == 3
    assert boots == sorted(boots)


def test_time_that_the_machine_slept_is_not_caught_up(plant: Path) -> None:
    """Ticks never run ahead of the clock; after a pause of a second all but a quarter of it is missing."""
    began_s = time.monotonic()
    with CompiledDevice(plant.read_bytes()) as served:
        with Device(served.name) as host:
            before = host.hello.tick
        served.process.send_signal(signal.SIGSTOP)
        with suppress(subprocess.TimeoutExpired):
            served.process.wait(1.0)
        served.process.send_signal(signal.SIGCONT)
        with Device(served.name) as host:
            assert 0 < (host.hello.tick - before) * DT_S < time.monotonic() - began_s - 0.7


def test_without_a_compiler_it_says_so_in_one_line(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "/nowhere/cc")
    assert_refused(terminal("transopt-device"), "CC = /nowhere/cc: is no C compiler that runs; unset CC")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--tap", "fast"], "--tap fast: must be SPEED,GRIP in m/s and N, like 0.2,3"),
        (["--tap", "9,3"], "--tap 9: must be 0.02 to 2 m/s"),
        (["--loss", "2"], "--loss 2: must be 0 to 1"),
        (["--hold", "-1"], "--hold -1: must be 0.5 to 50 N"),
        (["--hold", "3", "--tap", "0.2,3"], "--tap beside --hold"),
        (["--like", "/nowhere.npz"], "/nowhere.npz"),
    ],
)
def test_bad_options_are_told_in_one_line(options: list[str], message: str, terminal: Terminal) -> None:
    outcome = terminal("transopt-device", *options)
    assert_refused(outcome)
    assert outcome.err.startswith(f"error: {message}")


def test_a_librarys_device_is_served(library: Library, tmp_path: Path) -> None:
    """The simulator that `--like` makes is that of the scene in the library."""
    library.save(tmp_path / "library.npz")
    truth, _ = simulated(tmp_path / "library.npz", [(0.2, 3.0)], 0.0, 0.0, 0)
    assert truth.device.force_per_current_N_A == pytest.approx(1.24956)
