"""The transient that a device plays on a warm coil: a blend of a tap's two commands, as the servo decides it."""

from dataclasses import dataclass, replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.base.writing import percent
from transopt.design.context import Posed
from transopt.design.design import design
from transopt.design.entry import Entry
from transopt.plant.coil import CoilModel
from transopt.problem.objective.figures import Figures
from transopt.problem.wall_ticks import rendered
from transopt.problem.warm_coil import WarmCoil, currents, norms
from transopt.solvers.options import SolverOptions


@dataclass(frozen=True)
class Warm:
    """One tap on a warm coil.

    Attributes
    ----------
    words : description of what is played.
    scale : scale of the blend; 0 if no transient is played.
    cooled : share of the cool command in the blend.
    figures : comparison with the recorded tap; None if the cool command is needed and not certified.
    heat_A2_ms : integral of the squared current over the window.
    """

    words: str
    scale: float
    cooled: float
    figures: Figures | None
    heat_A2_ms: float


def on_warm_coil(
    posed: Posed, first: Entry, coil: CoilModel, winding_C: float, share: float, options: SolverOptions
) -> tuple[Warm, FloatArray, FloatArray]:
    """A tap at a winding temperature, with a housing that is not warmer; also (N + M,) y'' and (N + M,) current.

    The cool command is solved only if the coil cannot take the first command.

    Parameters
    ----------
    posed, first : the tap and its certified first command.
    coil : the coil's model of the servo's estimate.
    share : heat of the cool command, at most this share of the first one's.
    """
    problem = first.problem
    amplifier, dt_s, ticks = problem.stage.amplifier, problem.grid.dt_s, problem.grid.stages + 1
    room = WarmCoil.of(coil, dt_s)

    def size(command: FloatArray) -> float:
        return float(norms(currents(command, amplifier, dt_s), amplifier, dt_s))

    def beside(entry: Entry) -> float:
        return size(entry.solution.command - entry.transient_command)

    transient, transient_A, feedback_A = first.transient_command, size(first.transient_command), beside(first)
    scale, cooled = room.allowed(winding_C, winding_C, transient_A, np.inf, feedback_A, ticks)
    if scale < 1.0:
        (second,) = design([replace(posed, warmer=first.designed, cool_share=share)], options=options)
        if not second.certificate.accepted:
            unknown = np.full(problem.grid.stages + problem.grid.after_stages, np.nan)
            words = f"its cool command is not certified: {second.solution.status.value}"
            return Warm(words, np.nan, np.nan, None, np.nan), unknown, unknown
        cool = second.transient_command
        feedback_A = max(feedback_A, beside(second))
        scale, cooled = room.allowed(winding_C, winding_C, transient_A, size(cool), feedback_A, ticks)
        transient = scale * ((1 - cooled) * transient + cooled * cool)
    acceleration, current = problem.stage.rollout(rendered(problem, transient))
    window_A = current[: problem.grid.stages]
    heat_A2_ms = 1e3 * dt_s * float(window_A @ window_A)
    return (
        Warm(_words(scale, cooled), scale, cooled, problem.figures(acceleration), heat_A2_ms),
        acceleration,
        current,
    )


def _words(scale: float, cooled: float) -> str:
    """What is played, in words: the whole command, a blend, a scaled command, or nothing."""
    if scale <= 0:
        return "no transient"
    of = "the first command" if cooled <= 0 else "the cool command"
    if 0 < cooled < 1:
        return f"{percent(1 - cooled)} % of the first command and {percent(cooled)} % of the cool command"
    return of if scale >= 1 else f"{of}, scaled to {percent(scale)} %"
