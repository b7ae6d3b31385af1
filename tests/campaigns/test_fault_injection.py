"""Every fault at random instants while the servo plays on the simulator: FAULT at once, nothing played, latched.

    python -m pytest -m long -n 0 tests/campaigns/test_fault_injection.py
        --campaign="[LIBRARY] [--instants 100] [--seed 0]"

Each injection has a tap of its own, with random speed, grip, hand and mismatch. A fault counts as detectable at the
first tick whose readings show it: at once for most, after the stated time or impulse for a missing current and a
stuck encoder, which this script counts for itself. There the servo must answer with FAULT, this fault and no command,
and stay so when the cause is gone until it is reset. It fails if it ever does not.
"""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import pytest

from controller.servo.interface import Fault, Output, Readings, State
from controller.servo.settings import Settings
from controller.sim.simulated_tap import approach_ticks
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import device_of
from controller.sim.user import TapUser, Tremor
from controller.waveforms.bank import Bank, bank
from tests.benches.oracle.crosscheck import Crosscheck
from tests.benches.oracle.servo import Servo
from tests.benches.own_device import OpenChannel
from tests.campaigns.harness import LibraryFile, Seed, at_least, library_of, long_form
from transopt.library.library import Library
from transopt.plant.intention import Intention

PLAYING_TICKS = 800  # of a tap; instants lie between the first reading and its end
STROKE_TICKS = 60  # in which a missing current or a stuck encoder must show
LATCHED_TICKS = 30
# Before the contact a stuck encoder is a stylus that stands still: nothing is played, and nothing is at fault.
STUCK_WITHIN = (0, 10)
STUCK_ROOM = 1.05  # of the strokes, for a speed and a grip that are not measured exactly


@dataclass(frozen=True)
class Injection:
    """One fault and how it comes about.

    Attributes
    ----------
    readings : what the sensors say instead; a function takes the true readings.
    open_circuit : the command reaches no coil. heat_K : the servo's estimate is put this much above the limit.
    channel : the encoder loses one of its two channels.
    within : ticks about the contact between which the instant is drawn; everything without.
    """

    name: str
    fault: Fault
    readings: dict[str, Any] | Callable[[Readings], dict[str, Any]]
    open_circuit: bool = False
    heat_K: float | None = None
    channel: bool = False
    within: tuple[int, int] | None = None


INJECTIONS = (
    Injection("emergency stop", Fault.EMERGENCY_STOP, {"emergency_stop": True}),
    Injection("encoder NaN", Fault.BAD_SENSOR, {"encoder_counts": math.nan}),
    Injection("encoder absurd", Fault.BAD_SENSOR, {"encoder_counts": 2**40}),
    Injection("current NaN", Fault.BAD_SENSOR, {"current_A": math.nan}),
    Injection("current infinite", Fault.BAD_SENSOR, {"current_A": -math.inf}),
    Injection("encoder jump", Fault.ENCODER_JUMP, lambda true: {"encoder_counts": true.encoder_counts + 1000}),
    Injection("grip open", Fault.GRIP_OPEN, {"grip_N": math.nan}),
    Injection("grip short", Fault.GRIP_SHORT, {"grip_N": 80.0}),
    Injection("grip lost", Fault.GRIP_LOST, {"grip_N": 0.3}, within=(0, PLAYING_TICKS - 20)),
    Injection("over-current", Fault.OVER_CURRENT, {"current_A": 5.3}),
    Injection("no current", Fault.NO_CURRENT, {}, open_circuit=True, within=(-20, 20)),
    Injection("over-temperature", Fault.OVER_TEMPERATURE, {}, heat_K=1.0),
    Injection("encoder stuck", Fault.ENCODER_STUCK, {}, within=STUCK_WITHIN),
    Injection("encoder channel open", Fault.ENCODER_STUCK, {}, within=STUCK_WITHIN, channel=True),
)


@dataclass(frozen=True)
class Outcome:
    """Ticks from the instant to the first tick that shows the fault, and from there to FAULT; what was wrong."""

    shown_after: int
    late_ticks: int
    wrong: str


class Detectable:
    """Counts, from readings and outputs alone, when a fault that needs time can be known."""

    def __init__(self, servo: Servo, kind: Fault) -> None:
        self._servo, self._kind, self._ticks, self._impulse_A_s, self._counts = servo, kind, 0, 0.0, math.nan
        self._crosscheck = Crosscheck(servo.settings)
        self._low: int | None = None

    def step(self, readings: Readings, before: Output | None) -> bool:
        s = self._servo.settings
        if self._kind is Fault.NO_CURRENT:
            expected = abs(self._servo.expected_A)
            missing = expected >= s.no_current_A and abs(readings.current_A) < s.no_current_part * expected
            self._ticks = self._ticks + 1 if missing else 0
            return self._ticks >= s.ticks(s.no_current_s)
        if self._kind is Fault.ENCODER_STUCK:
            played = 0.0 if before is None or abs(before.transient_A) < s.stuck_A else before.transient_A
            self._impulse_A_s = (
                self._impulse_A_s + played * s.dt_s if readings.encoder_counts == self._counts else 0.0
            )
            counts = int(readings.encoder_counts)
            before_low = counts if self._low is None else self._low
            # An encoder that goes back and forth between two counts has not moved.
            self._low = min(max(before_low, counts - 1), counts)
            self._counts = counts
            playing = self._servo.state is State.PLAYING
            self._crosscheck.step(self._low - before_low, readings.acceleration_m_s2, readings.current_A, playing)
            return abs(self._impulse_A_s) >= s.stuck_A_s or self._crosscheck.stuck
        if self._kind is Fault.GRIP_LOST:
            return self._servo.state is State.PLAYING
        return True


