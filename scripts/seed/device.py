"""The device of the seed's Figs. 1, 5, 6 and 7: real taps, hand, amplifier and stylus, all in the simulator."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy import signal

from controller.record.excitation import sweep_command
from controller.sim.sensors import SEED_SENSORS
from controller.sim.simulated_tap import Struck, strike_real
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import device_of
from controller.sim.user import StillHand
from seed.plots import REFERENCE, logarithmic
from transopt.base.plotting import DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT, colours, style
from transopt.base.signals import STANDARD_GRAVITY_M_S2, ComplexArray, FloatArray, Signal
from transopt.identify.amplifier_response import sampled
from transopt.identify.hand.lines import HandFit, fit_hand
from transopt.identify.hand.tap import cut_tap
from transopt.identify.spectrum import TransferEstimate, Trial, estimate_transfer
from transopt.plant.amplifier import Amplifier, prefilter_coefficients
from transopt.scene.scene import Scene

LINES = ("-", "--", "-.", (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (8, 2)))
AS_BUILT = Imperfections()  # the simulator's crossover distortion and sensors, parameters as stated
SETTLED_S = 0.3  # of rest beside a sweep, in which what was before it dies away
HAND_WINDOW_S = 28e-3  # of a real tap that is fitted: all that is simulated but its end
MODEL: dict[str, Any] = {"linestyle": "--", "linewidth": 0.9}


@dataclass(frozen=True)
class Recorded:
    """How much is recorded of the device; by default as much as in the seed.

    Attributes
    ----------
    sweep_s : length of a sweep. trials : sweeps of a grip, every other one of the other polarity.
    grips_N : of Fig. 7, the free device first. hand_grips_N : of Fig. 5. taps : all of Fig. 5, the same at each grip.
    """

    sweep_s: float = 2.0
    trials: int = 4
    grips_N: tuple[float, ...] = (0.0, 1.0, 2.0, 3.0, 5.0)
    hand_grips_N: tuple[float, ...] = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0)
    taps: int = 81


def swept(
    scene: Scene, grip_N: float, low_Hz: float, high_Hz: float, duration_s: float, amplitude_A: float, seed: int = 1
) -> tuple[Signal, Signal, Signal]:
    """A sweep while the device is held still: the command, and the sensors' current and acceleration, in SI."""
    dt_s = scene.time.dt_s
    sweep = np.sign(amplitude_A) * sweep_command(low_Hz, high_Hz, duration_s, abs(amplitude_A), dt_s)
    command = np.concatenate([sweep, np.zeros(round(SETTLED_S / dt_s))])
    # The hand rests, so the linear flow is exact over any step.
    simulator = Simulator(device_of(scene), StillHand(grip_N), dt_s, imperfections=AS_BUILT, seed=seed, steps=1)
    read = np.empty((2, command.size))
    for k, each in enumerate(command.tolist()):
        said = simulator.readings()
        read[:, k] = said.current_A, said.acceleration_m_s2
        simulator.advance(each)
    current, acceleration = (Signal(0.0, dt_s, values) for values in read)
    return Signal(0.0, dt_s, command), current, acceleration


# ------------------------------------------------------------------------------------------------ Fig. 1

REAL_TAP_S = 30e-3
SOFT_N, FIRM_N = 0.86, 4.74  # grips of the seed's Fig. 1


@dataclass(frozen=True)
class RealTap:
    speed_m_s: float
    grip_N: float
    struck: Struck

    @property
    def peak_g(self) -> float:
        return float(np.abs(self.struck.acceleration_m_s2).max()) / STANDARD_GRAVITY_M_S2

    @property
    def peak_N(self) -> float:
        """Largest force of the surface."""
        return float(self.struck.contact_N.max())

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


