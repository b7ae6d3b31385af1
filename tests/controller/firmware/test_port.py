"""The firmware folder as an Arduino library, and its Teensy sketch on a Teensy of variables."""

import ctypes
import json
import shutil
import subprocess
from dataclasses import astuple, replace
from pathlib import Path

import pytest

from controller.device.circuit_file import CIRCUITS, block_text, load_circuit
from controller.firmware.build import CORE, FIRMWARE, NoCompilerError, compiler, sources
from controller.host.session import Session
from controller.protocol import events as t
from controller.protocol.capacity import Hardware
from controller.protocol.codes import LinkNotice, Reason
from controller.protocol.configuration import configuration_of
from controller.servo.interface import Fault, State
from tests.benches.device import CONFIGURATION, IMAGE, SETTINGS
from transopt.plant.coil import CoilModel

SRC, SKETCH = FIRMWARE / "src", FIRMWARE / "examples" / "teensy41" / "teensy41.ino"
STUB = Path(__file__).parent / "arduino_stub"
# What every Arduino tool defines: by it the core finds transopt_port.h.
ARDUINO = "-DARDUINO=10819"
CPP = (ARDUINO, "-std=gnu++17", "-fno-exceptions", "-fno-rtti", "-Wall", "-Wextra", "-Werror", "-D__IMXRT1062__")
STOP, ENABLE, ALIVE, ACCELEROMETER, GRIP, CURRENT = 9, 6, 8, 14, 15, 16
SAFE_TICKS = 1000
BUILT = load_circuit(CIRCUITS["escon_re25"])[0]
ZERO = 2048  # counts of the sensors at rest
NO_COMMAND = round(BUILT.scales.output_zero)
OUTPUTS = (0, 1)  # COMMAND_BY_DAC


def test_the_whole_core_lies_where_an_arduino_tool_compiles_it() -> None:
    assert CORE.is_relative_to(SRC)
    assert sources(CORE)


def test_the_manifests_agree_and_name_what_is_there() -> None:
    properties = dict(line.split("=", 1) for line in (FIRMWARE / "library.properties").read_text().splitlines())
    manifest = json.loads((FIRMWARE / "library.json").read_text())
    needed = {"name", "version", "author", "maintainer", "sentence", "paragraph", "category", "url", "architectures"}
    assert needed <= set(properties)
    assert (properties["name"], properties["version"]) == (manifest["name"], manifest["version"])
    assert properties["includes"] == manifest["headers"]
    assert (SRC / manifest["headers"]).exists()
    for example in manifest["examples"]:
        assert (FIRMWARE / example["base"] / example["files"][0]).exists()
    for name in manifest["export"]["include"]:
        assert (FIRMWARE / name).exists()


@pytest.mark.parametrize("place", [SKETCH.parent, FIRMWARE / "port"], ids=["teensy41", "port"])
def test_the_hardware_block_of_a_port_is_that_of_the_built_in_circuit(place: Path) -> None:
    text = block_text(BUILT, CIRCUITS["escon_re25"].name)
    assert (place / "hardware.h").read_text() == text, "run transopt-play device circuit on it again"


