"""How many cycles an instruction of the core takes at most on a Cortex-M4F: every instruction of a tick looked up.

    python -m pytest -m long -n 0 tests/campaigns/test_firmware_cycles.py
        --campaign="[--seed 0] [--conversation 0] [--ticks 4000]"

QEMU writes down each instruction of the device's ticks in one of the conversations of `test_firmware_targets.py`, and
each is given the cycles of ARM's tables for the processor (Cortex-M4 Technical Reference Manual, "Instruction set
summary" and "FPU instruction set"; no wait states): every load and store two, although most follow each other in one,
every branch that is taken a refill of three, the longest, every integer division twelve. What is printed for the long
ticks, which limit the servo, is where `test_firmware_targets.py` has its factor from. It fails if one of them takes
more. Needs what that campaign needs.
"""

import os
import re
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import pytest

from tests.campaigns.harness import Seed, at_least, long_form
from tests.campaigns.test_device_conversations import random_talk
from tests.campaigns.test_firmware_targets import (
    ARM,
    CYCLES_PER_INSTRUCTION,
    DAMAGES,
    QEMU,
    RUN_S,
    TARGETS,
    MissingToolError,
    need_tools,
    play,
)

REFILL = 3
ROOT = "td_device_step"
LONG = 9000  # instructions: a contact at which the coil is updated too
REGISTERS = {"sl": 10, "fp": 11, "ip": 12, "sp": 13, "lr": 14, "pc": 15}
COUNTS = {"vdiv": 14, "vsqrt": 14, "vmla": 3, "vmls": 3, "vnml": 3, "udiv": 12, "sdiv": 12, "mla": 2, "mls": 2}
PAIRS = ("ldrd", "strd")
SEVERAL = ("push", "pop", "ldm", "stm", "vpush", "vpop", "vldm", "vstm")
Instruction = tuple[int, str, int]  # bytes, name, cycles without a refill


def _listed(registers: str) -> int:
    """How many words a list such as {r4, r5-r8, pc} or {d8-d9} names."""
    count = 0
    for part in registers.split(","):
        ends = [REGISTERS.get(name.strip()) or int(name.strip()[1:]) for name in part.split("-")]
        count += (ends[-1] - ends[0] + 1) * (2 if part.strip().startswith("d") else 1)
    return count


def cycles(name: str, operands: str) -> int:
    """Cycles of one instruction, at most, without the refill of a branch that is taken."""
    listed = re.search(r"\{(.*)\}", operands)
    if name.startswith(SEVERAL) and listed:
        return 1 + _listed(listed[1])
    if name.startswith(PAIRS) or (name.startswith(("vldr", "vstr")) and operands.startswith("d")):
        return 3
    if name.startswith(("ldr", "str", "tb", "vldr", "vstr")):
        return 2
    if name.startswith("vmov") and operands.count(",") > 1:
        return 2
    return next((count for start, count in COUNTS.items() if name.startswith(start)), 1)


def read_program(program: Path) -> tuple[dict[int, Instruction], int]:
    """Instructions by their address, and where a tick begins."""
    listing = subprocess.run(
        [ARM.replace("gcc", "objdump"), "-d", program], capture_output=True, text=True, check=True
    ).stdout
    found = re.findall(r"^ +([0-9a-f]+):\t([0-9a-f ]+)\t([\w.]+)\s*(.*)$", listing, re.MULTILINE)
    begins = re.search(rf"^([0-9a-f]+) <{ROOT}>:", listing, re.MULTILINE)
    table = {
        int(at, 16): (len(code.replace(" ", "")) // 2, name, cycles(name, rest)) for at, code, name, rest in found
    }
    return table, int(begins[1], 16)


def trace(program: Path, machine: str, conversation: Path, pipe: Path) -> Iterator[int]:
    """Addresses of the instructions as they are gone through."""
    os.mkfifo(pipe)
    hidden = ("-nographic", "-monitor", "none", "-serial", "none")
    arguments = f"enable=on,target=native,arg=talks,arg={conversation}"
    with subprocess.Popen(
        [
            *(QEMU, "-machine", machine, *hidden, "-semihosting-config", arguments, "-singlestep"),
            *("-d", "exec,nochain", "-D", pipe, "-kernel", program),
        ],
        stdout=subprocess.DEVNULL,
    ) as emulator:
        with pipe.open() as lines:
            for line in lines:
                at = re.search(r"\[[0-9a-f]+/([0-9a-f]+)/", line)
                if at:
                    yield int(at[1], 16)
        emulator.wait(RUN_S)


def ticks_of(addresses: Iterator[int], program: dict[int, Instruction], begins: int) -> list[tuple[int, int]]:
    """(instructions, cycles at most) of each tick."""
    found, before, ends = [], 0, -1
    instructions = total = 0
    for at in addresses:
        if ends >= 0:
            size, _, least = program[before]
            instructions += 1
            total += least + (REFILL if at != before + size else 0)
            if at == ends:
                found.append((instructions, total))
                ends = -1
        elif at == begins:
            ends = before + program[before][0]
            instructions = total = 0
        before = at
    return found


def main(
    seed: Seed = 0,
    conversation: Annotated[int, at_least(0, "which of the seed's")] = 0,
    ticks: Annotated[int, at_least(100, "of the conversation; 4000 take a minute")] = 4000,
) -> int:
    try:
        need_tools()
    except MissingToolError as missing:
        pytest.skip(str(missing))
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        built = folder / "built"
        built.mkdir()
        talks = folder / "talks"
        damage = DAMAGES[conversation % len(DAMAGES)]
        talks.write_bytes(random_talk(1000 * seed + conversation, damage, 1, ticks=ticks).talk())
        play(TARGETS[0], {"talks": talks}, built)
        program, begins = read_program(built / "talks.elf")
        found = ticks_of(trace(built / "talks.elf", TARGETS[0].machine, talks, folder / "pipe"), program, begins)
    longest = [total / instructions for instructions, total in found if instructions > LONG]
    print(f"{len(found)} ticks, at most {max(n for n, _ in found)} instructions, {max(c for _, c in found)} cycles")
    print(
        f"cycles per instruction at most: {sum(c for _, c in found) / sum(n for n, _ in found):.3f} on average",
        end="",
    )
    print(f", {max(longest):.3f} in a tick of more than {LONG} instructions ({len(longest)})" if longest else "")
    return int(max(longest, default=0.0) > CYCLES_PER_INSTRUCTION)


test_long_form = long_form(main)
