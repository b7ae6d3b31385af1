"""The compiled device: its plant against the simulator, its command line, its link."""

import ctypes
import signal
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
from controller.host.driver import Device
from controller.protocol import messages as m
from controller.record.excitation import sweep_command
from controller.sim.compiled_device import CompiledDevice
from controller.sim.plant_file import plant_bytes
from controller.sim.sensors import Sensors
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import DEFAULT_DEVICE, Ground, device_of
from controller.sim.user import STRAIGHT, StillHand, TapsInTurn, TapUser
from tests.benches.commands import Terminal, assert_refused
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.library.library import Library
from transopt.scene.scene import Scene

pytestmark = pytest.mark.usefixtures("c_compiler")

DT_S = 1e-4
RANGE_G = 7.0  # beyond which the readings are no number
QUIET = Sensors(accelerometer_noise_g_rtHz=0.0, accelerometer_range_g=RANGE_G, grip_noise_N=0.0, current_noise_A=0.0)
FILES = [*sources(CORE), *sources(FIRMWARE / "host")]
WAIT_S = 60.0  # for a process on a busy machine; nothing is judged by it


@pytest.fixture(scope="module")
def user() -> TapsInTurn:
    return TapsInTurn([(0.2, 3.0), (0.3, 5.0)], 1.2)


def simulator(user: TapsInTurn | StillHand, **others: object) -> Simulator:
    return Simulator(DEFAULT_DEVICE, user, DT_S, imperfections=Imperfections(sensors=QUIET, **others))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def plant(user: TapsInTurn, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plant") / "plant"
    path.write_bytes(plant_bytes(simulator(user), user, user.period_s))
    return path


@pytest.fixture(scope="module")
def program() -> str:
    return str(build("transopt-device", FILES, flags=STRICT))


class Sensed(ctypes.Structure):
    """`td_readings` of td_interface.h."""

    _fields_ = (
        ("tick", ctypes.c_uint64),
        ("encoder_counts", ctypes.c_int32),
        *((name, ctypes.c_double) for name in ("grip_N", "current_A", "acceleration_m_s2")),
        *((name, ctypes.c_bool) for name in ("emergency_stop", "late", "host_stop")),
    )


@pytest.mark.parametrize(
    "hand", [TapsInTurn([(0.2, 3.0), (0.3, 5.0)], 1.2), StillHand()], ids=lambda h: type(h).__name__
)
def test_the_compiled_plant_moves_as_the_simulator(hand: TapsInTurn | StillHand, tmp_path: Path) -> None:
    """Swept by the same commands, in a hand that taps and in one that holds still, over more than one round."""
    path, room = tmp_path / "plant", ctypes.create_string_buffer(1 << 16)
    path.write_bytes(plant_bytes(simulator(hand), hand, hand.period_s))
    library = ctypes.CDLL(str(build("plant", [FIRMWARE / "host" / "plant.c"], flags=STRICT, shared=True)))
    library.plant_load.restype = ctypes.c_char_p
    library.plant_read.argtypes = [ctypes.c_char_p, ctypes.c_uint64, ctypes.POINTER(Sensed)]
    library.plant_advance.argtypes = [ctypes.c_char_p, ctypes.c_double]
    assert library.plant_load(room, str(path).encode(), ctypes.c_uint64(0)) is None
    truth, found, sensed = simulator(hand), ([], []), Sensed()
    for tick, command in enumerate(sweep_command(10, 1500, 1.5, 2.5, DT_S).tolist()):
        library.plant_read(room, tick, ctypes.byref(sensed))
        for rows, read in zip(found, (sensed, truth.readings()), strict=True):
            rows.append((read.encoder_counts, read.grip_N, read.current_A, read.acceleration_m_s2))
        library.plant_advance(room, command)
        truth.advance(command)
    library.plant_free(room)
    compiled, wanted = map(np.array, found)
    assert 0 < np.isnan(wanted[:, 3]).sum() < 0.3 * len(wanted)
    assert np.nanmax(np.abs(wanted[:, 3])) > 0.9 * RANGE_G * STANDARD_GRAVITY_M_S2
    assert np.ptp(wanted[:, 0]) > 10
    assert np.ptp(wanted[:, 2]) > 2.0
    assert np.abs(compiled[:, 0] - wanted[:, 0]).max() <= 1  # where it rounds the other way
    np.testing.assert_allclose(compiled[:, 1:], wanted[:, 1:], rtol=1e-9, atol=1e-9)


def test_every_reading_is_written(plant: Path) -> None:
    """Whatever stood there before: a stop or a late tick that nobody reported would latch a fault."""
    room, sensed = ctypes.create_string_buffer(1 << 16), Sensed()
    library = ctypes.CDLL(str(build("plant", [FIRMWARE / "host" / "plant.c"], flags=STRICT, shared=True)))
    library.plant_load.restype = ctypes.c_char_p
    assert library.plant_load(room, str(plant).encode(), ctypes.c_uint64(0)) is None
    ctypes.memset(ctypes.byref(sensed), 1, ctypes.sizeof(sensed))
    library.plant_read(room, ctypes.c_uint64(7), ctypes.byref(sensed))
    library.plant_free(room)
    assert sensed.tick == 7
    assert (sensed.emergency_stop, sensed.late, sensed.host_stop) == (False, False, False)


def test_what_the_compiled_plant_cannot_do_is_refused(user: TapsInTurn) -> None:
    with pytest.raises(InputError, match="knows no friction"):
        plant_bytes(simulator(user, ground=Ground(friction_N=0.1)), user, 0.01)
    letting_go = TapUser(0.2, 1.0, 0.0, STRAIGHT, grip_rate_N_s=-1000.0)
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
    ],
)
def test_the_program_refuses_in_one_line(plant: Path, program: str, options: list[str]) -> None:
    command = [program, *(str(plant) if word == "PLANT" else word for word in options)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=WAIT_S)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith("error: ")


@pytest.mark.parametrize(
    "address", ["nowhere", "localhost:", "localhost:x", "localhost:70000", "no.such.host.invalid:1"]
)
def test_an_address_that_cannot_be_had_is_named(plant: Path, program: str, address: str) -> None:
    command = [program, "--plant", str(plant), "--listen", address]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=WAIT_S)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"error: --listen {address}: ")


def test_a_plant_file_cut_short_is_refused(plant: Path, program: str, tmp_path: Path) -> None:
    whole = plant.read_bytes()
    for size in (10, 100, len(whole) - 1):
        (tmp_path / "cut").write_bytes(whole[:size])
        command = [program, "--plant", str(tmp_path / "cut")]
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
