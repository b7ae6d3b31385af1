"""Blind comparison: which of two libraries a person finds nearer to the real tap without knowing which one plays.

    python scripts/blind_comparison.py A.npz B.npz (--port PORT | --simulate) --csv answers.csv [--trials 20]
        [--taps 3] [--seed 0] [--gain 1] [--judge intensity|waveform|chance]

Figures state how far two waveforms are from a recorded tap; only a person can say which one feels like the real
object. In every trial both libraries are played one after the other in random order, for so many taps each. The
person may knock on the real object at any time, and then answers which interval was nearer to it, 1 or 2. Both
libraries have to be made for the same device and limits, so that only the waveforms differ.

Every answer is saved before the next trial begins. After Ctrl-C or q, the same command with the same libraries, seed
and file continues the comparison. At the end it prints how often B was chosen, with the exact binomial 95 % interval
and the probability of an outcome at least as uneven by chance.

With --simulate a simulated hand taps the compiled device, and a simulated person answers: by the felt intensity, by
the waveform, or by chance, each with the uncertainty of a person.
"""

import csv
import os
import queue
import threading
from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass, fields
from enum import StrEnum
from pathlib import Path
from typing import Annotated, get_type_hints

import numpy as np
from common.command import Seed, at_least, run
from scipy import stats
from typer import Argument, Option

from controller.cli.bench import Bench, simulated_bench
from controller.cli.port import StoppedError, connected, disarmed_by_ctrl_c, no_long_pauses, person_at
from controller.device.device_file import BUILT_IN
from controller.host.driver import Device
from controller.host.payload import Payload, fitted, payload
from controller.protocol.events import capacity_of
from controller.protocol.image import sha256
from controller.record.played import PlayedTap, played_tap
from controller.record.recorder import Recorder
from controller.servo.interface import State
from controller.sim.port import SIMULATED
from controller.sim.simulated_tap import SimulatedTap
from controller.sim.true_device import device_of
from transopt.base.errors import InputError
from transopt.problem.objective.bands import JUST_NOTICED_dB

LISTEN_S = 0.05
PREPARE_S = 1.0  # fixed pause before every interval, longer than any upload, so that its length tells nothing
JUST_NOTICED_ERROR = 0.1  # tap error, of the simulated person who goes by the waveform
QUIT = "q"


class Judge(StrEnum):
    """The criterion of a simulated person."""

    INTENSITY = "intensity"
    WAVEFORM = "waveform"
    CHANCE = "chance"


@dataclass(frozen=True)
class Answer:
    """One trial, as stored in the file.

    Attributes
    ----------
    first : library that was played first, A or B.
    answer : 1 or 2, the interval that the person found nearer.
    chosen : the library that was played in that interval.
    speed_1_m_s, grip_1_N : mean over the taps of the first interval; likewise of the second.
    library_A, library_B : beginnings of the libraries' hashes.
    """

    trial: int
    seed: int
    first: str
    answer: int
    chosen: str
    taps: int
    speed_1_m_s: float
    grip_1_N: float
    speed_2_m_s: float
    grip_2_N: float
    library_A: str
    library_B: str


COLUMNS = [field.name for field in fields(Answer)]
Asked = Callable[[Device, int, list[list[PlayedTap]]], str]  # device, trial, taps of both intervals -> 1, 2 or q


class Answers:
    """The file of answers, which is complete after every answer.

    Parameters
    ----------
    seed : seed of the order.
    names : names of libraries A and B.

    Attributes
    ----------
    all : answers in the order in which they were given.

    Raises
    ------
    InputError : a file that cannot be written, or with other content.
    """

    def __init__(self, path: Path, seed: int, names: tuple[str, str]) -> None:
        self._path, self.seed, self.names = path, seed, names
        self.all: list[Answer] = self._read()

    def _read(self) -> list[Answer]:
        if not self._path.exists():
            return []
        try:
            with self._path.open(newline="", encoding="utf-8") as file:
                rows = list(csv.DictReader(file))
            kinds = get_type_hints(Answer)
            found = [Answer(**{name: kinds[name](row[name]) for name in COLUMNS}) for row in rows]
        except (OSError, UnicodeDecodeError, KeyError, TypeError, ValueError):
            raise InputError(f"--csv {self._path}: no answers of a comparison: choose another file") from None
        for each in found:
            if (each.library_A, each.library_B, each.seed) != (*self.names, self.seed):
                raise InputError(
                    f"--csv {self._path}: answers on other libraries or of seed {each.seed}: choose another file"
                )
        return found

    def add(self, answer: Answer) -> None:
        """Append an answer and write it to the disk."""
        new = not self._path.exists()
        try:
            with self._path.open("a", newline="", encoding="utf-8") as file:
                writer = csv.writer(file, lineterminator="\n")
                if new:
                    writer.writerow(COLUMNS)
                writer.writerow(astuple(answer))
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise InputError(f"--csv {self._path}: cannot be written ({error.strerror}): choose another") from None
        self.all.append(answer)