def real_taps_figure(by_speed: Sequence[RealTap], by_grip: Sequence[RealTap], name: str) -> Figure:
    """Seed Fig. 1: acceleration of the stylus and force of a real surface, by speed and by grip.

    Parameters
    ----------
    name : of the scene.
    """
    figure = Figure(figsize=(7.6, 5.0), layout="constrained")
    figure.suptitle(f"real taps, {name}", fontsize=LABEL_PT)
    rows = figure.subplots(2, 2, sharex=True, sharey="row")
    texts: tuple[tuple[Sequence[RealTap], str, Callable[[RealTap], str]], ...] = (
        (by_speed, f"grip {by_speed[0].grip_N:g} N", lambda tap: f"{tap.speed_m_s:g} m/s"),
        (by_grip, f"speed {by_grip[0].speed_m_s:g} m/s", lambda tap: f"{tap.grip_N:g} N"),
    )
    for (above, below), (taps, title, label) in zip(rows.T, texts, strict=True):
        for tap, colour, line in zip(taps, colours(len(taps)), LINES, strict=False):
            look = {"color": colour, "linestyle": line, "linewidth": 1.3}
            times_ms = tap.struck.times_s * 1e3
            above.plot(times_ms, tap.struck.acceleration_m_s2 / STANDARD_GRAVITY_M_S2, label=label(tap), **look)
            below.plot(times_ms, tap.struck.contact_N, **look)
        above.set_title(title, fontsize=LABEL_PT)
        above.legend(fontsize=SMALL_PT, frameon=False)
        below.set_xlabel("time after contact [ms]", fontsize=LABEL_PT)
        for axes in (above, below):
            style(axes)
    rows[0, 0].set_xlim(-1.5, REAL_TAP_S * 1e3)
    rows[0, 0].set_ylabel("acceleration [g]", fontsize=LABEL_PT)
    rows[1, 0].set_ylabel("force of the surface [N]", fontsize=LABEL_PT)
    return figure


# ------------------------------------------------------------------------------------------------ Fig. 5

HAND_SPEEDS_M_S = 0.1, 0.4
FORCE_NOISE_N = 0.02  # of the sensor below the surface, rms
SEED_LINES = {  # seed Eqs. 3 to 5: quantity -> constant and slope over grip
    "mass_kg": (0.215, -0.00328),
    "damping_N_s_m": (6.713, 0.369),
    "stiffness_N_m": (75.65, 14.72),
}
HAND_WORDS = {"mass_kg": "mass [kg]", "damping_N_s_m": "damping [N s/m]", "stiffness_N_m": "stiffness [N/m]"}


def hand_fit(scene: Scene, recorded: Recorded, seed: int = 5) -> HandFit:
    """Mass, damper and spring of the hand, tap by tap, from real taps with random speeds over the grips."""
    random, taps = np.random.default_rng(seed), []
    for j in range(recorded.taps):
        grip = recorded.hand_grips_N[j % len(recorded.hand_grips_N)]
        struck = real_tap(scene, float(random.uniform(*HAND_SPEEDS_M_S)), grip).struck
        n = struck.times_s.size
        acceleration = struck.acceleration_m_s2 + SEED_SENSORS.accelerometer_noise_m_s2 * random.standard_normal(n)
        force = struck.contact_N + FORCE_NOISE_N * random.standard_normal(n)
        step = float(np.median(np.diff(struck.times_s)))
        even = np.arange(struck.times_s[0], struck.times_s[-1], step)
        force, acceleration = (np.interp(even, struck.times_s, values) for values in (force, acceleration))
        taps.append(cut_tap(f"tap {j}", force, acceleration, step, grip_N=grip, window_s=HAND_WINDOW_S))
    return fit_hand(taps)


def hand_figure(fit: HandFit, name: str) -> Figure:
    """Seed Fig. 5: mass, damping and stiffness of single taps over grip, their lines, and those of the seed."""
    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    figure.suptitle(f"second-order hand with the stylus, {len(fit.fits)} taps, {name}", fontsize=LABEL_PT)
    for axes, line in zip(figure.subplots(1, 3), fit.lines, strict=True):
        style(axes)
        axes.plot(fit.grips_N, line.at_taps, linestyle="", marker="o", markersize=3, color="0.55", label="one tap")
        ends = np.array([fit.grips_N.min(), fit.grips_N.max()])
        axes.plot(ends, [line.line.at(float(grip)) for grip in ends], color=OPTIMUM, linewidth=1.8, label="its line")
        constant, slope = SEED_LINES[line.quantity]
        axes.plot(ends, constant + slope * ends, color=SEED, linewidth=1.4, linestyle="--", label="seed, Eqs. 3 to 5")
        axes.set_xlabel("grip force [N]", fontsize=LABEL_PT)
        axes.set_ylabel(HAND_WORDS[line.quantity], fontsize=LABEL_PT)
        axes.set_ylim(bottom=0.0)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=SMALL_PT, frameon=False)
    return figure


# ------------------------------------------------------------------------------------------------ Fig. 6

