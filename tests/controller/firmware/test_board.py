"""The port for a bare processor: its functions, its memories, and processors that are no good for it."""

import re
import shutil
import struct
import subprocess
from pathlib import Path

import pytest

from controller.device.circuit_file import CIRCUITS, block_text, load_circuit
from controller.firmware.build import FIRMWARE
from tests.benches.board import PORT, MissingToolError, need_tools
from tests.campaigns.test_desk import Tap
from tests.campaigns.test_emulated_board import TAPS, misses

ARM = "arm-none-eabi-gcc"
SRC = FIRMWARE / "src"
M4F = ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard")
STRICT = (
    "-std=c11",
    "-O2",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-pedantic",
    "-Wconversion",
    "-Wdouble-promotion",
    "-Wshadow",
)
EXCEPTION_FRAME = 112  # with floating-point registers, and aligned
IN_A_LIBRARY = 256  # of a function of libm or libgcc with all that it calls
BOARDS = (PORT / "board.c", PORT / "emulated.c", PORT.parent / "port_template.c")


@pytest.fixture(autouse=True)
def _tools() -> None:
    try:
        need_tools(ARM)
    except MissingToolError as missing:
        pytest.skip(str(missing))


def arm(*words: object, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [ARM, "-mthumb", *map(str, words)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def tool(name: str, *words: object, folder: Path) -> str:
    """What a tool of the compiler's says."""
    command = [ARM.replace("gcc", name), *map(str, words)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("board", BOARDS, ids=lambda path: path.stem)
def test_a_board_has_all_functions_and_no_others(board: Path, tmp_path: Path) -> None:
    """The template, the board and its emulation are the same list; what a compiler warns of is an error."""
    done = arm(*M4F, *STRICT, "-DTRANSOPT_PORT", f"-I{SRC}", "-c", board, "-o", "board.o", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    said = tool("nm", "--defined-only", "board.o", folder=tmp_path)
    declared = set(re.findall(r"^[a-z].*?\b(board_\w+)\(", (PORT.parent / "board.h").read_text(), re.MULTILINE))
    assert set(re.findall(r" T (board_\w+)", said)) == declared
    assert len(declared) > 10


def compiled_for(old: str, new: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """The board of a built-in circuit of which a text is another, compiled as board.o."""
    text = CIRCUITS["escon_re25"].read_text(encoding="utf-8")
    assert old in text
    (folder / "circuit.toml").write_text(text.replace(old, new, 1))
    (folder / "port").mkdir()
    for name in ("board.h", "stm32f405/board.c", "stm32f405/registers.h"):
        (folder / "port" / name).parent.mkdir(exist_ok=True)
        shutil.copy(PORT.parent / name, folder / "port" / name)
    block = block_text(load_circuit(folder / "circuit.toml")[0], "circuit.toml")
    (folder / "port" / "hardware.h").write_text(block)
    source = folder / "port" / "stm32f405" / "board.c"
    return arm(*M4F, *STRICT, "-DTRANSOPT_PORT", f"-I{SRC}", "-c", source, "-o", "board.o", folder=folder)


def numbers_in(code: str) -> set[int]:
    """Immediate operands and literals of disassembled code."""
    literals = {int(word, 16) for word in re.findall(r"\.word\s+0x([0-9a-f]+)", code)}
    return literals | {int(value) for value in re.findall(r"#(\d+)", code)}


@pytest.mark.parametrize(("old", "new"), [("bits = 12", "bits = 10"), ('"dac"', '"pwm"')])
def test_a_circuit_with_converters_that_the_board_has_not_does_not_compile(
    old: str, new: str, tmp_path: Path
) -> None:
    done = compiled_for(old, new, tmp_path)
    assert done.returncode != 0
    assert "this board has converters of 12 bits" in done.stderr


@pytest.mark.parametrize(
    ("dt_s", "reload", "period"), [(5e-5, 4199, 4200), (1e-4, 8399, 8400), (1e-3, 41_999, 84_000)]
)
def test_a_period_of_the_board_is_that_of_the_circuit(dt_s: float, reload: int, period: int, tmp_path: Path) -> None:
    """TIM4 counts 16 bits, of 84 MHz: 1 ms is divided by two before it."""
    text = f"dt_s = {dt_s}\nresistors = 0.01"
    assert compiled_for("resistors = 0.01", text, tmp_path).returncode == 0
    code = tool("objdump", "-d", "board.o", folder=tmp_path)
    divider_of_tim4 = 0x828
    assert {reload, period, divider_of_tim4} <= numbers_in(code)


def test_the_counter_of_the_ticks_goes_on_while_the_processor_sleeps(tmp_path: Path) -> None:
    """A timer's, not the processor's own, which a late tick after a sleep would not show."""
    assert compiled_for("", "", tmp_path).returncode == 0
    code = tool("objdump", "-d", "--disassemble=board_cycles", "board.o", folder=tmp_path)
    counter_of_tim5 = 0x40000C24
    assert sum(numbers_in(code)) == counter_of_tim5


def test_the_stack_has_room_for_the_deepest_loop_and_a_tick_on_top_of_it(tmp_path: Path) -> None:
    """What the compiler says of every frame, along the deepest calls; ports are called by pointers."""
    core = sorted((SRC / "core").glob("*.c"))
    asked = ("-std=c11", "-O2", "-DTRANSOPT_PORT", f"-I{SRC}", "-fcallgraph-info=su", "-c")
    done = arm(*M4F, *asked, *core, PORT.parent / "main.c", PORT / "board.c", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    graph = "".join(path.read_text() for path in tmp_path.glob("*.ci"))
    assert graph.count("(static)") > 100
    assert "dynamic" not in graph  # no array of a length that only the run knows
    frames = {name: int(size) for name, size in re.findall(r'title: "([^"]+)" label: ".*?(\d+) bytes', graph)}
    calls: dict[str, set[str]] = {}
    for caller, called in re.findall(r'sourcename: "([^"]+)" targetname: "([^"]+)"', graph):
        calls.setdefault(caller, set()).add(called)
    of_port = max(
        size for name, size in frames.items() if name.endswith((":hold", ":put", "board_hold", "board_put"))
    )

    def deepest(name: str) -> int:
        below = max(map(deepest, calls.get(name, ())), default=0)
        return frames.get(name, of_port if name == "__indirect_call" else IN_A_LIBRARY) + below

    took = deepest("main") + EXCEPTION_FRAME + deepest("ADC_IRQHandler")
    assert took > 4096  # it is what it was made for
    least = re.search(r"td_stack_bottom >= (\d+)K", (PORT / "memory.ld").read_text())
    assert least is not None
    assert took <= 1024 * int(least[1])


def test_the_template_states_a_budget_for_every_function() -> None:
    template = (PORT.parent / "port_template.c").read_text()
    for comment, name in re.findall(r"/\*((?:(?!\*/).)*)\*/\n[a-z].*?\b(board_\w+)\(", template, re.DOTALL):
        assert re.search(r"\d+ cycles|\d+ us|\d+ s\b|Any time|One servo period", comment), name


PROGRAM = "char big[{bytes}]; int main(void) {{ return big[0]; }}"


def linked(size: int, folder: Path) -> subprocess.CompletedProcess[str]:
    (folder / "main.c").write_text(PROGRAM.format(bytes=size))
    link = ("-nostartfiles", "-T", PORT / "memory.ld")
    return arm(*M4F, "-O2", "main.c", PORT / "startup.c", *link, "-o", "image.elf", folder=folder)


def test_a_stopped_crystal_and_a_falling_supply_end_in_the_trap(tmp_path: Path) -> None:
    """The vectors of the non-maskable interrupt and of the supply's detector."""
    assert linked(64, tmp_path).returncode == 0
    (place,) = re.findall(r"^(\w+) \w td_trap$", tool("nm", "image.elf", folder=tmp_path), re.MULTILINE)
    tool("objcopy", "-O", "binary", "image.elf", "image.bin", folder=tmp_path)
    image = (tmp_path / "image.bin").read_bytes()
    nmi, detector = 2, 16 + 1
    thumb = 1
    assert {struct.unpack_from("<I", image, 4 * entry)[0] for entry in (nmi, detector)} == {int(place, 16) | thumb}


def test_the_trap_is_a_reset_that_wants_no_watchdog(tmp_path: Path) -> None:
    """What ends there before the first tick would stay there for ever: the watchdog does not run yet."""
    assert linked(64, tmp_path).returncode == 0
    code = tool("objdump", "-d", "--disassemble=td_trap", "image.elf", folder=tmp_path)
    key_and_request = 0x05FA0004
    assert key_and_request in numbers_in(code)


def test_bytes_of_the_line_are_read_behind_the_counter_that_says_they_came(tmp_path: Path) -> None:
    flags = ("-O2", "-std=c11", "-DTRANSOPT_PORT", f"-I{SRC}", "-c", PORT / "board.c", "-o", "board.o")
    assert arm(*M4F, *flags, folder=tmp_path).returncode == 0
    code = tool("objdump", "-d", "--disassemble=board_receive", "board.o", folder=tmp_path)
    assert code.index("ldr") < code.index("dmb") < code.index("ldrb")


def test_an_image_that_is_larger_than_the_memory_of_the_board_does_not_link(tmp_path: Path) -> None:
    """An emulator that has more memory would not show it."""
    assert linked((128 << 10) - 64, tmp_path).returncode == 0
    too_large = linked((128 << 10) + 8, tmp_path)
    assert too_large.returncode != 0
    assert "sram" in too_large.stderr.lower()


def test_the_stack_lies_at_the_bottom_of_the_ccm(tmp_path: Path) -> None:
    """What runs over it is no memory, so that it is a fault and writes over nothing."""
    assert linked(64, tmp_path).returncode == 0
    said = subprocess.run(
        [ARM.replace("gcc", "nm"), "image.elf"], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout
    at = {name: int(address, 16) for address, name in re.findall(r"^(\w+) \w (\w+)$", said, re.MULTILINE)}
    assert at["td_stack_bottom"] == 0x10000000
    assert at["td_stack_top"] - at["td_stack_bottom"] == 8192
    assert at["td_bss_end"] <= 0x20000000 + (128 << 10)


@pytest.mark.parametrize(
    ("processor", "flags", "said"),
    [
        (("-mcpu=cortex-m0plus",), (), "no floating-point unit"),
        (("-mcpu=cortex-m3",), ("-DTD_REAL_FLOAT",), "no floating-point unit"),
        (("-mcpu=cortex-m0plus",), ("-DTD_SOFTWARE_FLOAT",), ""),
        (M4F, (), ""),
        (("-mcpu=cortex-m7", "-mfpu=fpv5-d16", "-mfloat-abi=hard"), (), ""),
    ],
)
def test_a_processor_that_computes_in_software_is_refused(
    processor: tuple[str, ...], flags: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    asked = (*processor, *flags, "-DTRANSOPT_PORT", f"-I{SRC}", "-E", SRC / "core" / "td_guard.c")
    done = arm(*asked, folder=tmp_path)
    assert (done.returncode != 0) == bool(said)
    assert said in done.stderr


def test_what_the_emulated_board_falls_short_of_is_told() -> None:
    """Taps, refinement, memories, and the port's part of a tick."""
    taps = [Tap(0.2, 3.0, 0.0, 0.20, 0.20)] * (TAPS - 2) + [Tap(0.3, 3.0, 0.0, 0.24, 0.20)]
    sized = [("stm32f405", 10, 131_073, 8192, 201)]
    said = misses(taps, TAPS, "1 of 2 nodes refined", sized)
    assert len(said) == 5
    for words in ("a tap at 0.3 m/s: error 24.00 %", "11 of 12 taps", "refine", "SRAM is full", "201 instructions"):
        assert any(words in line for line in said), words
    assert not misses(taps[:1] * TAPS, TAPS, "2 of 2 nodes refined", [("stm32f405", 10, 131_072, 8192, 200)])
