"""Presents an identified device: tables, verdict and a figure.

The figure shows the responses at all grips, as in the seed's Fig. 7. Beside them, for each grip, it shows the error
of the model and one recorded motion that was held out of the fit, measured and predicted.
"""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MultipleLocator, NullLocator
from rich.console import Console

from transopt.base.plotting import DARK, LABEL_PT, SEED, SMALL_PT, colours, plain, style
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.base.tables import Table
from transopt.identify.device.chain import unit_of
from transopt.identify.device.result import Candidate, DeviceResult, Kind
from transopt.identify.device.trials import Grip
from transopt.identify.device.validation import Transient, called, modelled
from transopt.report.fits import value_table

POINTS = 300
BAND_COLOUR = "0.82"
MAGNITUDE_G_A = 1e-3  # a response below it is noise
SHOWN_DEG = 60.0  # a phase interval wider than this is not drawn
SHOWN_S, BEFORE = 40e-3, 0.25  # length of a held-out motion, and the share of it before its peak
OFF_PERCENT = 0.01, 100.0
ROW_IN, LEAST_IN, HEAD_IN, FOOT_IN = 1.35, 5.4, 0.6, 0.5


def device_figure(result: DeviceResult) -> Figure:
    """Left: magnitude and phase at all grips; right: per grip the error over frequency and a motion over time.

    The accelerometer's pole is in both measurement and model, so that they are comparable.
    """
    grips = result.grips
    high_in = max(LEAST_IN, ROW_IN * len(grips) + HEAD_IN + FOOT_IN)
    figure = Figure(figsize=(12.0, high_in))
    # Stated here, because an automatic layout takes longer than drawing.
    ends = {"top": 1 - HEAD_IN / high_in, "bottom": FOOT_IN / high_in}
    left = figure.add_gridspec(2, 1, left=0.062, right=0.38, hspace=0.08, **ends)
    right = figure.add_gridspec(len(grips), 2, left=0.43, right=0.988, wspace=0.13, hspace=0.14, **ends)
    above = figure.add_subplot(left[0])
    below = figure.add_subplot(left[1], sharex=above)
    first: tuple[Axes, Axes] | None = None
    for j, (grip, colour) in enumerate(zip(grips, colours(len(grips)), strict=True)):
        _response(above, below, result.chosen, grip, tuple(colour))
        off = figure.add_subplot(right[j, 0], sharex=above)
        motion = figure.add_subplot(right[j, 1], sharex=None if first is None else first[1])
        first = first or (off, motion)
        _error(off, result.chosen, grip, tuple(colour))
        _motion(motion, result.chosen.transients.get(grip.grip_N, []))
        _say(off, 0.5, "center", called(grip.grip_N), LABEL_PT)
        for axes in (off, motion):
            axes.tick_params(labelbottom=j == len(grips) - 1)
    assert first is not None
    # y is stated, because finding it would make Matplotlib lay out the panel once more.
    first[0].set_title("model off by [% of the response]", fontsize=LABEL_PT, y=1.0)
    first[1].set_title("kept out of the fit: acceleration [g]", fontsize=LABEL_PT, y=1.0)
    above.set_ylabel("acceleration / current [g/A]", fontsize=LABEL_PT)
    below.set_ylabel("phase [deg]", fontsize=LABEL_PT)
    above.tick_params(labelbottom=False)
    for axes in (below, off):
        axes.set_xlabel("frequency [Hz]", fontsize=LABEL_PT)
    motion.set_xlabel("time about the peak [ms]", fontsize=LABEL_PT)
    figure.legend(handles=_handles(result), loc="upper center", ncols=5, fontsize=SMALL_PT, frameon=False)
    return figure


def _handles(result: DeviceResult) -> list[Line2D | Patch]:
    name = "drive chain" if result.chosen.kind == "drive" else "state space"
    return [
        Line2D([], [], color=DARK, linestyle="", marker=".", markersize=4, label="measured response"),
        Patch(color=BAND_COLOUR, label="95 % of what is measured, by its noise"),
        Line2D([], [], color=DARK, linewidth=1.1, label=f"{name}, light: firmer grip"),
        Line2D([], [], color=DARK, linewidth=2.2, alpha=0.4, label="measured motion"),
        Line2D([], [], color=SEED, linewidth=1.0, label="predicted motion"),
    ]


def _response(above: Axes, below: Axes, chosen: Candidate, grip: Grip, colour: tuple[float, ...]) -> None:
    """Draw the measured magnitude and phase at one grip, and the model's."""
    estimate = grip.response.estimate
    measured_Hz, size = estimate.frequencies_Hz, np.abs(estimate.response) / STANDARD_GRAVITY_M_S2
    dense_Hz = np.geomspace(measured_Hz[0], measured_Hz[-1], POINTS)
    response = modelled(chosen.model, grip.grip_N, chosen.instrument, dense_Hz)
    model_deg = np.degrees(np.unwrap(np.angle(response)))
    if model_deg[0] < -SHOWN_DEG:
        model_deg += 360.0
    # The measured phase is shifted by whole turns to lie next to the model's.
    at = np.interp(measured_Hz, dense_Hz, model_deg)
    phase = at + (np.degrees(np.angle(estimate.response)) - at + 180.0) % 360.0 - 180.0
    half = estimate.phase_half_width_deg()
    half = np.where(half > SHOWN_DEG, np.nan, half)
    low, high = (limit / STANDARD_GRAVITY_M_S2 for limit in estimate.magnitude_band())

    above.fill_between(measured_Hz, np.maximum(low, 1e-9), high, color=BAND_COLOUR, linewidth=0)
    below.fill_between(measured_Hz, phase - half, phase + half, color=BAND_COLOUR, linewidth=0)
    for axes, measured, model in (
        (above, size, np.abs(response) / STANDARD_GRAVITY_M_S2),
        (below, phase, model_deg),
    ):
        axes.plot(measured_Hz, measured, ".", color=colour, markersize=2.5)
        axes.plot(dense_Hz, model, color=colour, linewidth=1.1)
        style(axes)
    least, most = above.get_ylim() if above.get_yscale() == "log" else (np.inf, 0.0)
    above.set(xscale="log", yscale="log")
    above.set_ylim(min(least, max(0.5 * float(size.min()), MAGNITUDE_G_A)), max(most, 2.0 * float(size.max())))
    above.xaxis.set_major_formatter(FuncFormatter(plain))
    above.yaxis.set_major_formatter(FuncFormatter(plain))
    below.yaxis.set_major_locator(MultipleLocator(90))


