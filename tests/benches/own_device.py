"""A device and a person at it, written anew for the trials of the check: nothing of it is shared with the simulator.

Three masses in absolute coordinates (motor, stylus, hand), an amplifier with a PI current loop on the motor's voltage
and an accelerometer with one pole, all linear for one grip, by the classical Runge-Kutta rule at 5 us. For a linear
system one such step is the polynomial I + hA + (hA)^2/2 + (hA)^3/6 + (hA)^4/24, so a servo period is a product of two
powers of it: before and after the moment at which a command is felt, which may be ticks after it was given. The
sensors round and add noise of their own.

The scripted person does what the check asks for: moves by a ruler, shakes, rests, lets go, holds, taps; a hand never
holds quite still.
"""

import math
import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from controller.servo.interface import Output, Readings
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray

STEP_S = 5e-6
Z1, V1, Z2, V2, Z3, V3, CURRENT, CHARGE, FELT, COMMAND, HAND, HAND_SPEED = range(12)
BLOCK = 4096  # random numbers drawn at once
TREMOR = ((0.55e-4, 3.1), (0.3e-4, 5.3), (0.13e-4, 8.7))  # m, Hz: 0.1 mm each way at most
STRAIGHT_S = 0.15  # of a tap's way in
ABOVE_M = 6e-3  # where the stylus is held above the surface


@dataclass(frozen=True)
class Truth:
    """Physical parameters of the default device, by their own names.

    Attributes
    ----------
    motor_kg, stylus_kg, hand_kg : the masses; motor and link at the tip.
    drive_N_m, drive_N_s_m : transmission between motor and stylus.
    skin_N_m, skin_N_m_N, skin_N_s_m, skin_N_s_m_N : between stylus and hand, constant and per newton of grip.
    arm_N_m, arm_N_m_N, arm_N_s_m, arm_N_s_m_N : between hand and the hand's intention, likewise.
    bearing_N_s_m : friction of the motor's bearings, which no model here knows.
    force_N_A : at the tip.
    pole_Hz, delay_s, R_ohm, L_H : of the amplifier's loop and of the motor; the delay counts in whole steps of 5 us.
    """

    motor_kg: float = 0.0140
    stylus_kg: float = 0.026
    hand_kg: float = 0.010
    drive_N_m: float = 6e4
    drive_N_s_m: float = 8.0
    skin_N_m: float = 3000.0
    skin_N_m_N: float = 2000.0
    skin_N_s_m: float = 6.0
    skin_N_s_m_N: float = 3.0
    arm_N_m: float = 160.0
    arm_N_m_N: float = 110.0
    arm_N_s_m: float = 6.0
    arm_N_s_m_N: float = 3.0
    bearing_N_s_m: float = 0.05
    force_N_A: float = 1.25
    pole_Hz: float = 1050.0
    delay_s: float = 70e-6
    R_ohm: float = 2.18
    L_H: float = 0.238e-3

    def drawn(self, part: float, random: np.random.Generator) -> "Truth":
        """Every parameter off by up to this part of it."""
        names = [name for name in self.__dataclass_fields__ if name != "delay_s"]
        factors = 1 + part * random.uniform(-1, 1, len(names))
        return replace(self, **{n: getattr(self, n) * float(f) for n, f in zip(names, factors, strict=True)})


class OpenChannel:
    """What a decoder of all four edges counts once channel B has lost its wire and stays as it is.

    Parameters
    ----------
    counts : at that moment. Of channel A's edges each is then the step forth or back of the one before.
    """

    def __init__(self, counts: int) -> None:
        self._counts, self._a, self._step = counts, self._level(counts + 1), 1 - 2 * self._level(counts)

    @staticmethod
    def _level(counts: int) -> int:
        return counts >> 1 & 1

    def counts(self, true: int) -> int:
        """The decoder's count where a whole encoder has `true`."""
        return self._counts + self._step * (self._level(true + 1) - self._a)


