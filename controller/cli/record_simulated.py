"""`transopt-play record --simulate`: the files of a recording, and what is said about them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import typer

from controller.cli.bench import simulated_bench
from controller.cli.port import connected, load, run
from controller.host.monitor import Monitor
from controller.host.payload import payload_of
from controller.record.played import contact_s
from controller.record.recorder import Contact, Recorder
from controller.record.sweep_plan import PlannedSweep, check_plan
from controller.record.trial_file import write_measurement
from controller.servo.settings import Settings
from controller.sim.chosen_device import device_in, scene_like
from controller.sim.records import (
    Record,
    heat_record,
    noise_seed,
    object_record,
    sweep_records,
    true_coil,
)
from controller.sim.sensors import SEED_SENSORS
from controller.sim.simulated_tap import SimulatedTap
from controller.sim.simulator import Imperfections
from controller.waveforms.prediction import scene_of
from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.library.proven import load_proven

MOST_HEAT_S = 24 * 3600.0


def _empty_folder(out: Path, pattern: str) -> None:
    """Recordings are never written over."""
    terminal.make_folder(out)
    _refuse_old(out, sorted(path.name for path in out.glob(pattern)))


def _refuse_old(out: Path, names: Sequence[str]) -> None:
    old = next((name for name in names if (out / name).exists()), None)
    if old is not None:
        raise InputError(f"--out {out}: holds a recording already ({old}); choose another folder")


def _say(*lines: str) -> None:
    terminal.console().print("\n".join(lines), highlight=False, soft_wrap=True)


def _write(path: Path, taken: Record) -> str:
    write_measurement(path, taken.columns, taken.scalars)
    return path.name


def simulate_sweeps(out: Path, planned: Sequence[PlannedSweep], scene: str, wrong: Imperfections, seed: int) -> None:
    """One file per trial; another noise in each, one device for all."""
    truth = scene_like(scene)
    dt = truth.time.dt_s
    check_plan(planned, dt, truth.limits.transient_current_A)
    purpose = planned[0].purpose.value
    terminal.make_folder(out)
    # Sweeps at other grips may join those that are there: a series is recorded in one folder, as on a port.
    _refuse_old(out, [trial.file_name for trial in planned])
    device = device_in(truth, wrong, seed)
    for trial, taken in sweep_records(device, planned, dt, imperfections=wrong, seed=seed):
        _write(out / trial.file_name, taken)
    first, last = planned[0], planned[-1]
    _say(
        f"{out}: {len(planned)} sweeps of {first.seconds:g} s, {first.file_name} to {last.file_name}",
        f"next: transopt identify {purpose} {out}/{purpose}_*.npz --out MODEL.json",
    )


def simulate_object_taps(
    out: Path,
    scene: str,
    speeds: list[float] | None,
    grips: list[float] | None,
    repeats: int,
    wrong: Imperfections,
    seed: int,
    force_noise_N: float,
) -> None:
    """The undriven device on the scene's object, with the force on the stylus."""
    for grip in grips or ():
        if grip == 0:
            raise InputError("--grips 0: only a sweep is played on the free device: name grips above 0")
    truth = scene_like(scene)
    target = truth.recordings.simulated
    if target is None:
        raise InputError(
            f"--object: {truth.name} states no simulated object: give --device with one, like wood_on_foam"
        )
    _empty_folder(out, "tap_*.npz")
    device, names = device_in(truth, wrong, seed), []
    for i, speed in enumerate(speeds or truth.grid.speeds_m_s):
        for j, grip in enumerate(grips or [target.grip_N]):
            for n in range(repeats):
                taken = object_record(
                    device,
                    target,
                    speed,
                    grip,
                    truth.time.dt_s,
                    imperfections=wrong,
                    seed=noise_seed(seed, i, j, n),
                    force_noise_N=force_noise_N,
                )
                names.append(_write(out / f"tap_{speed:g}m_s_{grip:g}N_{n + 1}.npz", taken))
    _say(
        f"{out}: {len(names)} taps, {names[0]} to {names[-1]}",
        f"next: transopt taps {out}/tap_*.npz, and with 12 taps or more at several --grips "
        f"transopt identify hand {out}/tap_*.npz --out MODEL.json",
    )


