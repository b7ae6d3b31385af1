"""Figure of one tap: position, acceleration against reference, current, temperature over time."""

import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from controller.record.played import PlayedTap
from transopt.base.plotting import DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT, leave_room, style
from transopt.base.signals import STANDARD_GRAVITY_M_S2

BEFORE_MS = 5.0
REFERENCE = "0.6"
WANTED = "recorded tap"
TITLE_CHARACTERS = 90  # of one line of the title; a hundred of mean width fill the figure


def _axis(axes: Axes, label: str) -> None:
    axes.set_ylabel(label, fontsize=LABEL_PT)
    style(axes)
    axes.axvline(0.0, color="0.75", linewidth=0.8, zorder=1)


def tap_figure(tap: PlayedTap, title: str, *, walled: bool) -> Figure:
    """Four panels over one time axis, contact at 0, all from the device's own sensors.

    Parameters
    ----------
    walled : whether the library has a wall, without which only the transient holds the stylus up.
    """
    figure = Figure(figsize=(7.0, 7.6))
    panels = figure.subplots(4, 1, sharex=True, height_ratios=[1, 1.8, 1.3, 0.8], gridspec_kw={"hspace": 0.1})
    position, acceleration, current, temperature = panels
    contact, prediction = tap.contact, tap.prediction
    # What the library looks at: the waveform, and how the stylus comes to rest after it.
    predicted_ms = np.append(prediction.times_s, prediction.after_times_s) * 1e3
    predicted = np.append(prediction.whole_m_s2, prediction.after_m_s2 + prediction.own_after_m_s2)
    after = prediction.gain * prediction.reference_after_m_s2 + prediction.own_after_m_s2
    recorded = np.append(prediction.recorded_m_s2, after)
    shown = (-BEFORE_MS, float(predicted_ms[-1]))
    inside = (tap.times_s * 1e3 >= shown[0]) & (tap.times_s * 1e3 <= shown[1])
    times_s = tap.times_s[inside]
    ms, visible_mm = times_s * 1e3, tap.position_m[inside] * 1e3

    straight = -contact.speed_m_s * times_s * 1e3
    position.plot(ms, straight, color=REFERENCE, linestyle="--", linewidth=1.0, label="incoming motion, continued")
    position.plot(ms, visible_mm, color=DARK, linewidth=1.2, label="encoder")
    pushes = (
        "its wall pushes back by feedback" if walled else "no wall in this library, only the transient pushes back"
    )
    _axis(position, "position [mm]")
    if visible_mm.size:
        margin = 0.08 * float(np.ptp(visible_mm)) + 0.05
        lowest = float(visible_mm.min()) - margin
        position.set_ylim(lowest, float(visible_mm.max()) + margin)
        inside_label = f"inside the object; {pushes}"
        # The edge shows the legend's patch, which otherwise lies on its own colour.
        position.axhspan(min(lowest, 0.0), 0.0, facecolor="0.85", edgecolor="0.55", zorder=0, label=inside_label)
        position.axhline(0.0, color="0.55", linewidth=0.8, zorder=1)

    g = STANDARD_GRAVITY_M_S2
    acceleration.plot(predicted_ms, recorded / g, color=REFERENCE, linewidth=3.0, label=WANTED)
    acceleration.plot(predicted_ms, predicted / g, color=SEED, linewidth=1.2, label="predicted")
    played = tap.acceleration_m_s2[inside] / g
    acceleration.plot(ms, played, color=OPTIMUM, linestyle="--", linewidth=1.0, label="played, as measured")
    _axis(acceleration, "acceleration [g]")

    command, feedback = contact.command_A[inside], contact.feedback_A[inside]
    current.step(ms, command, where="post", color=REFERENCE, linewidth=1.0, label="command")
    current.plot(ms, contact.current_A[inside], color=OPTIMUM, linewidth=1.2, label="current, as measured")
    if np.any(feedback):
        current.step(ms, feedback, where="post", color=DARK, linestyle=":", linewidth=1.2, label="feedback")
    _axis(current, "current [A]")

    # Rises of a few hundredths of a kelvin: the start is taken off, or the axis would show nothing.
    winding_C = contact.winding_C[inside]
    if winding_C.size and np.all(np.isfinite(winding_C)):
        rise_mK = (winding_C - winding_C[0]) * 1e3
        temperature.plot(ms, rise_mK, color=OPTIMUM, linewidth=1.2, label="winding, estimated")
        _axis(temperature, f"rise above\n{winding_C[0]:.1f} °C [mK]")
    else:
        temperature.text(0.5, 0.5, "no motor data", transform=temperature.transAxes, ha="center", fontsize=SMALL_PT)
        _axis(temperature, "temperature")

    # Positions fall and temperatures rise; accelerations die down; currents do either, by the wall.
    places = {position: "lower left", acceleration: "upper right", current: "best", temperature: "lower right"}
    for panel, place in places.items():
        if panel.get_legend_handles_labels()[0]:
            panel.legend(fontsize=SMALL_PT, frameon=False, loc=place)
    temperature.set_xlabel("time from contact [ms]", fontsize=LABEL_PT)
    temperature.set_xlim(*shown)
    lines = textwrap.wrap(title, TITLE_CHARACTERS)
    if not tap.why:
        found = tap.compared
        errors = f"tap error {100 * found.tap_error:.1f} %, playback error {100 * found.playback_error:.2f} %"
        lines.append(f"latency {found.latency_s * 1e6:.0f} µs, {errors}")
    figure.suptitle("\n".join(lines), fontsize=LABEL_PT, parse_math=False)
    leave_room(figure, left_in=0.85, right_in=0.1, below_in=0.48, above_in=0.17 + 0.18 * len(lines))
    return figure
