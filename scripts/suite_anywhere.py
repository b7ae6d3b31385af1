"""Runs the test suite as on other processors, in other orders and with other numbers of threads.

    python scripts/suite_anywhere.py [NAME ...] [--list] [--tests FILE ...] [--write FILE]
    python scripts/suite_anywhere.py [NAME ...] --stress CASES

The last bits of a sum depend on the order in which it is taken, and that order is chosen at run time: OpenBLAS takes
a kernel, numpy its loops, the C library its exp and sin, and the compiled pass its width by what the processor has.
Each of these can be asked for what another processor would get, so one machine shows what a test would see on
others. Tests that only pass after others, and results that depend on the number of threads, are looked for alike.

Every environment runs the whole suite once, one after the other, with the workers that pyproject.toml states; NAME
chooses those whose names contain it, --tests the files. With --stress, as many cases of the stress suite's first seed
are judged in place of the suite, and a case fails where its verdict is another than in the first environment. An
environment that this machine cannot give is skipped and says why. Printed is a table of the environments, below it
the tests that failed; --write keeps both in a file. Exit code 1 if a test failed, or nothing was run.
"""

import argparse
import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from controller.firmware.build import NoCompilerError, compiler
from transopt.base.writing import table, write_text
from transopt.solvers.native.extension import EXTENSION

ROOT = Path(__file__).parents[1]
SHUFFLED, ORDER = "tests.benches.shuffled", "SHUFFLED"  # plugin of pytest, and the variable that it reads
# What a run leaves behind or brings itself; all else belongs to the copy that is given another extension.
LEFT_BEHIND = (".git", ".venv", ".*cache", ".hypothesis", "__pycache__", "*.so", "*.pyd", "build", "dist", "out")
BESIDE = "shared"  # recordings that some tests look for beside the checkout
PROBE_S = 60.0
EXTENSION_FLAGS = ("-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno")  # as in setup.py
NO_EXTENSION = 0  # as a width of the compiled pass
HEAD = ("environment", "passed", "failed", "skipped", "seconds")
# OpenBLAS names some kernels otherwise than it is asked for them.
ALSO_CALLED = {"Prescott": "Katmai"}
# glibc has its exp, sin, log and pow twice: with fused products, for processors that have them, and without.
WITHOUT_FMA = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2"}
PROBE = """
import json, math, sys
import numpy
found = numpy.show_config(mode="dicts").get("SIMD Extensions", {}).get("found", [])
random = numpy.random.default_rng(0).uniform(-5, 5, 5000)
print(json.dumps([found, [math.exp(x).hex() for x in random.tolist()]]))
"""


@dataclass(frozen=True)
class Environment:
    """What differs from an ordinary run of the suite.

    Attributes
    ----------
    variables :
        These are set for pytest and everything that it starts.
    arguments :
        These are given to pytest.
    kernel :
        The kernel that OpenBLAS has to report, or nothing where any will do.
    needs_found :
        Some of these must be among the instruction sets that numpy finds on this processor, unless it is empty.
    width :
        The doubles that the compiled pass works on side by side. `NO_EXTENSION` stands for none at all, and None for
        the extension that is installed.
    """

    name: str
    variables: dict[str, str] = field(default_factory=dict)
    arguments: tuple[str, ...] = ()
    kernel: str = ""
    needs_found: tuple[str, ...] = ()
    width: int | None = None


@dataclass(frozen=True)
class Result:
    """How one run of the suite ended; `broken` says why there are no numbers, if there are none."""

    environment: Environment
    passed: int = 0
    skipped: int = 0
    seconds: float = 0.0
    failures: tuple[str, ...] = ()
    broken: str = ""


@dataclass(frozen=True)
class Probed:
    """What a new Python reports under some variables.

    Attributes
    ----------
    found :
        The instruction sets beyond numpy's baseline that it uses here.
    exponentials :
        The values of exp at 5000 points, to the last bit.
    kernel :
        OpenBLAS's own name for the kernel in use, empty if numpy has another library.
    error :
        The exception or the warning that Python ended with, without its traceback.
    """

    found: tuple[str, ...] = ()
    exponentials: tuple[str, ...] = ()
    kernel: str = ""
    error: str = ""


