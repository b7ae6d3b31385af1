"""Record, identify, solve, play, refine: how near a device that is not what its scene says comes to recorded taps.

    python -m pytest -m long -n 0 tests/campaigns/test_identification_loop.py
        --campaign="[--scene NAME] [--mismatch 0.1,0.2] [--seed 4] [--rounds 3] [--taps 3] [--trials 4]
        [--grips 1,2,3,4,5] [--without-identification] [--unstated-pole] [--out out/identification_loop]"

The true device is the scene's with every parameter off by up to the mismatch, its amplifier with a crossover, its
sensors with noise. For each mismatch: the nominal library is solved; sweeps are recorded on the true device,
amplifier and device identified from them, the scene solved anew with that model; what came out is refined by taps on
the device; all of it by the command line. Each library is then played at every node on the true device, through the
servo, and its true acceleration, after the one shift that aligns them, compared with the recorded tap over the whole
window; the refinement's rounds are stated as its sensors measured them, until the hand can react. Beside them stands
the optimum of someone who knows the true device, under the same limits: where they bind nothing can be better.

Two rows are free of what a servo adds: the optimum of who knows the true chain and amplifier, and the commands of the
identified library, both rolled out through the true device without its crossover. Their difference is what the
identification costs.

Prints one table per mismatch, draws loop.png, writes loop.json. It fails if a current was above its limit, if the
identified commands are more than 0.05 points worse than who knows the truth over the taps up to 0.3 m/s (not asked
with `--unstated-pole`, where no file states the accelerometer's pole), if the identified model is worse than the
nominal one, or if refinement makes it worse.
"""

import re
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
import typer

import problems
from controller.record.metrics import align
from controller.refine.heard import Node, nodes_of
from controller.sim.played_tap import play_tap
from controller.sim.sensors import noise_seed
from controller.sim.simulated_tap import SimulatedTap
from controller.sim.simulator import Imperfections, device_in
from controller.sim.true_device import TrueDevice
from problems.generators.strikes import write_csv
from tests.benches.compiled import servo_of
from tests.campaigns.harness import PartFile, Seed, at_least, long_form, numbers_of, show, write_json, write_part
from tests.campaigns.loop_stages import IDENTIFIED, ROUND, TRUTH, Stage, figure, in_markdown, shortfalls, table
from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.base.plotting import save_figure
from transopt.base.signals import FloatArray, nrmse
from transopt.design.build import build_library
from transopt.design.optimum import optimum
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.plant.chain import Link, chain
from transopt.plant.discretise import discretise
from transopt.plant.intention import INTENTION_S
from transopt.plant.state_space import StateSpace
from transopt.problem.problem import TransientProblem
from transopt.recordings.tap import read_recordings
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings
from transopt.solvers.options import SolverOptions

ANOTHER_SEED = 1000  # noise that no refinement has seen


@dataclass(frozen=True)
class Loop:
    """How the loop is gone through.

    Attributes
    ----------
    seed : of the true device and its noise.
    rounds, taps : of the refinement.
    trials, grips : of the sweeps; grips in N with commas between.
    identify : the library that is refined has an identified model.
    unstated_pole : no file states the accelerometer's pole.
    """

    out: Path
    seed: int
    rounds: int
    taps: int
    trials: int
    grips: str
    identify: bool
    unstated_pole: bool


def command(program: str, *arguments: object) -> None:
    """A command of the project; its output goes to the terminal.

    Raises
    ------
    InputError : it failed on its input. A result that fell short (exit code 1) is told and taken.
    """
    words = [str(argument) for argument in arguments]
    print(f"$ {program} {' '.join(words)}", flush=True)
    module = {"transopt": "transopt.cli.main", "transopt-play": "controller.cli.play"}[program]
    done = subprocess.run([sys.executable, "-c", f"from {module} import main; main()", *words], check=False)
    if done.returncode > 1:
        raise InputError(f"{program} {words[0]}: ended with {done.returncode}")
    if done.returncode == 1:
        print(f"{program} {words[0]}: its result fell short of its own checks", flush=True)


def recorded_scene(name: str, folder: Path) -> Path:
    """A scene file whose recordings are files, so that the references stay when the model changes."""
    scene = problems.load(name)
    if scene.recordings.simulated is None:
        raise InputError(f"--scene {name}: has no simulated object whose recordings could be written")
    taps = folder / "recordings"
    taps.mkdir(parents=True, exist_ok=True)
    for number, recording in enumerate(recordings(scene)):
        write_csv(recording, taps / f"tap_{number:02d}.csv")
    text = problems.scene_path(name).read_text(encoding="utf-8")
    text = re.sub(r"(?m)^#[^\n]*\n(?=\[recordings\.simulated\])", "", text)
    text = re.sub(r"(?ms)^\[recordings\.simulated\]\n.*?(?=^\[)", "", text)
    text = text.replace("[recordings]\n", '[recordings]\nfolder = "recordings"\nfiles = ["tap_*.csv"]\n', 1)
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def with_model(scene: Path, model: Path) -> Path:
    """Write the scene again with amplifier and device as they were identified."""
    path = scene.with_name(f"{scene.stem}_{model.stem}.toml")
    path.write_text(f'model_file = "{model.name}"\n{scene.read_text(encoding="utf-8")}', encoding="utf-8")
    return path


