"""Simulates the recordings of a scene: its device, not driven, strikes an object that the scene states."""

from collections.abc import Sequence

import numpy as np

from transopt.base import recursions
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray, Signal
from transopt.base.sizes import MOST_SAMPLES
from transopt.plant.intention import Intention
from transopt.plant.state_space import StateSpace
from transopt.recordings.recording import Recording
from transopt.recordings.settings import SimulatedTaps
from transopt.scene.scene import Scene

STEP_S = 1e-5
LONGEST_S = 1.0  # longest simulated tap
APPROACH_S = 30e-3  # recorded time before contact
BEYOND_S = 10e-3  # recorded time after the end of the scene's window and tail
USUAL_LEAD_S = 3e-4  # reference lead, so that another lead of the scene does not change the drawn noise
ENCODER_COUNT_M = 24.5e-6
GRIP_STEP_N = 1e-6  # rounding of a grip where it seeds the random numbers
LIGHT_N = 1.0  # grip of the hand that strikes in a scene of a free stylus
STRAIGHT = Intention(yields="straight")


def contact_force(target: SimulatedTaps, depth_m: FloatArray, closing_m_s: FloatArray) -> FloatArray:
    """Contact force k delta^n (1 + c d delta/dt) >= 0 on the stylus [N], for arrays of indentation and its rate."""
    elastic = target.contact_stiffness_N_m * np.maximum(depth_m, 0.0) ** target.contact_exponent
    return np.asarray(np.maximum(elastic * (1 + target.contact_damping_s_m * closing_m_s), 0.0))


def _driven(
    flow: FloatArray,
    push: FloatArray,
    contact: FloatArray,
    outputs: FloatArray,
    target: SimulatedTaps,
    start: FloatArray,
    step_s: float,
    found: FloatArray,
) -> FloatArray:
    """RK4 of dx/dt = flow x + push F for V taps at once.

    The force F follows from depth and closing speed, the two rows of `contact`. State, slopes and outputs of all four
    RK4 stages are linear in the state at the start of the step and in the forces of the previous stages. So only the
    forces are computed one by one: in compiled code, or for all taps at once in numpy.

    Parameters
    ----------
    start : (n, V) states. found : (K, q, V), receives the outputs of x and F.

    Returns
    -------
    (n, V) states at the last instant.
    """
    size = push.size
    # Maps from the state (size) and the four forces.
    now, nothing = np.eye(size, size + 4), np.zeros((size, size + 4))
    stages, slopes = [], [nothing]
    for j, share in enumerate((0.0, 0.5, 0.5, 1.0)):
        stages.append(now + share * step_s * slopes[-1])
        slope = flow @ stages[-1]
        slope[:, size + j] += push
        slopes.append(slope)
    k1, k2, k3, k4 = slopes[1:]
    after = now + step_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    by_output = np.pad(outputs, ((0, 0), (0, 3)))  # outputs depend on the first stage's force only
    rows = np.concatenate([*(contact @ stage for stage in stages), by_output, after])
    law = (target.contact_stiffness_N_m, target.contact_exponent, target.contact_damping_s_m)
    last = recursions.strike(rows, law, start, found)
    if last is not None:
        return last
    both = np.zeros((size + 4, start.shape[1]))
    both[:size] = start
    for k in range(len(found)):
        for j in range(4):
            both[size + j] = contact_force(target, *(rows[2 * j : 2 * j + 2, : size + j] @ both[: size + j]))
        reached = rows[8:] @ both
        found[k] = reached[:-size]
        if k < len(found) - 1:
            both[:size] = reached[-size:]
    return both[:size]