def probe(variables: dict[str, str]) -> Probed:
    """A warning counts as an error, as it does in the suite."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", PROBE],
        env={**os.environ, "OPENBLAS_VERBOSE": "2", **variables},
        capture_output=True,
        text=True,
        timeout=PROBE_S,
        check=False,
    )
    if done.returncode:
        last = itertools.takewhile(lambda line: not line.startswith(" "), reversed(done.stderr.splitlines()))
        return Probed(error=" ".join(reversed(list(last))) or f"exit code {done.returncode}")
    found, exponentials = json.loads(done.stdout)
    kernels = [line.split(":", 1)[1].strip() for line in done.stderr.splitlines() if line.startswith("Core:")]
    return Probed(tuple(found), tuple(exponentials), kernels[0] if kernels else "")


def is_wide(name: str) -> bool:
    """Whether numpy's name of an instruction set stands for 512 bits."""
    return name.startswith("AVX512") or name == "X86_V4"


def environments(here: Probed) -> list[Environment]:
    """All that may be asked for, on this machine or another."""
    wide = tuple(name for name in here.found if is_wide(name))
    without_wide = {"NPY_DISABLE_CPU_FEATURES": " ".join(wide)}
    baseline = {"NPY_DISABLE_CPU_FEATURES": " ".join(here.found)}
    threads = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    prescott = {"OPENBLAS_CORETYPE": "Prescott"}
    return [
        Environment("as it is"),
        Environment("BLAS for Haswell", {"OPENBLAS_CORETYPE": "Haswell"}, kernel="Haswell"),
        Environment(
            "BLAS for SkylakeX",
            {"OPENBLAS_CORETYPE": "SkylakeX"},
            kernel="SkylakeX",
            needs_found=("AVX512_SKX", "X86_V4"),
        ),
        Environment("BLAS for Prescott", prescott, kernel="Prescott"),
        Environment("numpy without AVX512", without_wide, needs_found=wide or ("AVX512F",)),
        Environment("numpy without AVX2", baseline, needs_found=("AVX2", "X86_V3")),
        Environment("libm without FMA", WITHOUT_FMA),
        Environment("compiled pass of two doubles", width=2),
        Environment("compiled pass of one double", width=1),
        Environment("no compiled pass", width=NO_EXTENSION),
        Environment("all of an old processor", {**prescott, **baseline, **WITHOUT_FMA}, kernel="Prescott", width=2),
        *(Environment(f"order {seed}", {ORDER: str(seed)}, ("-p", SHUFFLED)) for seed in (1, 2, 3)),
        *(Environment(f"threads {count}", dict.fromkeys(threads, count)) for count in ("1", "4")),
    ]


def obstacle(environment: Environment, here: Probed) -> str:
    """Why this machine cannot give an environment, or nothing if it can."""
    if environment.needs_found and not set(environment.needs_found) & set(here.found):
        return f"numpy finds none of {', '.join(environment.needs_found)} on this processor"
    if environment.kernel and not here.kernel:
        return "numpy's BLAS is no OpenBLAS"
    there = probe(environment.variables)
    if there.error:
        return there.error
    if environment.kernel and there.kernel not in (environment.kernel, ALSO_CALLED.get(environment.kernel)):
        return f"OpenBLAS takes {there.kernel} for {environment.kernel}"
    if WITHOUT_FMA.items() <= environment.variables.items() and there.exponentials == here.exponentials:
        return "the C library has no other exp"
    if environment.width:
        try:
            compiler()
        except NoCompilerError as missing:
            return str(missing)
    return ""


def build_extension(root: Path, width: int) -> None:
    """Compile the solver's extension into a copy of the checkout."""
    command = [*compiler().command, "-shared", "-fPIC", *EXTENSION_FLAGS, f"-DONLY_WIDTH={width}"]
    native = root / "transopt/solvers/native"
    sources = sorted(path.name for path in native.glob("*.c"))
    subprocess.run([*command, *sources, "-o", EXTENSION, "-lm"], cwd=native, check=True)


@contextmanager
def checkout(width: int | None) -> Iterator[Path]:
    """The checkout itself, or a copy that has another extension or none while it is needed."""
    if width is None:
        yield ROOT
        return
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*LEFT_BEHIND))
        if (ROOT.parent / BESIDE).is_dir():
            (copy.parent / BESIDE).symlink_to(ROOT.parent / BESIDE)
        if width != NO_EXTENSION:
            build_extension(copy, width)
        yield copy


def asked_for(root: Path, environment: Environment, arguments: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """What `python -m` with these arguments says in an environment."""
    # Ahead of the installed package, which is the checkout: what the tests start has to find the copy as well.
    paths = [str(root), os.environ.get("PYTHONPATH", "")]
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=root,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths)), **environment.variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )


