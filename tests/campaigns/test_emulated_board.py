"""A whole board under QEMU, through the commands of a user: described, zeroed, checked, loaded, tapped, refined.

    python -m pytest -m long -n 0 tests/campaigns/test_emulated_board.py
        --campaign="[--short] [--baud RATE] [--out DIR] [--part FILE]"

CMake builds the image for an STM32F405 and links it for its memories. The one for QEMU's netduinoplus2 has the file
`emulated.c` in place of `board.c`, and a stylus in a hand in place of the converters. `transopt-play` finds its
serial port, a pseudo-terminal, as behind a cable. Twelve taps are played, then two nodes refined. It fails if a
command does, if a tap's error is more than 3 points from the library's, if a memory is full, or if a port's own part
of a tick has more instructions than its budget allows. Short: the check leaves out encoder, accelerometer and grip,
and four taps are played. With a rate below 3.7 Mbaud the board keeps each tap and sends it afterwards.
"""

import re
import subprocess
import tempfile
from contextlib import redirect_stdout
from pathlib import Path
from typing import Annotated

import pytest
from typer import Option

from tests.benches.board import Ear, MissingToolError, build_images, emulated, need_tools
from tests.campaigns.harness import PartFile, long_form, show, solved, write_part
from tests.campaigns.test_desk import MOST_OVER, Tap, taps_in, typed
from transopt.base.errors import InputError
from transopt.library.library import Library

SCENE = {"grid.speeds_m_s": [0.2, 0.3], "grid.grips_N": [3.0]}  # as much as comes over an emulated line in a second
TAPPED_M_S, TAPS, TAPS_IN_SHORT = (0.21, 0.28), 12, 4
DONE_BY_A_PERSON = ("encoder", "accelerometer", "grip-zero", "grip-hold")
MEMORIES = {"flash": 896 * 1024, "SRAM": 128 * 1024, "CCM": 64 * 1024}
PORT_CYCLES = 400  # of a tick beside the core, see port/port_template.c
CYCLES = 2  # of an instruction, at most on average: as ARM's table has loads, stores and what fills the pipeline
OF_THE_TICK = {"ADC_IRQHandler": 1, "port_tick": 1, "put": 1, "value_of": 3, "board_converted": 3}
OF_THE_TICK |= dict.fromkeys(("board_cycles", "board_period_cycles", "board_alive", "board_encoder"), 1)
OF_THE_TICK |= dict.fromkeys(("board_stop_pressed", "board_put"), 1)


def sizes(image: Path) -> tuple[int, int, int]:
    """Bytes of flash, of SRAM, and of the stack."""
    said = subprocess.run(["arm-none-eabi-size", "-A", str(image)], capture_output=True, text=True, check=True).stdout
    of = {name: int(size) for name, size in re.findall(r"^(\.\S+) +(\d+) +\d+", said, re.MULTILINE)}
    stored = of[".data"]
    return of[".text"] + of.get(".ARM.exidx", 0) + stored, stored + of[".bss"], of[".stack"]


