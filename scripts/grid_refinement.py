"""What refining the grid does between the nodes, on two devices, at random points.

    python scripts/grid_refinement.py [--points 200] [--tolerance 0.02] [--cap 400] [--out DIR]

Prints for the default scene and for the same device in a soft hand: entries, worst and median excess of the blend
over the optimum without and with refinement, and times. The excess is taken from the two libraries as a device blends
them, solved anew and replayed at each point. With --out, grid_error_*.png go there. Exit code 1 if the tolerance is
not met at one of the points.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import problems
from transopt.base.errors import InputError
from transopt.base.plotting import save_figure
from transopt.base.signals import FloatArray
from transopt.design.build import build_library
from transopt.design.entry import entry_problem, optimum
from transopt.design.refine_grid import DEFAULT_CAP, refine_grid
from transopt.library.library import Library
from transopt.plant.discretise import discretise
from transopt.proof.replay import replayed_errors
from transopt.recordings.reference import Reference, between, build_references
from transopt.report.grid_figure import grid_figure
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings
from transopt.solvers.options import SolverOptions
from transopt.study.grid_spacing import soft_hand

SEED = 1


def random_points(scene: Scene, count: int, seed: int = SEED) -> FloatArray:
    """(count, 2) speeds [m/s] and grips [N], uniform within the grid of a scene."""
    grid = scene.grid
    low, high = (grid.speeds_m_s[0], grid.grips_N[0]), (grid.speeds_m_s[-1], grid.grips_N[-1])
    return np.random.default_rng(seed).uniform(low, high, (count, 2))


def excess(scene: Scene, references: list[Reference], points: FloatArray, *libraries: Library) -> FloatArray:
    """(n, libraries) NRMSE of what each library plays at points (n, 2) less that of the optimum there, replayed."""
    grid, found = scene.time_grid(), []
    for speed, grip in points:
        stage = discretise(scene.plant(grip), scene.amplifier_model(), grid.dt_s)
        reference = between(references, speed)
        best = optimum(entry_problem(scene, stage, reference), SolverOptions()).solution.command_A
        commands = np.stack([best, *(library.at(speed, grip).command_A for library in libraries)])
        wanted = np.tile(reference.motor_m_s2, (len(commands), 1))
        exact, *blended = replayed_errors(stage, grid, commands, wanted)
        found.append([each - exact for each in blended])
    return np.array(found)


def demonstrate(name: str, scene: Scene, arguments: argparse.Namespace) -> bool:
    """One device: refined, built both ways, compared; whether the tolerance holds at every point."""
    taps = recordings(scene)
    refinement = refine_grid(scene, taps, arguments.tolerance, cap=arguments.cap)
    if refinement.shortfall:
        print(f"{name}: {refinement.shortfall}")
    start = time.perf_counter()
    libraries = [build_library(scene, taps, refinement=r).library for r in (None, refinement)]
    built_s = time.perf_counter() - start
    references = build_references(taps, scene.grid.speeds_m_s, scene.time_grid(), scene.recordings)
    points = random_points(scene, arguments.points)
    found = 100 * excess(scene, references, points, *(library for library in libraries if library is not None))
    if found.shape[1] != 2:
        print(f"{name}: entries refused, no library to compare")
        return False
    print(f"{name}: {len(points)} random points, tolerance {100 * arguments.tolerance:g} %")
    entries = (refinement.recorded_entries, refinement.entries)
    for text, count, errors in zip(("without refinement", "with refinement"), entries, found.T, strict=True):
        worst = points[np.argmax(errors)]
        print(
            f"  {text:18}  {count:3} entries, worst excess {errors.max():5.2f} % at {worst[0]:.3f} m/s, "
            f"{worst[1]:.2f} N, median {np.median(errors):.2f} %"
        )
    grid = refinement.grid
    print(f"  speeds {grid.speeds_m_s} m/s, grips {grid.grips_N} N")
    print(f"  {refinement.elapsed_s:.1f} s for {refinement.rounds} rounds, {built_s:.1f} s for both libraries")
    if arguments.out is not None:
        arguments.out.mkdir(parents=True, exist_ok=True)
        save_figure(grid_figure(refinement), arguments.out / f"grid_error_{name}.png")
    return bool(found[:, 1].max() <= 100 * arguments.tolerance)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--points", type=int, default=200, help="random points per device")
    parser.add_argument("--tolerance", type=float, default=0.02, help="largest excess, absolute in NRMSE")
    parser.add_argument("--cap", type=int, default=DEFAULT_CAP, help="most entries")
    parser.add_argument("--out", type=Path, help="folder for the figures")
    arguments = parser.parse_args()
    if arguments.points < 1:
        parser.error(f"--points {arguments.points}: must be at least 1")
    scene = problems.load("wood_on_foam")
    try:
        held = [
            demonstrate("wood_on_foam", scene, arguments),
            demonstrate("soft_hand", soft_hand(scene), arguments),
        ]
    except InputError as error:
        parser.error(str(error))
    return 0 if all(held) else 1


if __name__ == "__main__":
    sys.exit(main())
