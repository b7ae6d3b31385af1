"""The figure of an identified device, like the seed's Fig. 7: magnitude and phase per grip, measured and fitted."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter

from transopt.base.plotting import DARK, LABEL_PT, SMALL_PT
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray
from transopt.identify.device.identify import DeviceResult
from transopt.identify.device.response import sampled_response
from transopt.identify.device.trials import Grip
from transopt.identify.device.validation import called

POINTS = 400
COLUMNS = 3
BAND_COLOUR, FIT_COLOUR = "0.75", "#D55E00"
MAGNITUDE_G_A = 1e-3, 30.0
SHOWN_DEG = 60.0  # a wider phase interval than this is drawn as no interval at all


def device_figure(result: DeviceResult) -> Figure:
    """One column per grip: magnitude, phase, and what the chosen model is off by; measured with its 95 % band.

    The accelerometer's pole is in both, so that measured and fitted are the same quantity.
    """
    columns = min(COLUMNS, len(result.grips))
    rows = -(-len(result.grips) // columns)
    figure = Figure(figsize=(3.3 * columns + 0.6, 4.4 * rows + 0.7), layout="constrained")
    axes = figure.subplots(3 * rows, columns, squeeze=False, sharex=True, height_ratios=[1.6, 1.0, 0.8] * rows)
    for j, grip in enumerate(result.grips):
        above, below, under = (axes[3 * (j // columns) + row, j % columns] for row in range(3))
        _grip(above, below, under, result, grip)
        if j % columns == 0:
            above.set_ylabel("acceleration / current [g/A]", fontsize=LABEL_PT)
            below.set_ylabel("phase [deg]", fontsize=LABEL_PT)
            under.set_ylabel("off by [% of it]", fontsize=LABEL_PT)
        last = j + columns >= len(result.grips)
        if last:
            under.set_xlabel("frequency [Hz]", fontsize=LABEL_PT)
            under.tick_params(labelbottom=True)
    for j in range(len(result.grips), rows * columns):
        for row in range(3):
            axes[3 * (j // columns) + row, j % columns].set_visible(False)
    figure.legend(handles=_handles(result), loc="outside upper center", ncols=3, fontsize=SMALL_PT, frameon=False)
    return figure


def _handles(result: DeviceResult) -> Sequence[Line2D | Patch]:
    name = "drive chain" if result.chosen.kind == "drive" else "state space"
    return [
        Line2D([], [], color=DARK, linestyle="", marker=".", markersize=4, label="measured (ETFE)"),
        Patch(color=BAND_COLOUR, label="95 % of what is measured, by its noise"),
        Line2D([], [], color=FIT_COLOUR, label=name),
    ]


def _grip(above: Axes, below: Axes, under: Axes, result: DeviceResult, grip: Grip) -> None:
    estimate = grip.response.estimate
    measured_Hz, size = estimate.frequencies_Hz, np.abs(estimate.response) / STANDARD_GRAVITY_M_S2
    low, high = (limit / STANDARD_GRAVITY_M_S2 for limit in estimate.magnitude_band())
    dense_Hz = np.geomspace(measured_Hz[0], measured_Hz[-1], POINTS)
    modelled = np.zeros(POINTS, dtype=complex)
    for plant, weight in result.chosen.model.shares(grip.grip_N):
        modelled += weight * sampled_response(plant, result.chosen.instrument, dense_Hz)[0]
    model_deg = np.degrees(np.unwrap(np.angle(modelled)))
    if model_deg[0] < -SHOWN_DEG:
        model_deg += 360.0
    # The measured phase is drawn on the turn that lies next to the model's.
    at = np.interp(measured_Hz, dense_Hz, model_deg)
    phase = at + _turned(np.degrees(np.angle(estimate.response)) - at)
    half = estimate.phase_half_width_deg()
    half = np.where(half > SHOWN_DEG, np.nan, half)

    above.fill_between(measured_Hz, np.maximum(low, 1e-9), high, color=BAND_COLOUR, linewidth=0)
    above.plot(measured_Hz, size, ".", color=DARK, markersize=2.5)
    above.plot(dense_Hz, np.abs(modelled) / STANDARD_GRAVITY_M_S2, color=FIT_COLOUR, linewidth=1.1)
    above.set(xscale="log", yscale="log", ylim=_span(size))
    below.fill_between(measured_Hz, phase - half, phase + half, color=BAND_COLOUR, linewidth=0)
    below.plot(measured_Hz, phase, ".", color=DARK, markersize=2.5)
    below.plot(dense_Hz, model_deg, color=FIT_COLOUR, linewidth=1.1)
    below.set_yticks(np.arange(-360, 361, 90))
    below.set_ylim(*(np.clip([model_deg.min() - 40, model_deg.max() + 40], -360, 360)))
    error = result.chosen.recorded[grip.grip_N]
    above.set_title(
        called(grip.grip_N) + (f", held-out NRMSE {100 * error:.1f} %" if np.isfinite(error) else ", not validated"),
        fontsize=LABEL_PT,
    )
    at_bins = np.zeros(measured_Hz.size, dtype=complex)
    for plant, weight in result.chosen.model.shares(grip.grip_N):
        at_bins += weight * sampled_response(plant, result.chosen.instrument, measured_Hz)[0]
    scale = np.abs(estimate.response)
    under.fill_between(measured_Hz, 1e-9, 100 * estimate.radius() / scale, color=BAND_COLOUR, linewidth=0)
    under.plot(measured_Hz, 100 * np.abs(at_bins - estimate.response) / scale, ".", color=FIT_COLOUR, markersize=2.5)
    under.set(yscale="log", ylim=(0.01, 100.0))
    under.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    for axes in (above, below, under):
        axes.tick_params(labelsize=SMALL_PT)
        axes.grid(color="0.9", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    above.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _turned(degrees: FloatArray) -> FloatArray:
    return np.asarray((degrees + 180.0) % 360.0 - 180.0)


def _span(size: FloatArray) -> tuple[float, float]:
    return max(0.5 * float(size.min()), MAGNITUDE_G_A[0]), 2.0 * float(size.max())
