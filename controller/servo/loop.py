"""Servo and plant tick by tick in virtual time; and the clock that paces a simulated port for demonstrations."""

import time
from collections.abc import Callable
from typing import Protocol

from controller.servo.interface import Output, Plant, Readings

SLEEP_S = 1e-3  # shorter waits are not slept: the next ticks catch up


class Servo(Protocol):
    """What the loop needs of a servo."""

    def arm(self) -> object: ...

    def step(self, readings: Readings) -> Output: ...


class Clock(Protocol):
    """Real time; `time.monotonic` and `time.sleep` as `WallClock`, something faster in tests."""

    def now_s(self) -> float: ...

    def sleep(self, duration_s: float) -> None: ...


class WallClock:
    def now_s(self) -> float:
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        time.sleep(duration_s)


Observer = Callable[[Readings, Output], None]


def run(plant: Plant, servo: Servo, ticks: int, dt_s: float, *, observe: Observer | None = None) -> None:
    """Let `ticks` servo periods pass in virtual time.

    Parameters
    ----------
    observe : called once per tick with what was read and answered.
    """
    for _ in range(ticks):
        readings = plant.readings()
        output = servo.step(readings)
        plant.advance(output.command_A)
        if observe is not None:
            observe(readings, output)