@dataclass(frozen=True)
class Wires:
    """What is wired, and how wrong: factors of each part, 0 for a dead one, below 0 for a reversed one.

    Attributes
    ----------
    motor : of the force. amplifier : of the current. monitor, encoder, accelerometer, grip : of what is read.
    open_channel : whether the encoder's channel B is off from the start on.
    stuck_grip_N : what the grip sensor reads whatever happens; None reads.
    swapped : two analog inputs that are exchanged, of `current_A`, `acceleration_m_s2`, `grip_N`.
    """

    motor: float = 1.0
    amplifier: float = 1.0
    monitor: float = 1.0
    encoder: float = 1.0
    accelerometer: float = 1.0
    grip: float = 1.0
    open_channel: bool = False
    stuck_grip_N: float | None = None
    swapped: tuple[str, str] | None = None


@dataclass(frozen=True)
class Sensing:
    """The sensors have an encoder count, a reading at the surface, noise, and gravity along the accelerometer."""

    count_m: float = 24.5e-6
    surface_counts: int = 0
    accelerometer_Hz: float = 2500.0
    acceleration_noise_m_s2: float = 0.2
    current_noise_A: float = 5e-3
    grip_noise_N: float = 0.02
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2
    grip_sensor: bool = True


def _flow(truth: Truth, sensing: Sensing, motor: float, grip_N: float) -> FloatArray:
    """(12, 12) of x' = A x; command and hand speed are held, the hand moves by its speed."""
    t, A = truth, np.zeros((12, 12))
    held = grip_N > 0
    skin, skin_d = (
        (t.skin_N_m + t.skin_N_m_N * grip_N, t.skin_N_s_m + t.skin_N_s_m_N * grip_N) if held else (0.0, 0.0)
    )
    arm, arm_d = t.arm_N_m + t.arm_N_m_N * grip_N, t.arm_N_s_m + t.arm_N_s_m_N * grip_N
    A[Z1, V1] = A[Z2, V2] = A[Z3, V3] = 1.0
    A[V1, [Z1, Z2, V1, V2]] = np.array([-t.drive_N_m, t.drive_N_m, -t.drive_N_s_m, t.drive_N_s_m]) / t.motor_kg
    A[V1, V1] -= t.bearing_N_s_m / t.motor_kg
    A[V1, CURRENT] = motor * t.force_N_A / t.motor_kg
    A[V2, [Z1, Z2, V1, V2]] = np.array([t.drive_N_m, -t.drive_N_m, t.drive_N_s_m, -t.drive_N_s_m]) / t.stylus_kg
    A[V2, [Z2, Z3, V2, V3]] += np.array([-skin, skin, -skin_d, skin_d]) / t.stylus_kg
    A[V3, [Z2, Z3, V2, V3]] = np.array([skin, -skin, skin_d, -skin_d]) / t.hand_kg
    A[V3, [Z3, HAND, V3, HAND_SPEED]] += np.array([-arm, arm, -arm_d, arm_d]) / t.hand_kg
    # V = L w (c - i) + R w sum(c - i), less the motor's own voltage: without it a pole at w.
    w = 2 * math.pi * t.pole_Hz
    A[CURRENT, [COMMAND, CURRENT, CHARGE, V1]] = [w, -w - t.R_ohm / t.L_H, w * t.R_ohm / t.L_H, -t.force_N_A / t.L_H]
    A[CHARGE, [COMMAND, CURRENT]] = [1.0, -1.0]
    A[FELT] = 2 * math.pi * sensing.accelerometer_Hz * A[V2]
    A[FELT, FELT] -= 2 * math.pi * sensing.accelerometer_Hz
    A[HAND, HAND_SPEED] = 1.0
    return A


def _step(A: FloatArray) -> FloatArray:
    """The classical Runge-Kutta rule over one step."""
    h, power, total = A * STEP_S, np.eye(len(A)), np.eye(len(A))
    for j in range(1, 5):
        power = power @ h / j
        total = total + power
    return total


