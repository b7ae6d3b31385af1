"""Minutes of random tapping with the compiled servo on the simulator: do the limits hold, is anything left unsaid?

    python -m pytest -m long -n 0 tests/campaigns/test_soak.py
        --campaign="[LIBRARY] [--minutes 10] [--seed 0] [--amplifier-tolerance T]"

Taps at 0.05 to 1 m/s and 0 to 10 N by hands that yield, in stretches of 10 s that take turns: the nominal device;
10 % of mismatch in every parameter; 20 % with tremor and a dead band of 50 mA; hands that let go or grasp within
50 ms of the contact, with tremor; a coil so warm that the servo has to hold back, with 10 % of mismatch. The servo is
told how far the amplifier's pole may be off, unless --amplifier-tolerance says something else. A host resets the
servo after a fault.

Checked: |i| of the true current between ticks too, the true winding's temperature, numbers in every output, a notice
for every contact that the encoder shows, within one count of it, and an explanation in the truth for every fault.
Exit code 1 on a violation.
"""

import math
import time
from collections import Counter, deque
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
import pytest
from typer import Option

from controller.firmware.core_servo import CoreServo
from controller.host.payload import payload_of
from controller.servo.interface import Fault, Notice, Output, Readings, State
from controller.servo.settings import Settings
from controller.sim.played_tap import run as play
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import device_of
from controller.sim.user import Tremor
from tests.benches.repeated_taps import RepeatedTaps
from tests.campaigns.harness import LibraryFile, Seed, library_of, long_form
from transopt.library.library import Library

STRETCH_S = 10.0
TURN_TICKS = 200  # after which the host looks whether there is a fault to reset
ALLOWED_A = 1e-6  # as the library's certificates
ABOVE_M = 1.5e-4  # a stylus above this has left the surface
SPEED_TICKS = 30  # over which the speed of a contact is taken
SLOWEST_M_S = 0.025  # slower touches need no notice; above the servo's 0.02 m/s by what 3 ms of counts leave open
SETTLED_TICKS = 150  # after a reset the servo's fit needs 100 readings, and the trigger 50 off the surface
GRIP_SLACK = 0.06  # hysteresis of the grip sensor, and its noise
ESTIMATE_K = 0.3  # by which the servo's cautious estimate of the winding may lie above the truth
ANSWERS = (Notice.CONTACT, Notice.CONTACT_CHATTER, Notice.NO_GRIP, Notice.TOO_HOT_TO_PLAY)


class Fickle:
    """Repeated taps whose hand lets go or grasps within 50 ms of some contacts.

    Parameters
    ----------
    part : of the taps.
    """

    def __init__(self, taps: RepeatedTaps, seed: int, part: float) -> None:
        self._taps, self._seed, self._part = taps, seed, part
        self._start_s, self._target_N = -1.0, math.nan

    def intention_m(self, time_s: float) -> float:
        return self._taps.intention_m(time_s)

    def carried_m_s2(self, time_s: float) -> float:
        return self._taps.carried_m_s2(time_s)

    def grip_N(self, time_s: float) -> float:
        cycle = self._taps.cycle(time_s)
        if cycle.start_s != self._start_s:
            self._start_s = cycle.start_s
            random = np.random.default_rng([self._seed, round(1e3 * cycle.start_s)])
            self._target_N = random.uniform(0.0, 10.0) if random.uniform() < self._part else math.nan
        held, after = cycle.held_N(time_s), time_s - cycle.contact_s
        if math.isnan(self._target_N) or after <= 0.0 or time_s >= cycle.retreat_s:
            return held
        back = min(max(cycle.retreat_s - time_s, 0.0) / 50e-3, 1.0)
        return held + min(after / 50e-3, back, 1.0) * (self._target_N - held)


@dataclass
class Tally:
    """What came of a run.

    Attributes
    ----------
    silent : contacts of the encoder without a notice. unexplained : faults that the truth does not show.
    slow : touches too slow for a tap.
    """

    virtual_s: float = 0.0
    contacts: int = 0
    slow: int = 0
    largest_A: float = 0.0
    excess_A: float = -math.inf
    hottest_C: float = -math.inf
    margin_K: float = math.inf
    notices: Counter[Notice] = field(default_factory=Counter)
    faults: Counter[Fault] = field(default_factory=Counter)
    silent: list[str] = field(default_factory=list)
    unexplained: list[str] = field(default_factory=list)
    absurd: int = 0

    @property
    def violations(self) -> list[str]:
        found = []
        if self.excess_A > ALLOWED_A:
            found.append(f"current {self.excess_A:.4f} A above its limit")
        if self.margin_K < 0:
            found.append(f"winding {-self.margin_K:.3f} K above its limit")
        if self.absurd:
            found.append(f"{self.absurd} outputs without a number")
        return found + self.silent + self.unexplained