AMPLIFIER_HZ, AMPLIFIER_A = (10.0, 4000.0), 0.75
AMPLIFIER_SHOWN_HZ = 3500.0  # where the sweep ends it tells nothing
OFFSETS_A = (1.0, 0.0, -1.0)


@dataclass(frozen=True)
class Swept:
    """Current over the current that was asked for, at one offset, before and after the prefilter."""

    offset_A: float
    before: TransferEstimate
    after: TransferEstimate


def amplifier_sweeps(scene: Scene, recorded: Recorded) -> list[Swept]:
    """Swept sines of 0.75 A around +1, 0 and -1 A through the simulated amplifier with its dead band.

    The prefilter is the inverse of the amplifier's pole: each command is the one after whose period of hold the
    current is the one asked for.
    """
    amplifier, dt_s, found = scene.amplifier_model(), scene.time.dt_s, []
    assert amplifier is not None
    now, before = prefilter_coefficients(amplifier, dt_s)
    for offset in OFFSETS_A:
        wanted = sweep_command(*AMPLIFIER_HZ, recorded.sweep_s, AMPLIFIER_A, dt_s) + offset
        commands = (wanted, signal.lfilter([now, before], [1.0], wanted, zi=[before * offset])[0])
        estimates = []
        for command in commands:
            simulator = Simulator(device_of(scene), StillHand(3.0), dt_s, imperfections=AS_BUILT, seed=1, steps=1)
            for _ in range(round(SETTLED_S / dt_s)):
                simulator.advance(offset)
            read = np.empty(command.size)
            for k, each in enumerate(command.tolist()):
                read[k] = simulator.readings().current_A
                simulator.advance(each)
            asked = Signal(0.0, dt_s, wanted - offset)
            estimates.append(estimate_transfer([Trial(f"{offset:g} A", asked, Signal(0.0, dt_s, read - offset))]))
        found.append(Swept(offset, *estimates))
    return found


def amplifier_figure(amplifier: Amplifier, sweeps: Sequence[Swept], dt_s: float, name: str) -> Figure:
    """Seed Fig. 6: the amplifier around three offsets, as it is and with the prefilter before it."""
    figure = Figure(figsize=(8.4, 4.6), layout="constrained")
    figure.suptitle(f"current over the current asked for, sweeps of {AMPLIFIER_A:g} A, {name}", fontsize=LABEL_PT)
    panels = figure.subplots(2, 2, sharex=True, sharey="row", height_ratios=(3, 2))
    fine = np.geomspace(*AMPLIFIER_HZ, 300)
    model, _ = sampled(fine, amplifier.pole_Hz, amplifier.delay_s, dt_s)
    for (magnitude, phase), way in zip(panels.T, ("before", "after"), strict=True):
        for each, colour, line in zip(sweeps, colours(len(sweeps)), LINES, strict=False):
            found = getattr(each, way)
            shown = found.frequencies_Hz <= AMPLIFIER_SHOWN_HZ
            look = {"color": colour, "linestyle": line, "linewidth": 1.2, "label": f"around {_signed(each.offset_A)}"}
            _bode(magnitude, phase, found.frequencies_Hz[shown], found.response[shown], look)
        if way == "before":
            label = f"model, {amplifier.pole_Hz:g} Hz and {1e6 * amplifier.delay_s:g} µs"
            _bode(magnitude, phase, fine, model, {"color": REFERENCE, "linewidth": 3.0, "zorder": 0, "label": label})
            handles = magnitude.get_legend_handles_labels()
        logarithmic(magnitude, y=False)
        for axes in (magnitude, phase):
            style(axes)
        magnitude.set_title(f"{way} the prefilter", fontsize=LABEL_PT)
        phase.set_xlabel("frequency [Hz]", fontsize=LABEL_PT)
    panels[0, 0].set_ylim(0, 1.2)
    panels[0, 0].set_xlim(AMPLIFIER_HZ[0], AMPLIFIER_SHOWN_HZ)
    panels[1, 0].set_ylim(-200, 20)
    panels[0, 0].set_ylabel("current per current asked for", fontsize=LABEL_PT)
    panels[1, 0].set_ylabel("phase [deg]", fontsize=LABEL_PT)
    figure.legend(*handles, loc="outside lower center", ncols=4, fontsize=SMALL_PT, frameon=False)
    return figure


def _signed(current_A: float) -> str:
    return "0 A" if current_A == 0 else f"{current_A:+g} A"