def instructions_of_the_port(image: Path) -> int:
    """Most instructions that a tick executes outside of the core: all of its functions, none of which has a loop."""
    command = ["arm-none-eabi-objdump", "-d", "--no-show-raw-insn", str(image)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    bodies = re.findall(r"^[0-9a-f]+ <(\w+)>:\n((?:.+\n)+)", said, re.MULTILINE)
    return sum(OF_THE_TICK.get(name, 0) * len(re.findall(r":\t[a-z]", body)) for name, body in bodies)


def rows_of_sizes(images: dict[str, Path]) -> list[tuple[object, ...]]:
    return [(name, *sizes(image), instructions_of_the_port(image)) for name, image in images.items()]


def taps_asked(short: bool) -> int:
    return TAPS_IN_SHORT if short else TAPS


def through_the_commands(ear: Ear, library: Library, folder: Path, short: bool) -> list[Tap]:
    """The road of a device, each command as a user types it, in the hearing of the hand; the taps.

    Raises
    ------
    InputError : one of them ended with another exit code than 0.
    """
    board, path, device = ear.board, folder / "library.npz", folder / "device.toml"
    library.save(path)
    port = ("--port", board.port, "--device", device)
    skipped = [word for name in DONE_BY_A_PERSON if short for word in ("--skip", name)]
    with redirect_stdout(ear):
        typed("transopt-play", "device", "new", device, "--defaults")
        typed("transopt-play", "zero", *port)
        typed("transopt-play", "check", path, *port, "--patience", 10, *skipped)
        typed("transopt-play", "upload", path, *port)
        board.ask(f"please taps {' '.join(map(str, TAPPED_M_S))}")
        typed("transopt-play", "tap", path, *port, "--taps", taps_asked(short), "--for", 60)
        taps = taps_in(ear.text, library)
        typed(
            "transopt-play",
            "refine",
            path,
            *port,
            "--taps",
            2,
            "--rounds",
            1,
            "--for",
            60,
            "--out",
            folder / "refined",
        )
    return taps


def misses(taps: list[Tap], asked: int, said: str, sized: list[tuple[object, ...]]) -> list[str]:
    """What is not as asked, one line each."""
    found = [
        f"a tap at {t.speed_m_s:g} m/s: error {100 * t.tap_error:.2f} %, predicted {100 * t.predicted:.2f} %"
        for t in taps
        if not abs(t.tap_error - t.predicted) <= MOST_OVER
    ]
    if len(taps) != asked:
        found.append(f"{len(taps)} of {asked} taps")
    if "2 of 2 nodes refined" not in said:
        found.append("refine: not 2 of 2 nodes refined")
    for name, *used, instructions in sized:
        over = [what for (what, most), size in zip(MEMORIES.items(), used, strict=True) if size > most]
        found += [f"{name}: {what} is full" for what in over]
        if name == "stm32f405" and CYCLES * int(str(instructions)) > PORT_CYCLES:
            found.append(f"{name}: {instructions} instructions of its own in a tick, for {PORT_CYCLES} cycles")
    return found


def main(
    short: Annotated[
        bool, Option("--short", help="leave out the steps of the check that a person does by hand")
    ] = False,
    baud: Annotated[int, Option(min=0, help="rate of the line; 0 for one that takes all")] = 0,
    out: Annotated[Path | None, Option(help="keep images, device file and libraries here")] = None,
    part: PartFile = None,
) -> int:
    try:
        need_tools()
    except MissingToolError as missing:
        pytest.skip(str(missing))
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) if out is None else out
        folder.mkdir(parents=True, exist_ok=True)
        images = build_images(folder / "images")
        with emulated(images["emulated"], baud) as board:
            ear = Ear(board)
            try:
                taps = through_the_commands(ear, solved("wood_on_foam", SCENE), folder, short)
            except InputError:
                print(ear.text)
                raise
        sized = rows_of_sizes(images)
    lines = show(("image", "flash B", "SRAM B", "CCM B: the stack", "instructions of the port in a tick"), sized)
    there_is = ", ".join(f"{name} {size}" for name, size in MEMORIES.items())
    lines += ["", f"There are, in bytes: {there_is}.", ""]
    rows = []
    for speed in TAPPED_M_S:
        near = [tap for tap in taps if abs(tap.speed_m_s - speed) < 0.1 * speed]
        errors = sorted(100 * tap.tap_error for tap in near)
        said = sorted(100 * tap.predicted for tap in near)
        rows.append((speed, len(near), *(f"{v[0]:.1f} to {v[-1]:.1f}" if v else "-" for v in (errors, said))))
    lines += show(("tapped at m/s", "taps", "tap error %", "predicted %"), rows)
    write_part(part, lines)
    missed = misses(taps, taps_asked(short), ear.text, sized)
    print("\n".join(missed) or "as asked")
    return 1 if missed else 0


test_long_form = long_form(main)