def first_of(seed: int, trial: int) -> str:
    """The library played first in a trial; every pair of trials has both orders, in random sequence."""
    orders = np.random.default_rng([seed, trial // 2]).permutation(["A", "B"])
    return str(orders[trial % 2])


def summary(answers: list[Answer]) -> str:
    """How often B was chosen, with its interval and probability."""
    n, k = len(answers), sum(answer.chosen == "B" for answer in answers)
    if n == 0:
        return "no answers"
    test = stats.binomtest(k, n)
    low, high = test.proportion_ci(0.95, method="exact")
    second = sum(answer.answer == 2 for answer in answers)
    interval = f"{100 * low:.0f} to {100 * high:.0f} %"
    return (
        f"B was nearer in {k} of {n} trials: {100 * k / n:.0f} %, 95 % interval {interval}; as uneven by chance with "
        f"probability {test.pvalue:.2g}. The second interval was chosen {second} times."
    )


def played(device: Device, given: Payload, bench: Bench, taps: int, gain: float) -> list[PlayedTap]:
    """Arm, wait for so many whole taps, disarm."""
    settings = given.settings
    with Recorder(None, device.hello.dt_s, settings.count_m, settings.surface_counts) as recorder, no_long_pauses():
        device.listeners.append(recorder.take)
        try:
            with disarmed_by_ctrl_c(device):
                device.set_telemetry(1)
                device.arm(gain)
                while len(recorder.contacts) < taps and not bench.done(False):
                    device.listen(LISTEN_S)
                    if device.state in (State.FAULT, State.IDLE):
                        device.need_no_fault()
                        raise InputError(f"{device.name}: disarmed by itself: start the comparison again")
                device.disarm()
        finally:
            device.listeners.remove(recorder.take)
    library = given.library
    return [played_tap(contact, library, settings, gain, BUILT_IN.accelerometer) for contact in recorder.contacts]


def person(device: Device, trial: int, intervals: list[list[PlayedTap]]) -> str:
    """Ask the person at the terminal; the link to the device is served meanwhile."""
    typed: queue.Queue[str] = queue.Queue()

    def read() -> None:
        try:
            typed.put(input("  nearer to the real tap: 1 or 2? (q ends) "))
        except EOFError:
            typed.put(QUIT)

    while True:
        threading.Thread(target=read, daemon=True).start()
        while typed.empty():
            device.listen(LISTEN_S)
        text = typed.get().strip().lower()
        if text in ("1", "2", QUIT):
            return text
        print("  please type 1, 2 or q")


def simulated_person(judge: Judge, seed: int) -> Asked:
    """A simulated person who judges the recorded taps, with the uncertainty of a just noticeable difference."""

    def distance(tap: PlayedTap) -> float:
        compared = tap.compared
        if tap.why or compared.levels is None:
            return 0.0
        if judge is Judge.INTENSITY:
            return abs(compared.levels.felt_dB) / JUST_NOTICED_dB
        return compared.tap_error / JUST_NOTICED_ERROR

    def asked(device: Device, trial: int, intervals: list[list[PlayedTap]]) -> str:
        rng = np.random.default_rng([seed, trial, 1])
        if judge is Judge.CHANCE:
            return str(rng.integers(1, 3))
        one, two = (np.mean([distance(tap) for tap in taps]) + rng.normal() for taps in intervals)
        return "1" if one < two else "2"

    return asked


def prepare(device: Device, given: Payload) -> None:
    """Load a library without naming it, in the same time whether it has to be sent or not."""
    end_s = device.now_s() + PREPARE_S
    device.configure(given.configuration)
    device.upload(fitted(given, capacity_of(device.hello))[0].image)
    device.listen(max(end_s - device.now_s(), 0.0))


def compare(
    bench: Bench, given: dict[str, Payload], answers: Answers, trials: int, taps: int, gain: float, asked: Asked
) -> None:
    """Run all trials that the file does not contain yet; the person may end early."""
    with connected(bench.port, False) as device:
        for trial in range(len(answers.all), trials):
            pair = [first_of(answers.seed, trial)]
            pair.append("B" if pair[0] == "A" else "A")
            print(f"trial {trial + 1} of {trials}")
            intervals = []
            for j, name in enumerate(pair):
                prepare(device, given[name])
                print(f"  interval {j + 1}: tap {taps} times")
                intervals.append(played(device, given[name], bench, taps, gain))
            text = asked(device, trial, intervals)
            if text == QUIT:
                return
            (speed_1, grip_1), (speed_2, grip_2) = (
                np.mean([(tap.contact.speed_m_s, tap.contact.grip_N) for tap in own], axis=0) for own in intervals
            )
            answers.add(
                Answer(
                    trial=trial,
                    seed=answers.seed,
                    first=pair[0],
                    answer=int(text),
                    chosen=pair[int(text) - 1],
                    taps=taps,
                    speed_1_m_s=float(speed_1),
                    grip_1_N=float(grip_1),
                    speed_2_m_s=float(speed_2),
                    grip_2_N=float(grip_2),
                    library_A=answers.names[0],
                    library_B=answers.names[1],
                )
            )


def simulated_taps(given: Payload, seed: int, trials: int, taps: int) -> Iterator[SimulatedTap]:
    """Taps of a hand at random speeds and grips in the upper half of the grid, where limits bind."""
    rng, library = np.random.default_rng([seed, 2]), given.library
    for _ in range(2 * trials * taps):
        v, F = (
            float(rng.uniform(0.5 * (nodes[0] + nodes[-1]), nodes[-1]))
            for nodes in (library.speeds_m_s, library.grips_N)
        )
        yield SimulatedTap(min(v, 0.9 * given.settings.fastest_m_s), F, seed=int(rng.integers(2**31)))


def main(
    a: Annotated[Path, Argument(help="library.npz", metavar="A")],
    b: Annotated[Path, Argument(help="library.npz", metavar="B")],
    csv_file: Annotated[Path, Option("--csv", help="the answers, one row per trial")],
    port: Annotated[str | None, Option(help="of the device")] = None,
    simulate: Annotated[
        bool, Option("--simulate", help="on the compiled device, tapped by a simulated hand")
    ] = False,
    trials: Annotated[int, at_least(1, "trials in all, those that the file has among them")] = 20,
    taps: Annotated[int, at_least(1, "taps per library and trial")] = 3,
    seed: Seed = 0,
    gain: Annotated[float, Option(min=0.01, max=1.0, help="of the waveforms")] = 1.0,
    judge: Annotated[Judge, Option(help="what a simulated person goes by")] = Judge.INTENSITY,
) -> int:
    if (port is None) == (not simulate) or (port == SIMULATED and simulate):
        raise InputError("give --port PORT or --simulate")
    given = {"A": payload(a), "B": payload(b)}
    if given["A"].configuration != given["B"].configuration:
        raise InputError(f"{a} and {b}: made for other limits or another device: make both from one scene")
    names = [sha256(one.image).hex()[:12] for one in given.values()]
    if names[0] == names[1]:
        raise InputError(f"{a} and {b}: the same waveforms: give two libraries")
    answers = Answers(csv_file, seed, (names[0], names[1]))
    simulated = simulate or port == SIMULATED
    asked = simulated_person(judge, seed) if simulated else person
    if simulated:
        left = trials - len(answers.all)
        hand = simulated_taps(given["A"], seed + len(answers.all), left, taps)
        bench, _ = simulated_bench(given["A"], device_of(given["A"].library.scene()), hand)
    else:
        assert port is not None
        bench = person_at(port)
        print("Knock on the real object as often as you like. Then tap the surface in each interval as you knocked.")
    stopped = False
    try:
        compare(bench, given, answers, trials, taps, gain, asked)
    except StoppedError:
        stopped = True
    print(summary(answers.all))
    return 130 if stopped else 0


if __name__ == "__main__":
    run(main)
