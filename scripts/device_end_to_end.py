"""From recordings to the played tap and back: solve, upload to the compiled device, tap, record, compare.

    python scripts/device_end_to_end.py [--library LIBRARY] [--rounds 4] [--out DIR] [--seed 0]

The compiled device serves a pseudo-terminal in real time; its scripted hand taps at every speed and grip of the
library's grid in turn, in straight motion. Motion and noise depend on the device's ticks only, so the figures do not
depend on the machine. If a busy machine loses records of a tap, the hand repeats it in its next round. Each tap is
recorded and compared with the library's prediction as by `transopt-play tap` (`controller.record.played`): at the
speed and grip that the device reported, through the accelerometer's pole, from the instant at which the recorded
encoder would have met the surface until the hand can react.

This is done twice: with the real sensors, whose noise is in every recorded tap, and with an ideal accelerometer and
grip sensor. Exit code 1 if a latency exceeds 20 us rms over a condition's taps, or the playback error after the
common shift exceeds 3 %: for every tap with ideal sensors, for the mean over the rounds with real ones.
"""

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from common.command import Seed, at_least, run
from typer import Option

import problems
from controller.device.device_file import Accelerometer
from controller.host.driver import Device, arm_at_rest
from controller.protocol.configuration import configuration_of
from controller.protocol.image import image_of
from controller.record.played import PlayedTap, played_tap
from controller.record.recorder import Contact, Recorder
from controller.servo.settings import Settings
from controller.sim.compiled_device import CompiledDevice
from controller.sim.plant_file import plant_bytes
from controller.sim.sensors import SEED_SENSORS, Sensors
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import device_of
from controller.waveforms.bank import bank
from transopt.base.errors import InputError
from transopt.base.writing import table
from transopt.design.build import build_library
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.scene.strikes import recordings

MOST_LATENCY_S, MOST_ERROR = 20e-6, 0.03
IDEAL = Sensors(accelerometer_noise_g_rtHz=0.0, accelerometer_bandwidth_Hz=1e6, grip_hysteresis=0.0, grip_noise_N=0.0)
FIRST_REST_S = 3.0  # the device is configured, loaded and armed in this time
REST_S, STARTING_S, STRAIGHT_S, ONWARD_S, RETREAT_S = 0.1, 0.03, 0.25, 0.11, 0.3
MOST_ROUNDS = 3  # rounds of the hand per requested round, if a busy machine loses records
LEASE_MS = 1000  # a long lease, as the machine may be busy
HEAD = (
    "m/s",
    "N",
    "reported m/s",
    "N",
    "taps",
    "latency rms us",
    "playback error %: worst tap",
    "mean",
    "tap error %",
    "kept",
)
Node = tuple[float, float]  # speed [m/s], grip [N]


def eased(part: float) -> float:
    """Minimum-jerk transition from 0 to 1, as hands move (Flash and Hogan 1985)."""
    part = min(max(part, 0.0), 1.0)
    return part**3 * (10 - 15 * part + 6 * part**2)


class StraightTaps:
    """The given taps in turn after a rest, repeated; the hand moves straight until the window ends.

    It moves straight long enough for the oscillations of its start to decay before contact.
    """

    CYCLE_S = REST_S + STARTING_S + STRAIGHT_S + ONWARD_S + RETREAT_S

    def __init__(self, taps: list[Node], dt_s: float) -> None:
        self.taps = taps
        self.period_s = math.ceil((FIRST_REST_S + len(taps) * self.CYCLE_S) / dt_s) * dt_s

    def _at(self, time_s: float) -> tuple[int, float]:
        into = time_s % self.period_s - FIRST_REST_S
        if into < 0:
            return 0, 0.0
        tap = min(int(into / self.CYCLE_S), len(self.taps) - 1)
        return tap, into - tap * self.CYCLE_S

    def _height_m(self, tap: int) -> float:
        return self.taps[tap % len(self.taps)][0] * (STARTING_S / 2 + STRAIGHT_S)

    def intention_m(self, time_s: float) -> float:
        tap, into = self._at(time_s)
        speed, moving = self.taps[tap][0], into - REST_S
        if moving <= 0:
            return self._height_m(tap)
        started = min(moving, STARTING_S)
        onward = min(moving, STARTING_S + STRAIGHT_S + ONWARD_S)
        z = self._height_m(tap) - speed * (started**2 / (2 * STARTING_S) + onward - started)
        return z + (self._height_m(tap + 1) - z) * self._back(into)

    def grip_N(self, time_s: float) -> float:
        tap, into = self._at(time_s)
        grip, following = self.taps[tap][1], self.taps[(tap + 1) % len(self.taps)][1]
        return grip + (following - grip) * self._back(into)

    def _back(self, into_s: float) -> float:
        return eased((into_s - (self.CYCLE_S - RETREAT_S)) / RETREAT_S)


@dataclass(frozen=True)
class Condition:
    """All taps at one speed and grip."""

    node: Node
    taps: tuple[PlayedTap, ...]

    @property
    def latency_rms_s(self) -> float:
        return float(np.sqrt(np.mean([tap.compared.latency_s**2 for tap in self.taps])))

    @property
    def playback_errors(self) -> tuple[float, float]:
        """Playback error of the worst tap, and the mean."""
        errors = [tap.compared.playback_error for tap in self.taps]
        return max(errors), float(np.mean(errors))

    @property
    def tap_error(self) -> float:
        """Tap error relative to the recorded tap, mean over the taps."""
        return float(np.mean([tap.compared.tap_error for tap in self.taps]))

    def kept(self, noisy: bool) -> bool:
        return self.latency_rms_s <= MOST_LATENCY_S and self.playback_errors[noisy] <= MOST_ERROR


