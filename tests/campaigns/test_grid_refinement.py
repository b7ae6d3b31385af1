"""What refining the grid does between the nodes, on two devices, at random points.

    python -m pytest -m long -n 0 tests/campaigns/test_grid_refinement.py
        --campaign="[--points 200] [--tolerance 0.02] [--cap 400] [--out DIR]"

Prints for the default scene and for the same device in a soft hand: entries, worst and median excess of the blend
over the optimum without and with refinement, and times. The excess is taken from the two libraries as a device blends
them, solved anew and replayed at each point. With --out, grid_error_*.png go there. It fails if the tolerance is
not met at one of the points.
"""

import time
from pathlib import Path
from typing import Annotated

import numpy as np
from typer import Option

import problems
from tests.campaigns.harness import PartFile, at_least, long_form, write_part
from transopt.base.plotting import save_figure
from transopt.base.signals import FloatArray
from transopt.base.writing import table
from transopt.design.build import build_library
from transopt.design.context import Context
from transopt.design.design import design
from transopt.design.refine_grid import DEFAULT_CAP, refine_grid
from transopt.library.library import Library
from transopt.plant.discretise import discretise
from transopt.proof.replay import replayed_figures
from transopt.references.references import References
from transopt.scene.recordings import references_of
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings
from transopt.study.grid_spacing import soft_hand

SEED = 1


def random_points(scene: Scene, count: int, seed: int = SEED) -> FloatArray:
    """(count, 2) speeds [m/s] and grips [N], uniform within the grid of a scene."""
    grid = scene.grid
    low, high = (grid.speeds_m_s[0], grid.grips_N[0]), (grid.speeds_m_s[-1], grid.grips_N[-1])
    return np.random.default_rng(seed).uniform(low, high, (count, 2))


def excess(scene: Scene, references: References, points: FloatArray, *libraries: Library) -> FloatArray:
    """(n, libraries) tap error of what each library plays at points (n, 2) less that of the optimum, replayed."""
    grid, found = scene.time_grid(), []
    for speed, grip in points:
        stage = discretise(scene.plant(grip), scene.amplifier_model(), grid.dt_s)
        reference = references.at(speed, grip)
        (entry,) = design([Context(scene).posed_as(reference, grip)])
        exactly = entry.solution.command
        commands = np.stack([exactly, *(library.at(speed, grip).command for library in libraries)])
        wanted = [reference.target] * len(commands)
        told = replayed_figures(stage, entry.problem.yardstick, commands, wanted)
        exact, *blended = (each.tap_error for each in told)
        found.append([each - exact for each in blended])
    return np.array(found)


def demonstrate(
    name: str, scene: Scene, points: int, tolerance: float, cap: int, out: Path | None
) -> tuple[bool, list[list[object]]]:
    """One device: refined, built both ways, compared; whether the tolerance holds at every point, and its rows."""
    taps = recordings(scene)
    refinement = refine_grid(scene, taps, tolerance, cap=cap)
    if refinement.shortfall:
        print(f"{name}: {refinement.shortfall}")
    start = time.perf_counter()
    libraries = [build_library(scene, taps, refinement=r).library for r in (None, refinement)]
    built_s = time.perf_counter() - start
    references = references_of(scene, taps)
    places = random_points(scene, points)
    found = 100 * excess(scene, references, places, *(library for library in libraries if library is not None))
    if found.shape[1] != 2:
        print(f"{name}: entries refused, no library to compare")
        return False, []
    print(f"{name}: {points} random points, tolerance {100 * tolerance:g} %")
    entries = (refinement.recorded_entries, refinement.entries)
    for text, count, errors in zip(("without refinement", "with refinement"), entries, found.T, strict=True):
        worst = places[np.argmax(errors)]
        print(
            f"  {text:18}  {count:3} entries, worst excess {errors.max():5.2f} % at {worst[0]:.3f} m/s, "
            f"{worst[1]:.2f} N, median {np.median(errors):.2f} %"
        )
    grid = refinement.grid
    print(f"  speeds {grid.speeds_m_s} m/s, grips {grid.grips_N} N")
    print(f"  {refinement.elapsed_s:.1f} s for {refinement.rounds} rounds, {built_s:.1f} s for both libraries")
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        save_figure(refinement.plot(), out / f"grid_error_{name}.png")
    sizes = f"refined, {len(grid.speeds_m_s)} speeds x {len(grid.grips_N)} grips"
    rows: list[list[object]] = [
        [device, words, count, f"{errors.max():.2f}", f"{np.median(errors):.2f}"]
        for device, words, count, errors in zip(
            (f"`{name}`", ""), ("of the scene", sizes), entries, found.T, strict=True
        )
    ]
    return bool(found[:, 1].max() <= 100 * tolerance), rows


def main(
    points: Annotated[int, at_least(1, "random points per device")] = 200,
    tolerance: Annotated[float, Option(help="largest excess, absolute in tap error")] = 0.02,
    cap: Annotated[int, Option(help="most entries")] = DEFAULT_CAP,
    out: Annotated[Path | None, Option(help="folder for the figures")] = None,
    part: PartFile = None,
) -> int:
    scene = problems.load("wood_on_foam")
    devices = {"wood_on_foam": scene, "soft_hand": soft_hand(scene)}
    shown = [demonstrate(name, device, points, tolerance, cap, out) for name, device in devices.items()]
    head = ("device", "grid", "entries", "worst excess %", "median excess %")
    write_part(part, table(head, [row for _, rows in shown for row in rows]))
    return 0 if all(held for held, _ in shown) else 1


test_long_form = long_form(main)
