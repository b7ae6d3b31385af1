"""How an identified amplifier is shown: its tables, and a figure like the seed's Fig. 6."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MultipleLocator, NullFormatter

from transopt.base.plotting import LABEL_PT, OPTIMUM, SEED, SMALL_PT
from transopt.base.signals import ComplexArray, FloatArray
from transopt.base.tables import Table
from transopt.identify.amplifier import AmplifierFit
from transopt.identify.spectrum import TransferEstimate, Trial
from transopt.plant.amplifier import Amplifier, prefilter_coefficients

POINTS = 400
LEAST_DRAWN = 1e-6  # of the largest magnitude: the logarithm of nothing has no place
MOST_UNKNOWN = 0.2  # of the magnitude: where the band at either end is wider, the figure ends


def amplifier_figure(fit: AmplifierFit) -> Figure:
    """Magnitude and phase from command to measured current, and from wanted current through the prefilter to it.

    Dots: the estimate; shaded: its 95 % band; lines: one pole and a delay, held and sampled.
    """
    known = fit.estimate.half_width() < MOST_UNKNOWN * np.abs(fit.estimate.response)
    estimate = fit.estimate.between(*fit.estimate.frequencies_Hz[known][[0, -1]])
    f = estimate.frequencies_Hz
    fine = np.geomspace(f[0], f[-1], POINTS)
    figure = Figure(figsize=(5.6, 5.2), layout="constrained")
    magnitude, phase = axes = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1))
    said = f"fit: {fit.pole_Hz:.0f} Hz, {1e6 * fit.delay_s:.1f} us"
    _draw(magnitude, phase, estimate, OPTIMUM, "command to current")
    _line(magnitude, phase, fine, fit.response(fine), OPTIMUM, said)
    _draw(magnitude, phase, estimate.over(1 / prefilter_response(fit, f)), SEED, "after the prefilter")
    after = fit.response(fine) * prefilter_response(fit, fine)
    _line(magnitude, phase, fine, after, SEED, "fit after the prefilter")
    magnitude.set_xscale("log")
    magnitude.set_ylabel("magnitude [dB]", fontsize=LABEL_PT)
    phase.set_ylabel("phase [deg]", fontsize=LABEL_PT)
    phase.set_xlabel("frequency [Hz]", fontsize=LABEL_PT)
    phase.set_xlim(f[0], f[-1])
    phase.yaxis.set_major_locator(MultipleLocator(90))
    phase.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    phase.xaxis.set_minor_formatter(NullFormatter())
    for one in axes:
        one.grid(True, color="0.9", linewidth=0.6)
        one.tick_params(labelsize=SMALL_PT)
        one.spines[["top", "right"]].set_visible(False)
    magnitude.legend(fontsize=SMALL_PT, frameon=False, loc="lower left")
    hold = f"delay beyond the hold; with its half sample {1e6 * fit.delay_with_hold_s:.1f} us"
    phase.text(0.02, 0.04, hold, transform=phase.transAxes, fontsize=SMALL_PT)
    return figure


def prefilter_response(fit: AmplifierFit, frequencies_Hz: FloatArray) -> ComplexArray:
    """(m,) complex response of the prefilter that inverts the fitted pole (`transopt.plant.amplifier.prefilter`)."""
    pole = Amplifier(fit.pole_Hz, fit.delay_s, 1.0)  # the range of the command has no part in it
    now, before = prefilter_coefficients(pole, fit.dt_s)
    return np.asarray(now + before * np.exp(-2j * np.pi * frequencies_Hz * fit.dt_s))


def _draw(magnitude: Axes, phase: Axes, estimate: TransferEstimate, colour: str, label: str) -> None:
    """An estimate with its band."""
    f, size, (low, high) = estimate.frequencies_Hz, np.abs(estimate.response), estimate.magnitude_band()
    degrees, spread = np.degrees(np.unwrap(np.angle(estimate.response))), estimate.phase_half_width_deg()
    low = np.maximum(low, LEAST_DRAWN * size.max())
    magnitude.fill_between(f, 20 * np.log10(low), 20 * np.log10(high), color=colour, alpha=0.25, linewidth=0)
    magnitude.plot(f, 20 * np.log10(size), ".", color=colour, markersize=2.5, label=f"{label}, 95 % band")
    phase.fill_between(f, degrees - spread, degrees + spread, color=colour, alpha=0.25, linewidth=0)
    phase.plot(f, degrees, ".", color=colour, markersize=2.5)


def _line(magnitude: Axes, phase: Axes, f: FloatArray, response: ComplexArray, colour: str, label: str) -> None:
    """A fit."""
    magnitude.plot(f, 20 * np.log10(np.abs(response)), color=colour, linewidth=1.1, label=label)
    phase.plot(f, np.degrees(np.unwrap(np.angle(response))), color=colour, linewidth=1.1)


def trial_table(fit: AmplifierFit, trials: Sequence[Trial]) -> Table:
    """What each file played, and the gain that a linear model sees in it."""
    table = Table(title="trials, command to current")
    table.add_column("file")
    for heading in ("length [s]", "rate [Hz]", "peak [A]", "middle [A]", "gain with crossover"):
        table.add_column(heading, justify="right")
    for trial, gain in zip(trials, fit.trial_gains, strict=True):
        command = trial.input
        numbers = (command.values.size * command.dt_s, command.rate_Hz, np.abs(command.values).max())
        table.add_row(
            trial.name, *(f"{number:.6g}" for number in numbers), f"{np.median(command.values):.2f}", f"{gain:.4f}"
        )
    return table


def value_table(fit: AmplifierFit) -> Table:
    """Values with their 95 % intervals; below them what a continuous fit of the same response would say."""
    table = Table(title="amplifier")
    table.add_column("quantity")
    for heading in ("value", "95 % interval"):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    late = (fit.delay_s, fit.intervals["delay_s"], 1e6)
    rows = [
        ("pole", fit.pole_Hz, fit.intervals["pole_Hz"], 1.0, 0.0, "Hz", ".1f"),
        ("delay beyond the hold", *late, 0.0, "us", ".2f"),
        ("delay with the hold's half sample", *late, 5e5 * fit.dt_s, "us", ".2f"),
        ("gain", fit.gain, fit.intervals["gain"], 1.0, 0.0, "", ".4f"),
    ]
    for name, value, interval, factor, more, unit, form in rows:
        found, low, high = (format(factor * number + more, form) for number in (value, *interval))
        table.add_row(name, found, f"{low} to {high}", unit)
    crossover = fit.crossover
    if crossover.shows:
        h, half = 1e3 * crossover.half_width_A, 1.96e3 * crossover.deviation_A
        table.add_row("crossover, half-width", f"{h:.2f}", f"{h - half:.2f} to {h + half:.2f}", "mA")
    table.add_section()
    continuous = f"{fit.continuous_pole_Hz:.0f} Hz and {1e6 * fit.continuous_delay_s:.1f} us"
    table.add_row("without hold and sampling in the model", continuous, "", "")
    return table


def crossover_line(fit: AmplifierFit) -> str:
    """Whether the amplifier's dead band shows."""
    crossover = fit.crossover
    if crossover.shows:
        h = crossover.half_width_A
        # First harmonic of what a dead band takes off a sine of 1 A: 4 h / pi.
        lost = f"commands within {1e3 * h:.3g} mA of zero are lost, {400 * h / np.pi:.2g} % of a sine of 1 A"
        return f"crossover: {lost}; taken off before the fit, so that pole and delay are free of it"
    seen = f"none above {4e3 * crossover.deviation_A:.2g} mA" if crossover.deviation_A > 0 else "not to be seen"
    return f"crossover: {seen}"