def strike(
    plant: StateSpace,
    target: SimulatedTaps,
    speeds_m_s: FloatArray,
    duration_s: float,
    step_s: float = STEP_S,
    intention: Intention = STRAIGHT,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Stylus acceleration and encoder position of V taps, from contact on.

    The states of the chain are relative to the hand's intended motion, whose acceleration v u'' acts on every mass as
    an inertial force (`transopt.plant.intention`). The contact force F = k delta^n (1 + c d delta/dt) >= 0 acts on
    the stylus. The object is a mass on a spring and a damper.

    Parameters
    ----------
    plant : model from force on the stylus [N] to stylus acceleration; a chain with states elongations, then
        their rates.
    target : the object.
    speeds_m_s : (V,) incoming speeds.
    duration_s : simulated time after contact.
    step_s : step of the integration; the phases of the intended motion begin at whole steps.
    intention : intended motion of the hand from contact on.

    Returns
    -------
    times_s (K,), acceleration_m_s2 (V, K), encoder_position_m (V, K).
    """
    n, masses = plant.order, plant.order // 2
    # The position of a mass is the sum of the elongations from it to the ground, its velocity that of their rates.
    stylus = int(np.flatnonzero(plant.B[masses:, 0])[-1])
    beyond = np.zeros(n)
    beyond[stylus:masses] = 1.0
    # States after those of the chain: position and velocity of the object, v t, v, and v u with its derivative.
    thing, way = slice(n, n + 2), slice(n + 2, n + 4)

    # Indentation and its rate: z of the stylus is its deviation from the intended motion v u - v t.
    contact = np.zeros((2, n + 6))
    contact[0, :n], contact[0, n], contact[0, n + 2], contact[0, n + 4] = -beyond, 1.0, 1.0, -1.0
    contact[1, :n], contact[1, n + 1], contact[1, n + 3], contact[1, n + 5] = -np.roll(beyond, masses), 1.0, 1.0, -1.0
    state = np.zeros((n + 6, speeds_m_s.size))
    state[n + 3] = speeds_m_s
    steps = int(np.ceil(duration_s / step_s))
    starts = [round(phase.start_s / step_s) for phase in intention.phases]
    outputs = np.zeros((2, n + 7))  # rows over the states and the force
    outputs[0, :n], outputs[0, -1] = plant.C[0], plant.D[0, 0]
    outputs[1, :n], outputs[1, n + 2], outputs[1, n + 4] = plant.Ce[0], -1.0, 1.0
    found = np.empty((steps + 1, 2, speeds_m_s.size))
    for phase, first, last in zip(intention.phases, starts, [*starts[1:], steps], strict=True):
        if first >= steps:
            break
        # All but the contact force is linear: d state/dt = flow @ state + push F.
        flow, push = np.zeros((n + 6, n + 6)), np.zeros(n + 6)
        flow[:n, :n], push[:n] = plant.A, plant.B[:, 0]
        flow[n, n + 1], push[n + 1] = 1.0, -1 / target.object_mass_kg
        flow[n + 1, thing] = -np.array([target.object_stiffness_N_m, target.object_damping_N_s_m])
        flow[n + 1, thing] /= target.object_mass_kg
        flow[way, way] = [[0.0, 1.0], [0.0, 0.0]]
        flow[n + 4, n + 5] = 1.0
        flow[n + 5, [n + 3, n + 5]] = phase.rate_1_s, -phase.decay_1_s
        flow[n - 1] -= flow[n + 5]  # the rate of the link to the ground
        state[n + 5] += phase.jump * speeds_m_s
        state[n - 1] -= phase.jump * speeds_m_s
        along = found[first : min(last, steps) + 1]  # the next phase begins at its last instant
        state = _driven(flow, push, contact, outputs, target, state, step_s, along)
    acceleration, encoder = found.transpose(1, 2, 0)
    return np.asarray(step_s * np.arange(steps + 1)), acceleration, encoder


def grips_of(scene: Scene) -> list[float]:
    """Grips of a scene's simulated recordings: the stated one, or those of its grid.

    A free stylus would not return for the next tap, so in its scene a light hand strikes.
    """
    target = scene.recordings.simulated
    assert target is not None
    if target.grip_N is not None:
        return [target.grip_N]
    return [LIGHT_N] if scene.grid.grips_N[0] == 0 else list(scene.grid.grips_N)


def recordings(scene: Scene) -> list[Recording]:
    """Simulated recordings at every grid speed and grip, with repeats at varied speed, as measured by an ADXL321.

    They include static 1 g, white noise, clipping at the sensor's range and encoder counts; a fixed seed makes them
    reproducible. They end 10 ms after the scene's window and tail. A longer tail extends them and changes no earlier
    sample, since its noise is drawn separately.

    Raises
    ------
    InputError : the scene has no simulated table.
    """
    target = scene.recordings.simulated
    if target is None:
        raise InputError(f"{scene.name}: recordings.simulated: missing; this scene reads files")
    scene = scene.striking()
    grips, grid = grips_of(scene), scene.time_grid()
    within = grid.end_s + grid.lead_s - USUAL_LEAD_S + BEYOND_S
    duration = within + grid.after_stages * grid.dt_s
    if duration > LONGEST_S:
        raise InputError(
            f"recordings.simulated: {duration:g} s a tap, at most {LONGEST_S:g} s: lower time.stages or "
            "weights.after_s"
        )
    taps = len(scene.grid.speeds_m_s) * target.repeats * len(grips)
    samples = int(taps * duration * max(target.rate_Hz, 1 / STEP_S))
    if samples > MOST_SAMPLES:
        raise InputError(
            f"recordings.simulated: {taps} taps of {duration:g} s are {samples} samples, at most "
            f"{MOST_SAMPLES}: lower repeats, rate_Hz or the number of speeds and grips"
        )
    return [recording for grip in grips for recording in _at_grip(scene, target, grip, within)]


def _at_grip(scene: Scene, target: SimulatedTaps, grip_N: float, within_s: float) -> list[Recording]:
    """The recordings of one grip; its random numbers do not depend on the scene's other grips."""
    random = np.random.default_rng([target.seed, round(grip_N / GRIP_STEP_N)])
    nodes = np.repeat(scene.grid.speeds_m_s, target.repeats)
    speeds = nodes * (1 + target.speed_spread * random.uniform(-1, 1, nodes.size))
    after_s = scene.time_grid().after_stages * scene.time_grid().dt_s
    plant, intention = scene.plant(grip_N, struck=True), scene.hand.intention()
    with np.errstate(all="ignore"):  # an overflow is found below, by numbers that are not finite
        _, acceleration, encoder = strike(plant, target, speeds, within_s + after_s, intention=intention)

    dt = 1 / target.rate_Hz
    before, last = int(np.ceil(APPROACH_S / dt)), int(within_s / dt) - 1
    # Sampling is not synchronous with the contact.
    phases, later = random.uniform(0, dt, speeds.size), random.spawn(speeds.size)
    times = np.arange(-before, last + round(after_s / dt)) * dt + phases[:, None]
    drawn = random.standard_normal((speeds.size, before + last))
    drawn = np.hstack([drawn, [each.standard_normal(times.shape[1] - drawn.shape[1]) for each in later]])
    measured_g = 1.0 + target.noise_g_rtHz * np.sqrt(target.rate_Hz / 2) * drawn
    z = -speeds[:, None] * times
    felt_m_s2, z[:, before:] = _between((acceleration, encoder), times[:, before:])
    measured_g[:, before:] += felt_m_s2 / STANDARD_GRAVITY_M_S2
    if not (np.isfinite(measured_g).all() and np.isfinite(z).all()):
        raise InputError(
            f"recordings.simulated: the simulation of a tap in steps of {STEP_S:g} s diverges: device or contact are "
            "too fast for this step; raise the masses, or lower the stiffnesses and dampings"
        )
    measured_m_s2 = np.clip(measured_g, -target.range_g, target.range_g) * STANDARD_GRAVITY_M_S2
    counts_m = np.round(z / ENCODER_COUNT_M) * ENCODER_COUNT_M
    return [
        Recording(
            name=f"{scene.name}_{nodes[j]:g}_m_s_{grip_N:g}_N_{j % target.repeats + 1}",
            source=f"simulated: the undriven device at {grip_N:g} N strikes the object of the scene",
            sha256="",
            acceleration=Signal(0.0, dt, measured_m_s2[j]),
            position=Signal(0.0, dt, counts_m[j]),
            speed_m_s=float(speed),
            grip_N=grip_N,
        )
        for j, speed in enumerate(speeds)
    ]


def _between(kinds: Sequence[FloatArray], times_s: FloatArray) -> list[FloatArray]:
    """(V, m) courses (V, K) in steps of `STEP_S` from 0 on, interpolated linearly at times (V, m) within them."""
    places = times_s.T / STEP_S  # transposed, as `strike` stores its courses with instants outermost
    left = np.clip(places.astype(int), 0, kinds[0].shape[1] - 2)
    course, share, found = np.arange(times_s.shape[0]), places - left, list[FloatArray]()
    for courses in kinds:
        low, high = courses.T[left, course], courses.T[left + 1, course]
        with np.errstate(all="ignore"):  # courses that overflowed
            found.append((low + share * (high - low)).T)
    return found
