"""Taps by independent equations of motion, integrated by `scipy.integrate.solve_ivp`: on a real object or a library.

Only the device's numbers are shared with design and simulator: masses, springs and dampers of the chain, force per
ampere, the amplifier's pole. Masses have absolute positions along the surface normal, positive outwards, and the
hand's intended motion drives the far end of the last spring. The equations are smooth between instants at which a
command changes, a sample is taken, the encoder is read or the law of the hand changes; each such interval is
integrated separately.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from controller.sim.true_device import TrueDevice
from played.wall import Pushing
from transopt.base.signals import FloatArray
from transopt.plant.intention import Yielding
from transopt.recordings.settings import SimulatedTaps

RELATIVE, ABSOLUTE = 1e-9, 1e-11  # tolerances of the integration, in SI units
ROUNDING_S = 1e-10  # instants nearer than this count as one
CHANGE_S = 60e-3  # time in which a hand brakes to rest, or reverses its speed, at constant acceleration
DECAY_S = 30e-3  # time constant of a hand whose speed decays


@dataclass(frozen=True)
class Hand:
    """What a hand does, and how it differs from the hand of the scene.

    Attributes
    ----------
    yields : what it does when its intention is over, by the names of `hand.yields`.
    incoming_m_s2 : acceleration with which it comes, kept until the intention is over.
    stiffness, damping : factors on every spring and every damper of the hand.
    tremor_m, tremor_Hz, tremor_rad : amplitude, frequency and phase at contact of a sway of the intention.
    """

    yields: Yielding
    incoming_m_s2: float = 0.0
    stiffness: float = 1.0
    damping: float = 1.0
    tremor_m: float = 0.0
    tremor_Hz: float = 0.0
    tremor_rad: float = 0.0


@dataclass(frozen=True)
class Tap:
    """One tap of a hand.

    Attributes
    ----------
    speed_m_s : of the stylus at contact, inwards.
    command_A : (C,) that the device plays, each from its switching instant on; the transients where it renders a
        wall besides. None where the object is struck.
    """

    speed_m_s: float
    grip_N: float
    hand: Hand
    command_A: FloatArray | None = None


@dataclass(frozen=True)
class Courses:
    """What V taps did: stylus acceleration, motor position and integral of i^2 (V, K) at the samples."""

    acceleration_m_s2: FloatArray
    position_m: FloatArray
    heat_A2_s: FloatArray


class Taps:
    """V taps with one device, integrated together.

    Parameters
    ----------
    target : the object that taps without a command strike, at rest at z = 0.
    intention_s : for so long after contact every hand goes on as it came.
    wall : that the device renders under taps with a command; None for none.
    """

    def __init__(
        self,
        device: TrueDevice,
        target: SimulatedTaps,
        taps: Sequence[Tap],
        intention_s: float,
        wall: Pushing | None = None,
    ) -> None:
        self._device, self._target, self._taps, self._intention_s = device, target, taps, intention_s
        self._wall = wall
        self._hands = [tap.hand for tap in taps]
        each = [self._chain(tap) for tap in taps]
        self._mass, self._spring, self._damper = (np.array(part).T for part in zip(*each, strict=True))
        self._n = self._mass.shape[0]
        self._sway_m = np.array([hand.tremor_m for hand in self._hands])
        self._sway_rad_s = 2 * np.pi * np.array([hand.tremor_Hz for hand in self._hands])
        self._sway_rad = np.array([hand.tremor_rad for hand in self._hands])
        self._strikes = np.array([tap.command_A is None for tap in taps])

    def _chain(self, tap: Tap) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(n,) masses, stiffnesses and dampings of one tap; the joints from the skin on are the hand's."""
        mass, spring, damper = self._device.at(tap.grip_N)
        first = self._device.skin or 0
        spring[first:] *= tap.hand.stiffness
        damper[first:] *= tap.hand.damping
        return mass, spring, damper

    def courses(self, times_s: FloatArray, switching_s: FloatArray) -> Courses:
        """Integrate from the first sample or contact, whichever comes first, to the last sample.

        Parameters
        ----------
        times_s : (K,) samples, rising, contact at 0. switching_s : (C,) when the commands change.
        """
        T, wall = self._intention_s, self._wall
        ticks = switching_s - self._device.delay_s if wall is not None else np.zeros(0)
        edges = np.concatenate([times_s, switching_s, ticks, [0.0, T, T + CHANGE_S]])
        first, last = min(float(times_s[0]), float(ticks.min(initial=0.0))), float(times_s[-1])
        edges = np.unique(edges[(edges >= first - ROUNDING_S) & (edges <= last + ROUNDING_S)])
        edges = edges[np.append(True, np.diff(edges) > ROUNDING_S)]
        commands = np.zeros((switching_s.size + 1, len(self._taps)))
        for column, tap in enumerate(self._taps):
            if tap.command_A is not None:
                commands[1:, column] = tap.command_A
        amplifier = self._device.amplifier
        if amplifier is not None and wall is None:
            # Over a wall it is transient and feedback together that may not pass the limit.
            commands = np.clip(commands, -amplifier.command_limit, amplifier.command_limit)
        x = self._start(first)
        found, plays = [], ~self._strikes
        if wall is not None:
            wall.start(x[0, plays], x[self._n, plays])
        for j, start in enumerate(edges):
            for k in np.flatnonzero(np.abs(ticks - start) <= ROUNDING_S):
                commands[k + 1, plays] = wall.command(x[0, plays], commands[k + 1, plays])
            felt = commands[np.searchsorted(switching_s, start + ROUNDING_S)]
            x, push, decay = self._minded(x, start)
            held = (felt, push, decay)
            if np.min(np.abs(times_s - start)) <= ROUNDING_S:
                slope = self._rates(start, x.ravel(), *held).reshape(x.shape)
                found.append((slope[self._n + self._device.stylus], x[0], x[-1]))
            if j + 1 < edges.size:
                span = start, edges[j + 1]
                ended = solve_ivp(
                    self._rates,
                    span,
                    x.ravel(),
                    method="DOP853",
                    t_eval=span[1:],
                    args=held,
                    rtol=RELATIVE,
                    atol=ABSOLUTE,
                    first_step=span[1] - span[0],
                )
                x = ended.y[:, -1].reshape(x.shape)
        return Courses(*(np.array(course).T for course in zip(*found, strict=True)))

    def _minded(self, x: FloatArray, start_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """States, (V,) acceleration and (V,) decay of the intention's speed, for the stretch that begins here."""
        after, speed = start_s - self._intention_s, 2 * self._n + 1
        push, decay, x = np.zeros(len(self._taps)), np.zeros(len(self._taps)), x.copy()
        if after < -ROUNDING_S:
            return x, np.array([hand.incoming_m_s2 for hand in self._hands]), decay
        if after < ROUNDING_S:
            self._speed_at_end = x[speed].copy()
        for column, hand in enumerate(self._hands):
            changes = after < CHANGE_S - ROUNDING_S
            if hand.yields == "stops":
                x[speed, column] = 0.0
            elif hand.yields == "decays":
                decay[column] = 1 / DECAY_S
            elif hand.yields in ("brakes", "pulls") and changes:
                share = 1.0 if hand.yields == "brakes" else 2.0
                push[column] = -share * self._speed_at_end[column] / CHANGE_S
        return x, push, decay

    def _start(self, time_s: float) -> FloatArray:
        """(2 n + 6, V) positions, velocities, intention and its speed, object and its speed, current, heat.

        The chain follows the intention as it does when its own motions have died out: behind its acceleration by what
        the springs give, behind its sway by the response at that frequency. The stylus is at 0 at time 0.
        """
        n, stylus = self._n, self._device.stylus
        x = np.zeros((2 * n + 6, len(self._taps)))
        for column, (tap, hand) in enumerate(zip(self._taps, self._hands, strict=True)):
            a = hand.incoming_m_s2
            lag, response, omega = np.zeros(n), np.ones(n, dtype=complex), self._sway_rad_s[column]
            joined = np.eye(n) - np.eye(n, k=1)
            spring = joined.T @ np.diag(self._spring[:, column]) @ joined
            damper = joined.T @ np.diag(self._damper[:, column]) @ joined
            mass = np.diag(self._mass[:, column])
            if a:
                lag = -np.linalg.solve(spring, mass @ np.full(n, a))
            if hand.tremor_m:
                driven = np.zeros(n, dtype=complex)
                driven[-1] = self._spring[-1, column] + 1j * omega * self._damper[-1, column]
                response = np.linalg.solve(spring + 1j * omega * damper - omega**2 * mass, driven)
            swung = response * hand.tremor_m * np.exp(1j * (hand.tremor_rad - np.pi / 2))
            speed = tap.speed_m_s + float(np.real(1j * omega * swung[stylus]))
            place = -lag[stylus] - float(np.real(swung[stylus]))
            u, w = place - speed * time_s + a * time_s**2 / 2, -speed + a * time_s
            now = swung * np.exp(1j * omega * time_s)
            x[:n, column] = u + lag + np.real(now)
            x[n : 2 * n, column] = w + np.real(1j * omega * now)
            x[2 * n : 2 * n + 2, column] = u, w
        return x

    def _rates(
        self, time_s: float, flat: FloatArray, felt_A: FloatArray, push: FloatArray, decay: FloatArray
    ) -> FloatArray:
        """Derivatives of all states of all taps."""
        device, target, n, stylus = self._device, self._target, self._n, self._device.stylus
        x = flat.reshape(2 * n + 6, -1)
        z, v, (u, w, thing, thing_v, current, _) = x[:n], x[n : 2 * n], x[2 * n :]
        swing = self._sway_rad_s * time_s + self._sway_rad
        following = np.vstack([z[1:], u + self._sway_m * np.sin(swing)])
        following_v = np.vstack([v[1:], w + self._sway_m * self._sway_rad_s * np.cos(swing)])
        pull = self._spring * (following - z) + self._damper * (following_v - v)
        force = pull.copy()
        force[1:] -= pull[:-1]
        flows = felt_A if device.amplifier is None else current
        force[0] += device.force_per_current_N_A * flows
        elastic = target.contact_stiffness_N_m * np.maximum(thing - z[stylus], 0.0) ** target.contact_exponent
        contact = np.maximum(elastic * (1 + target.contact_damping_s_m * (thing_v - v[stylus])), 0.0) * self._strikes
        force[stylus] += contact
        backed = target.object_stiffness_N_m * thing + target.object_damping_N_s_m * thing_v
        rates = np.empty_like(x)
        rates[:n], rates[n : 2 * n] = v, force / self._mass
        rates[2 * n], rates[2 * n + 1] = w, push - decay * w
        rates[2 * n + 2], rates[2 * n + 3] = thing_v, -(contact + backed) / target.object_mass_kg
        rates[2 * n + 4] = 0.0 if device.amplifier is None else device.amplifier.rate_rad_s * (felt_A - current)
        rates[2 * n + 5] = flows**2
        return rates.ravel()
