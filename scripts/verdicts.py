"""Is what `transopt identify device` says about its own model true? Twenty effects on a drive of other make.

    python scripts/verdicts.py [--effects none pole ...] [--seeds 0 1 2] [--grips 1,2,3,4,5] [--trials 4] [--jobs 2]
        [--sweeps-only] [--out out/verdicts] [--page PAGE.md]

For each effect and seed: sweeps, multisines and held-out taps are recorded on a device whose equations and
integration are not transopt's (tests/benches/other_device.py), the device is identified from them by the command, the
default scene is solved with the model, to its own recordings, and each entry's command is played on the true device
without noise. The true error of an entry is the NRMSE between the acceleration that the library predicts and what the
device does; of a hand that varies, the root mean square over several hands. It stands beside the error that the model
file predicts. A verdict holds if for median and worst entry the predicted error is 0.5 to 2 times the true one, or
within 0.1 points of it where the true one is below 0.2 %, or if the model was refused (exit code, shortfalls) and a
right cause named. On the plain device any shortfall is a false alarm.

"against taps" is the NRMSE of what the device does against the recorded taps, mean over the entries, with the
identified library and with the nominal device's. Last come the parameters' errors on the plain device, how many of
the 95 % intervals hold the truth, and where a cause was named that is none (which alone fails on the plain device).

Prints a table, writes verdicts.json. Exit code 1 if a verdict does not hold.
"""

import argparse
import contextlib
import io
import json
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import typer
from common.measuring import on_one_thread
from common.page import write_part
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.benches.other_device import FloatArray
from tests.benches.other_records import EFFECTS, GRIPS_N, TAPS, make_records, played, truth
from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.base.writing import table as markdown_table
from transopt.cli.identify_device import identify_device
from transopt.design.build import build_library
from transopt.library.library import Library
from transopt.recordings.recording import Recording
from transopt.scene import builtin
from transopt.scene.recordings import recordings_of
from transopt.scene.scene import Scene

SCENE = "wood_on_foam"
LEAST, MOST = 0.5, 2.0  # predicted error over the true one
SMALL, NEAR = 2e-3, 1e-3  # below this true error, this difference is as good
SHARED = {
    "moving_mass_kg": "motor_mass",
    "stylus_mass_kg": "stylus_mass",
    "transmission_stiffness_N_m": "transmission_stiffness",
    "transmission_damping_N_s_m": "transmission_damping",
}
# In the order of `Truth.hand`.
HAND = ("mass_kg", "skin_stiffness_N_m", "skin_damping_N_s_m", "arm_stiffness_N_m", "arm_damping_N_s_m")


@dataclass(frozen=True)
class Verdict:
    """One effect with one seed.

    Attributes
    ----------
    predicted, true : (ng, nv) of the library's entries; empty where there is none.
    against_taps, nominal_against_taps : mean NRMSE of what the device does against the recorded taps.
    causes, shortfalls : of the model file; of a refusal of the records its message.
    unsolved : which entries of the scene the model leads to no admitted command for, with their status.
    seconds : of the identification alone.
    parameters : name -> (found, low, high, true), where the model is a drive.
    """

    effect: str
    seed: int
    predicted: list[list[float]] = field(default_factory=list)
    true: list[list[float]] = field(default_factory=list)
    against_taps: float = float("nan")
    nominal_against_taps: float = float("nan")
    causes: list[str] = field(default_factory=list)
    shortfalls: list[str] = field(default_factory=list)
    unsolved: list[str] = field(default_factory=list)
    kind: str = ""
    seconds: float = float("nan")
    parameters: dict[str, tuple[float, float, float, float]] = field(default_factory=dict)

    def of(self, statistic: Callable[[FloatArray], Any]) -> tuple[float, float]:
        """Predicted and true error, e.g. median or worst over the entries."""
        pair = (np.array(values, dtype=float) for values in (self.predicted, self.true))
        predicted, true = (float(statistic(values)) if values.size else float("nan") for values in pair)
        return predicted, true

    @property
    def shortcoming(self) -> str:
        """Why the verdict does not hold; empty if it does."""
        if self.effect == "none" and (self.shortfalls or self.causes):
            return "false alarm"
        if self.shortfalls:
            right = EFFECTS[self.effect].causes
            return "" if set(self.causes) & set(right) or _is_right(*self.pairs) else "refused without the cause"
        return "" if _is_right(*self.pairs) else "wrong"

    @property
    def false_causes(self) -> list[str]:
        """Named causes that are none of the effect's."""
        return [cause for cause in self.causes if cause not in EFFECTS[self.effect].causes]

    @property
    def pairs(self) -> list[tuple[float, float]]:
        return [self.of(np.median), self.of(np.max)]