def solved(scene: Path, out: Path) -> Library:
    command("transopt", "solve", scene, "--out", out, "--accept-unfit-model")
    return load_library(out / "library.npz")


def played(
    name: str, library: Library, designed: Library, device: TrueDevice, wrong: Imperfections, taps: int, seed: int
) -> Stage:
    """Every node some times on the true device, which is asked what it really did.

    Parameters
    ----------
    designed : what the device shall do; the library itself, or the one that its refinement began with.
    """
    times, noise = library.time_grid().switching_times_s, replace(wrong, mismatch=0.0)
    early = times <= INTENTION_S
    errors, off_design, peak = [], [], 0.0
    for iv, ig in nodes_of(library):
        found, off = [], []
        for n in range(taps):
            tap = SimulatedTap(
                speed_m_s=float(library.speeds_m_s[iv]),
                grip_N=float(library.grips_N[ig]),
                seed=noise_seed(seed, 0, iv, ig, n),
                imperfections=noise,
            )
            one = play_tap(library, servo_of(library, amplifier_tolerance=wrong.mismatch), tap, device=device)
            if not one.played:
                raise InputError(f"{name}: nothing was played at {tap.speed_m_s:g} m/s, {tap.grip_N:g} N")
            found.append(one.tap_error)
            wanted = designed.acceleration_m_s2[iv, ig] + designed.free_m_s2[iv, ig]
            off.append(align(one.times_s, one.acceleration_m_s2, times[early], wanted[early]).nrmse)
            peak = max(peak, one.peak_current_A)
        errors.append(float(np.mean(found)))
        off_design.append(float(np.mean(off)))
    return Stage(name, errors, off_design, peak)


def plant_of(device: TrueDevice, grip_N: float) -> StateSpace:
    """From current to stylus acceleration of the true device."""
    masses, stiffness, damping = device.at(grip_N)
    links = [Link(float(k), float(b)) for k, b in zip(stiffness, damping, strict=True)]
    force = device.force_per_current_N_A
    return chain(masses.tolist(), links, force_per_current_N_A=force, stylus=device.stylus)


def without_servo(
    name: str, library: Library, device: TrueDevice, command: Callable[[Node, TransientProblem], FloatArray]
) -> Stage:
    """Commands rolled out through the true chain and amplifier, crossover aside: what a servo adds is not in it.

    Parameters
    ----------
    command : at a node, for the problem of who knows the true device, whose reference is shifted by the error of the
        delay.
    """
    errors, off_design, peak = [], [], 0.0
    for iv, ig in nodes_of(library):
        stage = discretise(plant_of(device, float(library.grips_N[ig])), device.amplifier, library.dt_s)
        grid = replace(library.time_grid(), delay_s=device.delay_s)
        problem = replace(library.problem(iv, ig).without("temperature"), stage=stage, grid=grid)
        acceleration, current = stage.rollout(command((iv, ig), problem))
        errors.append(problem.yardstick.tap_error(problem.target, acceleration))
        early = grid.switching_times_s <= INTENTION_S
        off_design.append(nrmse(acceleration[early], library.acceleration_m_s2[iv, ig, early]))
        peak = max(peak, float(np.abs(current).max()))
    return Stage(name, errors, off_design, peak)


def known_optimum(node: Node, problem: TransientProblem) -> FloatArray:
    """The best command under the library's limits for who knows the true device."""
    found = optimum(problem, SolverOptions())
    if not found.is_proven:
        raise InputError(f"optimum of the true device: {found.solution.status.value}")
    return found.solution.command


def identified(scene: Path, loop: Loop, mismatch: float, folder: Path) -> Path:
    """Record on the true device and identify; the scene with that model."""
    model = scene.with_name(f"identified_{mismatch:g}.json")
    truth = ("--true-device", scene, "--mismatch", mismatch, "--seed", loop.seed)
    for purpose, more in (("amplifier", ()), ("device", ("--grips", loop.grips))):
        sweeps = folder / f"sweeps_{purpose}"
        for old in sweeps.glob("*.npz"):
            old.unlink()
        record = ("record", "sweep", "--simulate", "--for", purpose, "--trials", loop.trials, *more)
        command("transopt-play", *record, *truth, "--out", sweeps)
        files = sorted(sweeps.glob(f"{purpose}_*.npz"))
        if loop.unstated_pole:
            for file in files:
                leave_out(file, "accelerometer_Hz")
        known = ("--scene", scene) if purpose == "device" else ()
        command("transopt", "identify", purpose, *files, *known, "--out", model)
    return with_model(scene, model)