def by_node(nodes: list[Node], contacts: list[Contact]) -> dict[Node, list[Contact]]:
    """The contacts without lost records, each under the nearest speed and grip."""
    found: dict[Node, list[Contact]] = {node: [] for node in nodes}
    for contact in contacts:
        if contact.path is not None:
            reported = contact.speed_m_s, contact.grip_N
            found[min(nodes, key=lambda node: math.dist(np.log(node), np.log(reported)))].append(contact)
    return found


def recorded(
    library: Library, nodes: list[Node], sensors: Sensors, rounds: int, seed: int, folder: Path
) -> list[Condition]:
    """Upload, arm, and repeat the hand's rounds until each tap is recorded so many times; each condition's taps.

    Raises
    ------
    InputError : no compiler, no pseudo-terminal; or this machine was too busy for the device's time.
    """
    settings = Settings.of(library)
    dt_s, accelerometer = settings.dt_s, Accelerometer(bandwidth_Hz=sensors.accelerometer_bandwidth_Hz)
    hand = StraightTaps(nodes, dt_s)
    true = Imperfections(crossover_A=0.0, sensors=sensors)
    simulator = Simulator(device_of(library.scene()), hand, dt_s, imperfections=true, seed=seed)
    with (
        Recorder(folder, dt_s, settings.count_m, settings.surface_counts) as recorder,
        CompiledDevice(plant_bytes(simulator, hand, hand.period_s), "--seed", str(seed)) as served,
        Device(served.name) as device,
    ):
        device.listeners.append(recorder.take)
        device.configure(configuration_of(settings))
        device.upload(image_of(bank(library), dt_s, settings.lead_s, library.hand_over_samples))
        # The bring-up check of `transopt-play check` is not needed on a simulated device.
        device.set_telemetry(1)
        arm_at_rest(device, LEASE_MS, hand.period_s)
        for _ in range(MOST_ROUNDS * rounds + 1):
            device.listen(hand.period_s)
            found = by_node(nodes, recorder.contacts)
            if min(map(len, found.values())) >= rounds:
                break
        device.disarm()
    least = min(map(len, found.values()))
    if least < rounds:
        raise InputError(
            f"{least} of {rounds} taps of a condition were recorded whole, {recorder.missed} records lost: run again "
            f"on a quieter machine"
        )
    return [
        Condition(node, tuple(played_tap(one, library, settings, 1.0, accelerometer) for one in contacts[:rounds]))
        for node, contacts in found.items()
    ]


def told(conditions: list[Condition], noisy: bool) -> bool:
    """Print the conditions; whether all meet the requirements."""
    rows = []
    for c in conditions:
        reported = np.mean([(tap.contact.speed_m_s, tap.contact.grip_N) for tap in c.taps], axis=0)
        errors = (f"{100 * error:.2f}" for error in (*c.playback_errors, c.tap_error))
        rows.append(
            [*c.node, *np.round(reported, 3), len(c.taps), f"{1e6 * c.latency_rms_s:.1f}", *errors, c.kept(noisy)]
        )
    late_us = 1e6 * np.array([tap.compared.latency_s for c in conditions for tap in c.taps])
    worst, mean = (100 * max(errors) for errors in zip(*(c.playback_errors for c in conditions), strict=True))
    print("\n".join(table(HEAD, rows)))
    print(
        f"all: latency {np.sqrt(np.mean(late_us**2)):.1f} us rms, {np.abs(late_us).max():.1f} us at most; "
        f"playback error {worst:.2f} % at most, of the means {mean:.2f} %",
        flush=True,
    )
    return all(c.kept(noisy) for c in conditions)


def solved() -> Library:
    """The default scene's library, solved here.

    Raises
    ------
    InputError : it cannot be solved.
    """
    scene = problems.load("wood_on_foam")
    library = build_library(scene, recordings(scene)).library
    if library is None:
        raise InputError("wood_on_foam: not every entry could be solved; see `transopt solve wood_on_foam`")
    return library


def main(
    library: Annotated[Path | None, Option(help="library.npz; without it wood_on_foam is solved")] = None,
    rounds: Annotated[int, at_least(1, "taps at each condition")] = 4,
    seed: Seed = 0,
    out: Annotated[Path | None, Option(help="keep the recordings in this new folder")] = None,
) -> int:
    given, good = solved() if library is None else load_library(library), True
    nodes = [(float(v), float(F)) for F in given.grips_N for v in given.speeds_m_s]
    with tempfile.TemporaryDirectory(prefix="transopt-") as folder:
        for name, sensors in (("sensors as they are", SEED_SENSORS), ("ideal accelerometer and grip sensor", IDEAL)):
            print(f"{name}:")
            place = (out or Path(folder)) / name.split()[0]
            good &= told(recorded(given, nodes, sensors, rounds, seed, place), sensors is SEED_SENSORS)
    return 0 if good else 1


if __name__ == "__main__":
    run(main)
