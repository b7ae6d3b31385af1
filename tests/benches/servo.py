"""A servo on a bench of its own: prescribed motion, a one-pole amplifier, readings to falsify."""

import math
from collections.abc import Callable

from controller.servo.interface import Fault, Notice, Output, Readings
from controller.servo.settings import Settings
from controller.waveforms.bank import Bank
from tests.benches.oracle.servo import Servo
from transopt.plant.amplifier import Amplifier
from transopt.plant.wall import Wall

DT_S, COUNT_M = 1e-4, 24.5e-6
AMPLIFIER = Amplifier(1050.0, 68e-6, 6.0)
DECAY = math.exp(-AMPLIFIER.rate_rad_s * DT_S)
WALL = Wall(200.0, 1.0, 1.25, 1, 500.0)
RINGING_M_S2 = 2.0
CONTACT = 400  # tick of the built-in tap's contact


def tap_m(k: float, speed_m_s: float = 0.3, contact: float = CONTACT) -> float:
    """Straight in, then to rest 2 mm deep while the hand trembles by a few counts, and out again after 0.15 s."""
    t = (k - contact) * DT_S
    if t < 0:
        return -speed_m_s * t
    depth = 2e-3 * (1 - math.exp(-t * speed_m_s / 2e-3)) + 6e-5 * math.sin(60 * t)
    return -depth + (0.3 * (t - 0.15) if t > 0.15 else 0.0)


class Bench:
    """A servo over an ideal sensor board: prescribed motion, a one-pole amplifier."""

    def __init__(self, settings: Settings, table: Bank, motion: Callable[[float], float] = tap_m) -> None:
        self.servo, self.motion = Servo(settings, table), motion
        self.tick, self.current_A, self.grip_N = 0, 0.0, 3.0
        self.seen_m: tuple[float, float] | None = None  # at the last two ticks
        self.outputs: list[Output] = []
        self.change: dict[str, float] = {}  # readings to falsify

    def reading(self) -> Readings:
        now_m = self.motion(self.tick)
        last_m, earlier_m = self.seen_m or (now_m, now_m)
        self.seen_m = now_m, last_m
        counts = round(now_m / COUNT_M)
        # A prescribed motion does not feel the current; the ringing of the drive under it tells of a live sensor.
        felt = (now_m - 2 * last_m + earlier_m) / DT_S**2 + (RINGING_M_S2 if self.tick % 2 else -RINGING_M_S2)
        reading = Readings(self.tick, counts, self.grip_N, self.current_A, felt)
        return reading._replace(**self.change) if self.change else reading  # type: ignore[arg-type]

    def step(self) -> Output:
        output = self.servo.step(self.reading())
        self.current_A = DECAY * self.current_A + (1 - DECAY) * output.command_A
        self.tick += 1
        self.outputs.append(output)
        return output

    def run(self, ticks: int) -> "Bench":
        for _ in range(ticks):
            self.step()
        return self

    def events(self) -> list[Notice | Fault]:
        return [event.what for output in self.outputs for event in output.events]

    def commands(self) -> list[float]:
        return [output.command_A for output in self.outputs]
