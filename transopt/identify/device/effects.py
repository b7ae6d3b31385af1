"""What a device does at the amplitude of use that no response shows, told apart by name.

Each candidate is a force that acts inside the drive chain, beside the linear ones, as the motion predicted by the
chain makes it: friction against the motor's velocity, play that takes back a part of the transmitted force, a skin
whose spring grows with the cube of its stretch; and an amplifier whose current falls short of the command with the
cube of it. The chain turns the force into an acceleration; the candidate that explains most of what was missed is
named. It is the first order of a perturbation: small effects add to the linear answer, each in a shape of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from transopt.base.signals import FloatArray, Signal, highpass
from transopt.identify.amplifier import simulate_current
from transopt.identify.device.chain import DriveChain
from transopt.identify.device.response import Instrument
from transopt.identify.device.trials import felt_current
from transopt.identify.device.validation import HIGHPASS_HZ, PADDING_S, Model, predict
from transopt.identify.measurement import Measurement
from transopt.identify.spectrum import ComplexArray
from transopt.plant.state_space import StateSpace
from transopt.scene.model_error import AtUse, ModelError

QUIET = 0.02  # of the predicted peak: below, a record shows its noise alone
LEAST_QUIET_S = 0.02
CERTAIN = 4.0  # deviations of the noise's energy that an excess must have
COLOURED = 4.0  # times as uncertain is the energy of noise whose neighbouring samples are alike
EXPLAINS = 0.35  # of what was missed: a candidate that explains less is not named
SHORTFALL = 0.01  # of the current that the amplifier may miss before it is named


@dataclass(frozen=True)
class Missed:
    """One record at the amplitude of use against its prediction.

    Attributes
    ----------
    run : what was recorded.
    current_A : (n,) that the prediction is of.
    residual : (n,) recorded less predicted acceleration after the high-pass [m/s^2].
    energy : of the recorded acceleration where something happens.
    excess : energy of the residual there beyond the noise's, over `energy`.
    deviation : of `excess`, by the noise alone; infinite where the record never rests, so that its noise is unknown.
    """

    run: Measurement
    current_A: FloatArray
    residual: FloatArray
    energy: float
    excess: float
    deviation: float


def missed(model: Model, grip_N: float, instrument: Instrument, run: Measurement) -> Missed:
    """What a prediction from the command misses beyond the noise; from the current where that alone was recorded.

    As a design predicts: with the amplifier's pole and delay and a gain of one. The noise is that of the record
    itself where the prediction rests.
    """
    recorded = run.require("acceleration", "acceleration_m_s2")
    current = felt_current(run if run.command is None else replace(run, current=None), instrument.amplifier)

    def passed(values: FloatArray) -> FloatArray:
        return highpass(Signal(recorded.start_s, recorded.dt_s, values), HIGHPASS_HZ).values

    at_rest = current.values - np.median(current.values[: max(3, current.values.size // 50)])
    predicted, measured = passed(predict(model, grip_N, instrument, at_rest)), passed(recorded.values)
    step = passed(np.ones(recorded.values.size))
    residual = measured - predicted
    size = np.abs(predicted)
    least = QUIET * size.max(initial=0.0)
    # Not yet begun, or rung down for good.
    quiet = (np.maximum.accumulate(size) < least) | (np.maximum.accumulate(size[::-1])[::-1] < least)
    offset = float(step[quiet] @ residual[quiet] / max(step[quiet] @ step[quiet], 1e-300)) if quiet.any() else 0.0
    residual = residual - offset * step
    busy = ~quiet
    energy = float(np.sum((measured - offset * step)[busy] ** 2))
    noise, uncertain = 0.0, np.inf
    if np.count_nonzero(quiet) * recorded.dt_s >= LEAST_QUIET_S:
        noise = float(np.mean(residual[quiet] ** 2))
        n, rest = int(np.count_nonzero(busy)), int(np.count_nonzero(quiet))
        uncertain = noise * n * float(np.sqrt(2 * COLOURED * (1 / max(n, 1) + 1 / rest)))
    excess = float(np.sum(residual[busy] ** 2)) - noise * np.count_nonzero(busy)
    scale = max(energy, np.finfo(float).tiny)
    return Missed(run, at_rest, residual, energy, excess / scale, uncertain / scale)


def at_use(found: Sequence[Missed], error: ModelError) -> list[AtUse]:
    """What each record missed beyond noise and beyond what the response's own error explains."""
    stated = []
    for one in found:
        assert one.run.grip_N is not None
        linear = error.nrmse(one.run.grip_N, one.current_A, one.run.require("acceleration", "").dt_s, one.energy) ** 2
        beyond = one.excess - linear
        significant = beyond > CERTAIN * one.deviation
        stated.append(
            AtUse(
                grip_N=one.run.grip_N,
                peak_A=max(float(np.abs(one.current_A).max()), 1e-9),
                excess=float(np.sqrt(beyond)) if significant else 0.0,
            )
        )
    return stated


