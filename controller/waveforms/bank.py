"""Waveforms as the servo plays them: a table over (speed, grip), blended once at contact."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy import signal

from controller.waveforms import predecessors
from controller.waveforms.inversions import inversion
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.plant.amplifier import Amplifier
from transopt.problem.heat import heating


class Method(Enum):
    """How a tap is rendered; the value is its name on a command line."""

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


@dataclass(frozen=True, slots=True)
class Play:
    """What is played at one contact.

    Attributes
    ----------
    samples_A : transient commands, one per servo period; empty if this method has none.
    speed_m_s, grip_N : where it was taken from, after clamping to the grid.
    out_of_grid : whether the wanted point lay outside.
    silent : nothing may be played, for want of speed or grip.
    transient_A, feedback_A : bounds on the norms of the currents, as `Guard.scale` takes them.
    """

    samples_A: list[float]
    speed_m_s: float
    grip_N: float
    out_of_grid: bool
    silent: bool
    transient_A: float
    feedback_A: float


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

    A blend weighs the four corners in a stated order with products and sums only, so that firmware that does the
    same gets the same bits. Norms are convex, so the corners' bound the blend's.

    Attributes
    ----------
    speeds_m_s, grips_N : nodes; one grip where the method knows no grip, which then is never out of grid.
    command_A : (nv, ng, N) transient commands.
    transient_A, feedback_A : [nv][ng] norms sqrt(sum over servo periods of the mean i^2) of the currents.
    grip_min_N : nothing plays below it; 0 for the free device.
    by_grip : whether the method looks at the grip. nearest : take the nearest node instead of a blend.
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

        c, t, f = self.command_A, self.transient_A, self.feedback_A
        samples = w[0] * c[iv, ig] + w[1] * c[iv, jg] + w[2] * c[jv, ig] + w[3] * c[jv, jg]
        return Play(
            samples_A=samples.tolist(),
            speed_m_s=(1.0 - y) * self.speeds_m_s[iv] + y * self.speeds_m_s[jv],
            grip_N=(1.0 - x) * self.grips_N[ig] + x * self.grips_N[jg],
            out_of_grid=fast or (odd and self.by_grip),
            silent=False,
            transient_A=blend(t[iv][ig], t[iv][jg], t[jv][ig], t[jv][jg]),
            feedback_A=blend(f[iv][ig], f[iv][jg], f[jv][ig], f[jv][jg]),
        )


def currents(command_A: FloatArray, amplifier: Amplifier | None, dt_s: float) -> FloatArray:
    """(..., N + 1) current at the switching instants from rest, and after the last servo period."""
    if amplifier is None:
        return np.concatenate([command_A, np.zeros((*command_A.shape[:-1], 1))], axis=-1)
    decay = float(np.exp(-amplifier.rate_rad_s * dt_s))
    after = signal.lfilter([1 - decay], [1.0, -decay], command_A, axis=-1)
    return np.concatenate([np.zeros((*command_A.shape[:-1], 1)), after], axis=-1)


def norms(current_A: FloatArray, amplifier: Amplifier | None, dt_s: float) -> FloatArray:
    """(...) sqrt(sum of the mean i^2 of each servo period) for currents (..., N + 1) at the switching instants."""
    if amplifier is None:
        return np.asarray(np.linalg.norm(current_A, axis=-1))
    first, cross, last = heating(amplifier, dt_s).square
    a, b = current_A[..., :-1], current_A[..., 1:]
    return np.asarray(np.sqrt(np.sum(first * a * a + cross * a * b + last * b * b, axis=-1)))


def bank(
    library: Library,
    method: Method = Method.BILINEAR,
    *,
    blind_grip_N: float | None = None,
) -> Bank:
    """The table of one method for one library.

    Parameters
    ----------
    blind_grip_N : the one grip of `BLIND`; the middle of the grid without it.

    Raises
    ------
    InputError : the blind grip lies outside the grid.
    """
    speeds, grips = library.speeds_m_s, library.grips_N
    solved = library.transient_command
    every = [(iv, ig) for iv in range(speeds.size) for ig in range(grips.size)]

    def nodes(of_node: Callable[[int, int], FloatArray]) -> FloatArray:
        return np.stack([of_node(iv, ig) for iv, ig in every]).reshape(solved.shape)

    by_grip = True
    if method in (Method.BILINEAR, Method.NEAREST, Method.ONLINE):
        command = solved
    elif method is Method.BLIND:
        middle = float(grips[0] + grips[-1]) / 2 if blind_grip_N is None else blind_grip_N
        if not grips[0] <= middle <= grips[-1]:
            raise InputError(f"blind grip {middle:g} N: the library covers {grips[0]:g} to {grips[-1]:g} N")
        command = np.stack([library.at(float(v), middle).transient_command for v in speeds])[:, None]
        grips, by_grip = np.array([middle]), False
    elif method is Method.PROPORTIONAL:
        command = solved[:, :1, :0]
        grips, by_grip = grips[:1], False
    elif method in (Method.SEED_INVERSION, Method.CLIPPED_OPTIMUM):
        optimal = method is Method.CLIPPED_OPTIMUM
        command = nodes(lambda iv, ig: inversion(library, iv, ig, optimal=optimal))
    else:
        # They know no grip: one mass, that of the grips' mean.
        waveform = {
            Method.DECAYING_SINUSOID: predecessors.decaying_sinusoid,
            Method.FIXED_WIDTH_PULSE: predecessors.fixed_width_pulse,
            Method.MOMENTUM_CANCELLATION: predecessors.momentum_cancellation,
        }[method]
        command = waveform(library, predecessors.inertia(library))[:, None]
        grips, by_grip = grips[:1], False
    amplifier, dt = library.amplifier(), library.dt_s
    transient = norms(currents(command, amplifier, dt), amplifier, dt)
    # What the wall is predicted to add beside the transient; of the optimum's motion, for every method.
    pushed = norms(currents(library.command - solved, amplifier, dt), amplifier, dt)
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
    )
