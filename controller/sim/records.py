"""What identification needs, recorded from the simulator's truth: sweeps, taps, the coil's heating."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from controller.record.sweep_plan import PlannedSweep
from controller.servo.interface import Readings
from controller.sim.open_loop import Sensed, play_still
from controller.sim.sensors import Sensors
from controller.sim.simulated_tap import STEPS_AT_CONTACT, approach_ticks
from controller.sim.simulator import Coil, Imperfections, Simulator
from controller.sim.true_device import TrueDevice
from controller.sim.user import TapUser
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.plant.coil import CoilModel, effective_square
from transopt.recordings.settings import SimulatedTaps

OBJECT_AFTER_S = 60e-3  # recorded after contact with a real object
HEAT_STEP_S = 0.05  # of the coil's integration: 1/240 of the winding's time constant, an error of microkelvins


def noise_seed(seed: int, *place: int) -> int:
    """Another noise for each trial of one device."""
    return int(np.random.SeedSequence([seed, 7, *place]).generate_state(1, np.uint64)[0] >> 1)


@dataclass(frozen=True)
class Record:
    """One measurement: columns and scalars as `measurement_file.write_measurement` takes them."""

    columns: dict[str, FloatArray]
    scalars: dict[str, float]


def _record(times_s: FloatArray, command_A: FloatArray, sensed: Sensed, sensors: Sensors, **scalars: float) -> Record:
    columns = {
        "time_s": times_s,
        "command_A": command_A,
        "current_A": sensed.current_A,
        "acceleration_m_s2": sensed.acceleration_m_s2,
        "position_m": sensed.position_m,
    }
    known = {"grip_N": float(sensed.grip_N.mean()), "accelerometer_Hz": sensors.accelerometer_bandwidth_Hz}
    return Record(columns, {**known, **scalars})


def sweep_records(
    device: TrueDevice, trials: Sequence[PlannedSweep], dt_s: float, *, imperfections: Imperfections, seed: int
) -> Iterator[tuple[PlannedSweep, Record]]:
    """Each trial played while the user holds still.

    Parameters
    ----------
    device : the true one. seed : of the noise, which is another in each trial.
    """
    for j, trial in enumerate(trials):
        command = trial.command(dt_s)
        sensed = play_still(
            device, trial.grip_N, command, dt_s, imperfections=imperfections, seed=noise_seed(seed, j)
        )
        times = np.asarray(dt_s * np.arange(command.size))
        # Nobody holds a free device, whatever the grip sensor's noise says.
        free = {"grip_N": 0.0} if trial.grip_N == 0 else {}
        yield trial, _record(times, command, sensed, imperfections.sensors, **free)


def _sensed(readings: Sequence[Readings], count_m: float) -> Sensed:
    return Sensed(
        position_m=count_m * np.array([r.encoder_counts for r in readings], dtype=float),
        grip_N=np.array([r.grip_N for r in readings]),
        current_A=np.array([r.current_A for r in readings]),
        acceleration_m_s2=np.array([r.acceleration_m_s2 for r in readings]),
    )


def object_record(
    device: TrueDevice,
    target: SimulatedTaps,
    speed_m_s: float,
    grip_N: float,
    dt_s: float,
    *,
    imperfections: Imperfections,
    seed: int,
    force_noise_N: float,
) -> Record:
    """The undriven device strikes a real object under a force sensor; times from contact.

    Parameters
    ----------
    seed : of phase and noise. force_noise_N : rms, of the force that the object exerts on the stylus.
    """
    random = np.random.default_rng([seed, 6])
    approach, phase = approach_ticks(speed_m_s, dt_s), float(random.uniform())
    contact = (approach + phase) * dt_s
    simulator = Simulator(
        device,
        TapUser(speed_m_s, grip_N, contact),
        dt_s,
        imperfections=replace(imperfections, mismatch=0.0),
        seed=seed,
        target=target,
        steps=STEPS_AT_CONTACT,
        trace=True,
    )
    ticks = approach + int(np.ceil(OBJECT_AFTER_S / dt_s)) + 1
    readings = []
    for _ in range(ticks):
        readings.append(simulator.readings())
        simulator.advance(0.0)
    per_tick = simulator.steps * len(simulator.step_s)
    force = simulator.trace().contact_N[::per_tick][:ticks]
    times = np.asarray(dt_s * np.arange(ticks) - contact)
    sensed = _sensed(readings, imperfections.sensors.count_m)
    record = _record(times, np.zeros(ticks), sensed, imperfections.sensors, speed_m_s=speed_m_s)
    measured = force + force_noise_N * random.standard_normal(ticks)
    return replace(record, columns={**record.columns, "force_N": measured})


def true_coil(model: CoilModel, mismatch: float, seed: int) -> CoilModel:
    """The coil with both thermal resistances and both time constants times 1 +- `mismatch`, independent and uniform.

    Only for a heating record: in a tap the simulated coil is the scene's, since no limit there feels the difference.
    """
    R_wh, R_ha, tau_w, tau_h = 1 + mismatch * np.random.default_rng([seed, 8]).uniform(-1, 1, 4)
    return replace(
        model,
        R_wh_K_W=model.R_wh_K_W * float(R_wh),
        R_ha_K_W=model.R_ha_K_W * float(R_ha),
        tau_w_s=model.tau_w_s * float(tau_w),
        tau_h_s=model.tau_h_s * float(tau_h),
    )


def heat_record(
    model: CoilModel,
    current_A: float,
    heating_s: float,
    cooling_s: float,
    every_s: float,
    *,
    noise_K: float,
    current_noise_A: float,
    seed: int,
) -> Record:
    """A constant current from the coil's rest, then none; the winding as its resistance tells it.

    Row k is read at k `every_s`; the current of row k flows until row k + 1.

    Parameters
    ----------
    model : the true coil. noise_K, current_noise_A : rms.

    Raises
    ------
    InputError : the winding would leave its limit.
    """
    rows = round((heating_s + cooling_s) / every_s) + 1
    current = np.where(np.arange(rows) < round(heating_s / every_s), current_A, 0.0)
    steps = max(round(every_s / HEAT_STEP_S), 1)
    coil, winding, housing = Coil(model), np.empty(rows), np.empty(rows)
    for k, square in enumerate(effective_square(current).tolist()):
        winding[k], housing[k] = coil.winding_C, coil.housing_C
        if coil.winding_C > model.limit_C:
            raise InputError(
                f"record heat: the winding would pass its limit of {model.limit_C:g} C after {k * every_s:g} s at "
                f"{current_A:g} A; lower --current or --heating"
            )
        for _ in range(steps):
            coil.step(square, every_s / steps)
    random = np.random.default_rng([seed, 9])
    columns = {
        "time_s": every_s * np.arange(rows),
        "current_A": current + current_noise_A * random.standard_normal(rows),
        "winding_C": winding + noise_K * random.standard_normal(rows),
        "housing_C": housing + noise_K * random.standard_normal(rows),
    }
    return Record({name: np.asarray(values) for name, values in columns.items()}, {})