def named(device: DriveChain, instrument: Instrument, found: Sequence[Missed]) -> list[tuple[str, float]]:
    """Candidates that explain what the records missed, and which part of it; the best first.

    Parameters
    ----------
    found : records with a significant excess.
    """
    if not found:
        return []
    fitted: dict[str, float] = {}
    for name in ("friction", "backlash", "stiffening"):
        explained, wanted = 0.0, 0.0
        for one in found:
            shape = _shape(name, device, instrument, one.run)
            along = float(shape @ one.residual)
            if along > 0:  # the other sign is no such effect
                explained += along**2 / max(float(shape @ shape), np.finfo(float).tiny)
            wanted += max(one.excess, 0.0) * one.energy
        fitted[name] = explained / max(wanted, np.finfo(float).tiny)
    best = max(fitted, key=lambda name: fitted[name])
    return [(best, min(fitted[best], 1.0))] if fitted[best] > EXPLAINS else []


def _shape(name: str, device: DriveChain, instrument: Instrument, run: Measurement) -> FloatArray:
    """(n,) acceleration after the high-pass that a candidate of some size adds [m/s^2]."""
    assert run.grip_N is not None
    plant = device.plant(run.grip_N)
    current = felt_current(run, instrument.amplifier)
    values = current.values - np.median(current.values[: max(3, current.values.size // 50)])
    n = plant.order // 2
    masses = np.concatenate([device.shared[:2], device.hand_at(run.grip_N)[:1]])[:n]
    velocities, stretches = np.eye(plant.order)[n : n + n], np.eye(plant.order)[:n]
    if name == "friction":
        motion = _through(plant, plant.B[:, 0], velocities[0], 0.0, current.dt_s, values)
        forces = {0: -np.tanh(motion / (0.02 * np.abs(motion).max(initial=1e-12)))}
    elif name == "backlash":
        stretch = _through(plant, plant.B[:, 0], stretches[0], 0.0, current.dt_s, values)
        part = np.tanh(stretch / (0.02 * np.abs(stretch).max(initial=1e-12)))
        forces = {0: part, 1: -part}
    else:
        if n < 3:
            return np.zeros(values.size)
        stretch = _through(plant, plant.B[:, 0], stretches[1], 0.0, current.dt_s, values)
        part = (stretch / np.abs(stretch).max(initial=1e-12)) ** 3
        forces = {1: -part, 2: part}
    total = np.zeros(values.size)
    for mass, force in forces.items():
        given = np.zeros(plant.order)
        given[n + mass] = 1 / masses[mass]
        total += _through(plant, given, plant.C[0], 1 / masses[1] if mass == 1 else 0.0, current.dt_s, force)
    return highpass(Signal(current.start_s, current.dt_s, total), HIGHPASS_HZ).values


def _through(
    plant: StateSpace, given: FloatArray, row: FloatArray, direct: float, dt_s: float, values: FloatArray
) -> FloatArray:
    """(n,) what an input along `given` makes of an output `row`, from rest."""
    size = fft.next_fast_len(values.size + round(PADDING_S / dt_s), real=True)
    s = 2j * np.pi * np.maximum(fft.rfftfreq(size, dt_s), 0.1)
    poles, modes = np.linalg.eig(plant.A)
    gains = (row @ modes) * np.linalg.solve(modes, given.astype(complex))
    ratio: ComplexArray = (gains / (s[:, None] - poles)).sum(axis=1) + direct
    return np.asarray(fft.irfft(fft.rfft(values, size) * ratio, size)[: values.size])


def current_shortfall(instrument: Instrument, run: Measurement) -> float:
    """Part of the current that the amplifier fell short of, as the cube of the command shows it; 0 if none."""
    if run.current is None or run.command is None or instrument.amplifier is None:
        return 0.0
    amplifier = instrument.amplifier
    expected = instrument.amplifier_gain * simulate_current(
        run.command.values, amplifier.pole_Hz, amplifier.delay_s, run.command.dt_s
    )
    measured = run.current.values - np.median(run.current.values[: max(3, expected.size // 50)])
    peak = max(float(np.abs(expected).max()), 1e-12)
    shapes = np.stack([expected, expected**3 / peak**2], axis=1)
    _, cube = np.linalg.lstsq(shapes, measured, rcond=None)[0]
    return max(float(-cube), 0.0)