class OwnWorld:
    """Device and person behind a port: `readings` and `advance`, once per servo period, and `asked`.

    Attributes
    ----------
    path_m : where the hand means to be beside its tremor, over time [s].
    grip_N : with which it holds.
    """

    def __init__(
        self,
        dt_s: float = 1e-4,
        *,
        truth: Truth | None = None,
        wires: Wires | None = None,
        sensing: Sensing | None = None,
        grip_N: float = 3.0,
        tremor: float = 1.0,
        seed: int = 0,
    ) -> None:
        self.dt_s, self.truth, self.wires, self.sensing = (
            dt_s,
            truth or Truth(),
            wires or Wires(),
            sensing or Sensing(),
        )
        self._random = np.random.default_rng(seed)
        self._channel: OpenChannel | None = None
        self._noise = iter(())  # type: ignore[var-annotated]
        self._flows: dict[float, tuple[FloatArray, FloatArray, FloatArray]] = {}
        self._tremor = [(tremor * size, 2 * math.pi * f, self._random.uniform(0, 6.28)) for size, f in TREMOR]
        self.tick, self.pressed, self.held_N, self.weight_N = 0, False, grip_N, 0.0
        self.grip_N = grip_N
        self.path_m: Callable[[float], float] = lambda _: ABOVE_M
        self._x = np.zeros(12)
        self._x[[Z1, Z2, Z3, HAND]] = ABOVE_M
        self._late_ticks, self._felt_after = divmod(round(self.truth.delay_s / STEP_S), round(dt_s / STEP_S))
        # The oldest first: felt before and after the moment within this period, and those that are under way.
        self._commands = deque([0.0] * (self._late_ticks + 2), maxlen=self._late_ticks + 2)
        self._meant: tuple[Any, ...] = ()  # the last time, path and grip of `hand_m`, and the position
        self.person = Person(self)

    @property
    def now_s(self) -> float:
        return self.tick * self.dt_s

    def hand_m(self, time_s: float) -> float:
        """Position that the hand means to have; the end of one period is the beginning of the next."""
        when = (time_s, self.path_m, self.grip_N)
        if self._meant[:3] != when:
            shaking = 0.0
            if self.grip_N > 0:
                for size, w, phase in self._tremor:
                    shaking += size * math.sin(w * time_s + phase)
            self._meant = *when, self.path_m(time_s) + shaking
        return float(self._meant[3])

    def _draw(self) -> float:
        value = next(self._noise, None)
        if value is None:
            self._noise = iter(self._random.standard_normal(BLOCK).tolist())
            value = next(self._noise)
        return float(value)

    def readings(self, tick: int) -> Readings:
        s, w, x = self.sensing, self.wires, self._x.tolist()  # floats, whose arithmetic is faster than an array's
        counts = math.floor(w.encoder * x[Z1] / s.count_m + 0.5) + s.surface_counts
        if w.open_channel:
            self._channel = self._channel or OpenChannel(counts)
            counts = self._channel.counts(counts)
        grip = self.grip_N + self.weight_N if w.stuck_grip_N is None else w.stuck_grip_N
        dead = w.accelerometer == 0
        analog = {
            "current_A": w.monitor * x[CURRENT] + s.current_noise_A * self._draw(),
            "acceleration_m_s2": 0.0
            if dead
            else w.accelerometer * (x[FELT] + s.gravity_m_s2) + s.acceleration_noise_m_s2 * self._draw(),
            "grip_N": w.grip * grip + s.grip_noise_N * self._draw() if s.grip_sensor else float("nan"),
        }
        if w.swapped is not None:
            one, other = w.swapped
            analog[one], analog[other] = analog[other], analog[one]
        return Readings(tick, counts, emergency_stop=self.pressed, **analog)

    def advance(self, output: Output) -> None:
        self.person.act()
        x, here = self._x, self.hand_m(self.now_s)
        following = self.hand_m((self.tick + 1) * self.dt_s)
        x[HAND], x[HAND_SPEED] = here, (following - here) / self.dt_s
        if self.grip_N == 0:
            # The hand is away, and takes hold again where the stylus is.
            x[HAND], x[HAND_SPEED] = x[Z2], x[V2]
            x[Z3], x[V3] = x[Z2], x[V2]
        self._commands.append(self.wires.amplifier * output.command_A)
        first, last, whole = self._at(self.grip_N)
        earlier, later = self._commands[0], self._commands[1]
        x[COMMAND] = earlier
        if earlier == later:
            self._x = whole @ x
        else:
            x = first @ x
            x[COMMAND] = later
            self._x = last @ x
        self.tick += 1

    def _at(self, grip_N: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What moves the state at a grip: until a command is felt, from there on, and over the whole period."""
        if grip_N not in self._flows:
            step = _step(_flow(self.truth, self.sensing, self.wires.motor, grip_N))
            power, period = np.linalg.matrix_power, round(self.dt_s / STEP_S)
            parts = power(step, self._felt_after), power(step, period - self._felt_after)
            self._flows[grip_N] = *parts, parts[1] @ parts[0]
        return self._flows[grip_N]

    def asked(self, what: str) -> None:
        self.person.asked(what)


def eased(part: float) -> float:
    """From 0 to 1 as hands move (Flash and Hogan 1985)."""
    part = min(max(part, 0.0), 1.0)
    return part**3 * (10 - 15 * part + 6 * part**2)


@dataclass
class Person:
    """Does what is asked, some tenths of a second later.

    Attributes
    ----------
    way_part : of the way asked for that the person's ruler gives.
    speed_m_s : of a tap.
    requests : so far.
    """

    world: OwnWorld
    way_part: float = 1.0
    speed_m_s: float = 0.2
    requests: list[str] = field(default_factory=list)
    _later: list[tuple[float, Callable[[], None]]] = field(default_factory=list)

    def act(self) -> None:
        if self._later and self._later[0][0] <= self.world.now_s:
            self._later.pop(0)[1]()

    def later(self, after_s: float, act: Callable[[], None]) -> None:
        self._later.append((self.world.now_s + after_s, act))
        self._later.sort(key=lambda each: each[0])

    def asked(self, what: str) -> None:
        self.requests.append(what)
        obeys: dict[str, Callable[[], None]] = {
            "press": lambda: setattr(self.world, "pressed", True),
            "release": lambda: setattr(self.world, "pressed", False),
            "let the stylus rest": self.rest,
            "move": lambda: self.go(self.here() + self.way_part * 10e-3, 0.4),
            "shake": self.shake,
            "let go": self.let_go,
            "hold": lambda: self.hold(what),
            "put the weight": lambda: self.weigh(float(what.split()[4])),
            "tap": lambda: self.tap(self.speed_m_s),
        }
        act = next(act for words, act in obeys.items() if what.startswith(words))
        self.later(0.05, act)

    def here(self) -> float:
        return self.world.path_m(self.world.now_s)

    def go(self, to_m: float, within_s: float) -> None:
        begin_s, begin_m = self.world.now_s, self.here()
        self.world.path_m = lambda t: begin_m + (to_m - begin_m) * eased((t - begin_s) / within_s)

    def rest(self) -> None:
        self.world.weight_N = 0.0
        self.go(ABOVE_M, 0.1)

    def shake(self) -> None:
        begin_s, middle = self.world.now_s, self.here()
        self.world.path_m = lambda t: (
            middle + 5e-3 * math.sin(2 * math.pi * 3 * (t - begin_s)) * eased((t - begin_s) / 0.2)
        )

    def let_go(self) -> None:
        self.world.grip_N = 0.0

    def hold(self, what: str) -> None:
        """At the grip that is asked for, as before where none is."""
        asked = re.search(r"at ([\d.]+) N", what)
        if asked:
            self.world.held_N = float(asked[1])
        self.world.weight_N, self.world.grip_N = 0.0, self.world.held_N
        here = float(self.world._x[Z2])
        begin_s = self.world.now_s
        self.world.path_m = lambda t: here + (ABOVE_M - here) * eased((t - begin_s) / 0.3)

    def weigh(self, grams: float) -> None:
        self.world.grip_N, self.world.weight_N = 0.0, 1e-3 * grams * STANDARD_GRAVITY_M_S2

    def tap(self, speed_m_s: float) -> None:
        """Out first, then straight in for so long that the start's swing is gone, on for 30 ms, and back."""
        v, begin_s, high = speed_m_s, self.world.now_s, self.here()
        up_s, start_s, onward_s, stop_s, back_s = 0.4, 0.03, 0.03, 0.05, 0.4
        top = v * (STRAIGHT_S + start_s / 2)
        rise = top - high
        straight_s = (top - v * start_s / 2) / v
        deepest = -v * (onward_s + stop_s / 2)

        def path(time_s: float) -> float:
            t = time_s - begin_s
            if t < up_s:
                return high + rise * eased(t / up_s)
            t -= up_s
            if t < start_s:
                return top - v * t * t / (2 * start_s)
            t -= start_s
            if t < straight_s + onward_s:
                return top - v * start_s / 2 - v * t
            t -= straight_s + onward_s
            if t < stop_s:
                return -v * onward_s - v * (t - t * t / (2 * stop_s))
            t -= stop_s
            return deepest + (ABOVE_M - deepest) * eased(t / back_s)

        self.world.path_m = path
