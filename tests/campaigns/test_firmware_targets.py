"""The C core for the processors of real devices, compiled with Debian's toolchain and run under QEMU.

    python -m pytest -m long -n 0 tests/campaigns/test_firmware_targets.py
        --campaign="[LIBRARY] [--seed 0] [--part FILE]"

Recorded runs of the servo and recorded conversations with the device, random ones and with LIBRARY taps on the
simulator too, are played by the core for Cortex-M4F (single precision) and Cortex-M7 (double), by its Arduino library
with that tool's flags as well. The hash of all answers must be that of the host's build. Instructions are those that
QEMU counts (-icount): not cycles, and no silicon. Needs arm-none-eabi-gcc with newlib, and qemu-system-arm (Debian:
gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm). What the device does beside its servo until the command is
out, and the longest tick of the Cortex-M4F in cycles, have limits. It fails if a hash is another or a limit is
passed.
"""

import re
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import pytest
from typer import Argument

from controller.firmware.build import CORE, FIRMWARE, FLAGS, STRICT, build, sources
from controller.firmware.core_device import REPLAY
from tests.benches import board
from tests.benches.board import MissingToolError
from tests.benches.core_replay import write_runs
from tests.campaigns.harness import PartFile, Seed, library_of, long_form, write_part
from tests.campaigns.parity_runs import random_run, tap_run
from tests.campaigns.test_device_conversations import random_talk
from transopt.base.errors import InputError
from transopt.base.writing import table

DAMAGES = (0.0, 0.02, 0.3)  # parts of the frames that arrive damaged, in turn
EMULATOR = FIRMWARE / "port" / "emulator"
LIBRARY = FIRMWARE / "src"
ARM, QEMU = "arm-none-eabi-gcc", "qemu-system-arm"
RUN_S = 120.0
WRAPPED = ("main", "td_servo_step", "td_servo_answer", "td_servo_applied")
WRAPPED += ("td_device_step", "td_device_begin", "td_device_receive")
SECTIONS = ("-O2", "-ffunction-sections", "-fdata-sections")
PROGRAMS = {"runs": ("td_replay.c", "replay_main.c"), "talks": ("td_probe.c", "talk_main.c")}
MOST_BEFORE_COMMAND = 500  # instructions, of the device beside its servo
MOST_HELD = 5600  # instructions for which the loop keeps the tick out: 48 us; by 50 us the tick would count as late
PERIOD_CYCLES = 16_800  # of a servo period of 0.1 ms at 168 MHz, the clock of common Cortex-M4F
# From ARM's tables without wait states, over ticks of more than 9000 instructions; test_firmware_cycles.py counts.
CYCLES_PER_INSTRUCTION = 1.45
M4F = ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16")
M7 = ("-mcpu=cortex-m7", "-mfpu=fpv5-d16")


@dataclass(frozen=True)
class Target:
    """A processor, and how the core is compiled for it.

    Attributes
    ----------
    flags : beside those of the processor. host : what makes the host's build the same device.
    library : the sources as an Arduino tool finds and compiles them, without -std and -ffp-contract.
    """

    name: str
    machine: str
    processor: tuple[str, ...]
    precision: str
    flags: tuple[str, ...] = ()
    host: tuple[str, ...] = ()
    library: bool = False


def _capacities(samples: int, speeds: int, grips: int, records: int) -> tuple[str, ...]:
    """Set the capacities of src/transopt_port.h, which the hash of a conversation tells from all others."""
    return (
        f"-DTD_MAX_LIBRARY_SAMPLES={samples}",
        f"-DTD_MAX_SPEEDS={speeds}",
        f"-DTD_MAX_GRIPS={grips}",
        f"-DTD_MAX_RECORDS={records}",
    )


SINGLE = ("-DTD_REAL_FLOAT",)
TEENSY = ("-D__IMXRT1062__",)
TARGETS = (
    Target("Cortex-M4F", "mps2-an386", M4F, "single", SINGLE, SINGLE),
    Target("Cortex-M7", "mps2-an500", M7, "double"),
    Target("Arduino, Cortex-M4F", "mps2-an386", M4F, "single", (), (*SINGLE, *_capacities(16384, 16, 8, 128)), True),
    Target("Arduino, Teensy 4.1", "mps2-an500", M7, "double", TEENSY, _capacities(94208, 32, 16, 512), True),
)


