"""From recordings to the played tap and back: solve, upload to the compiled device, tap, record, import, compare.

    python scripts/device_end_to_end.py [--library LIBRARY] [--rounds 4] [--out DIR] [--seed 0]

The compiled device serves a pseudo-terminal in real time; its scripted hand taps at every speed and grip of the
library's grid in turn, going straight on through the library's window (what a hand does of its own accord is not the
library's to predict). Motion and noise depend on the device's ticks alone, so the figures are the same in every run;
a tap of which a busy machine loses records is left to the hand's next round.
What it tells is recorded to files, and these are read by the project's importer. Each tap is compared with the
library's prediction at the speed and the grip that the device reported, blended as the device blends, behind the
accelerometer's own pole; the moment of contact is that at which the recorded encoder would have met the surface.

Twice: with the sensors as they are, where the accelerometer's noise is part of every recorded tap, and with an ideal
accelerometer and grip sensor. Exit code 1 if a latency is above 20 us rms over a condition's taps, or the NRMSE after
the one shift above 3 %: with ideal sensors of every tap, with real ones of the mean over the rounds.
"""

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from campaign.compiled_device import CompiledDevice
from common.command import Seed, at_least, run
from scipy import signal
from typer import Option

import problems
from controller.host.driver import Device
from controller.protocol.configuration import configuration_of
from controller.protocol.image import image_of
from controller.record.metrics import align
from controller.record.recorder import AFTER_S, BEFORE_S, Contact, Recorder
from controller.servo.settings import Settings
from controller.sim.plant_file import plant_bytes
from controller.sim.sensors import SEED_SENSORS, Sensors
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import device_of
from controller.waveforms.bank import bank
from controller.waveforms.prediction import predict, scene_of
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.design.build import build_library
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.recordings.recording import Recording, load_recording
from transopt.scene.strikes import recordings

MOST_LATENCY_S, MOST_NRMSE = 20e-6, 0.03
IDEAL = Sensors(accelerometer_noise_g_rtHz=0.0, accelerometer_bandwidth_Hz=1e6, grip_hysteresis=0.0, grip_noise_N=0.0)
FIRST_REST_S = 3.0  # the device is configured, loaded and armed in this time
REST_S, STARTING_S, STRAIGHT_S, ONWARD_S, RETREAT_S = 0.1, 0.03, 0.25, 0.11, 0.3
FITTED_S = 0.04  # of the approach, to the tick at which the waveform begins
MOST_ROUNDS = 3  # of the hand, per round asked for, if a busy machine loses records
LEASE_MS = 1000  # the machine may have more to do


def eased(part: float) -> float:
    """From 0 to 1 as hands move (Flash and Hogan 1985)."""
    part = min(max(part, 0.0), 1.0)
    return part**3 * (10 - 15 * part + 6 * part**2)


class StraightTaps:
    """The given taps in turn after a rest, over and over; straight in, and straight on until the window is over.

    The hand moves straight for so long that what its start has set swinging is gone at the contact.
    """

    CYCLE_S = REST_S + STARTING_S + STRAIGHT_S + ONWARD_S + RETREAT_S

    def __init__(self, taps: list[tuple[float, float]], dt_s: float) -> None:
        self.taps = taps
        self.period_s = math.ceil((FIRST_REST_S + len(taps) * self.CYCLE_S) / dt_s) * dt_s

    def contact_s(self, tap: int) -> float:
        """When the hand means to reach the surface in the first round."""
        return FIRST_REST_S + tap * self.CYCLE_S + REST_S + STARTING_S + STRAIGHT_S

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

    def carried_m_s2(self, time_s: float) -> float:
        return 0.0

    def grip_N(self, time_s: float) -> float:
        tap, into = self._at(time_s)
        grip, following = self.taps[tap][1], self.taps[(tap + 1) % len(self.taps)][1]
        return grip + (following - grip) * self._back(into)

    def _back(self, into_s: float) -> float:
        return eased((into_s - (self.CYCLE_S - RETREAT_S)) / RETREAT_S)


@dataclass(frozen=True)
class Tap:
    """One recorded tap.

    Attributes
    ----------
    speed_m_s, grip_N : that the device reported. fitted_m_s : of the recorded encoder.
    played_m_s2, predicted_m_s2 : (N,) after the shift, and what the library says. noise_m_s2 : rms in the approach.
    """

    speed_m_s: float
    grip_N: float
    fitted_m_s: float
    latency_s: float
    nrmse: float
    played_m_s2: FloatArray
    predicted_m_s2: FloatArray
    noise_m_s2: float


