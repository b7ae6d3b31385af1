"""Faults that come while a transient plays: each seen in time, and none seen on a sound device.

    python -m pytest -m long -n 0 tests/campaigns/test_faults_playing.py
        --campaign="[LIBRARY] [--runs 12] [--devices 20] [--taps 50] [--seed 0] [--single] [--json FILE]"

A device with equations of its own (`common.own_device`) stands behind the compiled core: parameters off by 10 %,
amplifier and monitor each off by 10 %, so that 22 % lie between command and reading, noise, and a PWM ripple that
every reading catches at another phase. Into taps at 0.3 m/s comes one fault each: an amplifier that stops at 1 A, a
current monitor that reads twice, one that is stuck, a stuck encoder, one with a single channel, a dead
accelerometer; before the contact in every third run, else in its first 10 ms, at an instant from which it can be
told.

What can be told is counted here, from the truth and from the readings alone: 2 ms of a current that is 0.3 A and 30
% off, ten counts of the true motion, 5 ms of a dead accelerometer in which the current has swung by an ampere. From
there on FAULT must come within 5 ms, by the right name. Then taps of sound devices at every speed and grip. It
fails if a fault is seen too late or by another name, or anything is seen on a sound device.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import pytest
from typer import Option

from controller.device.device_file import Accelerometer, DeviceFile
from controller.host.payload import Payload, payload_of
from controller.protocol import messages as m
from controller.protocol.configuration import configuration_of
from controller.protocol.image import sha256
from controller.servo.interface import Fault, Notice, Output, Readings, State
from tests.benches.device import Talker
from tests.benches.own_device import ABOVE_M, Z1, OpenChannel, OwnWorld, Truth, Wires, eased
from tests.benches.probed import ProbedDevice
from tests.campaigns.harness import JsonFile, LibraryFile, Seed, at_least, library_of, long_form, show, write_json
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.library.library import Library
from transopt.plant.wall import Wall

DT_S = 1e-4
OFF, RIPPLE_A = 0.1, 0.1
SPEED_M_S, IN_TIME_S, WITHIN_S = 0.3, 5e-3, 10e-3
STOPS_A = 1.0
COUNTS, LEAST_M = 10, 2e-4
SWING_A, SILENT_S = 1.0, 5e-3
ATTEMPTS = 20  # at a fault that can be told
LATEST_S = 1.2  # of a tap, from the moment when the person is asked for it
LEASE_TICKS, REST_TICKS = 500, 300
DEEP_M, IN_S, STAY_S, OUT_S = -8e-3, 2.0, 2.0, 0.3  # where a hand means to be that presses into a wall, and how long
LEVEL = DeviceFile(name="trial", accelerometer=Accelerometer(rest_m_s2=STANDARD_GRAVITY_M_S2))
FLAGS: dict[bool, tuple[str, ...]] = {False: (), True: ("-DTD_REAL_FLOAT",)}


@dataclass
class Seen:
    """What one tap looked like, tick by tick, from the first that played.

    Attributes
    ----------
    broken : first tick with the fault, None for none.
    truth_m, measured_A, expected_A : true place of the motor, reading of the monitor, current by the stated model.
    fault, ticks : what ended it, after so many ticks; None for nothing.
    finished : whether it played to its end.
    """

    broken: int | None
    truth_m: list[float]
    measured_A: list[float]
    expected_A: list[float]
    fault: Fault | None = None
    ticks: int = 0
    finished: bool = False


class Broken(OwnWorld):
    """A device that breaks at a tick after its transient has begun to play."""

    def __init__(self, kind: str, at: int, **world: object) -> None:
        super().__init__(DT_S, **world)  # type: ignore[arg-type]
        self.kind, self.at, self.since = kind, at, -1 if at < 0 else None
        self.kept: Readings | None = None
        self.phase = np.random.default_rng([int(world["seed"]), 3])  # type: ignore[call-overload]

    @property
    def broken(self) -> bool:
        return self.kind != "" and (self.at < 0 or (self.since is not None and self.since >= self.at))

    def readings(self, tick: int) -> Readings:
        true = super().readings(tick)
        ripple = RIPPLE_A * float(self.phase.uniform(-1, 1))
        true = true._replace(current_A=true.current_A + self.wires.monitor * ripple)
        if not self.broken:
            self.kept = true
            return true
        self.kept = held = self.kept or true
        changes: dict[str, Callable[[], Readings]] = {
            "amplifier stops": lambda: true,
            "monitor twice": lambda: true._replace(current_A=2 * true.current_A),
            "monitor stuck": lambda: true._replace(current_A=held.current_A),
            "encoder stuck": lambda: true._replace(encoder_counts=held.encoder_counts),
            "encoder channel open": lambda: true._replace(
                encoder_counts=OpenChannel(held.encoder_counts).counts(true.encoder_counts)
            ),
            "accelerometer dead": lambda: true._replace(acceleration_m_s2=held.acceleration_m_s2),
        }
        return changes[self.kind]()

    def advance(self, output: Output) -> None:
        if output.state is State.PLAYING and self.since is None:
            self.since = 0
        elif self.since is not None:
            self.since += 1
        if self.broken and self.kind == "amplifier stops":
            most_A = STOPS_A / self.wires.amplifier
            output = output._replace(command_A=min(max(output.command_A, -most_A), most_A))
        super().advance(output)


def excess(seen: Seen) -> int | None:
    """Ticks until a current was wrong for 2 ms on end."""
    wrong = 0
    for tick, (measured, expected) in enumerate(zip(seen.measured_A, seen.expected_A, strict=True)):
        wrong = wrong + 1 if abs(measured - expected) > 0.3 + 0.3 * abs(expected) else 0
        if wrong * DT_S >= 2e-3 - 1e-9:
            return tick
    return None


def moved(seen: Seen, count_m: float) -> int | None:
    """Ticks until the truth has moved by what no encoder sleeps through."""
    assert seen.broken is not None
    begin = seen.truth_m[seen.broken]
    far = np.abs(np.array(seen.truth_m[seen.broken :]) - begin) >= max(COUNTS * count_m, LEAST_M)
    return seen.broken + int(np.argmax(far)) if far.any() else None


def silent(seen: Seen) -> int | None:
    """Ticks until 5 ms of silence have seen the current swing."""
    assert seen.broken is not None
    size = round(SILENT_S / DT_S)
    for end in range(seen.broken + size, len(seen.measured_A) + 1):
        if np.ptp(seen.measured_A[end - size : end]) >= SWING_A:
            return end - 1
    return None


KINDS: dict[str, tuple[Fault, Callable[[Seen, float], int | None]]] = {
    "amplifier stops": (Fault.WRONG_CURRENT, lambda seen, _: excess(seen)),
    "monitor twice": (Fault.WRONG_CURRENT, lambda seen, _: excess(seen)),
    "monitor stuck": (Fault.WRONG_CURRENT, lambda seen, _: excess(seen)),
    "encoder stuck": (Fault.ENCODER_STUCK, moved),
    "encoder channel open": (Fault.ENCODER_STUCK, moved),
    "accelerometer dead": (Fault.ACCELEROMETER_DEAD, lambda seen, _: silent(seen)),
}
# Less than a quarter of what is expected, and more than the limit by a fourth, are known sooner by other names.
SOONER = {
    "amplifier stops": (Fault.NO_CURRENT,),
    "monitor twice": (Fault.OVER_CURRENT,),
    "monitor stuck": (Fault.NO_CURRENT,),
}
AFTER_TICKS = 100  # for so long the readings after a fault are looked at, so that what could be told is known


def tapped(given: Payload, world: Broken, speed_m_s: float, single: bool) -> Seen:
    """One tap of this world, and how the device took it."""
    talker = Talker(ProbedDevice(1, flags=FLAGS[single], simulated=True))
    assert isinstance(talker.configure(given.configuration), m.Done)
    talker.loaded(given.image)
    amplifier = given.settings.amplifier
    keep = math.exp(-amplifier.rate_rad_s * DT_S)
    seen, expected, begun = Seen(None, [], [], []), 0.0, False
    armed = m.Arm(0, 1000, 1.0, sha256(given.configuration), sha256(given.image))
    for tick in range(REST_TICKS + round(LATEST_S / DT_S)):
        if tick == REST_TICKS:
            talker.done(armed)
            world.person.tap(speed_m_s)
        if tick % LEASE_TICKS == 0:
            talker.tell(talker.lease())
        readings = world.readings(tick)
        if begun:
            seen.truth_m.append(float(world._x[Z1]))
            seen.measured_A.append(readings.current_A)
            seen.expected_A.append(expected)
            if world.broken and seen.broken is None:
                seen.broken = len(seen.truth_m) - 1
        output = talker.device.step(readings)
        expected = keep * expected + (1 - keep) * output.command_A
        begun = begun or output.state is State.PLAYING
        whats = [event.what for event in output.events]
        faults = [what for what in whats if isinstance(what, Fault)]
        if faults and seen.fault is None:
            seen.fault, seen.ticks = faults[0], len(seen.truth_m) - 1
        seen.finished = seen.finished or Notice.FINISHED in whats
        if seen.finished or (seen.fault is not None and len(seen.truth_m) > seen.ticks + AFTER_TICKS):
            break
        world.advance(output)
    return seen


def pressed(
    given: Payload, world: OwnWorld, wall: Wall, tilt_m_s2: float = 0.0, single: bool = False
) -> Fault | None:
    """The fault of a sound device whose hand goes slowly into a wall, stays, and comes out; None for none.

    Parameters
    ----------
    tilt_m_s2 : by which gravity along the accelerometer changes meanwhile, back and forth once a second.
    """
    settings = replace(given.settings, wall=wall)
    configuration = configuration_of(settings)
    talker = Talker(ProbedDevice(1, flags=FLAGS[single], simulated=True))
    assert isinstance(talker.configure(configuration), m.Done)
    talker.loaded(given.image)
    world.path_m = lambda t: DEEP_M + (ABOVE_M - DEEP_M) * (1 - eased(t / IN_S) + eased((t - IN_S - STAY_S) / OUT_S))
    for tick in range(round((IN_S + STAY_S + 2 * OUT_S) / DT_S)):
        if tick == REST_TICKS:
            talker.done(m.Arm(0, 1000, 1.0, sha256(configuration), sha256(given.image)))
        if tick % LEASE_TICKS == 0:
            talker.tell(talker.lease())
        readings = world.readings(tick)
        tilted = readings.acceleration_m_s2 + tilt_m_s2 * math.sin(2 * math.pi * world.now_s)
        output = talker.device.step(readings._replace(acceleration_m_s2=tilted))
        faults = [event.what for event in output.events if isinstance(event.what, Fault)]
        if faults:
            return faults[0]
        world.advance(output)
    return None


def sound_world(random: np.random.Generator, kind: str, at: int, grip_N: float, seed: int) -> Broken:
    """A device with every parameter, amplifier and monitor off by up to 10 %, the last two all the way."""
    wires = Wires(
        amplifier=1 + OFF * float(random.choice([-1, 1])),
        monitor=1 + OFF * float(random.choice([-1, 1])),
        accelerometer=1 + OFF * float(random.uniform(-1, 1)),
    )
    return Broken(kind, at, truth=Truth().drawn(OFF, random), wires=wires, grip_N=grip_N, seed=seed)


def faulty(given: Payload, kind: str, run: int, seed: int, single: bool) -> tuple[str, float, bool]:
    """What came, how long after it could be told [s], and whether that is right."""
    random = np.random.default_rng([seed, run, list(KINDS).index(kind)])
    fault, told = KINDS[kind]
    for _ in range(ATTEMPTS):
        at = -1 if run % 3 == 0 else int(random.integers(round(WITHIN_S / DT_S)))
        if kind.startswith("encoder") and at < 0:
            at = 0  # without an approach there is no contact, and nothing plays
        world = sound_world(random, kind, at, float(random.choice([1.0, 2.0, 3.0, 5.0])), run)
        seen = tapped(given, world, SPEED_M_S, single)
        tick = told(seen, given.settings.count_m)
        # Nothing is missed that cannot be told: another instant then.
        if seen.fault is not None or tick is not None:
            break
    late_s = math.nan if tick is None else (seen.ticks - tick) * DT_S
    if seen.fault is None:
        return "nothing", late_s, False
    right = seen.fault is fault or seen.fault in SOONER.get(kind, ())
    return seen.fault.name, late_s, right and (tick is None or late_s <= IN_TIME_S + 1e-9)


def given_of(library: Library) -> Payload:
    return payload_of(library, device=LEVEL)


def main(
    library: LibraryFile = None,
    runs: Annotated[int, at_least(1, "of each fault")] = 12,
    devices: Annotated[int, at_least(0, "that are sound")] = 20,
    taps: Annotated[int, at_least(1, "of each sound device")] = 50,
    seed: Seed = 0,
    single: Annotated[bool, Option("--single", help="the core in single precision")] = False,
    json: JsonFile = None,
) -> int:
    loaded = library_of(library)
    given, rows, good = given_of(loaded), [], True
    for kind in KINDS:
        found = [faulty(given, kind, run, seed, single) for run in range(runs)]
        late = [1e3 * late_s for _, late_s, _ in found if not math.isnan(late_s)]
        names = sorted({name for name, _, _ in found})
        right = sum(one[2] for one in found)
        good &= right == runs
        rows.append((kind, ", ".join(names), f"{max(late, default=math.nan):+.1f}", f"{right} of {runs}"))
    show(("fault at 0.3 m/s", "seen as", "at most ms late", "right"), rows)
    false = played = 0
    for device in range(devices):
        random = np.random.default_rng([seed, device, 9])
        told: list[str] = []
        for tap in range(taps):
            grip, speed = float(random.uniform(1.0, 5.0)), float(random.uniform(0.08, 0.4))
            world = sound_world(np.random.default_rng([seed, device, 8]), "", -1, grip, 1000 * device + tap)
            seen = tapped(given, world, speed, single)
            played += seen.finished
            if seen.fault is not None:
                told.append(f"{seen.fault.name} at {speed:.2f} m/s, {grip:.1f} N")
        false += len(told)
        print(f"device {device}: {taps} taps, {len(told)} false faults {'; '.join(told)}", flush=True)
    print(f"{played} taps of sound devices played to their end, {false} false faults")
    write_json({"faults": rows, "taps": played, "false": false}, json)
    return 0 if good and false == 0 and played == devices * taps else 1


test_long_form = long_form(main)


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_while_playing_is_seen_in_time(library: Library, c_compiler: None, kind: str) -> None:
    assert faulty(given_of(library), kind, 0, 0, single=False)[2]


def test_a_sound_device_plays_to_its_end(library: Library, c_compiler: None) -> None:
    world = sound_world(np.random.default_rng(1), "", -1, 3.0, 0)
    seen = tapped(given_of(library), world, SPEED_M_S, single=False)
    assert (seen.fault, seen.finished) == (None, True)


def test_a_sound_device_is_held_in_a_wall_by_a_hand_that_tilts(library: Library, c_compiler: None) -> None:
    world = sound_world(np.random.default_rng(1), "", -1, 3.0, 0)
    wall = Wall(2000.0, 1.0, 1.25, 1, 500.0)
    assert pressed(given_of(library), world, wall, tilt_m_s2=3.0) is None
