"""A simulated hand that taps in turn as soon as the device is armed: a world behind the port `sim:`."""

from collections import deque
from collections.abc import Callable, Iterable

import numpy as np

from controller.record.recorder import AFTER_S as RECORDED_S
from controller.servo.interface import Output, Readings, State
from controller.sim.sensors import SEED_SENSORS
from controller.sim.simulated_tap import AFTER_S, SimulatedTap, approach_ticks, tap_simulator
from controller.sim.simulator import Simulator
from controller.sim.true_device import TrueDevice
from transopt.library.library import Library

BACK_M_S = 0.5  # with which the hand moves between two taps
SETTLE_S = 30e-3  # of rest after each tap, in which the last telemetry arrives, and after each move
LATE_S = 5e-3  # by which the device may take a contact for later than the hand meant it


class TappingHand:
    """Holds the stylus still, taps once the device is armed, takes the stylus back, and taps again.

    A `controller.sim.port.World`. Each tap is a simulation of its own, with its own phase and noise. While the hand
    rests or moves between two taps, nothing is integrated: the sensors say without noise where it is held, and that
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
        self._under_way = False
        self._ticks_left = self._settling = 0
        self._rest_s = SETTLE_S  # after the tap
        self._way: list[int] = []  # to another place: encoder counts tick by tick, the last first
        self._start = self._counts = 0  # where the tap begins, and where the stylus is
        self._grip_N, self._current_A = 0.0, 0.0
        self.plan(library, taps)
        self._counts = self._start

    def plan(self, library: Library, taps: Iterable[SimulatedTap]) -> None:
        """Further taps, of this library."""
        self._planned.extend((library, tap) for tap in taps)
        if self._simulator is None:
            self._prepare()

    @property
    def done(self) -> bool:
        """Nothing is left to do, and the stylus is at rest above the surface."""
        return self._simulator is None and not self._way and self._settling == 0

    def readings(self, tick: int) -> Readings:
        if self._under_way:
            assert self._simulator is not None
            r = self._simulator.readings()
            return Readings(tick, r.encoder_counts, r.grip_N, r.current_A, r.acceleration_m_s2)
        return Readings(tick, self._counts, self._grip_N, self._current_A, 0.0)

    def advance(self, output: Output) -> None:
        """One servo period; a tap begins only while the device is armed."""
        self._current_A = output.command_A
        if self._under_way:
            assert self._simulator is not None
            self._simulator.advance(output.command_A)
            self._ticks_left -= 1
            if self._ticks_left == 0:
                self._end(self._simulator)
        elif self._settling:
            self._settling -= 1
        elif self._way:
            self._counts = self._way.pop()
            # A device is armed only when its stylus has been at rest for a while.
            self._settling = 0 if self._way else self._ticks(SETTLE_S)
        elif self._simulator is not None and output.state is State.ARMED:
            self._under_way = self._counts == self._start
            self._go(self._start)

    def _end(self, simulator: Simulator) -> None:
        self._counts = _counts(simulator)
        self._simulator, self._under_way = None, False
        self._settling = self._ticks(self._rest_s)
        self._go(self._start)
        self._tapped()
        self._prepare()

    def _ticks(self, duration_s: float) -> int:
        return round(duration_s / self._dt_s)

    def _go(self, to: int) -> None:
        """Straight on to there."""
        ticks = int(np.ceil(abs(to - self._counts) * SEED_SENSORS.count_m / (BACK_M_S * self._dt_s)))
        self._way = [round(counts) for counts in np.linspace(to, self._counts, ticks, endpoint=False)]

    def _prepare(self) -> None:
        """The next tap, if there is one."""
        if not self._planned:
            return
        library, tap = self._planned.popleft()
        self._simulator, _ = tap_simulator(library, tap, self._device)
        after_s = library.time_grid().end_s + AFTER_S
        # A recording goes on for so long after its contact.
        self._rest_s = max(SETTLE_S, RECORDED_S + LATE_S - after_s)
        self._ticks_left = approach_ticks(tap.speed_m_s, self._dt_s) + int(np.ceil(after_s / self._dt_s)) + 1
        self._start, self._grip_N = _counts(self._simulator), tap.grip_N


def _counts(simulator: Simulator) -> int:
    """Of the encoder, without reading it: a reading draws noise."""
    return int(np.floor(simulator.state[0] / simulator.sensors.count_m + 0.5))