@dataclass(frozen=True)
class Condition:
    """All taps at one speed and grip; nrmse : of single taps, rms. nrmse_mean : of the mean over the taps."""

    speed_m_s: float
    grip_N: float
    taps: tuple[Tap, ...]

    @property
    def latency_rms_s(self) -> float:
        return float(np.sqrt(np.mean([tap.latency_s**2 for tap in self.taps])))

    @property
    def nrmse(self) -> float:
        return max(tap.nrmse for tap in self.taps)

    @property
    def nrmse_mean(self) -> float:
        played, predicted = (np.mean([getattr(tap, name) for tap in self.taps], axis=0) for name in PAIR)
        return float(np.linalg.norm(played - predicted) / np.linalg.norm(predicted))

    @property
    def noise(self) -> float:
        """What the accelerometer's noise alone makes of the NRMSE of one tap."""
        return float(
            np.mean(
                [
                    tap.noise_m_s2 * tap.predicted_m_s2.size**0.5 / np.linalg.norm(tap.predicted_m_s2)
                    for tap in self.taps
                ]
            )
        )


PAIR = ("played_m_s2", "predicted_m_s2")


def behind_pole(values: FloatArray, bandwidth_Hz: float, dt_s: float) -> FloatArray:
    """(N,) samples, straight lines between them, behind one pole; exact (Franklin et al. 1998, triangle hold)."""
    a = 2 * math.pi * bandwidth_Hz * dt_s
    keep = math.exp(-a)
    before, now = (1 - keep) / a - keep, 1 - (1 - keep) / a
    return np.asarray(signal.lfilter([now, before], [1.0, -keep], values))


def contact_of(recording: Recording) -> tuple[float, float]:
    """(time [s], speed [m/s]) at which the encoder's straight approach would have met the surface."""
    assert recording.position is not None
    times = recording.position.times_s
    fitted = (times >= -FITTED_S) & (times <= 0)
    slope, height = np.polyfit(times[fitted], recording.position.values[fitted], 1)
    return float(-height / slope), float(-slope)


def compare(library: Library, recording: Recording, bandwidth_Hz: float) -> Tap:
    """One imported recording against the library's prediction."""
    assert recording.speed_m_s is not None
    assert recording.grip_N is not None
    prediction = predict(library, recording.speed_m_s, recording.grip_N)
    contact, fitted = contact_of(recording)
    times = recording.acceleration.times_s
    played = recording.acceleration.values
    predicted = behind_pole(prediction.acceleration_m_s2, bandwidth_Hz, library.time_grid().dt_s)
    aligned = align(times - contact, played, prediction.times_s, predicted)
    return Tap(
        speed_m_s=recording.speed_m_s,
        grip_N=recording.grip_N,
        fitted_m_s=fitted,
        latency_s=aligned.latency_s,
        nrmse=aligned.nrmse,
        played_m_s2=aligned.played_m_s2,
        predicted_m_s2=predicted,
        noise_m_s2=float(np.std(played[(times >= -FITTED_S) & (times <= 0)])),
    )


def recorded(
    library: Library, hand: StraightTaps, sensors: Sensors, rounds: int, seed: int, folder: Path
) -> Recorder:
    """Upload, arm, let the hand go round until each tap is recorded so often.

    Raises
    ------
    InputError : no compiler, no pseudo-terminal; or this machine was too busy for the device's time.
    """
    settings = Settings.of(library)
    dt_s, true = settings.dt_s, Imperfections(crossover_A=0.0, sensors=sensors)
    simulator = Simulator(device_of(scene_of(library)), hand, dt_s, imperfections=true, seed=seed)
    image = image_of(bank(library), dt_s, settings.lead_s, library.meta["hand_over_samples"])
    with (
        Recorder(folder, dt_s, settings.count_m, settings.surface_counts) as recorder,
        CompiledDevice(plant_bytes(simulator, hand, hand.period_s), "--seed", str(seed)) as served,
        Device(served.name) as device,
    ):
        device.listeners.append(recorder.take)
        device.configure(configuration_of(settings))
        device.upload(image)
        # What `transopt-play check` finds out by hand needs no finding out here.
        device.checked()
        device.set_telemetry(1)
        device.arm(1.0, LEASE_MS)
        for _ in range(MOST_ROUNDS * rounds):
            device.listen(hand.period_s)
            if min(map(len, by_node(hand, recorder, dt_s))) >= rounds:
                break
        device.disarm()
    return recorder


