"""What a device plays on a warm coil: a blend of a tap's two commands, as its servo decides at the contact."""

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
    words : what is played.
    scale : of the blend; 0 where no transient is played.
    cooled : part of the cool command in the blend.
    figures : how near it comes to the recorded tap; None where the cool command is needed and not certified.
    heat_A2_ms : integral of the squared current.
    """

    words: str
    scale: float
    cooled: float
    figures: Figures | None
    heat_A2_ms: float


def on_warm_coil(
    posed: Posed, first: Entry, coil: CoilModel, winding_C: float, share: float, options: SolverOptions
) -> tuple[Warm, FloatArray, FloatArray]:
    """A tap on a winding of some temperature, whose housing is no warmer; with it (N + M,) y'' and (N + M,) current.

    The cool command is solved only where the coil cannot take the first.

    Parameters
    ----------
    posed, first : the tap and its certified first command. coil : as the servo estimates it.
    share : of the first command's heat that the cool one may make.
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
            said = f"its cool command is not certified: {second.solution.status.value}"
            return Warm(said, np.nan, np.nan, None, np.nan), unknown, unknown
        cool = second.transient_command
        feedback_A = max(feedback_A, beside(second))
        scale, cooled = room.allowed(winding_C, winding_C, transient_A, size(cool), feedback_A, ticks)
        transient = scale * ((1 - cooled) * transient + cooled * cool)
    acceleration, current = problem.stage.rollout(rendered(problem, transient))
    heat_A2_ms = 1e3 * dt_s * float(current @ current)
    return (
        Warm(_words(scale, cooled), scale, cooled, problem.figures(acceleration), heat_A2_ms),
        acceleration,
        current,
    )


def _words(scale: float, cooled: float) -> str:
    """What is played: whole, a blend, a scaled command, or nothing."""
    if scale <= 0:
        return "no transient"
    of = "the first command" if cooled <= 0 else "the cool command"
    if 0 < cooled < 1:
        return f"{percent(1 - cooled)} % of the first command and {percent(cooled)} % of the cool command"
    return of if scale >= 1 else f"{of}, scaled to {percent(scale)} %"