def leave_out(file: Path, name: str) -> None:
    """Rewrite a record without one of its numbers."""
    with np.load(file) as record:
        kept = {key: record[key] for key in record.files if key != name}
    np.savez_compressed(file, **kept)


def run_one(scene: Path, loop: Loop, mismatch: float) -> list[Stage]:
    """All stages at one mismatch, the known truth last."""
    folder = loop.out / f"mismatch_{mismatch:g}"
    folder.mkdir(parents=True, exist_ok=True)
    wrong = Imperfections(mismatch=mismatch)
    nominal = solved(scene, folder / "nominal")
    device = device_in(nominal.scene(), wrong, loop.seed)
    seed = loop.seed + ANOTHER_SEED

    def play(name: str, library: Library, designed: Library) -> Stage:
        return played(name, library, designed, device, wrong, loop.taps, seed)

    stages, begun = [play("nominal model", nominal, nominal)], folder / "nominal" / "library.npz"
    designed = nominal
    if loop.identify:
        model_scene = identified(scene, loop, mismatch, folder)
        begun = folder / "identified" / "library.npz"
        model = solved(model_scene, begun.parent)
        stages.append(play("identified model", model, model))
        designed = model
    out = folder / "refined"
    truth = ("--true-device", scene, "--mismatch", mismatch, "--seed", loop.seed)
    how = ("--simulate", *truth, "--rounds", loop.rounds, "--taps", loop.taps)
    command("transopt-play", "refine", begun, *how, "--out", out)
    command("transopt", "verify", out / "library.npz")
    refined = load_library(out / "library.npz")
    stages += rounds_of(refined, loop.rounds)
    stages.append(play("refined, kept", refined, designed))
    if loop.identify:
        stages.append(without_servo(IDENTIFIED, model, device, lambda node, _: model.command[node]))
    return [*stages, without_servo(TRUTH, nominal, device, known_optimum)]


def rounds_of(refined: Library, most: int) -> list[Stage]:
    """After each round the best that every node had until then, as the device's own sensors measured it.

    A refinement that ended before `most` rounds has what it had from there on.
    """
    stages: list[Stage] = []
    best: list[float] = []
    unknown = [float("nan")] * refined.tap_error.size
    for number, told in enumerate(refined.meta["refinement"]["rounds"]):
        errors, better = ([value for row in told[name] for value in row] for name in ("playback_error", "better"))
        # A node with nothing left to be learnt is not played in a round: null, and not better.
        best = [new if kept else old for new, kept, old in zip(errors, better, best or errors, strict=True)]
        peak = max(value for row in told["peak_current_A"] for value in row if value is not None)
        if number:
            stages.append(Stage(f"{ROUND} {number}", unknown, best, peak))
    last = stages[-1] if stages else Stage("", unknown, best, peak)
    return stages + [replace(last, name=f"{ROUND} {number}") for number in range(len(stages) + 1, most + 1)]


def main(
    scene: str = "wood_on_foam",
    mismatch: str = "0.1,0.2",
    seed: Seed = 4,
    rounds: Annotated[int, at_least(1)] = 3,
    taps: Annotated[int, at_least(1)] = 3,
    trials: Annotated[int, at_least(1)] = 4,
    grips: Annotated[str, typer.Option(help="at which sweeps are recorded, in N")] = "1,2,3,4,5",
    without_identification: Annotated[
        bool, typer.Option("--without-identification", help="refine the nominal library")
    ] = False,
    unstated_pole: Annotated[
        bool, typer.Option("--unstated-pole", help="no file states the accelerometer's pole")
    ] = False,
    out: Path = Path("out/identification_loop"),
    part: PartFile = None,
) -> int:
    began_s = time.monotonic()
    terminal.make_folder(out)
    loop = Loop(out, seed, rounds, taps, trials, grips, not without_identification, unstated_pole)
    recorded = recorded_scene(scene, out)
    results = {by: run_one(recorded, loop, by) for by in numbers_of(mismatch)}
    failed = []
    for by, stages in results.items():
        library = load_library(out / f"mismatch_{by:g}" / "nominal" / "library.npz")
        show(*table(by, stages, library))
        failed += shortfalls(by, stages, library, unstated_pole)
    save_figure(figure(results), out / "loop.png")
    write_part(part, in_markdown(results))
    write_json({f"{by:g}": [asdict(stage) for stage in stages] for by, stages in results.items()}, out / "loop.json")
    print(f"{out}: loop.png, loop.json; {time.monotonic() - began_s:.0f} s")
    print("\n".join(failed))
    return 1 if failed else 0


