"""The study `grip_mismatch`: a certified command for one grip, played with another grip."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from transopt.base.plotting import LABEL_PT, SEED, colours, style
from transopt.design.refine_grid import Errors
from transopt.proof.replay import replayed_figures
from transopt.scene.scene import Scene
from transopt.study.figures import legend_above, percent_axis
from transopt.study.optima import Proven, errors_of, proven
from transopt.study.plan import grip_range, two_speeds

GRIPS = 9  # from the least to the greatest one of the scene


@dataclass(frozen=True)
class Played:
    """A certified command for one grip, played at another.

    Attributes
    ----------
    speed_m_s : speed of the tap.
    made_for_N, played_at_N : grip of the command, and grip of the hand.
    tap_error : tap error after replay, as a share of 1.
    excess : that error less the error of the optimum for the hand's grip.
    """

    speed_m_s: float
    made_for_N: float
    played_at_N: float
    tap_error: float
    excess: float


def _errors_at(errors: Errors, grip: float, speed: float, grips: Sequence[float]) -> list[float]:
    """Tap errors at one grip of the transients made for each of `grips`; a wall adds the feedback of this grip."""
    made = [errors.optimum((speed, F)) for F in grips]
    transients = np.stack([each.problem.transient_command(each.solution.command) for each in made])
    own, context = errors.optimum((speed, grip)).problem, errors.context
    walls = [] if own.wall is None else [own.wall] * len(grips)
    wanted = [context.reference(speed, grip).target] * len(grips)
    return [
        each.tap_error for each in replayed_figures(context.stage(grip), context.yardstick, transients, wanted, walls)
    ]


def mismatch(
    scene: Scene, speeds_m_s: Sequence[float] = (), grips_N: Sequence[float] = ()
) -> tuple[list[Played], list[Proven]]:
    """Every grip's command on every grip's device, and the optima solved for this.

    Parameters
    ----------
    speeds_m_s, grips_N : taps and hands; by default `two_speeds`, and nine grips over the range of the scene.

    Raises
    ------
    InputError : the scene has one grip, or an optimum is not certified.
    """
    speeds_m_s = speeds_m_s or two_speeds(scene)
    grips_N = grips_N or np.linspace(*grip_range(scene, "grip_mismatch"), GRIPS).tolist()
    errors, found = errors_of(scene), []
    for speed in speeds_m_s:
        for grip in grips_N:
            played = _errors_at(errors, grip, speed, grips_N)
            own = played[grips_N.index(grip)]
            found += [Played(speed, F, grip, e, e - own) for F, e in zip(grips_N, played, strict=True)]
    return found, proven("default", errors)


def _single(found: Sequence[Played]) -> tuple[float, float, float]:
    """Least, middle and greatest grip [N], those of the libraries for one grip."""
    grips = sorted({p.made_for_N for p in found})
    return grips[0], grips[len(grips) // 2], grips[-1]


def mismatch_figure(found: Sequence[Played]) -> Figure:
    """Tap error over the grip of the hand: compensated, and with libraries for a single grip."""
    speeds, single = list(dict.fromkeys(p.speed_m_s for p in found)), _single(found)
    figure = Figure(figsize=(1.0 + 3.1 * len(speeds), 3.5), layout="constrained")
    panels = figure.subplots(1, len(speeds), sharey=True, squeeze=False)[0]
    for axes, speed in zip(panels, speeds, strict=True):
        style(axes)
        own = [p for p in found if p.speed_m_s == speed]
        for grip, colour in zip(single, colours(len(single)), strict=True):
            line = [p for p in own if p.made_for_N == grip]
            axes.plot(
                [p.played_at_N for p in line],
                [100 * p.tap_error for p in line],
                color=colour,
                linewidth=1.2,
                marker="o",
                markersize=2.5,
            )
        best = [p for p in own if p.made_for_N == p.played_at_N]
        axes.plot([p.played_at_N for p in best], [100 * p.tap_error for p in best], color=SEED, linewidth=1.6)
        axes.set_title(f"{speed:g} m/s", fontsize=LABEL_PT)
        axes.set_xlabel("grip of the hand [N]", fontsize=LABEL_PT)
        percent_axis(axes)
    panels[0].set_ylabel("tap error [%], log scale", fontsize=LABEL_PT)
    shades = zip(single, colours(len(single)), strict=True)
    handles = [Line2D([], [], color=c, linewidth=1.2, label=f"blind, made for {F:g} N") for F, c in shades]
    handles.append(Line2D([], [], color=SEED, linewidth=1.6, label="made for the grip there is"))
    legend_above(figure, handles, 2)
    return figure


def mismatch_sentence(found: Sequence[Played]) -> str:
    """The finding in one sentence."""
    middle_N = _single(found)[1]
    blind = [p for p in found if p.made_for_N == middle_N]
    worst = max(blind, key=lambda p: p.excess)
    near = [
        p
        for p in found
        if abs(p.made_for_N - p.played_at_N)
        == min(abs(q.made_for_N - q.played_at_N) for q in found if q.made_for_N != q.played_at_N)
    ]
    return (
        f"A library for {middle_N:g} N alone errs by up to {100 * worst.tap_error:.0f} % at "
        f"{worst.played_at_N:g} N ({worst.speed_m_s:g} m/s), where the optimum for that grip errs by "
        f"{100 * (worst.tap_error - worst.excess):.1f} %; a grip misread by "
        f"{abs(near[0].made_for_N - near[0].played_at_N):g} N costs up to "
        f"{100 * max(p.excess for p in near):.1f} percentage points."
    )
