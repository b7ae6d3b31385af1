"""Fuzz the device's core by libFuzzer, in double and in single precision, under sanitizers.

    python -m pytest -m long -n 0 tests/campaigns/test_device_fuzz.py --campaign="[--seconds 30] [--keep FOLDER]"

The harness and what it asks of the device stand in `controller/firmware/fuzz/fuzz_device.c`. Both precisions run at
once, each for so long. It fails if something was found: the inputs that show it are kept in FOLDER.
"""

import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Annotated

import pytest
from typer import Option

from controller.firmware.build import CORE, FIRMWARE, sources
from tests.campaigns.harness import at_least, long_form

HARNESS = FIRMWARE / "fuzz"
PRECISIONS: dict[str, tuple[str, ...]] = {"double": (), "single": ("-DTD_REAL_FLOAT",)}
# Small capacities, so that a device starts fast.
FLAGS = (
    *("-g", "-O1", "-std=c99", "-ffp-contract=off", "-fno-sanitize-recover=all"),
    "-fsanitize=fuzzer,address,undefined",
    *("-DTD_MAX_LIBRARY_SAMPLES=20000", "-DTD_MAX_SPEEDS=4", "-DTD_MAX_GRIPS=4", "-DTD_MAX_RECORDS=64"),
)
LONGEST_INPUT = 600


def built(precision: str, folder: Path) -> Path:
    """The harness with the core; raises CalledProcessError if they do not compile."""
    program = folder / f"fuzz_{precision}"
    files = map(str, [*sources(CORE), *sources(HARNESS)])
    command = ["clang", *FLAGS, *PRECISIONS[precision], f"-I{CORE}", *files, "-lm", "-o", str(program)]
    subprocess.run(command, check=True)
    return program


def main(
    seconds: Annotated[int, at_least(1, "of fuzzing, each precision")] = 30,
    keep: Annotated[Path | None, Option(metavar="FOLDER", help="for corpus and findings")] = None,
) -> int:
    if shutil.which("clang") is None:
        pytest.skip("clang: not found; install clang and libclang-rt-dev (Debian)")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) if keep is None else keep
        running = {}
        for precision in PRECISIONS:
            corpus = folder / f"corpus_{precision}"
            corpus.mkdir(parents=True, exist_ok=True)
            options = (f"-max_total_time={seconds}", f"-max_len={LONGEST_INPUT}")
            command = [
                str(built(precision, folder)),
                *options,
                f"-artifact_prefix={folder}/{precision}-",
                str(corpus),
            ]
            running[precision] = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        good = True
        for precision, process in running.items():
            said = process.communicate(timeout=seconds + 120)[1]
            words = [line for line in said.splitlines() if line.startswith(("tick ", "Done ", "==", "SUMMARY"))]
            print(f"{precision}: {'; '.join(words) or said[-300:]}")
            good &= process.returncode == 0
        return 0 if good else 1


test_long_form = long_form(main)
