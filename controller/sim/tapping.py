"""A simulated hand that taps in turn as soon as the device is armed: a world behind the port `sim:`."""

from collections import deque
from collections.abc import Callable, Iterable

import numpy as np

from controller.record.recorder import AFTER_S as RECORDED_S
from controller.servo.interface import Output, Readings, State
from controller.sim.experiment import AFTER_S, SimulatedTap, approach_ticks, tap_simulator
from controller.sim.simulator import Simulator
from controller.sim.true_device import TrueDevice
from transopt.library.library import Library

BACK_M_S = 0.5  # with which the hand takes the stylus back to where the next tap begins
SETTLE_S = 30e-3  # of rest after each tap, in which the last telemetry arrives
LATE_S = 5e-3  # by which the device may take a contact for later than the hand meant it


class TappingHand:
    """Holds the stylus still where a tap begins, taps once the device is armed, takes it back, and taps again.

    A `controller.sim.port.World`. Each tap is a simulation of its own, with its own phase and noise. While the hand
    rests or takes the stylus back, nothing is integrated: the sensors say without noise where it is held, and that
    the commanded current flows.

    Parameters
    ----------
    device : the true one, before the imperfections of the taps.
    tapped : called after each tap.
    """

    def __init__(
        self, library: Library, device: TrueDevice, taps: Iterable[SimulatedTap], tapped: Callable[[], None]
    ) -> None:
        self._device, self._tapped = device, tapped
        self._dt_s = library.time_grid().dt_s
        self._planned: deque[tuple[Library, SimulatedTap]] = deque()
        self._simulator: Simulator | None = None  # of the tap that comes, or is under way
        self._left = 0  # ticks of it
        self._under_way = False
        self._way: list[int] = []  # back: encoder counts tick by tick, the last first
        self._settling = 0
        self._counts, self._grip_N, self._current_A = 0, 0.0, 0.0
        self.plan(library, taps)
        self._way = []

    def plan(self, library: Library, taps: Iterable[SimulatedTap]) -> None:
        """Further taps, of this library."""
        self._planned.extend((library, tap) for tap in taps)
        if self._simulator is None:
            self._prepare()

    @property
    def done(self) -> bool:
        """Nothing is left to do."""
        return self._simulator is None and self._settling == 0

    def readings(self, tick: int) -> Readings:
        if self._under_way:
            assert self._simulator is not None
            r = self._simulator.readings()
            return Readings(tick, r.encoder_counts, r.grip_N, r.current_A, r.acceleration_m_s2)
        return Readings(tick, self._way[-1] if self._way else self._counts, self._grip_N, self._current_A, 0.0)

    def advance(self, output: Output) -> None:
        """One servo period; the first of a tap is the one after the device was armed."""
        self._current_A = output.command_A
        if self._under_way:
            assert self._simulator is not None
            self._simulator.advance(output.command_A)
            self._left -= 1
            if self._left == 0:
                self._end(self._simulator)
        elif self._settling:
            self._settling -= 1
        elif self._way:
            self._way.pop()
        elif self._simulator is not None and output.state is State.ARMED:
            self._under_way = True

    def _end(self, simulator: Simulator) -> None:
        self._counts = _counts(simulator)
        self._simulator, self._under_way = None, False
        self._settling = round(SETTLE_S / self._dt_s)
        self._tapped()
        self._prepare()

    def _prepare(self) -> None:
        if not self._planned:
            return
        library, tap = self._planned.popleft()
        self._simulator, _ = tap_simulator(library, tap, self._device)
        after_s = max(library.time_grid().end_s + AFTER_S, RECORDED_S + LATE_S)
        self._left = approach_ticks(tap.speed_m_s, self._dt_s) + int(np.ceil(after_s / self._dt_s)) + 1
        from_counts, self._counts = self._counts, _counts(self._simulator)
        self._grip_N = tap.grip_N
        step = BACK_M_S * self._dt_s / self._simulator.sensors.count_m
        ticks = int(np.ceil(abs(self._counts - from_counts) / step))
        self._way = [round(z) for z in np.linspace(self._counts, from_counts, ticks + 1)]


def _counts(simulator: Simulator) -> int:
    """Of the encoder, without reading it: a reading draws noise."""
    return int(np.floor(simulator.state[0] / simulator.sensors.count_m + 0.5))
