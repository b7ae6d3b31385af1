"""Simulator of a true device in a user's hand, in virtual time, with the interface `Plant`.

The linear part of the motion is exact (matrix exponential); friction and the contact with a real object are
integrated by the midpoint rule, so their error is of second order in the step. Time advances only in `advance`.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from controller.servo.interface import Readings
from controller.sim.current_loop import CurrentLoop
from controller.sim.sensors import SEED_SENSORS, SensorBench, Sensors
from controller.sim.true_device import (
    COMMAND,
    CONTACT_FORCE,
    INPUTS,
    INTENTION,
    INTENTION_SPEED,
    MOTOR_FORCE,
    NO_GROUND,
    Flow,
    Ground,
    Layout,
    TrueDevice,
    device_of,
    flow,
    nonlinear,
)
from controller.sim.user import User
from transopt.base.signals import FloatArray
from transopt.library.file import load_library
from transopt.plant.coil import COPPER_PER_K, PWM_RIPPLE_A, RESISTANCE_REFERENCE_C, CoilModel
from transopt.recordings.settings import SimulatedTaps
from transopt.scene.builtin import load_scene
from transopt.scene.scene import Scene

GRIP_STEP_N = 0.05  # change of the grip from which on the matrices are updated
EARLIEST_S = 1e-12  # a fraction of a tick in the delay below this counts as zero


@dataclass(frozen=True)
class Imperfections:
    """Deviations of the true device from the design model.

    Attributes
    ----------
    mismatch : largest relative deviation of every parameter.
    crossover_A : half-width of the amplifier's dead band around zero; beyond it the output is smaller by this.
    ground : friction and springs between motor and base. sensors : resolution and noise of the sensors.
    """

    mismatch: float = 0.0
    crossover_A: float = 0.01
    ground: Ground = NO_GROUND
    sensors: Sensors = SEED_SENSORS


NONE = Imperfections(crossover_A=0.0)


@dataclass(frozen=True)
class Trace:
    """The true quantities at every step, (K,) each.

    Attributes
    ----------
    times_s : simulator's time. acceleration_m_s2 : of the stylus. motor_m, stylus_m : positions.
    motor_m_s : velocity. current_A : in the coil. contact_N : force of a real object on the stylus.
    winding_C : NaN without a coil.
    """

    times_s: FloatArray
    acceleration_m_s2: FloatArray
    motor_m: FloatArray
    motor_m_s: FloatArray
    stylus_m: FloatArray
    current_A: FloatArray
    contact_N: FloatArray
    winding_C: FloatArray


class Coil:
    """Two-node thermal model with copper's resistance rise, by the explicit midpoint rule once per servo period."""

    def __init__(self, model: CoilModel) -> None:
        self._model = model
        self._C_w, self._C_h = model.tau_w_s / model.R_wh_K_W, model.tau_h_s / model.R_ha_K_W
        self.winding_C, self.housing_C = model.start_winding_C, model.start_housing_C

    def _rates(self, winding_C: float, housing_C: float, square_A2: float) -> tuple[float, float]:
        m = self._model
        heat = m.R_ohm * (1 + COPPER_PER_K * (winding_C - RESISTANCE_REFERENCE_C)) * square_A2
        out = (winding_C - housing_C) / m.R_wh_K_W
        # One node: the housing keeps its temperature.
        away = out if m.nodes == 1 else (housing_C - m.ambient_C) / m.R_ha_K_W
        return (heat - out) / self._C_w, (out - away) / self._C_h

    def step(self, square_A2: float, dt_s: float) -> None:
        """`square_A2` : mean of i_eff^2 over the period."""
        w, h = self._rates(self.winding_C, self.housing_C, square_A2)
        w, h = self._rates(self.winding_C + w * dt_s / 2, self.housing_C + h * dt_s / 2, square_A2)
        self.winding_C += w * dt_s
        self.housing_C += h * dt_s


