"""Ctrl-C and SIGTERM at random instants of every command: each ends in time, loses nothing and leaves nothing behind.

    python -m pytest -m long -n 0 tests/campaigns/test_signals.py
        --campaign="[--instants 200] [--seed 0] [--processes 2] [--only WORD]"

Every command first runs undisturbed, which tells how long it takes and leaves an earlier result. Then it runs again
over that result and gets a signal at a random instant: SIGTERM alone, or SIGINT with its whole process group, as a
terminal sends it. Long searches of native code (IPOPT, PIQP, the compiled interior point on
20 000 stages) are commands of their own, which are never let finish.

Asked of each: it has ended within 1 s; its folder has either the earlier result, byte for byte, or the whole new one;
no process of its session, no file and no socket among the temporary ones is left. It fails if anything is off.
Signals that come while Python itself is starting are counted apart: what they print is Python's own.
"""

import hashlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
import typer

from tests.campaigns.harness import Seed, at_least, long_form
from transopt.solvers import riccati

MOST_S = 1.0  # between the signal and the end
LONGEST_S = 12.0  # from the start of a command: the instants lie before
GIVEN_UP_S = 100.0  # for an end that does not come
BIN = Path(sys.executable).parent
PROGRAM = "import sys; sys.path[:0] = {path!r}; from transopt.base import terminal; terminal.run(lambda: {call})"
LONG = """
from problems.stress.cases import StressCase
from problems.stress.parts import Horizon
from transopt.solvers import choose
from transopt.solvers.options import SolverOptions

def search(method):
    problem = StressCase("long", horizon=Horizon(stages=20000)).problem()
    while True:
        choose.solve(problem, SolverOptions(method))
"""


@dataclass(frozen=True)
class Command:
    """One command line, run in a folder that has its input.

    Attributes
    ----------
    words : of the line, the program first.
    result : folder or file that it writes; empty for none.
    endless : whether it is never let finish.
    """

    name: str
    words: tuple[str, ...]
    result: str = ""
    endless: bool = False


@dataclass(frozen=True)
class Ended:
    """How one run with a signal ended.

    Attributes
    ----------
    after_s : from its start to the signal. took_s : from the signal to its end; inf if it had to be killed.
    code : exit code. complaints : what is off, in words; empty if nothing is.
    traceback : what it printed, if that was one. done : whether it had ended by itself before the signal.
    """

    command: Command
    signal: signal.Signals
    after_s: float
    took_s: float
    code: int
    complaints: tuple[str, ...]
    traceback: str
    done: bool


def line(text: str, result: str = "") -> Command:
    """A command line of the installed programs."""
    words = text.split()
    return Command(text, (str(BIN / words[0]), *words[1:]), result)


def search(method: str) -> Command:
    """A search in native code that takes longer than anyone waits."""
    program = PROGRAM.format(path=[os.curdir], call=f"__import__('long').search({method!r})")
    return Command(f"a long search: {method}", (sys.executable, "-c", program), endless=True)