def by_node(hand: StraightTaps, recorder: Recorder, dt_s: float) -> list[list[Contact]]:
    """Of each of the hand's taps, the contacts of which no record is lost."""
    found: list[list[Contact]] = [[] for _ in hand.taps]
    period, whole = round(hand.period_s / dt_s), round((BEFORE_S + AFTER_S) / dt_s) + 1
    for contact in recorder.contacts:
        into_s = (contact.tick % period) * dt_s
        if contact.path is not None and contact.ticks.size == whole:
            min(enumerate(found), key=lambda one: abs(hand.contact_s(one[0]) - into_s))[1].append(contact)
    return found


def imported(
    library: Library, hand: StraightTaps, recorder: Recorder, rounds: int, bandwidth_Hz: float
) -> list[Condition]:
    """Each condition's taps, read back from the files.

    Raises
    ------
    InputError : not as many were played and recorded whole.
    """
    conditions = []
    for (speed, grip), contacts in zip(hand.taps, by_node(hand, recorder, library.time_grid().dt_s), strict=True):
        if len(contacts) < rounds:
            raise InputError(
                f"{speed:g} m/s, {grip:g} N: {len(contacts)} of {rounds} taps were recorded whole, {recorder.missed} "
                f"records lost: run again on a quieter machine"
            )
        files = [contact.path for contact in contacts[:rounds] if contact.path is not None]
        taps = tuple(compare(library, load_recording(path), bandwidth_Hz) for path in files)
        conditions.append(Condition(speed, grip, taps))
    return conditions


def table(conditions: list[Condition], real: bool) -> bool:
    """Print them; whether all is as asked."""
    print("  m/s    N | reported m/s    N  taps | latency rms us | NRMSE %: worst tap  noise alone  mean of the taps")
    good = True
    for c in conditions:
        kept = c.latency_rms_s <= MOST_LATENCY_S and (c.nrmse_mean if real else c.nrmse) <= MOST_NRMSE
        good &= kept
        speed, grip = (np.mean([getattr(tap, name) for tap in c.taps]) for name in ("speed_m_s", "grip_N"))
        print(
            f"{c.speed_m_s:5g} {c.grip_N:4g} | {speed:12.4f} {grip:4.2f} {len(c.taps):5d} | "
            f"{1e6 * c.latency_rms_s:14.1f} | {100 * c.nrmse:18.2f} {100 * c.noise:12.2f} {100 * c.nrmse_mean:17.2f}"
            f"{'' if kept else '  MISSED'}"
        )
    late = np.array([tap.latency_s for c in conditions for tap in c.taps])
    print(
        f"all: latency {1e6 * np.sqrt(np.mean(late**2)):.1f} us rms, {1e6 * np.abs(late).max():.1f} us at most; "
        f"NRMSE {100 * max(c.nrmse for c in conditions):.2f} % at most, of the means "
        f"{100 * max(c.nrmse_mean for c in conditions):.2f} %",
        flush=True,
    )
    return good


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


def play(library: Library, rounds: int, seed: int, folder: Path) -> bool:
    """With real and with ideal sensors; whether all is as asked."""
    nodes = [(float(v), float(F)) for F in library.grips_N for v in library.speeds_m_s]
    hand = StraightTaps(nodes, library.time_grid().dt_s)
    good = True
    for name, sensors in (("sensors as they are", SEED_SENSORS), ("ideal accelerometer and grip sensor", IDEAL)):
        recorder = recorded(library, hand, sensors, rounds, seed, folder / name.split()[0])
        print(f"{name}: {recorder.records} records, {recorder.missed} lost, {len(recorder.contacts)} taps")
        conditions = imported(library, hand, recorder, rounds, sensors.accelerometer_bandwidth_Hz)
        good &= table(conditions, sensors is SEED_SENSORS)
    return good


def main(
    library: Annotated[Path | None, Option(help="library.npz; without it wood_on_foam is solved")] = None,
    rounds: Annotated[int, at_least(1, "taps at each condition")] = 4,
    seed: Seed = 0,
    out: Annotated[Path | None, Option(help="keep the recordings in this new folder")] = None,
) -> int:
    given = solved() if library is None else load_library(library)
    with tempfile.TemporaryDirectory(prefix="transopt-") as folder:
        return 0 if play(given, rounds, seed, out or Path(folder)) else 1


if __name__ == "__main__":
    run(main)
