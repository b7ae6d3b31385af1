"""What a library is worth off its nodes: a command for one grip played at another, and grids of several spacings."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from transopt.base.plotting import CLIPPED, DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT, colours, style
from transopt.design.refine_grid import Errors, Nodes
from transopt.plant.discretise import StageModel
from transopt.proof.replay import replayed_errors
from transopt.recordings.reference import build_references
from transopt.scene.scene import Scene
from transopt.scene.sections import Drive, LinearParameter
from transopt.scene.strikes import recordings
from transopt.solvers.options import SolverOptions
from transopt.study.figures import percent_axis
from transopt.study.rows import OPTIMAL

MISMATCH_SPEEDS_M_S = (0.2, 0.4)
MISMATCH_GRIPS_N = tuple(float(F) for F in np.arange(1.0, 5.01, 0.5))
BLIND_GRIPS_N = (1.0, 3.0, 5.0)
GRIP_SPACINGS_N = (4.0, 2.0, 1.0, 0.5)
SPEED_SPACINGS_M_S = (0.3, 0.15, 0.1, 0.05, 0.025)
LEAST_EXCESS_PERCENT = 0.01  # shown
FINE = 4  # points looked at in every interval of the finest grid


def errors_of(scene: Scene) -> Errors:
    """Optima, blends and replays at any speed and grip of a scene with simulated recordings."""
    recorded = build_references(recordings(scene), scene.grid.speeds_m_s, scene.time_grid(), scene.recordings)
    return Errors(scene, recorded, SolverOptions())


def soft_hand(scene: Scene) -> Scene:
    """The device of a drive scene in a heavier, softer, less damped hand, whose resonance moves with grip.

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
class Proven:
    """One optimum that a study stands on, and what its certificate says; gaps relative to max(J, 1e-3)."""

    device: str
    speed_m_s: float
    grip_N: float
    status: str
    relative_gap: float
    relative_bound: float
    violation_A: float
    violation_V: float
    violation_K: float


def proven(device: str, errors: Errors) -> list[Proven]:
    """Every optimum that was solved so far."""
    return [
        Proven(
            device,
            *point,
            status.name,
            proof.relative_gap,
            proof.relative_bound,
            proof.violation("A"),
            proof.violation("V"),
            proof.violation("K"),
        )
        for point, (status, proof) in sorted(errors.proofs.items())
    ]


def proven_sentence(optima: Sequence[Proven]) -> str:
    """How many there are, how many are certified, and how well."""
    certified = [one for one in optima if one.status == OPTIMAL]
    worst = max((one.relative_gap for one in certified), default=float("nan"))
    return f"{len(certified)} of {len(optima)} optima certified (rows.csv), worst gap {worst:.0e}"


# ------------------------------------------------------------------------------------------------ grip


@dataclass(frozen=True)
class Played:
    """A certified command for one grip, played at another. excess: over the optimum made for that one."""

    speed_m_s: float
    made_for_N: float
    played_at_N: float
    nrmse: float
    excess: float


def _errors_at(errors: Errors, scene: Scene, stage: StageModel, speed: float, grips: Sequence[float]) -> list[float]:
    commands = np.stack([errors.optimum((speed, F)).command_A for F in grips])
    wanted = np.tile(errors.reference(speed).motor_m_s2, (len(grips), 1))
    return [float(error) for error in replayed_errors(stage, scene.time_grid(), commands, wanted)]


def mismatch(
    scene: Scene,
    speeds_m_s: Sequence[float] = MISMATCH_SPEEDS_M_S,
    grips_N: Sequence[float] = MISMATCH_GRIPS_N,
) -> tuple[list[Played], list[Proven]]:
    """Every grip's command on every grip's device, and the optima that were solved for it.

    Raises
    ------
    InputError : an optimum that cannot be proven.
    """
    errors, found = errors_of(scene), []
    for speed in speeds_m_s:
        for grip in grips_N:
            played = _errors_at(errors, scene, errors.stage(grip), speed, grips_N)
            own = played[grips_N.index(grip)]
            found += [Played(speed, F, grip, e, e - own) for F, e in zip(grips_N, played, strict=True)]
    return found, proven("default", errors)


def mismatch_figure(found: Sequence[Played], blind_N: Sequence[float] = BLIND_GRIPS_N) -> Figure:
    """NRMSE over the grip of the hand: compensated, and blind with a library for one grip."""
    speeds = list(dict.fromkeys(p.speed_m_s for p in found))
    figure = Figure(figsize=(1.0 + 3.1 * len(speeds), 3.5), layout="constrained")
    panels = figure.subplots(1, len(speeds), sharey=True, squeeze=False)[0]
    for axes, speed in zip(panels, speeds, strict=True):
        style(axes)
        own = [p for p in found if p.speed_m_s == speed]
        for grip, colour in zip(blind_N, colours(len(blind_N)), strict=True):
            line = [p for p in own if p.made_for_N == grip]
            axes.plot(
                [p.played_at_N for p in line],
                [100 * p.nrmse for p in line],
                color=colour,
                linewidth=1.2,
                marker="o",
                markersize=2.5,
            )
        best = [p for p in own if p.made_for_N == p.played_at_N]
        axes.plot([p.played_at_N for p in best], [100 * p.nrmse for p in best], color=SEED, linewidth=1.6)
        axes.set_title(f"{speed:g} m/s", fontsize=LABEL_PT)
        axes.set_xlabel("grip of the hand [N]", fontsize=LABEL_PT)
        percent_axis(axes)
    panels[0].set_ylabel("NRMSE [%]", fontsize=LABEL_PT)
    shades = zip(blind_N, colours(len(blind_N)), strict=True)
    handles = [Line2D([], [], color=c, linewidth=1.2, label=f"blind, made for {F:g} N") for F, c in shades]
    handles.append(Line2D([], [], color=SEED, linewidth=1.6, label="made for the grip there is"))
    figure.legend(handles=handles, loc="outside upper center", ncols=2, fontsize=SMALL_PT, frameon=False)
    return figure