test_long_form = long_form(main)


def test_recorded_files_give_the_library_of_the_simulated_object(library: Library, tmp_path: Path) -> None:
    path = recorded_scene("wood_on_foam", tmp_path)
    scene = problems.load(path)
    assert scene.recordings.simulated is None
    again = build_library(scene, read_recordings(scene.recordings)).library
    # The files round accelerations to 1e-4 g and speeds to 1e-4 m/s.
    np.testing.assert_allclose(again.recorded_m_s2, library.recorded_m_s2, atol=0.2)
    np.testing.assert_allclose(again.tap_error, library.tap_error, atol=2e-3)


def test_a_scene_on_its_model(tmp_path: Path) -> None:
    path, model = recorded_scene("wood_on_foam", tmp_path), tmp_path / "m.json"
    before = tomllib.loads(path.read_text())
    after = tomllib.loads(with_model(path, model).read_text())
    assert after.pop("model_file") == "m.json"
    assert after == before


def test_without_mismatch_the_known_truth_is_the_library(scene: Scene, library: Library) -> None:
    device = device_in(scene, Imperfections(), 0)
    f = np.geomspace(5, 2000, 30)
    for grip in (1.0, 5.0):
        np.testing.assert_allclose(plant_of(device, grip).response(f), scene.plant(grip).response(f), rtol=1e-9)
    truth = without_servo(TRUTH, library, device, known_optimum)
    np.testing.assert_allclose(truth.tap_error, library.tap_error.ravel(), atol=1e-6)
    assert max(truth.playback_error) < 1e-6
    assert truth.peak_current_A == pytest.approx(4.0, abs=1e-6)
    other = device_in(scene, Imperfections(mismatch=0.2), 4)
    best = without_servo(TRUTH, library, other, known_optimum)
    own = without_servo(IDENTIFIED, library, other, lambda node, _: library.command[node])
    assert best.worst > truth.worst
    assert own.playback > 0.03


def test_rounds_keep_the_best_so_far(library: Library) -> None:
    rounds = [
        {"playback_error": [[0.2, 0.3]], "better": [[True, True]], "peak_current_A": [[1.0, 2.0]]},
        {"playback_error": [[0.1, 0.4]], "better": [[True, False]], "peak_current_A": [[1.0, 3.0]]},
        {"playback_error": [[None, 0.2]], "better": [[None, True]], "peak_current_A": [[None, 1.0]]},
    ]
    found = rounds_of(replace(library, meta={**library.meta, "refinement": {"rounds": rounds}}), 3)
    assert [stage.playback_error for stage in found] == [[0.1, 0.3], [0.1, 0.2], [0.1, 0.2]]
    assert [stage.peak_current_A for stage in found] == [3.0, 1.0, 1.0]


def test_what_falls_short(library: Library) -> None:
    def stages(nominal: float, model: float, refined: float, own: float = 0.0104, peak: float = 4.0) -> list[Any]:
        named = {
            "nominal model": nominal,
            "identified model": model,
            "refined, kept": refined,
            IDENTIFIED: own,
            TRUTH: 0.01,
        }
        return [Stage(name, [value] * 12, [value] * 12, peak) for name, value in named.items()]

    def short(*values: float, unstated: bool = False, **more: float) -> list[str]:
        return list(shortfalls(0.1, stages(*values, **more), library, unstated))

    assert short(0.09, 0.04, 0.03) == []
    [worse] = short(0.09, 0.10, 0.03)
    assert "identified 10.00%, worse than nominal 9.00%" in worse
    [far] = short(0.09, 0.04, 0.03, own=0.0106)
    assert "up to 0.3 m/s identified 1.060%, known truth 1.000%" in far
    assert short(0.09, 0.04, 0.03, own=0.0106, unstated=True) == []
    [refined] = short(0.09, 0.04, 0.05)
    assert "refined, kept 5.00% of playback, identified model 4.00%" in refined
    assert len(short(0.09, 0.04, 0.03, peak=4.01)) == 4


def test_a_record_without_one_of_its_numbers(tmp_path: Path) -> None:
    np.savez(tmp_path / "one.npz", time_s=np.arange(3.0), accelerometer_Hz=2500.0)
    leave_out(tmp_path / "one.npz", "accelerometer_Hz")
    with np.load(tmp_path / "one.npz") as record:
        assert record.files == ["time_s"]
