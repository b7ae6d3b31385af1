"""The device of the seed's Figs. 1, 5, 6 and 7: real taps, amplifier, stylus and hand, all in the simulator."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from controller.sim.open_loop import Sensed, play_still
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from controller.record.excitation import sweep_command
from controller.sim.sensors import SEED_SENSORS
from controller.sim.simulated_tap import Struck, strike_real
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import device_of
from controller.sim.user import TapUser
from seed.plots import REFERENCE, logarithmic
from transopt.base.plotting import DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT, colours, style
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray, Signal
from transopt.identify.amplifier import AmplifierFit, fit_amplifier, sampled_response
from transopt.identify.spectrum import TransferEstimate, Trial, estimate_transfer
from transopt.plant.amplifier import Amplifier
from transopt.scene.scene import Scene

LINES = ("-", "--", "-.", (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (8, 2)))
AS_BUILT = Imperfections()  # the simulator's crossover distortion and sensors, parameters as stated
SETTLED_S = 0.3  # of silence after a sweep, in which the response to it dies away


def swept(
    scene: Scene, grip_N: float, low_Hz: float, high_Hz: float, duration_s: float, amplitude_A: float
) -> tuple[Signal, Sensed]:
    """A sweep of the command while the device is held still, and what the sensors read."""
    dt_s = scene.time.dt_s
    sweep = sweep_command(low_Hz, high_Hz, duration_s, amplitude_A, dt_s)
    command = np.concatenate([sweep, np.zeros(round(SETTLED_S / dt_s))])
    sensed = play_still(device_of(scene), grip_N, command, dt_s, imperfections=AS_BUILT, seed=1)
    return Signal(0.0, dt_s, command), sensed


# ------------------------------------------------------------------------------------------------ Fig. 1

REAL_TAP_S = 30e-3


@dataclass(frozen=True)
class RealTap:
    speed_m_s: float
    grip_N: float
    struck: Struck

    @property
    def peak_g(self) -> float:
        return float(np.abs(self.struck.acceleration_m_s2).max()) / STANDARD_GRAVITY_M_S2

    @property
    def pulse_s(self) -> float:
        """From contact to where the first push ends."""
        after = self.struck.times_s > 0
        pushed = self.struck.acceleration_m_s2[after] > 0
        start = int(np.argmax(pushed))
        return float(self.struck.times_s[after][start + int(np.argmin(pushed[start:]))])


def real_tap(scene: Scene, speed_m_s: float, grip_N: float) -> RealTap:
    target = scene.recordings.simulated
    assert target is not None
    return RealTap(
        speed_m_s, grip_N, strike_real(device_of(scene), target, speed_m_s, grip_N, REAL_TAP_S, scene.time.dt_s)
    )


def real_taps_figure(by_speed: Sequence[RealTap], by_grip: Sequence[RealTap]) -> Figure:
    """Seed Fig. 1: stylus acceleration [g] while a real object is struck, by speed and by grip."""
    figure = Figure(figsize=(7.6, 3.4), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    texts: tuple[tuple[Sequence[RealTap], str, Callable[[RealTap], str]], ...] = (
        (by_speed, f"grip {by_speed[0].grip_N:g} N", lambda tap: f"{tap.speed_m_s:g} m/s"),
        (by_grip, f"speed {by_grip[0].speed_m_s:g} m/s", lambda tap: f"{tap.grip_N:g} N"),
    )
    for axes, (taps, title, label) in zip(panels, texts, strict=True):
        style(axes)
        for tap, colour, line in zip(taps, colours(len(taps)), LINES, strict=False):
            values = tap.struck.acceleration_m_s2 / STANDARD_GRAVITY_M_S2
            axes.plot(tap.struck.times_s * 1e3, values, color=colour, linestyle=line, linewidth=1.3, label=label(tap))
        axes.set_title(title, fontsize=LABEL_PT)
        axes.set_xlabel("time after contact [ms]", fontsize=LABEL_PT)
        axes.set_xlim(-1.5, REAL_TAP_S * 1e3)
        axes.legend(fontsize=SMALL_PT, frameon=False)
    panels[0].set_ylabel("acceleration [g]", fontsize=LABEL_PT)
    return figure


# ------------------------------------------------------------------------------------------------ Fig. 5

AMPLIFIER_HZ, AMPLIFIER_S = (10.0, 4000.0), 2.0
AMPLIFIER_STEPS = 5  # integration steps per segment of a servo period, so that the rise within it is seen
LOUD_A, QUIET_A = 2.0, 0.1  # the crossover's dead band is 0.01 A


def amplifier_fit(scene: Scene, amplitude_A: float) -> AmplifierFit:
    """Pole, delay, gain and dead band of the simulated amplifier, from a sweep and its current monitor."""
    command, sensed = swept(scene, 3.0, *AMPLIFIER_HZ, AMPLIFIER_S, amplitude_A)
    return fit_amplifier([Trial(f"{amplitude_A:g} A", command, replace(command, values=sensed.current_A))])


def amplifier_figure(scene: Scene, amplifier: Amplifier, fits: dict[float, AmplifierFit]) -> Figure:
    """Seed Fig. 5: step and frequency response of the simulated amplifier against its model.

    Parameters
    ----------
    fits : by the amplitude of the sweep [A].
    """
    dt_s = scene.time.dt_s
    figure = Figure(figsize=(8.4, 3.6), layout="constrained")
    left, right = figure.subfigures(1, 2, squeeze=False)[0]
    step = left.subplots()
    style(step)
    times = np.linspace(-1e-4, 8e-4, 901)
    model = -np.expm1(-amplifier.rate_rad_s * np.maximum(times - amplifier.delay_s, 0.0))
    step.plot(times * 1e3, (times >= 0).astype(float), color=DARK, linewidth=0.8, linestyle=":", label="command")
    step.plot(times * 1e3, model, color=REFERENCE, linewidth=3.0, label="model")
    still, steps = TapUser(0.0, 3.0, 0.0), AMPLIFIER_STEPS
    for amplitude, colour, line in zip(fits, (OPTIMUM, SEED), ("-", "--"), strict=True):
        simulator = Simulator(device_of(scene), still, dt_s, imperfections=AS_BUILT, seed=1, steps=steps, trace=True)
        for command in (0.0, *[amplitude] * 8):
            simulator.advance(command)
        trace, look = simulator.trace(), {"color": colour, "linestyle": line, "linewidth": 1.1}
        label = f"simulator, {amplitude:g} A"
        step.plot((trace.times_s - dt_s) * 1e3, trace.current_A / amplitude, label=label, **look)
    step.set_xlim(-0.1, 0.8)
    step.set_xlabel("time after the command [ms]", fontsize=LABEL_PT)
    step.set_ylabel("current per command", fontsize=LABEL_PT)
    step.legend(fontsize=SMALL_PT, frameon=False, loc="lower right")

    magnitude, phase = right.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    fine = np.geomspace(*AMPLIFIER_HZ, 300)
    wanted = sampled_response(fine, amplifier.pole_Hz, amplifier.delay_s, dt_s)
    _bode(magnitude, phase, fine, wanted, {"color": REFERENCE, "linewidth": 3.0})
    for (amplitude, fit), colour, marker in zip(fits.items(), (OPTIMUM, SEED), "o^", strict=True):
        dots = {"color": colour, "linestyle": "", "marker": marker, "markersize": 3.0}
        found = fit.estimate
        _bode(magnitude, phase, found.frequencies_Hz, found.response, {**dots, "label": f"sweep of {amplitude:g} A"})
    logarithmic(magnitude, y=False)
    for axes in (magnitude, phase):
        style(axes)
    magnitude.set_ylim(0, 1.1)
    magnitude.legend(fontsize=SMALL_PT, frameon=False, loc="lower left")
    magnitude.set_ylabel("current per command", fontsize=LABEL_PT)
    phase.set_ylabel("phase [deg]", fontsize=LABEL_PT)
    phase.set_xlabel("frequency [Hz]", fontsize=LABEL_PT)
    return figure


def _bode(
    magnitude: Axes, phase: Axes, frequencies_Hz: FloatArray, response: FloatArray, line: dict[str, Any]
) -> None:
    magnitude.plot(frequencies_Hz, np.abs(response), **line)
    phase.plot(frequencies_Hz, np.degrees(np.unwrap(np.angle(response))), **line)


# ------------------------------------------------------------------------------------------------ Fig. 6

SWEEP_HZ, SWEEP_A = (0.7, 1500.0), 1.0
SHOWN_HZ = (1.0, 1000.0)


def sweep_response(scene: Scene, grip_N: float, duration_s: float) -> TransferEstimate:
    """Acceleration per current [m/s^2/A] from a sweep, the accelerometer's known pole taken out."""
    command, sensed = swept(scene, grip_N, *SWEEP_HZ, duration_s, SWEEP_A)
    current, acceleration = (replace(command, values=v) for v in (sensed.current_A, sensed.acceleration_m_s2))
    found = estimate_transfer([Trial("sweep", current, acceleration)], band_Hz=SHOWN_HZ)
    behind_pole = 1 / (1 + 1j * found.frequencies_Hz / SEED_SENSORS.accelerometer_bandwidth_Hz)
    return replace(found, response=found.response / behind_pole)