def true_device(device: TrueDevice, imperfections: Imperfections, seed: int) -> TrueDevice:
    """The device with a simulator's imperfections: ground, crossover and the mismatch drawn from the seed."""
    known = replace(device, ground=imperfections.ground, crossover_A=imperfections.crossover_A)
    return known.mismatched(imperfections.mismatch, np.random.default_rng([seed, 3]))


class Simulator:
    """A device in a user's hand; implements `Plant`.

    Parameters
    ----------
    device : as the scene describes it; the mismatch is applied here.
    user : intention and grip as functions of this simulator's time.
    dt_s : servo period.
    seed : seed of mismatch and noise; the same seed gives the same run, bit for bit.
    target : a real object at the surface, or None.
    steps : integration steps per segment of a servo period; the delay's end divides the period into two segments.
    trace : whether to keep the truth at every step.

    Attributes
    ----------
    device : the true device, mismatch included.
    sensors, bench : parameters of the sensors, and their states in this run.
    dt_s : servo period.
    behind : for each segment of a servo period, the age of its command in periods.
    steps, step_s : integration steps per segment, and their length for each segment.
    ahead_m : distance by which the hand aims ahead of its intention to balance friction.
    time_s : time so far.
    peak_current_A : maximum over all times; between steps the current is monotone.
    """

    def __init__(
        self,
        device: TrueDevice,
        user: User,
        dt_s: float,
        *,
        imperfections: Imperfections = NONE,
        seed: int = 0,
        target: SimulatedTaps | None = None,
        steps: int = 2,
        trace: bool = False,
    ) -> None:
        self.device = true_device(device, imperfections, seed)
        self.dt_s, self._user, self._target = dt_s, user, target
        self.sensors = imperfections.sensors
        self.bench = SensorBench(imperfections.sensors, dt_s, seed, user.grip_N(0.0))
        self._coil = None if self.device.coil is None else Coil(self.device.coil)
        self._ripple_A = PWM_RIPPLE_A if self.device.coil is None else self.device.coil.ripple_A
        bridge, amplifier = self.device.bridge, self.device.amplifier
        self._loop = None
        if bridge is not None and amplifier is not None:
            self._loop = CurrentLoop(bridge, amplifier.pole_Hz / bridge.pole_Hz)
        whole = int(self.device.delay_s / dt_s + 1e-9)
        late = max(self.device.delay_s - whole * dt_s, 0.0)
        lengths, behind = ((dt_s,), (whole,)) if late < EARLIEST_S else ((late, dt_s - late), (whole + 1, whole))
        self.behind, self.steps = behind, steps
        self.step_s = tuple(length / steps for length in lengths)
        # Newest command first.
        self._commands = deque([0.0] * (behind[0] + 1), maxlen=behind[0] + 1)
        self._nonlinear = nonlinear(self.device, target)
        self._at = Layout(len(self.device.masses_kg))
        self._tick, self.time_s = 0, 0.0
        self.peak_current_A = 0.0
        self._rows: list[tuple[float, ...]] | None = [] if trace else None
        self._grip_N, self.ahead_m = user.grip_N(0.0), 0.0
        self._flow = self.flow_at(self._grip_N)
        self._x = self._start()
        self._intention_m = user.intention_m(0.0) + self.ahead_m
        if self._rows is not None:
            self._keep(0.0)

    def readings(self) -> Readings:
        x, bench = self._x, self.bench
        return Readings(
            tick=self._tick,
            encoder_counts=bench.counts(float(x[0])),
            grip_N=bench.grip_N(self._user.grip_N(self.time_s)),
            current_A=bench.current_A(float(x[self._at.current])),
            acceleration_m_s2=bench.acceleration_m_s2(float(x[self._at.sensed])),
        )

    def advance(self, command_A: float) -> None:
        """Advance by one servo period with this command, issued now and held.

        A command that is not finite is a programming error of the servo; the amplifier clips others to its range.
        """
        if not math.isfinite(command_A):
            raise ValueError(f"command {command_A} A at tick {self._tick}: must be a finite number")
        self._commands.appendleft(command_A)
        self._take_grip(self._user.grip_N(self.time_s))
        start_s, square = self._tick * self.dt_s, 0.0
        x, current, ripple_A, loop = self._x, self._at.current, self._ripple_A, self._loop
        for segment, step_s in enumerate(self.step_s):
            felt = self._felt(self._commands[self.behind[segment]])
            if self.device.amplifier is None:
                x[current] = felt
            after = abs(x.item(current)) + ripple_A
            for j in range(1, self.steps + 1):
                mean = None if loop is None else self._through_bridge(loop, felt, step_s)
                before = after if loop is None else abs(x.item(current)) + ripple_A
                self._advance_step(segment, felt, start_s + j * step_s, step_s)
                after = abs(x.item(current)) + ripple_A
                square += step_s * ((before * before + before * after + after * after) / 3 if mean is None else mean)
                self.peak_current_A = max(self.peak_current_A, after - ripple_A)
            start_s += self.steps * step_s
        self._tick += 1
        self.time_s = self._tick * self.dt_s
        if self._coil is not None:
            self._coil.step(square / self.dt_s, self.dt_s)

    def _through_bridge(self, loop: CurrentLoop, felt_A: float, step_s: float) -> float:
        """Set the mean current of the coming step in the state; return the mean of its square [A^2].

        The coil's effective resistance and the square both include the ripple's heat, so the square is divided by
        `heat_factor`.
        """
        circuit = loop.bridge.circuit if self._coil is None else loop.bridge.circuit.at(self._coil.winding_C)
        emf_V = self.device.force_per_current_N_A * float(self._x[self._at.n])
        self._x[self._at.current], square = loop.advance(step_s, felt_A, emf_V, circuit.R_ohm)
        return square / loop.bridge.heat_factor

    @property
    def winding_C(self) -> float:
        return float("nan") if self._coil is None else self._coil.winding_C

    @property
    def housing_C(self) -> float:
        return float("nan") if self._coil is None else self._coil.housing_C

    @property
    def contact_N(self) -> float:
        """Force of a real object on the stylus."""
        return self._contact_N(self._x)

    def trace(self) -> Trace:
        """The truth so far.

        Raises
        ------
        ValueError : the simulator was made without `trace`.
        """
        if self._rows is None:
            raise ValueError("this simulator keeps no trace: make it with trace=True")
        return Trace(*np.array(self._rows).T)

    @property
    def state(self) -> FloatArray:
        """(S + U,) positions, velocities, current, accelerometer, object and inputs, see `true_device.Layout`."""
        return self._x.copy()

    def flow_at(self, grip_N: float) -> Flow:
        """Maps of the exact linear motion at a grip over one step of each segment."""
        return flow(self.device, self._target, self.sensors.accelerometer_bandwidth_Hz, grip_N, self.step_s)

    def _start(self) -> FloatArray:
        """Initial state: all masses move with the intention, and the springs balance friction.

        The hand aims ahead by the elongation that friction causes, so that the motor mass is at the intended place.
        """
        n = self._at.n
        x = np.zeros(self._at.states + INPUTS)
        wanted = self._user.intention_m(0.0)
        speed = (self._user.intention_m(self.step_s[0]) - wanted) / self.step_s[0]
        ground = self.device.ground
        held = self._friction_N(speed) - ground.stiffness_N_m * wanted - ground.damping_N_s_m * speed
        _, stiffness, _ = self.device.at(self._grip_N)
        elongations = np.array([held / k if k > 0 else 0.0 for k in stiffness])
        self.ahead_m = -float(elongations.sum())
        x[:n] = wanted + self.ahead_m + np.cumsum(elongations[::-1])[::-1]
        x[n : 2 * n] = speed
        x[self._at.states + INTENTION_SPEED] = speed
        return x

    def _take_grip(self, grip_N: float) -> None:
        if abs(grip_N - self._grip_N) <= GRIP_STEP_N:
            return
        skin, n = self.device.skin, self._at.n
        if skin is not None and self._grip_N <= 0 < grip_N:
            # A hand that takes hold again takes over position and velocity of the stylus.
            self._x[skin + 1 : n] = self._x[skin]
            self._x[n + skin + 1 : 2 * n] = self._x[n + skin]
        self._grip_N = round(grip_N / GRIP_STEP_N) * GRIP_STEP_N
        self._flow = self.flow_at(self._grip_N)

    def _felt(self, command_A: float) -> float:
        """Input of the amplifier's pole: the command clipped to its range, less the crossover's dead band."""
        amplifier, dead = self.device.amplifier, self.device.crossover_A
        if amplifier is not None and abs(command_A) > amplifier.command_limit:
            command_A = math.copysign(amplifier.command_limit, command_A)
        return command_A - (command_A if abs(command_A) <= dead else math.copysign(dead, command_A))

    def _friction_N(self, speed_m_s: float) -> float:
        ground = self.device.ground
        return -ground.friction_N * math.tanh(speed_m_s / ground.friction_speed_m_s)

    def _contact_N(self, x: FloatArray) -> float:
        """k delta^n (1 + c d delta/dt) >= 0 on the stylus (Hunt and Crossley 1975)."""
        if self._target is None:
            return 0.0
        stylus, at = self.device.stylus, self._at
        depth = float(x[at.target] - x[stylus])
        if depth <= 0:
            return 0.0
        closing = float(x[at.target + 1] - x[at.n + stylus])
        elastic = self._target.contact_stiffness_N_m * math.pow(depth, self._target.contact_exponent)
        return max(elastic * (1 + self._target.contact_damping_s_m * closing), 0.0)

    def _push(self, x: FloatArray) -> None:
        """Set the inputs to the nonlinear forces of the present state."""
        S = self._at.states
        x[S + MOTOR_FORCE] = self._friction_N(float(x[self._at.n]))
        x[S + CONTACT_FORCE] = self._contact_N(x)

    def _advance_step(self, segment: int, felt_A: float, end_s: float, step_s: float) -> None:
        x, S, before = self._x, self._at.states, self._intention_m
        self._intention_m = after = self._user.intention_m(end_s) + self.ahead_m
        x[S + COMMAND], x[S + INTENTION], x[S + INTENTION_SPEED] = felt_A, before, (after - before) / step_s
        if self._nonlinear:
            self._push(x)
            middle = x.copy()
            middle[:S] = self._flow.half[segment].dot(x)
            self._push(middle)
            x[S + MOTOR_FORCE :] = middle[S + MOTOR_FORCE :]
        x[:S] = self._flow.whole[segment].dot(x)  # half the time of `@` at this size
        if self._rows is not None:
            self._keep(end_s)

    def _keep(self, time_s: float) -> None:
        assert self._rows is not None
        x, n, S = self._x, self._at.n, self._at.states
        now = x.copy()
        # Use the inputs of this instant, not those held over the step that led here.
        now[S + INTENTION] = self._intention_m
        if self._nonlinear:
            self._push(now)
        stylus = self.device.stylus
        acceleration = float(self._flow.acceleration @ now)
        motor_m, motor_m_s, stylus_m = float(x[0]), float(x[n]), float(x[stylus])
        current, contact = float(x[self._at.current]), float(now[S + CONTACT_FORCE])
        self._rows.append((time_s, acceleration, motor_m, motor_m_s, stylus_m, current, contact, self.winding_C))


def scene_like(named: str | Path) -> Scene:
    """A scene by built-in name or by path, or the one that a library was solved from.

    Raises
    ------
    InputError : the name is neither a scene nor a library.
    """
    path = Path(named)
    return load_library(path).scene() if path.suffix.lower() == ".npz" else load_scene(str(named))


def device_in(scene: Scene, wrong: Imperfections, seed: int) -> TrueDevice:
    """The true device of a scene: that of `transopt-play tap --simulate` with the same mismatch and seed."""
    return true_device(device_of(scene), wrong, seed)