def simulate_library_taps(
    out: Path,
    library: Path,
    scene: str | None,
    speeds: list[float] | None,
    grips: list[float] | None,
    repeats: int,
    wrong: Imperfections,
    seed: int,
) -> None:
    """A library's taps, as a device on a port plays and measures them; exit code 1 if one was not played."""
    loaded = load_proven(library)
    given = payload_of(loaded, amplifier_tolerance=wrong.mismatch)
    if given.settings.assumed_grip_N == 0 and any(grips or ()):
        raise InputError(f"--grips: {library} is of the free device, which nobody holds: give --grips 0")
    _empty_folder(out, "tap_*.npz")
    device = device_in(scene_of(loaded) if scene is None else scene_like(scene), wrong, seed)
    bench, hand = simulated_bench(given, device, ())
    settings, noise = given.settings, replace(wrong, mismatch=0.0)
    names, silent = [], []
    with connected(bench.port) as held:
        load(held, given, bench.console)
        for i, speed in enumerate(speeds or loaded.speeds_m_s.tolist()):
            for j, grip in enumerate(grips or loaded.grips_N.tolist()):
                for n in range(repeats):
                    tap = SimulatedTap(speed, grip, seed=noise_seed(seed, i, j, n), imperfections=noise)
                    hand.plan(loaded, [tap])
                    recorder = Recorder(None, settings.dt_s, settings.count_m, settings.surface_counts)
                    shown = Monitor(bench.console, "", settings.dt_s, settings.count_m)
                    run(held, recorder, shown, lambda: bench.done(True), None, 1.0)
                    name = f"tap_{speed:g}m_s_{grip:g}N_{n + 1}.npz"
                    if not recorder.contacts:
                        silent.append(name)
                        continue
                    [contact] = recorder.contacts
                    _write(out / name, _measured(contact, settings, wrong.sensors.accelerometer_bandwidth_Hz))
                    names.append(name)
    if silent:
        typer.echo(f"nothing was played in {', '.join(silent)}", err=True)
        raise typer.Exit(1)
    _say(f"{out}: {len(names)} taps, {names[0]} to {names[-1]}")


def _measured(contact: Contact, settings: Settings, accelerometer_Hz: float) -> Record:
    """A played tap as a measurement; times from contact."""
    columns = {
        "time_s": (contact.ticks - contact.tick) * contact.dt_s - contact_s(contact, settings),
        "command_A": contact.command_A,
        "current_A": contact.current_A,
        "acceleration_m_s2": contact.acceleration_m_s2,
        "position_m": (contact.counts - settings.surface_counts) * settings.count_m,
    }
    scalars = {"grip_N": contact.grip_N, "accelerometer_Hz": accelerometer_Hz, "speed_m_s": contact.speed_m_s}
    return Record(columns, scalars)


def simulate_heat(
    out: Path,
    scene: str,
    current_A: float | None,
    heating_s: float,
    cooling_s: float,
    every_s: float,
    noise_K: float,
    mismatch: float,
    seed: int,
) -> None:
    """One file; without a current 0.9 of the one that the motor bears for ever."""
    truth = scene_like(scene)
    coil, limits = truth.coil(), truth.limits
    if coil is None:
        raise InputError(f"record heat: {truth.name} states no motor, so no coil; give another --device")
    amount = 0.9 * limits.steady_current_A if current_A is None else current_A
    if not 0 <= amount <= limits.transient_current_A:
        raise InputError(f"--current {amount:g}: must be 0 to {limits.transient_current_A:g} A")
    _empty_folder(out, "heat.npz")
    taken = heat_record(
        true_coil(coil, mismatch, seed),
        amount,
        heating_s,
        cooling_s,
        every_s,
        noise_K=noise_K,
        current_noise_A=SEED_SENSORS.current_noise_A,
        seed=seed,
    )
    name, hottest = _write(out / "heat.npz", taken), float(taken.columns["winding_C"].max())
    _say(
        f"{out}: {name}, {heating_s:g} s at {amount:g} A and {cooling_s:g} s of cooling, winding at most "
        f"{hottest:.1f} °C",
        f"next: transopt identify coil {out}/{name} --out MODEL.json",
    )