def _tap(random: np.random.Generator) -> tuple[float, float]:
    """Speed [m/s], fast enough for the strokes that a missing current is seen by, and grip [N]."""
    return float(random.uniform(0.25, 0.6)), float(random.integers(2, 17) / 2)


def _shows_stuck(library: Library, settings: Settings, speed_m_s: float, grip_N: float) -> bool:
    """Whether what is left of a tap's strokes after the instant is more than what a stuck encoder is known by."""
    strokes = library.at(speed_m_s, grip_N).command[STUCK_WITHIN[1] :]
    strokes = strokes[np.abs(strokes) >= settings.stuck_A]
    return bool(abs(strokes.sum()) * settings.dt_s > STUCK_ROOM * settings.stuck_A_s)


def inject(library: Library, table: Bank, injection: Injection, seed: int) -> Outcome:
    """One tap with one fault at a random instant."""
    random = np.random.default_rng([seed, 6])
    settings = replace(Settings.of(library), amplifier_tolerance=0.1)
    speed, grip = _tap(random)
    while injection.fault is Fault.ENCODER_STUCK and not _shows_stuck(library, settings, speed, grip):
        speed, grip = _tap(random)
    contact = approach_ticks(speed, settings.dt_s)
    intention = Intention(yields="brakes" if random.uniform() < 0.5 else "straight")
    user = TapUser(speed, grip, (contact + random.uniform()) * settings.dt_s, intention, Tremor())
    low, high = (1 - contact, PLAYING_TICKS + 100) if injection.within is None else injection.within
    instant = contact + int(random.integers(low, high))
    device = device_of(library.scene())
    imperfections = Imperfections(mismatch=float(random.uniform(0, 0.1)))
    simulator = Simulator(device, user, settings.dt_s, imperfections=imperfections, seed=seed)
    servo = Servo(settings, table)
    servo.arm()
    needs_time = Detectable(servo, injection.fault)
    before, held, shown = None, math.nan, -1
    deadline = instant + (STROKE_TICKS + 50 if injection.within is not None else 1) + 800
    for tick in range(deadline):
        readings, active = simulator.readings(), tick >= instant
        if active:
            if math.isnan(held):
                held = readings.encoder_counts
            change = injection.readings if isinstance(injection.readings, dict) else injection.readings(readings)
            if injection.fault is Fault.ENCODER_STUCK:
                open_channel = OpenChannel(int(held)).counts(int(readings.encoder_counts))
                change = {"encoder_counts": open_channel if injection.channel else held}
            readings = replace(readings, **change)
            if injection.heat_K is not None and servo.guard is not None:
                servo.guard.winding_C = servo.guard.limit_C + injection.heat_K
            if shown < 0 and needs_time.step(readings, before):
                shown = tick
        elif injection.fault in (Fault.NO_CURRENT, Fault.ENCODER_STUCK):
            needs_time.step(readings, before)
        before = servo.step(readings)
        if before.state is State.FAULT:
            break
        if shown >= 0 and tick > shown:
            return Outcome(shown - instant, tick - shown, "no FAULT within one period")
        simulator.advance(0.0 if active and injection.open_circuit else before.command_A)
    else:
        return Outcome(-1, -1, "never shown")
    if shown < 0:
        return Outcome(-1, -1, f"{servo.fault} before the fault can be seen")
    return Outcome(shown - instant, tick - shown, _wrong(servo, simulator, before, injection))


def _wrong(servo: Servo, simulator: Simulator, output: Output, injection: Injection) -> str:
    """What is not as it must be at a tick in FAULT and, with the cause gone, after it; empty if nothing."""
    if (output.command_A, output.transient_A, output.feedback_A) != (0.0, 0.0, 0.0):
        return f"commands {output.command_A:g} A in FAULT"
    if servo.fault is not injection.fault or injection.fault not in [event.what for event in output.events]:
        return f"says {servo.fault}"
    for _ in range(LATCHED_TICKS):
        simulator.advance(output.command_A)
        output = servo.step(simulator.readings())
        if servo.arm() or output.state is not State.FAULT or output.command_A != 0.0:
            return "does not latch"
    if injection.heat_K is not None and servo.guard is not None:
        servo.guard.winding_C = servo.guard.play_limit_C
        servo.step(simulator.readings())
    if not servo.reset() or servo.state is not State.IDLE:
        return "does not reset"
    return ""


def main(
    library: LibraryFile = None, instants: Annotated[int, at_least(1, "of each fault")] = 100, seed: Seed = 0
) -> int:
    solved, failed = library_of(library), False
    table = bank(solved)
    print(f"{'fault':17} {'instants':>8} {'caught':>6} {'ticks late':>10}  shown after ticks (median, most)")
    for injection in INJECTIONS:
        found = [inject(solved, table, injection, 10_000 * seed + j) for j in range(instants)]
        wrong, after = Counter(o.wrong for o in found if o.wrong), [o.shown_after for o in found]
        late = max(o.late_ticks for o in found)
        print(
            f"{injection.name:17} {instants:8d} {instants - wrong.total():6d} {late:10d}  "
            f"{np.median(after):g}, {max(after)}",
            flush=True,
        )
        for words, count in wrong.items():
            print(f"  VIOLATED {count} times: {words}")
        failed |= bool(wrong) or late > 0
    return 1 if failed else 0


test_long_form = long_form(main)


@pytest.mark.parametrize("injection", INJECTIONS, ids=lambda i: i.name)
def test_every_fault_is_caught_at_once_in_closed_loop(library: Library, tables: Bank, injection: Injection) -> None:
    outcome = inject(library, tables, injection, seed=0)
    assert outcome.wrong == ""
    assert outcome.late_ticks == 0
