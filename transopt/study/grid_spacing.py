"""The study `grid_spacing`: excess of blends between a library's nodes over the optimum, by node spacing."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from transopt.base.errors import InputError
from transopt.base.plotting import CLIPPED, DARK, LABEL_PT, OPTIMUM, SEED, style
from transopt.design.nodes import Nodes
from transopt.plant.drive import Drive
from transopt.plant.hand import LinearParameter
from transopt.scene.scene import Scene
from transopt.study.figures import percent_axis
from transopt.study.optima import Proven, errors_of, proven
from transopt.study.plan import grip_range, two_speeds

GRIP_PARTS, SPEED_PARTS = (1, 2, 4, 8), (1, 2, 3, 6, 12)  # equal intervals of the scene's range
LEAST_EXCESS_PERCENT = 0.01  # smallest excess shown
FINE = 4  # points per interval of the finest grid
CLOSE = 0.02  # excess of tap error; the finding names the widest spacing that stays below it


def soft_hand(scene: Scene) -> Scene:
    """The device of a drive scene in a heavier, softer, less damped hand, whose resonance depends on grip.

    50 g on a skin of 200 + 1800 F [N/m]: from 46 Hz at 1 N to 97 Hz at 5 N, inside the band of a tap, damping
    ratio 0.19.
    """
    assert isinstance(scene.model, Drive)
    change = {
        "mass_kg": 0.05,
        "skin_stiffness_N_m": LinearParameter(constant=200, per_newton=1800),
        "skin_damping_N_s_m": LinearParameter(constant=0.5, per_newton=0.2),
    }
    hand = scene.model.hand.model_copy(update=change)
    return scene.model_copy(update={"model": scene.model.model_copy(update={"hand": hand})})


@dataclass(frozen=True)
class Spaced:
    """Excess of the blend over the optimum between the nodes of one axis, the other axis held.

    device : its name.
    axis : "grip" or "speed".
    spacing : spacing of the nodes on that axis [N or m/s].
    held : value on the other axis [m/s or N].
    nodes : number of nodes on that axis.
    worst, median : excess of tap error over the points between the nodes; the worst one is replayed.
    worst_at : position of the worst point on the axis [N or m/s].
    """

    device: str
    axis: str
    spacing: float
    held: float
    nodes: int
    worst: float
    worst_at: float
    median: float


def _nodes(low: float, high: float, count: int) -> tuple[float, ...]:
    return tuple(float(f"{v:.10g}") for v in np.linspace(low, high, count + 1))


def spacing(
    device: str,
    scene: Scene,
    *,
    grip_parts: Sequence[int] = GRIP_PARTS,
    speed_parts: Sequence[int] = SPEED_PARTS,
    held_speeds_m_s: Sequence[float] = (),
    held_grips_N: Sequence[float] = (),
    fine: int = FINE,
) -> tuple[list[Spaced], list[Proven]]:
    """Both axes of one device, and the optima solved. All grids are compared at the points of the finest one.

    Parameters
    ----------
    grip_parts, speed_parts : numbers of equal intervals between the nodes; each divides the last.
    held_speeds_m_s, held_grips_N : values on the other axis; by default `two_speeds`, and least and greatest grip.
    fine : points per interval of the finest grid.

    Raises
    ------
    InputError : the scene has one grip or one speed, or an optimum is not certified.
    """
    grips, speeds = grip_range(scene, "grid_spacing"), scene.axes.speeds_m_s
    if len(speeds) < 2:
        raise InputError(f"--study grid_spacing: {scene.name} has one speed: state two or more in grid.speeds_m_s")
    errors, found = errors_of(scene), []
    cases = [
        ("grip", held_speeds_m_s or two_speeds(scene), grips, grip_parts),
        ("speed", held_grips_N or grips, (speeds[0], speeds[-1]), speed_parts),
    ]
    for axis, helds, (low, high), parts in cases:
        points = _nodes(low, high, parts[-1] * fine)
        for held in helds:
            for count in parts:
                own, width = _nodes(low, high, count), float(f"{(high - low) / count:.10g}")
                between = [x for x in points if x not in own]
                if axis == "grip":
                    nodes, at = Nodes((held,), own), [(held, F) for F in between]
                else:
                    nodes, at = Nodes(own, (held,)), [(v, held) for v in between]
                excess = errors.excess(nodes, at)
                worst = max(excess, key=lambda point: excess[point])
                [replayed] = errors.replayed([worst], nodes, nodes)
                place = worst[1] if axis == "grip" else worst[0]
                middle = float(np.median(list(excess.values())))
                found.append(Spaced(device, axis, width, held, len(own), replayed.excess_after, place, middle))
    return found, proven(device, errors)


def spacing_study(scene: Scene) -> tuple[list[Spaced], list[Proven]]:
    """The scene's device, and a drive also in a heavier, softer hand whose resonance depends on grip."""
    usual, usual_optima = spacing("default", scene)
    if not isinstance(scene.model, Drive):
        return usual, usual_optima
    soft, soft_optima = spacing("soft hand", soft_hand(scene))
    return [*usual, *soft], [*usual_optima, *soft_optima]


