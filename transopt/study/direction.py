"""The study `direction`: how an arm trades error along the normal against error across it, beside other methods.

Where the limits of single motors bind, each missing ampere turns the force. An optimum weighs the error along the
normal against the error across it; clipping each motor separately weighs nothing.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from transopt.base.plotting import CLIPPED, LABEL_PT, SEED, colours, style
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.design.context import Context
from transopt.design.optimum import optimum
from transopt.problem.baselines import clipped_optimum, input_bounds, seed_inversion
from transopt.problem.problem import TransientProblem
from transopt.proof.replay import replayed
from transopt.scene.recordings import recordings_of
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions
from transopt.study.figures import legend_above, percent_axis
from transopt.study.optima import Proven

WEIGHTS = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # of the tangential error; the normal error has weight 1
USUAL = 1.0  # tangential weight of the reported findings
LOUD = 0.1  # of the largest force: a smaller force has no meaningful direction
OPTIMUM, CUT, INVERTED = "optimum", "clipped", "inverted"


@dataclass(frozen=True)
class Traded:
    """One command at one place, replayed.

    Attributes
    ----------
    method : "optimum", "clipped" (the unlimited optimum, each motor clipped separately) or "inverted" (the seed's
        method with the response as a matrix, each motor clipped separately).
    tangential : weight of the tangential error; NaN for the other methods.
    speed_m_s, grip_N, normal, posture : the place; the last two as numbers from 1.
    tap_error, felt_error, felt_dB : along the normal. tangential_error : across it, over |r|.
    off_normal_deg : angle by which the tangential error turns the acceleration.
    force_limited_deg, force_limited_90_deg : median and 90th percentile of the angle between the motors' force at the
        tip and that of the unlimited optimum, over the instants at which the latter exceeds a limit; NaN if there are
        none.
    """

    method: str
    tangential: float
    speed_m_s: float
    grip_N: float
    normal: int
    posture: int
    tap_error: float
    felt_error: float
    felt_dB: float
    tangential_error: float
    off_normal_deg: float
    force_limited_deg: float
    force_limited_90_deg: float


@one_blas_thread()
def direction(scene: Scene) -> tuple[list[Traded], list[Proven]]:
    """Every method at the fastest tap and the first grip, for each normal and posture; and the optima solved.

    Raises
    ------
    InputError : the scene's plant is no arm.
    """
    arm, context = scene.arm(), Context.recorded(scene, recordings_of(scene))
    found, proven = list[Traded](), list[Proven]()
    tap = (scene.grid.speeds_m_s[-1], scene.grid.grips_N[0])
    for at in arm.places:
        problem, place = context.posed(*tap, place=at).problem, (*tap, *at)
        _, force_N_A = arm.at_tip(arm.place(*at))
        methods = list(_commands(problem, place, proven))
        free = methods[0][2]
        replays = replayed([problem] * len(methods), np.stack([command for _, _, command in methods]))
        for (method, weight, command), played in list(zip(methods, replays, strict=True))[1:]:
            tangential, angle = problem.yardstick.across(problem.target, played.lasting_m_s2)
            figures = played.figures
            angles = _angles(problem, force_N_A, free, command)
            errors = (figures.tap_error, figures.felt_error, figures.felt_dB, tangential, float(np.degrees(angle)))
            found.append(Traded(method, weight, *place, *errors, *angles))
    return found, proven


def _commands(
    problem: TransientProblem, place: tuple[float, float, int, int], proven: list[Proven]
) -> Iterator[tuple[str, float, FloatArray]]:
    """Method, weight and command (m, N); the unlimited optimum comes first, as the reference for the others."""
    options, limits = SolverOptions(), input_bounds(problem)
    usual = optimum(replace(problem, shares=_shares(problem, USUAL)), options)
    yield "unlimited", USUAL, usual.unlimited_command
    yield CUT, np.nan, clipped_optimum(problem.stage, problem.grid, usual.unlimited_command, limits)
    target, taper = problem.target.window_m_s2, problem.hand_over_samples
    yield INVERTED, np.nan, seed_inversion(problem.stage, problem.grid, target, limits, taper)
    for weight in WEIGHTS:
        designed = optimum(replace(problem, shares=_shares(problem, weight)), options)
        device = f"normal {place[2]}, posture {place[3]}, tangential weight {weight:g}"
        proven.append(Proven.of(device, place[:2], designed.solution.status, designed.certificate))
        yield OPTIMUM, weight, designed.solution.command


def _shares(problem: TransientProblem, tangential: float) -> FloatArray:
    return np.array([1.0, *[tangential] * (problem.stage.tracked - 1)])


def _angles(
    problem: TransientProblem, force_N_A: FloatArray, free: FloatArray, command: FloatArray
) -> tuple[float, float]:
    """Median and 90th percentile of the angle between both forces where the free command exceeds a limit [deg]."""
    wanted, played = (problem.stage.rollout(each)[1] for each in (free, command))
    beyond = (np.abs(wanted) > input_bounds(problem)).any(axis=0)
    forces = [force_N_A @ each for each in (wanted, played)]
    sizes = [np.linalg.norm(each, axis=0) for each in forces]
    loud = (sizes[0] > LOUD * sizes[0].max()) & (sizes[1] > 0)
    cosine = np.sum(forces[0] * forces[1], axis=0) / np.maximum(sizes[0] * sizes[1], np.finfo(float).tiny)
    angles = np.degrees(np.arccos(np.clip(cosine, -1, 1)))[loud & beyond]
    if not angles.size:
        return float("nan"), float("nan")
    return float(np.percentile(angles, 50)), float(np.percentile(angles, 90))


def direction_figure(found: Sequence[Traded]) -> Figure:
    """Error along the normal over error across it, one curve per place."""
    places = list(dict.fromkeys((t.normal, t.posture) for t in found))
    figure = Figure(figsize=(5.4, 4.2), layout="constrained")
    axes = figure.subplots()
    style(axes)
    for place, colour in zip(places, colours(len(places)), strict=True):
        own = [t for t in found if (t.normal, t.posture) == place]
        curve = [t for t in own if t.method == OPTIMUM]
        axes.plot(
            [100 * t.tangential_error for t in curve],
            [100 * t.tap_error for t in curve],
            color=colour,
            marker="o",
            markersize=2.5,
            linewidth=1.2,
        )
        for method, mark in ((CUT, "s"), (INVERTED, "^")):
            for t in (each for each in own if each.method == method):
                axes.plot(100 * t.tangential_error, 100 * t.tap_error, mark, color=colour, markersize=5)
    percent_axis(axes)
    axes.set_xlabel("acceleration across the normal [% of the tap]", fontsize=LABEL_PT)
    axes.set_ylabel("tap error along the normal [%]", fontsize=LABEL_PT)
    shades = zip(places, colours(len(places)), strict=True)
    handles = [Line2D([], [], color=c, label=f"normal {o}, posture {q}") for (o, q), c in shades]
    handles += [
        Line2D([], [], color=CLIPPED, marker="s", linestyle="", label="clipped"),
        Line2D([], [], color=SEED, marker="^", linestyle="", label="inverted"),
    ]
    legend_above(figure, handles, 3)
    return figure


def direction_sentence(found: Sequence[Traded]) -> str:
    """The finding in a few sentences."""
    rows = []
    for place in dict.fromkeys((t.normal, t.posture) for t in found):
        own = [t for t in found if (t.normal, t.posture) == place]
        curve = {t.tangential: t for t in own if t.method == OPTIMUM}
        clipped = next(t for t in own if t.method == CUT)
        compared = (clipped, curve[USUAL], curve[WEIGHTS[0]])
        alike = [_at(list(curve.values()), clipped.tangential_error, name) for name in ("tap_error", "felt_error")]
        rows.append([[t.tap_error, t.felt_error, t.tangential_error] for t in compared] + [[*alike, np.nan]])
    cut, best, free, alike = 100 * np.mean(rows, axis=0)
    turned = np.nanmean([t.force_limited_deg for t in found if t.method == CUT])
    return (
        f"At {found[0].speed_m_s:g} m/s, in the mean over the places, clipping every motor alone leaves {cut[2]:.1f} "
        f"% across the normal and turns the force by {turned:.0f} degrees where limits bind, with a tap error of "
        f"{cut[0]:.1f} % and a felt error of {cut[1]:.1f} %. At the same size across, the optimum has {alike[0]:.1f} "
        f"and {alike[1]:.1f} %; with tangential weight {USUAL:g} {best[0]:.1f} and {best[1]:.1f} % at {best[2]:.1f} "
        f"% across, and free across {free[0]:.1f} and {free[1]:.1f} % at {free[2]:.0f} %."
    )


def _at(curve: Sequence[Traded], tangential_error: float, name: str) -> float:
    """A figure of the optima at this tangential error, interpolated linearly."""
    points = sorted((t.tangential_error, getattr(t, name)) for t in curve)
    return float(np.interp(tangential_error, *np.transpose(points)))