@pytest.mark.parametrize("by_dac", OUTPUTS)
def test_the_sketch_compiles_for_the_processor(by_dac: int, tmp_path: Path) -> None:
    if shutil.which("arm-none-eabi-g++") is None:
        pytest.skip("arm-none-eabi-g++: not found; install gcc-arm-none-eabi (Debian)")
    processor = ("-mthumb", "-mcpu=cortex-m7", "-mfloat-abi=hard", "-mfpu=fpv5-d16", "-nostdinc++", "-O2")
    include = (f"-I{STUB}", f"-I{SRC}", "-include", "Arduino.h", f"-DCOMMAND_BY_DAC={by_dac}")
    command = ["arm-none-eabi-g++", *CPP, *processor, *include, "-x", "c++", "-c", str(SKETCH)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_circuit_with_converters_that_the_sketch_has_not_does_not_compile(tmp_path: Path) -> None:
    if shutil.which("g++") is None:
        pytest.skip("g++: not found")
    text = CIRCUITS["escon_re25"].read_text(encoding="utf-8").replace("bits = 12", "bits = 16")
    (tmp_path / "circuit.toml").write_text(text)
    shutil.copy(SKETCH, tmp_path / SKETCH.name)
    block = block_text(load_circuit(tmp_path / "circuit.toml")[0], "circuit.toml")
    (tmp_path / "hardware.h").write_text(block)
    include = (f"-I{STUB}", f"-I{SRC}", "-include", "Arduino.h")
    for by_dac, words in ((1, "the MCP4921 takes 12 bits"), (0, "the Teensy converts 12 bits")):
        command = ["g++", *include, f"-DCOMMAND_BY_DAC={by_dac}", "-x", "c++", "-c", str(tmp_path / SKETCH.name)]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode != 0
        assert words in done.stderr


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Objects of the library, by the C compiler, for this machine."""
    if shutil.which("g++") is None:
        pytest.skip("g++: not found")
    try:
        cc = compiler().command
    except NoCompilerError as missing:
        pytest.skip(str(missing))
    folder = tmp_path_factory.mktemp("core")
    defines = (ARDUINO, "-D__IMXRT1062__", "-fPIC", f"-I{SRC}")
    subprocess.run([*cc, *defines, "-c", *map(str, sources(SRC, CORE))], cwd=folder, check=True)
    return sorted(map(str, folder.glob("*.o")))


@pytest.fixture(scope="module", params=OUTPUTS, ids=["pwm", "dac"])
def built(request: pytest.FixtureRequest, core: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sketch and stub by C++, linked with the library."""
    folder = tmp_path_factory.mktemp("sketch")
    include = ("-fPIC", f"-I{STUB}", f"-I{SRC}", "-include", "Arduino.h", f"-DCOMMAND_BY_DAC={request.param}")
    sketch = ["g++", *CPP, "-DNOTHING_IS_WIRED=1", *include, "-x", "c++", "-c", str(SKETCH)]
    subprocess.run(sketch, cwd=folder, check=True)
    made = folder / "sketch.so"
    stub = [*CPP, "-fPIC", f"-I{STUB}", str(STUB / "stub.cpp")]
    objects = [*core, *map(str, folder.glob("*.o"))]
    subprocess.run(["g++", "-shared", *stub, *objects, "-o", str(made)], cwd=folder, check=True)
    return made


class Teensy:
    """A sketch that has power; sensors at rest, 5 mm above the surface, in a hand of 3 N."""

    def __init__(self, library: Path) -> None:
        self._c = c = ctypes.CDLL(str(library))
        c.stub_tick.argtypes = [ctypes.c_float]
        c.stub_send.restype, c.stub_watchdog.restype = ctypes.c_size_t, ctypes.c_double
        c.stub_receive.argtypes = [ctypes.c_char_p, ctypes.c_size_t]
        c.stub_send.argtypes = [ctypes.c_void_p, ctypes.c_size_t]
        c.stub_period_us.restype, c.stub_enable_rose_early.restype = ctypes.c_float, ctypes.c_bool
        self.ticks, self.told, self.now_s = 0, list[t.News](), 0.0
        self._room = ctypes.create_string_buffer(1 << 16)
        self.show(ACCELEROMETER, ZERO)
        self.show(GRIP, 400)
        self.show(CURRENT, ZERO)
        c.stub_set_encoder(204)
        c.stub_set_pin(STOP, 0)
        c.stub_setup()

    @property
    def c(self) -> ctypes.CDLL:
        return self._c

    def show(self, pin: int, counts: int) -> None:
        self._c.stub_set_analogue(pin, counts)

    def step(self, ticks: int = 1, periods: float = 1.0) -> None:
        for _ in range(ticks):
            self._c.stub_tick(periods)
            self.ticks += 1

    def enabled(self) -> bool:
        return bool(self._c.stub_pin(ENABLE))

    def output(self) -> int:
        """Give the output as a level of 4096, whichever output this build has."""
        word = int(self._c.stub_dac())
        return word & 0xFFF if word else int(self._c.stub_pwm(22))

    def exchange(self, session: Session, ticks: int) -> None:
        """Bytes both ways each millisecond, for so many periods."""
        for _ in range(ticks // 10):
            out = session.bytes_to_send(self.now_s)
            self._c.stub_receive(out, len(out))
            self._c.stub_loop()
            self.step(10)
            self.now_s += 1e-3
            self._c.stub_loop()
            size = self._c.stub_send(self._room, len(self._room))
            self.told += session.receive(self._room.raw[:size], self.now_s)

    def happened(self) -> set[object]:
        return {told.what for told in self.told if isinstance(told, t.Happened)}


@pytest.fixture
def teensy(built: Path, tmp_path: Path) -> Teensy:
    """Each on a copy of its own, whose variables nobody has touched."""
    return Teensy(Path(shutil.copy(built, tmp_path / "sketch.so")))


def connected(teensy: Teensy) -> Session:
    session = Session()
    session.connect(teensy.now_s)
    teensy.exchange(session, 100)
    assert session.device is not None
    return session


def armed(teensy: Teensy) -> Session:
    teensy.step(SAFE_TICKS)
    session = connected(teensy)
    session.configure(CONFIGURATION)
    session.upload(IMAGE)
    teensy.exchange(session, 1000)
    session.arm(0.1, trial=True)
    teensy.exchange(session, 100)
    assert session.device_state is State.ARMED, teensy.told
    return session


def test_nothing_comes_out_before_the_first_tick_and_no_power_before_it_is_armed(teensy: Teensy) -> None:
    assert not teensy.c.stub_enable_rose_early()
    assert teensy.c.stub_pin_mode(ENABLE) == 1
    assert not teensy.enabled()
    assert teensy.output() == NO_COMMAND
    teensy.step(2 * SAFE_TICKS)
    assert not teensy.enabled()
    assert teensy.output() == NO_COMMAND


def test_power_is_there_only_while_it_is_armed_or_pulses(teensy: Teensy) -> None:
    session = armed(teensy)
    assert teensy.enabled()
    session.disarm()
    teensy.exchange(session, 100)
    assert not teensy.enabled()
    session.pulse(0.05, 50)
    powered = []
    # The rest before a pulse is 1000 ticks.
    for _ in range(120):
        teensy.exchange(session, 10)
        powered.append(teensy.enabled())
    assert 104 <= sum(powered) <= 106
    assert not powered[-1]


def test_each_tick_feeds_the_watchdog_and_shows_that_it_lives(teensy: Teensy) -> None:
    assert 0 < teensy.c.stub_watchdog() <= 0.5
    levels = []
    for _ in range(4):
        teensy.step()
        levels.append(teensy.c.stub_pin(ALIVE))
    assert levels in ([0, 1, 0, 1], [1, 0, 1, 0])
    assert teensy.c.stub_feedings() == 4


def test_without_its_loop_a_tick_feeds_no_watchdog_and_shows_no_life(teensy: Teensy) -> None:
    half_a_second = round(0.5 / (1e-6 * teensy.c.stub_period_us()))
    teensy.step(half_a_second + 1000)
    assert teensy.c.stub_feedings() == half_a_second
    level = teensy.c.stub_pin(ALIVE)
    teensy.step()
    assert teensy.c.stub_pin(ALIVE) == level
    teensy.c.stub_loop()
    teensy.step()
    assert teensy.c.stub_feedings() == half_a_second + 1


def test_what_it_says_of_itself_is_what_the_block_of_the_sketch_says(teensy: Teensy) -> None:
    device = connected(teensy).device
    assert device is not None
    assert device.real_bytes == 8
    said = [float(getattr(device, name)) for name in Hardware.__dataclass_fields__]
    assert said == pytest.approx([float(value) for value in astuple(BUILT.hardware)], rel=1e-6)
    assert device.dt_s == pytest.approx(1e-6 * teensy.c.stub_period_us(), rel=1e-6)
    assert device.capacity_samples == 94208
    assert device.firmware == 0x20000
    assert (FIRMWARE / "library.properties").read_text().splitlines()[1] == "version=2.0.0"


def test_every_start_has_another_boot_number(teensy: Teensy) -> None:
    first = connected(teensy).device
    teensy.c.stub_setup()
    second = connected(teensy).device
    assert first is not None
    assert second is not None
    assert first.boot != second.boot


def test_a_pulse_goes_out_with_its_size_and_sign(teensy: Teensy) -> None:
    teensy.step(SAFE_TICKS)
    session = connected(teensy)
    session.configure(CONFIGURATION)
    teensy.exchange(session, 500)
    session.pulse(0.05, 50)
    seen = []
    for _ in range(120):
        teensy.exchange(session, 10)
        seen.append(teensy.output())
    assert set(seen) == {NO_COMMAND, round(BUILT.scales.output_zero + 0.05 * BUILT.scales.output_per_A)}
    assert seen[-1] == NO_COMMAND


def test_armed_it_answers_and_without_a_host_it_goes_safe(teensy: Teensy) -> None:
    session = armed(teensy)
    teensy.step(3000)
    teensy.exchange(session, 2000)
    assert session.device_state is State.IDLE
    assert LinkNotice.LEASE_LOST in teensy.happened()


@pytest.mark.parametrize(
    ("fault", "pin", "counts"),
    [(Fault.BAD_SENSOR, CURRENT, 4095), (Fault.BAD_SENSOR, CURRENT, 0), (Fault.GRIP_OPEN, GRIP, 0)],
)
def test_a_sensor_at_the_rail_is_a_fault_and_takes_the_power_away(
    teensy: Teensy, fault: Fault, pin: int, counts: int
) -> None:
    session = armed(teensy)
    assert teensy.enabled()
    teensy.show(pin, counts)
    for _ in range(10):
        teensy.exchange(session, 100)
    assert session.fault is fault
    assert not teensy.enabled()
    assert teensy.output() == NO_COMMAND


def test_the_stop_takes_the_power_away_in_its_tick(teensy: Teensy) -> None:
    session = armed(teensy)
    teensy.c.stub_set_pin(STOP, 1)
    teensy.step()
    assert not teensy.enabled()
    assert teensy.output() == NO_COMMAND
    teensy.exchange(session, 2000)
    assert session.fault is Fault.EMERGENCY_STOP
    assert Fault.EMERGENCY_STOP in teensy.happened()
    teensy.c.stub_set_pin(STOP, 0)
    teensy.step()
    session.reset()
    teensy.exchange(session, 1000)
    assert session.device_state is State.IDLE
    assert not teensy.enabled()


@pytest.mark.parametrize("powered", [False, True], ids=["off", "armed"])
def test_a_late_tick_is_a_fault(teensy: Teensy, powered: bool) -> None:
    """Without a current it costs a record its times: a tap on a real object is recorded with the amplifier off."""
    session = armed(teensy) if powered else connected(teensy)
    teensy.step(1, periods=1.4)
    assert teensy.enabled() is powered
    teensy.exchange(session, 1000)
    assert session.fault is None
    teensy.step(1, periods=1.6)
    assert not teensy.enabled()
    teensy.exchange(session, 2000)
    assert session.fault is Fault.LATE_TICK
    session.reset()
    teensy.exchange(session, 1000)
    assert session.device_state is State.IDLE


def test_the_coil_is_as_hot_as_may_be_unless_its_heat_was_kept_over_the_restart(teensy: Teensy) -> None:
    """The stub's registers begin as zeros, as behind an empty battery; what is kept is found again."""
    session = connected(teensy)
    session.configure(configuration_of(replace(SETTINGS, coil=CoilModel(2.18, 3.1, 14.0, 12.0, 612.0, 100.0))))
    session.upload(IMAGE)
    teensy.exchange(session, 1000)
    session.arm(0.1, trial=True)
    teensy.exchange(session, 100)
    too_hot = [told for told in teensy.told if isinstance(told, t.Refused) and told.reason is Reason.TOO_HOT]
    assert [round(told.value) for told in too_hot] == [100]
    for _ in range(30):
        teensy.step(10_000)
    teensy.c.stub_loop()
    teensy.c.stub_setup()
    session = connected(teensy)
    session.configure(configuration_of(replace(SETTINGS, coil=CoilModel(2.18, 3.1, 14.0, 12.0, 612.0, 100.0))))
    session.upload(IMAGE)
    teensy.exchange(session, 1000)
    session.arm(0.1, trial=True)
    teensy.exchange(session, 100)
    assert session.device_state is State.ARMED