def commands() -> list[Command]:
    """Every command of the three programs that computes, with the own solver and with the others."""
    stress = "problems.stress"
    return [
        line("transopt solve --out out", "out"),
        line("transopt solve hot_coil --solver casadi-ipopt --out out", "out"),
        line("transopt solve wood_on_foam --solver casadi-piqp --no-figures --out out", "out"),
        line("transopt solve --grid-tolerance 0.01 --out out", "out"),
        line("transopt verify library.npz"),
        line("transopt show library.npz --figure look.png", "look.png"),
        line("transopt compare library.npz library.npz --out compared.md", "compared.md"),
        line("transopt export library.npz mine.h", "mine.h"),
        line("transopt taps taps/tap_0.3_m_s.csv --out look", "look"),
        line("transopt scene keys"),
        line("transopt study --vary limits.current_A=1:6:40 --out studied --executor serial"),
        line("transopt study --vary limits.current_A=1:6:40 --out studied --jobs 2"),
        line("transopt study --vary limits.current_A=1:6:8 --jobs 2 --full --out studied"),
        line("transopt identify amplifier amplifier/amplifier_*.npz --out A.json", "A.json"),
        line("transopt identify device device/device_*.npz --out D.json", "D.json"),
        line("transopt identify hand hand/tap_*.npz --out H.json", "H.json"),
        line("transopt identify coil heat/heat.npz --out C.json", "C.json"),
        line("transopt-play tap library.npz --simulate --out played"),
        line("transopt-play tap library.npz --simulate --method online --out played"),
        line(
            "transopt-play refine library.npz --simulate --mismatch 0.1 --rounds 1 --taps 2 --out refined", "refined"
        ),
        line("transopt-play record sweep --simulate --trials 1 --out swept"),
        line("transopt-play record tap library.npz --simulate --repeats 1 --out tapped"),
        line("transopt-play record heat --simulate --out heated"),
        line("transopt-play ports"),
        line("transopt-device --listen 127.0.0.1:0"),
        Command(f"python -m {stress}", (sys.executable, "-m", stress, "--jobs", "2", "--cases", "40")),
        Command(f"python -m {stress} --case", (sys.executable, "-m", stress, "--seed", "3", "--case", "286")),
        *(search(method) for method in ("riccati", "casadi-ipopt", "casadi-piqp")),
    ]


def prepare(folder: Path, wanted: Sequence[Command]) -> None:
    """The input of the commands that are wanted."""
    folder.mkdir()
    (folder / "long.py").write_text(LONG)
    said = " ".join(command.name for command in wanted)
    made = [("library.npz", "transopt solve --no-figures --out made"), ("taps/", "")]
    for kind, grips in (("amplifier", "3"), ("device", "1,3,5")):
        made.append((f"{kind}/", f"transopt-play record sweep --simulate --for {kind} --grips {grips} --out {kind}"))
    made.append(("hand/", "transopt-play record tap --simulate --object --grips 1,3,5 --repeats 3 --out hand"))
    made.append(("heat/", "transopt-play record heat --simulate --out heat"))
    for name, text in made:
        if name not in said:
            continue
        if not text:
            import problems

            shutil.copytree(Path(problems.__file__).parent / "recordings", folder / name)
            continue
        words = text.split()
        subprocess.run([BIN / words[0], *words[1:]], cwd=folder, check=True, capture_output=True)
    if (folder / "made").exists():
        shutil.move(folder / "made" / "library.npz", folder / "library.npz")
        shutil.rmtree(folder / "made")


