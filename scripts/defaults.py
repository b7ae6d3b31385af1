"""Justifies the default weights and window: errors over heat, and the effect of single changes.

    python scripts/defaults.py [--figure FILE.png] [--page docs/results/defaults.md]

The figure shows Pareto fronts of an entry without binding limits, one for each window: the price of heat varies along
a line, so that no other command of that window has less error at the same heat. The table changes one number at a
time in every built-in scene with a hand, and states the effect on the means over its entries.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from common.command import run
from common.page import PageFile, write_part
from matplotlib.figure import Figure
from played_against_real import SCENES
from typer import Option

import problems
from transopt.base.errors import InputError
from transopt.base.plotting import LABEL_PT, SMALL_PT, save_figure
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.base.writing import table
from transopt.design.build import build_library
from transopt.scene import strikes
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene

ENTRY = {"grid.speeds_m_s": [0.3], "grid.grips_N": [3.0]}  # an entry without binding limits
WINDOWS_STAGES = (400, 600, 800, 1000)  # windows in stages of 0.1 ms
PRICES = (0.0, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4)
CORNERS_Hz, PLAIN = (10.0, 20.0, 30.0), (0.0, 0.03, 0.09, 0.25, 1.0)
CHANGES: tuple[tuple[str, Mapping[str, Any]], ...] = (
    ("as it is", {}),
    ("window three quarters", {"time.stages": 0.75}),
    ("window five quarters", {"time.stages": 1.25}),
    ("`plain` 0", {"weights.plain": 0.0}),
    ("`plain` 0.25", {"weights.plain": 0.25}),
    ("rapid from 10 Hz", {"weights.rapid_from_Hz": 10.0}),
    ("rapid from 30 Hz", {"weights.rapid_from_Hz": 30.0}),
    ("tail 10 ms", {"weights.after_s": 0.01}),
    ("tail 60 ms", {"weights.after_s": 0.06}),
    ("hand-over 50 samples", {"hand_over_samples": 50}),
)


@dataclass(frozen=True)
class Means:
    """Means over the entries of a scene; bump [g] and heat [A^2 ms] of entries as fast as its fastest."""

    tap: float
    felt: float
    speed: float
    bump_g: float
    heat_A2_ms: float


def means(scene: Scene) -> Means:
    """Means over the entries of a scene.

    Raises
    ------
    InputError : an entry is refused.
    """
    build = build_library(scene, strikes.recordings(scene))
    if build.refused:
        raise InputError(f"{scene.name}: {len(build.refused)} entries are refused")
    entries = list(build.all_entries())
    return Means(
        tap=float(np.mean([e.figures.tap_error for e in entries])),
        felt=float(np.mean([e.figures.felt_error for e in entries])),
        speed=float(np.mean([e.figures.speed for e in entries])),
        bump_g=float(np.mean([e.figures.bump_m_s2 for e in entries])) / STANDARD_GRAVITY_M_S2,
        heat_A2_ms=1e3 * float(np.mean([e.heat_A2_s for e in entries])),
    )


def fronts() -> dict[str, list[Means]]:
    """Line of the figure -> its points, in order of increasing price of heat."""
    scene, found = with_values(problems.load("wood_on_foam"), ENTRY), {}
    for stages in WINDOWS_STAGES:
        priced = [{"time.stages": stages, "weights.heat_price": price} for price in PRICES]
        found[f"{stages / 10:g} ms, heat priced"] = [means(with_values(scene, values)) for values in priced]
    for corner in CORNERS_Hz:
        weighed = [{"weights.plain": plain, "weights.rapid_from_Hz": corner} for plain in PLAIN]
        name = f"80 ms, from {corner:g} Hz, plain {PLAIN[0]:g} to {PLAIN[-1]:g}"
        found[name] = [means(with_values(scene, values)) for values in weighed]
    return found


def front_figure(found: Mapping[str, list[Means]], default: Means) -> Figure:
    """Tap error, felt error and bump over heat, a line for each window and each corner."""
    figure = Figure(figsize=(10.5, 4.4), layout="constrained")
    panels = figure.subplots(1, 3)
    for axes, (name, label, scale) in zip(
        panels,
        (("tap", "tap error [%]", 100), ("felt", "felt error [%]", 100), ("bump_g", "bump [g]", 1)),
        strict=True,
    ):
        for k, (words, points) in enumerate(found.items()):
            style = "-" if k < len(WINDOWS_STAGES) else ":"
            heat, value = [p.heat_A2_ms for p in points], [scale * getattr(p, name) for p in points]
            axes.plot(heat, value, style, color=f"C{k}", marker="o", markersize=3, linewidth=1.3, label=words)
        axes.plot(default.heat_A2_ms, scale * getattr(default, name), "k*", markersize=11, label="as it is")
        axes.set_xlabel("heat [A$^2$ ms]", fontsize=LABEL_PT)
        axes.set_ylabel(label, fontsize=LABEL_PT)
        axes.set_ylim(bottom=0)
        axes.set_xlim(left=0)
        axes.tick_params(labelsize=SMALL_PT)
        axes.grid(color="0.9")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=SMALL_PT, frameon=False)
    return figure


def changed(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """A scene with other numbers; a changed window is stated relative to the present one."""
    stages = {"time.stages": round(scene.stages * values["time.stages"])} if "time.stages" in values else {}
    return with_values(scene, {**values, **stages})


def by_scene(change: Mapping[str, Any]) -> list[Means | None]:
    """Means of every scene of a hand with a change; None where it is refused, as a window beyond the tap period."""
    found: list[Means | None] = []
    for scene in map(problems.load, SCENES):
        if max(scene.grid.grips_N) == 0:
            continue  # without a hand the optimum has no error, and ratios of it tell nothing
        try:
            found.append(means(changed(scene, change)))
        except InputError:
            found.append(None)
    return found


def change_table() -> list[str]:
    """Rows of the table: change, and the median, least and largest ratio to the unchanged scenes."""
    rows, first = [], by_scene({})
    for words, change in CHANGES[1:]:
        found = by_scene(change)
        row = [words]
        for name in ("tap", "felt", "bump_g", "heat_A2_ms"):
            pairs = [(a, b) for a, b in zip(found, first, strict=True) if a is not None and b is not None]
            ratios = np.array([getattr(a, name) / getattr(b, name) for a, b in pairs])
            row += [f"{np.median(ratios):.2f}", f"{ratios.min():.2f} to {ratios.max():.2f}"]
        rows.append(row)
        print(*row, sep="  ", flush=True)
    head = [each for name in ("tap", "felt", "bump", "heat") for each in (f"{name}, median", f"{name}, scenes")]
    return table(("change", *head), rows)


def main(
    figure: Annotated[Path | None, Option(help="file of the figure")] = None,
    page: PageFile = None,
) -> int:
    found = fronts()
    default = found["80 ms, heat priced"][0]
    if figure is not None:
        save_figure(front_figure(found, default), figure)
    for words, points in found.items():
        print(words, *(f"{100 * p.tap:.1f}/{100 * p.felt:.1f}/{p.bump_g:.2f}/{p.heat_A2_ms:.0f}" for p in points))
    write_part(page, change_table())
    return 0


if __name__ == "__main__":
    run(main)