@dataclass
class Found:
    """What came of one target.

    Attributes
    ----------
    hashes : by program, (target's, host's). counts : by what was called, (calls, instructions on average, at most).
    text_bytes : code and constants of the core alone, without the compiler's and newlib's routines.
    device_bytes : one td_device, the core's only memory beside the stack. stack_bytes : at most, with test program.
    """

    hashes: dict[str, tuple[str, str]] = field(default_factory=dict)
    counts: dict[str, tuple[int, float, int]] = field(default_factory=dict)
    text_bytes: int = 0
    device_bytes: int = 0
    stack_bytes: int = 0

    def alike(self) -> bool:
        return all(target == host for target, host in self.hashes.values())

    def longest_tick(self) -> int:
        """Cycles of a Cortex-M4F for the device's longest tick."""
        return round(self.counts["talks device"][2] * CYCLES_PER_INSTRUCTION)


def need_tools() -> None:
    """Raises
    ------
    MissingToolError : which, and the package that has it.
    """
    board.need_tools(ARM, QEMU)
    done = subprocess.run([ARM, "-print-file-name=rdimon.specs"], capture_output=True, text=True, check=True)
    if not Path(done.stdout.strip()).is_absolute():
        raise MissingToolError(f"{ARM}: has no newlib; install libnewlib-arm-none-eabi (Debian)")


def _run(command: Sequence[str | Path], folder: Path) -> str:
    words = [str(word) for word in command]
    try:
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=RUN_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise InputError(f"{words[0]}: {error}") from None
    if done.returncode:
        said = next(
            (line for line in done.stderr.splitlines() if "error" in line), done.stderr.strip() or "no message"
        )
        raise InputError(f"{words[0]}: ended with {done.returncode}: {said[:300]}")
    return done.stdout


def compiler_flags(target: Target) -> list[str]:
    """All but what is compiled."""
    own = [] if target.library else FLAGS
    headers = ["-DARDUINO=10819"] if target.library else []
    return ["-mthumb", *target.processor, "-mfloat-abi=hard", *own, *SECTIONS, *STRICT, *target.flags, *headers]


def compile_core(target: Target, folder: Path) -> list[Path]:
    """Object files of the core, or of the Arduino library, in this folder."""
    files = [*sources(CORE), *(sources(LIBRARY) if target.library else [])]
    _run([ARM, *compiler_flags(target), "-c", *files], folder)
    return [folder / f"{path.stem}.o" for path in files]


def play(target: Target, records: dict[str, Path], folder: Path) -> Found:
    """Compile and run everything for one target.

    Parameters
    ----------
    records : file by name of the program that reads it, see `PROGRAMS`. folder : for what is built, empty.

    Raises
    ------
    InputError : what does not compile or does not run to its end.
    """
    found, objects = Found(), compile_core(target, folder)
    sizes = _run([ARM.replace("gcc", "size"), *objects], folder).splitlines()[1:]
    found.text_bytes = sum(int(line.split()[0]) for line in sizes)
    if any(line.split()[1:3] != ["0", "0"] for line in sizes):
        raise InputError("the core has variables outside of td_device")
    wrap = ",".join(f"--wrap={name}" for name in WRAPPED)
    for name, record in records.items():
        own = [REPLAY / file for file in PROGRAMS[name]]
        link = ["--specs=rdimon.specs", "-T", EMULATOR / "mps2.ld", f"-Wl,--gc-sections,{wrap}", "-lm"]
        include = [f"-I{CORE}", f"-I{REPLAY}"]
        everything = [*include, *own, *sources(EMULATOR), *objects]
        _run([ARM, *compiler_flags(target), *everything, *link, "-o", f"{name}.elf"], folder)
        said = _run(
            [
                QEMU,
                *("-machine", target.machine, "-nographic", "-monitor", "none", "-serial", "none"),
                *("-semihosting-config", f"enable=on,target=native,arg={name},arg={record}"),
                *("-icount", "shift=0", "-kernel", folder / f"{name}.elf"),
            ],
            folder,
        )
        host = build(f"target-{name}", [*sources(CORE), *own], flags=target.host)
        found.hashes[name] = said.split()[0], _run([host, record], folder).strip()
        for what, calls, average, most in re.findall(
            r"^(\w+) (\d+) calls, ([\d.]+) instructions on average, (\d+) at most", said, re.MULTILINE
        ):
            found.counts[f"{name} {what}"] = int(calls), float(average), int(most)
        found.device_bytes = int(re.findall(r"^device (\d+) bytes", said, re.MULTILINE)[0])
        found.stack_bytes = max(found.stack_bytes, int(re.findall(r"^stack (\d+) bytes", said, re.MULTILINE)[0]))
    return found


