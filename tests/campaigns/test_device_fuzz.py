"""Fuzz the device's core by libFuzzer, in double and in single precision, under sanitizers.

    python -m pytest -m long -n 0 tests/campaigns/test_device_fuzz.py
        --campaign="[--seconds 30] [--keep FOLDER] [--mutants]"

The harness and what it asks of the device stand in `controller/firmware/fuzz/fuzz_device.c`. Both precisions run at
once, each for so long. It fails if something was found: the inputs that show it are kept in FOLDER. With `--mutants`
the core lacks one of its rules at a time, in double precision, and the campaign fails if that is not found within so
many seconds of processor time, from the corpus that an earlier run has left in FOLDER.
"""

import resource
import shutil
import signal
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
from typer import Option

from controller.firmware.build import CORE, FIRMWARE, sources
from tests.campaigns.harness import at_least, long_form, show

HARNESS = FIRMWARE / "fuzz"
PRECISIONS: dict[str, tuple[str, ...]] = {"double": (), "single": ("-DTD_REAL_FLOAT",)}
# Small capacities, so that a device starts fast.
FLAGS = (
    *("-g", "-O1", "-std=c99", "-ffp-contract=off", "-fno-sanitize-recover=all"),
    "-fsanitize=fuzzer,address,undefined",
    *("-DTD_MAX_LIBRARY_SAMPLES=20000", "-DTD_MAX_SPEEDS=4", "-DTD_MAX_GRIPS=4", "-DTD_MAX_RECORDS=64"),
)
LONGEST_INPUT = 600
WAITING = 20  # longest time of a mutant over its processor time, on a busy machine


@dataclass(frozen=True)
class Mutant:
    """The core without one of its rules.

    Attributes
    ----------
    rule : what is no longer kept. file : of the core. old, new : a text that stands in it once, and its replacement.
    """

    rule: str
    file: str
    old: str
    new: str


MUTANTS = (
    Mutant(
        "a pulse's limit holds for the amplifier's command too",
        "td_request.c",
        "fabs(current_A) <= hardware->pulse_A && fabs(commanded_A) <= hardware->pulse_A",
        "fabs(current_A) <= hardware->pulse_A && commanded_A == commanded_A",
    ),
    Mutant(
        "a pulse has the hardware's length at most",
        "td_request.c",
        "ticks == 0 || ticks > td_device_ticks(device, 1e3 * hardware->pulse_s)",
        "ticks == 0",
    ),
    Mutant(
        "a rest precedes each pulse",
        "td_pulse.c",
        "(int32_t)ceil(TD_REST_BETWEEN_PULSES_S / config->dt_s)",
        "(int32_t)ceil(0.1 * TD_REST_BETWEEN_PULSES_S / config->dt_s)",
    ),
    Mutant(
        "pulses end with the lease",
        "td_tick.c",
        "if (td_device_is_active(device) || device->pulse.left > 0) {",
        "if (td_device_is_active(device)) {",
    ),
    Mutant(
        "a pulse too small to be measured is no evidence",
        "td_request.c",
        "if (pairs > 0 && !shows(hardware, calibration, fabs(current_A)))",
        "if (pairs > 0 && !shows(hardware, calibration, 1.0))",
    ),
    Mutant(
        "a trial of no current is no evidence",
        "td_evidence.c",
        "(td_wide)flowed->least_A >= least_A && agrees(",
        "least_A >= 0 && agrees(",
    ),
    Mutant(
        "a trial is of one library",
        "td_request.c",
        "        td_evidence_other_library(&device->evidence);",
        "        device->trial = false;",
    ),
    Mutant(
        "a current below the expected one is a fault",
        "td_watch.c",
        "gap = td_size(watch->current_A - expected_A);",
        "gap = size - expected;",
    ),
    Mutant(
        "a current above the expected one is a fault",
        "td_watch.c",
        "gap = td_size(watch->current_A - expected_A);",
        "gap = expected - size;",
    ),
    Mutant(
        "the true current keeps the hardware's limit",
        "td_ring.c",
        "return td_within(td_within(command_A, low, high), -ring->command_A, ring->command_A);",
        "return low > high ? 0 : td_within(command_A, -ring->command_A, ring->command_A);",
    ),
    Mutant(
        "the coil keeps its temperature",
        "td_ring.c",
        "if (td_guard_too_hot(&ring->guard, &ring->coil))",
        "if (false)",
    ),
    Mutant(
        "the memory of an arriving library keeps no records",
        "td_request.c",
        "    td_records_give_back(&device->records);\n",
        "",
    ),
)


