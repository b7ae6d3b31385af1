"""Waveforms as a device stores them: a table over (speed, grip), which it blends once at contact."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from controller.waveforms import predecessors
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.problem.baselines import clipped_optimum, seed_inversion
from transopt.problem.warm_coil import currents, norms
from transopt.solvers import unlimited


class Method(Enum):
    """Rendering method of a tap; the value is its name on the command line."""

    BILINEAR = "bilinear"  # the library as it is meant
    ONLINE = "online"  # solved anew for what was measured, see `solved_for`
    NEAREST = "nearest"  # its nearest node
    BLIND = "blind"  # one grip for all, as without a grip sensor
    PROPORTIONAL = "proportional"  # the wall's feedback alone, no transient
    DECAYING_SINUSOID = "decaying-sinusoid"  # Okamura, Dennerlein, Howe 1998; Okamura et al. 2001
    FIXED_WIDTH_PULSE = "fixed-width-pulse"  # Salcudean and Vlaar 1997; Hwang et al. 2004
    MOMENTUM_CANCELLATION = "momentum-cancellation"  # Hwang, Williams, Niemeyer 2004
    SEED_INVERSION = "seed-inversion"  # Fiene et al. 2006, Sec. 6
    CLIPPED_OPTIMUM = "clipped-optimum"  # the unlimited optimum, cut


COOLED = (Method.BILINEAR, Method.NEAREST, Method.BLIND)  # a hot coil gets the library's cool commands with these


@dataclass(frozen=True)
class Bank:
    """A table of transients.

    A device blends the four nodes around a contact. Norms are convex, so the blend of the nodes' norms bounds the
    norm of the blend.

    Attributes
    ----------
    speeds_m_s, grips_N : nodes; one grip where the method knows no grip, which then is never out of grid.
    command_A : (nv, ng, N) transient commands.
    transient_A, feedback_A : [nv][ng] norms sqrt(sum over servo periods of the mean i^2) of the currents.
    grip_min_N : nothing plays below it; 0 for the free device.
    by_grip : whether the method looks at the grip. nearest : take the nearest node instead of a blend.
    cool_command_A : (nv, ng, N) cool commands, with less heat; None where there are none.
    cool_transient_A : [nv][ng] norms of their currents; empty where there are none.
    """

    method: Method
    speeds_m_s: list[float]
    grips_N: list[float]
    command_A: FloatArray
    transient_A: list[list[float]]
    feedback_A: list[list[float]]
    grip_min_N: float
    by_grip: bool
    nearest: bool
    cool_command_A: FloatArray | None = None
    cool_transient_A: list[list[float]] = field(default_factory=list)


def bank(
    library: Library,
    method: Method = Method.BILINEAR,
    *,
    blind_grip_N: float | None = None,
) -> Bank:
    """The table of one method for one library.

    Tables of methods that blend the library's own commands include its cool ones, if it has any; `online` solves for
    the coil's temperature instead.

    Parameters
    ----------
    blind_grip_N : the single grip of `BLIND`; None for the middle of the grid.

    Raises
    ------
    InputError : the blind grip lies outside the grid.
    """
    speeds, grips = library.speeds_m_s, library.grips_N
    solved = library.transient_command
    every = [(iv, ig) for iv in range(speeds.size) for ig in range(grips.size)]

    def nodes(of_node: Callable[[int, int], FloatArray]) -> FloatArray:
        return np.stack([of_node(iv, ig) for iv, ig in every]).reshape(solved.shape)

    by_grip, cool = True, None if library.cool is None else library.cool.transient_command
    if method in (Method.BILINEAR, Method.NEAREST, Method.ONLINE):
        command = solved
    elif method is Method.BLIND:
        middle = float(grips[0] + grips[-1]) / 2 if blind_grip_N is None else blind_grip_N
        if not grips[0] <= middle <= grips[-1]:
            raise InputError(f"blind grip {middle:g} N: the library covers {grips[0]:g} to {grips[-1]:g} N")

        def of_one_grip(of: Library) -> FloatArray:
            return np.stack([of.at(float(v), middle).transient_command for v in speeds])[:, None]

        command = of_one_grip(library)
        cool = None if library.cool is None else of_one_grip(library.cool)
        grips, by_grip = np.array([middle]), False
    elif method is Method.PROPORTIONAL:
        command = solved[:, :1, :0]
        grips, by_grip = grips[:1], False
    elif method in (Method.SEED_INVERSION, Method.CLIPPED_OPTIMUM):
        optimal = method is Method.CLIPPED_OPTIMUM
        command = nodes(lambda iv, ig: _inversion(library, iv, ig, optimal=optimal))
    else:
        # These methods ignore the grip and use one mass, the mean over the grips.
        waveform = {
            Method.DECAYING_SINUSOID: predecessors.decaying_sinusoid,
            Method.FIXED_WIDTH_PULSE: predecessors.fixed_width_pulse,
            Method.MOMENTUM_CANCELLATION: predecessors.momentum_cancellation,
        }[method]
        command = waveform(library, predecessors.inertia(library))[:, None]
        grips, by_grip = grips[:1], False
    amplifier, dt = library.amplifier(), library.dt_s
    transient = norms(currents(command, amplifier, dt), amplifier, dt)
    # Predicted feedback of the wall in addition to the transient, taken from the optimum's motion for every method.
    pushed = norms(currents(library.command - solved, amplifier, dt), amplifier, dt)
    if method not in COOLED or library.cool is None:
        cool = None
    else:
        # One norm serves both transients: the larger one.
        beside = library.cool.command - library.cool.transient_command
        pushed = np.maximum(pushed, norms(currents(beside, amplifier, dt), amplifier, dt))
    feedback = pushed if by_grip else np.max(pushed, axis=1, keepdims=True)
    return Bank(
        method=method,
        speeds_m_s=speeds.tolist(),
        grips_N=grips.tolist(),
        command_A=np.ascontiguousarray(command),
        transient_A=transient.tolist(),
        feedback_A=feedback.tolist(),
        grip_min_N=library.grip_min_N,
        by_grip=by_grip,
        nearest=method is Method.NEAREST,
        cool_command_A=None if cool is None else np.ascontiguousarray(cool),
        cool_transient_A=[] if cool is None else norms(currents(cool, amplifier, dt), amplifier, dt).tolist(),
    )


def _inversion(library: Library, iv: int, ig: int, *, optimal: bool) -> FloatArray:
    """(N,) transient command of one node by clipping the unlimited optimum, or by the seed's inversion.

    A library stores the errors of both, not their commands. The total current is clipped at the library's limit; with
    a wall its predicted feedback is subtracted, as for the optimum.
    """
    problem = library.problem(iv, ig).without_intensity()
    limit = problem.limits.input_limit
    if optimal:
        [free] = unlimited.solve([problem])
        command = clipped_optimum(problem.stage, problem.grid, free.command, limit)
    else:
        command = seed_inversion(
            problem.stage, problem.grid, problem.reference_m_s2, limit, problem.hand_over_samples
        )
    return problem.transient_command(command)


def solved_for(library: Library, table: Bank, speed_m_s: float, grip_N: float) -> Bank:
    """The one transient that is solved for a speed and a grip; the table itself without a certified optimum.

    In a simulation no virtual time passes during the solve. In real time it takes milliseconds, which the end of an
    approach does not leave: it serves between taps, or on a host that predicts the contact.

    Raises
    ------
    InputError : the solver's extension is not built.
    """
    from transopt.library.online import Online  # loads the solver

    tap = Online(library).solve(speed_m_s, grip_N)
    if not tap.solved:
        return table
    wave, amplifier, dt = tap.wave, library.amplifier(), library.dt_s
    parts = np.stack([wave.transient_command, wave.command - wave.transient_command])
    transient, feedback = norms(currents(parts, amplifier, dt), amplifier, dt)
    return replace(
        table,
        speeds_m_s=[wave.speed_m_s],
        grips_N=[wave.grip_N],
        command_A=wave.transient_command[None, None],
        transient_A=[[float(transient)]],
        feedback_A=[[float(feedback)]],
    )
