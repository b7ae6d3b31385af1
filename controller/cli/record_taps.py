"""`transopt-play record tap`: taps on a real object or of a library, by a person or by a simulated hand."""

import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import typer

from controller.cli.bench import Bench, simulated_bench, striking_bench
from controller.cli.port import STOPPED, connected, load, run
from controller.device.device_file import BUILT_IN, DeviceFile
from controller.device.rail import why_at_rail
from controller.device.stated import servo_numbers
from controller.host.driver import Device
from controller.host.payload import load_playable, payload_of
from controller.record.played import height_m, met_surface
from controller.record.recorder import Contact, Recorder, make_room
from controller.record.trial_file import refuse_old, write_measurement
from controller.servo.settings import Settings
from controller.sim.sensors import noise_seed
from controller.sim.simulated_tap import SimulatedTap
from controller.sim.simulator import Imperfections, device_in, scene_like
from controller.sim.tapping import Motion, TappingHand, strike_of, tap_of
from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray
from transopt.base.writing import rounded_down
from transopt.library.library import Library

TRIGGER_SHARE = 0.7  # of the softest tap's peak is proposed for --trigger
LEAST_TRIGGER_G = 0.1  # what is proposed lies above the accelerometer's noise, 0.02 g rms


def taps_by_a_person(
    bench: Bench, out: Path, trigger_m_s2: float, described: DeviceFile, taps: int | None, seconds: float | None
) -> None:
    """A real object's taps, the device idle: one file each, which `transopt taps` and scenes read."""
    make_room(out)
    encoder, accelerometer = described.encoder, described.accelerometer
    with connected(bench.port) as device:
        recorder = Recorder(
            out,
            device.hello.dt_s,
            encoder.count_m,
            encoder.surface_counts,
            trigger_m_s2,
            accelerometer=accelerometer,
        )

        def counted() -> int:
            return len(recorder.contacts) - len(recorder.at_rail)

        title, enough = f"recording on {bench.name}", lambda: taps is not None and counted() >= taps
        _, stopped = run(bench, device, recorder, title, enough=enough, seconds=seconds)
        fault = device.fault
    bench.console.print(recorder.in_words().removeprefix("; ") or "nothing came")
    for number, why in recorder.at_rail.items():
        bench.console.print(f"tap {number} does not count and has no file: {why}", style="yellow")
    if fault is not None:
        bench.console.print(f"fault: {fault.value}", style="red")
    if stopped:
        typer.echo(STOPPED, err=True)
        raise typer.Exit(130)
    if fault is not None or not counted():
        raise typer.Exit(1)


@dataclass(frozen=True)
class Wanted:
    """Taps of a simulated hand, as asked for.

    Attributes
    ----------
    out : a folder without such files.
    speeds_m_s, grips_N : None for those of the library or scene.
    repeats : at each of them.
    wrong : with the true device and its sensors.
    seed : of it all.
    device : how its sensors are wired.
    """

    out: Path
    speeds_m_s: Sequence[float] | None
    grips_N: Sequence[float] | None
    repeats: int
    wrong: Imperfections
    seed: int
    device: DeviceFile = BUILT_IN


class TapFiles:
    """A tap at every speed and grip, each in a file of its own.

    Parameters
    ----------
    speeds_m_s, grips_N : where none were asked for.

    Raises
    ------
    InputError : the folder holds a recording already.
    """

    def __init__(self, wanted: Wanted, speeds_m_s: Sequence[float], grips_N: Sequence[float]) -> None:
        terminal.make_folder(wanted.out)
        refuse_old(wanted.out, sorted(path.name for path in wanted.out.glob("tap_*.npz")))
        self._out, self._seed, self._wrong = wanted.out, wanted.seed, wanted.wrong
        speeds, grips = wanted.speeds_m_s or speeds_m_s, wanted.grips_N or grips_N
        self._places = list(product(enumerate(speeds), enumerate(grips), range(wanted.repeats)))
        self._written: list[str] = []
        self._silent: dict[str, float] = {}  # name of a tap that was not heard -> its largest deviation, in m/s^2
        self._spoilt: dict[str, str] = {}  # name of a tap without a file -> the reason
        range_g = wanted.wrong.sensors.accelerometer_range_g
        self._accelerometer = wanted.device.accelerometer.model_copy(update={"range_g": range_g})

    def _taps(self) -> Iterator[tuple[SimulatedTap, str]]:
        wrong = replace(self._wrong, mismatch=0.0)
        for (i, speed), (j, grip), n in self._places:
            seed = noise_seed(self._seed, i, j, n)
            yield SimulatedTap(speed, grip, seed=seed, imperfections=wrong), f"tap_{speed:g}m_s_{grip:g}N_{n + 1}.npz"

    def record(
        self,
        bench: Bench,
        device: Device,
        hand: TappingHand,
        settings: Settings,
        motion_of: Callable[[SimulatedTap], Motion],
        *,
        gain: float | None = None,
        trigger_m_s2: float | None = None,
        more: Callable[[SimulatedTap, Contact], dict[str, FloatArray]] = lambda tap, contact: {},
        library: Library | None = None,
    ) -> None:
        """Tap after tap.

        Parameters
        ----------
        gain : of the library in force; None leaves the device idle.
        trigger_m_s2 : takes for a contact what the device does not report as one.
        more : columns of what is measured beside the device.
        library : the one that is played; None for a real object.
        """
        for tap, name in self._taps():
            hand.plan([motion_of(tap)])
            recorder = Recorder(None, settings.dt_s, settings.count_m, settings.surface_counts, trigger_m_s2)
            run(bench, device, recorder, name, gain=gain)
            heard = [contact for contact in recorder.contacts if np.isfinite(met_surface(contact, settings)[0])]
            if not heard:
                self._silent[name] = recorder.loudest_m_s2
                continue
            contact = heard[0]
            times_s = (contact.ticks - contact.tick) * contact.dt_s
            at_rail = why_at_rail(times_s, contact.acceleration_m_s2, self._accelerometer, library)
            if why := contact.spoilt or at_rail:
                self._spoilt[name] = why
                continue
            columns, scalars = measured(contact, settings, self._wrong.sensors.accelerometer_bandwidth_Hz)
            write_measurement(self._out / name, {**columns, **more(tap, contact)}, scalars)
            self._written.append(name)

    def tell(self, nothing: str, following: str = "") -> None:
        """What is in the folder; exit code 1 if a tap is not.

        Parameters
        ----------
        nothing : what it means that a tap was not heard. following : a line on what to do with the files.
        """
        if self._silent:
            softest_g = min(self._silent.values()) / STANDARD_GRAVITY_M_S2
            lower = softest_g * TRIGGER_SHARE
            remedy = f": give --trigger {rounded_down(lower, 1):g}, another --out" if lower >= LEAST_TRIGGER_G else ""
            softest = f", the softest of which reached {softest_g:.2g} g{remedy}" if softest_g > 0 else ""
            typer.echo(f"{nothing} in {', '.join(self._silent)}{softest}", err=True)
            raise typer.Exit(1)
        if self._spoilt:
            name, why = next(iter(self._spoilt.items()))
            typer.echo(f"{len(self._spoilt)} of {len(self._places)} taps have no file, {name}: {why}", err=True)
            raise typer.Exit(1)
        files = f"{self._out}: {len(self._written)} taps, {self._written[0]} to {self._written[-1]}"
        terminal.console().print(f"{files}\nnext: {following}" if following else files)


