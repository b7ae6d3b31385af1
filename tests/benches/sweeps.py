"""Records of swept sines on devices known exactly, with the noise of real sensors."""

from pathlib import Path

import numpy as np

from controller.record.excitation import sweep_command
from controller.record.trial_file import write_measurement
from tests.benches.identification import DEFAULT
from transopt.base.signals import FloatArray, Signal
from transopt.identify.amplifier_response import less_dead_band, simulate_current
from transopt.identify.spectrum import Trial
from transopt.plant.amplifier import Amplifier
from transopt.plant.discretise import discretise

DT_S = 1e-4
POLE_HZ, DELAY_S = 1050.0, 68e-6
CURRENT_NOISE_A, ACCELERATION_NOISE_M_S2 = 0.005, 0.2


def amplifier_trial(
    seed: int,
    *,
    amplitude_A: float = 0.5,
    offset_A: float = 0.0,
    sign: int = 1,
    crossover_A: float = 0.01,
    pole_Hz: float = POLE_HZ,
    delay_s: float = DELAY_S,
    seconds: float = 2.0,
    noise_A: float = CURRENT_NOISE_A,
    low_Hz: float = 10.0,
) -> Trial:
    """Command and measured current of one sweep to 4 kHz, with 3 mA of offset in the current monitor."""
    command = sign * sweep_command(low_Hz, 4000, seconds, amplitude_A, DT_S, offset_A)
    current = simulate_current(less_dead_band(command, crossover_A), pole_Hz, delay_s, DT_S)
    measured = current + 0.003 + noise_A * np.random.default_rng(seed).standard_normal(command.size)
    return Trial(f"trial {seed}", Signal(0.0, DT_S, command), Signal(0.0, DT_S, measured))


def device_columns(grip_N: float, seed: int, *, sign: int = 1, seconds: float = 2.0) -> dict[str, FloatArray]:
    """Columns of one sweep of the default drive at 0.75 A, 1 to 2000 Hz, its amplifier without delay.

    The accelerometer's polarity and unit are right.
    """
    command = sign * sweep_command(1, 2000, seconds, 0.75, DT_S)
    acceleration, current = discretise(DEFAULT.plant(grip_N), Amplifier(POLE_HZ, 0.0, 6.0), DT_S).rollout(command)
    random = np.random.default_rng(seed)
    return {
        "time_s": DT_S * np.arange(command.size),
        "command_A": command,
        "current_A": current + CURRENT_NOISE_A * random.standard_normal(command.size),
        "acceleration_m_s2": acceleration + ACCELERATION_NOISE_M_S2 * random.standard_normal(command.size),
    }


def save_amplifier_trial(path: Path, trial: Trial) -> Path:
    columns = {"time_s": trial.input.times_s, "command_A": trial.input.values, "current_A": trial.output.values}
    write_measurement(path, columns, {})
    return path
