"""A simulated hand that taps in turn: a world behind the port `sim:`."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from controller.record.recorder import AFTER_S as RECORDED_S
from controller.servo.interface import Output, Readings, State
from controller.sim.sensors import SEED_SENSORS
from controller.sim.simulated_tap import AFTER_S, SimulatedTap, approach_ticks, object_simulator, tap_simulator
from controller.sim.simulator import Simulator
from controller.sim.true_device import TrueDevice
from transopt.library.library import Library
from transopt.recordings.settings import SimulatedTaps

BACK_M_S = 0.5  # speed of the hand between two taps
SETTLE_S = 30e-3  # rest after each tap, in which the last telemetry arrives, and after each move
LATE_S = 5e-3  # largest delay of the device's contact against the intended one


@dataclass(frozen=True)
class Motion:
    """One tap, about to begin.

    Attributes
    ----------
    simulator : simulator of this tap alone, with its own phase and noise.
    grip_N : grip on the way to where the tap begins.
    approach_ticks : servo periods until the intention reaches the surface.
    after_s : duration of the tap from there on.
    """

    simulator: Simulator
    grip_N: float
    approach_ticks: int
    after_s: float


def tap_of(library: Library, device: TrueDevice, tap: SimulatedTap) -> Motion:
    """A tap on the surface that a library renders; `device` is the true device without the tap's imperfections."""
    grid = library.time_grid()
    simulator, _ = tap_simulator(library, tap, device)
    # The tap continues to the end of the library's time grid, at which the hand's motion is over.
    after_s = max(AFTER_S, grid.after_stages * grid.dt_s)
    return Motion(simulator, tap.grip_N, approach_ticks(tap.speed_m_s, grid.dt_s), grid.end_s + after_s)


def strike_of(target: SimulatedTaps, device: TrueDevice, tap: SimulatedTap, dt_s: float) -> Motion:
    """A tap on a real object by the undriven device."""
    simulator = object_simulator(target, device, tap, dt_s)
    return Motion(simulator, tap.grip_N, approach_ticks(tap.speed_m_s, dt_s), RECORDED_S + LATE_S)


class TappingHand:
    """A hand that holds the stylus still, taps, moves it back, and taps again; a `controller.sim.port.World`.

    While the hand rests or moves between two taps nothing is integrated: the sensors read, without noise, its place
    and the commanded current.

    Parameters
    ----------
    when : state of the device in which a tap may begin.
    pause_s : rest before a tap that is planned while the hand is idle.
    tapped : called after each tap.

    Attributes
    ----------
    forces_N : tick -> force of a struck object on the stylus, by a force sensor that is not part of the device.
    """

    def __init__(
        self,
        dt_s: float,
        motions: Iterable[Motion] = (),
        *,
        when: State = State.ARMED,
        pause_s: float = 0.0,
        tapped: Callable[[], None] = lambda: None,
    ) -> None:
        self._dt_s, self._when, self._pause_s, self._tapped = dt_s, when, pause_s, tapped
        self.forces_N: dict[int, float] = {}
        self._planned: Iterator[Motion] = iter(())
        self._motion: Motion | None = None  # the next tap, or the present one
        self._under_way = False
        self._ticks_left = self._settling = 0
        self._way: list[int] = []  # encoder counts of a move, tick by tick, the last first
        self._start = self._counts = 0  # counts where the tap begins, and present counts
        self._grip_N, self._current_A = 0.0, 0.0
        self._count_m = SEED_SENSORS.count_m
        self.plan(motions)
        self._counts = self._start

    def plan(self, motions: Iterable[Motion]) -> None:
        """Add further taps; the iterable is advanced when the previous tap is over."""
        self._planned = chain(self._planned, motions)
        if self._motion is None:
            self._prepare()
            self._settling = max(self._settling, self._ticks(self._pause_s))

    @property
    def done(self) -> bool:
        """Whether no tap is left and the stylus is at rest above the surface."""
        return self._motion is None and not self._way and self._settling == 0

    def readings(self, tick: int) -> Readings:
        if self._under_way:
            assert self._motion is not None
            simulator = self._motion.simulator
            r = simulator.readings()
            self.forces_N[tick] = simulator.contact_N
            return Readings(tick, r.encoder_counts, r.grip_N, r.current_A, r.acceleration_m_s2)
        return Readings(tick, self._counts, self._grip_N, self._current_A, 0.0)

    def advance(self, output: Output) -> None:
        """One servo period."""
        self._current_A = output.command_A
        if self._under_way:
            assert self._motion is not None
            self._motion.simulator.advance(output.command_A)
            self._ticks_left -= 1
            if self._ticks_left == 0:
                self._end(self._motion)
        elif self._settling:
            self._settling -= 1
        elif self._way:
            self._counts = self._way.pop()
            # A device can be armed only after its stylus has been at rest for a while.
            self._settling = 0 if self._way else self._ticks(SETTLE_S)
        elif self._motion is not None and output.state is self._when:
            self._under_way = self._counts == self._start
            self._go(self._start)

    def _end(self, motion: Motion) -> None:
        self._counts = _counts(motion.simulator)
        self._motion, self._under_way = None, False
        # A recording needs `RECORDED_S` after its contact.
        self._settling = self._ticks(max(SETTLE_S, RECORDED_S + LATE_S - motion.after_s))
        self._go(self._start)
        self._tapped()
        self._prepare()

    def _ticks(self, duration_s: float) -> int:
        return round(duration_s / self._dt_s)

    def _go(self, to: int) -> None:
        self._way = straight_way(self._counts, to, self._dt_s, self._count_m)

    def _prepare(self) -> None:
        """Take the next planned tap, if there is one."""
        self._motion = next(self._planned, None)
        if self._motion is None:
            return
        self._ticks_left = self._motion.approach_ticks + int(np.ceil(self._motion.after_s / self._dt_s)) + 1
        self._start, self._grip_N = _counts(self._motion.simulator), self._motion.grip_N
        self._count_m = self._motion.simulator.sensors.count_m


def straight_way(start: int, end: int, dt_s: float, count_m: float) -> list[int]:
    """Encoder counts tick by tick of a straight move from start to end, the last first."""
    ticks = int(np.ceil(abs(end - start) * count_m / (BACK_M_S * dt_s)))
    return [round(counts) for counts in np.linspace(end, start, ticks, endpoint=False)]


def _counts(simulator: Simulator) -> int:
    """Counts of the encoder from the state, since a reading would draw noise."""
    return int(np.floor(simulator.state[0] / simulator.sensors.count_m + 0.5))