def mismatch_sentence(found: Sequence[Played], blind_N: float = 3.0) -> str:
    """The finding."""
    blind = [p for p in found if p.made_for_N == blind_N]
    worst = max(blind, key=lambda p: p.nrmse)
    near = [
        p
        for p in found
        if abs(p.made_for_N - p.played_at_N)
        == min(abs(q.made_for_N - q.played_at_N) for q in found if q.made_for_N != q.played_at_N)
    ]
    return (
        f"A library for {blind_N:g} N alone errs by up to {100 * worst.nrmse:.0f} % at {worst.played_at_N:g} N "
        f"({worst.speed_m_s:g} m/s), where the optimum for that grip errs by "
        f"{100 * (worst.nrmse - worst.excess):.1f} %; a grip misread by "
        f"{abs(near[0].made_for_N - near[0].played_at_N):g} N costs up to "
        f"{100 * max(p.excess for p in near):.1f} percentage points."
    )


# ------------------------------------------------------------------------------------------------ spacing


@dataclass(frozen=True)
class Spaced:
    """Excess of the blend over the optimum between the nodes of one axis, the other axis held.

    axis : "grip" or "speed". spacing : of the nodes [N or m/s]. held : the other coordinate [m/s or N].
    nodes : on that axis. worst, median : over the points between them; the worst one is replayed.
    """

    device: str
    axis: str
    spacing: float
    held: float
    nodes: int
    worst: float
    worst_at: float
    median: float


def _nodes(low: float, high: float, spacing: float) -> tuple[float, ...]:
    count = round((high - low) / spacing)
    return tuple(float(f"{v:.10g}") for v in np.linspace(low, high, count + 1))


def spacing(
    device: str,
    scene: Scene,
    *,
    grip_spacings_N: Sequence[float] = GRIP_SPACINGS_N,
    speed_spacings_m_s: Sequence[float] = SPEED_SPACINGS_M_S,
    held_speeds_m_s: Sequence[float] = MISMATCH_SPEEDS_M_S,
    held_grips_N: Sequence[float] = (1.0, 5.0),
    fine: int = FINE,
) -> tuple[list[Spaced], list[Proven]]:
    """Both axes of one device, and the optima solved. The wider grids are seen at the points of the finest.

    Raises
    ------
    InputError : an optimum that cannot be proven.
    """
    errors, grid, found = errors_of(scene), scene.grid, []
    cases = [
        ("grip", held_speeds_m_s, (grid.grips_N[0], grid.grips_N[-1]), grip_spacings_N),
        ("speed", held_grips_N, (grid.speeds_m_s[0], grid.speeds_m_s[-1]), speed_spacings_m_s),
    ]
    for axis, helds, (low, high), spacings in cases:
        points = _nodes(low, high, min(spacings) / fine)
        for held in helds:
            for width in spacings:
                own = _nodes(low, high, width)
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
    """The device of the scene, and the same in a heavier, softer hand whose resonance moves with grip."""
    usual, usual_optima = spacing("default", scene)
    soft, soft_optima = spacing("soft hand", soft_hand(scene))
    return [*usual, *soft], [*usual_optima, *soft_optima]


def spacing_figure(found: Sequence[Spaced]) -> Figure:
    """Worst excess between the nodes over their spacing, a panel per axis."""
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
    panels[0].set_ylabel("worst excess between the nodes\n[percentage points of NRMSE]", fontsize=LABEL_PT)
    return figure


def spacing_sentence(found: Sequence[Spaced], tolerance: float = 0.02) -> str:
    """The finding: the widest spacing that keeps a tolerance, per axis."""
    parts = []
    for axis, unit in (("grip", "N"), ("speed", "m/s")):
        own = [s for s in found if s.axis == axis]
        widths = sorted({s.spacing for s in own}, reverse=True)
        meets = next((w for w in widths if all(s.worst <= tolerance for s in own if s.spacing == w)), None)
        worst = max((s for s in own if s.spacing == widths[0]), key=lambda s: s.worst)
        kept = f"{meets:g} {unit} keeps" if meets is not None else f"none of {widths[-1]:g} {unit} or wider keeps"
        parts.append(
            f"along the {axis}s {kept} every blend within {100 * tolerance:g} percentage points, {widths[0]:g} "
            f"{unit} costs up to {100 * worst.worst:.1f} ({worst.device}, {worst.worst_at:.3g} {unit})"
        )
    return f"{'; '.join(parts)[0].upper()}{'; '.join(parts)[1:]}."