def _error(axes: Axes, chosen: Candidate, grip: Grip, colour: tuple[float, ...]) -> None:
    """Relative error of the model at each bin, above the error that noise alone causes."""
    estimate = grip.response.estimate
    scale = np.abs(estimate.response)
    model = modelled(chosen.model, grip.grip_N, chosen.instrument, estimate.frequencies_Hz)
    off = np.abs(model - estimate.response)
    axes.fill_between(estimate.frequencies_Hz, 1e-9, 100 * estimate.radius() / scale, color=BAND_COLOUR, linewidth=0)
    axes.plot(estimate.frequencies_Hz, 100 * off / scale, ".", color=colour, markersize=2.5)
    axes.set(yscale="log", ylim=OFF_PERCENT)
    axes.yaxis.set_major_locator(LogLocator(numticks=3))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(plain))
    style(axes)


def _motion(axes: Axes, transients: list[Transient]) -> None:
    """The loudest stretch of one held-out record: of a tap at usual amplitude if there is one, else of a sweep."""
    style(axes)
    if not transients:
        axes.text(0.5, 0.5, "nothing was kept out", ha="center", va="center", transform=axes.transAxes)
        return
    one = next((found for found in transients if found.run.held_out), transients[-1])
    recorded = one.run.require("acceleration")
    peak = int(np.argmax(np.abs(one.measured)))
    shown = slice(max(peak - round(BEFORE * SHOWN_S / recorded.dt_s), 0), peak + round(SHOWN_S / recorded.dt_s))
    times_ms = 1e3 * recorded.dt_s * (np.arange(one.measured.size)[shown] - peak)
    axes.plot(times_ms, one.measured[shown] / STANDARD_GRAVITY_M_S2, color=DARK, linewidth=2.2, alpha=0.4)
    axes.plot(times_ms, one.predicted[shown] / STANDARD_GRAVITY_M_S2, color=SEED, linewidth=1.0)
    kind = "tap" if one.run.held_out else "sweep"
    _say(axes, 0.985, "right", f"{kind}, relative error {100 * one.nrmse:.2g} %", SMALL_PT)


def _say(axes: Axes, at: float, side: Literal["center", "right"], words: str, size: float) -> None:
    """Text at the top of a panel, on a white background."""
    paper = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5}
    axes.annotate(words, (at, 0.95), xycoords="axes fraction", ha=side, va="top", fontsize=size, bbox=paper)


def show(console: Console, result: DeviceResult) -> None:
    """Print the tables, the findings about the records, and what to record again."""
    if result.chosen.kind is Kind.DRIVE and result.chain is not None:
        names, values, _, intervals = result.chain.stated()
        stated = np.column_stack([values, intervals]).tolist()
        rows = [(name, *(f"{x:.4g}" for x in row), unit_of(name)) for name, row in zip(names, stated, strict=True)]
        console.print(value_table("drive chain", rows))
    elif result.black_box is not None:
        console.print(f"state space of order {result.black_box.order} at each grip")
    heads = ("grip", "trials", "held-out error %", "unknown to the model %", "residual", "hand of its own")
    table = Table.of(None, heads, words=("grip",))
    recorded, between = result.chosen.recorded, result.chosen.between
    residual = dict(zip([grip.grip_N for grip in result.grips], result.residuals, strict=True))
    own = {one.grip_N: one.own_scatter for one in result.own_hands if result.chosen.kind is Kind.DRIVE}
    trials = {grip.grip_N: len(grip.fitted) for grip in result.grips}

    def number(values: Mapping[float, float], grip: float, factor: float = 1.0) -> str:
        return f"{factor * values[grip]:.2g}" if grip in values and values[grip] == values[grip] else "-"

    for grip in sorted({*recorded, *between}):
        errors = number(recorded, grip, 100), number(between, grip, 100)
        table.add_row(called(grip), str(trials.get(grip, 0)), *errors, number(residual, grip), number(own, grip))
    console.print(table)
    console.print(
        "unknown to the model: error at this grip of a fit without it. residual: mean square over the noise's, 1 for "
        "a model that is right; hand of its own: the same with a hand fitted to this grip alone",
        style="dim",
    )
    if result.other is not None and recorded:
        ours, theirs = 100 * result.chosen.off, 100 * result.other.off
        console.print(f"{result.chosen.kind} chosen: response {ours:.2g} % off, {result.other.kind} {theirs:.2g} %")
    for finding in result.findings:
        console.print(f"note: {finding}")
    for text in result.advice:
        console.print(f"record again: {text}")
