"""Records of identification on a drive of other make, with what goes wrong on real ones, one effect at a time."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from tests.benches.other_device import (
    ACCELEROMETER_HZ,
    HAND,
    TICK_S,
    Device,
    FloatArray,
    Motion,
    Truth,
    simulate,
    true_device,
)

GRIPS_N = (1.0, 2.0, 3.0, 4.0, 5.0)
TAPS = (
    (0.1, 1.0),
    (0.4, 1.0),
    (0.1, 3.0),
    (0.4, 3.0),
    (0.1, 5.0),
    (0.4, 5.0),
)  # speed m/s, grip N; the latter at the limit
NOISE_M_S2_RTHZ = 320e-6 * 9.80665  # ADXL321, in front of its pole
CURRENT_NOISE_A = 5e-3
COUNT_M = 24.5e-6
ACCELERATION_RANGE_M_S2, CURRENT_RANGE_A = 20 * 9.80665, 8.0  # of the converters, to either side
DAQ_STEP_S = 20e-6
PERIOD_S, PERIODS, MULTISINE_A = 0.5, 4, 3.0
VARIED_DEVICES = 8  # hands over which the error of a hand that varies is taken


@dataclass(frozen=True)
class Effect:
    """One way in which the world is not as assumed.

    Attributes
    ----------
    causes : names by which a refusal may rightly call it; none for one that has to be predicted.
    device : numbers of `Device` that it changes. square_root, cubic_length_m : see `Truth`.
    accelerometer_Hz : its true pole. stated : whether the record says so.
    varying : part by which each number of the hand is off, anew in each trial.
    bits : of the converters of current and acceleration; 0: perfect ones.
    pink_m_s2, pink_A : rms of noise whose power falls as 1/f.
    hum_m_s2, hum_A : amplitude at 50 Hz, a third of it at 150 Hz.
    tremor_N : rms of a force on the hand between 8 and 12 Hz.
    jitter_s : rms by which time stamps are off. clock : how fast the clock of the time stamps goes.
    daq : a card of its own at 50 kHz, whose clock knows nothing of the servo's.
    late_ticks : by which acceleration is read late. gain : of the accelerometer.
    """

    causes: tuple[str, ...] = ()
    device: dict[str, float] = field(default_factory=dict)
    square_root: bool = False
    cubic_length_m: float = 0.0
    accelerometer_Hz: float = ACCELEROMETER_HZ
    stated: bool = True
    varying: float = 0.0
    bits: int = 0
    pink_m_s2: float = 0.0
    pink_A: float = 0.0
    hum_m_s2: float = 0.0
    hum_A: float = 0.0
    tremor_N: float = 0.0
    jitter_s: float = 0.0
    clock: float = 1.0
    daq: bool = False
    late_ticks: int = 0
    gain: float = 1.0


def _mode(mass_kg: float, frequency_Hz: float, damping_ratio: float) -> dict[str, float]:
    rate = 2 * np.pi * frequency_Hz
    return {
        "mode_mass": mass_kg,
        "mode_stiffness": mass_kg * rate**2,
        "mode_damping": 2 * damping_ratio * mass_kg * rate,
    }


EFFECTS = {
    "none": Effect(),
    "adc_10": Effect(("quantisation",), bits=10),
    "adc_12": Effect(("quantisation",), bits=12),
    "pink": Effect(pink_m_s2=0.5, pink_A=0.01),
    "hum": Effect(("hum",), hum_m_s2=0.5, hum_A=0.02),
    "tremor": Effect(("tremor",), tremor_N=0.1),
    "jitter": Effect(("jittered sampling",), jitter_s=10e-6),
    "clock": Effect(("clock",), clock=1.01),
    "daq": Effect(("clock",), daq=True),
    "mode_600": Effect(("resonance",), device=_mode(0.002, 600.0, 0.03)),
    "grip_law": Effect(("grip law",), square_root=True),
    "drift": Effect(("varying hand",), device={"drift": 0.1}),
    "varying": Effect(("varying hand",), varying=0.1),
    "friction": Effect(("friction",), device={"friction": 0.05}),
    "backlash": Effect(("backlash",), device={"half_gap": 5e-6}),
    "stiffening": Effect(("stiffening",), cubic_length_m=0.5e-3),
    "soft_limit": Effect(("amplifier saturation",), device={"soft_limit": 5.0}),
    "pole": Effect(("unstated accelerometer pole",), accelerometer_Hz=1500.0, stated=False),
    "late": Effect(("read delay",), late_ticks=1),
    "gain": Effect(("accelerometer or encoder gain",), gain=1.2),
}


def truth(effect: str, seed: int) -> Truth:
    """The true device of a seed, with what the effect changes of it."""
    what, plain = EFFECTS[effect], true_device(seed)
    rate = 2 * np.pi * what.accelerometer_Hz
    return replace(
        plain,
        shared=replace(plain.shared, sensor_rate=rate, **what.device),
        square_root=what.square_root,
        cubic_length_m=what.cubic_length_m,
    )


def _hand_of_trial(device: Device, part: float, random: np.random.Generator) -> Device:
    factors = 1 + part * random.uniform(-1, 1, len(HAND))
    values = {name: getattr(device, name) * float(f) for name, f in zip(HAND, factors, strict=True)}
    return replace(device, **values)


def played(effect: str, seed: int, grip_N: float, command_A: FloatArray, delay_s: float) -> list[FloatArray]:
    """What the true device does with a command, without noise: acceleration [m/s^2] at k `TICK_S` + `delay_s`, (N,).

    One array; of a hand that varies one for each of some hands.
    """
    device, part = truth(effect, seed).at(grip_N), EFFECTS[effect].varying
    device = replace(device, drift=0.0)  # a tap is short: the hand is as stated
    random = np.random.default_rng([seed, 4])
    devices = [_hand_of_trial(device, part, random) for _ in range(VARIED_DEVICES)] if part else [device]
    longer = np.append(command_A, np.zeros(20))
    at = delay_s + TICK_S * np.arange(command_A.size)
    found = []
    for one in devices:
        motion = simulate(one, longer, stride=1)
        times = motion.dt_s * np.arange(motion.acceleration_m_s2.size)
        found.append(CubicSpline(times, motion.acceleration_m_s2)(at))
    return found


def sweep(
    low_Hz: float = 1.0, high_Hz: float = 2000.0, seconds: float = 2.0, amplitude_A: float = 0.75
) -> FloatArray:
    """(N,) logarithmic sweep that rises over half a period of the lowest and falls over ten of the highest [A]."""
    t = TICK_S * np.arange(round(seconds / TICK_S))
    octaves = np.log(high_Hz / low_Hz)
    phase = 2 * np.pi * low_Hz * t[-1] / octaves * np.expm1(octaves * t / t[-1])
    rise, fall = min(0.05 * t[-1], 0.5 / low_Hz), min(0.05 * t[-1], 10 / high_Hz)
    window = (
        np.sin(np.pi / 2 * np.clip(t / rise, 0, 1)) ** 2 * np.sin(np.pi / 2 * np.clip((t[-1] - t) / fall, 0, 1)) ** 2
    )
    return np.asarray(amplitude_A * window * np.sin(phase))


@cache
def multisine() -> FloatArray:
    """(N,) `PERIODS` periods of odd lines from 2 Hz to 1 kHz, equally many per octave [A].

    Every third odd line and all even ones are left out: what the device answers there is distortion. Of a hundred
    drawings of the phases the one with the lowest peak is taken, and scaled to `MULTISINE_A`.
    """
    samples = round(PERIOD_S / TICK_S)
    wanted = np.geomspace(1, 1000 * PERIOD_S, 90)
    odd = np.unique(2 * np.round((wanted - 1) / 2).astype(int) + 1)
    lines = np.delete(odd, slice(2, None, 3))
    k, best = np.arange(samples), np.array([np.inf])
    random = np.random.default_rng(3)
    for _ in range(100):
        phases = random.uniform(0, 2 * np.pi, lines.size)
        wave = np.cos(2 * np.pi * np.outer(k, lines) / samples + phases).sum(axis=1)
        wave /= np.sqrt(np.mean(wave**2))
        best = min(best, wave, key=lambda one: float(np.abs(one).max()))
    return np.tile(MULTISINE_A / np.abs(best).max() * best, PERIODS)


def _pink(size: int, step_s: float, random: np.random.Generator) -> FloatArray:
    """(size,) of unit rms, power as 1/f from 0.5 Hz on."""
    frequencies = np.fft.rfftfreq(size, step_s)
    lines = random.standard_normal(frequencies.size) + 1j * random.standard_normal(frequencies.size)
    lines[frequencies < 0.5] = 0
    lines[1:] /= np.sqrt(frequencies[1:])
    wave = np.fft.irfft(lines, size)
    return np.asarray(wave / np.sqrt(np.mean(wave**2)))


def _tremor(size: int, random: np.random.Generator) -> FloatArray:
    """(size,) of unit rms between 8 and 12 Hz, at the ticks."""
    t, wave = TICK_S * np.arange(size), np.zeros(size)
    for frequency, phase in zip(random.uniform(8, 12, 8), random.uniform(0, 2 * np.pi, 8), strict=True):
        wave += 0.5 * np.sin(2 * np.pi * frequency * t + phase)
    return wave


def _hum(times_s: FloatArray, amplitude: float, random: np.random.Generator) -> FloatArray:
    first, third = random.uniform(0, 2 * np.pi, 2)
    return np.asarray(amplitude * (np.sin(100 * np.pi * times_s + first) + np.sin(300 * np.pi * times_s + third) / 3))


def _converted(values: FloatArray, span: float, bits: int) -> FloatArray:
    step = 2 * span / 2**bits
    return np.asarray(step * np.round(np.clip(values, -span, span) / step))


def _read(motion: Motion, command: FloatArray, what: Effect, random: np.random.Generator) -> dict[str, FloatArray]:
    """Times and what the sensors have at them, without noise: at the ticks or by a card with a clock of its own."""
    late = np.zeros(what.late_ticks)
    signals = {
        "current_A": motion.current_A,
        "acceleration_m_s2": np.concatenate([late, motion.sensed_m_s2])[: motion.sensed_m_s2.size],
        "position_m": motion.position_m,
    }
    if not what.daq:
        return {"time_s": TICK_S * np.arange(command.size), "command_A": command, **signals}
    step = DAQ_STEP_S * (1 + 50e-6 * random.uniform(-1, 1))
    own = np.arange(random.uniform(0, step), TICK_S * (command.size - 1), step)
    fine = motion.dt_s * np.arange(motion.current_A.size)
    read = {name: CubicSpline(fine, values)(own) for name, values in signals.items()}
    held = command[np.floor(own / TICK_S).astype(int)]
    return {"time_s": DAQ_STEP_S * np.arange(own.size), "command_A": held, **read}


def record(effect: str, seed: int, grip_N: float, command_A: FloatArray, number: int) -> dict[str, Any]:
    """One trial as a file of a measurement holds it: columns by name, and scalars; its noise is that of `number`."""
    what = EFFECTS[effect]
    random = np.random.default_rng([seed, number, round(1000 * grip_N)])
    device = truth(effect, seed).at(grip_N)
    if what.varying:
        device = _hand_of_trial(device, what.varying, random)
    push = what.tremor_N * _tremor(command_A.size, random) if what.tremor_N else None
    columns = _read(simulate(device, command_A, push_N=push, stride=1 if what.daq else 25), command_A, what, random)
    times = columns["time_s"]
    size, step = times.size, float(times[1] - times[0])
    # White noise behind one pole, sampled: exact for any step.
    rate = 2 * np.pi * what.accelerometer_Hz
    kept, deviation = np.exp(-rate * step), NOISE_M_S2_RTHZ * np.sqrt(rate / 4)
    white = random.standard_normal(size + 200)
    sensed = what.gain * columns["acceleration_m_s2"]
    sensed = sensed + deviation * lfilter([np.sqrt(1 - kept**2)], [1, -kept], white)[200:]
    current = columns["current_A"] + CURRENT_NOISE_A * random.standard_normal(size)
    if what.pink_m_s2:
        sensed, current = (
            sensed + what.pink_m_s2 * _pink(size, step, random),
            current + what.pink_A * _pink(size, step, random),
        )
    if what.hum_m_s2:
        sensed, current = sensed + _hum(times, what.hum_m_s2, random), current + _hum(times, what.hum_A, random)
    if what.bits:
        sensed = _converted(sensed, ACCELERATION_RANGE_M_S2, what.bits)
        current = _converted(current, CURRENT_RANGE_A, what.bits)
    columns["acceleration_m_s2"], columns["current_A"] = sensed, current
    columns["position_m"] = COUNT_M * np.round(columns["position_m"] / COUNT_M + random.uniform(-0.5, 0.5))
    columns["time_s"] = what.clock * times + what.jitter_s * random.standard_normal(size)
    scalars = {"grip_N": grip_N}
    if what.stated:
        scalars["accelerometer_Hz"] = what.accelerometer_Hz
    return {**columns, **scalars}


@cache
def tap_commands() -> dict[tuple[float, float], FloatArray]:
    """(speed, grip) -> (N,) command of the default scene's library, solved for the nominal device."""
    from transopt.design.build import build_library
    from transopt.scene import builtin
    from transopt.scene.recordings import recordings_of

    scene = builtin.load_scene("wood_on_foam")
    library = build_library(scene, recordings_of(scene)).library
    return {
        (float(speed), float(grip)): np.array(library.command[iv, ig])
        for iv, speed in enumerate(library.speeds_m_s)
        for ig, grip in enumerate(library.grips_N)
    }


def make_records(
    folder: Path,
    effect: str,
    seed: int,
    *,
    grips_N: Sequence[float] = GRIPS_N,
    trials: int = 4,
    multisines: bool = True,
    taps: Sequence[tuple[float, float]] = TAPS,
) -> list[Path]:
    """Sweeps of either polarity, a multisine per grip and held-out taps as NPZ files in `folder`; their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths: list[Path] = []

    def write(name: str, grip: float, command: FloatArray, **scalars: float) -> None:
        path = folder / f"{name}.npz"
        np.savez_compressed(path, **record(effect, seed, grip, command, len(paths)), **scalars)
        paths.append(path)

    for grip in grips_N:
        for trial in range(trials):
            write(f"sweep_{grip:g}N_{trial + 1}", grip, (-1) ** trial * sweep())
        if multisines:
            write(f"multisine_{grip:g}N", grip, multisine(), period_s=PERIOD_S * EFFECTS[effect].clock)
    for speed, grip in taps:
        if grip in grips_N:
            command = np.concatenate([np.zeros(200), tap_commands()[speed, grip], np.zeros(400)])
            write(f"tap_{speed:g}_{grip:g}N", grip, command, held_out=1.0, speed_m_s=speed)
    return paths
