"""The simulator's exact flow and the hand's trajectory as numbers, for the compiled plant (firmware/host/plant.c)."""

import numpy as np

from controller.sim.simulator import GRIP_STEP_N, Simulator
from controller.sim.true_device import INPUTS, Layout, nonlinear
from controller.sim.user import User
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray

MAGIC = 0x4C504E54  # "TNPL"
VERSION = 2
MOST_SEGMENTS = 2


def plant_bytes(simulator: Simulator, user: User, duration_s: float) -> bytes:
    """The file: sizes, numbers, initial state, maps by grip; per servo period the hand's intention, grip and map.

    The compiled plant repeats the trajectory endlessly, so the user's motion should have this period.

    Parameters
    ----------
    simulator : not yet advanced, without a struck object; the plant draws the sensors' noise itself.
    duration_s : duration of the trajectory, rounded to whole servo periods.

    Raises
    ------
    InputError : the device has friction, which the plant does not model, or the hand lets go and takes hold again.
    """
    s = simulator
    device, sensors, dt_s = s.device, s.sensors, s.dt_s
    if nonlinear(device, None):
        raise InputError("device: the compiled plant knows no friction: leave it out")
    ticks, at = round(duration_s / dt_s), Layout(len(device.masses_kg))
    segments, steps = len(s.step_s), s.steps
    intention, grips = np.empty((ticks, segments, steps)), np.array([user.grip_N(k * dt_s) for k in range(ticks)])
    if device.skin is not None and grips.min() <= 0 < grips.max():
        raise InputError("user: the compiled plant's hand holds the stylus all the time, or never")
    for k in range(ticks):
        start_s = k * dt_s
        for segment, step_s in enumerate(s.step_s):
            for j in range(steps):
                intention[k, segment, j] = user.intention_m(start_s + (j + 1) * step_s) + s.ahead_m
            start_s += steps * step_s
    used, which = _maps(grips)
    maps = [np.stack(s.flow_at(grip).whole) for grip in used]
    behind = [*s.behind, 0][:MOST_SEGMENTS]
    amplifier = device.amplifier
    head = np.array(
        [MAGIC, VERSION, at.n, segments, steps, ticks, len(used), *behind, int(amplifier is None)], dtype="<u4"
    )
    numbers = [
        *[*s.step_s, 0.0][:MOST_SEGMENTS],
        user.intention_m(0.0) + s.ahead_m,
        0.0 if amplifier is None else amplifier.command_limit,
        device.crossover_A,
        sensors.count_m,
        sensors.accelerometer_range_g * STANDARD_GRAVITY_M_S2,
        s.bench.keep,
        s.bench.new_m_s2,
        sensors.accelerometer_noise_m_s2,
        sensors.grip_hysteresis,
        sensors.grip_noise_N,
        sensors.current_noise_A,
    ]
    assert s.state.size == at.states + INPUTS
    parts = (np.array(numbers), s.state, np.stack(maps), intention, grips, which)
    return head.tobytes() + b"".join(np.ascontiguousarray(part, dtype="<f8").tobytes() for part in parts)


def _maps(grips: FloatArray) -> tuple[list[float], FloatArray]:
    """The grips of the maps, and the index of the map in each period, by the simulator's rule for a changing grip."""
    taken, used, which = float(grips[0]), [float(grips[0])], np.empty(grips.size)
    places = {taken: 0}
    for k, grip in enumerate(grips.tolist()):
        if abs(grip - taken) > GRIP_STEP_N:
            taken = round(grip / GRIP_STEP_N) * GRIP_STEP_N
            if taken not in places:
                places[taken] = len(used)
                used.append(taken)
        which[k] = places[taken]
    return used, which