@dataclass(frozen=True)
class Touched:
    """A contact that waits for its notice. ticks : of leaving the surface, of the contact, and of the last moment."""

    left: int
    tick: int
    due: int
    speed_m_s: float


class Witness:
    """Looks at every tick with what the servo does not know."""

    def __init__(self, tally: Tally, simulator: Simulator, settings: Settings, user: Fickle, name: str) -> None:
        self.tally, self.simulator, self.settings, self.user, self.name = tally, simulator, settings, user, name
        self.state = State.IDLE
        self._z = deque([0.0] * SPEED_TICKS, maxlen=SPEED_TICKS)
        self._above, self._left, self._answered, self.armed = False, 0, -1, 0
        self._touched: Touched | None = None

    def __call__(self, readings: Readings, output: Output) -> None:
        tally, tick, s, self.state = self.tally, readings.tick, self.settings, output.state
        if not math.isfinite(output.command_A + output.transient_A + output.feedback_A + output.winding_C):
            tally.absurd += 1
        tally.hottest_C = max(tally.hottest_C, self.simulator.winding_C)
        for event in output.events:
            if isinstance(event.what, Fault):
                tally.faults[event.what] += 1
                if not self._explained(event.what, readings):
                    tally.unexplained.append(f"{self.name}, {tick * s.dt_s:.4f} s: {event.what.name} out of nothing")
            else:
                tally.notices[event.what] += 1
                if event.what in ANSWERS:
                    self._answered = tick
        if self._touched is not None and (self._answered >= self._touched.left or tick >= self._touched.due):
            self._contact(self._touched)
            self._touched = None
        z = readings.encoder_counts * s.count_m
        if z > ABOVE_M and not self._above:
            self._above, self._left = True, tick
        elif z <= 0.0 and self._above:
            self._above = False
            if output.state is not State.FAULT and tick > self.armed + SETTLED_TICKS:
                speed = (self._z[0] - z) / (SPEED_TICKS * s.dt_s)
                # The servo fits the motion, which may lie within one count of what the encoder says.
                late = max(math.ceil(s.count_m / (max(speed, SLOWEST_M_S) * s.dt_s)), 1)
                self._touched = Touched(self._left, tick, tick + late, speed)
        self._z.append(z)

    def _contact(self, touched: Touched) -> None:
        if self._answered >= touched.left:
            self.tally.contacts += 1
        elif touched.speed_m_s < SLOWEST_M_S:
            self.tally.slow += 1
        else:
            self.tally.contacts += 1
            at, speed = touched.tick * self.settings.dt_s, touched.speed_m_s
            self.tally.silent.append(f"{self.name}, {at:.4f} s: a contact at {speed:.3f} m/s without a notice")

    def _explained(self, fault: Fault, readings: Readings) -> bool:
        """Whether the truth itself is at fault: a loose grip, or a coil that a wall has heated to its limit."""
        coil = self.settings.coil
        if fault is Fault.OVER_TEMPERATURE and coil is not None:
            return self.simulator.winding_C > coil.limit_C - ESTIMATE_K
        held = self.user.grip_N(self.simulator.time_s)
        return fault is Fault.GRIP_LOST and held * (1 - GRIP_SLACK) - 0.1 < self.settings.grip_min_N


@dataclass(frozen=True)
class Stretch:
    name: str
    mismatch: float = 0.0
    crossover_A: float = 0.0
    tremor: bool = False
    fickle: float = 0.0
    hot: bool = False


STRETCHES = (
    Stretch("nominal"),
    Stretch("mismatch", mismatch=0.1, crossover_A=0.01),
    Stretch("trembling", mismatch=0.2, crossover_A=0.05, tremor=True),
    Stretch("fickle", crossover_A=0.01, tremor=True, fickle=0.3),
    Stretch("hot", mismatch=0.1, crossover_A=0.01, hot=True),
)
# A hot coil starts this much below its limit, less than a tap's heat below the servo's threshold.
BELOW_LIMIT_K = 5.02