def deviation(scene: Scene, grip_N: float, found: TransferEstimate, from_Hz: float) -> tuple[float, float]:
    """Rms deviation of a sweep from the model above a frequency [dB, deg]."""
    used = found.frequencies_Hz >= from_Hz
    ratio = found.response[used] / scene.plant(grip_N).response(found.frequencies_Hz[used])
    size, turned = 20 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio))
    return float(np.sqrt(np.mean(size**2))), float(np.sqrt(np.mean(turned**2)))


def sweep_figure(scene: Scene, grip_N: float, found: TransferEstimate) -> Figure:
    """Seed Fig. 6: current to stylus acceleration, from a sweep and from the model."""
    figure = Figure(figsize=(5.6, 5.4), layout="constrained")
    magnitude, phase, coherence = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 1))
    fine = np.geomspace(*SHOWN_HZ, 500)
    model, g = scene.plant(grip_N).response(fine) / STANDARD_GRAVITY_M_S2, STANDARD_GRAVITY_M_S2
    _bode(magnitude, phase, fine, model, {"color": REFERENCE, "linewidth": 3.0, "label": f"model, {grip_N:g} N"})
    dots = {"color": OPTIMUM, "linestyle": "", "marker": "o", "markersize": 3.0, "label": "simulator, sweep"}
    _bode(magnitude, phase, found.frequencies_Hz, found.response / g, dots)
    coherence.plot(found.frequencies_Hz, found.coherence, color=OPTIMUM, linewidth=1.2)
    for axes in (magnitude, phase, coherence):
        style(axes)
    logarithmic(magnitude, y=True)
    magnitude.set_ylabel("acceleration per current [g/A]", fontsize=LABEL_PT)
    magnitude.legend(fontsize=SMALL_PT, frameon=False, loc="upper left")
    phase.set_ylabel("phase [deg]", fontsize=LABEL_PT)
    phase.set_yticks([-90, 0, 90, 180])
    coherence.set_ylabel("coherence", fontsize=LABEL_PT)
    coherence.set_ylim(0, 1.05)
    coherence.set_xlabel("frequency [Hz]", fontsize=LABEL_PT)
    coherence.set_xlim(*SHOWN_HZ)
    return figure


