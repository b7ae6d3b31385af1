"""Waveforms as the servo plays them: a table over (speed, grip), blended once at contact."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from controller.waveforms import predecessors
from controller.waveforms.inversions import inversion
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.problem.warm_coil import currents, norms


class Method(Enum):
    """Rendering method of a tap; the value is its name on the command line."""

    BILINEAR = "bilinear"  # the library as it is meant
    ONLINE = "online"  # solved anew for what was measured, see `controller.waveforms.online_bank`
    NEAREST = "nearest"  # its nearest node
    BLIND = "blind"  # one grip for all, as without a grip sensor
    PROPORTIONAL = "proportional"  # the wall's feedback alone, no transient
    DECAYING_SINUSOID = "decaying-sinusoid"  # Okamura, Dennerlein, Howe 1998; Okamura et al. 2001
    FIXED_WIDTH_PULSE = "fixed-width-pulse"  # Salcudean and Vlaar 1997; Hwang et al. 2004
    MOMENTUM_CANCELLATION = "momentum-cancellation"  # Hwang, Williams, Niemeyer 2004
    SEED_INVERSION = "seed-inversion"  # Fiene et al. 2006, Sec. 6
    CLIPPED_OPTIMUM = "clipped-optimum"  # the unlimited optimum, cut


COOLED = (Method.BILINEAR, Method.NEAREST, Method.BLIND)  # a hot coil gets the library's cool commands with these


@dataclass(frozen=True, slots=True)
class Play:
    """The transient of one contact.

    Attributes
    ----------
    samples_A : transient commands, one per servo period; empty if this method has none.
    speed_m_s, grip_N : point of the grid it was taken from, after clipping to the grid.
    out_of_grid : whether the requested point lay outside the grid.
    silent : whether nothing may be played, for lack of speed or grip.
    transient_A, feedback_A : bounds on the norms of the currents, as `Guard.allowed` takes them.
    cool_samples_A : the cool command, of less heat, as long as the first; empty where the table has none.
    cool_transient_A : bound on the norm of its current; infinite where the table has none.
    """

    samples_A: list[float]
    speed_m_s: float
    grip_N: float
    out_of_grid: bool
    silent: bool
    transient_A: float
    feedback_A: float
    cool_samples_A: list[float] = field(default_factory=list)
    cool_transient_A: float = math.inf

    def blended(self, cooled: float) -> list[float]:
        """The samples with a part `cooled` (0 to 1) of the cool command and the rest of the first [A]."""
        if not cooled > 0.0:
            return self.samples_A
        first = 1.0 - cooled
        return [first * warm + cooled * cool for warm, cool in zip(self.samples_A, self.cool_samples_A, strict=True)]


def _interval(nodes: list[float], value: float, nearest: bool) -> tuple[int, float, bool]:
    """Interval of increasing nodes that `value` lies in, its place there (0..1), and whether it lay outside."""
    j = 0
    while j + 2 < len(nodes) and value >= nodes[j + 1]:
        j += 1
    if len(nodes) == 1:
        return 0, 0.0, value != nodes[0]
    place = (value - nodes[j]) / (nodes[j + 1] - nodes[j])
    clamped = 0.0 if place < 0.0 else min(place, 1.0)
    if nearest:
        return j, 0.0 if clamped < 0.5 else 1.0, clamped != place
    return j, clamped, clamped != place


@dataclass(frozen=True)
class Bank:
    """A table of transients.

    A blend weights the four corners in a fixed order with products and sums only, so that the firmware computes the
    same bits. Norms are convex, so the blend of the corners' norms bounds the norm of the blend.

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

    def at(
        self, speed_m_s: float, grip_N: float, winding_C: float | None = None, housing_C: float | None = None
    ) -> Play:
        """The transient for a contact; outside the grid its edge is taken, and NaN plays nothing.

        A table knows no temperature: those given are for a bank that solves.
        """
        silent = not (speed_m_s > 0.0 and grip_N >= self.grip_min_N)
        if silent:
            return Play([], speed_m_s, grip_N, False, True, 0.0, 0.0)
        iv, y, fast = _interval(self.speeds_m_s, speed_m_s, self.nearest)
        ig, x, odd = _interval(self.grips_N, grip_N, self.nearest)
        jv, jg = min(iv + 1, len(self.speeds_m_s) - 1), min(ig + 1, len(self.grips_N) - 1)
        w = ((1.0 - y) * (1.0 - x), (1.0 - y) * x, y * (1.0 - x), y * x)

        def blend(a: float, b: float, c: float, d: float) -> float:
            return w[0] * a + w[1] * b + w[2] * c + w[3] * d

        def norm(of: list[list[float]]) -> float:
            return blend(of[iv][ig], of[iv][jg], of[jv][ig], of[jv][jg])

        def samples(c: FloatArray) -> list[float]:
            mixed = w[0] * c[iv, ig] + w[1] * c[iv, jg] + w[2] * c[jv, ig] + w[3] * c[jv, jg]
            return list(mixed.tolist())

        cool = self.cool_command_A
        return Play(
            samples_A=samples(self.command_A),
            speed_m_s=(1.0 - y) * self.speeds_m_s[iv] + y * self.speeds_m_s[jv],
            grip_N=(1.0 - x) * self.grips_N[ig] + x * self.grips_N[jg],
            out_of_grid=fast or (odd and self.by_grip),
            silent=False,
            transient_A=norm(self.transient_A),
            feedback_A=norm(self.feedback_A),
            cool_samples_A=[] if cool is None else samples(cool),
            cool_transient_A=math.inf if cool is None else norm(self.cool_transient_A),
        )


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
        command = nodes(lambda iv, ig: inversion(library, iv, ig, optimal=optimal))
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
