"""Figure of one tap: position, acceleration against reference, current, temperature over time."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from controller.sim.experiment import Played
from transopt.base.plotting import DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT
from transopt.base.signals import STANDARD_GRAVITY_M_S2

BEFORE_MS = 5.0
REFERENCE = "0.6"


def _axis(axes: Axes, label: str) -> None:
    axes.set_ylabel(label, fontsize=LABEL_PT)
    axes.tick_params(labelsize=SMALL_PT)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.axvline(0.0, color="0.75", linewidth=0.8, zorder=1)


def tap_figure(played: Played) -> Figure:
    """Four panels over one time axis, contact at 0."""
    metrics, prediction, tap = played.metrics, played.prediction, played.tap
    figure = Figure(figsize=(7.0, 7.6), layout="constrained")
    panels = figure.subplots(4, 1, sharex=True, height_ratios=[1, 1.8, 1.3, 0.8])
    position, acceleration, current, temperature = panels
    ms, ticks_ms = played.times_s * 1e3, played.tick_times_s * 1e3
    predicted_ms = prediction.times_s * 1e3
    shown = (-BEFORE_MS, float(predicted_ms[-1]))

    straight = -tap.speed_m_s * played.times_s * 1e3
    position.plot(ms, straight, color=REFERENCE, linestyle="--", linewidth=1.0, label="incoming motion, continued")
    position.plot(ms, played.motor_m * 1e3, color=DARK, linewidth=1.2, label="encoder's mass")
    _axis(position, "position mm")

    g = STANDARD_GRAVITY_M_S2
    acceleration.plot(
        predicted_ms, tap.gain * prediction.reference_m_s2 / g, color=REFERENCE, linewidth=3.0, label="recorded tap"
    )
    acceleration.plot(predicted_ms, prediction.acceleration_m_s2 / g, color=SEED, linewidth=1.2, label="predicted")
    acceleration.plot(
        ms, played.acceleration_m_s2 / g, color=OPTIMUM, linestyle="--", linewidth=1.0, label="played, as it came"
    )
    _axis(acceleration, "acceleration g")

    current.step(ticks_ms, played.command_A, where="post", color=REFERENCE, linewidth=1.0, label="command")
    current.plot(ms, played.current_A, color=OPTIMUM, linewidth=1.2, label="current")
    if np.any(played.feedback_A):
        current.step(
            ticks_ms, played.feedback_A, where="post", color=DARK, linestyle=":", linewidth=1.2, label="feedback"
        )
    _axis(current, "current A")

    # Rises of a few hundredths of a kelvin: the start is taken off, or the axis would show nothing.
    inside = (ms >= shown[0]) & (ms <= shown[1])
    start_C = float(played.winding_C[0])
    if np.isfinite(start_C):
        rise_K = played.winding_C[inside] - start_C
        temperature.plot(ms[inside], rise_K * 1e3, color=OPTIMUM, linewidth=1.2, label="winding")
        estimate_C = played.estimated_winding_C
        if np.all(np.isfinite(estimate_C)):
            seen = (ticks_ms >= shown[0]) & (ticks_ms <= shown[1])
            temperature.plot(
                ticks_ms[seen],
                (estimate_C[seen] - estimate_C[0]) * 1e3,
                color=DARK,
                linestyle="--",
                linewidth=1.0,
                label="servo's estimate",
            )
        _axis(temperature, f"rise above\n{start_C:.1f} °C, mK")
    else:
        temperature.text(0.5, 0.5, "no motor data", transform=temperature.transAxes, ha="center", fontsize=SMALL_PT)
        _axis(temperature, "temperature")

    for panel in panels:
        if panel.get_legend_handles_labels()[0]:
            # Temperatures rise to the upper right, everything else has died down there.
            place = "lower right" if panel is temperature else "upper right"
            panel.legend(fontsize=SMALL_PT, frameon=False, loc=place)
    temperature.set_xlabel("time from contact ms", fontsize=LABEL_PT)
    temperature.set_xlim(*shown)
    visible = played.motor_m[inside] * 1e3
    margin = 0.08 * float(np.ptp(visible)) + 0.05
    position.set_ylim(float(visible.min()) - margin, float(visible.max()) + margin)
    title = f"{tap.speed_m_s:g} m/s, {tap.grip_N:g} N, {tap.habit.value} user"
    if metrics.played:
        title += f": latency {metrics.latency_s * 1e6:.0f} µs, NRMSE {100 * metrics.nrmse:.2f} % after it"
    figure.suptitle(title, fontsize=LABEL_PT)
    return figure
