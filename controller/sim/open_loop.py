"""A command played on the simulated device without a servo: what its sensors say at every tick.

The user holds still, so the device is linear and its motion over a servo period one affine map; the result is that
of `Simulator.advance` tick by tick, to rounding, at a tenth of the cost.
"""

from dataclasses import dataclass, replace

import numpy as np

from controller.sim.sensors import SensorBench
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import COMMAND, INTENTION, Layout, TrueDevice, nonlinear
from controller.sim.user import StillHand
from transopt.base.signals import FloatArray


@dataclass(frozen=True)
class Sensed:
    """Readings at the ticks, (N,) each, before the command of that tick acts.

    Attributes
    ----------
    position_m : of the encoder, in whole counts.
    """

    position_m: FloatArray
    grip_N: FloatArray
    current_A: FloatArray
    acceleration_m_s2: FloatArray


def true_device(device: TrueDevice, imperfections: Imperfections, seed: int) -> TrueDevice:
    """The device that a simulator of this seed has, mismatch and amplifier's crossover included."""
    still = StillHand(0.0)
    return Simulator(device, still, 1e-4, imperfections=imperfections, seed=seed).device


def _affine(
    maps: FloatArray, steps: int, current: int | None, intention_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """One segment as x+ = A x + b felt + c, from the map of one of its steps.

    Parameters
    ----------
    maps : (S, S + U). current : index of the current where the amplifier is ideal and sets it; None otherwise.
    """
    S = maps.shape[0]
    A, b, c = np.eye(S), np.zeros(S), np.zeros(S)
    step, by_command, by_intention = maps[:, :S], maps[:, S + COMMAND], maps[:, S + INTENTION] * intention_m
    for _ in range(steps):
        A, b, c = step @ A, step @ b + by_command, step @ c + by_intention
    if current is not None:
        b, A[:, current] = b + A[:, current], 0.0
    return A, b, c


def _motion(simulator: Simulator, grip_N: float, intention_m: float, command_A: FloatArray) -> FloatArray:
    """(N, S) states before each tick's command."""
    device, N = simulator.device, command_A.size
    at = Layout(len(device.masses_kg))
    felt = command_A
    if device.amplifier is not None:
        felt = np.clip(felt, -device.amplifier.command_limit_A, device.amplifier.command_limit_A)
    felt = felt - np.clip(felt, -device.crossover_A, device.crossover_A)
    whole = simulator.flow_at(grip_N).whole
    A, forcing = np.eye(at.states), np.zeros((N, at.states))
    for maps, behind in zip(whole, simulator.behind, strict=True):
        ideal = at.current if device.amplifier is None else None
        own, by_command, constant = _affine(maps, simulator.steps, ideal, intention_m)
        late = np.concatenate([np.zeros(behind), felt])[:N]
        A, forcing = own @ A, forcing @ own.T + np.outer(late, by_command) + constant
    x, states = simulator.state[: at.states], np.empty((N, at.states))
    for k in range(N):
        states[k] = x
        x = A @ x + forcing[k]
    return states


def play_still(
    device: TrueDevice, grip_N: float, command_A: FloatArray, dt_s: float, *, imperfections: Imperfections, seed: int
) -> Sensed:
    """Play a command while the user holds still at a grip.

    Parameters
    ----------
    device : the true one (`true_device`); the imperfections' own mismatch is not put on again.
    command_A : (N,) issued at k dt and held; zero before.
    seed : of the noise.

    Raises
    ------
    ValueError : a device with friction, whose motion is not linear.
    """
    user = StillHand(grip_N)
    simulator = Simulator(device, user, dt_s, imperfections=replace(imperfections, mismatch=0.0), seed=seed)
    if nonlinear(simulator.device, None):
        raise ValueError("friction to ground: step the simulator instead")
    states = _motion(simulator, grip_N, user.height_m, command_A)
    at, bench = Layout(len(device.masses_kg)), SensorBench(simulator.sensors, dt_s, seed, grip_N)
    motor, current, sensed = (states[:, j].tolist() for j in (0, at.current, at.sensed))
    return Sensed(
        position_m=bench.sensors.count_m * np.array([bench.counts(z) for z in motor], dtype=float),
        grip_N=np.array([bench.grip_N(grip_N) for _ in motor]),
        current_A=np.array([bench.current_A(i) for i in current]),
        acceleration_m_s2=np.array([bench.acceleration_m_s2(a) for a in sensed]),
    )