def record(folder: Path, seed: int, library: Path | None, *, runs: int = 6, ticks: int = 4000) -> dict[str, Path]:
    """Files of random runs and conversations, of taps too where there is a library to play."""
    recorded = [random_run(1000 * seed + j, ticks).run_bytes() for j in range(runs)]
    if library is not None:
        loaded = library_of(library)
        recorded += [tap_run(loaded, 1000 * seed + j).run_bytes() for j in range(runs)]
    write_runs(folder / "runs", recorded)
    talks = [random_talk(1000 * seed + j, DAMAGES[j % len(DAMAGES)], 1, ticks=ticks) for j in range(runs)]
    (folder / "talks").write_bytes(b"".join(talk.talk() for talk in talks))
    return {name: folder / name for name in PROGRAMS}


def rows(found: dict[Target, Found]) -> list[str]:
    """Markdown, one row a target."""
    head = ["target", "precision", "text B", "td_device B", "stack B", "servo tick: mean / worst"]
    head += ["device tick: mean / worst", "of it servo", "of it device", "command out", "of it device"]
    head += ["interrupt held", "longest tick, cycles", "hash equal"]
    cells = []
    for target, f in found.items():
        talks = (f.counts[f"talks {name}"] for name in ("device", "inner", "device_own", "command", "command_own"))
        counted = (f.counts["runs servo"], *talks)
        ticks = (f"{mean:.0f} / {most}" for _, mean, most in counted)
        sizes = (f.text_bytes, f.device_bytes, f.stack_bytes)
        equal = "yes" if f.alike() else "NO"
        longest = f.longest_tick() if target.processor == M4F else ""
        cells.append([target.name, target.precision, *sizes, *ticks, f.counts["talks held"][2], longest, equal])
    return table(head, cells)


def misses(found: dict[Target, Found]) -> list[str]:
    """What is not as asked, one line each."""
    said = []
    for target, f in found.items():
        before = f.counts["talks command_own"][2]
        if not f.alike():
            said.append(f"{target.name}: other answers than the host's build")
        if before > MOST_BEFORE_COMMAND:
            said.append(f"{target.name}: {before} instructions beside the servo before the command is out")
        held = f.counts["talks held"][2]
        if held > MOST_HELD:
            said.append(f"{target.name}: {held} instructions for which the interrupt is held")
        if target.processor == M4F and f.longest_tick() > PERIOD_CYCLES:
            said.append(f"{target.name}: a tick of {f.longest_tick()} cycles, of {PERIOD_CYCLES} that there are")
    return said


def main(
    library: Annotated[Path | None, Argument(help="library.npz of a simulated scene, for taps")] = None,
    seed: Seed = 0,
    part: PartFile = None,
) -> int:
    found = {}
    try:
        need_tools()
    except MissingToolError as missing:
        pytest.skip(str(missing))
    with tempfile.TemporaryDirectory() as scratch:
        records = record(Path(scratch), seed, library)
        for j, target in enumerate(TARGETS):
            folder = Path(scratch) / str(j)
            folder.mkdir()
            found[target] = play(target, records, folder)
    counts = next(iter(found.values())).counts
    lines = rows(found)
    lines.append(
        f"{counts['runs servo'][0]} ticks of the servo, {counts['talks device'][0]} of the device, each target."
    )
    lines.append("Instructions as QEMU counts them, in steps of 40; mean / worst. No silicon was tested.")
    write_part(part, lines)
    print("\n".join(lines))
    missed = misses(found)
    print("\n".join(missed), end="\n" if missed else "")
    return 1 if missed else 0


test_long_form = long_form(main)