def verdicts(environment: Environment, cases: int, first: dict[str, str]) -> Result:
    """Judge cases of the stress suite; the verdicts of the first environment are put into `first`."""
    with checkout(environment.width) as root, tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "verdicts.txt"
        arguments = ["problems.stress", "--seed", "1", "--cases", str(cases), "--write", str(written)]
        began = time.monotonic()
        done = asked_for(root, environment, arguments)
        if not written.exists():
            return Result(environment, broken=f"exit code {done.returncode}\n{done.stdout}")
        found = dict(line.split(" ", 1) for line in written.read_text(encoding="utf-8").splitlines())
    if not first:
        first.update(found)
    others = tuple(
        f"case {index}: {verdict}, {first[index]} in the first environment"
        for index, verdict in found.items()
        if verdict != first[index]
    )
    return Result(environment, len(found) - len(others), 0, time.monotonic() - began, others)


def told_by(case: ElementTree.Element) -> str:
    """A test that failed, and the first line of what it said."""
    said = [part.get("message") or "" for part in case if part.tag in ("failure", "error")]
    return f"{case.get('classname')}::{case.get('name')}: {(said[0].splitlines() or [''])[0]}"


def run(environment: Environment, tests: Sequence[str]) -> Result:
    """Run the suite once; its output is kept only where it failed without a report."""
    with checkout(environment.width) as root, tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        arguments = ["pytest", f"--junitxml={report}", *environment.arguments, *tests]
        done = asked_for(root, environment, arguments)
        if not report.exists():
            return Result(environment, broken=f"exit code {done.returncode}\n{done.stdout}")
        suite = ElementTree.parse(report).getroot()
    cases = list(suite.iter("testcase"))
    failed = [case for case in cases if case.find("failure") is not None or case.find("error") is not None]
    skipped = sum(case.find("skipped") is not None for case in cases)
    seconds = sum(float(part.get("time", "0")) for part in suite.iter("testsuite"))
    broken = f"exit code {done.returncode}\n{done.stdout}" if done.returncode and not failed else ""
    passed = len(cases) - len(failed) - skipped
    return Result(environment, passed, skipped, seconds, tuple(map(told_by, failed)), broken)


def explained(result: Result) -> list[str]:
    """The tests that failed in one environment, and how to have it again."""
    variables = " ".join(f"{name}='{value}'" for name, value in result.environment.variables.items())
    lines = ["", f"{result.environment.name} ({variables or 'no variables'}):", *result.failures]
    return [*lines, *([result.broken] if result.broken else [])]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="part of an environment's name; all without it")
    parser.add_argument("--list", action="store_true", help="print the environments and what stands in their way")
    parser.add_argument("--tests", nargs="+", default=[], metavar="FILE", help="these test files alone")
    parser.add_argument("--stress", type=int, metavar="CASES", help="cases of the stress suite in place of the tests")
    parser.add_argument("--write", type=Path, metavar="FILE", help="keep the table in a file")
    arguments = parser.parse_args()
    here = probe({})
    if here.error:
        parser.error(f"numpy cannot be asked: {here.error}")
    every = environments(here)
    for name in arguments.names:
        if not any(name in environment.name for environment in every):
            parser.error(f"{name}: no environment; choose among {', '.join(e.name for e in every)}")
    chosen = [e for e in every if not arguments.names or any(name in e.name for name in arguments.names)]
    if arguments.list:
        for environment in chosen:
            print(f"{environment.name}: {obstacle(environment, here) or 'can be run'}")
        return 0
    rows, results = [], []
    first: dict[str, str] = {}
    for environment in chosen:
        reason = obstacle(environment, here)
        if reason:
            rows.append([environment.name, f"cannot be run: {reason}", "", "", ""])
            continue
        print(f"running: {environment.name}", file=sys.stderr, flush=True)
        if arguments.stress is None:
            result = run(environment, arguments.tests)
        else:
            result = verdicts(environment, arguments.stress, first)
        results.append(result)
        failed = "no report" if result.broken else len(result.failures)
        rows.append([environment.name, result.passed, failed, result.skipped, f"{result.seconds:.0f}"])
        print(rows[-1], *result.failures, sep="\nfailed: ", file=sys.stderr, flush=True)
    bad = [result for result in results if result.failures or result.broken]
    text = "\n".join([*table(HEAD, rows), *(line for result in bad for line in explained(result))])
    print(text)
    if arguments.write is not None:
        write_text(text + "\n", arguments.write)
    return 1 if bad or not results else 0


if __name__ == "__main__":
    sys.exit(main())