def built(precision: str, folder: Path, core: Path = CORE) -> Path:
    """The harness with the core; raises CalledProcessError if they do not compile."""
    program = folder / f"fuzz_{precision}"
    files = map(str, [*sources(core), *sources(HARNESS)])
    command = ["clang", *FLAGS, *PRECISIONS[precision], f"-I{core}", *files, "-lm", "-o", str(program)]
    subprocess.run(command, check=True)
    return program


def begun(program: Path, name: str, folder: Path, seconds: int, cpu_s: int | None = None) -> subprocess.Popen[str]:
    """A fuzzer that runs on a corpus of this name. cpu_s : processor time after which it is killed."""
    corpus = folder / f"corpus_{name}"
    corpus.mkdir(parents=True, exist_ok=True)
    options = (f"-max_total_time={seconds}", f"-max_len={LONGEST_INPUT}", f"-artifact_prefix={folder}/{name}-")
    bound = [] if cpu_s is None else ["prlimit", f"--cpu={cpu_s}"]
    return subprocess.Popen([*bound, str(program), *options, str(corpus)], stderr=subprocess.PIPE, text=True)


def ended(running: subprocess.Popen[str], seconds: int) -> str:
    """What a fuzzer has said in the end."""
    said = running.communicate(timeout=seconds + 120)[1]
    words = [line for line in said.splitlines() if line.startswith(("tick ", "Done ", "==", "SUMMARY"))]
    return "; ".join(words) or said[-300:]


def mutated(mutant: Mutant, folder: Path) -> Path:
    """A copy of the core without the rule."""
    shutil.copytree(CORE, folder)
    text = (CORE / mutant.file).read_text()
    assert text.count(mutant.old) == 1, f"{mutant.file}: {mutant.old}"
    (folder / mutant.file).write_text(text.replace(mutant.old, mutant.new))
    return folder


def hunted(folder: Path, seconds: int) -> int:
    """Look for every mutant; how many were not found."""
    rows, missed = [], 0
    for number, mutant in enumerate(MUTANTS):
        corpus = folder / f"corpus_mutant_{number}"
        if (folder / "corpus_double").is_dir():
            shutil.copytree(folder / "corpus_double", corpus, dirs_exist_ok=True)
        with tempfile.TemporaryDirectory() as scratch:
            program = built("double", folder, mutated(mutant, Path(scratch) / "core"))
        begin_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        running = begun(program, f"mutant_{number}", folder, WAITING * seconds, seconds)
        said = ended(running, WAITING * seconds)
        took_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - begin_s
        found = running.returncode not in (0, -signal.SIGXCPU, -signal.SIGKILL)
        missed += not found
        shutil.rmtree(corpus)
        rows.append((mutant.rule, f"{took_s:.0f} s" if found else "not found", said.split("; true")[0][:70]))
        print(*rows[-1], sep=": ", flush=True)
    show(("rule left out", "found after", "by"), rows)
    return missed


def main(
    seconds: Annotated[int, at_least(1, "of fuzzing, each precision or mutant")] = 30,
    keep: Annotated[Path | None, Option(metavar="FOLDER", help="for corpus and findings")] = None,
    mutants: Annotated[bool, Option("--mutants", help="fuzz the core without one of its rules at a time")] = False,
) -> int:
    if shutil.which("clang") is None:
        pytest.skip("clang: not found; install clang and libclang-rt-dev (Debian)")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) if keep is None else keep
        folder.mkdir(parents=True, exist_ok=True)
        if mutants:
            return 1 if hunted(folder, seconds) else 0
        programs = {precision: built(precision, folder) for precision in PRECISIONS}
        running = {name: begun(program, name, folder, seconds) for name, program in programs.items()}
        for precision, process in running.items():
            print(f"{precision}: {ended(process, seconds)}")
        return 1 if any(process.returncode for process in running.values()) else 0


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.rule)
def test_every_rule_that_a_mutant_lacks_stands_in_the_core(mutant: Mutant, tmp_path: Path) -> None:
    core = mutated(mutant, tmp_path / "core")
    assert (core / mutant.file).read_text() != (CORE / mutant.file).read_text()


test_long_form = long_form(main)