def widest(found: TransferEstimate) -> float:
    """Frequency [Hz] up to which a response stays within 3 dB of one."""
    outside = np.abs(20 * np.log10(np.abs(found.response))) > 3.0
    return float(found.frequencies_Hz[int(np.argmax(outside)) if outside.any() else -1])


def _bode(
    magnitude: Axes, phase: Axes, frequencies_Hz: FloatArray, response: ComplexArray, line: dict[str, Any]
) -> None:
    magnitude.plot(frequencies_Hz, np.abs(response), **line)
    phase.plot(frequencies_Hz, np.degrees(np.unwrap(np.angle(response))), **line)


# ------------------------------------------------------------------------------------------------ Fig. 7

SWEEP_HZ, SWEEP_A = (1.0, 2000.0), 0.75
FREE_FROM_HZ = 20.0  # a device that nobody holds drifts away from slower ones
SHOWN_HZ = (1.0, 1000.0)


def sweep_response(scene: Scene, grip_N: float, recorded: Recorded) -> TransferEstimate:
    """Acceleration per current [m/s^2/A] from sweeps, the accelerometer's known pole taken out."""
    low_Hz = SWEEP_HZ[0] if grip_N > 0 else FREE_FROM_HZ
    trials = []
    for j in range(recorded.trials):
        sign = (-1.0) ** j
        _, current, acceleration = swept(scene, grip_N, low_Hz, SWEEP_HZ[1], recorded.sweep_s, sign * SWEEP_A, seed=j)
        trials.append(Trial(f"sweep {j}", current, acceleration))
    found = estimate_transfer(trials)
    shown = (found.frequencies_Hz <= SHOWN_HZ[1]) & (found.frequencies_Hz >= low_Hz)
    frequencies = found.frequencies_Hz[shown]
    behind_pole = 1 / (1 + 1j * frequencies / SEED_SENSORS.accelerometer_bandwidth_Hz)
    return replace(
        found,
        frequencies_Hz=frequencies,
        response=found.response[shown] / behind_pole,
        deviation=found.deviation[shown],
        degrees=found.degrees[shown],
        coherence=found.coherence[shown],
        trial_responses=found.trial_responses[:, shown],
    )


def deviation(scene: Scene, grip_N: float, found: TransferEstimate, from_Hz: float) -> tuple[float, float]:
    """Rms deviation of a sweep from the model above a frequency [dB, deg]."""
    used = found.frequencies_Hz >= from_Hz
    ratio = found.response[used] / scene.plant(grip_N).response(found.frequencies_Hz[used])
    size, turned = 20 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio))
    return float(np.sqrt(np.mean(size**2))), float(np.sqrt(np.mean(turned**2)))


def family_figure(scene: Scene, measured: Mapping[float, TransferEstimate]) -> Figure:
    """Seed Fig. 7: current to acceleration over the grips, the free device among them: measured, and the models.

    Parameters
    ----------
    measured : by grip [N].
    """
    figure = Figure(figsize=(6.4, 6.0), layout="constrained")
    title = f"current to stylus acceleration, sweeps of {SWEEP_A:g} A at each grip, {scene.name}"
    figure.suptitle(title, fontsize=LABEL_PT)
    magnitude, phase = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    g = STANDARD_GRAVITY_M_S2
    for (grip, found), colour in zip(measured.items(), colours(len(measured)), strict=True):
        fine = np.geomspace(found.frequencies_Hz[0], SHOWN_HZ[1], 400)
        look = {"color": colour, "linewidth": 1.3}
        _bode(magnitude, phase, found.frequencies_Hz, found.response / g, {**look, "label": f"{grip:g} N"})
        _bode(magnitude, phase, fine, scene.plant(grip).response(fine) / g, {**look, "color": DARK, **MODEL})
    for axes in (magnitude, phase):
        style(axes)
    logarithmic(magnitude, y=True)
    magnitude.set_xlim(*SHOWN_HZ)
    magnitude.set_ylabel("acceleration per current [g/A]", fontsize=LABEL_PT)
    phase.set_ylabel("phase [deg]", fontsize=LABEL_PT)
    phase.set_yticks([-90, 0, 90, 180])
    phase.set_xlabel("frequency [Hz]", fontsize=LABEL_PT)
    handles, _ = magnitude.get_legend_handles_labels()
    handles.append(Line2D([], [], color=DARK, label="model", **MODEL))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=SMALL_PT, frameon=False)
    return figure


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