def spacing_figure(found: Sequence[Spaced]) -> Figure:
    """Worst excess between the nodes over their spacing, one panel per axis."""
    devices = list(dict.fromkeys(s.device for s in found))
    shade = dict(zip(devices, (OPTIMUM, SEED, CLIPPED), strict=False))
    figure = Figure(figsize=(7.2, 3.6), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for axes, axis, unit, other in zip(panels, ("grip", "speed"), ("N", "m/s"), ("m/s", "N"), strict=True):
        style(axes)
        helds = list(dict.fromkeys(s.held for s in found if s.axis == axis))
        for device in devices:
            for held, dash in zip(helds, ("-", "--", ":"), strict=False):
                own = [s for s in found if (s.device, s.axis, s.held) == (device, axis, held)]
                options: dict[str, Any] = {
                    "color": shade[device],
                    "linestyle": dash,
                    "marker": "o",
                    "markersize": 3.5,
                }
                label = f"{device}, {held:g} {other}"
                axes.plot(
                    [s.spacing for s in own], [100 * s.worst for s in own], linewidth=1.2, label=label, **options
                )
        axes.axhline(2.0, color=DARK, linewidth=0.8, linestyle=":")
        percent_axis(axes, x=True)
        axes.set_xlabel(f"spacing of the {axis} nodes [{unit}]", fontsize=LABEL_PT)
        percent_axis(axes)
        axes.set_ylim(bottom=LEAST_EXCESS_PERCENT)
        axes.legend(fontsize=6.5, frameon=False)
    panels[0].set_ylabel("worst excess between the nodes\n[percentage points of tap error]", fontsize=LABEL_PT)
    return figure


def spacing_sentence(found: Sequence[Spaced]) -> str:
    """The finding: the widest spacing within the tolerance, per axis."""
    parts = []
    for axis, unit in (("grip", "N"), ("speed", "m/s")):
        own = [s for s in found if s.axis == axis]
        widths = sorted({s.spacing for s in own}, reverse=True)
        meets = next((w for w in widths if all(s.worst <= CLOSE for s in own if s.spacing == w)), None)
        worst = max((s for s in own if s.spacing == widths[0]), key=lambda s: s.worst)
        kept = f"{meets:g} {unit} keeps" if meets is not None else f"none of {widths[-1]:g} {unit} or wider keeps"
        parts.append(
            f"along the {axis}s {kept} every blend within {100 * CLOSE:g} percentage points, {widths[0]:g} "
            f"{unit} costs up to {100 * worst.worst:.1f} ({worst.device}, {worst.worst_at:.3g} {unit})"
        )
    return f"{'; '.join(parts)[0].upper()}{'; '.join(parts)[1:]}."
