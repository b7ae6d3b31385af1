"""The C core against the Python servo: random ticks, scenarios on the simulator, an hour of heat.

    python -m pytest -m long -n 0 tests/campaigns/test_device_parity.py
        --campaign="[LIBRARY] [--ticks 1000000] [--scenarios 200] [--seed 0] [--write FILE]"

In double precision every command, state, event and temperature must be the same, bit for bit. In single precision
states and events are compared tick by tick, commands wherever both are in the same state. It fails if something is
off. --write keeps all runs in a file for `controller/firmware/replay/replay_main.c`.
"""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import numpy as np
from typer import Option

from controller.protocol.codes import EVENTS
from controller.protocol.image import image_of
from controller.servo.settings import Settings
from tests.benches.core_replay import Core, Recorder, Rows, write_runs
from tests.benches.oracle.guard import Guard
from tests.campaigns.harness import LibraryFile, Seed, at_least, library_of, long_form
from tests.campaigns.parity_runs import TAIL, draw_bank, random_run, tap_run
from transopt.plant.coil import CoilModel

DOUBLE: tuple[str, ...] = ()
FLOAT = ("-DTD_REAL_FLOAT",)
RUN_TICKS = 20_000
COMMAND_A, WINDING_K = 1e-5, 0.1  # what single precision may be off by
NUMBERS = ("command_A", "transient_A", "feedback_A", "winding_C", "speed_m_s", "grip_N")
WHOLE = ("state", "answers", "events", "what")


@dataclass
class Difference:
    """Between the two over some runs.

    Attributes
    ----------
    other_bits : numbers that are not the same bits. other_state, other_events : ticks in which these differ.
    runs_apart : runs in which any such tick is. command_A, winding_K : largest difference, commands only where
    states agree.
    """

    ticks: int = 0
    runs: int = 0
    other_bits: int = 0
    other_state: int = 0
    other_events: int = 0
    runs_apart: int = 0
    command_A: float = 0.0
    winding_K: float = 0.0

    def add(self, recorder: Recorder, flags: tuple[str, ...]) -> None:
        """One run more, played through the core."""
        wanted = recorder.output_rows()
        found = Core(recorder.settings, recorder.image, flags).run(recorder.input_rows())
        self.count(wanted, found)

    def count(self, wanted: Rows, found: Rows) -> None:
        self.ticks += wanted.size
        self.runs += 1
        self.other_bits += sum(_other_bits(wanted[name], found[name]) for name in NUMBERS)
        other_state = wanted["state"] != found["state"]
        events = np.any(wanted["what"] != found["what"], axis=1) | (wanted["answers"] != found["answers"])
        self.other_state += int(np.sum(other_state))
        self.other_events += int(np.sum(events))
        self.runs_apart += bool(np.any(other_state | events))
        alike = ~other_state
        self.command_A = max(self.command_A, _most(wanted["command_A"], found["command_A"], alike))
        self.winding_K = max(self.winding_K, _most(wanted["winding_C"], found["winding_C"], alike))

    def __str__(self) -> str:
        return ", ".join(f"{field.name} {getattr(self, field.name):.4g}" for field in fields(self))


def _other_bits(wanted: Rows, found: Rows) -> int:
    """Numbers that differ; any NaN is like any other."""
    both = np.isnan(wanted) & np.isnan(found)
    return int(np.sum((wanted.view("<u8") != found.view("<u8")) & ~both))


def _most(wanted: Rows, found: Rows, where: Rows) -> float:
    off = np.abs(wanted - found)[where & ~np.isnan(wanted)]
    return float(np.max(off, initial=0.0))


def heat_differences_K(duration_s: float, seed: int) -> dict[tuple[str, ...], float]:
    """Largest difference of the coil's temperatures, by flags of the core, while currents come and go for so long.

    Noise whose size swells and fades over ten minutes, so that the coil warms and cools; compared every half second.
    """
    random = np.random.default_rng([seed, 14])
    settings = Settings(1e-4, 3e-4, 4.0, coil=CoilModel(2.18, 3.1, 14.0, 12.0, 612.0, 100.0))
    assert settings.coil is not None
    guard = Guard(settings.coil, settings.dt_s, settings.withhold_K, settings.least_scale)
    image = image_of(draw_bank(random, None, free=False), settings.dt_s, settings.lead_s, TAIL)
    cores = {flags: Core(settings, image, flags) for flags in (DOUBLE, FLOAT)}
    worst, ticks = dict.fromkeys(cores, 0.0), 5000
    for block in range(round(duration_s / (ticks * settings.dt_s))):
        size = np.abs(random.standard_normal(ticks)) * (1.0 + np.sin(2 * np.pi * block / 1200))
        for current in size.tolist():
            guard.step(current)
        for flags, core in cores.items():
            worst[flags] = max(worst[flags], abs(float(core.heat(size, ticks)[-1]) - guard.winding_C))
    return worst


def random_runs(ticks: int, seed: int) -> Iterator[Recorder]:
    for j in range(-(-ticks // RUN_TICKS)):
        yield random_run(1000 * seed + j, min(RUN_TICKS, ticks))


def report(name: str, runs: Iterable[Recorder], kept: list[bytes] | None) -> bool:
    """Play the runs through both builds and print what came out; whether all is as it must be."""
    exact, single, seen = Difference(), Difference(), Counter[str]()
    for recorder in runs:
        what = recorder.output_rows()["what"]
        seen.update(EVENTS[int(code)].name.lower() for code in what[what > 0])
        exact.add(recorder, DOUBLE)
        single.add(recorder, FLOAT)
        if kept is not None:
            kept.append(recorder.run_bytes())
    print(f"{name}, double: {exact}\n{name}, single: {single}")
    print(f"{name}, events: {', '.join(f'{what} {count}' for what, count in seen.most_common())}", flush=True)
    return (
        exact.other_bits + exact.other_state + exact.other_events == 0
        and single.command_A <= COMMAND_A
        and single.winding_K <= WINDING_K
    )


def main(
    library: LibraryFile = None,
    ticks: Annotated[int, at_least(0, "random ones")] = 1_000_000,
    scenarios: Annotated[int, at_least(0, "taps on the simulator")] = 200,
    heat: Annotated[float, at_least(0, "virtual time of the coil's comparison [s]")] = 3600.0,
    seed: Seed = 0,
    write: Annotated[Path | None, Option(metavar="FILE", help="keep the runs for replay_main.c")] = None,
) -> int:
    kept: list[bytes] | None = None if write is None else []
    solved = library_of(library)
    good = report("random ticks", random_runs(ticks, seed), kept)
    good &= report("scenarios", (tap_run(solved, 1000 * seed + j) for j in range(scenarios)), kept)
    worst = heat_differences_K(heat, seed)
    print(f"coil over {heat:g} s: double {worst[DOUBLE]:.2g} K, single {worst[FLOAT]:.2g} K")
    if write is not None and kept is not None:
        write_runs(write, kept)
    return 0 if good and worst[DOUBLE] == 0.0 and worst[FLOAT] <= WINDING_K else 1


test_long_form = long_form(main)