def session_of(process: int) -> list[int]:
    """The processes of a session, by its leader, without those that have ended; only where there is /proc."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session = path.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(session) == process and state != "Z":
            found.append(int(path.parent.name))
    return found


def state_of(path: Path) -> dict[str, tuple[int, str]]:
    """Name -> which file it is, and a hash of what is in it, of a file or of all files in a folder."""
    files = [path] if path.is_file() else sorted(each for each in path.rglob("*") if each.is_file())
    return {
        str(each.relative_to(path.parent)): (each.stat().st_ino, hashlib.sha256(each.read_bytes()).hexdigest())
        for each in files
    }


def half(before: dict[str, tuple[int, str]], after: dict[str, tuple[int, str]]) -> list[str]:
    """What is off with a result: files that are gone or written into, or only some of them new."""
    said = [f"gone: {name}" for name in before if name not in after]
    there = [name for name in before if name in after]
    said += [
        f"written into: {name}" for name in there if before[name][0] == after[name][0] and before[name] != after[name]
    ]
    new = [name for name in there if before[name][0] != after[name][0]]
    return said + ([f"new are only {new} of {there}"] if new and len(new) < len(there) else [])


@dataclass
class Place:
    """Place of one command: its folder with input and an earlier result, and the temporary files of its own."""

    folder: Path
    temporary: Path

    @classmethod
    @contextmanager
    def of(cls, given: Path) -> "Iterator[Place]":
        with tempfile.TemporaryDirectory(prefix="signals-") as top:
            place = cls(Path(top) / "here", Path(top) / "tmp")
            shutil.copytree(given, place.folder)
            place.temporary.mkdir()
            yield place

    def start(self, command: Command) -> "subprocess.Popen[bytes]":
        words = [
            str(word)
            for each in command.words
            for word in (
                sorted(path.relative_to(self.folder) for path in self.folder.glob(each)) if "*" in each else [each]
            )
        ]
        with (self.folder.parent / "said").open("wb") as said:
            return subprocess.Popen(
                words,
                cwd=self.folder,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=said,
                start_new_session=True,
                env={**os.environ, "TMPDIR": str(self.temporary), "PYTHONUNBUFFERED": "1"},
            )

    def said(self) -> str:
        return (self.folder.parent / "said").read_text(errors="replace")


def end_all(process: "subprocess.Popen[bytes]") -> None:
    """End what is left of a process and its session."""
    for left in {process.pid, *session_of(process.pid)}:
        try:
            os.kill(left, signal.SIGKILL)
        except ProcessLookupError:
            continue
    process.wait()
    process.stdin.close()


def undisturbed(command: Command, given: Path) -> float:
    """How long a command takes by itself, at most `LONGEST_S`; its result stays among what is given."""
    if command.endless:
        return LONGEST_S / 4
    with Place.of(given) as place:
        begun = time.monotonic()
        process = place.start(command)
        try:
            # A result is waited for; what has none may have no end either.
            code = process.wait(GIVEN_UP_S if command.result else LONGEST_S)
        except subprocess.TimeoutExpired:
            end_all(process)
            return LONGEST_S
        took = min(time.monotonic() - begun, LONGEST_S)
        end_all(process)
        if code not in (0, 1):
            raise SystemExit(f"{command.name}: exit code {code} undisturbed: {place.said()}")
        if command.result:
            result = place.folder / command.result
            kept = given / command.result
            kept.parent.mkdir(exist_ok=True)
            (shutil.copytree if result.is_dir() else shutil.copy)(result, kept)
        return took


def disturbed(command: Command, given: Path, after_s: float, number: signal.Signals) -> Ended:
    """Run a command over its earlier result, send the signal, and look at what is left."""
    complaints = []
    with Place.of(given) as place:
        result = place.folder / command.result
        before = state_of(result) if command.result else {}
        beside = result if result.is_dir() else result.parent
        there = set(beside.iterdir())
        process = place.start(command)
        with suppress(subprocess.TimeoutExpired):
            process.wait(after_s)
        done = process.poll() is not None
        sent = time.monotonic()
        if not done:
            (os.killpg if number is signal.SIGINT else os.kill)(process.pid, number)
        try:
            code = process.wait(GIVEN_UP_S)
            took = time.monotonic() - sent
        except subprocess.TimeoutExpired:
            code, took = -signal.SIGKILL, float("inf")
        # What ends with its parent needs a moment: its line has to be heard to be closed.
        while session_of(process.pid) and time.monotonic() - sent < MOST_S:
            time.sleep(0.005)
        left = session_of(process.pid)
        if took > MOST_S:
            complaints.append(f"ended after {took:.2f} s with code {code}")
        if left:
            complaints.append(f"processes left: {left}")
        end_all(process)
        if any(place.temporary.iterdir()):
            complaints.append(f"temporary files left: {[path.name for path in place.temporary.rglob('*')]}")
        if command.result:
            complaints += half(before, state_of(result))
            # A figure may accompany a file; what is hidden is what was under way.
            new = {path.name for path in set(beside.iterdir()) - there}
            extra = sorted(name for name in new if name.startswith(".") or result.is_dir())
            if extra:
                complaints.append(f"beside the result: {extra}")
        return Ended(
            command,
            number,
            after_s,
            took,
            code,
            tuple(complaints),
            place.said() if "Traceback" in place.said() else "",
            done,
        )


def campaign(
    wanted: Sequence[Command], instants: int, seed: int, processes: int, folder: Path
) -> Generator[Ended, None, None]:
    """So many runs with a signal, the commands in turn."""
    random, given = np.random.default_rng(seed), folder / "given"
    prepare(given, wanted)
    places, lengths = {}, {}
    for j, command in enumerate(wanted):
        places[command.name] = folder / f"given{j}"
        shutil.copytree(given, places[command.name])
        lengths[command.name] = undisturbed(command, places[command.name])
    runs = []
    for j in range(instants):
        command = wanted[j % len(wanted)]
        number = (signal.SIGINT, signal.SIGTERM)[(j + j // len(wanted)) % 2]
        runs.append((command, places[command.name], random.uniform(0.0, lengths[command.name]), number))
    with ThreadPoolExecutor(processes) as pool:
        yield from pool.map(lambda run: disturbed(*run), runs)


def table(ended: Sequence[Ended]) -> list[str]:
    """A line for each command: runs, the longest time from signal to end, what was off."""
    by_name: dict[str, list[Ended]] = defaultdict(list)
    for each in ended:
        by_name[each.command.name].append(each)
    lines = [
        f"{'command':88s} {'runs':>4s} {'done':>4s} {'median s':>8s} {'worst s':>8s} {'off':>4s} {'traceback':>9s}"
    ]
    for name, those in by_name.items():
        took = [each.took_s for each in those if not each.done] or [0.0]
        off, traces = sum(bool(each.complaints) for each in those), sum(bool(each.traceback) for each in those)
        done = sum(each.done for each in those)
        lines.append(
            f"{name[:88]:88s} {len(those):4d} {done:4d} {np.median(took):8.3f} {max(took):8.3f} {off:4d} {traces:9d}"
        )
    return lines


def main(
    instants: Annotated[int, at_least(1, "runs with a signal")] = 200,
    seed: Seed = 0,
    processes: Annotated[int, at_least(1, "commands at a time")] = 2,
    only: Annotated[str, typer.Option(help="commands whose line has this word")] = "",
    verbose: Annotated[bool, typer.Option("--verbose", help="print tracebacks whole")] = False,
) -> int:
    # A job in the background has SIGINT ignored, and so would all that it starts.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    wanted = [command for command in commands() if only in command.name]
    ended = []
    with tempfile.TemporaryDirectory(prefix="signals-given-") as folder:
        runs = campaign(wanted, instants, seed, processes, Path(folder))
        # Stopped, it says what it has found until then.
        with closing(runs), suppress(KeyboardInterrupt):
            for each in runs:
                ended.append(each)
                when = f"{each.command.name}, {each.signal.name} after {each.after_s:.3f} s"
                for complaint in each.complaints:
                    print(f"{when}: {complaint}", flush=True)
                if each.traceback:
                    print(f"{when}: {each.traceback if verbose else 'a traceback'}", flush=True)
    print("\n".join(table(ended)))
    off = sum(bool(each.complaints) for each in ended)
    print(f"{len(ended)} instants, {off} with anything off")
    return int(off > 0)


test_long_form = long_form(main)


@pytest.mark.skipif(not Path("/proc").exists(), reason="what is left is looked for in /proc")
@pytest.mark.skipif(not riccati.available, reason="the extension is not built")
def test_each_ends_in_time_loses_nothing_and_leaves_nothing(tmp_path: Path) -> None:
    searches = [command for command in commands() if command.endless]
    assert len(searches) == 3
    solve = line("transopt solve single_grip --no-figures --solver casadi-ipopt --out out", "out")
    for ended in campaign([solve, *searches], 5, 3, 2, tmp_path):
        assert not ended.complaints, f"{ended.command.name}, {ended.signal.name} after {ended.after_s:.3f} s"