def _is_right(*pairs: tuple[float, float]) -> bool:
    return all(
        LEAST * true <= predicted <= MOST * true or (true < SMALL and abs(predicted - true) <= NEAR)
        for predicted, true in pairs
    )


@cache
def _nominal() -> tuple[Scene, Sequence[Recording], Library]:
    """The default scene, its recordings, which no model may change, and its library for the nominal device."""
    scene = builtin.load_scene(SCENE)
    recorded = recordings_of(scene)
    library = build_library(scene, recorded).library
    assert library is not None
    return scene, recorded, library


def _errors(effect: str, seed: int, library: Library) -> tuple[FloatArray, FloatArray]:
    """(ng, nv) true NRMSE against the library's prediction, and against the recorded taps."""
    delay = float(library.meta["amplifier"]["delay_s"])
    shape = library.grips_N.size, library.speeds_m_s.size
    predicted, recorded = np.empty(shape), np.empty(shape)
    for ig, grip in enumerate(library.grips_N):
        for iv in range(library.speeds_m_s.size):
            runs = played(effect, seed, float(grip), np.array(library.command[iv, ig]), delay)
            for wanted, found in (
                (library.acceleration_m_s2[iv, ig], predicted),
                (library.reference_m_s2[iv], recorded),
            ):
                misses = [np.mean((run - wanted) ** 2) for run in runs]
                found[ig, iv] = np.sqrt(np.mean(misses) / np.mean(np.square(wanted)))
    return predicted, recorded


def _predicted(told: dict[str, Any], library: Library) -> FloatArray:
    """(ng, nv) as the model file says."""
    where = [told["grips_N"].index(grip) for grip in library.grips_N.tolist()]
    speeds = [told["speeds_m_s"].index(speed) for speed in library.speeds_m_s.tolist()]
    return np.array(told["nrmse"], dtype=float)[np.ix_(where, speeds)]


def _parameters(device: dict[str, Any], effect: str, seed: int) -> dict[str, tuple[float, float, float, float]]:
    """Name -> found, its 95 % interval, true; what is truly zero is left out."""
    if device["kind"] != "drive":
        return {}
    true = truth(effect, seed)
    values = {name: (device[name], getattr(true.shared, ours)) for name, ours in SHARED.items()}
    for name, row in zip(HAND, true.hand.tolist(), strict=True):
        for part, really in zip(("constant", "per_newton"), row, strict=True):
            values[f"hand.{name}.{part}"] = (device["hand"][name][part], really)
    spans = device.get("intervals", {})
    return {
        name: (float(found), *map(float, spans.get(name, (np.nan, np.nan))), float(really))
        for name, (found, really) in values.items()
        if really
    }


def judge(
    effect: str,
    seed: int,
    folder: Path,
    *,
    grips_N: Sequence[float] = GRIPS_N,
    trials: int = 4,
    sweeps_only: bool = False,
) -> Verdict:
    """Record, identify, solve, play."""
    more = {"grips_N": grips_N, "trials": trials, "multisines": not sweeps_only, "taps": () if sweeps_only else TAPS}
    files = make_records(folder / "records", effect, seed, **more)
    model, began = folder / "model.json", time.perf_counter()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(typer.Exit):
            identify_device(files, model, SCENE)
    except InputError as refused:
        said, seconds = str(refused), time.perf_counter() - began
        named = [cause for cause in EFFECTS[effect].causes if cause in said]
        return Verdict(effect, seed, shortfalls=[said], causes=named, seconds=seconds)
    seconds = time.perf_counter() - began
    device = json.loads(model.read_text(encoding="utf-8"))["device"]
    known: dict[str, Any] = {
        "seconds": seconds,
        "kind": device["kind"],
        "causes": list(device.get("causes", ())),
        "shortfalls": list(device["shortfalls"]),
        "parameters": _parameters(device, effect, seed),
    }
    _, recorded, nominal = _nominal()
    build = build_library(builtin.load_scene(SCENE, model=model), recorded)
    library = build.library
    if library is None:
        unsolved = [f"{e.speed_m_s:g} m/s, {e.grip_N:g} N: {e.status.value}" for e in build.refused]
        return Verdict(effect, seed, unsolved=unsolved, **known)
    true, against = _errors(effect, seed, library)
    return Verdict(
        effect,
        seed,
        predicted=_predicted(device["predicted"], library).tolist(),
        true=true.tolist(),
        against_taps=float(np.mean(against)),
        nominal_against_taps=float(np.mean(_errors(effect, seed, nominal)[1])),
        **known,
    )


def _judge(work: tuple[str, int, tuple[float, ...], int, bool]) -> Verdict:
    effect, seed, grips, trials, sweeps_only = work
    with TemporaryDirectory() as folder:
        return judge(effect, seed, Path(folder), grips_N=grips, trials=trials, sweeps_only=sweeps_only)


