"""The virtual wall: feedback from the encoder at the servo ticks (seed Eq. 9).

The currents of wall and transient add up. The variable of the optimal-control problem is the total command, so the
wall enters it only at the end of the horizon, where the transient has to be zero and the total command equals the
feedback. With the signs of this package Eq. 9 reads i_tr = y'' / G + (K_p z + K_d dz/dt) / k_f while z < 0; the seed
counts the current with the opposite sign.
"""

from dataclasses import dataclass

import numpy as np

from transopt.base import recursions
from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import BoolArray, FloatArray, integral
from transopt.plant.amplifier import Amplifier, prefilter, prefilter_coefficients
from transopt.plant.time_grid import TimeGrid

MAX_FEEDBACK_A = 1e100  # clips the current of an unstable wall, so that squares of its motion do not overflow


def earlier_by(ticks: int, values: FloatArray) -> FloatArray:
    """(N,) values advanced by `ticks`, followed by zeros: the transpose of a delay, which may exceed N."""
    kept = values[ticks:]
    return np.append(kept, np.zeros(values.size - kept.size))


@dataclass(frozen=True)
class Wall:
    """Spring and damper that act while the encoder is below the surface, and only push.

    i_fb = max(0, -(K_p z + K_d dz/dt) / k_f) while z < 0, z read `latency_ticks` ago, dz/dt by the filtered
    difference v_k = a v_(k-1) + (1 - a) (z_k - z_(k-1)) / dt, a = exp(-2 pi f dt).

    Attributes
    ----------
    stiffness_N_m : K_p >= 0.
    damping_N_s_m : K_d >= 0.
    force_per_current_N_A : k_f > 0.
    latency_ticks : whole ticks from an encoder reading to the command that responds to it, >= 0.
    derivative_filter_Hz : f > 0.

    Raises
    ------
    InputError : one of them is out of its range.
    """

    stiffness_N_m: float
    damping_N_s_m: float
    force_per_current_N_A: float
    latency_ticks: int
    derivative_filter_Hz: float

    def __post_init__(self) -> None:
        for name in ("stiffness_N_m", "damping_N_s_m"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(f"feedback: {name} = {getattr(self, name):g}: must be >= 0 and finite")
        if not (self.force_per_current_N_A > 0 and self.derivative_filter_Hz > 0 and self.latency_ticks >= 0):
            raise InputError(
                "feedback: force_per_current_N_A and derivative_filter_Hz must be > 0, latency_ticks must be >= 0"
            )

    def smoothing(self, dt_s: float) -> float:
        """Coefficient a of the derivative filter."""
        return float(np.exp(-2 * np.pi * self.derivative_filter_Hz * dt_s))

    @staticmethod
    def _filtered(values: FloatArray, a: float) -> FloatArray:
        """(..., N) output of the derivative filter with coefficient a, from rest."""
        recursion, courses = recursions.Recursion(np.array([[a]])), (1 - a) * values.reshape(-1, values.shape[-1], 1)
        return np.stack([recursion.run(course) for course in courses]).reshape(values.shape)

    def measured(self, encoder_m: FloatArray, dt_s: float, approach_m_s: float) -> tuple[FloatArray, FloatArray]:
        """Position [m] and filtered velocity [m/s] that enter the law at each tick, (..., N) each.

        Before the first tick the stylus moved at the constant speed `approach_m_s`, on which the filter has settled.

        Parameters
        ----------
        encoder_m : (..., N) readings at the ticks.
        """
        late = self.latency_ticks
        steps = np.arange(late + 1, 0, -1)
        earlier = encoder_m[..., :1] + approach_m_s * dt_s * steps
        z = np.concatenate([earlier, encoder_m], axis=-1)
        a = self.smoothing(dt_s)
        # Relative to the approach the filter starts from rest.
        difference = np.diff(z, axis=-1) / dt_s + approach_m_s
        velocity = self._filtered(difference, a) - approach_m_s
        N = encoder_m.shape[-1]
        return z[..., 1 : N + 1], velocity[..., :N]

    def wanted(self, position_m: FloatArray, velocity_m_s: FloatArray) -> FloatArray:
        """The law without clipping: -(K_p z + K_d v) / k_f [A]."""
        force = self.stiffness_N_m * position_m + self.damping_N_s_m * velocity_m_s
        return np.asarray(-force / self.force_per_current_N_A)

    def current(self, position_m: FloatArray, velocity_m_s: FloatArray) -> FloatArray:
        """i_fb [A] for a measured position and velocity: >= 0 below the surface, zero above it.

        The current of an unstable wall grows at every tick. It is clipped at `MAX_FEEDBACK_A`, so that a simulation
        of such a wall, which is then refused with its name, does not overflow.
        """
        pushed = np.clip(self.wanted(position_m, velocity_m_s), 0.0, MAX_FEEDBACK_A)
        return np.asarray(np.where(position_m < 0, pushed, 0.0))

    def linear(self, deviation_m: FloatArray, dt_s: float) -> FloatArray:
        """(..., N) change of `wanted` for a deviation of the encoder readings that starts at zero."""
        position, velocity = self.measured(deviation_m, dt_s, 0.0)
        return self.wanted(position, velocity)

    def linear_transpose(self, by_wanted: FloatArray, dt_s: float) -> FloatArray:
        """(N,) gradient by the encoder readings for a gradient by `wanted`; the transpose of `linear`."""
        g = earlier_by(self.latency_ticks, by_wanted) / -self.force_per_current_N_A
        a = self.smoothing(dt_s)
        filtered = self._filtered(g[::-1], a)[::-1] / dt_s
        difference = filtered - np.append(filtered[1:], 0.0)
        return np.asarray(self.stiffness_N_m * g + self.damping_N_s_m * difference)


@dataclass(frozen=True)
class HandOver:
    """The wall during one tap: from the hand-over on the total command equals its feedback.

    Attributes
    ----------
    wall : the wall's law.
    nominal_m : (N + M,) z_nom at the ticks t_k of window and tail; methods for K ticks use the first K.
    approach_m_s : incoming speed.
    pressing : (N + M,) whether the wall pushes at tick k; fixed during a solve and checked against its solution.
    """

    wall: Wall
    nominal_m: FloatArray
    approach_m_s: float
    pressing: BoolArray

    __repr__ = brief

    def encoder(self, deviation_m: FloatArray) -> FloatArray:
        """(..., K) encoder position z at the ticks for deviations y."""
        return self.nominal_m[: deviation_m.shape[-1]] + deviation_m

    def feedback(self, deviation_m: FloatArray, dt_s: float) -> FloatArray:
        """(..., K) i_fb by the law for deviations y at the ticks."""
        return self.wall.current(*self.wall.measured(self.encoder(deviation_m), dt_s, self.approach_m_s))

    def masked_feedback(self, deviation_m: FloatArray, dt_s: float) -> FloatArray:
        """(..., K) i_fb with the pushing ticks fixed to `pressing`, which makes it affine in the deviations."""
        wanted = self.wall.wanted(*self.wall.measured(self.encoder(deviation_m), dt_s, self.approach_m_s))
        return np.asarray(np.where(self.pressing[: wanted.shape[-1]], wanted, 0.0))

    def feedback_transpose(self, by_feedback: FloatArray, dt_s: float) -> FloatArray:
        """(K,) gradient by the deviations for a gradient by `masked_feedback`."""
        return self.wall.linear_transpose(np.where(self.pressing[: by_feedback.size], by_feedback, 0.0), dt_s)


def feedback_command(feedback_A: FloatArray, amplifier: Amplifier | None, dt_s: float) -> FloatArray:
    """(..., N) command that makes the amplifier deliver the feedback current (`prefilter`)."""
    return feedback_A if amplifier is None else prefilter(feedback_A, amplifier, dt_s)


def feedback_command_transpose(by_command: FloatArray, amplifier: Amplifier | None, dt_s: float) -> FloatArray:
    """(N,) gradient by the feedback current for a gradient by its command."""
    if amplifier is None:
        return by_command
    now, before = prefilter_coefficients(amplifier, dt_s)
    return np.asarray(now * by_command + before * np.append(by_command[1:], 0.0))


def reference_course(grid: TimeGrid, reference_m_s2: FloatArray) -> FloatArray:
    """(K,) deviation from the nominal motion at the first K <= N + M ticks, if the stylus follows r (K,) exactly."""
    course = integral(integral(reference_m_s2, grid.dt_s), grid.dt_s)
    ticks = grid.all_issue_times_s[: reference_m_s2.size]
    return np.asarray(np.interp(ticks, ticks + grid.delay_s, course))


class FeedbackLoop:
    """The wall's law tick by tick, as the device computes it, for M taps at once.

    Before the first tick the stylus moved at constant speed, on which the derivative filter has settled.

    Parameters
    ----------
    wall : the same for all taps.
    amplifier : the prefilter inverts its pole; None is ideal.
    dt_s : servo period.
    first_m : (M,) encoder position at the first tick.
    approach_m_s : (M,) incoming speeds.
    """

    def __init__(
        self, wall: Wall, amplifier: Amplifier | None, dt_s: float, first_m: FloatArray, approach_m_s: FloatArray
    ) -> None:
        self._wall, self._dt_s, self._smoothing = wall, dt_s, wall.smoothing(dt_s)
        self._now, self._before = (1.0, 0.0) if amplifier is None else prefilter_coefficients(amplifier, dt_s)
        step = approach_m_s * dt_s
        self._position, self._velocity = first_m + step, -approach_m_s
        self._read = [(first_m + j * step, -approach_m_s) for j in range(wall.latency_ticks, 0, -1)]
        self._current = np.zeros_like(first_m)

    def step(self, encoder_m: FloatArray) -> FloatArray:
        """(M,) feedback command of this tick, from the encoder at this tick [A]."""
        a = self._smoothing
        self._velocity = a * self._velocity + (1 - a) * (encoder_m - self._position) / self._dt_s
        self._position = encoder_m
        self._read.append((self._position, self._velocity))
        earlier, self._current = self._current, self._wall.current(*self._read.pop(0))
        return np.asarray(self._now * self._current + self._before * earlier)

    def close(
        self,
        system: tuple[FloatArray, FloatArray, FloatArray],
        nominal_m: FloatArray,
        commands: FloatArray,
        *,
        count_m: float = 0.0,
    ) -> FloatArray:
        """Add the feedback to the commands of M taps tick by tick, on a device that starts at rest.

        The device is x_(k+1) = A x_k + B u_k; at tick k the p commands u_k of number k to k + p - 1 act.

        Parameters
        ----------
        system : A (n, n), B (n, p) and the row (p + n,) of the encoder's deviation over u_k and x_k.
        nominal_m : (M, K) nominal encoder position at the ticks.
        commands : (M, behind + K) contiguous, that of tick k at number behind + k; changed in place.
        count_m : resolution to which the encoder is rounded; 0 does not round.

        Returns
        -------
        (M, K) deviations of the encoder from its nominal positions at the ticks, before rounding.
        """
        (A, B, encoder), (M, K), wall = system, nominal_m.shape, self._wall
        (n, p), late = B.shape, wall.latency_ticks
        if recursions.COMPILED is None or n > recursions.MOST_STATES:
            return self._closed(system, nominal_m, commands, count_m)
        S, current, found = np.zeros((p + n, n + -n % 8)), np.empty((M, late + K)), np.empty((M, K))
        S[:p, :n], S[p:, :n] = B.T, A.T
        for number, read in enumerate(self._read):
            current[:, number] = wall.current(*read)
        force = wall.stiffness_N_m, wall.damping_N_s_m, wall.force_per_current_N_A, MAX_FEEDBACK_A
        law = self._smoothing, self._dt_s, *force, self._now, self._before, count_m
        before = np.stack([self._position, self._velocity], axis=1)
        given = [np.ascontiguousarray(each, dtype=float) for each in (S, encoder, law, nominal_m, before)]
        behind, arrays = commands.shape[1] - K, (*given, current, commands, found)
        recursions.COMPILED.tr_walled(M, K, n, p, S.shape[1], behind, late, *map(recursions.address, arrays))
        return found

    def _closed(
        self,
        system: tuple[FloatArray, FloatArray, FloatArray],
        nominal_m: FloatArray,
        commands: FloatArray,
        count_m: float,
    ) -> FloatArray:
        """`close` without the extension."""
        (A, B, encoder), (M, K) = system, nominal_m.shape
        p, behind = B.shape[1], commands.shape[1] - K
        x, found = np.zeros((M, len(A))), np.empty((M, K))
        with np.errstate(over="ignore", invalid="ignore"):  # the loop of an unstable wall overflows
            for k in range(K):
                found[:, k] = commands[:, k : k + p] @ encoder[:p] + x @ encoder[p:]
                z = nominal_m[:, k] + found[:, k]
                commands[:, behind + k] += self.step(np.round(z / count_m) * count_m if count_m else z)
                x = x @ A.T + commands[:, k : k + p] @ B.T
        return found