# ------------------------------------------------------------------------------------------------ Fig. 7


@dataclass(frozen=True)
class Shape:
    """|G| at one grip: slopes in dB per decade, size at 80 Hz, and the resonance."""

    grip_N: float
    slow_dB_decade: float
    fast_dB_decade: float
    at_80_Hz_g_A: float
    resonance_Hz: float
    resonance_g_A: float


def shape(scene: Scene, grip_N: float) -> Shape:
    def size(frequencies_Hz: FloatArray) -> FloatArray:
        return np.abs(scene.plant(grip_N).response(frequencies_Hz)) / STANDARD_GRAVITY_M_S2

    def slope(low_Hz: float, high_Hz: float) -> float:
        low, high = size(np.array([low_Hz, high_Hz]))
        return float(20 * np.log10(high / low) / np.log10(high_Hz / low_Hz))

    fine = np.geomspace(100.0, 2000.0, 2000)
    peak = int(np.argmax(size(fine)))
    return Shape(
        grip_N=grip_N,
        slow_dB_decade=slope(1.0, 4.0),
        fast_dB_decade=slope(5.0, 80.0),
        at_80_Hz_g_A=float(size(np.array([80.0]))[0]),
        resonance_Hz=float(fine[peak]),
        resonance_g_A=float(size(fine)[peak]),
    )


def family_figure(scene: Scene, grips_N: Sequence[float]) -> Figure:
    """Seed Fig. 7: |G| over the grips."""
    figure = Figure(figsize=(5.6, 3.8), layout="constrained")
    axes = figure.subplots()
    style(axes)
    fine = np.geomspace(*SHOWN_HZ, 500)
    for grip, colour, line in zip(grips_N, colours(len(grips_N)), LINES, strict=False):
        size = np.abs(scene.plant(grip).response(fine)) / STANDARD_GRAVITY_M_S2
        axes.plot(fine, size, color=colour, linestyle=line, linewidth=1.4, label=f"{grip:g} N")
    logarithmic(axes, y=True)
    axes.set_xlim(*SHOWN_HZ)
    axes.set_xlabel("frequency [Hz]", fontsize=LABEL_PT)
    axes.set_ylabel("acceleration per current [g/A]", fontsize=LABEL_PT)
    axes.legend(fontsize=SMALL_PT, frameon=False, title="grip", title_fontsize=SMALL_PT)
    return figure