def rows(verdicts: Iterable[Verdict]) -> list[list[str]]:
    """Cells of the table, errors in %."""

    def percent(value: float) -> str:
        return f"{100 * value:.2f}" if np.isfinite(value) else "-"

    found = []
    for one in verdicts:
        (median, true_median), (worst, true_worst) = one.pairs
        row = [
            one.effect,
            str(one.seed),
            percent(median),
            percent(true_median),
            f"{median / true_median:.2f}",
            percent(worst),
            percent(true_worst),
            f"{worst / true_worst:.2f}",
            f"{percent(one.against_taps)} / {percent(one.nominal_against_taps)}",
            ", ".join(one.causes) or "-",
            "refused" if one.shortfalls else "unsolved" if one.unsolved else one.kind,
            f"{one.seconds:.1f}",
            one.shortcoming or "holds",
        ]
        found.append(row)
    return found


HEAD = [
    "effect",
    "seed",
    "predicted median %",
    "true",
    "ratio",
    "predicted worst %",
    "true",
    "ratio",
    "against taps, nominal %",
    "causes",
    "model",
    "s",
    "verdict",
]


def parameter_rows(verdicts: Iterable[Verdict]) -> tuple[list[list[str]], int, int]:
    """Root mean square error of each parameter in % on the plain device; intervals that hold the truth, of all."""
    plain = [one.parameters for one in verdicts if one.effect == "none" and one.parameters]
    found, held, all_ = [], 0, 0
    for name in plain[0] if plain else ():
        values = np.array([one[name] for one in plain])
        error = np.log(np.maximum(values[:, 0], 1e-12) / values[:, 3])
        inside = (values[:, 1] <= values[:, 3]) & (values[:, 3] <= values[:, 2])
        held, all_ = held + int(inside.sum()), all_ + inside.size
        found.append([name, f"{100 * np.sqrt(np.mean(error**2)):.3f}", f"{inside.sum()} of {inside.size}"])
    return found, held, all_


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effects", nargs="+", default=list(EFFECTS), choices=list(EFFECTS), metavar="EFFECT")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--grips", default=",".join(f"{grip:g}" for grip in GRIPS_N), help="recorded ones, in N")
    parser.add_argument("--trials", type=int, default=4)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--sweeps-only", action="store_true", help="neither multisines nor held-out taps")
    parser.add_argument("--out", type=Path, default=Path("out/verdicts"))
    parser.add_argument("--page", type=Path, help="page of results whose marked part is written anew")
    arguments = parser.parse_args()
    on_one_thread()
    terminal.make_folder(arguments.out)
    grips = tuple(float(grip) for grip in arguments.grips.split(","))
    work = [
        (effect, seed, grips, arguments.trials, arguments.sweeps_only)
        for effect in arguments.effects
        for seed in arguments.seeds
    ]
    console, verdicts = terminal.console(), list[Verdict]()
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for one in pool.map(_judge, work):
            verdicts.append(one)
            print("  ".join(rows([one])[0]), flush=True)
            text = json.dumps([{**asdict(done), "shortcoming": done.shortcoming} for done in verdicts], indent=1)
            (arguments.out / "verdicts.json").write_text(text + "\n", encoding="utf-8")
    table = Table(*HEAD)
    for row in rows(verdicts):
        table.add_row(*row)
    console.print(table)
    for one in verdicts:
        for text in (*one.shortfalls, *one.unsolved):
            console.print(f"{one.effect} {one.seed}: {text}", soft_wrap=True, highlight=False)
    parameters, held, all_ = parameter_rows(verdicts)
    words = []
    if parameters:
        errors = Table("parameter", "rms error %", "in its 95 % interval", title="plain device")
        for row in parameters:
            errors.add_row(*row)
        console.print(errors)
        words.append(f"95 % intervals on the plain device: {held} of {all_} hold the truth")
    rightly = sum(len(one.causes) > len(one.false_causes) for one in verdicts)
    falsely = [f"{one.effect} {one.seed} ({', '.join(one.false_causes)})" for one in verdicts if one.false_causes]
    words.append(f"a right cause named in {rightly}, a false one in {len(falsely)}: {'; '.join(falsely) or 'none'}")
    wrong = [one for one in verdicts if one.shortcoming]
    words.append(f"{len(verdicts) - len(wrong)} of {len(verdicts)} verdicts hold")
    for line in words:
        console.print(line, soft_wrap=True, highlight=False)
    console.print(f"{arguments.out / 'verdicts.json'}", highlight=False)
    write_part(arguments.page, [*markdown_table(HEAD, rows(verdicts)), f"{'; '.join(words)}."])
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
