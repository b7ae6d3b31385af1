"""The device of the seed's Figs. 1, 5, 6 and 7: real taps, amplifier, stylus and hand, all in the simulator."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import optimize, signal

from controller.sim.sensors import SEED_SENSORS
from controller.sim.simulated_tap import Struck, strike_real
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import device_of
from controller.sim.user import TapUser
from seed.plots import REFERENCE, logarithmic
from transopt.base.plotting import DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT, colours, style
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.scene.scene import Scene

LINES = ("-", "--", "-.", (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (8, 2)))
AS_BUILT = Imperfections()  # the simulator's crossover distortion and sensors, parameters as stated


def hands_off(scene: Scene, grip_N: float, steps: int, *, trace: bool) -> Simulator:
    """The device held still at a grip: the hand means to stay where it is."""
    user = TapUser(0.0, grip_N, 0.0)
    return Simulator(
        device_of(scene), user, scene.time.dt_s, imperfections=AS_BUILT, seed=1, steps=steps, trace=trace
    )


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

AMPLIFIER_HZ = np.geomspace(20.0, 4000.0, 17)
SETTLING_S, LEAST_S, PERIODS = 5e-3, 20e-3, 2  # of each sine
AMPLIFIER_STEPS = 5  # integration steps per segment of a servo period, so that the rise within it is seen
LOUD_A, QUIET_A = 2.0, 0.1  # the crossover's dead band is 0.01 A


def sine_response(scene: Scene, amplitude_A: float) -> FloatArray:
    """(m,) complex current per command of sines issued at the servo's ticks, at `AMPLIFIER_HZ`.

    The fundamental of the true current by least squares; the hold's part is in it.
    """
    dt, found = scene.time.dt_s, []
    for f in AMPLIFIER_HZ:
        ticks = round((SETTLING_S + max(PERIODS / f, LEAST_S)) / dt)
        simulator = hands_off(scene, 3.0, AMPLIFIER_STEPS, trace=True)
        for command in amplitude_A * np.sin(2 * np.pi * f * np.arange(ticks) * dt):
            simulator.advance(float(command))
        trace = simulator.trace()
        settled = trace.times_s > SETTLING_S
        turn = np.exp(2j * np.pi * f * trace.times_s[settled])
        # The steps are not even; the constant takes up what the settling has left.
        weight = np.sqrt(np.gradient(trace.times_s[settled]))
        basis = np.column_stack([turn.imag, turn.real, np.ones(turn.size)]) * weight[:, None]
        inphase, ahead, _ = np.linalg.lstsq(basis, trace.current_A[settled] * weight)[0]
        found.append((inphase + 1j * ahead) / amplitude_A)
    return np.array(found)


def amplifier_model(pole_Hz: float, delay_s: float, dt_s: float, frequencies_Hz: FloatArray) -> FloatArray:
    """(m,) hold, delay and pole: current per command sequence."""
    f = np.asarray(frequencies_Hz)
    late = np.exp(-2j * np.pi * f * (dt_s / 2 + delay_s))
    return np.asarray(np.sinc(f * dt_s) * late / (1 + 1j * f / pole_Hz))


def fitted_amplifier(response: FloatArray, dt_s: float) -> tuple[float, float, float]:
    """Gain, pole [Hz] and delay beyond the hold [s] that fit a measured response best."""

    def left(parameters: FloatArray) -> FloatArray:
        gain, pole, delay = parameters
        error = gain * amplifier_model(pole * 1e3, delay * 1e-4, dt_s, AMPLIFIER_HZ) - response
        return np.concatenate([error.real, error.imag])

    gain, pole_kHz, delay = optimize.least_squares(left, [1.0, 0.5, 0.0]).x
    return float(gain), float(pole_kHz * 1e3), float(delay * 1e-4)


def amplifier_figure(scene: Scene, amplifier: Amplifier, responses: dict[float, FloatArray]) -> Figure:
    """Seed Fig. 5: step and frequency response of the simulated amplifier against its model.

    Parameters
    ----------
    responses : amplitude [A] -> (m,) `sine_response`.
    """
    dt = scene.time.dt_s
    figure = Figure(figsize=(8.4, 3.6), layout="constrained")
    left, right = figure.subfigures(1, 2, squeeze=False)[0]
    step = left.subplots()
    style(step)
    times = np.linspace(-1e-4, 8e-4, 901)
    model = -np.expm1(-amplifier.rate_rad_s * np.maximum(times - amplifier.delay_s, 0.0))
    step.plot(times * 1e3, (times >= 0).astype(float), color=DARK, linewidth=0.8, linestyle=":", label="command")
    step.plot(times * 1e3, model, color=REFERENCE, linewidth=3.0, label="model")
    for amplitude, colour, line in zip(responses, (OPTIMUM, SEED), ("-", "--"), strict=True):
        simulator = hands_off(scene, 3.0, AMPLIFIER_STEPS, trace=True)
        simulator.advance(0.0)
        for _ in range(8):
            simulator.advance(amplitude)
        trace = simulator.trace()
        text = f"simulator, {amplitude:g} A"
        step.plot(
            (trace.times_s - dt) * 1e3,
            trace.current_A / amplitude,
            color=colour,
            linestyle=line,
            linewidth=1.1,
            label=text,
        )
    step.set_xlim(-0.1, 0.8)
    step.set_xlabel("time after the command [ms]", fontsize=LABEL_PT)
    step.set_ylabel("current per command", fontsize=LABEL_PT)
    step.legend(fontsize=SMALL_PT, frameon=False, loc="lower right")

    magnitude, phase = right.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    fine = np.geomspace(AMPLIFIER_HZ[0], AMPLIFIER_HZ[-1], 300)
    wanted = amplifier_model(amplifier.pole_Hz, amplifier.delay_s, dt, fine)
    _bode(magnitude, phase, fine, wanted, {"color": REFERENCE, "linewidth": 3.0})
    for (amplitude, response), colour, marker in zip(responses.items(), (OPTIMUM, SEED), "o^", strict=True):
        dots = {
            "color": colour,
            "linestyle": "",
            "marker": marker,
            "markersize": 3.5,
            "label": f"sines of {amplitude:g} A",
        }
        _bode(magnitude, phase, AMPLIFIER_HZ, response, dots)
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

SWEEP_HZ, SWEEP_A, FADE_S = (0.7, 1500.0), 1.0, 0.3
BANDS_PER_DECADE = 24
SHOWN_HZ = (1.0, 1000.0)


@dataclass(frozen=True)
class Identified:
    """A frequency response from a sweep: (m,) centres of bands, acceleration per current [m/s^2/A], coherence."""

    frequencies_Hz: FloatArray
    response: FloatArray
    coherence: FloatArray


def sweep_response(scene: Scene, grip_N: float, duration_s: float) -> Identified:
    """A logarithmic sweep of the command; what amplifier monitor and accelerometer read, divided band by band.

    H = sum A I* / sum |I|^2 over each band, the accelerometer's known pole taken out.
    """
    dt = scene.time.dt_s
    ticks = round(duration_s / dt)
    t = np.arange(ticks) * dt
    command = SWEEP_A * signal.chirp(t, SWEEP_HZ[0], t[-1], SWEEP_HZ[1], method="logarithmic", phi=-90)
    fade = round(FADE_S / dt)
    # Silence at the end, so that the response to the sweep has died away in the record.
    command = np.concatenate([command, np.zeros(fade)])
    simulator = hands_off(scene, grip_N, 1, trace=False)
    current, acceleration = np.empty(command.size), np.empty(command.size)
    for k, value in enumerate(command):
        readings = simulator.readings()
        current[k], acceleration[k] = readings.current_A, readings.acceleration_m_s2
        simulator.advance(float(value))
    f = np.fft.rfftfreq(command.size, dt)
    i = np.fft.rfft(current)
    a = np.fft.rfft(acceleration) * (1 + 1j * f / SEED_SENSORS.accelerometer_bandwidth_Hz)
    count = round(BANDS_PER_DECADE * np.log10(SHOWN_HZ[1] / SHOWN_HZ[0])) + 1
    edges = np.geomspace(*SHOWN_HZ, count)
    centres, responses, coherences = [], [], []
    for low, high in itertools.pairwise(edges):
        inside = (f >= low) & (f < high)
        if np.count_nonzero(inside) < 2:
            continue
        power, cross = np.sum(np.abs(i[inside]) ** 2), np.sum(a[inside] * i[inside].conj())
        centres.append(np.sum(f[inside] * np.abs(i[inside]) ** 2) / power)
        responses.append(cross / power)
        coherences.append(np.abs(cross) ** 2 / power / np.sum(np.abs(a[inside]) ** 2))
    return Identified(np.array(centres), np.array(responses), np.array(coherences))


def deviation(scene: Scene, grip_N: float, found: Identified, from_Hz: float) -> tuple[float, float]:
    """Rms deviation of a sweep from the model above a frequency [dB, deg]."""
    used = found.frequencies_Hz >= from_Hz
    ratio = found.response[used] / scene.plant(grip_N).response(found.frequencies_Hz[used])
    size, turned = 20 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio))
    return float(np.sqrt(np.mean(size**2))), float(np.sqrt(np.mean(turned**2)))


def sweep_figure(scene: Scene, grip_N: float, found: Identified) -> Figure:
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
