"""The error between the nodes of a library, on the scene's own grid and on the refined grid."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation

from transopt.base.plotting import LABEL_PT, SMALL_PT, Drawing
from transopt.base.signals import FloatArray
from transopt.design.refine_grid import Refinement
from transopt.scene.sections import Grid

SHADES = "YlGnBu"  # light for small errors, dark for large ones, also in grey print
SHADE_LEVELS = 41
TOLERANCE = "#D55E00"  # Okabe and Ito's vermilion, visible on light and dark
NODE: dict[str, Any] = {"marker": "o", "linestyle": "", "markerfacecolor": "white", "markeredgecolor": "0.15"}
WORST: dict[str, Any] = {"marker": "x", "linestyle": "", "color": TOLERANCE, "markersize": 8, "markeredgewidth": 1.8}


def grid_figure(refinement: Refinement) -> Figure:
    """Excess [%] of the blend over the optimum, before (left) and after (right) refinement, on one scale.

    Heat maps over (speed, grip), nodes as circles; if the grid has a single speed or grip, curves over the other one.

    Parameters
    ----------
    refinement : a refinement of a grid with more than one node.
    """
    points = refinement.points
    at = np.array([(p.speed_m_s, p.grip_N) for p in points])  # (n, 2)
    excess = 100 * np.array([(p.excess_before, p.excess_after) for p in points])  # (n, 2) [%]
    tolerance = 100 * refinement.tolerance
    top = float(max(excess.max(), tolerance))
    figure = Drawing(figsize=(8.0, 3.8), layout="constrained")
    panels = list(figure.subplots(1, 2, sharex=True, sharey=True))
    single = [axis for axis in (0, 1) if np.ptp(at[:, axis]) == 0]
    names = ("speed [m/s]", "grip [N]")
    grids = {"grid of the scene": refinement.recorded, "refined": refinement.grid}
    for j, (axes, (name, grid)) in enumerate(zip(panels, grids.items(), strict=True)):
        axes.tick_params(labelsize=SMALL_PT)
        entries = len(grid.speeds_m_s) * len(grid.grips_N)
        worst = int(np.argmax(excess[:, j]))
        axes.set_title(f"{name}, {entries} entries: worst {excess[worst, j]:.2f} %", fontsize=LABEL_PT)
        if single:
            _curve(axes, at[:, 1 - single[0]], excess[:, j], grid, single[0], tolerance)
            axes.set_ylim(min(-0.02 * top, 1.05 * float(excess.min())), 1.08 * top)
            axes.set_xlabel(names[1 - single[0]], fontsize=LABEL_PT)
        else:
            image = _map(axes, at, excess[:, j], grid, top, tolerance)
            axes.plot(*at[worst], **WORST, clip_on=False, zorder=4)
            axes.set_xlabel(names[0], fontsize=LABEL_PT)
    label = "excess of the blend over the optimum, tap error or amplitude [%]"
    if single:
        panels[0].set_ylabel(label, fontsize=LABEL_PT)
    else:
        panels[0].set_ylabel(names[1], fontsize=LABEL_PT)
        bar = figure.colorbar(image, ax=panels, pad=0.02, ticks=MaxNLocator(5))
        bar.set_label(label, fontsize=LABEL_PT)
        bar.ax.tick_params(labelsize=SMALL_PT)
        bar.ax.axhline(tolerance, color=TOLERANCE, linewidth=1.5)
    handles = [
        panels[0].plot([], [], **NODE, markersize=4.5, label="node")[0],
        panels[0].plot([], [], color=TOLERANCE, linewidth=1.5, label=f"tolerance {tolerance:g} %")[0],
    ]
    if not single:
        handles.append(panels[0].plot([], [], **WORST, label="worst point")[0])
    figure.legend(handles=handles, loc="outside upper center", ncols=3, fontsize=SMALL_PT, frameon=False)
    return figure


def _map(axes: Axes, at: FloatArray, excess: FloatArray, grid: Grid, top: float, tolerance: float) -> Any:
    """Heat map from scattered points, interpolated linearly, with the contour of the tolerance."""
    # Triangulated in units of the axes' ranges, because metres per second and newtons are not comparable.
    unit = (at - at.min(axis=0)) / np.ptp(at, axis=0)
    mesh = Triangulation(at[:, 0], at[:, 1], Triangulation(unit[:, 0], unit[:, 1]).triangles)
    levels = np.linspace(0.0, top, SHADE_LEVELS)
    image = axes.tricontourf(mesh, np.clip(excess, 0.0, top), levels=levels, cmap=SHADES, antialiased=False)
    if excess.max() > tolerance:
        axes.tricontour(mesh, excess, levels=[tolerance], colors=TOLERANCE, linewidths=1.5)
    nodes = np.array([(v, F) for v in grid.speeds_m_s for F in grid.grips_N])
    axes.plot(nodes[:, 0], nodes[:, 1], **NODE, markersize=4.5, clip_on=False, zorder=3)
    return image


def _curve(axes: Axes, where: FloatArray, excess: FloatArray, grid: Grid, single: int, tolerance: float) -> None:
    """Excess over the axis (0 speed, 1 grip) other than `single`, with nodes and tolerance."""
    order = np.argsort(where)
    axes.grid(color="0.9", linewidth=0.6)
    axes.axhline(tolerance, color=TOLERANCE, linewidth=1.5)
    axes.plot(where[order], excess[order], color="0.15", linewidth=1.4, marker=".", markersize=4)
    nodes = grid.grips_N if single == 0 else grid.speeds_m_s
    axes.plot(nodes, np.zeros(len(nodes)), **NODE, markersize=4.5, clip_on=False, zorder=3)
