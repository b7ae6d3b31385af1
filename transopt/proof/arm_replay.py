"""Replay of a tap on the full arm, whose inertia and Jacobian change with its motion.

The linear plant is valid around one posture. Here the arm turns: I(q) q'' + c(q, q') = torques - J(q)' F, with F the
force of the spring and the damper between the tip of the arm and the stylus. Stylus and hand are modelled as in the
linear plant; the hand's intended motion is straight along the normal. The integrator is DOP853 (Hairer, Norsett and
Wanner, Solving Ordinary Differential Equations I, Sec. II.5).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy.integrate import DOP853

from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.arm import Arm, Place
from transopt.plant.time_grid import TimeGrid

RELATIVE, ABSOLUTE = 1e-9, 1e-12  # tolerances of the integrator; states are in m, rad and their rates


@dataclass(frozen=True)
class ArmMotion:
    """The motion of a tap on the full arm.

    Attributes
    ----------
    acceleration_m_s2 : (3, N + M) acceleration of the stylus along normal and tangents, at the switching instants.
    without_m_s2 : (3, N + M) the same without any command, by the motion of the arm alone.
    moved_m : (N + M,) distance of the stylus from the point of contact.
    """

    acceleration_m_s2: FloatArray
    without_m_s2: FloatArray
    moved_m: FloatArray


@dataclass(frozen=True)
class _Device:
    """The differential equation of an arm at a place, all vectors in the frame of the base."""

    arm: Arm
    place: Place
    grip_N: float
    speed_m_s: float

    @cached_property
    def _links(self) -> tuple[list[FloatArray], list[FloatArray]]:
        return self.arm.links(self.grip_N)

    @cached_property
    def start(self) -> FloatArray:
        """(18,) angles, stylus, hand and their rates at contact: all move along the normal."""
        q, velocity = self.place.posture_rad, -self.speed_m_s * self.place.normal
        rates, tip = np.linalg.solve(self.arm.linkage.jacobian(q), velocity), self.arm.linkage.tip_m(q)
        return np.concatenate([q, tip, tip, rates, velocity, velocity])

    def stylus_m_s2(self, time_s: float, state: FloatArray) -> FloatArray:
        """(3,) acceleration of the stylus."""
        return self.rate(time_s, state, np.zeros(3))[12:15]

    def rate(self, time_s: float, state: FloatArray, current_A: FloatArray) -> FloatArray:
        """(18,) time derivative of a state, at a time after contact, under currents (3,)."""
        (K, B), linkage = self._links, self.arm.linkage
        start, intended = self.start[3:6], self.start[12:15]
        q, stylus, hand = state[:3], state[3:6], state[6:9]
        q_rate, stylus_rate, hand_rate = state[9:12], state[12:15], state[15:18]
        J = linkage.jacobian(q)
        pull = K[0] @ (linkage.tip_m(q) - stylus) + B[0] @ (J @ q_rate - stylus_rate)
        skin = K[1] @ (stylus - hand) + B[1] @ (stylus_rate - hand_rate)
        held = K[2] @ (hand - start - time_s * intended) + B[2] @ (hand_rate - intended)
        torque = self.arm.torques_Nm_A() * current_A - J.T @ pull - linkage.centrifugal(q, q_rate)
        bent = np.linalg.solve(self.arm.joint_inertia(q), torque)
        return np.concatenate(
            [
                state[9:],
                bent,
                (pull - skin) / self.arm.stylus_mass_kg,
                (skin - held) / self.arm.hand_mass_kg(self.grip_N),
            ]
        )


def replay_on_arm(
    arm: Arm,
    place: Place,
    grip_N: float,
    speed_m_s: float,
    grid: TimeGrid,
    amplifier: Amplifier | None,
    command: FloatArray,
) -> ArmMotion:
    """Play commands (3, N) on the full arm, which makes contact at a speed along the normal.

    The simulation begins at contact or at the first switching instant, whichever is earlier; before that no current
    flows and the speed is constant. Each period between switching instants is integrated separately, as the slope of
    the current jumps at the instants.

    Parameters
    ----------
    amplifier : None is ideal.
    """
    device = _Device(arm, place, grip_N, speed_m_s)
    whole = np.concatenate([command, np.zeros((3, grid.after_stages))], axis=1)
    played = _played(device, grid, amplifier, whole)
    silent = _played(device, grid, amplifier, np.zeros_like(whole))
    states, frame = played[0], place.frame
    return ArmMotion(
        acceleration_m_s2=frame @ played[1],
        without_m_s2=frame @ silent[1],
        moved_m=np.linalg.norm(states[3:6] - device.start[3:6, None], axis=0),
    )


def _played(
    device: _Device, grid: TimeGrid, amplifier: Amplifier | None, command: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(18, K) states and (3, K) accelerations of the stylus at the K switching instants."""
    K, first = command.shape[1], float(grid.switching_times_s[0])
    states, accelerations = np.empty((18, K)), np.empty((3, K))
    state, current = device.start, np.zeros(3)
    if first < 0:  # before contact the motion is uniform, so only the positions differ from those at contact
        state = state.copy()
        state[3:9] += first * np.tile(-device.speed_m_s * device.place.normal, 2)
        state[:3] += first * state[9:12]
    for k in range(K):
        tau, held = first + k * grid.dt_s, command[:, k]
        states[:, k], accelerations[:, k] = state, device.stylus_m_s2(tau, state)
        fed = partial(_current, amplifier, tau, held, current)
        solver = DOP853(
            partial(_rate, device, fed),
            tau,
            state,
            tau + grid.dt_s,
            first_step=grid.dt_s / 2,
            rtol=RELATIVE,
            atol=ABSOLUTE,
        )
        while solver.status == "running":
            solver.step()
        state, current = np.asarray(solver.y), fed(tau + grid.dt_s)
    return states, accelerations


def _rate(device: _Device, fed: Callable[[float], FloatArray], time_s: float, state: FloatArray) -> FloatArray:
    return device.rate(time_s, state, fed(time_s))


def _current(
    amplifier: Amplifier | None, since_s: float, held: FloatArray, before: FloatArray, time_s: float
) -> FloatArray:
    """(3,) currents at a time, with a command that acts since `since_s`, when the currents were `before`."""
    if amplifier is None:
        return held
    return np.asarray(held + (before - held) * np.exp(-amplifier.rate_rad_s * (time_s - since_s)))