def measured(
    contact: Contact, settings: Settings, accelerometer_Hz: float
) -> tuple[dict[str, FloatArray], dict[str, float]]:
    """Columns and scalars of a tap as a measurement; times from contact, by the encoder."""
    contact_s, speed_m_s = met_surface(contact, settings)
    columns = {
        "time_s": (contact.ticks - contact.tick) * contact.dt_s - contact_s,
        "command_A": contact.command_A,
        "current_A": contact.current_A,
        "acceleration_m_s2": contact.acceleration_m_s2,
        "position_m": height_m(contact, settings),
    }
    speed = contact.speed_m_s if np.isfinite(contact.speed_m_s) else speed_m_s
    return columns, {"grip_N": contact.grip_N, "accelerometer_Hz": accelerometer_Hz, "speed_m_s": speed}


def taps_on_object(wanted: Wanted, scene: str, trigger_g: float, force_noise_N: float) -> None:
    """The undriven device on the scene's object, with the force on the stylus.

    The accelerometer has the range that the scene states for its simulated recordings.
    """
    if 0 in (wanted.grips_N or ()):
        raise InputError("--grips 0: only a sweep is played on the free device: name grips above 0")
    truth = scene_like(scene)
    target = truth.recordings.simulated
    if target is None:
        raise InputError(
            f"--object: {truth.name} states no simulated object: give --true-device with one, like wood_on_foam"
        )
    sensors = replace(wanted.wrong.sensors, accelerometer_range_g=target.range_g)
    wanted = replace(wanted, wrong=replace(wanted.wrong, sensors=sensors))
    dt_s, true = truth.time.dt_s, device_in(truth, wanted.wrong, wanted.seed)
    taps = TapFiles(wanted, truth.grid.speeds_m_s, truth.grid.grips_N if target.grip_N is None else [target.grip_N])
    bench, hand = striking_bench(dt_s, wanted.device)

    def force(tap: SimulatedTap, contact: Contact) -> dict[str, FloatArray]:
        """Force as a sensor under the object reads it."""
        noise = force_noise_N * np.random.default_rng([tap.seed, 6]).standard_normal(contact.ticks.size)
        return {"force_N": noise + [hand.forces_N.get(int(tick), 0.0) for tick in contact.ticks]}

    with connected(bench.port) as device:
        taps.record(
            bench,
            device,
            hand,
            Settings(dt_s, 0.0, 1.0, **servo_numbers(wanted.device, dt_s)),
            lambda tap: strike_of(target, true, tap, dt_s),
            trigger_m_s2=trigger_g * STANDARD_GRAVITY_M_S2,
            more=force,
        )
    files = f"{shlex.quote(str(wanted.out))}/tap_*.npz"
    taps.tell(
        f"nothing above {trigger_g:g} g (--trigger)",
        f"transopt taps {files}, and with 12 taps or more at several --grips "
        f"transopt identify hand {files} --out MODEL.json",
    )


def taps_of_library(wanted: Wanted, library: Path, scene: str | None) -> None:
    """A library's taps, as a device on a port plays and measures them; exit code 1 if one was not played."""
    loaded = load_playable(library)
    given = payload_of(loaded, device=wanted.device, amplifier_tolerance=wanted.wrong.mismatch)
    if given.settings.assumed_grip_N == 0 and any(wanted.grips_N or ()):
        raise InputError(f"--grips: {library} is of the free device, which nobody holds: give --grips 0")
    taps = TapFiles(wanted, loaded.speeds_m_s.tolist(), loaded.grips_N.tolist())
    true = device_in(loaded.scene() if scene is None else scene_like(scene), wanted.wrong, wanted.seed)
    bench, hand = simulated_bench(given, true, (), described=wanted.device)
    with connected(bench.port) as device:
        load(device, given, bench.console)
        taps.record(
            bench, device, hand, given.settings, lambda tap: tap_of(loaded, true, tap), gain=1.0, library=loaded
        )
    taps.tell("nothing was played")