def soak(
    library: Library,
    stretch: Stretch,
    seed: int,
    tally: Tally,
    *,
    duration_s: float = STRETCH_S,
    amplifier_tolerance: float | None = None,
) -> None:
    """One stretch of tapping, added to the tally; without a tolerance the servo knows how far the device is off."""
    known = stretch.mismatch if amplifier_tolerance is None else amplifier_tolerance
    device, coil = device_of(library.scene()), {}
    if stretch.hot and device.coil is not None:
        start_C = device.coil.limit_C - BELOW_LIMIT_K
        device = replace(device, coil=replace(device.coil, start_winding_C=start_C, start_housing_C=start_C))
        coil = {"coil": device.coil}
    given = payload_of(library, amplifier_tolerance=known, **coil)
    settings, servo = given.settings, CoreServo(given.settings, given.image)
    tremor = Tremor(phase_rad=float(seed)) if stretch.tremor else None
    user = Fickle(RepeatedTaps(seed, tremor=tremor), seed, stretch.fickle)
    imperfections = Imperfections(mismatch=stretch.mismatch, crossover_A=stretch.crossover_A)
    simulator = Simulator(device, user, settings.dt_s, imperfections=imperfections, seed=seed)
    witness = Witness(tally, simulator, settings, user, f"{stretch.name} {seed}")
    servo.arm()
    left = round(duration_s / settings.dt_s)
    while left > 0:
        ticks = min(TURN_TICKS, left)
        play(simulator, servo, ticks, witness)
        left -= ticks
        if witness.state is State.FAULT:
            servo.reset()
            servo.arm()
            witness.armed = round(simulator.time_s / settings.dt_s)
    tally.virtual_s += duration_s
    tally.largest_A = max(tally.largest_A, simulator.peak_current_A)
    tally.excess_A = max(tally.excess_A, simulator.peak_current_A - settings.current_limit_A)
    if device.coil is not None:
        tally.hottest_C = max(tally.hottest_C, simulator.winding_C)
        tally.margin_K = min(tally.margin_K, device.coil.limit_C - tally.hottest_C)


def main(
    library: LibraryFile = None,
    minutes: Annotated[float, Option(min=0.01, max=1e4, help="virtual time")] = 10.0,
    seed: Seed = 0,
    amplifier_tolerance: Annotated[
        float | None, Option(help="what the servo is told; by default the stretch's mismatch")
    ] = None,
) -> int:
    tally, started, solved = Tally(), time.perf_counter(), library_of(library)
    for j in range(max(round(60 * minutes / STRETCH_S), 1)):
        stretch = STRETCHES[j % len(STRETCHES)]
        soak(solved, stretch, 1000 * seed + j, tally, amplifier_tolerance=amplifier_tolerance)
    taken = time.perf_counter() - started
    print(f"{tally.virtual_s:.0f} virtual s in {taken:.0f} s; {tally.contacts} contacts, {tally.slow} slow touches")
    for what, count in [*tally.notices.most_common(), *tally.faults.most_common()]:
        print(f"{count:6d} {type(what).__name__.lower()} {what.name}")
    margin = "" if math.isinf(tally.margin_K) else f", {tally.margin_K:.3f} K below its limit"
    print(
        f"largest |i| {tally.largest_A:.6f} A, limit {solved.input_limit:g} A; "
        f"hottest winding {tally.hottest_C:.3f} °C{margin}"
    )
    for violation in tally.violations:
        print(f"VIOLATED: {violation}")
    return 1 if tally.violations else 0


test_long_form = long_form(main)


@pytest.mark.parametrize("stretch", STRETCHES[2:], ids=lambda s: s.name)
def test_limits_hold_and_nothing_is_left_unsaid(library: Library, c_compiler: None, stretch: Stretch) -> None:
    tally = Tally()
    soak(library, stretch, 5, tally, duration_s=1.8)
    assert tally.violations == []
    assert tally.contacts >= 2
    assert tally.notices[Notice.CONTACT] >= 1
    if stretch.hot:
        assert tally.notices[Notice.SCALED_FOR_HEAT] + tally.notices[Notice.TOO_HOT_TO_PLAY] > 0


def test_a_faster_amplifier_than_the_servo_knows_is_a_violation(library: Library, c_compiler: None) -> None:
    """What the soak would find: seed 3 draws such a device."""
    tally = Tally()
    soak(library, Stretch("told nothing", mismatch=0.2), 3, tally, duration_s=3.0, amplifier_tolerance=0.0)
    assert [words.split()[0] for words in tally.violations] == ["current"]
